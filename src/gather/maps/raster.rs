//! Triangles → two depth maps along one axis: what lies farthest along it, and farthest against it.

use super::axes::Axis;
use super::decimate::Shell;
use crate::math::Bounds3;
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

/// Depths along an axis (first of a pair) and against it (second), on a grid of pixels across it.
///
/// A key is 0 where nothing is, else depth above tag, so that the larger key is the farther. The outermost pixels are
/// always empty: whoever stands outside looks there.
#[derive(Debug)]
pub(super) struct DepthMap {
    /// Two a pixel, rows along the axis' `right`.
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

/// A corner in pixels and depth steps.
type Corner = [f32; 3];

impl DepthMap {
    /// Draw `pieces`, which lie within `bounds`, at `pixel` units a pixel.
    pub(super) fn draw(pieces: &[Piece<'_>], bounds: Bounds3, pixel: f32, axis: &Axis) -> Self {
        let mut map = Self::empty(bounds, pixel, axis);
        let mut corners = Vec::new();
        for piece in pieces {
            map.project(piece, axis, &mut corners);
            let flips = piece.local_from_object.matrix3.determinant() < 0.0;
            let id = tag(piece.prim, false);
            let painter = Painter {
                front: id | u32::from(!flips),
                back: id | u32::from(flips),
                is_solid: piece.is_solid,
            };
            for t in piece.shell.triangles.iter() {
                map.triangle(t.map(|i| corners[i as usize]), painter);
            }
        }
        map
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "counts of pixels, a few thousand"
    )]
    fn empty(bounds: Bounds3, pixel: f32, axis: &Axis) -> Self {
        let center = bounds.center();
        let half = 0.5 * (bounds.max - bounds.min);
        let reach = |v: Vec3| v.abs().dot(half);
        let pixels = 1.0 / pixel;
        let low = |v: Vec3| (center.dot(v) - reach(v)) * pixels;
        let extent = |v: Vec3| (2.0 * reach(v) * pixels).ceil() + 3.0;
        let (width, height) = (extent(axis.right) as u32, extent(axis.up) as u32);
        let (middle, depth) = (center.dot(axis.direction), reach(axis.direction));
        let steps = MOST_DEPTH / (2.0 * depth).max(f32::MIN_POSITIVE);
        let steps = steps.min(MOST_DEPTH * pixels);
        Self {
            keys: vec![0; 2 * width as usize * height as usize],
            width,
            height,
            pixels,
            origin: [
                1.0 + axis.shift.x - low(axis.right),
                1.0 + axis.shift.y - low(axis.up),
            ],
            steps,
            origin_depth: [
                (depth - middle) * steps + 2.0,
                (depth + middle) * steps + 2.0,
            ],
        }
    }

    fn project(&self, piece: &Piece<'_>, axis: &Axis, corners: &mut Vec<Corner>) {
        let row = |along: Vec3, scale: f32, offset: f32| {
            let along = along.as_dvec3() * f64::from(scale);
            let matrix = piece.local_from_object.matrix3;
            let linear = DVec3::new(
                along.dot(matrix.x_axis),
                along.dot(matrix.y_axis),
                along.dot(matrix.z_axis),
            );
            let constant = along.dot(piece.local_from_object.translation) + f64::from(offset);
            (linear.as_vec3(), rounded(constant))
        };
        let x = row(axis.right, self.pixels, self.origin[0]);
        let y = row(axis.up, self.pixels, self.origin[1]);
        let z = row(axis.direction, self.steps, self.origin_depth[0]);
        let place = |&p: &Vec3| [x, y, z].map(|(linear, constant)| linear.dot(p) + constant);
        corners.clear();
        corners.extend(piece.shell.positions.iter().map(place));
    }

