//! The definition of a look, for one receiver along one axis: what [`super::wide`] is tested against.

use super::axes::Axis;
use super::crowd::{Block, LANES, Sums};
use super::flat::FlatView;
use super::look::{
    FOREIGN_SHARE, FOREIGN_UNCERTAIN, LEAST_COSINE, OWN_UNCERTAIN, Rules, SLOPE_SHARE, View,
};
use super::raster::{DepthMap, TAG_BITS};
use super::sky::{self, SEEN, SUNKEN, SkyCell, TOWARDS};
use glam::Vec3;

/// Add what lane `lane` of `block` sees along one axis to its sums.
pub(super) fn look(view: &View, rules: &Rules, block: &Block, lane: usize, sums: &mut Sums) {
    let at = |rows: &[[f32; LANES]; 3]| [rows[0][lane], rows[1][lane], rows[2][lane]];
    let place = Place::of(&view.axis, at(&block.position), at(&block.normal));
    let mut is_open = true;
    let (mut is_uncertain, mut is_far) = (false, false);
    for map in &view.maps {
        let verdict = map_verdict(map, rules, &place, block.tag[lane]);
        is_open &= verdict.is_open;
        is_uncertain |= verdict.is_uncertain;
        is_far |= verdict.is_far;
    }
    for flat in &view.flats {
        is_open &= !flat_covers(flat, rules, &place);
    }
    let seen = if is_open { place.cosine } else { 0.0 };
    sums.weight[lane] += place.cosine;
    sums.open[lane] += seen;
    sums.uncertain[lane] += if is_far && is_open {
        f32::INFINITY
    } else if is_uncertain {
        place.cosine
    } else {
        0.0
    };
    let counted = if is_open && place.cosine > 0.0 {
        1.0
    } else {
        0.0
    };
    for (k, sum) in sums.channels.iter_mut().enumerate() {
        let factor = if k < rules.weighted_channels {
            seen
        } else {
            counted
        };
        sum[lane] += factor * view.channels[place.side][k];
    }
    for (side, cell) in view.sky.iter().flatten().enumerate() {
        let light = if side != place.side {
            Light::Sunken
        } else if counted > 0.0 {
            Light::Seen
        } else {
            Light::Covered
        };
        add_sky(cell, at(&block.normal), light, (sums, lane));
    }
}

/// How a cell of the sky stands to a receiver.
#[derive(PartialEq)]
enum Light {
    Seen,
    Covered,
    /// Its direction is below the horizon.
    Sunken,
}

fn add_sky(cell: &SkyCell, normal: [f32; 3], light: Light, (sums, lane): (&mut Sums, usize)) {
    let Some(arrival) = arrival(cell, normal).filter(|_| light != Light::Covered) else {
        return;
    };
    let first = if light == Light::Seen { SEEN } else { SUNKEN };
    for (color, value) in arrival.iter().enumerate() {
        sums.sky[first + color][lane] += value;
    }
    let [r, g, b] = sky::weights();
    let bright = arrival[0] * r + arrival[1] * g + arrival[2] * b;
    for (axis, sum) in sums.sky.iter_mut().skip(TOWARDS).enumerate() {
        if light == Light::Seen {
            sum[lane] += bright * cell.direction[axis];
        }
    }
}

/// Irradiance from a cell if nothing blocks it, as [`crate::lighting::EnvironmentCell::irradiance`]; `None` below the
/// horizon.
fn arrival(cell: &SkyCell, normal: [f32; 3]) -> Option<[f32; 3]> {
    let dot = |v: Vec3| v.x * normal[0] + v.y * normal[1] + v.z * normal[2];
    let cosine = dot(cell.direction);
    let top = cosine + cell.half_width;
    if top <= 0.0 {
        return None;
    }
    let is_above = cosine >= cell.half_width;
    Some([0, 1, 2].map(|color| {
        if is_above {
            dot(cell.moments[color]).max(0.0)
        } else {
            top * top * cell.rise[color]
        }
    }))
}

