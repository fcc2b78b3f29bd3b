//! Triangles → two depth maps along one axis: what lies farthest along it, and farthest against it.
//!
//! What one triangle paints is spelled out in `plain.rs`; [`wide`] paints sixteen at a time, to the bit the same.

#[cfg(test)]
mod plain;
mod wide;

use super::axes::Axis;
use super::shell::Shell;
use crate::math::Bounds3;
use fearless_simd::Level;
use glam::{DAffine3, DVec3, Vec3};

/// Bits of a key below the depth: 9 of the prim's index, 1 of the facing.
pub(super) const TAG_BITS: u32 = 10;

/// Largest depth in a key.
const MOST_DEPTH: f32 = (1_u32 << (32 - TAG_BITS)) as f32 - 8.0;

/// Most pixels along one side of a map.
pub(super) const MOST_PIXELS: f32 = 4094.0;

/// Pixels closer than this to a triangle, in pixels, are covered: the rounding of edge functions of triangles that
/// share an edge. Maps keep maxima, so covering a pixel twice does no harm.
const COVER: f32 = 1e-4;

/// A prim's surface seen by receivers and maps: low bits of a key. Prims 512 apart share a tag.
pub(super) fn tag(prim: u32, faces: bool) -> u32 {
    ((prim & 0x1FF) << 1) | u32::from(faces)
}

/// Triangles to draw.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece<'a> {
    pub(super) shell: &'a Shell<'a>,
    pub(super) local_from_object: DAffine3,
    pub(super) prim: u32,
    pub(super) is_solid: bool,
}

/// Depths along an axis and against it, on a grid of pixels across it.
///
/// A key is 0 where nothing is, else depth above tag, so that the larger key is the farther. The outermost pixels are
/// always empty: whoever stands outside looks there.
#[derive(Debug, Default, Clone, PartialEq)]
pub(super) struct DepthMap {
    /// The pixels along the axis, then those against it, rows along the axis' `right`.
    pub(super) keys: Vec<u32>,
    pub(super) width: u32,
    pub(super) height: u32,
    /// Pixels a unit.
    pub(super) pixels: f32,
    /// Pixel of the origin.
    pub(super) origin: [f32; 2],
    /// Depth steps a unit.
    pub(super) steps: f32,
    /// Depth of the origin along the axis and against it, in steps.
    pub(super) origin_depth: [f32; 2],
}

impl DepthMap {
    /// Forget everything, keep the memory, and draw `pieces`, which lie within `bounds`, at `pixel` units a pixel.
    pub(super) fn draw(
        &mut self,
        level: Level,
        pieces: &[Piece<'_>],
        (bounds, pixel): (Bounds3, f32),
        axis: &Axis,
    ) {
        self.clear(bounds, pixel, axis);
        for piece in pieces {
            let brush = self.brush(piece, axis);
            piece
                .shell
                .for_each(|blocks| wide::paint(level, self, &brush, blocks));
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "counts of pixels, a few thousand"
    )]
    fn clear(&mut self, bounds: Bounds3, pixel: f32, axis: &Axis) {
        let center = bounds.center();
        let half = 0.5 * (bounds.max - bounds.min);
        let reach = |v: Vec3| v.abs().dot(half);
        let pixels = 1.0 / pixel;
        let low = |v: Vec3| (center.dot(v) - reach(v)) * pixels;
        let extent = |v: Vec3| (2.0 * reach(v) * pixels).ceil() + 3.0;
        self.width = extent(axis.right) as u32;
        self.height = extent(axis.up) as u32;
        let (middle, depth) = (center.dot(axis.direction), reach(axis.direction));
        let steps = MOST_DEPTH / (2.0 * depth).max(f32::MIN_POSITIVE);
        self.steps = steps.min(MOST_DEPTH * pixels);
        self.keys.clear();
        self.keys.resize(2 * self.side(), 0);
        self.pixels = pixels;
        self.origin = [
            1.0 + axis.shift.x - low(axis.right),
            1.0 + axis.shift.y - low(axis.up),
        ];
        self.origin_depth = [
            (depth - middle) * self.steps + 2.0,
            (depth + middle) * self.steps + 2.0,
        ];
    }

    /// Pixels along the axis, and as many against it.
    pub(super) fn side(&self) -> usize {
        self.width as usize * self.height as usize
    }

    fn brush(&self, piece: &Piece<'_>, axis: &Axis) -> Brush {
        let affine = piece.local_from_object;
        let center = affine.transform_point3(piece.shell.center.as_dvec3());
        let row = |along: Vec3, scale: f32, offset: f32| {
            let along = along.as_dvec3() * f64::from(scale);
            let linear = DVec3::new(
                along.dot(affine.matrix3.x_axis),
                along.dot(affine.matrix3.y_axis),
                along.dot(affine.matrix3.z_axis),
            );
            (
                linear.as_vec3(),
                rounded(along.dot(center) + f64::from(offset)),
            )
        };
        let flips = affine.matrix3.determinant() < 0.0;
        let id = tag(piece.prim, false);
        Brush {
            rows: [
                row(axis.right, self.pixels, self.origin[0]),
                row(axis.up, self.pixels, self.origin[1]),
                row(axis.direction, self.steps, self.origin_depth[0]),
            ],
            top: self.origin_depth[0] + self.origin_depth[1],
            front: id | u32::from(!flips),
            back: id | u32::from(flips),
            is_solid: piece.is_solid,
        }
    }
}

/// What was computed in f64, rounded once.
#[expect(clippy::cast_possible_truncation, reason = "rounding is meant")]
fn rounded(x: f64) -> f32 {
    x as f32
}

/// How the triangles of a piece come into a map.
#[derive(Debug, Clone, Copy)]
struct Brush {
    /// Pixel column, pixel row and depth in steps along the axis, of a point relative to the shell's center.
    rows: [(Vec3, f32); 3],
    /// Depth along the axis plus depth against it, steps.
    top: f32,
    /// Tag of counter-clockwise triangles, as seen against the axis, in the map along it.
    front: u32,
    /// Tag of clockwise ones.
    back: u32,
    /// Only the map that sees the triangle's front is painted.
    is_solid: bool,
}

#[cfg(test)]
mod tests {
    use super::super::axes;
    use super::super::shell::TriangleBlock;
    use super::*;
    use crate::trace::testing::Random;

