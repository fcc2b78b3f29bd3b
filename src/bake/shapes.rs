//! Which prims can share one dice table: instances of one mesh placed alike but for rotation, reflection and place.

use crate::scene::{MeshId, PlacedMesh, Prim, PrimId, Scene};
use crate::surfels::{DiceTable, PrimDice, Sides};
use glam::{Affine3A, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;

/// Prims share a table when their sizes fall into the same quarter of an octave: cells are then at most 19 % off the
/// asked spacing, and a forest of trees of all sizes has a handful of tables a mesh.
const SIZES_PER_OCTAVE: f32 = 4.0;

/// Steps in which proportions (scaling along axes, shear) are compared: cells are a few percent out of shape at most.
const PROPORTION_STEPS: f32 = 32.0;

/// A mesh and, rounded, what its transform does to lengths.
type Shape = (MeshId, i32, [i32; 6]);

/// The distinct shapes among the prims of a scene.
pub(super) struct Shapes<'a> {
    scene: &'a Scene,
    sides: &'a [Sides],
    /// Number of each prim's shape.
    of_prims: Vec<usize>,
    /// The first prim of each shape: its table is made for this one.
    first: Vec<PrimId>,
}

impl<'a> Shapes<'a> {
    pub(super) fn new(scene: &'a Scene, sides: &'a [Sides]) -> Self {
        let mut numbers = HashMap::new();
        let mut first = Vec::new();
        let mut number = |(id, prim): (u32, &Prim)| {
            *numbers.entry(shape_of(prim)).or_insert_with(|| {
                first.push(PrimId(id));
                first.len() - 1
            })
        };
        Self {
            of_prims: (0..).zip(&scene.prims).map(&mut number).collect(),
            first,
            scene,
            sides,
        }
    }

    /// Dice all prims at `spacing`.
    pub(super) fn dice(&self, spacing: f32) -> Vec<PrimDice> {
        let table = |prim: &PrimId| {
            let world = PlacedMesh::of(self.scene, *prim);
            let place = |point: u32| world.point(world.mesh.positions[point as usize]);
            Arc::new(DiceTable::new(&world.mesh.triangles, place, spacing))
        };
        let tables: Vec<_> = self.first.par_iter().map(table).collect();
        let prims = self.of_prims.iter().zip(self.sides);
        prims
            .map(|(shape, sides)| PrimDice::new(Arc::clone(&tables[*shape]), *sides))
            .collect()
    }
}

/// Number of surfels of all prims together.
pub(super) fn count(prims: &[PrimDice]) -> u64 {
    let of_prim =
        |prim: &PrimDice| u64::from(prim.table().cell_count()) * u64::from(prim.sides().count());
    prims.iter().map(of_prim).sum()
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "logarithms and proportions are small, those of zero saturate"
)]
fn shape_of(prim: &Prim) -> Shape {
    let (size, proportions) = size_and_proportions(&prim.world_from_object);
    (
        prim.mesh,
        (SIZES_PER_OCTAVE * size.log2()).round() as i32,
        proportions.map(|x| (PROPORTION_STEPS * x).round() as i32),
    )
}

/// Root mean square scale of lengths, and the scalar products of the transformed axes over the sum of their squares:
/// what a transform does to lengths and angles, whatever it rotates.
fn size_and_proportions(transform: &Affine3A) -> (f32, [f32; 6]) {
    let matrix = transform.matrix3;
    let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(Vec3::from);
    let sum = x.length_squared() + y.length_squared() + z.length_squared();
    let products = [x.dot(x), y.dot(y), z.dot(z), x.dot(y), y.dot(z), z.dot(x)];
    (
        (sum / 3.0).sqrt(),
        products.map(|product| product / sum.max(f32::MIN_POSITIVE)),
    )
}
