//! Surfaces that stop part of the light, or all of it in places: leaves cut out of squares, veils, glass as UsdPreviewSurface
//! has it, all without refraction. Rays go straight on.
//!
//! Prims with such surfaces are in a hierarchy of their own, so that scenes and rays without them are as fast as ever. A ray
//! meets all of them up to the first that stops everything, and each takes its part of what is left: no ray is decided by
//! chance, so that what is half open is seen half open everywhere, without noise.

use super::triangles::{LocalHit, Triangles};
use super::wide::NEAREST_FIRST;
use super::{Hit, Ray, Tracer};
use crate::scene::PrimId;
use fearless_simd::{Simd, dispatch};
use glam::Vec3;
use std::fmt::Debug;
use std::sync::Arc;

/// How much of what falls on them surfaces stop.
pub trait Opacity: Debug + Send + Sync {
    /// True if anything passes somewhere through `prim`.
    fn is_screen(&self, prim: PrimId) -> bool;
    /// Part of the light that is stopped at barycentric `(u, v)` of `triangle` of `prim`, a screen: 0…1.
    fn at(&self, prim: PrimId, triangle: u32, u: f32, v: f32) -> f32;
}

/// A screen that a ray passes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layer {
    /// Where.
    pub hit: Hit,
    /// The part of what arrives there that it stops, 0…1.
    pub opacity: f32,
}

/// All screens of a tracer's scene.
#[derive(Debug)]
pub(super) struct Screens {
    /// They alone.
    pub(super) prims: Box<Tracer>,
    pub(super) opacity: Arc<dyn Opacity>,
}

/// Less than this part of the light counts as nothing.
const NOTHING: f32 = 1e-4;

/// A ray may pass both triangles at an edge (barycentric weight below the first number), at distances that differ by less
/// than the second times themselves: it is one surface.
const SAME: (f32, f32) = (1e-5, 1e-5);

impl Screens {
    /// Collects what a ray passes closer than `max_distance`, in order of distance; returns the part of the light that comes
    /// through.
    pub(super) fn pass(
        &self,
        ray: (Vec3, Vec3),
        max_distance: f32,
        layers: &mut Vec<Layer>,
    ) -> f32 {
        self.pass_from(f32::MIN_POSITIVE, ray, max_distance, layers)
    }

    /// The same, of surfaces that stop at least `least` of the light.
    fn pass_from(
        &self,
        least: f32,
        (origin, direction): (Vec3, Vec3),
        max_distance: f32,
        layers: &mut Vec<Layer>,
    ) -> f32 {
        layers.clear();
        dispatch!(self.prims.level, simd => {
            if let Some(mut ray) = Ray::new(origin, direction, max_distance) {
                self.collect(simd, least, &mut ray, layers);
                layers.retain(|layer| layer.hit.distance <= ray.max_distance);
            }
        });
        if layers.is_empty() {
            return 1.0;
        }
        layers.sort_unstable_by(|a, b| {
            let key = |layer: &Layer| (layer.hit.prim, layer.hit.triangle);
            (a.hit.distance.total_cmp(&b.hit.distance)).then_with(|| key(a).cmp(&key(b)))
        });
        layers.dedup_by(|next, last| is_same_surface(&next.hit, &last.hit));
        let mut open = 1.0;
        let mut count = 0;
        for layer in layers.iter() {
            count += 1;
            open *= 1.0 - layer.opacity;
            if open < NOTHING {
                open = 0.0;
                break;
            }
        }
        layers.truncate(count);
        open
    }

    /// Shortens `ray` to the first place where it is stopped wholly.
    #[inline(always)]
    fn collect<S: Simd>(&self, simd: S, least: f32, ray: &mut Ray, layers: &mut Vec<Layer>) {
        let prims = &*self.prims;
        let keep = |hit: Hit, ray: &mut Ray, layers: &mut Vec<Layer>| {
            let opacity = self.opacity.at(hit.prim, hit.triangle, hit.u, hit.v);
            if opacity >= least {
                layers.push(Layer { hit, opacity });
            }
            if opacity >= 1.0 {
                ray.max_distance = hit.distance;
            }
        };
        let world = &prims.world;
        world.triangles.all(
            simd,
            ray,
            #[inline(always)]
            |hit, ray| keep(world.resolve(hit), ray, layers),
        );
        prims.top.traverse::<NEAREST_FIRST, S>(
            simd,
            ray,
            #[inline(always)]
            |leaf, ray| {
                for occurrence in prims.occurrences_of(leaf) {
                    let Some(mut local) = occurrence.local(ray) else {
                        continue;
                    };
                    let keep = |hit: LocalHit, ray: &mut Ray| {
                        keep(hit.of_prim(occurrence.prim, hit.triangle), ray, layers);
                    };
                    prims.shared[occurrence.mesh].all(simd, &mut local, keep);
                    ray.max_distance = local.max_distance;
                }
                false
            },
        );
    }
}

