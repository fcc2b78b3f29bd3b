//! Painting of sixteen triangles at a time: the operations of `plain.rs` in its order, so the same bits on any
//! processor. Most triangles are about a pixel large: all sixteen try their first pixel, then their second, and so on.
//! Larger ones are painted one by one, sixteen pixels of a row at a time.

use super::super::crowd::{LANES, Lanes};
use super::super::shell::TriangleBlock;
use super::{Brush, COVER, DepthMap, TAG_BITS};
use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x16, mask32x16, u32x16};

/// Triangles of at most this many pixel columns and rows after the first are painted together.
const SMALL: f32 = 3.0;

/// Paint all `blocks`.
pub(super) fn paint(level: Level, map: &mut DepthMap, brush: &Brush, blocks: &[TriangleBlock]) {
    dispatch!(level, simd => for block in blocks {
        paint_block(simd, map, brush, block);
    });
}

/// Corner → pixel column, pixel row, depth.
type Corners<S> = [[f32x16<S>; 3]; 3];

// Functions and loops here instead of closures and `array::map`: those are compiled without the processor's
// instructions and called, which made painting four times slower.

#[inline(always)]
fn paint_block<S: Simd>(simd: S, map: &mut DepthMap, brush: &Brush, block: &TriangleBlock) {
    let corners = [
        place(simd, brush, &block.corners[0]),
        place(simd, brush, &block.corners[1]),
        place(simd, brush, &block.corners[2]),
    ];
    let first = [low(simd, &corners, 0), low(simd, &corners, 1)];
    let count = [
        high(simd, &corners, 0, map.width) - first[0],
        high(simd, &corners, 1, map.height) - first[1],
    ];
    let zero = f32x16::splat(simd, 0.0);
    let sides = [
        minus(&corners[1], &corners[0]),
        minus(&corners[2], &corners[0]),
    ];
    let area = sides[0][0] * sides[1][1] - sides[0][1] * sides[1][0];
    let hits = count[0].simd_ge(zero) & count[1].simd_ge(zero) & area.simd_ne(zero);
    if !hits.any_true() {
        return;
    }
    let triangles = Triangles::new(simd, &corners, (first, count), (sides, area));
    let small = f32x16::splat(simd, SMALL);
    let is_small = hits & count[0].simd_le(small) & count[1].simd_le(small);
    triangles.paint_together(simd, map, brush, is_small);
    let mut large = (hits & !is_small).to_bitmask();
    if large != 0 {
        let stored = triangles.store();
        while large != 0 {
            paint_alone(simd, map, brush, &stored, large.trailing_zeros() as usize);
            large &= large - 1;
        }
    }
}

#[inline(always)]
fn place<S: Simd>(simd: S, brush: &Brush, corner: &[Lanes; 3]) -> [f32x16<S>; 3] {
    let x = f32x16::from_slice(simd, &corner[0]);
    let y = f32x16::from_slice(simd, &corner[1]);
    let z = f32x16::from_slice(simd, &corner[2]);
    let [r, u, d] = &brush.rows;
    [
        x * r.0.x + y * r.0.y + z * r.0.z + r.1,
        x * u.0.x + y * u.0.y + z * u.0.z + u.1,
        x * d.0.x + y * d.0.y + z * d.0.z + d.1,
    ]
}

#[inline(always)]
fn minus<S: Simd>(p: &[f32x16<S>; 3], q: &[f32x16<S>; 3]) -> [f32x16<S>; 3] {
    [p[0] - q[0], p[1] - q[1], p[2] - q[2]]
}

#[inline(always)]
fn low<S: Simd>(simd: S, [a, b, c]: &Corners<S>, k: usize) -> f32x16<S> {
    (a[k].min(b[k]).min(c[k]) - 0.5)
        .max(f32x16::splat(simd, 0.0))
        .ceil()
}

