//! Values to look at: one of each channel for every surfel or vertex.

use crate::surfels::points::{ColumnValues, VectorKind};
use glam::Vec3;

/// What a channel's numbers are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChannelKind {
    /// Linear Rec.709, three numbers.
    Color,
    /// One number.
    Scalar,
    /// Three numbers, −1…1.
    Direction,
    /// One whole number.
    Id,
}

impl ChannelKind {
    /// Numbers a value.
    pub fn components(self) -> usize {
        match self {
            Self::Color | Self::Direction => 3,
            Self::Scalar | Self::Id => 1,
        }
    }

    /// The word for it in the page's data.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Color => "color",
            Self::Scalar => "scalar",
            Self::Direction => "direction",
            Self::Id => "id",
        }
    }
}

/// A named value for each element; NaN where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    /// As the AOV or primvar is called.
    pub name: String,
    /// What it is.
    pub kind: ChannelKind,
    /// `kind.components()` numbers an element.
    pub values: Vec<f32>,
}

/// Fractions: their false colors span 0…1 whatever the values are.
const FRACTIONS: [&str; 3] = ["occlusion", "visibility", "reflection_occlusion"];

/// Colors that are fractions of light: never exposed.
const ALBEDOS: [&str; 3] = ["albedo", "diffuse_albedo", "diffuseColor"];

/// Share of the values below the low end, and above the high end, of a scale found from the values.
const CLIPPED: f32 = 0.005;

/// Share of color values that are not clipped: a lamp may take the rest. As in preview images.
const WHITE_PERCENTILE: f32 = 0.95;

/// Stops at most that dark colors are brightened by.
const MOST_STOPS: f32 = 10.0;

impl Channel {
    /// A point's column as a channel. Directions are told by their type or by names that mean them.
    pub(super) fn of_column(name: &str, values: &ColumnValues) -> Self {
        let (kind, values) = match values {
            ColumnValues::Floats(values) => (ChannelKind::Scalar, values.clone()),
            #[expect(
                clippy::cast_precision_loss,
                reason = "ids below 2^24, or hues that may repeat"
            )]
            ColumnValues::Ints(values) => (
                ChannelKind::Id,
                values.iter().map(|&id| id as f32).collect(),
            ),
            ColumnValues::Vectors(kind, values) => {
                let is_color = *kind == VectorKind::Color;
                let kind = if is_color {
                    ChannelKind::Color
                } else {
                    ChannelKind::Direction
                };
                (kind, values.iter().flat_map(|v| v.to_array()).collect())
            }
        };
        Self {
            name: name.to_owned(),
            kind,
            values,
        }
    }

    /// Value of element `i`, as three numbers.
    pub(super) fn at(&self, i: usize) -> Vec3 {
        match self.kind.components() {
            1 => Vec3::splat(self.values[i]),
            _ => Vec3::from_slice(&self.values[3 * i..3 * i + 3]),
        }
    }

    /// Ends of the scale of false colors; (0, 1) for what is none.
    pub fn scale(&self) -> (f32, f32) {
        if self.kind != ChannelKind::Scalar || FRACTIONS.contains(&self.name.as_str()) {
            return (0.0, 1.0);
        }
        let mut values: Vec<f32> = self
            .values
            .iter()
            .copied()
            .filter(|x| x.is_finite())
            .collect();
        let low = percentile(&mut values, CLIPPED);
        let high = percentile(&mut values, 1.0 - CLIPPED);
        match low.zip(high) {
            Some((low, high)) if high > low => (low, high),
            Some((low, _)) => (low, low + low.abs().max(f32::MIN_POSITIVE)),
            None => (0.0, 1.0),
        }
    }

    /// Stops that a color channel is exposed by: the 95th percentile of the brightest component of what is not black
    /// becomes white; 0 for fractions of light and for what is no color.
    pub fn exposure(&self) -> f32 {
        if self.kind != ChannelKind::Color || ALBEDOS.contains(&self.name.as_str()) {
            return 0.0;
        }
        let brightest = |color: &[f32]| color.iter().copied().fold(0.0, f32::max);
        let mut values: Vec<f32> = self
            .values
            .chunks_exact(3)
            .map(brightest)
            .filter(|value| *value > 0.0 && value.is_finite())
            .collect();
        match percentile(&mut values, WHITE_PERCENTILE) {
            Some(white) => (-white.log2()).min(MOST_STOPS),
            None => 0.0,
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "an index of a list, rounded"
)]
fn percentile(values: &mut [f32], share: f32) -> Option<f32> {
    let last = values.len().checked_sub(1)?;
    let index = ((last as f32 * share).round() as usize).min(last);
    Some(*values.select_nth_unstable_by(index, f32::total_cmp).1)
}

