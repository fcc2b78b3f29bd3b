//! Light that areas send to receivers: computed, not sampled.
//!
//! Plain loops over lanes, compiled once for every instruction set; no operation is fused or reordered, so the bits are
//! the same on all of them.

use super::group::Group;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

const LANES: usize = 16;

/// A small area that shines.
#[derive(Debug, Clone, Copy)]
pub(super) struct Area {
    pub(super) position: Vec3,
    /// Unit; of length 0 for one that looks alike from everywhere.
    pub(super) normal: Vec3,
    /// True area, or the projected one where there is no normal.
    pub(super) area: f32,
    /// Reflected radiance.
    pub(super) light: Vec3,
}

impl Area {
    /// Cosine-weighted solid angle of it as seen from `position` with unit `normal`, sr; 0 beyond `max_distance`.
    pub(super) fn seen_from(&self, position: Vec3, normal: Vec3, max_distance: f32) -> f32 {
        let offset = self.position - position;
        solid_angle(
            (offset.to_array(), normal.to_array()),
            (self.normal.to_array(), self.area),
            max_distance * max_distance,
        )
    }
}

/// Areas by component.
#[derive(Debug, Clone)]
struct Row {
    position: [[f32; LANES]; 3],
    normal: [[f32; LANES]; 3],
    area: [f32; LANES],
    /// Of disks as large, the largest: what is higher than that over a horizon is not cut by it.
    radius: f32,
    /// True if all have a normal.
    is_flat: bool,
    light: [[f32; LANES]; 3],
}

/// Irradiance of all receivers of `group` from `areas`, none of them hidden.
#[inline(always)]
pub(super) fn irradiance(group: &Group, areas: &[Area], max_distance: f32) -> Vec<Vec3> {
    let rows: Vec<Row> = areas.chunks(LANES).map(row).collect();
    let squared = max_distance * max_distance;
    let mut sums = Vec::with_capacity(group.len());
    for (place, normal) in group.positions.iter().zip(&group.normals) {
        let mut sum = [[0.0; LANES]; 3];
        for row in &rows {
            add(row, (place, normal), squared, &mut sum);
        }
        sums.push(Vec3::from(sum.map(|lanes| lanes.iter().sum::<f32>())));
    }
    sums
}

/// Adds what a receiver gets from the areas of a row to its `sum`, lane by lane.
#[expect(
    clippy::needless_range_loop,
    reason = "lanes run through nine arrays at once"
)]
#[inline(always)]
fn add(row: &Row, (place, normal): (&Vec3, &Vec3), max_squared: f32, sum: &mut [[f32; LANES]; 3]) {
    let [mut squared, mut height, mut depth, mut seen] = [[0.0_f32; LANES]; 4];
    let mut lowest = [f32::INFINITY; LANES];
    for lane in 0..LANES {
        let x = row.position[0][lane] - place.x;
        let y = row.position[1][lane] - place.y;
        let z = row.position[2][lane] - place.z;
        squared[lane] = x * x + y * y + z * z;
        height[lane] = normal.x * x + normal.y * y + normal.z * z;
        depth[lane] =
            -(row.normal[0][lane] * x + row.normal[1][lane] * y + row.normal[2][lane] * z);
        lowest[lane] = height[lane];
    }
    let lowest = lowest.into_iter().fold(f32::INFINITY, f32::min);
    if lowest >= row.radius && row.is_flat {
        for lane in 0..LANES {
            seen[lane] = point_to_point((row.area[lane], depth[lane]), height[lane], squared[lane]);
        }
    } else {
        for lane in 0..LANES {
            let facing = row.normal.map(|component| component[lane]);
            let tilt = normal.x * facing[0] + normal.y * facing[1] + normal.z * facing[2];
            seen[lane] = cut_by_horizon(
                (row.area[lane], depth[lane], facing),
                (height[lane], tilt),
                squared[lane],
            );
        }
    }
    for lane in 0..LANES {
        let is_within = squared[lane] > 0.0 && squared[lane] < max_squared;
        let seen = if is_within { seen[lane] } else { 0.0 };
        for axis in 0..3 {
            sum[axis][lane] += row.light[axis][lane] * seen;
        }
    }
}

/// Up to [`LANES`] areas; the rest have none.
fn row(areas: &[Area]) -> Row {
    let component = |value: fn(&Area) -> Vec3, axis: usize| {
        std::array::from_fn(|lane| value(&areas[lane.min(areas.len() - 1)])[axis])
    };
    let vector = |value| [0, 1, 2].map(|axis| component(value, axis));
    let radius = |area: &Area| (area.area * FRAC_1_PI).sqrt();
    Row {
        position: vector(|area| area.position),
        normal: vector(|area| area.normal),
        area: std::array::from_fn(|lane| areas.get(lane).map_or(0.0, |area| area.area)),
        radius: areas.iter().map(radius).fold(0.0, f32::max),
        is_flat: areas.iter().all(|area| area.normal != Vec3::ZERO),
        light: vector(|area| area.light),
    }
}

/// Cosine-weighted solid angle of an area at `offset`, seen above the horizon of `normal`.
#[inline(always)]
fn solid_angle(
    (offset, normal): ([f32; 3], [f32; 3]),
    (facing, area): ([f32; 3], f32),
    max_squared: f32,
) -> f32 {
    let squared = dot(offset, offset);
    let depth = -dot(facing, offset);
    let seen = cut_by_horizon(
        (area, depth, facing),
        (dot(normal, offset), dot(normal, facing)),
        squared,
    );
    let is_within = squared > 0.0 && squared < max_squared;
    if is_within { seen } else { 0.0 }
}