    /// Triangles from a hundredth of a pixel to a hundred pixels, slivers and points among them.
    fn triangles(random: &mut Random) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let mut positions = Vec::new();
        for i in 0..400_i32 {
            let at = random.vector();
            let size = 10.0_f32.powi(-(i % 5));
            let (e, f) = (size * random.vector(), size * random.vector());
            let corners = match i % 7 {
                0 => [at, at + e, at + e + 1e-3 * f],
                1 => [at; 3],
                _ => [at, at + e, at + f],
            };
            positions.extend(corners);
        }
        let triangles = (0..400).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        (positions, triangles)
    }

    #[test]
    fn sixteen_triangles_at_a_time_paint_bit_for_bit_what_the_definition_paints_at_any_level() {
        let mut random = Random(3);
        let (positions, triangles) = triangles(&mut random);
        let shell = Shell::new(positions, triangles, Vec3::splat(0.1));
        let bounds = Bounds3 {
            min: Vec3::splat(-3.0),
            max: Vec3::splat(3.0),
        };
        let piece = |shell, is_solid, y| Piece {
            shell,
            local_from_object: DAffine3::from_scale_rotation_translation(
                DVec3::new(1.0, y, 1.0),
                glam::DQuat::from_rotation_x(0.3),
                DVec3::new(0.0, 0.1, 0.2),
            ),
            prim: 5,
            is_solid,
        };
        shell.keep_blocks();
        for axis in axes::axes(6) {
            let pieces = [piece(&shell, true, 1.0), piece(&shell, false, -0.7)];
            let mut plainly = DepthMap::default();
            plainly.clear(bounds, 0.05, &axis);
            for piece in &pieces {
                let brush = plainly.brush(piece, &axis);
                piece.shell.for_each(|blocks: &[TriangleBlock]| {
                    for block in blocks {
                        (0..16).for_each(|lane| plain::paint(&mut plainly, &brush, block, lane));
                    }
                });
            }
            assert!(plainly.keys.iter().filter(|&&key| key > 0).count() > 1000);
            for level in [Level::baseline(), Level::new()] {
                let mut widely = DepthMap::default();
                widely.draw(level, &pieces, (bounds, 0.05), &axis);
                assert!(widely == plainly, "{level:?}");
            }
        }
    }

    #[test]
    fn blocks_made_for_each_map_draw_what_kept_ones_draw() {
        let (positions, triangles) = triangles(&mut Random(4));
        let shell = Shell::new(positions, triangles, Vec3::ZERO);
        let bounds = Bounds3 {
            min: Vec3::splat(-3.0),
            max: Vec3::splat(3.0),
        };
        let axis = axes::axes(3)[1];
        let draw = |shell: &Shell<'_>| {
            let piece = Piece {
                shell,
                local_from_object: DAffine3::IDENTITY,
                prim: 0,
                is_solid: false,
            };
            let mut map = DepthMap::default();
            map.draw(Level::new(), &[piece], (bounds, 0.02), &axis);
            map
        };
        let made = draw(&shell);
        shell.keep_blocks();
        assert!(draw(&shell) == made);
    }
}
