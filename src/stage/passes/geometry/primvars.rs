//! Authored primvars → values over the triangles: indices resolved, lengths checked, layout translated.

use super::super::super::raw::{RawAttribute, RawPrim, Value};
use super::topology::Topology;
use crate::diagnostics::Diagnostics;
use crate::scene::{Interpolation, Primvar};
use glam::{Vec2, Vec3, Vec4};

/// Where an authored primvar has its values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    Constant,
    Uniform,
    Vertex,
    Varying,
    FaceVarying,
}

impl Layout {
    fn from_token(token: Option<&str>) -> Option<Self> {
        match token {
            None | Some("constant") => Some(Self::Constant),
            Some("uniform") => Some(Self::Uniform),
            Some("vertex") => Some(Self::Vertex),
            Some("varying") => Some(Self::Varying),
            Some("faceVarying") => Some(Self::FaceVarying),
            Some(_) => None,
        }
    }

    fn element_count(self, topology: &Topology) -> usize {
        match self {
            Self::Constant => 1,
            Self::Uniform => topology.face_count(),
            Self::Vertex | Self::Varying => topology.point_count,
            Self::FaceVarying => topology.indices.len(),
        }
    }
}

/// A primvar as authored, valid for its mesh.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct AuthoredPrimvar {
    pub(super) name: String,
    pub(super) components: u8,
    pub(super) layout: Layout,
    pub(super) values: Vec<Vec4>,
    /// For every element (face, point, face-vertex) its value; `None` = the values are those of the elements, in order.
    indices: Option<Vec<u32>>,
}

impl AuthoredPrimvar {
    /// Read `primvars:NAME` of `prim` for a mesh with `topology`. `None` if it is not authored; with a warning if it
    /// cannot be used.
    pub(super) fn read(
        prim: &RawPrim,
        name: &str,
        topology: &Topology,
        diagnostics: &Diagnostics,
    ) -> Option<Self> {
        let attribute = prim.attributes.get(&format!("primvars:{name}"))?;
        attribute.value.as_ref()?;
        let indices = prim.attributes.get(&format!("primvars:{name}:indices"));
        let read = read_attribute(
            attribute,
            indices,
            attribute.interpolation.as_deref(),
            topology,
        );
        match read {
            Ok(mut primvar) => {
                name.clone_into(&mut primvar.name);
                primvar.remove_non_finite(prim, diagnostics);
                Some(primvar)
            }
            Err(message) => {
                diagnostics.warn(
                    "bad-primvar",
                    prim.path.clone(),
                    format!("primvars:{name} is ignored: {message}"),
                );
                None
            }
        }
    }

    /// Constant primvars are inherited from ancestors; others are not.
    pub(super) fn is_inheritable(attribute: &RawAttribute) -> bool {
        attribute.value.is_some()
            && Layout::from_token(attribute.interpolation.as_deref()) == Some(Layout::Constant)
    }

    fn remove_non_finite(&mut self, prim: &RawPrim, diagnostics: &Diagnostics) {
        let mut count = 0;
        for value in self.values.iter_mut().filter(|value| !value.is_finite()) {
            *value = Vec4::ZERO;
            count += 1;
        }
        if count > 0 {
            diagnostics.warn(
                "non-finite-primvar",
                prim.path.clone(),
                format!(
                    "{count} values of primvars:{} are not finite and count as 0",
                    self.name
                ),
            );
        }
    }

    /// Place among `values` of that of `element`.
    pub(super) fn place_of(&self, element: u32) -> u32 {
        match &self.indices {
            Some(indices) => indices[element as usize],
            None => element,
        }
    }

    /// Value of `element`.
    pub(super) fn value_of(&self, element: usize) -> Vec4 {
        match &self.indices {
            Some(indices) => self.values[indices[element] as usize],
            None => self.values[element],
        }
    }

    /// One value an element, in element order.
    pub(super) fn expanded(&self) -> Vec<Vec4> {
        match &self.indices {
            Some(indices) => expanded(&self.values, indices),
            None => self.values.clone(),
        }
    }

    /// Laid out over the triangles of the authored polygons, whose face-vertices are `corners`: only face-varying ones need them.
    pub(super) fn on_polygons(self, mut corners: Vec<[u32; 3]>) -> Primvar {
        let interpolation = match self.layout {
            Layout::Constant => Interpolation::Constant,
            Layout::Uniform => Interpolation::Uniform,
            Layout::Vertex | Layout::Varying => Interpolation::Vertex,
            Layout::FaceVarying => {
                for corner in corners.as_flattened_mut() {
                    *corner = self.place_of(*corner);
                }
                Interpolation::Corner(corners)
            }
        };
        let values = match self.indices {
            Some(indices) if self.layout != Layout::FaceVarying => expanded(&self.values, &indices),
            _ => self.values,
        };
        Primvar {
            name: self.name,
            components: self.components,
            interpolation,
            values,
        }
    }

