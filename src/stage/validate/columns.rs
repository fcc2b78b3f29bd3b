//! Values of one attribute as numbers to judge, whatever their width.

use super::{Audit, Check};
use glam::Vec3;
use openusd::sdf::Value;

/// Half-precision normals are off by 2⁻¹¹ a component.
const UNIT_TOLERANCE: f32 = 2e-3;

/// A fraction rounded to single precision after sums over thousands of rays may exceed its range by this much.
const FRACTION_TOLERANCE: f32 = 1e-5;

/// Numbers of an attribute, `width` components a value.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Numbers {
    pub(super) values: Vec<f32>,
    pub(super) width: usize,
    /// False for a single value.
    pub(super) is_array: bool,
}

impl Numbers {
    /// `None` for values that are no numbers.
    pub(super) fn new(value: &Value) -> Option<Self> {
        let array = |values: Vec<f32>, width| {
            Some(Self {
                values,
                width,
                is_array: true,
            })
        };
        #[expect(
            clippy::cast_possible_truncation,
            reason = "judged by sign, range and finiteness, which single precision keeps or makes infinite"
        )]
        let narrow = |values: &[f64]| values.iter().map(|&v| v as f32).collect();
        #[expect(clippy::cast_precision_loss, reason = "as above")]
        let whole = |values: &[i32]| values.iter().map(|&v| v as f32).collect();
        match value {
            Value::Float(v) => Some(Self {
                values: vec![*v],
                width: 1,
                is_array: false,
            }),
            Value::FloatVec(v) => array(v.clone(), 1),
            Value::DoubleVec(v) => array(narrow(v), 1),
            Value::HalfVec(v) => array(v.iter().map(|&v| v.into()).collect(), 1),
            Value::IntVec(v) => array(whole(v), 1),
            Value::Vec2fVec(v) => array(bytemuck::cast_slice(v).to_vec(), 2),
            Value::Vec3fVec(v) => array(bytemuck::cast_slice(v).to_vec(), 3),
            Value::Vec4fVec(v) => array(bytemuck::cast_slice(v).to_vec(), 4),
            Value::Vec3dVec(v) => array(narrow(bytemuck::cast_slice(v)), 3),
            Value::Vec3hVec(v) => {
                let numbers = v.iter().flat_map(|v| [v.x.into(), v.y.into(), v.z.into()]);
                array(numbers.collect(), 3)
            }
            _ => None,
        }
    }

    /// Number of values.
    pub(super) fn len(&self) -> usize {
        self.values.len() / self.width
    }

    /// Index of the first value with a component that `is_bad`.
    fn first(&self, is_bad: impl Fn(f32) -> bool) -> Option<usize> {
        let component = self.values.iter().position(|&value| is_bad(value))?;
        Some(component / self.width)
    }

    /// NaN and infinities.
    pub(super) fn check_finite(&self, place: &str, audit: &mut Audit) {
        audit.look(Check::NonFinite, self.len());
        if let Some(index) = self.first(|value| !value.is_finite()) {
            let count = self.values.iter().filter(|v| !v.is_finite()).count();
            let message = format!(
                "{count} of {} numbers are not finite, value {index} first",
                self.values.len()
            );
            audit.error(Check::NonFinite, place, message);
        }
    }

    /// Unit vectors; a zero vector is an error unless `zero_means_nothing`.
    pub(super) fn check_unit(&self, place: &str, zero_means_nothing: bool, audit: &mut Audit) {
        audit.look(Check::Normals, self.len());
        let vectors = self.values.chunks_exact(3).map(Vec3::from_slice);
        let lengths: Vec<f32> = vectors.map(Vec3::length).collect();
        let zeros = lengths.iter().filter(|&&length| length == 0.0).count();
        if zeros > 0 && !zero_means_nothing {
            let message = format!("{zeros} vectors are zero: such points face nowhere");
            audit.error(Check::Normals, place, message);
        }
        let is_off = |&length: &f32| {
            length != 0.0 && length.is_finite() && (length - 1.0).abs() > UNIT_TOLERANCE
        };
        if let Some(index) = lengths.iter().position(is_off) {
            let message = format!(
                "{} of {} vectors are no unit vectors, vector {index} first with length {}",
                lengths.iter().filter(|&length| is_off(length)).count(),
                lengths.len(),
                lengths[index]
            );
            audit.warn(Check::Normals, place, message);
        }
    }

    /// Light, areas: nothing below 0.
    pub(super) fn check_not_negative(&self, place: &str, audit: &mut Audit) {
        audit.look(Check::Range, self.len());
        if let Some(index) = self.first(|value| value < 0.0) {
            let count = self.values.iter().filter(|&&value| value < 0.0).count();
            let message = format!("{count} numbers are below 0, value {index} first");
            audit.error(Check::Range, place, message);
        }
    }

    /// Fractions: nothing above 1.
    pub(super) fn check_at_most_one(&self, place: &str, audit: &mut Audit) {
        let is_above = |value: f32| value.is_finite() && value > 1.0 + FRACTION_TOLERANCE;
        if let Some(index) = self.first(is_above) {
            let message = format!(
                "value {index} is {}, above 1",
                self.values[index * self.width..(index + 1) * self.width]
                    .iter()
                    .fold(0.0, |a: f32, &b| a.max(b))
            );
            audit.error(Check::Range, place, message);
        }
    }

    /// Judge the numbers of the AOV or column `name` (without `primvars:`).
    pub(super) fn check_meaning(&self, name: &str, place: &str, audit: &mut Audit) {
        let fraction = [
            "occlusion",
            "visibility",
            "reflection_occlusion",
            "albedo",
            "diffuse_albedo",
        ];
        let light = [
            "irradiance",
            "diffuse_",
            "emission",
            "radiosity",
            "specular_",
            "error_",
            "color",
            "displayColor",
        ];
        let direction = ["bent_normal", "illumination_direction", "N", "normals"];
        if direction.contains(&name) && self.width == 3 {
            self.check_unit(place, name != "N" && name != "normals", audit);
        } else if fraction.contains(&name) {
            self.check_not_negative(place, audit);
            self.check_at_most_one(place, audit);
        } else if light.iter().any(|start| name.starts_with(start)) && !name.contains("_sh") {
            self.check_not_negative(place, audit);
        }
    }
}
