//! Implicit gprims → triangles with vertices and normals on the true surface.
//!
//! How fine round shapes are cut is [`Solid::facets`]' business; `triangle_faces` number the parts: side 0, bottom 1,
//! top 2; a cube's sides 0–5.

use super::super::super::raw::RawPrim;
use super::attributes::boolean;
use super::primvars::AuthoredPrimvar;
use super::solids::{Axis, Solid};
use super::topology::Topology;
use crate::diagnostics::Diagnostics;
use crate::scene::{Interpolation, Mesh, Normals, Primvar};
use glam::{DMat3, DVec2, DVec3, Vec3};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Type names that [`Gprim::read`] knows.
pub(super) const TYPES: [&str; 8] = [
    "Cube",
    "Sphere",
    "Cylinder",
    "Cylinder_1",
    "Cone",
    "Capsule",
    "Capsule_1",
    "Plane",
];

/// An implicit gprim as authored.
#[derive(Debug)]
pub(super) struct Gprim {
    type_name: String,
    pub(super) solid: Solid,
    primvars: Vec<Primvar>,
    double_sided: bool,
}

impl Gprim {
    /// `prim` with those of the primvars called `names` that it or (constant) `inherited` prims author as one value.
    /// `None`, with a warning, when a size is not a positive number.
    pub(super) fn read(
        prim: &RawPrim,
        inherited: &[(String, &RawPrim)],
        names: &[String],
        diagnostics: &Diagnostics,
    ) -> Option<Self> {
        let Some(solid) = Solid::read(prim) else {
            diagnostics.warn(
                "degenerate-gprim",
                prim.path.clone(),
                "a size is not a positive number; it is left out",
            );
            return None;
        };
        let is_plane = matches!(solid, Solid::Plane { .. });
        Some(Self {
            type_name: prim.type_name.clone(),
            solid,
            primvars: constants(prim, inherited, names, diagnostics),
            double_sided: boolean(prim, "doubleSided", is_plane),
        })
    }

    /// Equal for gprims that [`Self::tessellate`] makes equal meshes of.
    pub(super) fn key(&self, facets: usize) -> String {
        let Self {
            type_name,
            solid,
            primvars,
            double_sided,
        } = self;
        // Debug prints floats with all the digits that tell them apart.
        format!("{type_name} {solid:?} {facets} {double_sided} {primvars:?}")
    }

    /// The mesh in object space, with `facets` (a multiple of 4) around where it is round.
    pub(super) fn tessellate(self, facets: usize) -> Mesh {
        let mut shape = Shape::default();
        shape.add(&self.solid, facets);
        Mesh {
            positions: shape.positions,
            triangles: shape.triangles,
            triangle_faces: shape.parts,
            normals: Normals::Vertex(shape.normals),
            primvars: self.primvars,
            double_sided: self.double_sided,
            closed: !matches!(self.solid, Solid::Plane { .. }),
            cage: None,
            scheme: self.type_name,
        }
    }
}

/// A smooth stretch of an outline, from bottom to top: (radius, height) and the normal in the same plane.
struct Stretch {
    part: u32,
    points: Vec<(DVec2, DVec2)>,
}

/// Two half spheres around a spine of length `height`, smooth all along. With different radii the half spheres
/// stay half spheres, as in the schema, and the side between them is a cone.
fn capsule(bottom: f64, top: f64, height: f64, quarter: usize) -> Vec<Stretch> {
    let arc = |radius: f64, center: f64, quarters: std::ops::RangeInclusive<usize>| {
        quarters.map(move |i| {
            let angle = FRAC_PI_2 * (as_f64(i) / as_f64(quarter) - 1.0);
            let direction = DVec2::new(angle.cos().max(0.0), angle.sin());
            // Exactly on the axis: the poles are single points.
            let direction = match i {
                0 => DVec2::NEG_Y,
                i if i == 2 * quarter => DVec2::Y,
                _ => direction,
            };
            (radius * direction + DVec2::new(0.0, center), direction)
        })
    };
    let lower = arc(bottom, -0.5 * height, 0..=quarter);
    let upper_start = if height > 0.0 { quarter } else { quarter + 1 };
    let upper = arc(top, 0.5 * height, upper_start..=2 * quarter);
    if bottom == top {
        let points = lower.chain(upper).collect();
        return vec![Stretch { part: 0, points }];
    }
    let mut side = frustum(bottom, top, height);
    side.truncate(1);
    side.push(Stretch {
        part: 1,
        points: lower.collect(),
    });
    side.push(Stretch {
        part: 2,
        points: arc(top, 0.5 * height, quarter..=2 * quarter).collect(),
    });
    side
}