/// A receiver in the frame of an axis, which is turned round where the receiver looks against it.
struct Place {
    right: f32,
    up: f32,
    /// Depth in the direction looked along.
    depth: f32,
    /// 0: along the axis, 1: against it.
    side: usize,
    /// Between the normal and the direction.
    cosine: f32,
    inverse_cosine: f32,
    /// Growth of the depth along the tangent plane, to the right and up.
    slope: [f32; 2],
    /// Of the angle between normal and direction.
    tangent: f32,
}

impl Place {
    fn of(axis: &Axis, position: [f32; 3], normal: [f32; 3]) -> Self {
        let dot = |v: Vec3, p: [f32; 3]| v.x * p[0] + v.y * p[1] + v.z * p[2];
        let along = dot(axis.direction, normal);
        let (nr, nu) = (dot(axis.right, normal), dot(axis.up, normal));
        let side = usize::from(along < 0.0);
        let depth = dot(axis.direction, position);
        let cosine = along.abs();
        let inverse_cosine = 1.0 / cosine.max(LEAST_COSINE);
        Self {
            right: dot(axis.right, position),
            up: dot(axis.up, position),
            depth: if side == 0 { depth } else { -depth },
            side,
            cosine,
            inverse_cosine,
            slope: [-nr * inverse_cosine, -nu * inverse_cosine],
            tangent: (nr * nr + nu * nu).sqrt() * inverse_cosine,
        }
    }
}

struct Verdict {
    is_open: bool,
    is_uncertain: bool,
    /// Something lies beyond the limit: what is before it, if anything, is not known.
    is_far: bool,
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the map"
)]
fn map_verdict(map: &DepthMap, rules: &Rules, place: &Place, own_tag: u32) -> Verdict {
    let x = place.right * map.pixels + map.origin[0];
    let y = place.up * map.pixels + map.origin[1];
    let column = x.max(0.0).min((map.width - 1) as f32) as u32;
    let row = y.max(0.0).min((map.height - 1) as f32) as u32;
    let key = map.keys[(row * map.width + column) as usize + place.side * map.side()];
    let steps_a_pixel = map.steps / map.pixels;
    let slide_x = (column as f32 + 0.5 - x) * place.slope[0];
    let slide_y = (row as f32 + 0.5 - y) * place.slope[1];
    let slide = (slide_x + slide_y) * steps_a_pixel;
    let own = place.depth * map.steps + map.origin_depth[place.side] + slide;
    let above = (key >> TAG_BITS) as f32 - own;
    let bias = (place.tangent * SLOPE_SHARE + 1.0) * (rules.bias * steps_a_pixel);
    let is_own = key & ((1 << TAG_BITS) - 1) == own_tag;
    let needed = if is_own { bias } else { bias * FOREIGN_SHARE };
    let is_there = key != 0;
    let covers = above > needed;
    let hangs = if is_own {
        above > bias * OWN_UNCERTAIN.0 && above < bias * OWN_UNCERTAIN.1
    } else {
        above.abs() < FOREIGN_UNCERTAIN * bias || covers != (above + slide > needed)
    };
    let is_far = is_there && covers && above + bias > rules.max_distance * map.steps;
    Verdict {
        is_open: !(is_there && covers) || is_far,
        is_uncertain: is_there && hangs,
        is_far,
    }
}

fn flat_covers(flat: &FlatView, rules: &Rules, place: &Place) -> bool {
    let at = |[a, b, c]: [f32; 3]| a * place.right + b * place.up + c;
    let inside = flat
        .edges
        .iter()
        .all(|&edge| at(edge) >= -rules.flat_margin);
    let depth = at(flat.depth);
    let above = if place.side == 0 {
        depth - place.depth
    } else {
        -depth - place.depth
    };
    inside && above > rules.flat_margin * place.inverse_cosine && above < rules.max_distance
}
