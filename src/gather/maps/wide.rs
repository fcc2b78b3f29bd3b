//! The looks of [`super::look`] for sixteen receivers at a time: the same operations in the same order, so the same
//! bits on any processor.

use super::crowd::{Block, LANES, Lanes, Sums};
use super::flat::FlatView;
use super::look::{
    FOREIGN_SHARE, FOREIGN_UNCERTAIN, LEAST_COSINE, OWN_UNCERTAIN, Rules, SLOPE_SHARE, View,
};
use super::raster::{DepthMap, TAG_BITS};
use super::sky::{self, SEEN, SUNKEN, SkyCell, TOWARDS};
use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x16, i32x16, mask32x16, u32x16};
use glam::Vec3;

/// Add what `blocks` see along all `views` to their `sums`, view after view.
pub(super) fn look(
    level: Level,
    (views, rules): (&[View], &Rules),
    blocks: &[Block],
    sums: &mut [Sums],
) {
    dispatch!(level, simd => for (block, sums) in blocks.iter().zip(sums.iter_mut()) {
        look_block(simd, (views, rules), block, sums);
    });
}

// No closures with vectors and no `array::map` in here: they are compiled without the processor's instructions.

#[inline(always)]
fn load<S: Simd>(simd: S, row: &Lanes) -> f32x16<S> {
    f32x16::from_slice(simd, row)
}

#[inline(always)]
fn load_vector<S: Simd>(simd: S, rows: &[Lanes; 3]) -> [f32x16<S>; 3] {
    [
        load(simd, &rows[0]),
        load(simd, &rows[1]),
        load(simd, &rows[2]),
    ]
}

#[inline(always)]
fn dot<S: Simd>(v: Vec3, p: &[f32x16<S>; 3]) -> f32x16<S> {
    p[0] * v.x + p[1] * v.y + p[2] * v.z
}

#[inline(always)]
fn look_block<S: Simd>(simd: S, (views, rules): (&[View], &Rules), block: &Block, sums: &mut Sums) {
    let position = load_vector(simd, &block.position);
    let normal = load_vector(simd, &block.normal);
    let tag = u32x16::from_slice(simd, &block.tag);
    let (mut weight, mut open) = (load(simd, &sums.weight), load(simd, &sums.open));
    let mut uncertain = load(simd, &sums.uncertain);
    let zero = f32x16::splat(simd, 0.0);
    for view in views {
        let place = Place::of(simd, view, &position, &normal);
        let mut covered = zero.simd_gt(zero);
        let (mut unsure, mut far) = (covered, covered);
        for map in &view.maps {
            let verdict = map_verdict(simd, (map, rules), &place, tag);
            covered |= verdict.covered;
            unsure |= verdict.uncertain;
            far |= verdict.far;
        }
        for flat in &view.flats {
            covered |= flat_covers(simd, (flat, rules), &place);
        }
        let seen = covered.select(zero, place.cosine);
        weight += place.cosine;
        open += seen;
        uncertain += unsure.select(place.cosine, zero);
        uncertain = (far & !covered).select(f32x16::splat(simd, f32::INFINITY), uncertain);
        let counted = seen.simd_gt(zero).select(f32x16::splat(simd, 1.0), zero);
        for (k, sum) in sums.channels.iter_mut().enumerate() {
            let factor = if k < rules.weighted_channels {
                seen
            } else {
                counted
            };
            let value = place.against.select(
                f32x16::splat(simd, view.channels[1][k]),
                f32x16::splat(simd, view.channels[0][k]),
            );
            (load(simd, sum) + factor * value).store_slice(sum);
        }
        if let Some([along, opposite]) = &view.sky {
            let open = seen.simd_gt(zero);
            let ahead = !place.against;
            add_sky(simd, along, &normal, (ahead, open), &mut sums.sky);
            add_sky(
                simd,
                opposite,
                &normal,
                (place.against, open),
                &mut sums.sky,
            );
        }
    }
    weight.store_slice(&mut sums.weight);
    open.store_slice(&mut sums.open);
    uncertain.store_slice(&mut sums.uncertain);
}

/// Add the light of one cell of the sky to the rows of sixteen receivers: of those that look along it and are `open`,
/// and of those that look the other way.
#[inline(always)]
fn add_sky<S: Simd>(
    simd: S,
    cell: &SkyCell,
    normal: &[f32x16<S>; 3],
    (looks, open): (mask32x16<S>, mask32x16<S>),
    rows: &mut [Lanes],
) {
    let zero = f32x16::splat(simd, 0.0);
    let cosine = dot(cell.direction, normal);
    let top = cosine + cell.half_width;
    let lit = top.simd_gt(zero);
    let (seen, sunken) = (lit & looks & open, lit & !looks);
    let (any_seen, any_sunken) = (seen.any_true(), sunken.any_true());
    if !any_seen && !any_sunken {
        return;
    }
    let whole = cosine.simd_ge(f32x16::splat(simd, cell.half_width));
    let mut bright = zero;
    for (color, weight) in sky::weights().into_iter().enumerate() {
        let part = top * top * cell.rise[color];
        let value = whole.select(dot(cell.moments[color], normal).max(zero), part);
        if any_seen {
            let row = &mut rows[SEEN + color];
            (load(simd, row) + seen.select(value, zero)).store_slice(row);
        }
        if any_sunken {
            let row = &mut rows[SUNKEN + color];
            (load(simd, row) + sunken.select(value, zero)).store_slice(row);
        }
        bright = if color == 0 {
            value * weight
        } else {
            bright + value * weight
        };
    }
    for (axis, row) in rows.iter_mut().skip(TOWARDS).enumerate() {
        let towards = seen.select(bright * cell.direction[axis], zero);
        (load(simd, row) + towards).store_slice(row);
    }
}