#[inline(always)]
fn high<S: Simd>(simd: S, [a, b, c]: &Corners<S>, k: usize, count: u32) -> f32x16<S> {
    let last = f32x16::splat(simd, (count - 1) as f32);
    (a[k].max(b[k]).max(c[k]) - 0.5).min(last).floor()
}

/// A triangle's functions over the pixels: value at its first pixel, growth a column, growth a row.
type Linear<T> = [T; 3];

#[inline(always)]
fn at<S: Simd>(f: &Linear<f32x16<S>>, x: f32x16<S>, y: f32) -> f32x16<S> {
    f[0] + (f[1] * x + f[2] * y)
}

/// Sixteen triangles over the pixels (`T`: a vector) or stored (`T`: its lanes).
struct Triangles<T> {
    /// First pixel column and row.
    first: [T; 2],
    /// Columns and rows after the first.
    count: [T; 2],
    /// Nowhere negative in what they cover.
    edges: [Linear<T>; 3],
    depth: Linear<T>,
    least: T,
    most: T,
    /// Above 0 if counter-clockwise as seen against the axis.
    area: T,
}

impl<S: Simd> Triangles<f32x16<S>> {
    #[inline(always)]
    fn new(
        simd: S,
        [a, b, c]: &Corners<S>,
        (first, count): ([f32x16<S>; 2], [f32x16<S>; 2]),
        ([u, v], area): ([[f32x16<S>; 3]; 2], f32x16<S>),
    ) -> Self {
        let one = f32x16::splat(simd, 1.0);
        let faces = area.simd_gt(f32x16::splat(simd, 0.0));
        let sign = faces.select(one, -one);
        let slack = (u[0].abs() + u[1].abs() + v[0].abs() + v[1].abs() + 1.0) * COVER;
        let middle = [first[0] + 0.5, first[1] + 0.5];
        let p = [a[0] - middle[0], a[1] - middle[1]];
        let q = [b[0] - middle[0], b[1] - middle[1]];
        let r = [c[0] - middle[0], c[1] - middle[1]];
        let inverse = one / area;
        let slope = [
            (u[2] * v[1] - v[2] * u[1]) * inverse,
            (v[2] * u[0] - u[2] * v[0]) * inverse,
        ];
        Self {
            first,
            count,
            edges: [
                edge(&p, &q, sign, slack),
                edge(&q, &r, sign, slack),
                edge(&r, &p, sign, slack),
            ],
            depth: [a[2] - slope[0] * p[0] - slope[1] * p[1], slope[0], slope[1]],
            least: a[2].min(b[2]).min(c[2]),
            most: a[2].max(b[2]).max(c[2]),
            area,
        }
    }

    #[inline(always)]
    fn covered(&self, inside: mask32x16<S>, x: f32x16<S>, y: f32) -> mask32x16<S> {
        let zero = f32x16::splat(self.area.simd, 0.0);
        inside
            & at(&self.edges[0], x, y).simd_ge(zero)
            & at(&self.edges[1], x, y).simd_ge(zero)
            & at(&self.edges[2], x, y).simd_ge(zero)
    }

    #[inline(always)]
    fn depth(&self, x: f32x16<S>, y: f32) -> f32x16<S> {
        at(&self.depth, x, y).max(self.least).min(self.most)
    }

    /// Pixel by pixel, all triangles at once.
    #[inline(always)]
    fn paint_together(&self, simd: S, map: &mut DepthMap, brush: &Brush, which: mask32x16<S>) {
        let palette = self.palette(simd, map, brush);
        let mut y = 0.0;
        let mut in_rows = which;
        while in_rows.any_true() {
            let mut x = 0.0;
            let mut inside = in_rows;
            while inside.any_true() {
                let column = f32x16::splat(simd, x);
                let covered = self.covered(inside, column, y).to_bitmask();
                if covered != 0 {
                    let depth = self.depth(column, y);
                    let offset = y * map.width as f32 + x;
                    palette.put(&mut map.keys, (depth, offset), covered);
                }
                x += 1.0;
                inside &= self.count[0].simd_ge(f32x16::splat(simd, x));
            }
            y += 1.0;
            in_rows &= self.count[1].simd_ge(f32x16::splat(simd, y));
        }
    }

