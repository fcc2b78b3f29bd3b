//! Groups of triangles smaller than a cell, each of which becomes one surfel.
//!
//! Normals fall into 26 classes around the axes, face diagonals and space diagonals of a cube, so narrow that a
//! one-sided disk can stand for any of them. Within a class, triangles whose centroids lie in the same cell of a
//! grid, which is square across the class's direction, belong together if they are connected. Scraps, pieces with
//! little area that are connected to nothing else in their cell (leaves, hair, the corners of cells), are one group a
//! cell. O(n log n).

use glam::{DMat3, DVec3, Vec3};
use std::cmp::Ordering;

/// Components of unit normals within ± this count as 0 when classes are told apart: sin 22.5°, which puts axes and
/// diagonals in the middle of their classes. No normal is then more than 32.5° from the direction of its class.
const ZERO_BELOW: f64 = 0.382_683;

/// Cells are this many spacings deep along the direction of their class, so that a surface tilted against it seldom
/// crosses from one layer of cells into the next.
const DEPTH: f64 = 1.5;

/// A connected piece with less than this part of a cell's area is a scrap.
const SCRAP_BELOW: f64 = 0.25;

/// Groups of triangles, by number.
#[derive(Debug, Clone, Default)]
pub(super) struct Clusters {
    /// `members[starts[c]..starts[c + 1]]` are the triangles of cluster `c`, ascending.
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Clusters {
    pub(super) fn len(&self) -> u32 {
        u32::try_from(self.starts.len().saturating_sub(1)).expect("fewer clusters than triangles")
    }

    pub(super) fn members(&self, cluster: u32) -> &[u32] {
        let c = cluster as usize;
        &self.members[self.starts[c] as usize..self.starts[c + 1] as usize]
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(&*self.starts) + size_of_val(&*self.members)
    }

    fn push(&mut self, members: impl Iterator<Item = u32>) {
        if self.starts.is_empty() {
            self.starts.push(0);
        }
        self.members.extend(members);
        let end = u32::try_from(self.members.len()).expect("triangles are numbered with 32 bits");
        self.starts.push(end);
    }
}

/// True if a triangle is to be grouped with others: all of it lies within one spacing. Not for degenerate ones.
pub(super) fn is_small(corners: [Vec3; 3], spacing: f32) -> bool {
    let [a, b, c] = corners;
    let longest = a
        .distance_squared(b)
        .max(b.distance_squared(c))
        .max(c.distance_squared(a));
    longest <= spacing * spacing
}

/// Collects small triangles, then groups them.
pub(super) struct Clusterer {
    spacing: f64,
    /// In the middle of a cell of every class: what is smaller than a cell around it falls into one.
    center: DVec3,
    /// Columns: two tangents and the direction of a class.
    frames: [DMat3; 27],
    small: Vec<Small>,
}

/// A small triangle.
#[derive(Debug, Clone, Copy)]
struct Small {
    class: u8,
    cell: [i32; 3],
    t: u32,
    area: f32,
}

impl Small {
    fn place(&self) -> (u8, [i32; 3]) {
        (self.class, self.cell)
    }

    fn order(&self, other: &Self) -> Ordering {
        (self.place(), self.t).cmp(&(other.place(), other.t))
    }
}

impl Clusterer {
    pub(super) fn new(center: Vec3, spacing: f32) -> Self {
        Self {
            spacing: f64::from(spacing),
            center: center.as_dvec3(),
            frames: std::array::from_fn(frame),
            small: Vec::new(),
        }
    }