/// A side and two flat ends; an end without radius is left out.
fn frustum(bottom: f64, top: f64, height: f64) -> Vec<Stretch> {
    let low = DVec2::new(bottom, -0.5 * height);
    let high = DVec2::new(top, 0.5 * height);
    let outward = DVec2::new(height, bottom - top).normalize_or_zero();
    let mut stretches = vec![Stretch {
        part: 0,
        points: vec![(low, outward), (high, outward)],
    }];
    if bottom > 0.0 {
        let center = DVec2::new(0.0, low.y);
        stretches.push(Stretch {
            part: 1,
            points: vec![(center, DVec2::NEG_Y), (low, DVec2::NEG_Y)],
        });
    }
    if top > 0.0 {
        let center = DVec2::new(0.0, high.y);
        stretches.push(Stretch {
            part: 2,
            points: vec![(high, DVec2::Y), (center, DVec2::Y)],
        });
    }
    stretches
}

#[derive(Default)]
struct Shape {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    parts: Vec<u32>,
}

impl Shape {
    fn add(&mut self, solid: &Solid, facets: usize) {
        match *solid {
            Solid::Cube(half) => self.cube(half),
            Solid::Plane {
                width,
                length,
                axis,
            } => self.plane(axis, width, length),
            Solid::Round {
                bottom,
                top,
                height,
                has_domes,
                axis,
            } => {
                let outline = if has_domes {
                    capsule(bottom, top, height, facets / 4)
                } else {
                    frustum(bottom, top, height)
                };
                for stretch in outline {
                    self.revolve(&stretch, axis.frame(), facets);
                }
            }
        }
    }

    fn vertex(&mut self, position: DVec3, normal: DVec3) -> u32 {
        self.positions.push(position.as_vec3());
        self.normals.push(normal.as_vec3());
        u32::try_from(self.positions.len() - 1).expect("gprims have a few thousand vertices")
    }

    fn quad(&mut self, part: u32, [a, b, c, d]: [u32; 4]) {
        self.triangles.extend([[a, b, c], [a, c, d]]);
        self.parts.extend([part; 2]);
    }

    fn cube(&mut self, half: f64) {
        let directions = [
            (DVec3::X, DVec3::Y),
            (DVec3::Y, DVec3::Z),
            (DVec3::Z, DVec3::X),
        ];
        for (axis, (normal, across)) in (0..).zip(directions) {
            for (side, sign) in [(0, -1.0), (1, 1.0)] {
                let normal = sign * normal;
                let up = normal.cross(across);
                let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
                let corners = corners.map(|(u, v)| {
                    let position = half * (normal + u * across + v * up);
                    self.vertex(position, normal)
                });
                self.quad(2 * axis + side, corners);
            }
        }
    }

    fn plane(&mut self, axis: Axis, width: f64, length: f64) {
        let (normal, along_width, along_length) = match axis {
            Axis::X => (DVec3::X, DVec3::Z, DVec3::Y),
            Axis::Y => (DVec3::Y, DVec3::X, DVec3::Z),
            Axis::Z => (DVec3::Z, DVec3::X, DVec3::Y),
        };
        let corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)];
        let mut corners = corners.map(|(u, v)| {
            let position = u * width * along_width + v * length * along_length;
            self.vertex(position, normal)
        });
        if along_width.cross(along_length).dot(normal) < 0.0 {
            corners.reverse();
        }
        self.quad(0, corners);
    }

    /// Turn a stretch around the spine. Rings of radius 0 are one vertex each facet, so that their normals can lean
    /// its way (a cone's tip).
    fn revolve(&mut self, stretch: &Stretch, axes: DMat3, facets: usize) {
        let ring_count = stretch.points.len();
        let mut rings: Vec<Vec<u32>> = Vec::with_capacity(ring_count);
        for &(point, normal) in &stretch.points {
            let is_pole = point.x == 0.0;
            let offset = if is_pole { 0.5 } else { 0.0 };
            let ring = (0..facets).map(|i| {
                let (sine, cosine) = (TAU * (as_f64(i) + offset) / as_f64(facets)).sin_cos();
                let turn = |p: DVec2| axes * DVec3::new(p.x * cosine, p.x * sine, p.y);
                self.vertex(turn(point), turn(normal))
            });
            rings.push(ring.collect());
        }
        for (low, high) in rings.iter().zip(rings.iter().skip(1)) {
            self.band(stretch.part, low, high);
        }
    }

    fn band(&mut self, part: u32, low: &[u32], high: &[u32]) {
        let at = |ring: &[u32], i: usize| ring[i % ring.len()];
        let is_pole = |shape: &Self, ring: &[u32]| {
            shape.positions[ring[0] as usize] == shape.positions[ring[ring.len() / 4] as usize]
        };
        let (low_pole, high_pole) = (is_pole(self, low), is_pole(self, high));
        for i in 0..low.len() {
            let [a, b] = [at(low, i), at(low, i + 1)];
            let [c, d] = [at(high, i + 1), at(high, i)];
            match (low_pole, high_pole) {
                (false, false) => self.quad(part, [a, b, c, d]),
                (true, false) => self.triangle(part, [a, c, d]),
                (false, true) => self.triangle(part, [a, b, d]),
                (true, true) => {}
            }
        }
    }

    fn triangle(&mut self, part: u32, corners: [u32; 3]) {
        self.triangles.push(corners);
        self.parts.push(part);
    }
}

