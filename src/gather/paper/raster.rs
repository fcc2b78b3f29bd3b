//! The raster cube of one receiver: elements are drawn from near to far, each fills what is left of its pixels.

use super::pixels::{FACES, Face, OpenPixel, PixelTable};
use crate::gather::Hemisphere;
use glam::{Vec2, Vec3};

/// An element whose center projects farther out than this on the plane of a face is not drawn there: the projection of
/// its moments is linear about the center and means nothing near the plane's horizon. What is drawn as a rectangle
/// covers at most about 0.1 sr, so reaches no farther than about 1.6 from its own face onto the next.
const FARTHEST_OUTSIDE: f32 = 1.6;

/// Elements are drawn this much too dense: the neighbours on a wall overlap and leave gaps, the clamp cuts off the
/// overlaps, and the gaps would leak. Visibility in a Cornell box at 0.03 sr and 12² pixels is 5.9 % too bright at 1.0
/// (walls turned against the rasters), see tests/octree.rs.
const GAP_FILL: f32 = 1.1;

/// An element as one receiver sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Splat {
    /// Center, from the receiver.
    pub offset: Vec3,
    /// Length of `offset`.
    pub distance: f32,
    pub reflected: Vec3,
    pub emitted: Vec3,
    /// Overlaps what is before it at random, instead of filling what that left.
    pub is_scattered: bool,
    pub shape: Shape,
}

/// How an element is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shape {
    /// A rectangle along the pixel grid with the element's projected second moments.
    Rectangle {
        projected_area: f32,
        /// xx, yy, zz, xy, xz, yz.
        covariance: [f32; 6],
    },
    /// A disk, ray cast through the middle of each pixel.
    Disk { normal: Vec3, radius: f32 },
}

/// A rectangle on the plane of a face, whose pixels fill −1…1.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Footprint {
    center: Vec2,
    half_size: Vec2,
    /// Share of the rectangle that is covered, times [`GAP_FILL`]. Where `area / rectangle` layers overlap at random,
    /// exp(−layers) of it stays open.
    density: f32,
}

/// What the pixels of the cube hold.
#[derive(Debug, Clone)]
pub(super) struct RasterCube {
    coverage: Vec<f32>,
    /// Sum of distance · coverage.
    distance: Vec<f32>,
    reflected: Vec<Vec3>,
    emitted: Vec<Vec3>,
}

impl RasterCube {
    pub(super) fn new(pixel_count: usize) -> Self {
        Self {
            coverage: vec![0.0; pixel_count],
            distance: vec![0.0; pixel_count],
            reflected: vec![Vec3::ZERO; pixel_count],
            emitted: vec![Vec3::ZERO; pixel_count],
        }
    }

    pub(super) fn clear(&mut self) {
        self.coverage.fill(0.0);
        self.distance.fill(0.0);
        self.reflected.fill(Vec3::ZERO);
        self.emitted.fill(Vec3::ZERO);
    }

    /// Draw `splat` behind what is there.
    pub(super) fn draw(&mut self, table: &PixelTable, splat: &Splat) {
        for (index, face) in FACES.iter().enumerate() {
            match splat.shape {
                Shape::Rectangle {
                    projected_area,
                    covariance,
                } => {
                    if let Some(footprint) = footprint(face, splat, projected_area, &covariance) {
                        self.fill(table, index, &footprint, splat);
                    }
                }
                Shape::Disk { normal, radius } => {
                    self.cast(table, index, (normal, radius), splat);
                }
            }
        }
    }

    /// Fill the pixels that `footprint` overlaps, each in proportion.
    fn fill(&mut self, table: &PixelTable, face: usize, footprint: &Footprint, splat: &Splat) {
        let k = table.resolution();
        let to_pixels = 0.5 * k as f32;
        let low = (footprint.center - footprint.half_size + 1.0) * to_pixels;
        let high = (footprint.center + footprint.half_size + 1.0) * to_pixels;
        for row in pixel_range(low.y, high.y, k) {
            let rows = overlap(low.y, high.y, row) * footprint.density;
            for column in pixel_range(low.x, high.x, k) {
                let pixel = (face * k + row) * k + column;
                self.add(
                    pixel,
                    rows * overlap(low.x, high.x, column),
                    splat.distance,
                    splat,
                );
            }
        }
    }

    /// Fill the pixels whose middle ray meets the disk.
    fn cast(&mut self, table: &PixelTable, face: usize, disk: (Vec3, f32), splat: &Splat) {
        let (normal, radius) = disk;
        let k = table.resolution();
        let (rows, columns) = disk_pixels(&FACES[face], splat.offset, radius, k);
        let height = normal.dot(splat.offset);
        for row in rows {
            for column in columns.clone() {
                let pixel = (face * k + row) * k + column;
                let ray = table.center(pixel);
                let along = height / normal.dot(ray);
                let hit = ray * along;
                if along > 0.0 && hit.distance_squared(splat.offset) <= radius * radius {
                    self.add(pixel, 1.0, hit.length(), splat);
                }
            }
        }
    }

