//! Which element is seen in which pixel: disks as the ellipses they are, triangles, nearest first.
//!
//! Rows are worked on in bands, each by one thread with the elements that reach into it, in their order: the same picture for
//! any number of threads.

use super::subject::{Shape, Subject};
use crate::receivers::lens::Lens;
use glam::{DMat4, DVec4, Vec2, Vec3};
use rayon::prelude::*;

/// Rows of a band.
const BAND: usize = 32;

/// Disks with a radius below this many pixels are drawn as the pixel at their center, lest they fall between centers.
const SMALLEST: f32 = 0.75;

/// No element of a pixel.
pub(super) const NOTHING: u32 = u32::MAX;

/// What a pixel shows: a disk, or a place on a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Seen {
    /// Index of the disk or triangle, or [`NOTHING`].
    pub(super) index: u32,
    /// Weights of the triangle's second and third corner.
    pub(super) weights: Vec2,
    /// Distance along the viewing axis.
    pub(super) depth: f32,
}

/// Which sides of disks are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SidesShown {
    /// Disks that face the camera.
    Front,
    /// All.
    Both,
}

/// From camera space to pixels and back.
struct View {
    /// Pixels.
    size: Vec2,
    /// Pixel = `scale` · (slope or position) + `offset`.
    scale: Vec2,
    offset: Vec2,
    is_perspective: bool,
    near: f32,
}

/// An element in camera space, looking along −Z.
enum Element {
    Disk {
        center: Vec3,
        normal: Option<Vec3>,
        radius: f32,
    },
    Triangle([Vec3; 3]),
}

/// Rows from the top, `size.0` pixels each.
pub(super) fn rasterize(
    subject: &Subject,
    lens: &Lens,
    size: (usize, usize),
    sides: SidesShown,
) -> Vec<Seen> {
    let view = View::new(lens, size);
    let elements = in_camera_space(subject, lens, sides);
    let reaches: Vec<Option<Reach>> = elements
        .par_iter()
        .map(|element| view.reach(element.as_ref()?, size))
        .collect();
    let bands = size.1.div_ceil(BAND);
    let mut lists: Vec<Vec<u32>> = vec![Vec::new(); bands];
    for (index, reach) in (0..).zip(&reaches) {
        if let Some(reach) = reach {
            for list in &mut lists[reach.rows.0 / BAND..=reach.rows.1 / BAND] {
                list.push(index);
            }
        }
    }
    let rows: Vec<Vec<Seen>> = lists
        .par_iter()
        .enumerate()
        .map(|(band, list)| {
            let rows = (band * BAND, ((band + 1) * BAND).min(size.1));
            let mut target = Band::new(rows, size.0);
            for &index in list {
                let at = index as usize;
                if let (Some(element), Some(reach)) = (&elements[at], &reaches[at]) {
                    target.draw(index, element, (reach, &view));
                }
            }
            target.seen
        })
        .collect();
    rows.concat()
}

fn in_camera_space(subject: &Subject, lens: &Lens, sides: SidesShown) -> Vec<Option<Element>> {
    let camera = lens.world_to_camera() * DMat4::from_translation(subject.origin);
    let place = |p: Vec3| camera.transform_point3(p.as_dvec3()).as_vec3();
    match &subject.shape {
        Shape::Triangles(triangles) => triangles
            .par_iter()
            .map(|t| {
                Some(Element::Triangle(
                    t.map(|i| place(subject.positions[i as usize])),
                ))
            })
            .collect(),
        Shape::Disks(radii) => {
            let is_perspective = View::new(lens, (1, 1)).is_perspective;
            let disk = |i: usize| {
                let center = place(subject.positions[i]);
                let normal = subject
                    .normals
                    .as_ref()
                    .map(|normals| camera.transform_vector3(normals[i].as_dvec3()).as_vec3());
                let normal = normal.filter(|normal| *normal != Vec3::ZERO);
                let to_camera = if is_perspective { -center } else { Vec3::Z };
                let faces = normal.is_none_or(|normal| normal.dot(to_camera) > 0.0);
                (faces || sides == SidesShown::Both).then_some(Element::Disk {
                    center,
                    normal,
                    radius: radii[i],
                })
            };
            (0..subject.len()).into_par_iter().map(disk).collect()
        }
    }
}