    /// Collect triangle `t`, which has an area; ascending.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "cells saturate; an area, rounded to f32"
    )]
    pub(super) fn add(&mut self, t: u32, corners: [Vec3; 3]) {
        let [a, b, c] = corners.map(|p| p.as_dvec3());
        let cross = (b - a).cross(c - a);
        let class = class_of(cross.normalize_or_zero());
        let place = self.frames[usize::from(class)].transpose() * ((a + b + c) / 3.0 - self.center);
        let place = place / (self.spacing * DVec3::new(1.0, 1.0, DEPTH)) + 0.5;
        self.small.push(Small {
            class,
            cell: place.to_array().map(|x| x.floor() as i32),
            t,
            area: (0.5 * cross.length()) as f32,
        });
    }

    /// The groups of more than one triangle. `points`: the points of a triangle's corners, by which triangles are
    /// connected.
    pub(super) fn finish(mut self, points: impl Fn(u32) -> [u32; 3]) -> Clusters {
        self.small.sort_unstable_by(Small::order);
        let scrap_below = SCRAP_BELOW * self.spacing * self.spacing;
        let mut clusters = Clusters::default();
        let mut pieces = Pieces::default();
        for cell in self
            .small
            .chunk_by(|a, b| a.place() == b.place())
            .filter(|cell| cell.len() > 1)
        {
            pieces.find(cell, &points);
            pieces.join_scraps(cell, scrap_below);
            for group in pieces.groups() {
                clusters.push(group.iter().map(|(_, i)| cell[*i as usize].t));
            }
        }
        clusters
    }
}

/// Class of a unit normal: −, 0 or + on each axis as a number of base 3.
fn class_of(normal: DVec3) -> u8 {
    let digit = |x: f64| u8::from(x > -ZERO_BELOW) + u8::from(x > ZERO_BELOW);
    9 * digit(normal.x) + 3 * digit(normal.y) + digit(normal.z)
}

/// Tangents and direction of a class; anything for class 13, which no unit normal has.
#[expect(clippy::cast_precision_loss, reason = "digits of base 3")]
fn frame(class: usize) -> DMat3 {
    let direction =
        DVec3::from([class / 9, class / 3 % 3, class % 3].map(|digit| digit as f64 - 1.0));
    let direction = direction.normalize_or(DVec3::Z);
    let (x, y) = direction.any_orthonormal_pair();
    DMat3::from_cols(x, y, direction)
}

/// Connected pieces of the triangles of a cell; scratch memory for one cell after the other.
#[derive(Default)]
struct Pieces {
    /// Union-find over the cell's triangles: the root of a piece is its first triangle.
    parents: Vec<u32>,
    areas: Vec<f64>,
    /// (point, triangle), sorted.
    corners: Vec<(u32, u32)>,
    /// (group, triangle), sorted.
    labels: Vec<(u32, u32)>,
}

impl Pieces {
    fn find(&mut self, cell: &[Small], points: impl Fn(u32) -> [u32; 3]) {
        let count = u32::try_from(cell.len()).expect("triangles are numbered with 32 bits");
        self.parents.clear();
        self.parents.extend(0..count);
        self.corners.clear();
        for (i, small) in (0_u32..).zip(cell) {
            self.corners.extend(points(small.t).map(|point| (point, i)));
        }
        self.corners.sort_unstable();
        for k in 1..self.corners.len() {
            let ((point, i), (other, j)) = (self.corners[k - 1], self.corners[k]);
            if point == other {
                let (i, j) = (self.root(i), self.root(j));
                self.parents[i.max(j) as usize] = i.min(j);
            }
        }
    }

    fn root(&mut self, mut i: u32) -> u32 {
        while self.parents[i as usize] != i {
            let next = self.parents[self.parents[i as usize] as usize];
            self.parents[i as usize] = next;
            i = next;
        }
        i
    }

    /// Label triangles by the root of their piece, those of scraps by the root of the first scrap.
    fn join_scraps(&mut self, cell: &[Small], scrap_below: f64) {
        self.areas.clear();
        self.areas.resize(cell.len(), 0.0);
        self.labels.clear();
        for (i, small) in (0_u32..).zip(cell) {
            let root = self.root(i);
            self.areas[root as usize] += f64::from(small.area);
            self.labels.push((root, i));
        }
        let mut scraps = None;
        for (label, _) in &mut self.labels {
            if self.areas[*label as usize] < scrap_below {
                *label = *scraps.get_or_insert(*label);
            }
        }
        self.labels.sort_unstable();
    }

    fn groups(&self) -> impl Iterator<Item = &[(u32, u32)]> {
        self.labels
            .chunk_by(|a, b| a.0 == b.0)
            .filter(|group| group.len() > 1)
    }
}