    /// With this name and number of components.
    pub(super) fn finish(&self, interpolation: Interpolation, values: Vec<Vec4>) -> Primvar {
        Primvar {
            name: self.name.clone(),
            components: self.components,
            interpolation,
            values,
        }
    }
}

fn expanded(values: &[Vec4], indices: &[u32]) -> Vec<Vec4> {
    indices.iter().map(|&i| values[i as usize]).collect()
}

/// Values of `attribute` with `interpolation`, checked against `topology`. The error says what would be right.
pub(super) fn read_attribute(
    attribute: &RawAttribute,
    indices: Option<&RawAttribute>,
    interpolation: Option<&str>,
    topology: &Topology,
) -> Result<AuthoredPrimvar, String> {
    let layout = Layout::from_token(interpolation).ok_or_else(|| {
        let word = interpolation.unwrap_or_default();
        format!("interpolation {word:?} is none of constant, uniform, varying, vertex, faceVarying")
    })?;
    let (components, values) = vectors(attribute)?;
    let count = layout.element_count(topology);
    let indices = match indices.and_then(|indices| indices.value.as_ref()) {
        Some(Value::IntArray(indices)) => Some(checked(indices, values.len(), count)?),
        _ if values.len() == count => None,
        _ => return Err(wrong_length("values", values.len(), layout, count)),
    };
    Ok(AuthoredPrimvar {
        name: String::new(),
        components,
        layout,
        values,
        indices,
    })
}

fn wrong_length(what: &str, got: usize, layout: Layout, right: usize) -> String {
    format!("it has {got} {what}, {layout:?} interpolation on this mesh needs {right}")
}

fn checked(indices: &[i32], value_count: usize, count: usize) -> Result<Vec<u32>, String> {
    if indices.len() != count {
        return Err(format!(
            "it has {} indices, its interpolation needs {count} on this mesh",
            indices.len()
        ));
    }
    let valid = |&index: &i32| {
        let in_range = u32::try_from(index)
            .ok()
            .filter(|&i| (i as usize) < value_count);
        in_range
            .ok_or_else(|| format!("index {index} is out of range, there are {value_count} values"))
    };
    indices.iter().map(valid).collect()
}

/// Values as 4-vectors, and the number of components that were authored.
fn vectors(attribute: &RawAttribute) -> Result<(u8, Vec<Vec4>), String> {
    // Colors without alpha are opaque.
    let w = if attribute.type_name.starts_with("color3") {
        1.0
    } else {
        0.0
    };
    let Some(value) = &attribute.value else {
        return Err("it has no value".into());
    };
    let size = usize::try_from(attribute.element_size.unwrap_or(1)).unwrap_or(1);
    if size > 1 {
        return grouped(value, size);
    }
    let two = |v: Vec2| v.extend(0.0).extend(0.0);
    Ok(match value {
        Value::Float(x) => (1, vec![scalar(single(*x))]),
        Value::Vec2(v) => (2, vec![two(v.as_vec2())]),
        Value::Vec3(v) => (3, vec![v.as_vec3().extend(w)]),
        Value::Vec4(v) => (4, vec![v.as_vec4()]),
        Value::FloatArray(values) => (1, values.iter().copied().map(scalar).collect()),
        Value::Vec2Array(values) => (2, values.iter().copied().map(two).collect()),
        Value::Vec3Array(values) => (3, values.iter().map(|v| v.extend(w)).collect()),
        Value::Vec4Array(values) => (4, values.clone()),
        #[expect(
            clippy::cast_precision_loss,
            reason = "integers are read as weights or ids below 2^24"
        )]
        Value::IntArray(values) => (1, values.iter().map(|&i| scalar(i as f32)).collect()),
        _ => {
            return Err(format!(
                "its type {:?} is not one of floats or vectors",
                attribute.type_name
            ));
        }
    })
}

/// `elementSize` floats form one value; only up to 4 components can be kept.
fn grouped(value: &Value, size: usize) -> Result<(u8, Vec<Vec4>), String> {
    let (Value::FloatArray(values), Ok(components @ 2..=4)) = (value, u8::try_from(size)) else {
        return Err(format!(
            "elementSize {size} of this type cannot be used; only 2 to 4 floats can"
        ));
    };
    if values.len() % size != 0 {
        return Err(format!(
            "it has {} floats, not a multiple of its elementSize {size}",
            values.len()
        ));
    }
    let vector = |group: &[f32]| {
        Vec4::from_array(std::array::from_fn(|i| {
            group.get(i).copied().unwrap_or(0.0)
        }))
    };
    Ok((components, values.chunks(size).map(vector).collect()))
}

fn scalar(x: f32) -> Vec4 {
    Vec3::ZERO.extend(0.0).with_x(x)
}

#[expect(clippy::cast_possible_truncation, reason = "values are stored as f32")]
fn single(x: f64) -> f32 {
    x as f32
}

