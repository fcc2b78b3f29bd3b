//! Who stands where surfaces meet at an angle, or at the open border of another prim.
//!
//! A pixel there may lie beside what it should show, and what it shows may be as near as the receiver's own patch: whoever
//! looks into it sees past the border, or through the other side of the corner. At the top edges of the walls of a Cornell
//! box, whose ceiling has a hole and so is drawn, a quarter of the hemisphere that is covered seemed open; in a room that is
//! one mesh, bright lines along all its corners were 9 % error.

use super::MapsPlan;
use super::plan::Occluder;
use crate::scene::Mesh;
use glam::{IVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// Width of a cell in pixels, and how much wider it is for each pixel of bias, below which corners are not seen. Receivers
/// look into the eight cells around the corner of cells that is nearest to them: they find all that is nearer than half a
/// cell.
const CELL: f32 = 1.0;
const CELL_OF_BIAS: f32 = 3.0;

/// Cosine between the normals of the sides of a corner that maps do not see.
const FOLDED: f32 = 0.7;

/// The same between a face and the mean of those around its corner, where there may be one.
const SHARP: f32 = 0.95;

/// Its square where edges of the face may rise over the horizon of the mean by more than sin² = 1 − this.
const FLAT: f32 = 1.0 - super::handover::CREASED;

/// Bits of the filter a sample, at least: few receivers look further.
const FILTER_BITS: usize = 16;

/// Borders of more than one prim, or a corner.
const MANY: u32 = u32::MAX;

/// The borders and corners of all prims that are drawn at one width of pixels.
#[derive(Debug)]
struct Grid {
    cells_a_unit: f32,
    /// Bits of the hashes of `owners`.
    filter: Vec<u64>,
    /// Who is not met in a cell: the prim whose border it is, or nobody, [`MANY`].
    owners: HashMap<IVec3, u32>,
}

/// The borders and corners of all prims that are drawn into maps.
#[derive(Debug)]
pub(super) struct Borders {
    grids: Vec<Grid>,
    center: Vec3,
}

impl Borders {
    /// `pixels`: width of those that each prim is drawn at, stage units; `bias` in pixels.
    pub(super) fn new(plan: &MapsPlan<'_>, pixels: &[f32], bias: f32) -> Self {
        let grid = |class: &super::plan::Class| {
            let first = class.occluders.first()?;
            let pixel = pixels[first.prim.index()];
            Grid::new(plan, &class.occluders, (CELL + CELL_OF_BIAS * bias) * pixel)
        };
        for occluder in plan.classes.iter().flat_map(|class| &class.occluders) {
            plan.edges(occluder);
        }
        Self {
            grids: plan.classes.par_iter().filter_map(grid).collect(),
            center: plan.center,
        }
    }

    /// True if a receiver on prim `prim` stands at a corner, or at the border of another.
    pub(super) fn are_met(&self, position: Vec3, prim: u32) -> bool {
        let place = position - self.center;
        self.grids.iter().any(|grid| grid.is_met(place, prim))
    }
}

impl Grid {
    /// `None` if nothing is drawn that has any.
    fn new(plan: &MapsPlan<'_>, occluders: &[Occluder], cell: f32) -> Option<Self> {
        let mut grid = Self {
            cells_a_unit: cell.recip(),
            filter: Vec::new(),
            owners: HashMap::new(),
        };
        for occluder in occluders {
            let mesh = plan.mesh(occluder);
            let place = |i: u32| {
                let position = mesh.positions[i as usize].as_dvec3();
                let local = occluder.local_from_object.transform_point3(position);
                local.as_vec3() * grid.cells_a_unit
            };
            let edges = plan.edges(occluder);
            let open = edges.open.iter().map(|edge| (edge, occluder.prim.0));
            let folded = edges.folded.iter().map(|edge| (edge, MANY));
            for (edge, owner) in open.chain(folded) {
                let [from, to] = edge.map(place);
                mark(&mut grid.owners, (from, to), owner);
            }
        }
        if grid.owners.is_empty() {
            return None;
        }
        let bits = (FILTER_BITS * grid.owners.len()).next_power_of_two();
        grid.filter = vec![0; bits.div_ceil(64)];
        for &cell in grid.owners.keys() {
            let bit = hash(cell) & (bits - 1);
            grid.filter[bit / 64] |= 1 << (bit % 64);
        }
        Some(grid)
    }

    fn is_met(&self, place: Vec3, prim: u32) -> bool {
        let corner = (place * self.cells_a_unit).round().as_ivec3();
        let bits = 64 * self.filter.len();
        (0..8).any(|k| {
            let cell = corner - IVec3::new(k & 1, k >> 1 & 1, k >> 2);
            let bit = hash(cell) & (bits - 1);
            let may_be = self.filter[bit / 64] >> (bit % 64) & 1 == 1;
            may_be && self.owners.get(&cell).is_some_and(|&owner| owner != prim)
        })
    }
}

/// Mark the cells along an edge, in units of these: samples are at most half a cell apart.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "maps have at most a few thousand pixels along an edge"
)]
fn mark(owners: &mut HashMap<IVec3, u32>, (from, to): (Vec3, Vec3), owner: u32) {
    let steps = (2.0 * from.distance(to)).ceil().max(1.0) as u32;
    for step in 0..=steps {
        let place = from.lerp(to, step as f32 / steps as f32);
        let known = owners.entry(place.floor().as_ivec3()).or_insert(owner);
        if *known != owner {
            *known = MANY;
        }
    }
}