/// Add what side by side views need: the sum of direct and indirect light where only its parts are there, and light
/// without the indirect part where only sum and part are.
pub(super) fn add_derived(channels: &mut Vec<Channel>) {
    for base in ["irradiance", "diffuse"] {
        let name = |part: &str| format!("{base}_{part}");
        let find = |name: &str| {
            let mut colors = channels.iter().filter(|c| c.kind == ChannelKind::Color);
            colors.find(|channel| channel.name == name)
        };
        let (sum, indirect) = (find(base), find(&name("indirect")));
        let (direct, sky) = (find(&name("direct")), find(&name("environment")));
        let Some(indirect) = indirect else { continue };
        let made = match (sum, direct) {
            (None, Some(direct)) => {
                let mut total = combined(direct, indirect, (base, 1.0));
                if let Some(sky) = sky {
                    total = combined(&total, sky, (base, 1.0));
                }
                Some(total)
            }
            (Some(sum), _) if direct.is_none() || sky.is_some() => {
                Some(combined(sum, indirect, (&name("without_indirect"), -1.0)))
            }
            _ => None,
        };
        channels.extend(made);
    }
}

fn combined(a: &Channel, b: &Channel, (name, weight): (&str, f32)) -> Channel {
    let values = a.values.iter().zip(&b.values);
    Channel {
        name: name.to_owned(),
        kind: ChannelKind::Color,
        values: values.map(|(a, b)| (a + weight * b).max(0.0)).collect(),
    }
}

/// Names of the channels with and without light that was reflected, if both are there.
pub(super) fn with_and_without(channels: &[Channel]) -> Option<(&str, &str)> {
    let find = |name: &str| channels.iter().find(|channel| channel.name == name);
    let pairs = [
        ("irradiance", "irradiance_without_indirect"),
        ("irradiance", "irradiance_direct"),
        ("diffuse", "diffuse_direct"),
    ];
    let found = pairs
        .into_iter()
        .find_map(|(with, without)| find(with).zip(find(without)));
    found.map(|(with, without)| (with.name.as_str(), without.name.as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn color(name: &str, values: &[f32]) -> Channel {
        Channel {
            name: name.to_owned(),
            kind: ChannelKind::Color,
            values: values.to_vec(),
        }
    }

    #[test]
    fn light_with_and_without_reflections_comes_of_any_two_of_three() {
        let mut parts = vec![
            color("irradiance_direct", &[1.0, 2.0, 3.0]),
            color("irradiance_indirect", &[0.5, 0.25, 0.0]),
        ];
        add_derived(&mut parts);
        assert_eq!(parts[2], color("irradiance", &[1.5, 2.25, 3.0]));
        assert_eq!(
            with_and_without(&parts),
            Some(("irradiance", "irradiance_direct"))
        );
        let mut parts = vec![
            color("irradiance", &[1.5, 2.25, 3.0]),
            color("irradiance_indirect", &[0.5, 0.25, 0.0]),
        ];
        add_derived(&mut parts);
        assert_eq!(
            parts[2],
            color("irradiance_without_indirect", &[1.0, 2.0, 3.0])
        );
        assert_eq!(with_and_without(&parts[..2]), None);
    }

    #[test]
    fn scales_leave_out_the_outermost_values_and_fractions_have_their_own() {
        let scalar = |name: &str, values: Vec<f32>| Channel {
            name: name.to_owned(),
            kind: ChannelKind::Scalar,
            values,
        };
        let values: Vec<f32> = (0..=1000_u16).map(f32::from).collect();
        assert_eq!(scalar("area", values).scale(), (5.0, 995.0));
        assert_eq!(scalar("occlusion", vec![0.2, 0.3]).scale(), (0.0, 1.0));
        assert_eq!(scalar("area", vec![f32::NAN]).scale(), (0.0, 1.0));
        let (low, high) = scalar("area", vec![2.0, 2.0]).scale();
        assert!(low == 2.0 && high > low);
    }

    #[test]
    fn exposure_makes_bright_values_white_and_leaves_albedo() {
        let gray = [0.25; 300];
        assert_eq!(color("irradiance", &gray).exposure(), 2.0);
        assert_eq!(color("albedo", &gray).exposure(), 0.0);
        assert_eq!(color("irradiance", &[0.0; 3]).exposure(), 0.0);
    }
}
