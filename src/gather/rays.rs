//! The rays engine: a fixed low-discrepancy set of cosine-distributed rays against the scene, radiance read from the
//! surfels they hit. The in-house truth of the other engines, and the better choice in open scenes.
//!
//! Every receiver uses the same pattern in a frame that follows its normal continuously
//! ([`sequence::transported_frame`]), so there is error but no noise, and no seams. Measured against the alternatives
//! at 1024 rays in a box with two spheres, error of irradiance and roughness along a sphere: this 0.30 % and 0.06 %;
//! the same count of world-fixed directions 0.45 % and 0.045 %; random rays 1.95 % and 1.98 %.

use super::radiance::{Outgoing, RadianceSource};
use super::ray_query::RayQuery;
use super::{Engine, EngineFactory, Hemisphere};
use crate::math::sequence;
use crate::receivers::Receivers;
use crate::shading::SurfacePoint;
use crate::surfels::{DiceMap, SurfelCloud};
use crate::trace::Tracer;
use glam::{Vec2, Vec3};
use std::f32::consts::PI;
use std::ops::Range;

/// How receivers are sampled by rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RaysSettings {
    /// Rays a receiver; 0 counts as 1.
    pub rays: u32,
    /// Nothing beyond this distance, stage units, covers or lights; `None` = no limit.
    pub max_distance: Option<f32>,
    /// Turn of the pattern about the normal, in turns. Another turn gives another error of the same size.
    pub turn: f32,
}

impl Default for RaysSettings {
    fn default() -> Self {
        Self {
            rays: 1024,
            max_distance: None,
            turn: 0.0,
        }
    }
}

impl RaysSettings {
    /// For surfels as receivers: the errors of many average out. In a box with two spheres the
    /// irradiance of two bounces is then 0.46 % off, when 1024 rays gather it.
    pub const SURFEL: Self = Self {
        rays: 128,
        max_distance: None,
        turn: 0.0,
    };

    /// Rays of a reference over those of the run it judges.
    const REFERENCE_RATIO: u32 = 4;

    /// Share of the reference's expected squared error in that of the run: the error of the pattern falls with the
    /// number of rays to the power 0.75 (measured: 64 to 4096 rays), so 4^(−2·0.75).
    pub const REFERENCE_ERROR_SHARE: f64 = 0.125;

    /// Settings of a reference for a run with these: four times the rays, turned away from the run's own.
    #[must_use]
    pub fn reference(self) -> Self {
        Self {
            rays: self.rays.saturating_mul(Self::REFERENCE_RATIO),
            // An irrational turn, so that the reference's spiral arms do not repeat those of the run.
            turn: self.turn + std::f32::consts::FRAC_1_SQRT_2,
            ..self
        }
    }
}

/// Rays between two looks at whether the run was cancelled: a fraction of a second.
const RAYS_A_BLOCK: usize = 1 << 18;

/// Sees the scene by rays.
#[derive(Debug)]
pub struct RaysEngine<'a> {
    query: &'a dyn RayQuery,
    source: Option<RadianceSource<'a>>,
    max_distance: f32,
    /// Cosine-distributed directions about +Z.
    pattern: Vec<Vec3>,
}

impl<'a> RaysEngine<'a> {
    /// Rays against `tracer`, radiance from `source`. Without a source every ray only asks whether anything is there:
    /// faster, and enough for occlusion; distances are then 0 where something is.
    pub fn new(
        tracer: &'a Tracer,
        source: Option<RadianceSource<'a>>,
        settings: RaysSettings,
    ) -> Self {
        Self::with_query(tracer, source, settings)
    }

    fn with_query(
        query: &'a dyn RayQuery,
        source: Option<RadianceSource<'a>>,
        settings: RaysSettings,
    ) -> Self {
        let count = settings.rays.max(1);
        let pattern = (0..count)
            .map(|i| {
                let point = sequence::fibonacci(i, count);
                let turned = (point.y + settings.turn).rem_euclid(1.0);
                sequence::cosine_hemisphere(Vec2::new(point.x, turned))
            })
            .collect();
        Self {
            query,
            source,
            max_distance: settings.max_distance.unwrap_or(f32::INFINITY),
            pattern,
        }
    }

    fn fill(&self, receivers: &Receivers, i: usize, seen: &mut Hemisphere) {
        seen.clear();
        let stand = Stand::of(receivers, i);
        let origin = self.query.lift(receivers.position[i], stand.lift);
        let frame = sequence::transported_frame(receivers.normal[i]);
        let weight = PI / self.pattern.len() as f32;
        for &local in &self.pattern {
            let direction = stand.above_horizon(frame.to_world(local));
            let (distance, radiance) = self.look(origin, direction);
            let covered = distance.is_finite();
            seen.direction.push(direction);
            seen.weight.push(weight);
            seen.coverage.push(if covered { 1.0 } else { 0.0 });
            seen.distance.push(distance);
            seen.reflected.push(radiance.reflected);
            seen.emitted.push(radiance.emitted);
        }
    }

