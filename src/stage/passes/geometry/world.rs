//! Meshes carried into world space, and what transforms do to sizes.

use super::super::super::raw::RawStage;
use super::super::flatten::Occurrence;
use super::attributes::vectors;
use super::placement::{Kind, Placement};
use super::solids::Solid;
use crate::math::Bounds3;
use crate::scene::{Interpolation, Mesh, Normals};
use glam::{DMat3, DMat4, DVec3, Vec3};
use std::collections::HashMap;

/// A transform flattens space when its volume is below this part of what its columns could span: nothing is left of
/// an f32 normal there.
const SINGULAR: f64 = 1e-14;

/// Distances beyond this, stage units, cannot be worked with: products of four of them are no f32 any more.
pub(super) const LARGEST_DISTANCE: f64 = 1e9;

/// Boxes around prims' control points.
pub(super) struct Boxes<'a> {
    raw: &'a RawStage,
    occurrences: &'a [Occurrence],
    of_prim: HashMap<usize, (DVec3, DVec3)>,
}

impl<'a> Boxes<'a> {
    pub(super) fn new(raw: &'a RawStage, occurrences: &'a [Occurrence]) -> Self {
        Self {
            raw,
            occurrences,
            of_prim: HashMap::new(),
        }
    }

    /// Absolute world bounds of `placement`, around its transformed box; `min > max` when empty. Not finite where the
    /// control points or the transform are not.
    pub(super) fn world(&mut self, placement: &Placement) -> (DVec3, DVec3) {
        let prim = self.occurrences[placement.occurrence].prim;
        let raw = self.raw;
        let of_prim = self.of_prim.entry(prim);
        let (min, max) = *of_prim.or_insert_with(|| object_box(raw, prim));
        let mut all = NO_BOUNDS;
        if min.cmpgt(max).any() {
            return all;
        }
        for corner in 0..8 {
            let pick = |axis: usize| {
                if corner >> axis & 1 == 0 {
                    min[axis]
                } else {
                    max[axis]
                }
            };
            let local = DVec3::new(pick(0), pick(1), pick(2));
            let point = placement.world_from_object.transform_point3(local);
            if point.is_nan() {
                return (DVec3::NAN, DVec3::NAN);
            }
            all = (all.0.min(point), all.1.max(point));
        }
        all
    }

    /// Leave out what is drawn too far from what lies nearest to zero, or nowhere; `tell` hears of each. Control
    /// points that are not finite are not judged here. Returns the bounds of the rest.
    pub(super) fn keep_within_reach(
        &mut self,
        placements: &mut Vec<Placement>,
        tell: impl Fn(&Placement),
    ) -> (DVec3, DVec3) {
        let mut boxes: Vec<_> = placements.iter().map(|p| self.world(p)).collect();
        let centers = boxes.iter().map(|(min, max)| 0.5 * min + 0.5 * max);
        let sound = centers.filter(|center| center.is_finite());
        let size = |center: &DVec3| center.abs().max_element();
        let nearest = sound.min_by(|a, b| size(a).total_cmp(&size(b)));
        let nearest = nearest.unwrap_or_default();
        let mut kept = Vec::with_capacity(boxes.len());
        for (placement, &(min, max)) in placements.iter().zip(&boxes) {
            let reach = (min - nearest).abs().max((max - nearest).abs());
            let is_within = reach.max_element() <= LARGEST_DISTANCE && !reach.is_nan();
            let is_kept = is_within || !self.has_sound_box(placement);
            if !is_kept {
                tell(placement);
            }
            kept.push(is_kept);
        }
        let mut next = kept.iter();
        placements.retain(|_| next.next() == Some(&true));
        let mut next = kept.iter();
        boxes.retain(|_| next.next() == Some(&true));
        boxes.iter().fold(NO_BOUNDS, |all, (min, max)| {
            (all.0.min(*min), all.1.max(*max))
        })
    }

    /// True if control points and their number make a box.
    fn has_sound_box(&self, placement: &Placement) -> bool {
        let prim = self.occurrences[placement.occurrence].prim;
        let of_prim = self.of_prim.get(&prim);
        of_prim.is_some_and(|(min, max)| min.is_finite() && max.is_finite())
    }
}

/// Bounds of nothing.
const NO_BOUNDS: (DVec3, DVec3) = (DVec3::INFINITY, DVec3::NEG_INFINITY);

fn object_box(raw: &RawStage, prim: usize) -> (DVec3, DVec3) {
    let prim = &raw.prims[prim];
    let has_points = matches!(
        Kind::of(prim),
        Kind::Mesh | Kind::Curves | Kind::Patch | Kind::Points
    );
    if has_points {
        let bounds = Bounds3::around(vectors(prim, "points").iter().copied());
        return (bounds.min.as_dvec3(), bounds.max.as_dvec3());
    }
    match Solid::read(prim) {
        Some(solid) => (-solid.half_extent(), solid.half_extent()),
        None => (DVec3::INFINITY, DVec3::NEG_INFINITY),
    }
}

/// Longest image of a unit vector, up to √3 too short.
pub(super) fn greatest_scale(matrix: DMat4) -> f64 {
    let linear = DMat3::from_mat4(matrix);
    (linear.x_axis.length_squared()
        + linear.y_axis.length_squared()
        + linear.z_axis.length_squared())
    .sqrt()
        / 3.0_f64.sqrt()
}

/// True if `matrix` flattens space to a plane, a line or a point.
pub(super) fn is_singular(matrix: DMat4) -> bool {
    let linear = DMat3::from_mat4(matrix);
    let spanned = linear.x_axis.length() * linear.y_axis.length() * linear.z_axis.length();
    linear.determinant().abs() <= SINGULAR * spanned
}

/// Carry `mesh` through `matrix`, composed and applied in f64. The identity leaves every bit as it is.
pub(super) fn bake(mesh: &mut Mesh, matrix: DMat4) {
    if matrix == DMat4::IDENTITY {
        return;
    }
    for position in &mut mesh.positions {
        *position = matrix.transform_point3(position.as_dvec3()).as_vec3();
    }
    let linear = DMat3::from_mat4(matrix);
    // The cofactors are the inverse transpose times the determinant, whose sign keeps normals on their side.
    let sign = if linear.determinant() < 0.0 {
        -1.0
    } else {
        1.0
    };
    let cofactors = DMat3::from_cols(
        linear.y_axis.cross(linear.z_axis),
        linear.z_axis.cross(linear.x_axis),
        linear.x_axis.cross(linear.y_axis),
    );
    let turn = |normals: &mut [Vec3]| {
        for normal in normals {
            *normal = (sign * (cofactors * normal.as_dvec3()))
                .normalize_or_zero()
                .as_vec3();
        }
    };
    match &mut mesh.normals {
        Normals::Flat => {}
        Normals::Vertex(values) | Normals::Corner { values, .. } => turn(values),
    }
    if let Some(cage) = &mut mesh.cage {
        turn(&mut cage.point_normals);
        turn(&mut cage.corner_normals);
    }
    if sign < 0.0 {
        flip(mesh);
    }
}

/// Turn every triangle around, with everything that is listed by triangle corners.
fn flip(mesh: &mut Mesh) {
    let swap = |triangles: &mut [[u32; 3]]| triangles.iter_mut().for_each(|t| t.swap(1, 2));
    swap(&mut mesh.triangles);
    if let Normals::Corner { corners, .. } = &mut mesh.normals {
        swap(corners);
    }
    for primvar in &mut mesh.primvars {
        if let Interpolation::Corner(corners) = &mut primvar.interpolation {
            swap(corners);
        }
    }
}