    /// Cover up to `coverage` of what is left of the pixel.
    fn add(&mut self, pixel: usize, coverage: f32, distance: f32, splat: &Splat) {
        let left = 1.0 - self.coverage[pixel];
        let share = if splat.is_scattered {
            coverage.min(1.0) * left
        } else {
            coverage.min(left)
        };
        if share > 0.0 {
            self.coverage[pixel] += share;
            self.distance[pixel] += distance * share;
            self.reflected[pixel] += splat.reflected * share;
            self.emitted[pixel] += splat.emitted * share;
        }
    }

    /// Write what the pixels hold into `hemisphere`, made of the same `open` pixels.
    pub(super) fn read(&self, open: &[OpenPixel], hemisphere: &mut Hemisphere) {
        for (i, &OpenPixel { pixel, .. }) in open.iter().enumerate() {
            let drawn = self.coverage[pixel].min(1.0);
            if drawn > 0.0 {
                let coverage = true_coverage(drawn);
                let share = coverage / drawn;
                hemisphere.coverage[i] = coverage;
                hemisphere.distance[i] = self.distance[pixel] / drawn;
                hemisphere.reflected[i] = self.reflected[pixel] * share;
                hemisphere.emitted[i] = self.emitted[pixel] * share;
            }
        }
    }
}

/// What a pixel filled to `drawn` (0…1) with [`GAP_FILL`] stands for: a full one is full, an isolated element in an
/// emptier one has its own area and power again.
fn true_coverage(drawn: f32) -> f32 {
    (drawn / GAP_FILL).max(2.0 * drawn - 1.0)
}

/// Project an element onto the plane of `face`; `None` behind or beside it. A uniform rectangle of half size h has the
/// variance h²/3; what of its area the element does not fill makes its density.
fn footprint(
    face: &Face,
    splat: &Splat,
    projected_area: f32,
    covariance: &[f32; 6],
) -> Option<Footprint> {
    let depth = face.axis.dot(splat.offset);
    if depth <= 0.0 {
        return None;
    }
    let center = Vec2::new(face.u.dot(splat.offset), face.v.dot(splat.offset)) / depth;
    let half = |axis: Vec3, coordinate: f32| {
        let gradient = (axis - face.axis * coordinate) / depth;
        (3.0 * quadratic_form(covariance, gradient).max(0.0)).sqrt()
    };
    let half_size = Vec2::new(half(face.u, center.x), half(face.v, center.y));
    let is_beside = (center.abs() - half_size).max_element() >= 1.0;
    if is_beside || center.abs().max_element() > FARTHEST_OUTSIDE {
        return None;
    }
    let area = projected_area * splat.distance / depth.powi(3);
    let rectangle = 4.0 * half_size.x * half_size.y;
    (rectangle > 0.0).then(|| Footprint {
        center,
        half_size,
        density: if splat.is_scattered {
            -GAP_FILL * (-area / rectangle).exp_m1()
        } else {
            GAP_FILL * (area / rectangle).min(1.0)
        },
    })
}

/// `v`ᵀ · `matrix` · `v`.
fn quadratic_form(matrix: &[f32; 6], v: Vec3) -> f32 {
    let [xx, yy, zz, xy, xz, yz] = *matrix;
    xx * v.x * v.x
        + yy * v.y * v.y
        + zz * v.z * v.z
        + 2.0 * (xy * v.x * v.y + xz * v.x * v.z + yz * v.y * v.z)
}

/// Rows and columns of `face` that the ball about `offset` may touch: all when it reaches behind the face's plane.
fn disk_pixels(
    face: &Face,
    offset: Vec3,
    radius: f32,
    k: usize,
) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
    let depth = face.axis.dot(offset);
    if depth + radius <= 0.0 {
        return (0..0, 0..0);
    }
    let range = |axis: Vec3| {
        let coordinate = axis.dot(offset);
        if depth <= radius {
            return 0..k;
        }
        let bound = |edge: f32, toward_far: bool| {
            edge / if toward_far {
                depth + radius
            } else {
                depth - radius
            }
        };
        let (low, high) = (coordinate - radius, coordinate + radius);
        let (low, high) = (bound(low, low > 0.0), bound(high, high < 0.0));
        pixel_range(
            (low + 1.0) * 0.5 * k as f32,
            (high + 1.0) * 0.5 * k as f32,
            k,
        )
    };
    (range(face.v), range(face.u))
}

/// The pixels 0…k−1 that the interval from `low` to `high`, in pixels, overlaps.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "saturating casts clip to the face"
)]
fn pixel_range(low: f32, high: f32, k: usize) -> std::ops::Range<usize> {
    low.floor() as usize..(high.ceil() as usize).min(k)
}

/// Length of `pixel` that the interval covers.
fn overlap(low: f32, high: f32, pixel: usize) -> f32 {
    let start = pixel as f32;
    (high.min(start + 1.0) - low.max(start)).max(0.0)
}