/// See [`super::look`]: sixteen receivers in the frame of an axis.
struct Place<S: Simd> {
    right: f32x16<S>,
    up: f32x16<S>,
    depth: f32x16<S>,
    against: mask32x16<S>,
    cosine: f32x16<S>,
    inverse_cosine: f32x16<S>,
    slope: [f32x16<S>; 2],
    tangent: f32x16<S>,
}

impl<S: Simd> Place<S> {
    #[inline(always)]
    fn of(simd: S, view: &View, position: &[f32x16<S>; 3], normal: &[f32x16<S>; 3]) -> Self {
        let axis = &view.axis;
        let along = dot(axis.direction, normal);
        let (nr, nu) = (dot(axis.right, normal), dot(axis.up, normal));
        let against = along.simd_lt(f32x16::splat(simd, 0.0));
        let depth = dot(axis.direction, position);
        let cosine = along.abs();
        let inverse_cosine =
            f32x16::splat(simd, 1.0) / cosine.max(f32x16::splat(simd, LEAST_COSINE));
        Self {
            right: dot(axis.right, position),
            up: dot(axis.up, position),
            depth: against.select(-depth, depth),
            against,
            cosine,
            inverse_cosine,
            slope: [-nr * inverse_cosine, -nu * inverse_cosine],
            tangent: (nr * nr + nu * nu).sqrt() * inverse_cosine,
        }
    }
}

struct Verdict<S: Simd> {
    covered: mask32x16<S>,
    uncertain: mask32x16<S>,
    far: mask32x16<S>,
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "maps are at most a few thousand pixels across"
)]
#[inline(always)]
fn map_verdict<S: Simd>(
    simd: S,
    (map, rules): (&DepthMap, &Rules),
    place: &Place<S>,
    own_tag: u32x16<S>,
) -> Verdict<S> {
    let half = f32x16::splat(simd, 0.5);
    let x = place.right * map.pixels + map.origin[0];
    let y = place.up * map.pixels + map.origin[1];
    let (column, row) = (
        whole(simd, x, map.width).to_int::<i32x16<S>>(),
        whole(simd, y, map.height).to_int::<i32x16<S>>(),
    );
    let pixel = row * (map.width as i32) + column;
    let side = place.against.select(
        i32x16::splat(simd, map.side() as i32),
        i32x16::splat(simd, 0),
    );
    let key = gather(simd, &map.keys, pixel + side);
    let steps_a_pixel = map.steps / map.pixels;
    let slide_x = (column.to_float::<f32x16<S>>() + half - x) * place.slope[0];
    let slide_y = (row.to_float::<f32x16<S>>() + half - y) * place.slope[1];
    let origin = place.against.select(
        f32x16::splat(simd, map.origin_depth[1]),
        f32x16::splat(simd, map.origin_depth[0]),
    );
    let slide = (slide_x + slide_y) * steps_a_pixel;
    let own = place.depth * map.steps + origin + slide;
    let depth: i32x16<S> = (key >> TAG_BITS).bitcast();
    let above = depth.to_float::<f32x16<S>>() - own;
    let bias = (place.tangent * SLOPE_SHARE + 1.0) * (rules.bias * steps_a_pixel);
    let is_own = (key & ((1 << TAG_BITS) - 1)).simd_eq(own_tag);
    let needed = is_own.select(bias, bias * FOREIGN_SHARE);
    let is_there = key.simd_gt(u32x16::splat(simd, 0));
    let own_unsure = above.simd_gt(bias * OWN_UNCERTAIN.0) & above.simd_lt(bias * OWN_UNCERTAIN.1);
    let covers = above.simd_gt(needed);
    let foreign_unsure =
        above.abs().simd_lt(bias * FOREIGN_UNCERTAIN) | (covers ^ (above + slide).simd_gt(needed));
    let far = (above + bias).simd_gt(f32x16::splat(simd, rules.max_distance * map.steps));
    Verdict {
        covered: is_there & covers & !far,
        uncertain: is_there & ((is_own & own_unsure) | (!is_own & foreign_unsure)),
        far: is_there & covers & far,
    }
}

/// Into the map; its fraction is dropped when it becomes an integer.
#[inline(always)]
fn whole<S: Simd>(simd: S, x: f32x16<S>, count: u32) -> f32x16<S> {
    x.max(f32x16::splat(simd, 0.0))
        .min(f32x16::splat(simd, (count - 1) as f32))
}

#[inline(always)]
fn gather<S: Simd>(simd: S, keys: &[u32], index: i32x16<S>) -> u32x16<S> {
    let i: [u32; LANES] = index.bitcast::<u32x16<S>>().into();
    let mut found = [0; LANES];
    for k in 0..LANES {
        found[k] = keys[i[k] as usize];
    }
    u32x16::simd_from(simd, found)
}

#[inline(always)]
fn flat_covers<S: Simd>(
    simd: S,
    (flat, rules): (&FlatView, &Rules),
    place: &Place<S>,
) -> mask32x16<S> {
    let depth = at(place, flat.depth);
    let above = place.against.select(-depth, depth) - place.depth;
    let mut covers = above.simd_gt(place.inverse_cosine * rules.flat_margin)
        & above.simd_lt(f32x16::splat(simd, rules.max_distance));
    let least = f32x16::splat(simd, -rules.flat_margin);
    for &edge in &flat.edges {
        covers &= at(place, edge).simd_ge(least);
    }
    covers
}

#[inline(always)]
fn at<S: Simd>(place: &Place<S>, [a, b, c]: [f32; 3]) -> f32x16<S> {
    place.right * a + place.up * b + c
}