/// Primvars of one value; a gprim has no points or faces that others could belong to.
fn constants(
    prim: &RawPrim,
    inherited: &[(String, &RawPrim)],
    names: &[String],
    diagnostics: &Diagnostics,
) -> Vec<Primvar> {
    let single = Topology {
        point_count: 1,
        counts: vec![1].into(),
        indices: vec![0].into(),
        offsets: vec![0, 1],
        is_drawn: vec![true],
    };
    let read = |name: &String| {
        let own = AuthoredPrimvar::read(prim, name, &single, diagnostics);
        let authored = own.or_else(|| {
            let (_, owner) = inherited.iter().find(|(inherited, _)| inherited == name)?;
            AuthoredPrimvar::read(owner, name, &single, diagnostics)
        })?;
        Some(authored.finish(Interpolation::Constant, authored.expanded()))
    };
    names.iter().filter_map(read).collect()
}

#[expect(clippy::cast_precision_loss, reason = "counts of facets")]
fn as_f64(count: usize) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use super::super::super::super::raw::Value;
    use super::super::tests::{prim, with_attribute};
    use super::*;
    use std::f64::consts::PI;

    /// What shapes that fill the scene get.
    const FINEST: usize = 100;

    fn gprim(type_name: &str, sizes: &[(&str, f64)], axis: &str) -> Mesh {
        let mut prim = RawPrim::typed("/g", type_name, None);
        for &(name, size) in sizes {
            prim = with_attribute(prim, name, Value::Float(size), None);
        }
        prim = with_attribute(prim, "axis", Value::Token(axis.into()), None);
        let gprim = Gprim::read(&prim, &[], &[], &Diagnostics::default()).unwrap();
        gprim.tessellate(FINEST)
    }

    /// Area, enclosed volume, and the least cosine between a triangle's plane normal and its corners' normals.
    fn measure(mesh: &Mesh) -> (f64, f64, f32) {
        let Normals::Vertex(normals) = &mesh.normals else {
            unreachable!("gprims have vertex normals")
        };
        let (mut area, mut volume, mut cosine) = (0.0, 0.0, 1.0_f32);
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3());
            area += 0.5 * (b - a).cross(c - a).length();
            volume += a.dot(b.cross(c)) / 6.0;
            for i in mesh.triangles[t] {
                cosine = cosine.min(normals[i as usize].dot(mesh.plane_normal(t)));
            }
        }
        (area, volume, cosine)
    }

    #[track_caller]
    fn assert_size(mesh: &Mesh, area: f64, volume: f64) {
        let (got_area, got_volume, cosine) = measure(mesh);
        assert!(
            (got_area / area - 1.0).abs() < 2e-3,
            "{got_area} for {area}"
        );
        assert!(
            (got_volume / volume - 1.0).abs() < 3e-3,
            "{got_volume} for {volume}"
        );
        assert!(cosine > 0.99, "normals lean by {cosine}");
    }

    #[test]
    fn areas_and_volumes_are_those_of_the_solids() {
        assert_size(&gprim("Cube", &[("size", 3.0)], "Z"), 54.0, 27.0);
        let r = 2.0;
        let sphere = gprim("Sphere", &[("radius", r)], "Z");
        assert_size(&sphere, 4.0 * PI * r * r, 4.0 / 3.0 * PI * r.powi(3));
        for axis in ["X", "Y", "Z"] {
            let cylinder = gprim("Cylinder", &[("radius", r), ("height", 5.0)], axis);
            assert_size(&cylinder, TAU * r * (r + 5.0), PI * r * r * 5.0);
            let cone = gprim("Cone", &[("radius", 3.0), ("height", 4.0)], axis);
            assert_size(&cone, PI * 3.0 * (3.0 + 5.0), PI * 9.0 * 4.0 / 3.0);
            let capsule = gprim("Capsule", &[("radius", r), ("height", 3.0)], axis);
            let ball = 4.0 / 3.0 * PI * r.powi(3);
            assert_size(&capsule, TAU * r * (2.0 * r + 3.0), ball + PI * r * r * 3.0);
        }
    }

    #[test]
    fn different_radii_give_frustums() {
        let radii = [("radiusBottom", 3.0), ("radiusTop", 1.0), ("height", 2.0)];
        let slant = 8.0_f64.sqrt();
        let side = PI * 4.0 * slant;
        let frustum_volume = PI * 2.0 / 3.0 * (9.0 + 3.0 + 1.0);
        let cylinder = gprim("Cylinder_1", &radii, "Y");
        assert_size(&cylinder, side + PI * 10.0, frustum_volume);
        let capsule = gprim("Capsule_1", &radii, "Y");
        let halves = 2.0 / 3.0 * PI * 28.0;
        assert_size(&capsule, side + TAU * 10.0, frustum_volume + halves);
        let top = capsule
            .positions
            .iter()
            .map(|p| p.y)
            .fold(f32::MIN, f32::max);
        assert_eq!(top, 2.0);
    }

    #[test]
    fn spheres_are_as_deep_as_asked_with_vertices_and_normals_on_the_true_surface() {
        for (facets, error) in [(FINEST, 1e-3), (32, 1e-2)] {
            let sphere = Gprim {
                type_name: "Sphere".into(),
                solid: Solid::read(&prim("/s", "Sphere", None)).unwrap(),
                primvars: Vec::new(),
                double_sided: false,
            };
            let sphere = sphere.tessellate(facets);
            let off = sphere.positions.iter().map(|p| (p.length() - 1.0).abs());
            assert!(off.fold(0.0, f32::max) < 1e-6);
            let deepest = (0..sphere.triangles.len()).map(|t| {
                let [a, b, c] = sphere.corners(t);
                [a + b, b + c, c + a].map(|p| 1.0 - 0.5 * p.length())
            });
            let deepest = deepest.flatten().fold(0.0, f32::max);
            assert!(deepest < 1.001 * error, "{deepest} with {facets}");
            let Normals::Vertex(normals) = &sphere.normals else {
                unreachable!("gprims have vertex normals")
            };
            // The poles' normals lean nowhere either.
            for (position, normal) in sphere.positions.iter().zip(normals) {
                assert!(position.distance(*normal) < 1e-6);
            }
        }
    }

    #[test]
    fn planes_face_their_axis_and_lie_as_the_schema_says() {
        let sizes = [("width", 4.0), ("length", 2.0)];
        for (axis, normal, half) in [
            ("X", Vec3::X, Vec3::new(0.0, 1.0, 2.0)),
            ("Y", Vec3::Y, Vec3::new(2.0, 0.0, 1.0)),
            ("Z", Vec3::Z, Vec3::new(2.0, 1.0, 0.0)),
        ] {
            let plane = gprim("Plane", &sizes, axis);
            assert_eq!(plane.plane_normal(0), normal);
            assert_eq!(plane.bounds().max, half);
            assert!(plane.double_sided && !plane.closed);
        }
    }

    #[test]
    fn sizes_that_are_not_positive_leave_it_out_with_a_warning() {
        for radius in [-1.0, f64::NAN] {
            let prim = RawPrim::typed("", "Sphere", None);
            let prim = with_attribute(prim, "radius", Value::Float(radius), None);
            let diagnostics = Diagnostics::default();
            assert!(Gprim::read(&prim, &[], &[], &diagnostics).is_none());
            assert_eq!(diagnostics.warnings().len(), 1);
        }
    }

    #[test]
    fn constant_display_color_is_kept() {
        let prim = RawPrim::typed("", "Sphere", None);
        let color = Value::Vec3Array(vec![Vec3::ONE]);
        let prim = with_attribute(prim, "primvars:displayColor", color, None);
        let names = ["displayColor".to_owned()];
        let gprim = Gprim::read(&prim, &[], &names, &Diagnostics::default()).unwrap();
        let mesh = gprim.tessellate(FINEST);
        assert_eq!(mesh.primvars[0].values[0].truncate(), Vec3::ONE);
        assert_eq!(mesh.primvars[0].interpolation, Interpolation::Constant);
    }
}