    /// Distance to what is seen, `INFINITY` for nothing, and its radiance.
    fn look(&self, origin: Vec3, direction: Vec3) -> (f32, Outgoing) {
        const NOTHING: (f32, Outgoing) = (f32::INFINITY, Outgoing::BLACK);
        let Some(source) = &self.source else {
            let covered = self.query.occluded(origin, direction, self.max_distance);
            return if covered {
                (0.0, Outgoing::BLACK)
            } else {
                NOTHING
            };
        };
        self.query
            .closest(origin, direction, self.max_distance)
            .map_or(NOTHING, |hit| {
                (hit.distance, source.radiance(&hit, origin, direction))
            })
    }
}

impl Engine for RaysEngine<'_> {
    fn see(
        &self,
        receivers: &Receivers,
        block: Range<usize>,
        scratch: &mut Hemisphere,
        visit: &mut dyn FnMut(usize, &Hemisphere),
    ) {
        for i in block {
            self.fill(receivers, i, scratch);
            visit(i, scratch);
        }
    }

    fn name(&self) -> &'static str {
        "rays"
    }

    fn block_size(&self) -> usize {
        RAYS_A_BLOCK / self.pattern.len()
    }
}

/// Makes rays engines over clouds that share one [`DiceMap`]: the bounces of a baked cloud.
#[derive(Debug, Clone, Copy)]
pub struct RaysFactory<'a> {
    /// Rays.
    pub tracer: &'a Tracer,
    /// The way from triangles to the surfels of every cloud asked for.
    pub dice: &'a DiceMap,
    /// Rays a receiver.
    pub settings: RaysSettings,
}

impl EngineFactory for RaysFactory<'_> {
    fn with_engine(&self, cloud: &SurfelCloud, work: &mut dyn FnMut(&dyn Engine)) {
        let dice = self.dice;
        let source = RadianceSource::Baked { cloud, dice };
        work(&RaysEngine::new(self.tracer, Some(source), self.settings));
    }
}

/// How a receiver stands on its triangle: what is done about directions above the shading horizon and yet below the
/// triangle's plane.
///
/// Inside a triangle such directions see nothing but the triangle itself, which the smooth surface it stands for would
/// not: they are mirrored at its plane, to what lies just above the horizon. (Counted as covered they would print the
/// facets of coarse smooth meshes into the occlusion, by (1 − cos θ)/2 for an angle θ between the normals.) On the rim,
/// at a vertex, the receiver's triangle is only one of those around it; there the rays themselves find out what is
/// free, which on convex corners is everything and in concave ones is not.
#[derive(Debug, Clone, Copy)]
struct Stand {
    /// Direction to lift the rays' origin along.
    lift: Vec3,
    /// Plane normal to mirror at, if any.
    mirror: Option<Vec3>,
}

/// Closer to a corner or edge than this in barycentric weight a receiver counts as lying on the rim.
const RIM: f32 = 1e-4;

impl Stand {
    fn of(receivers: &Receivers, i: usize) -> Self {
        let (shading, plane) = (receivers.normal[i], receivers.geometric_normal[i]);
        let SurfacePoint { u, v, .. } = receivers.surface[i];
        let on_rim = u.min(v).min(1.0 - u - v) < RIM;
        if on_rim {
            // Between two walls of one mesh the shading normal leads away from both.
            Self {
                lift: if shading.dot(plane) > 0.5 {
                    shading
                } else {
                    plane
                },
                mirror: None,
            }
        } else {
            Self {
                lift: plane,
                mirror: (shading != plane).then_some(plane),
            }
        }
    }