    /// Draw one triangle.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "pixel indices and depth steps within the map"
    )]
    #[inline]
    fn triangle(&mut self, [a, b, c]: [Corner; 3], painter: Painter) {
        let low = |k: usize| (a[k].min(b[k]).min(c[k]) - 0.5).max(0.0).ceil();
        let high = |k: usize| a[k].max(b[k]).max(c[k]) - 0.5;
        let (x0, x1, y0, y1) = (low(0), high(0), low(1), high(1));
        if x0 > x1 || y0 > y1 {
            return;
        }
        let Some(plane) = Plane::of([a, b, c]) else {
            return;
        };
        let paint = painter.paint(plane.faces);
        let top = self.origin_depth[0] + self.origin_depth[1];
        let (columns, rows) = (self.width - 1, self.height - 1);
        let (x0, x1) = (x0 as u32, (x1 as u32).min(columns));
        for y in y0 as u32..=(y1 as u32).min(rows) {
            let row = 2 * (y * self.width) as usize;
            for x in x0..=x1 {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                if !plane.covers(px, py) {
                    continue;
                }
                let depth = plane.depth(px, py);
                let pair = &mut self.keys[row + 2 * x as usize..][..2];
                if let Some(tag) = paint.along {
                    pair[0] = pair[0].max((depth as u32) << TAG_BITS | tag);
                }
                if let Some(tag) = paint.against {
                    pair[1] = pair[1].max(((top - depth) as u32) << TAG_BITS | tag);
                }
            }
        }
    }
}

/// What was computed in f64, rounded once.
#[expect(clippy::cast_possible_truncation, reason = "rounding is meant")]
fn rounded(x: f64) -> f32 {
    x as f32
}

/// Tags of a prim's triangles.
#[derive(Debug, Clone, Copy)]
struct Painter {
    /// Seen from its front side.
    front: u32,
    /// Seen from its back.
    back: u32,
    is_solid: bool,
}

/// Tags to write for one triangle, `None` for nothing.
#[derive(Debug, Clone, Copy)]
struct Paint {
    along: Option<u32>,
    against: Option<u32>,
}

impl Painter {
    /// `faces`: counter-clockwise as seen against the axis.
    fn paint(self, faces: bool) -> Paint {
        let (along, against) = if faces {
            (self.front, self.back)
        } else {
            (self.back, self.front)
        };
        let shows = |tag: u32| (!self.is_solid || tag & 1 == 1).then_some(tag);
        Paint {
            along: shows(along),
            against: shows(against),
        }
    }
}

/// A triangle's edge functions and depth over the pixels.
#[derive(Debug, Clone, Copy)]
struct Plane {
    a: Corner,
    /// Edge vectors from each corner to the next, with the turning of the triangle made positive.
    corners: [Corner; 3],
    slope: [f32; 2],
    range: [f32; 2],
    /// Edge functions down to minus this count as inside.
    slack: f32,
    faces: bool,
}

impl Plane {
    fn of([a, b, c]: [Corner; 3]) -> Option<Self> {
        let (ux, uy, uz) = (b[0] - a[0], b[1] - a[1], b[2] - a[2]);
        let (vx, vy, vz) = (c[0] - a[0], c[1] - a[1], c[2] - a[2]);
        let area = ux * vy - uy * vx;
        if area == 0.0 {
            return None;
        }
        let faces = area > 0.0;
        Some(Self {
            a,
            corners: if faces { [a, b, c] } else { [a, c, b] },
            slope: [(uz * vy - vz * uy) / area, (vz * ux - uz * vx) / area],
            range: [a[2].min(b[2]).min(c[2]), a[2].max(b[2]).max(c[2])],
            slack: COVER * (1.0 + ux.abs() + uy.abs() + vx.abs() + vy.abs()),
            faces,
        })
    }

    #[inline]
    fn covers(&self, x: f32, y: f32) -> bool {
        (0..3).all(|k| {
            let (p, q) = (self.corners[k], self.corners[(k + 1) % 3]);
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) >= -self.slack
        })
    }

    #[inline]
    fn depth(&self, x: f32, y: f32) -> f32 {
        let depth = self.a[2] + self.slope[0] * (x - self.a[0]) + self.slope[1] * (y - self.a[1]);
        depth.clamp(self.range[0], self.range[1])
    }
}
