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

/// Absolute world bounds of all placements, around transformed boxes of control points; `min > max` when empty.
pub(super) fn bounds(
    raw: &RawStage,
    occurrences: &[Occurrence],
    placements: &[Placement],
) -> (DVec3, DVec3) {
    let mut boxes: HashMap<usize, (DVec3, DVec3)> = HashMap::new();
    let mut all = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for placement in placements {
        let prim = occurrences[placement.occurrence].prim;
        let (min, max) = *boxes.entry(prim).or_insert_with(|| object_box(raw, prim));
        if min.cmpgt(max).any() {
            continue;
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
            all = (all.0.min(point), all.1.max(point));
        }
    }
    all
}

fn object_box(raw: &RawStage, prim: usize) -> (DVec3, DVec3) {
    let prim = &raw.prims[prim];
    if Kind::of(prim) == Kind::Mesh {
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
