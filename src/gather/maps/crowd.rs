//! Receivers in the order and shape in which maps are looked at: sorted along the Morton curve, so that neighbors look
//! at neighboring pixels, sixteen to a block, each quantity in a row.

use super::plan::MapsPlan;
use super::raster;
use crate::math::bits::morton;
use crate::receivers::Receivers;
use crate::scene::Scene;
use glam::{Affine3A, Vec3};
use rayon::prelude::*;

/// Receivers in a block.
pub(super) const LANES: usize = 16;

/// One value a receiver of a block.
pub(super) type Lanes = [f32; LANES];

/// Where sixteen receivers are, relative to the plan's center, and what they are. Lanes without a receiver have a zero
/// normal, which weighs nothing.
#[derive(Debug, Clone)]
pub(super) struct Block {
    pub(super) position: [Lanes; 3],
    pub(super) normal: [Lanes; 3],
    /// Tag of the receiver's own surface where it faces the axis.
    pub(super) tag: [u32; LANES],
}

/// What sixteen receivers have seen so far.
#[derive(Debug, Clone)]
pub(super) struct Sums {
    /// Cosines of the directions looked along.
    pub(super) weight: Lanes,
    /// Cosines of the open ones.
    pub(super) open: Lanes,
    /// Cosines of those whose verdict hangs on the bias.
    pub(super) uncertain: Lanes,
    /// Sums over the open directions of what was asked for.
    pub(super) channels: Vec<Lanes>,
    /// Rows of [`super::sky`].
    pub(super) sky: Vec<Lanes>,
}

impl Sums {
    fn zero((channels, sky): (usize, usize)) -> Self {
        let zero = [0.0; LANES];
        Self {
            weight: zero,
            open: zero,
            uncertain: zero,
            channels: vec![zero; channels],
            sky: vec![zero; sky],
        }
    }
}

/// All receivers.
#[derive(Debug)]
pub(super) struct Crowd {
    pub(super) blocks: Vec<Block>,
    pub(super) sums: Vec<Sums>,
    /// Receivers' indices in the order of the lanes.
    pub(super) order: Vec<u32>,
}

impl Crowd {
    /// `rows`: how many sums over open directions each receiver keeps, and how many of the sky.
    pub(super) fn new(plan: &MapsPlan<'_>, receivers: &Receivers, rows: (usize, usize)) -> Self {
        let order = morton_order(plan, receivers);
        // In the receivers' order, which is that of their triangles.
        let tags: Vec<u32> = (0..receivers.len())
            .into_par_iter()
            .map(|i| raster::tag(receivers.prim[i], is_on_front(plan.scene, receivers, i)))
            .collect();
        let blocks: Vec<Block> = order
            .par_chunks(LANES)
            .map(|lanes| block(plan, (receivers, &tags), lanes))
            .collect();
        Self {
            sums: vec![Sums::zero(rows); blocks.len()],
            blocks,
            order,
        }
    }

    /// One value a receiver, in the receivers' order; `read` is given a block's sums and the lane.
    pub(super) fn values<T: Clone + Send + Default>(
        &self,
        read: impl Fn(&Sums, usize) -> T + Sync,
    ) -> Vec<T> {
        let mut values = vec![T::default(); self.order.len()];
        for (place, &receiver) in self.order.iter().enumerate() {
            values[receiver as usize] = read(&self.sums[place / LANES], place % LANES);
        }
        values
    }
}

/// Cells of the Morton curve along one axis.
const CELLS: f32 = 1024.0;

#[expect(
    clippy::cast_possible_truncation,
    reason = "there are less than 2³² receivers"
)]
fn morton_order(plan: &MapsPlan<'_>, receivers: &Receivers) -> Vec<u32> {
    let corner = plan.center - plan.radius;
    let scale = CELLS / (2.0 * plan.radius).max(f32::MIN_POSITIVE);
    let keys: Vec<u64> = (receivers.position.par_iter())
        .enumerate()
        .map(|(i, &position)| {
            let cell = (position - corner) * scale;
            morton(cell.min(Vec3::splat(CELLS - 1.0))) << 32 | i as u64
        })
        .collect();
    sorted(keys).iter().map(|&key| key as u32).collect()
}

/// Bits of a key that one pass sorts by.
const DIGIT: u32 = 10;

/// By the upper half of the keys, where equal in their order: a pass a digit, from the lowest.
fn sorted(mut keys: Vec<u64>) -> Vec<u64> {
    let mut other = vec![0; keys.len()];
    for digit in [32, 32 + DIGIT, 32 + 2 * DIGIT] {
        let bucket = |key: u64| (key >> digit & ((1 << DIGIT) - 1)) as usize;
        let mut starts = [0_usize; 1 << DIGIT];
        keys.iter().for_each(|&key| starts[bucket(key)] += 1);
        let mut next = 0;
        for start in &mut starts {
            next += std::mem::replace(start, next);
        }
        for &key in &keys {
            let place = &mut starts[bucket(key)];
            other[*place] = key;
            *place += 1;
        }
        std::mem::swap(&mut keys, &mut other);
    }
    keys
}

fn block(plan: &MapsPlan<'_>, (receivers, tags): (&Receivers, &[u32]), lanes: &[u32]) -> Block {
    let zero = [0.0; LANES];
    let mut block = Block {
        position: [zero; 3],
        normal: [zero; 3],
        tag: [u32::MAX; LANES],
    };
    for (lane, &receiver) in lanes.iter().enumerate() {
        let i = receiver as usize;
        let position = receivers.position[i] - plan.center;
        let normal = receivers.normal[i];
        for axis in 0..3 {
            block.position[axis][lane] = position[axis];
            block.normal[axis][lane] = normal[axis];
        }
        block.tag[lane] = tags[i];
    }
    block
}

/// True if the receiver is lit on the front side of its prim. Where its triangle is degenerate: yes.
fn is_on_front(scene: &Scene, receivers: &Receivers, i: usize) -> bool {
    let Some(prim) = scene.prims.get(receivers.prim[i] as usize) else {
        return true;
    };
    let mesh = scene.mesh_of(prim);
    let Some(&t) = mesh.triangles.get(receivers.surface[i].triangle as usize) else {
        return true;
    };
    let corners = t.map(|k| mesh.positions[k as usize]);
    let [a, b, c] = if prim.world_from_object == Affine3A::IDENTITY {
        corners
    } else {
        corners.map(|p| prim.world_from_object.transform_point3(p))
    };
    let flips = prim.world_from_object.matrix3.determinant() < 0.0;
    let front: Vec3 = (b - a).cross(c - a) * if flips { -1.0 } else { 1.0 };
    front.dot(receivers.geometric_normal[i]) >= 0.0
}