/// Pixels that an element may cover.
struct Reach {
    columns: (usize, usize),
    rows: (usize, usize),
}

impl View {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        reason = "pixels and slopes in single precision"
    )]
    fn new(lens: &Lens, size: (usize, usize)) -> Self {
        let ndc = lens.world_to_ndc() * lens.world_to_camera().inverse();
        let at = |x: f64, y: f64| {
            let p = ndc * DVec4::new(x, y, -1.0, 1.0);
            (p.truncate().truncate() / p.w).as_vec2()
        };
        let size = Vec2::new(size.0 as f32, size.1 as f32);
        let offset = at(0.0, 0.0);
        Self {
            size,
            scale: (at(1.0, 1.0) - offset) * size,
            offset: offset * size,
            is_perspective: (ndc * DVec4::NEG_Z).w != 0.0,
            near: (lens.near_distance() as f32).max(f32::MIN_POSITIVE),
        }
    }

    fn pixel(&self, p: Vec3) -> Vec2 {
        let on_plane = p.truncate();
        let slope = if self.is_perspective {
            on_plane / -p.z
        } else {
            on_plane
        };
        slope * self.scale + self.offset
    }

    /// Origin and direction of the ray through a pixel's center; the direction goes 1 along the axis.
    #[expect(clippy::cast_precision_loss, reason = "pixels of an image")]
    fn ray(&self, x: usize, y: usize) -> (Vec3, Vec3) {
        let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        let slope = (pixel - self.offset) / self.scale;
        match self.is_perspective {
            true => (Vec3::ZERO, slope.extend(-1.0)),
            false => (slope.extend(0.0), Vec3::NEG_Z),
        }
    }

    fn reach(&self, element: &Element, size: (usize, usize)) -> Option<Reach> {
        let (low, high) = match element {
            Element::Disk { center, radius, .. } => self.around_ball(*center, *radius)?,
            Element::Triangle(corners) => self.around_triangle(corners)?,
        };
        let last = |size: usize| size.checked_sub(1);
        let columns = covered((low.x, high.x), last(size.0)?)?;
        let rows = covered((low.y, high.y), last(size.1)?)?;
        Some(Reach { columns, rows })
    }

    fn around_ball(&self, center: Vec3, radius: f32) -> Option<(Vec2, Vec2)> {
        let depth = -center.z;
        if depth + radius <= self.near {
            return None;
        }
        if !self.is_perspective {
            let middle = self.pixel(center);
            let reach = (radius * self.scale).abs().max(Vec2::splat(SMALLEST));
            return Some((middle - reach, middle + reach));
        }
        if depth - radius <= self.near {
            return Some((Vec2::ZERO, self.size));
        }
        let corners = [(-1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (1.0, -1.0)];
        let corners = corners.into_iter().flat_map(|(x, y)| {
            [radius, -radius].map(|z| self.pixel(center + Vec3::new(x * radius, y * radius, z)))
        });
        let middle = self.pixel(center);
        let smallest = Vec2::splat(SMALLEST);
        let start = (middle - smallest, middle + smallest);
        Some(corners.fold(start, |(low, high), p| (low.min(p), high.max(p))))
    }

    fn around_triangle(&self, corners: &[Vec3; 3]) -> Option<(Vec2, Vec2)> {
        let mut bounds: Option<(Vec2, Vec2)> = None;
        let mut include = |p: Vec2| {
            let (low, high) = bounds.unwrap_or((p, p));
            bounds = Some((low.min(p), high.max(p)));
        };
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let (da, db) = (-a.z - self.near, -b.z - self.near);
            if da >= 0.0 {
                include(self.pixel(a));
            }
            if (da < 0.0) != (db < 0.0) {
                let mut cut = a.lerp(b, da / (da - db));
                cut.z = -self.near;
                include(self.pixel(cut));
            }
        }
        bounds
    }
}