/// A cos cos / d² of an area with a normal, all of which is above the horizon: `depth` and `height` are the cosines times
/// the distance.
#[inline(always)]
fn point_to_point((area, depth): (f32, f32), height: f32, squared: f32) -> f32 {
    let depth = if depth > 0.0 { depth } else { 0.0 };
    area * depth * height / (squared * squared)
}

/// The same of any area, part of which may be below: one that the horizon cuts is as high as a square, of which the part
/// above counts.
#[inline(always)]
fn cut_by_horizon(
    (area, depth, facing): (f32, f32, [f32; 3]),
    (height, tilt): (f32, f32),
    squared: f32,
) -> f32 {
    let is_flat = dot(facing, facing) > 0.0;
    let depth = if is_flat { depth } else { squared.sqrt() };
    let tilt = if is_flat {
        tilt * tilt
    } else {
        height * height / squared
    };
    let across = if tilt < 1.0 { 1.0 - tilt } else { 0.0 };
    let reach = (area * across * FRAC_1_PI).sqrt();
    let above = height + reach;
    let cut = above * above / (4.0 * reach);
    let cut = if above > 0.0 { cut } else { 0.0 };
    let height = if height >= reach { height } else { cut };
    point_to_point((area, depth), height, squared)
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::super::windows::{Sizes, Windows};
    use super::*;
    use crate::gather::testing::receivers_at;
    use crate::math::solid_angle::disk_form_factor;
    use crate::trace::Tracer;
    use fearless_simd::{Level, dispatch};
    use std::f32::consts::PI;

    fn disk(position: Vec3, normal: Vec3, radius: f32) -> Area {
        Area {
            position,
            normal,
            area: PI * radius * radius,
            light: Vec3::new(1.0, 2.0, 4.0),
        }
    }

    #[test]
    fn a_small_disk_overhead_has_its_form_factor() {
        let small = disk(Vec3::Y * 2.0, Vec3::NEG_Y, 0.1);
        let seen = small.seen_from(Vec3::ZERO, Vec3::Y, f32::INFINITY);
        // The disk of 1/20 rad is taken for a point: r²/d² = 0.25 % off.
        assert!((seen / (PI * disk_form_factor(2.0, 0.1)) - 1.0).abs() < 3e-3);
        assert_eq!(small.seen_from(Vec3::ZERO, Vec3::Y, 1.9), 0.0);
        assert_eq!(small.seen_from(Vec3::ZERO, Vec3::NEG_Y, 9.0), 0.0);
        assert_eq!(small.seen_from(small.position, Vec3::Y, 9.0), 0.0);
    }

    #[test]
    fn an_area_that_the_horizon_cuts_sinks_smoothly() {
        let at = |y: f32| disk(Vec3::new(3.0, y, 0.0), Vec3::NEG_X, 0.2);
        let seen = |y| at(y).seen_from(Vec3::ZERO, Vec3::Y, f32::INFINITY);
        assert!(seen(0.0) > 0.0 && seen(-0.19) > 0.0 && seen(-0.21) == 0.0);
        for k in -30..30 {
            let y = k as f32 * 0.01;
            assert!(seen(y + 0.01) >= seen(y), "{y}");
            assert!(
                seen(y + 0.01) - seen(y) < 0.02 * seen(0.3) / 0.3 * 1.2,
                "{y}"
            );
        }
    }

    #[test]
    fn all_instruction_sets_give_the_bits_of_single_areas() {
        let mut random = crate::trace::testing::Random(5);
        let areas: Vec<Area> = (0..77)
            .map(|i| Area {
                normal: if i % 5 == 0 {
                    Vec3::ZERO
                } else {
                    random.vector().normalize()
                },
                ..disk(random.vector() * 3.0, Vec3::Y, 0.1)
            })
            .collect();
        let places: Vec<_> = (0..64_u8)
            .map(|i| Vec3::new(f32::from(i % 8), 0.0, f32::from(i / 8)) * 0.02)
            .map(|place| (place, Vec3::Y))
            .collect();
        let receivers = receivers_at(&places);
        let tracer = Tracer::new(&crate::trace::testing::scene(Vec::new(), &[]));
        let sizes = Sizes {
            max_radius: 1.0,
            max_share: 1.0,
            probes: 16,
        };
        let (windows, sorted) = Windows::new(&tracer, &receivers, sizes);
        let window = windows.window(&sorted.cores[0]);
        let group = Group::new(&tracer, &receivers, &window);
        let wide = dispatch!(Level::new(), simd => {
            let _ = simd;
            irradiance(&group, &areas, 5.0)
        });
        assert_eq!(wide, irradiance(&group, &areas, 5.0));
        for (i, wide) in wide.iter().enumerate() {
            let place = (group.positions[i], group.normals[i]);
            let one = |area: &Area| area.light * area.seen_from(place.0, place.1, 5.0);
            let sum: Vec3 = areas.iter().map(one).sum();
            assert!(wide.abs_diff_eq(sum, 1e-5 * sum.length()), "{wide} {sum}");
        }
    }
}
