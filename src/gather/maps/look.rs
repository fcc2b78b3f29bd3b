//! Looks into the maps of one axis: which receivers see past everything. The plain definition, one receiver at a time;
//! [`super::wide`] does the same for sixteen.
//!
//! A receiver's depth is slid along its own tangent plane to the middle of the pixel it falls into: there the map
//! knows the depth, and there the receiver's own surface would be if it were flat. What lies farther than that by more
//! than a bias covers it. The bias is large where the map holds the receiver's own prim from the same side, which is
//! its own patch, curved and coarsely drawn; and small for everything else, so that contact stays dark.

use super::axes::Axis;
use super::crowd::{Block, Sums};
use super::flat::FlatView;
use super::raster::{DepthMap, TAG_BITS};
use glam::Vec3;

/// Below this cosine to the tangent plane a direction counts as lying in it: its weight is nothing, its slope huge.
pub(super) const LEAST_COSINE: f32 = 1e-3;

/// Slope's share in the bias: pixels a tangent, over pixels.
pub(super) const SLOPE_SHARE: f32 = 0.5;

/// Bias towards other surfaces over that towards the own patch.
pub(super) const FOREIGN_SHARE: f32 = 0.05;

/// Own patches deeper than this part of the bias, and up to the second part, make a verdict uncertain.
pub(super) const OWN_UNCERTAIN: (f32, f32) = (0.5, 1.5);

/// Foreign surfaces nearer than this part of the own bias make a verdict uncertain.
pub(super) const FOREIGN_UNCERTAIN: f32 = 0.5;

/// Flat prims nearer than this part of the scene's radius, measured across them, do not cover: rounding. 
const FLAT_MARGIN: f32 = 1e-6;

/// All there is to see along one axis.
#[derive(Debug)]
pub(super) struct View {
    pub(super) axis: Axis,
    pub(super) maps: Vec<DepthMap>,
    pub(super) flats: Vec<FlatView>,
    /// What an open direction adds to the sums: along the axis and against it.
    pub(super) channels: [Vec<f32>; 2],
}

/// What is the same for all axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules {
    /// Bias in pixels.
    pub(super) bias: f32,
    /// Nothing farther covers.
    pub(super) max_distance: f32,
    /// Depth below which flat prims are the receiver's own.
    pub(super) flat_margin: f32,
    /// Sums before this one are weighted by the cosine, later ones are not.
    pub(super) weighted_channels: usize,
}

impl Rules {
    pub(super) fn flat_margin(radius: f32) -> f32 {
        FLAT_MARGIN * radius
    }
}

/// Add what lane `lane` of `block` sees along one axis to its sums.
pub(super) fn look(view: &View, rules: &Rules, block: &Block, lane: usize, sums: &mut Sums) {
    let at = |rows: &[[f32; 16]; 3]| [rows[0][lane], rows[1][lane], rows[2][lane]];
    let place = Place::of(&view.axis, at(&block.position), at(&block.normal));
    let mut is_open = true;
    let mut is_uncertain = false;
    for map in &view.maps {
        let verdict = map_verdict(map, rules, &place, block.tag[lane]);
        is_open &= verdict.is_open;
        is_uncertain |= verdict.is_uncertain;
    }
    for flat in &view.flats {
        is_open &= !flat_covers(flat, rules, &place);
    }
    let seen = if is_open { place.cosine } else { 0.0 };
    sums.weight[lane] += place.cosine;
    sums.open[lane] += seen;
    sums.uncertain[lane] += if is_uncertain { place.cosine } else { 0.0 };
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
    let key = map.keys[2 * (row * map.width + column) as usize + place.side];
    let steps_a_pixel = map.steps / map.pixels;
    let slide_x = (column as f32 + 0.5 - x) * place.slope[0];
    let slide_y = (row as f32 + 0.5 - y) * place.slope[1];
    let own = place.depth * map.steps
        + map.origin_depth[place.side]
        + (slide_x + slide_y) * steps_a_pixel;
    let above = (key >> TAG_BITS) as f32 - own;
    let bias = rules.bias * steps_a_pixel * (1.0 + SLOPE_SHARE * place.tangent);
    let is_own = key & ((1 << TAG_BITS) - 1) == own_tag;
    let needed = if is_own { bias } else { FOREIGN_SHARE * bias };
    let is_there = key != 0;
    let uncertain = if is_own {
        above > OWN_UNCERTAIN.0 * bias && above < OWN_UNCERTAIN.1 * bias
    } else {
        above.abs() < FOREIGN_UNCERTAIN * bias
    };
    let is_far = above > rules.max_distance * map.steps;
    Verdict {
        is_open: !(is_there && above > needed),
        is_uncertain: is_there && (uncertain || is_far),
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
