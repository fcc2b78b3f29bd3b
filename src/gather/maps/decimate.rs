//! A mesh with fewer triangles that covers the same, for occluders seen through pixels of its size: vertices in the
//! same cell of a grid become one at their mean. Rossignac, Borrel, *Multi-resolution 3D approximations* (1993).
//!
//! Vertices of one cell whose normals lie in different octants stay apart, so that both sides of a thin part survive.

use super::shell::Shell;
use crate::scene::Mesh;
use glam::Vec3;

/// Cells along one axis that a key tells apart.
const MOST_CELLS: f32 = (1_u32 << 20) as f32;

/// `mesh` with one vertex a cell of size `cell`, object units, and normal octant. The same bits on every run.
/// `normals`: one a position, of any length.
pub(super) fn decimate(mesh: &Mesh, normals: &[Vec3], cell: f32) -> Shell<'static> {
    let bounds = mesh.bounds();
    let size = (bounds.max - bounds.min).max_element();
    let cells_per_unit = 1.0 / cell.max(size / (MOST_CELLS - 1.0));
    let mut clusters = Clusters::new();
    let cluster_of: Vec<u32> = mesh
        .positions
        .iter()
        .zip(normals)
        .map(|(&position, &normal)| {
            let key = key((position - bounds.min) * cells_per_unit, normal);
            clusters.add(key, position - bounds.min)
        })
        .collect();
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| cluster_of[i as usize]);
        if a != b && b != c && c != a {
            triangles.push([a, b, c]);
        }
    }
    Shell::new(clusters.means(bounds.min), triangles, bounds.center())
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "rounded down on purpose; cells are 0 to 2²⁰"
)]
fn key(cell: Vec3, normal: Vec3) -> u64 {
    let [x, y, z] = cell.to_array().map(|c| c as u64);
    let [i, j, k] = normal.to_array().map(|n| u64::from(n < 0.0));
    ((((x << 20 | y) << 20 | z) << 1 | i) << 1 | j) << 1 | k
}

/// Sums by key, numbered in order of first appearance.
struct Clusters {
    /// Open addressing: number of the cluster + 1, 0 = free.
    table: Vec<u32>,
    keys: Vec<u64>,
    sums: Vec<(Vec3, f32)>,
}

/// Slots of an empty table.
const FIRST_SLOTS: usize = 1 << 10;

impl Clusters {
    fn new() -> Self {
        Self {
            table: vec![0; FIRST_SLOTS],
            keys: Vec::new(),
            sums: Vec::new(),
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "a mesh has less than 2³² positions"
    )]
    fn add(&mut self, key: u64, position: Vec3) -> u32 {
        let slot = self.slot(key);
        let number = self.table[slot];
        if number != 0 {
            let (sum, count) = &mut self.sums[number as usize - 1];
            *sum += position;
            *count += 1.0;
            return number - 1;
        }
        self.keys.push(key);
        self.sums.push((position, 1.0));
        let number = self.keys.len() as u32;
        self.table[slot] = number;
        if 2 * self.keys.len() > self.table.len() {
            self.grow();
        }
        number - 1
    }

    /// Where `key` is, or where it belongs.
    fn slot(&self, key: u64) -> usize {
        let mask = self.table.len() - 1;
        let mut slot = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32) as usize & mask;
        loop {
            match self.table[slot] {
                0 => return slot,
                number if self.keys[number as usize - 1] == key => return slot,
                _ => slot = (slot + 1) & mask,
            }
        }
    }

    fn grow(&mut self) {
        self.table = vec![0; 2 * self.table.len()];
        for (number, &key) in (1..).zip(&self.keys) {
            let slot = self.slot(key);
            self.table[slot] = number;
        }
    }

    fn means(&self, origin: Vec3) -> Vec<Vec3> {
        let mean = |&(sum, count): &(Vec3, f32)| origin + sum / count;
        self.sums.iter().map(mean).collect()
    }
}