fn hash(cell: IVec3) -> usize {
    let mixed = |x: i32, factor: u64| (i64::from(x).cast_unsigned()).wrapping_mul(factor);
    let sum = mixed(cell.x, 0x9e37_79b9_7f4a_7c15)
        ^ mixed(cell.y, 0xc2b2_ae3d_27d4_eb4f)
        ^ mixed(cell.z, 0x1656_67b1_9e37_79f9);
    (sum >> 32) as usize
}

/// Edges of a mesh that maps are blind at: ends of each.
#[derive(Debug, Default)]
pub(super) struct Edges {
    /// One triangle uses them, and no other has an edge there.
    pub(super) open: Vec<[u32; 2]>,
    /// The triangles at both sides are folded towards each other.
    pub(super) folded: Vec<[u32; 2]>,
}

/// An edge as a triangle uses it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Use {
    /// Smaller index first.
    ends: [u32; 2],
    triangle: u32,
}

impl Edges {
    /// Those of `mesh`, around whose positions faces make these `turns`.
    pub(super) fn of(mesh: &Mesh, turns: &[Turn]) -> Self {
        let mut edges = Self::default();
        let is_sharp = |i: u32| turns[i as usize] == Turn::Sharp;
        let sharp = uses(mesh, |[a, b]| is_sharp(a) && is_sharp(b));
        for of_edge in sharp.chunk_by(|a, b| a.ends == b.ends) {
            if are_folded(mesh, of_edge) {
                edges.folded.push(of_edge[0].ends);
            }
        }
        if !mesh.closed {
            edges.add_open(mesh);
        }
        edges
    }

    /// Edges that one triangle uses; where another has one at the same place, a seam, they are no border, but may be folded.
    fn add_open(&mut self, mesh: &Mesh) {
        let known = mesh.cage.as_ref().map(|cage| cage.on_boundary.as_slice());
        // Of refined meshes the points of the cage tell nothing.
        let known = known.filter(|points| points.len() == mesh.positions.len());
        let may_be = |[a, b]: [u32; 2]| {
            known.is_none_or(|is_open| is_open[a as usize] && is_open[b as usize])
        };
        let all = uses(mesh, may_be);
        let once = all.chunk_by(|a, b| a.ends == b.ends);
        let once = once.filter(|uses| uses.len() == 1).map(|uses| uses[0]);
        let key = |one: Use| {
            let ends = one.ends.map(|i| mesh.positions[i as usize].to_array());
            let mut ends = ends.map(|place| place.map(f32::to_bits));
            ends.sort_unstable();
            (ends, one)
        };
        let mut by_place: Vec<_> = once.map(key).collect();
        by_place.par_sort_unstable();
        for at_place in by_place.chunk_by(|a, b| a.0 == b.0) {
            let uses: Vec<Use> = at_place.iter().map(|&(_, one)| one).collect();
            match uses[..] {
                [one] => self.open.push(one.ends),
                _ if are_folded(mesh, &uses) => self.folded.push(uses[0].ends),
                _ => {}
            }
        }
    }
}