    #[inline(always)]
    fn palette(&self, simd: S, map: &DepthMap, brush: &Brush) -> Palette<S> {
        let faces = self.area.simd_gt(f32x16::splat(simd, 0.0));
        let front = u32x16::splat(simd, brush.front);
        let back = u32x16::splat(simd, brush.back);
        let side = u32x16::splat(simd, map.width * map.height);
        let pixel = self.first[1] * map.width as f32 + self.first[0];
        let sees_along = if brush.front & 1 == 1 { faces } else { !faces };
        Palette {
            is_solid: brush.is_solid,
            sees_along,
            tags: [faces.select(front, back), faces.select(back, front)],
            solid_tag: u32x16::splat(simd, brush.front | 1),
            pixel,
            side,
            top: brush.top,
        }
    }

    #[inline(always)]
    fn store(&self) -> Triangles<Lanes> {
        Triangles {
            first: [self.first[0].into(), self.first[1].into()],
            count: [self.count[0].into(), self.count[1].into()],
            edges: [
                store_linear(&self.edges[0]),
                store_linear(&self.edges[1]),
                store_linear(&self.edges[2]),
            ],
            depth: store_linear(&self.depth),
            least: self.least.into(),
            most: self.most.into(),
            area: self.area.into(),
        }
    }
}

#[inline(always)]
fn edge<S: Simd>(
    p: &[f32x16<S>; 2],
    q: &[f32x16<S>; 2],
    sign: f32x16<S>,
    slack: f32x16<S>,
) -> Linear<f32x16<S>> {
    let along = [(q[0] - p[0]) * sign, (q[1] - p[1]) * sign];
    let start = along[1] * p[0] - along[0] * p[1] + slack;
    [start, -along[1], along[0]]
}

#[inline(always)]
fn store_linear<S: Simd>(f: &Linear<f32x16<S>>) -> Linear<Lanes> {
    [f[0].into(), f[1].into(), f[2].into()]
}

#[inline(always)]
fn splat_linear<S: Simd>(simd: S, f: &Linear<Lanes>, lane: usize) -> Linear<f32x16<S>> {
    [
        f32x16::splat(simd, f[0][lane]),
        f32x16::splat(simd, f[1][lane]),
        f32x16::splat(simd, f[2][lane]),
    ]
}

/// Keys of sixteen triangles.
struct Palette<S: Simd> {
    /// Each triangle goes into one map only: that which sees its front.
    is_solid: bool,
    /// That is the one along the axis.
    sees_along: mask32x16<S>,
    /// In the map along the axis and in that against it.
    tags: [u32x16<S>; 2],
    solid_tag: u32x16<S>,
    /// Number of the first pixel: exact, since maps have less than 2²⁴ pixels.
    pixel: f32x16<S>,
    /// Pixels of a side.
    side: u32x16<S>,
    top: f32,
}

impl<S: Simd> Palette<S> {
    /// Keep the farthest of what is there and the lanes `covered`, `offset` pixels after their first.
    #[inline(always)]
    fn put(&self, keys: &mut [u32], (depth, offset): (f32x16<S>, f32), covered: u64) {
        let pixel = (self.pixel + offset).to_int::<u32x16<S>>();
        let against = -depth + self.top;
        let other = pixel + self.side;
        if self.is_solid {
            let pixel = self.sees_along.select(pixel, other);
            let depth = self.sees_along.select(depth, against);
            keep(keys, pixel, key(depth, self.solid_tag), covered);
        } else {
            keep(keys, pixel, key(depth, self.tags[0]), covered);
            keep(keys, other, key(against, self.tags[1]), covered);
        }
    }
}