    fn above_horizon(&self, direction: Vec3) -> Vec3 {
        let Some(plane) = self.mirror else {
            return direction;
        };
        let height = direction.dot(plane);
        if height < 0.0 {
            direction - plane * (2.0 * height)
        } else {
            direction
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::quantities::occlusion::occlusion;
    use super::super::testing::{Shape, Shapes, receivers_at};
    use super::*;
    use crate::math::Frame;

    fn occlusions(shapes: &Shapes, receivers: &Receivers, settings: RaysSettings) -> Vec<f32> {
        let engine = RaysEngine::with_query(shapes, None, settings);
        let mut out = Vec::new();
        engine.see(
            receivers,
            0..receivers.len(),
            &mut Hemisphere::default(),
            &mut |_, seen| out.push(occlusion(seen)),
        );
        out
    }

    #[test]
    fn a_sphere_above_the_horizon_covers_its_configuration_factor() {
        // cos θ · (r/d)², for any sphere wholly above the horizon.
        let (radius, distance) = (0.5, 1.25);
        let shapes = Shapes(vec![Shape::Sphere {
            center: Vec3::ZERO,
            radius,
        }]);
        for tilt in [0.0_f32, 0.4, 0.9] {
            for azimuth in 0..12 {
                let away = Frame::about(sequence::spiral_sphere(azimuth, 12));
                let position = away.normal * -distance;
                let normal = away.normal * tilt.cos() + away.tangent * tilt.sin();
                let receivers = receivers_at(&[(position, normal)]);
                let got = occlusions(&shapes, &receivers, RaysSettings::default())[0];
                let exact = tilt.cos() * (radius / distance).powi(2);
                assert!((got - exact).abs() < 0.006, "{tilt}: {got} {exact}");
            }
        }
    }

    #[test]
    fn error_falls_almost_linearly_with_the_number_of_rays() {
        let shapes = Shapes(vec![Shape::Sphere {
            center: Vec3::ZERO,
            radius: 0.5,
        }]);
        let points: Vec<_> = (0..200)
            .map(|i| {
                let away = sequence::spiral_sphere(i, 200);
                (away * -1.25, away)
            })
            .collect();
        let receivers = receivers_at(&points);
        let error = |rays| {
            let settings = RaysSettings {
                rays,
                ..RaysSettings::default()
            };
            let values = occlusions(&shapes, &receivers, settings);
            (values.iter().map(|x| (x - 0.16).powi(2)).sum::<f32>() / 200.0).sqrt() / 0.84
        };
        // Random rays: 1.4 %, 0.34 %.
        let (coarse, fine) = (error(1024), error(16384));
        assert!(coarse < 0.004 && fine < 0.0006, "{coarse} {fine}");
    }

    #[test]
    fn a_coaxial_disk_covers_its_form_factor_and_an_enclosure_everything() {
        let disk = Shapes(vec![Shape::Disk {
            center: Vec3::Y,
            normal: Vec3::Y,
            radius: 2.0,
        }]);
        let receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
        let got = occlusions(&disk, &receivers, RaysSettings::default())[0];
        assert!((got - 4.0 / 5.0).abs() < 1e-3, "{got}"); // r²/(r²+h²)
        let enclosure = Shapes(vec![Shape::Sphere {
            center: Vec3::ZERO,
            radius: 9.0,
        }]);
        let got = occlusions(&enclosure, &receivers, RaysSettings::default())[0];
        assert!((got - 1.0).abs() < 1e-6);
        let near = RaysSettings {
            max_distance: Some(8.9),
            ..RaysSettings::default()
        };
        assert_eq!(occlusions(&enclosure, &receivers, near)[0], 0.0);
    }

    #[test]
    fn weights_sum_to_pi_for_any_number_of_rays() {
        for rays in [0, 1, 7, 1024] {
            let settings = RaysSettings {
                rays,
                ..RaysSettings::default()
            };
            let shapes = Shapes(Vec::new());
            let engine = RaysEngine::with_query(&shapes, None, settings);
            let receivers = receivers_at(&[(Vec3::ZERO, Vec3::X)]);
            engine.see(
                &receivers,
                0..1,
                &mut Hemisphere::default(),
                &mut |_, seen| {
                    assert!((seen.weight.iter().sum::<f32>() - PI).abs() < 1e-4);
                    assert!(seen.distance.iter().all(|d| d.is_infinite()));
                },
            );
        }
    }

    #[test]
    fn values_have_no_seam_where_normals_cross_the_coordinate_planes() {
        let toward = Vec3::new(3.0, 2.0, 1.0);
        let shapes = Shapes(vec![Shape::Disk {
            center: toward,
            normal: toward.normalize(),
            radius: 2.0,
        }]);
        let off = 1e-6;
        let mut points = Vec::new();
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            let circle = Frame::about(axis);
            for k in 0..100 {
                let (sin, cos) = (k as f32 * PI / 50.0).sin_cos();
                let normal = circle.tangent * cos + circle.bitangent * sin;
                points.push((Vec3::ZERO, (normal + off * axis).normalize()));
                points.push((Vec3::ZERO, (normal - off * axis).normalize()));
            }
        }
        let values = occlusions(&shapes, &receivers_at(&points), RaysSettings::default());
        for pair in values.chunks_exact(2) {
            // One ray may change sides; a frame that flips changes several.
            assert!((pair[0] - pair[1]).abs() < 1.5 / 1024.0, "{pair:?}");
        }
    }

    #[test]
    fn a_tilted_shading_normal_sees_neither_its_own_plane_nor_anything_less_of_the_sky() {
        // A large ground of which the receiver's triangle is a part.
        let ground = Shapes(vec![Shape::Disk {
            center: Vec3::ZERO,
            normal: Vec3::Y,
            radius: 1e3,
        }]);
        let mut receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
        receivers.normal[0] = Vec3::new(0.5, 1.0, 0.0).normalize();
        let inside = occlusions(&ground, &receivers, RaysSettings::default())[0];
        assert_eq!(inside, 0.0);
        // At a vertex the rays find out: the ground's far part lies below this share of the tilted hemisphere.
        (receivers.surface[0].u, receivers.surface[0].v) = (1.0, 0.0);
        let rim = occlusions(&ground, &receivers, RaysSettings::default())[0];
        let exact = 0.5 * (1.0 - receivers.normal[0].y);
        assert!((rim - exact).abs() < 3.0 / 1024.0, "{rim} {exact}");
    }
}