/// Edges of `mesh` for which `is_asked`, as triangles use them, those of one edge side by side.
fn uses(mesh: &Mesh, is_asked: impl Fn([u32; 2]) -> bool + Sync) -> Vec<Use> {
    let mut all = of_triangles(mesh, |triangle, t, found| {
        for [a, b] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
            let ends = [a.min(b), a.max(b)];
            if is_asked(ends) {
                found.push(Use { ends, triangle });
            }
        }
    });
    all.par_sort_unstable();
    all
}

/// How far faces around a position are turned away from their mean normal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub(super) enum Turn {
    /// So little that they cover less of the hemisphere about it than [`super::handover::CREASED`].
    #[default]
    Flat,
    /// More than that.
    Bent,
    /// So far that two of them may be folded.
    Sharp,
}

/// For every position of `mesh`, whose area-weighted normals are `normals`.
pub(super) fn turns(mesh: &Mesh, normals: &[Vec3]) -> Vec<Turn> {
    let found = of_triangles(mesh, |_, t, found| {
        let face = normal_of(mesh, t);
        for &i in t {
            let (mean, along) = (normals[i as usize], face.dot(normals[i as usize]));
            let lengths = face.length_squared() * mean.length_squared();
            let along = along.max(0.0).powi(2);
            if along < FLAT * lengths {
                let is_sharp = along < SHARP * SHARP * lengths;
                found.push((i, if is_sharp { Turn::Sharp } else { Turn::Bent }));
            }
        }
    });
    let mut turns = vec![Turn::Flat; mesh.positions.len()];
    for (i, turn) in found {
        turns[i as usize] = turns[i as usize].max(turn);
    }
    turns
}

/// What `find` pushes for each triangle, its number and corners, in their order.
fn of_triangles<T: Send>(mesh: &Mesh, find: impl Fn(u32, &[u32; 3], &mut Vec<T>) + Sync) -> Vec<T> {
    let count = u32::try_from(mesh.triangles.len()).unwrap_or(u32::MAX);
    let numbers = (0..count).into_par_iter().zip(&mesh.triangles);
    numbers
        .with_min_len(1 << 12)
        .fold(Vec::new, |mut found, (number, t)| {
            find(number, t, &mut found);
            found
        })
        .collect_vec_list()
        .into_iter()
        .flatten()
        .flatten()
        .collect()
}

/// Twice its area long.
fn normal_of(mesh: &Mesh, t: &[u32; 3]) -> Vec3 {
    let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
    (b - a).cross(c - a)
}