impl Triangles {
    /// Hands every hit closer than the ray's limit, which may be drawn nearer, to `keep`, in no order.
    #[inline(always)]
    fn all<S: Simd>(&self, simd: S, ray: &mut Ray, mut keep: impl FnMut(LocalHit, &mut Ray)) {
        self.tree.traverse::<NEAREST_FIRST, S>(
            simd,
            ray,
            #[inline(always)]
            |leaf, ray| {
                self.each_hit(
                    simd,
                    leaf,
                    ray,
                    #[inline(always)]
                    |hit, ray| keep(hit, ray),
                );
                false
            },
        );
    }
}

fn is_same_surface(next: &Hit, last: &Hit) -> bool {
    let on_edge = |hit: &Hit| hit.u.min(hit.v).min(1.0 - hit.u - hit.v) < SAME.0;
    next.prim == last.prim
        && next.front == last.front
        && next.distance - last.distance <= SAME.1 * last.distance
        && on_edge(next)
        && on_edge(last)
}

impl Tracer {
    /// True if some surfaces let light through.
    pub fn has_screens(&self) -> bool {
        self.screens.is_some()
    }

    /// Part of the light that passes along the unit `direction` from `origin` as far as `max_distance`, 0…1.
    #[inline]
    pub fn transmittance(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> f32 {
        if self.solid_occluded(origin, direction, max_distance) {
            return 0.0;
        }
        self.screened((origin, direction), max_distance)
    }

    /// Part of the light that comes through what lets light through.
    pub(super) fn screened(&self, ray: (Vec3, Vec3), max_distance: f32) -> f32 {
        match &self.screens {
            Some(screens) => screens.pass(ray, max_distance, &mut Vec::new()),
            None => 1.0,
        }
    }

    /// Fills `layers` with the screens that a ray passes closer than `max_distance` up to the first that stops all of it, in
    /// their order, whatever solid surfaces there are; returns the part of the light that comes through all of them.
    pub fn layers(
        &self,
        (origin, direction): (Vec3, Vec3),
        max_distance: f32,
        layers: &mut Vec<Layer>,
    ) -> f32 {
        layers.clear();
        match &self.screens {
            Some(screens) => screens.pass((origin, direction), max_distance, layers),
            None => 1.0,
        }
    }

    /// The same with the places, of opacity 0, where a ray passes a screen as if it were not there.
    pub fn layers_and_holes(
        &self,
        ray: (Vec3, Vec3),
        max_distance: f32,
        layers: &mut Vec<Layer>,
    ) -> f32 {
        layers.clear();
        match &self.screens {
            Some(screens) => screens.pass_from(0.0, ray, max_distance, layers),
            None => 1.0,
        }
    }

    /// What hides more than half of what lies beyond, together with all before it: the first of `layers`, or `solid` if none
    /// does.
    pub(super) fn hides_most(layers: &[Layer], solid: Option<Hit>) -> Option<Hit> {
        let mut open = 1.0;
        let layer = layers.iter().find(|layer| {
            open *= 1.0 - layer.opacity;
            open <= MOST_OPEN
        });
        layer.map(|layer| layer.hit).or(solid)
    }
}

/// Rays that can only go on or stop go on while more than this part of the light does.
pub(super) const MOST_OPEN: f32 = 0.5;

#[cfg(test)]
mod tests {
    use super::super::testing::{Random, mesh, scene};
    use super::*;
    use crate::scene::Scene;
    use glam::{Affine3A, Quat};