#[cfg(test)]
mod tests {
    use super::super::tests::{mesh, with_attribute};
    use super::super::triangulate::Triangulation;
    use super::*;

    /// Two triangles and a quad over six points: 3 faces, 10 face-vertices.
    fn sample() -> (RawPrim, Topology<'static>) {
        let prim = mesh(
            "/m",
            &[Vec3::ZERO; 6],
            &[3, 3, 4],
            &[0, 1, 2, 2, 1, 3, 2, 3, 4, 5],
        );
        let topology = Topology::read(&prim, 6, &Diagnostics::default()).unwrap();
        let topology = topology.into_owned();
        (prim, topology)
    }

    fn floats(count: u8) -> Value {
        Value::FloatArray((0..count).map(f32::from).collect())
    }

    fn read(
        value: Value,
        interpolation: &str,
        indices: Option<Vec<i32>>,
    ) -> (Option<AuthoredPrimvar>, Vec<String>) {
        let (prim, topology) = sample();
        let mut prim = with_attribute(prim, "primvars:a", value, Some(interpolation));
        if let Some(indices) = indices {
            prim = with_attribute(prim, "primvars:a:indices", Value::IntArray(indices), None);
        }
        let diagnostics = Diagnostics::default();
        let primvar = AuthoredPrimvar::read(&prim, "a", &topology, &diagnostics);
        let messages = diagnostics.warnings().into_iter().map(|w| w.message);
        (primvar, messages.collect())
    }

    #[test]
    fn every_interpolation_needs_its_own_number_of_values() {
        for (interpolation, count) in [
            ("constant", 1),
            ("uniform", 3),
            ("vertex", 6),
            ("varying", 6),
            ("faceVarying", 10),
        ] {
            let (primvar, warnings) = read(floats(count), interpolation, None);
            assert_eq!(primvar.unwrap().values.len(), usize::from(count));
            assert!(warnings.is_empty());
            let (primvar, warnings) = read(floats(count + 1), interpolation, None);
            assert_eq!(primvar, None);
            assert!(
                warnings[0].ends_with(&format!("needs {count}")),
                "{warnings:?}"
            );
        }
    }

    #[test]
    fn indices_are_followed_and_checked() {
        let (primvar, _) = read(floats(2), "uniform", Some(vec![1, 0, 1]));
        let xs: Vec<f32> = primvar.unwrap().expanded().iter().map(|v| v.x).collect();
        assert_eq!(xs, [1.0, 0.0, 1.0]);
        let (none, warnings) = read(floats(2), "uniform", Some(vec![1, 2, 1]));
        assert!(none.is_none() && warnings[0].contains("index 2 is out of range"));
        let (none, warnings) = read(floats(2), "uniform", Some(vec![1]));
        assert!(none.is_none() && warnings[0].contains("needs 3"));
    }

    #[test]
    fn face_varying_values_stay_with_their_corners() {
        let (primvar, _) = read(floats(10), "faceVarying", None);
        let mut triangulation = Triangulation::default();
        let square = [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y];
        triangulation.add(2, 6, &[0, 1, 2, 3], &square);
        let laid_out = primvar.unwrap().on_polygons(triangulation.corners);
        assert_eq!(
            laid_out.interpolation,
            Interpolation::Corner(vec![[6, 7, 8], [6, 8, 9]])
        );
    }

    #[test]
    fn element_size_groups_floats_and_colors_get_an_alpha_of_one() {
        let (prim, topology) = sample();
        let mut prim = with_attribute(prim, "primvars:a", floats(9), Some("uniform"));
        let attribute = prim.attributes.get_mut("primvars:a").unwrap();
        attribute.element_size = Some(3);
        let diagnostics = Diagnostics::default();
        let primvar = AuthoredPrimvar::read(&prim, "a", &topology, &diagnostics).unwrap();
        assert_eq!(primvar.components, 3);
        assert_eq!(primvar.values[1], Vec4::new(3.0, 4.0, 5.0, 0.0));

        let mut prim = with_attribute(prim, "primvars:c", Value::Vec3Array(vec![Vec3::ONE]), None);
        prim.attributes.get_mut("primvars:c").unwrap().type_name = "color3f[]".into();
        let color = AuthoredPrimvar::read(&prim, "c", &topology, &diagnostics).unwrap();
        assert_eq!(color.values, [Vec4::ONE]);
        assert!(diagnostics.warnings().is_empty());
    }

    #[test]
    fn values_that_are_not_finite_become_zero_with_a_warning() {
        let (primvar, warnings) = read(
            Value::FloatArray(vec![1.0, f32::NAN, f32::INFINITY]),
            "uniform",
            None,
        );
        assert_eq!(primvar.unwrap().values[1..], [Vec4::ZERO; 2]);
        assert!(warnings[0].starts_with("2 values"));
    }
}
