//! What receivers look at along one axis, and by which rules they are covered. The looks themselves are in
//! [`super::wide`], and spelled out for one receiver in `plain.rs`, which tests hold against it.
//!
//! A receiver's depth is slid along its own tangent plane to the middle of the pixel it falls into: there the map
//! knows the depth, and there the receiver's own surface would be if it were flat. What lies farther than that by more
//! than a bias covers it. The bias is large where the map holds the receiver's own prim from the same side, which is
//! its own patch, curved and coarsely drawn; and small for everything else, so that contact stays dark.

use super::axes::Axis;
use super::flat::FlatView;
use super::raster::DepthMap;
use super::sky::SkyCell;

/// Below this cosine to the tangent plane a direction counts as lying in it: its weight is nothing, its slope huge.
pub(super) const LEAST_COSINE: f32 = 1e-3;

/// Slope's share in the bias: pixels a tangent, over pixels.
pub(super) const SLOPE_SHARE: f32 = 0.5;

/// Bias towards other surfaces over that towards the own patch.
pub(super) const FOREIGN_SHARE: f32 = 0.05;

/// Own patches deeper than this part of the bias, and up to the second part, make a verdict uncertain.
pub(super) const OWN_UNCERTAIN: (f32, f32) = (0.5, 1.5);

/// Foreign surfaces nearer than this part of the own bias make a verdict uncertain. So do those that cover at the
/// middle of the pixel and not without the slide there, or the other way round: what lies inside the pixel matters.
pub(super) const FOREIGN_UNCERTAIN: f32 = 0.5;

/// Flat prims nearer than this part of the scene's radius, measured across them, do not cover: rounding.
const FLAT_MARGIN: f32 = 1e-6;

/// Roundings of a coordinate in the world that flat prims and receivers on them may be apart: one each, on three axes.
const WORLD_ROUNDINGS: f32 = 3.0;

/// All there is to see along one axis.
#[derive(Debug, Default)]
pub(super) struct View {
    pub(super) axis: Axis,
    pub(super) maps: Vec<DepthMap>,
    pub(super) flats: Vec<FlatView>,
    /// What an open direction adds to the sums: along the axis and against it.
    pub(super) channels: [Vec<f32>; 2],
    /// The cells of the sky along the axis and against it, if they are asked for.
    pub(super) sky: Option<[SkyCell; 2]>,
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
    /// `reach`: the largest coordinate of the scene, to which positions in the world are rounded.
    pub(super) fn flat_margin(radius: f32, reach: f32) -> f32 {
        FLAT_MARGIN * radius + WORLD_ROUNDINGS * f32::EPSILON * reach
    }
}
