//! Cells of the triangles of a mesh: large triangles are cut into several, several small ones make one.
//!
//! A cell is a part of a triangle, a whole triangle, or a cluster of triangles. Cells within triangles come first,
//! triangle by triangle, then the clusters. All of it is in terms of triangle numbers and barycentric coordinates, so
//! a table fits every instance of the mesh, whatever its transform; cells have the asked size in those that are
//! placed like the one it was made for, but for rotation.

use super::clusters::{Clusterer, Clusters, is_small};
use super::triangle_dice::{Dicing, Part, TriangleDice};
use glam::Vec3;

/// Marks an entry of [`Cells::Mixed`] that points into `diced`.
const DICED: u32 = 1 << 31;
/// Entry of a triangle without area.
const NOTHING: u32 = u32::MAX;

#[derive(Debug)]
enum Cells {
    /// Every triangle is one cell.
    OnePerTriangle,
    /// 4 bytes a triangle: the number of its only cell, [`DICED`] + an index into `diced`, or [`NOTHING`].
    Mixed {
        triangles: Box<[u32]>,
        diced: Box<[TriangleDice]>,
        /// Numbers of the first cells of the rows of all of `diced`, so that a cell is found without a search.
        row_starts: Box<[u32]>,
    },
}

/// How the triangles of a mesh are diced.
#[derive(Debug)]
pub struct DiceTable {
    triangle_count: u32,
    /// Cells that are no clusters.
    within_count: u32,
    cells: Cells,
    clusters: Clusters,
}

impl DiceTable {
    /// Dice `triangles` (the points at their corners) at `spacing`; `place` gives the world position of a point.
    /// Fewer than 2³¹ cells: the caller chooses the spacing accordingly.
    ///
    /// # Panics
    /// With more than 2³² triangles or cells.
    pub fn new(triangles: &[[u32; 3]], place: impl Fn(u32) -> Vec3, spacing: f32) -> Self {
        let clusters = cluster(triangles, &place, spacing);
        let triangle_count =
            u32::try_from(triangles.len()).expect("triangles are numbered with 32 bits");
        let mut entries = vec![NOTHING; triangles.len()];
        for cluster in 0..clusters.len() {
            for t in clusters.members(cluster) {
                entries[*t as usize] = cluster;
            }
        }
        let (mut diced, mut row_starts) = (Vec::new(), Vec::new());
        let (mut next, mut diced_count) = (0, 0_u32);
        for (entry, points) in entries.iter_mut().zip(triangles) {
            if *entry != NOTHING {
                continue;
            }
            let dicing = Dicing::new(points.map(&place), spacing);
            *entry = match dicing {
                Dicing::Nothing => NOTHING,
                Dicing::Whole => next,
                Dicing::Cells(dice) => {
                    diced.push(dice.placed(next, &mut row_starts));
                    diced_count += 1;
                    DICED | (diced_count - 1)
                }
            };
            next += dicing.cell_count();
        }
        for cluster in 0..clusters.len() {
            for t in clusters.members(cluster) {
                entries[*t as usize] = next + cluster;
            }
        }
        let plain = diced.is_empty() && next == triangle_count;
        Self {
            triangle_count,
            within_count: next,
            cells: if plain {
                Cells::OnePerTriangle
            } else {
                Cells::Mixed {
                    triangles: entries.into(),
                    diced: diced.into(),
                    row_starts: row_starts.into(),
                }
            },
            clusters,
        }
    }

    /// Number of cells.
    pub fn cell_count(&self) -> u32 {
        self.within_count + self.clusters.len()
    }

    /// Number of cells that lie within triangles; those from here on are clusters.
    pub fn within_count(&self) -> u32 {
        self.within_count
    }

    /// Number of triangles.
    pub fn triangle_count(&self) -> u32 {
        self.triangle_count
    }

    /// Triangles of cell `cell`, a cluster (not below [`Self::within_count`]): two or more, ascending.
    pub fn members(&self, cell: u32) -> &[u32] {
        self.clusters.members(cell - self.within_count)
    }

    /// Number of the first cell within triangle `t`, and its parts in cell order: none without area or in a cluster.
    pub fn parts(&self, t: u32) -> (u32, impl Iterator<Item = Part> + use<>) {
        let entry = match &self.cells {
            Cells::OnePerTriangle => t,
            Cells::Mixed { triangles, .. } => triangles[t as usize],
        };
        let (first, whole, dice) = match &self.cells {
            Cells::Mixed { .. } if entry == NOTHING => (0, None, None),
            Cells::Mixed { diced, .. } if entry & DICED != 0 => {
                let dice = diced[(entry ^ DICED) as usize];
                (dice.first(), None, Some(dice))
            }
            _ if entry >= self.within_count => (0, None, None),
            _ => (entry, Some(Part::WHOLE), None),
        };
        let parts = whole
            .into_iter()
            .chain(dice.into_iter().flat_map(|dice| dice.parts()));
        (first, parts)
    }

    /// True if triangle `t` is not cut: it is one cell, in a cluster, or has no area.
    pub fn is_whole(&self, t: u32) -> bool {
        match &self.cells {
            Cells::OnePerTriangle => true,
            Cells::Mixed { triangles, .. } => {
                let entry = triangles[t as usize];
                entry == NOTHING || entry & DICED == 0
            }
        }
    }

    /// Number of the cell at barycentric `(u, v)` of triangle `t`.
    pub fn cell_at(&self, t: u32, u: f32, v: f32) -> Option<u32> {
        match &self.cells {
            Cells::OnePerTriangle => Some(t),
            Cells::Mixed {
                triangles,
                diced,
                row_starts,
            } => match triangles[t as usize] {
                NOTHING => None,
                entry if entry & DICED != 0 => {
                    let dice = &diced[(entry ^ DICED) as usize];
                    Some(dice.cell_at(Vec3::new(1.0 - u - v, u, v), row_starts))
                }
                cell => Some(cell),
            },
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let cells = match &self.cells {
            Cells::OnePerTriangle => 0,
            Cells::Mixed {
                triangles,
                diced,
                row_starts,
            } => size_of_val(&**triangles) + size_of_val(&**diced) + size_of_val(&**row_starts),
        };
        size_of::<Self>() + cells + self.clusters.bytes()
    }
}

/// Group the small ones of `triangles`.
fn cluster(triangles: &[[u32; 3]], place: &impl Fn(u32) -> Vec3, spacing: f32) -> Clusters {
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let mut any = false;
    for points in triangles {
        let corners = points.map(place);
        for p in corners {
            (low, high) = (low.min(p), high.max(p));
        }
        any |= is_small(corners, spacing);
    }
    if !any {
        return Clusters::default();
    }
    let mut clusterer = Clusterer::new(low.midpoint(high), spacing);
    for (t, points) in (0..).zip(triangles) {
        let corners = points.map(place);
        if is_small(corners, spacing) && Dicing::new(corners, spacing) == Dicing::Whole {
            clusterer.add(t, corners);
        }
    }
    clusterer.finish(|t| triangles[t as usize])
}