#[inline(always)]
fn key<S: Simd>(depth: f32x16<S>, tag: u32x16<S>) -> u32x16<S> {
    (depth.to_int::<u32x16<S>>() << TAG_BITS) | tag
}

#[inline(always)]
fn keep<S: Simd>(keys: &mut [u32], pixel: u32x16<S>, key: u32x16<S>, mut covered: u64) {
    let pixel: [u32; LANES] = pixel.into();
    let key: [u32; LANES] = key.into();
    while covered != 0 {
        let lane = covered.trailing_zeros() as usize % LANES;
        covered &= covered - 1;
        let place = &mut keys[pixel[lane] as usize];
        *place = (*place).max(key[lane]);
    }
}

/// Paint one triangle, sixteen pixels of a row at a time.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "pixels within the map"
)]
#[inline(always)]
fn paint_alone<S: Simd>(
    simd: S,
    map: &mut DepthMap,
    brush: &Brush,
    stored: &Triangles<Lanes>,
    lane: usize,
) {
    let one = Triangles::alone(simd, stored, lane);
    let (columns, rows) = (
        stored.count[0][lane] as usize,
        stored.count[1][lane] as usize,
    );
    let (first, top) = (
        stored.first[0][lane] as usize,
        stored.first[1][lane] as usize,
    );
    let tags = if stored.area[lane] > 0.0 {
        [brush.front, brush.back]
    } else {
        [brush.back, brush.front]
    };
    let shows = |tag: u32| !brush.is_solid || tag & 1 == 1;
    let (width, side) = (map.width as usize, map.side());
    for j in 0..=rows {
        let y = j as f32;
        let start = (top + j) * width + first;
        for i in (0..=columns).step_by(LANES) {
            let x = f32x16::from_slice(simd, &STEPS) + i as f32;
            let covered = one.covered(x.simd_le(one.count[0]), x, y);
            if !covered.any_true() {
                continue;
            }
            let depth = one.depth(x, y);
            let nothing = u32x16::splat(simd, 0);
            if shows(tags[0]) {
                let key = key(depth, u32x16::splat(simd, tags[0]));
                let key = covered.select(key, nothing);
                keep_farthest(simd, &mut map.keys[start + i..], key);
            }
            if shows(tags[1]) {
                let key = key(-depth + brush.top, u32x16::splat(simd, tags[1]));
                let key = covered.select(key, nothing);
                keep_farthest(simd, &mut map.keys[side + start + i..], key);
            }
        }
    }
}

impl<S: Simd> Triangles<f32x16<S>> {
    /// The same triangle in all lanes.
    #[inline(always)]
    fn alone(simd: S, stored: &Triangles<Lanes>, lane: usize) -> Self {
        let zero = f32x16::splat(simd, 0.0);
        Self {
            first: [zero; 2],
            count: [f32x16::splat(simd, stored.count[0][lane]), zero],
            edges: [
                splat_linear(simd, &stored.edges[0], lane),
                splat_linear(simd, &stored.edges[1], lane),
                splat_linear(simd, &stored.edges[2], lane),
            ],
            depth: splat_linear(simd, &stored.depth, lane),
            least: f32x16::splat(simd, stored.least[lane]),
            most: f32x16::splat(simd, stored.most[lane]),
            area: f32x16::splat(simd, stored.area[lane]),
        }
    }
}

/// Columns of a step.
const STEPS: Lanes = [
    0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0,
];

/// Into the first sixteen places, or as many as there are.
#[inline(always)]
fn keep_farthest<S: Simd>(simd: S, places: &mut [u32], key: u32x16<S>) {
    if let Some(places) = places.first_chunk_mut::<LANES>() {
        let there = u32x16::from_slice(simd, places);
        there.max(key).store_slice(places);
    } else {
        let keys: [u32; LANES] = key.into();
        for (place, key) in places.iter_mut().zip(keys) {
            *place = (*place).max(key);
        }
    }
}