    /// Opacity of each prim, the same all over it; 1 is no screen.
    #[derive(Debug)]
    struct Even(Vec<f32>);

    impl Opacity for Even {
        fn is_screen(&self, prim: PrimId) -> bool {
            self.0[prim.index()] < 1.0
        }

        fn at(&self, prim: PrimId, _triangle: u32, _u: f32, _v: f32) -> f32 {
            self.0[prim.index()]
        }
    }

    /// Triangles here and there, some of them many times, and what they stop.
    fn soup(random: &mut Random) -> (Scene, Vec<f32>) {
        let meshes = (0..6).map(|_| {
            let triangles: Vec<_> = (0..20)
                .map(|_| {
                    let at = random.vector();
                    [(); 3].map(|()| at + 0.7 * random.vector())
                })
                .collect();
            mesh(&triangles)
        });
        let meshes: Vec<_> = meshes.collect();
        let placed = |random: &mut Random| {
            let turn = Quat::from_axis_angle(random.direction(), 3.0 * random.next());
            Affine3A::from_rotation_translation(turn, 0.3 * random.vector())
        };
        let prims: Vec<_> = (0..12).map(|i| (i % 6, placed(random))).collect();
        let opacity = (0..12).map(|i| if i % 3 == 0 { 1.0 } else { random.next() });
        (scene(meshes, &prims), opacity.collect())
    }

    /// The part that passes all prims, one prim and one triangle after the other.
    fn passes(scene: &Scene, opacity: &[f32], (origin, direction): (Vec3, Vec3), end: f32) -> f32 {
        let mut open = 1.0;
        for (prim, &opacity) in (0..).zip(opacity) {
            let one = Tracer::among(scene, None, |id| id == PrimId(prim));
            let (mut from, mut left) = (origin, end);
            while let Some(hit) = one.solid_closest(from, direction, left) {
                open *= 1.0 - opacity;
                let step = hit.distance + 1e-5;
                from += direction * step;
                left -= step;
            }
        }
        open
    }

    #[test]
    fn rays_pass_as_much_as_one_surface_after_the_other_lets_through() {
        let mut random = Random(7);
        let (scene, opacity) = soup(&mut random);
        for most_copies in [usize::MAX, 0] {
            let with =
                |is_in: &dyn Fn(PrimId) -> bool| Tracer::with_copies(&scene, most_copies, is_in);
            let even = Even(opacity.clone());
            let tracer = Tracer {
                screens: Some(Screens {
                    prims: Box::new(with(&|prim| even.is_screen(prim))),
                    opacity: Arc::new(Even(opacity.clone())),
                }),
                ..with(&|prim| !even.is_screen(prim))
            };
            for _ in 0..500 {
                let ray = (1.5 * random.vector(), random.direction());
                let exact = passes(&scene, &opacity, ray, 2.0);
                let found = tracer.transmittance(ray.0, ray.1, 2.0);
                assert!((found - exact).abs() < 2e-4, "{found} {exact}");
                assert_eq!(tracer.occluded(ray.0, ray.1, 2.0), found <= MOST_OPEN);
                let along = tracer.occluded_along(ray.1, &[ray.0], 2.0, 1);
                assert_eq!(along == 1, found <= MOST_OPEN);
                let closest = tracer.closest(ray.0, ray.1, 2.0);
                assert_eq!(closest.is_some(), found <= MOST_OPEN);
                let mut hits = [None];
                tracer.closest_along(ray.1, &[ray.0], (2.0, 1), &mut hits);
                assert_eq!(hits[0], closest);
            }
        }
    }

    #[test]
    fn two_triangles_that_meet_in_an_edge_are_one_surface_there() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y];
        let [a, b, c, d] = corners;
        let scene = scene(
            vec![mesh(&[[a, b, c], [a, c, d]])],
            &[(0, Affine3A::IDENTITY)],
        );
        let tracer = Tracer::among(&scene, Some(Arc::new(Even(vec![0.5]))), |_| true);
        for i in 1..40_u8 {
            let along = f32::from(i) / 40.0;
            let origin = Vec3::new(along, along, 1.0);
            let open = tracer.transmittance(origin, -Vec3::Z, 2.0);
            assert!((open - 0.5).abs() < 1e-6, "{along}: {open}");
        }
    }
}