/// True if a triangle of `uses` of one edge rises steeply before another (on either side, of a mesh that is seen from both).
fn are_folded(mesh: &Mesh, uses: &[Use]) -> bool {
    let triangle = |one: &Use| &mesh.triangles[one.triangle as usize];
    let rises = |one: &Use, other: &Use| {
        let (own, there) = (triangle(one), triangle(other));
        let own_normal = normal_of(mesh, own);
        let normals = (own_normal, normal_of(mesh, there));
        let along = normals
            .0
            .normalize_or_zero()
            .dot(normals.1.normalize_or_zero());
        let start = mesh.positions[one.ends[0] as usize];
        let height = |&i: &u32| own_normal.dot(mesh.positions[i as usize] - start);
        let highest = there.iter().map(height).fold(0.0, f32::max);
        along < FOLDED && (highest > 0.0 || mesh.double_sided)
    };
    let pairs = uses.iter().enumerate();
    pairs
        .flat_map(|(i, one)| uses[i + 1..].iter().map(move |other| (one, other)))
        .any(|(one, other)| rises(one, other))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::maps::MapsSettings;
    use crate::gather::testing::receivers_at;
    use crate::trace::testing::{mesh, scene};
    use glam::Affine3A;

    /// A square of 2 × 2 about (0, 0, `height`) without its quarter at the end of both axes: not convex.
    fn ceiling(height: f32) -> Mesh {
        let at = |x: f32, y: f32| Vec3::new(x, y, height);
        let quarter = |x: f32, y: f32| {
            let (a, b) = (at(x, y), at(x + 1.0, y + 1.0));
            let (c, d) = (at(x + 1.0, y), at(x, y + 1.0));
            [[a, c, b], [a, b, d]]
        };
        let parts = [quarter(-1.0, -1.0), quarter(0.0, -1.0), quarter(-1.0, 0.0)];
        mesh(&parts.concat())
    }

    fn wall() -> Mesh {
        let [a, b] = [-1.0, 1.0].map(|y| Vec3::new(-1.0, y, -1.0));
        let up = 2.0 * Vec3::Z;
        mesh(&[[a, b, b + up], [a, b + up, a + up]])
    }

    #[test]
    fn the_top_of_a_wall_meets_the_border_of_a_ceiling_and_what_is_below_does_not() {
        let scene = scene(
            vec![wall(), ceiling(1.0)],
            &[(0, Affine3A::IDENTITY), (1, Affine3A::IDENTITY)],
        );
        let plan = MapsPlan::new(&scene);
        assert_eq!(plan.flats.len(), 1, "the wall is flat, the ceiling drawn");
        let pixel = 0.02;
        let borders = Borders::new(&plan, &[0.0, pixel], 0.5);
        for y in [-0.93_f32, -0.4, 0.0, 0.71] {
            let at = |below: f32| Vec3::new(-1.0, y, 1.0 - below * pixel);
            for below in [0.0, 0.6, 1.2] {
                assert!(borders.are_met(at(below), 0), "{y} {below}");
            }
            for below in [4.5, 9.0] {
                assert!(!borders.are_met(at(below), 0), "{y} {below}");
            }
            assert!(!borders.are_met(at(0.0), 1), "its own border");
        }
        let receivers = receivers_at(&[
            (Vec3::new(-1.0, 0.3, 1.0), Vec3::X),
            (Vec3::new(-1.0, 0.3, 0.5), Vec3::X),
            // On something at the foot of the wall.
            (Vec3::new(-1.0, 0.3, -1.0), Vec3::Z),
        ]);
        let seen = crate::gather::maps::visibility(
            &plan,
            &receivers,
            &MapsSettings::default(),
            &crate::gather::maps::Wanted::default(),
            &crate::diagnostics::Diagnostics::default(),
        );
        assert_eq!(seen.expect("nobody cancels").ambiguous, [true, false, true]);
    }

    /// A floor and a wall at its edge x = 0, `rise` high, which share points or have their own.
    fn corner(rise: f32, is_welded: bool) -> Mesh {
        let [a, b, c, d] = [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y];
        let up = Vec3::new(-0.1, 0.0, rise);
        let mut mesh = mesh(&[[a, b, c], [a, c, d], [d, d + up, a + up], [d, a + up, a]]);
        if is_welded {
            let first_at = |p: Vec3| mesh.positions.iter().position(|&q| q == p);
            let first = |i: u32| {
                let place = first_at(mesh.positions[i as usize]);
                place.and_then(|k| u32::try_from(k).ok()).unwrap_or(i)
            };
            mesh.triangles = mesh.triangles.iter().map(|t| t.map(first)).collect();
        }
        mesh.double_sided = false;
        mesh
    }

    fn places(mesh: &Mesh, edges: &[[u32; 2]]) -> Vec<[Vec3; 2]> {
        let place = |edge: &[u32; 2]| edge.map(|i| mesh.positions[i as usize]);
        edges.iter().map(place).collect()
    }

    #[test]
    fn corners_are_folded_and_rims_are_open_whether_points_are_shared_or_not() {
        for is_welded in [true, false] {
            let mesh = corner(1.0, is_welded);
            let edges = Edges::of(
                &mesh,
                &turns(&mesh, &crate::gather::maps::plan::normals(&mesh)),
            );
            let folded = places(&mesh, &edges.folded);
            assert_eq!(folded.len(), 1, "{is_welded}");
            assert!(folded[0].contains(&Vec3::ZERO) && folded[0].contains(&Vec3::Y));
            assert_eq!(edges.open.len(), 6, "{is_welded}");
            // Nearly flat, or bent away: nothing rises before anybody.
            for rise in [0.01, -1.0] {
                let mesh = corner(rise, is_welded);
                let edges = Edges::of(
                    &mesh,
                    &turns(&mesh, &crate::gather::maps::plan::normals(&mesh)),
                );
                assert!(edges.folded.is_empty(), "{is_welded} {rise}");
                assert_eq!(edges.open.len(), 6, "{is_welded} {rise}");
            }
        }
    }
}