/// First and last pixel whose center may lie between `low` and `high`; `None` outside the image.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "clamped to the image; NaN becomes 0"
)]
fn covered((low, high): (f32, f32), last: usize) -> Option<(usize, usize)> {
    if !(high >= 0.0 && low <= last as f32 + 1.0) {
        return None;
    }
    let clamp = |x: f32| (x.max(0.0) as usize).min(last);
    Some((clamp((low - 0.5).floor()), clamp(high.ceil())))
}

/// Rows being drawn.
struct Band {
    first_row: usize,
    end_row: usize,
    width: usize,
    seen: Vec<Seen>,
}

impl Band {
    fn new((first_row, end_row): (usize, usize), width: usize) -> Self {
        let nothing = Seen {
            index: NOTHING,
            weights: Vec2::ZERO,
            depth: f32::INFINITY,
        };
        Self {
            first_row,
            end_row,
            width,
            seen: vec![nothing; (end_row - first_row) * width],
        }
    }

    fn draw(&mut self, index: u32, element: &Element, (reach, view): (&Reach, &View)) {
        let rows = reach.rows.0.max(self.first_row)..(reach.rows.1 + 1).min(self.end_row);
        let dot = element.dot(view);
        for y in rows {
            for x in reach.columns.0..=reach.columns.1 {
                let (origin, direction) = view.ray(x, y);
                let hit = match dot {
                    Some((pixel, depth)) => (pixel == (x, y)).then_some((depth, Vec2::ZERO)),
                    None => element.hit(origin, direction),
                };
                let Some((depth, weights)) = hit else {
                    continue;
                };
                let seen = &mut self.seen[(y - self.first_row) * self.width + x];
                if depth > view.near && depth < seen.depth {
                    *seen = Seen {
                        index,
                        weights,
                        depth,
                    };
                }
            }
        }
    }
}

impl Element {
    /// Pixel and depth of a disk that is too small to hit pixels' centers.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "pixels left or above of the image are none of the reach anyway"
    )]
    fn dot(&self, view: &View) -> Option<((usize, usize), f32)> {
        let Self::Disk { center, radius, .. } = self else {
            return None;
        };
        let depth = -center.z;
        let distance = if view.is_perspective { depth } else { 1.0 };
        let pixels = radius * view.scale.abs().max_element() / distance;
        let pixel = view.pixel(*center);
        let is_dot = depth > view.near && pixels < SMALLEST && pixel.min_element() >= 0.0;
        is_dot.then_some(((pixel.x as usize, pixel.y as usize), depth))
    }

    /// Depth and weights where a ray meets it.
    fn hit(&self, origin: Vec3, direction: Vec3) -> Option<(f32, Vec2)> {
        match self {
            Self::Triangle([a, b, c]) => {
                let (u, v) = (*b - *a, *c - *a);
                let p = direction.cross(v);
                let determinant = u.dot(p);
                if determinant == 0.0 {
                    return None;
                }
                let from = origin - *a;
                let x = from.dot(p) / determinant;
                let q = from.cross(u);
                let y = direction.dot(q) / determinant;
                let inside = x >= 0.0 && y >= 0.0 && x + y <= 1.0;
                inside.then(|| (v.dot(q) / determinant, Vec2::new(x, y)))
            }
            Self::Disk {
                center,
                normal,
                radius,
            } => {
                let normal = normal.unwrap_or_else(|| {
                    if origin == Vec3::ZERO {
                        *center
                    } else {
                        Vec3::Z
                    }
                });
                let slope = normal.dot(direction);
                if slope == 0.0 {
                    return None;
                }
                let depth = normal.dot(*center - origin) / slope;
                let off = origin + direction * depth - *center;
                (off.length_squared() <= radius * radius).then_some((depth, Vec2::ZERO))
            }
        }
    }
}
