//! The pilot's promises, on scenes made by code: its choice meets the tolerance at receivers it never looked at, its
//! estimate is honest there, and it takes the cheaper engine of two.

#[allow(dead_code, reason = "every test file uses some of the builders")]
#[path = "support/scenes.rs"]
mod scenes;

#[allow(dead_code, reason = "every test file uses some of the builders")]
#[path = "support/dense.rs"]
mod dense;

#[path = "support/sky.rs"]
mod sky;

use glam::Vec3;
use scenes::{SceneBuilder, Side, bowl, plate, receivers_in};
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use surflux::bake::{BakeSettings, Baked, bake};
use surflux::diagnostics::{Cancelled, Diagnostics};
use surflux::gather::maps::{self, MapsPlan, MapsSettings};
use surflux::gather::{DicedSurfels, GatherScene, RadianceSource, RaysEngine, RaysSettings};
use surflux::lighting::{LightSamples, Lighting};
use surflux::pilot::error::{Truth, statistics, values};
use surflux::pilot::{Candidate, LightScenes, Maps, Method, Outcome, Pick, Pilot, choose};
use surflux::receivers::Receivers;
use surflux::results::{Aov, AovBuffer, Results};
use surflux::scene::Scene;
use surflux::shading::Shader;
use surflux::trace::Tracer;

/// A yard with a back wall, two balls and a glowing panel above, under no sky; the ground and a ball as receivers.
fn balls() -> (Scene, Receivers) {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::new(0.7, 0.6, 0.5), Vec3::ZERO);
    let glow = builder.material(Vec3::ZERO, Vec3::splat(5.0));
    let ground = plate(Vec3::ZERO, Vec3::Z * 2.0, Vec3::X * 2.0, 48);
    let ground = builder.mesh("ground", ground, gray);
    let wall = plate(Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 1.5, 8);
    builder.mesh("wall", wall, gray);
    let ball = bowl(
        Vec3::new(0.6, 0.4, 0.7),
        0.4,
        std::f32::consts::PI,
        24,
        Side::Outside,
    );
    let first = builder.mesh("ball", ball, gray);
    let other = bowl(
        Vec3::new(1.4, 0.3, 1.2),
        0.3,
        std::f32::consts::PI,
        24,
        Side::Outside,
    );
    builder.mesh("other", other, gray);
    let panel = plate(Vec3::new(0.7, 1.9, 0.7), Vec3::X * 0.6, Vec3::Z * 0.6, 2);
    builder.mesh("panel", panel, glow);
    let scene = builder.build();
    let mut receivers = receivers_in(&scene, ground, 1);
    let more = receivers_in(&scene, first, 1);
    receivers.position.extend(more.position);
    receivers.normal.extend(more.normal);
    receivers.geometric_normal.extend(more.geometric_normal);
    receivers.prim.extend(more.prim);
    receivers.surface.extend(more.surface);
    (scene, receivers)
}

/// Costs are processor time of the whole process: while one test measures, no other may compute.
static ALONE: Mutex<()> = Mutex::new(());

/// Everything prepared for gathering in one scene; one a test.
struct Setup<'a> {
    _alone: MutexGuard<'static, ()>,
    diagnostics: Diagnostics,
    shader: Shader<'a>,
    tracer: Tracer,
    lighting: Lighting,
    finer: Lighting,
    baked: Baked,
}

impl<'a> Setup<'a> {
    fn new(scene: &'a Scene) -> Self {
        let alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        let diagnostics = Diagnostics::default();
        let shader = Shader::new(scene, &diagnostics);
        let tracer = Tracer::new(scene);
        let usual = LightSamples::default();
        let finer = LightSamples {
            per_light: 4 * usual.per_light,
            emissive: 4 * usual.emissive,
            environment: 4 * usual.environment,
        };
        let surfels = Lighting::new(&shader, LightSamples::SURFEL, &diagnostics);
        let settings = BakeSettings {
            surfels: 20_000,
            ..BakeSettings::default()
        };
        let baked =
            bake(&shader, &tracer, &surfels, &settings, &diagnostics).expect("not cancelled");
        Self {
            _alone: alone,
            lighting: Lighting::new(&shader, usual, &diagnostics),
            finer: Lighting::new(&shader, finer, &diagnostics),
            diagnostics,
            tracer,
            baked,
            shader,
        }
    }

    fn scene<'s>(&'s self, lighting: &'s Lighting) -> GatherScene<'s> {
        GatherScene {
            shader: &self.shader,
            tracer: &self.tracer,
            lighting: Some(lighting),
        }
    }

    /// Light with this many times the usual cells of the sky.
    fn sky(&self, times: u32) -> Lighting {
        let usual = LightSamples::default();
        let samples = LightSamples {
            environment: times * usual.environment,
            ..usual
        };
        Lighting::new(&self.shader, samples, &self.diagnostics)
    }

    fn rays(&self, rays: u32, turn: f32) -> RaysEngine<'_> {
        let source =
            RadianceSource::Baked(DicedSurfels::new(&self.baked.cloud, &self.baked.dice, None));
        let settings = RaysSettings {
            rays,
            turn,
            ..RaysSettings::default()
        };
        RaysEngine::new(&self.tracer, Some(source), settings)
    }

    fn choose(
        &self,
        receivers: &Receivers,
        (aovs, tolerance): (&[Aov], f64),
        candidates: &[Candidate<'_>],
    ) -> Outcome {
        self.choose_with(receivers, (aovs, tolerance), candidates, Maps::Never)
    }

    fn choose_with<'s>(
        &'s self,
        receivers: &'s Receivers,
        (aovs, tolerance): (&'s [Aov], f64),
        candidates: &'s [Candidate<'_>],
        maps: Maps<'s>,
    ) -> Outcome {
        let rays = |count, turn| Box::new(self.rays(count, turn)) as Box<dyn Method>;
        let pilot = Pilot {
            scenes: LightScenes {
                run: self.scene(&self.lighting),
                finer: Some(self.scene(&self.finer)),
            },
            receivers,
            aovs,
            tolerance,
            evened: 1.0,
            rays: &rays,
            share: &|_| Ok(None),
            thinning: None,
            candidates,
            maps,
            surfel_errors: &[],
        };
        choose(&pilot, &self.diagnostics).expect("not cancelled")
    }

    fn run(&self, rays: u32, turn: f32, receivers: &Receivers, aov: Aov) -> Vec<f64> {
        let results = self
            .rays(rays, turn)
            .gather(
                self.scene(&self.lighting),
                receivers,
                &[aov],
                &self.diagnostics,
            )
            .expect("not cancelled");
        values(&results, aov).expect("asked for")
    }
}

#[test]
fn the_choice_meets_the_tolerance_and_its_estimate_holds_at_other_receivers() {
    let (scene, receivers) = balls();
    let setup = Setup::new(&scene);
    for (aov, tolerances) in [
        (Aov::Visibility, &[0.05, 0.02][..]),
        (Aov::IrradianceIndirect, &[0.05]),
    ] {
        for &tolerance in tolerances {
            let outcome = setup.choose(&receivers, (&[aov], tolerance), &[]);
            let rays = outcome.rays.expect("an AOV of the engine");
            let estimate = outcome.worst().expect("an estimate");
            // One in eleven: hardly any of the pilot's own, which are one in 64.
            let held_out: Vec<usize> = (5..receivers.len()).step_by(11).collect();
            let held_out = receivers.subset(&held_out);
            let half = |turn| setup.run(8192, turn, &held_out, aov);
            let truth = Truth::of_halves(&half(0.3), &half(0.58));
            let found = statistics(&setup.run(rays, 0.0, &held_out, aov), &truth).relative_rmse;
            let ratio = found / estimate;
            assert!(
                estimate <= tolerance && found <= 1.15 * tolerance,
                "{aov}: {found}"
            );
            assert!(
                (1.0 / 1.3..1.3).contains(&ratio),
                "{aov} at {tolerance}: {ratio}"
            );
            // Not more than twice the rays that would do.
            assert!(
                found > 0.5 * tolerance,
                "{aov} at {tolerance}: {rays} rays are too many"
            );
        }
    }
}

#[test]
fn light_that_no_engine_changes_is_estimated_by_its_own_samples() {
    let (scene, receivers) = balls();
    let setup = Setup::new(&scene);
    let outcome = setup.choose(
        &receivers,
        (&[Aov::IrradianceDirect, Aov::Normal], 0.02),
        &[],
    );
    assert!(outcome.rays.is_none() && outcome.pick == Pick::Rays);
    let names: Vec<Aov> = outcome.errors.iter().map(|error| error.aov).collect();
    assert_eq!(names, [Aov::IrradianceDirect]);
    assert!(
        outcome
            .worst()
            .is_some_and(|error| error > 0.0 && error <= 0.02)
    );
    let none = setup.choose(&receivers, (&[Aov::Position], 0.02), &[]);
    assert!(none.errors.is_empty() && none.worst().is_none());
}

/// Knows the visibility of all receivers beforehand, times a factor: as cheap as can be.
#[derive(Debug, Clone)]
struct Oracle {
    known: HashMap<[u32; 6], f32>,
    factor: f32,
}

fn key(receivers: &Receivers, i: usize) -> [u32; 6] {
    let (p, n) = (receivers.position[i], receivers.normal[i]);
    [p.x, p.y, p.z, n.x, n.y, n.z].map(f32::to_bits)
}

impl Method for Oracle {
    fn gather(
        &self,
        _: GatherScene<'_>,
        receivers: &Receivers,
        aovs: &[Aov],
        _: &Diagnostics,
    ) -> Result<Results, Cancelled> {
        assert_eq!(aovs, [Aov::Visibility]);
        let value = |i| self.factor * self.known[&key(receivers, i)];
        Ok(Results {
            buffers: vec![AovBuffer {
                aov: Aov::Visibility,
                data: (0..receivers.len()).map(value).collect(),
            }],
            ..Results::default()
        })
    }
}

fn candidate<M: Method + Clone + 'static>(method: M, preparation: f64) -> Candidate<'static> {
    Candidate {
        engine: "made",
        knobs: Vec::new(),
        preparation,
        sees_groups: false,
        make: Box::new(move || Box::new(method.clone())),
    }
}

#[test]
fn a_cheaper_candidate_wins_only_if_it_meets_the_tolerance() {
    let (scene, receivers) = balls();
    let setup = Setup::new(&scene);
    let values = setup.run(8192, 0.44, &receivers, Aov::Visibility);
    #[expect(clippy::cast_possible_truncation, reason = "it was single precision")]
    let known = values
        .iter()
        .enumerate()
        .map(|(i, x)| (key(&receivers, i), *x as f32));
    let exact = Oracle {
        known: known.collect(),
        factor: 1.0,
    };
    let wrong = Oracle {
        factor: 1.1,
        ..exact.clone()
    };
    let wanted = (&[Aov::Visibility][..], 0.02);
    // 10 % off; and perfect, but after years of preparation.
    let useless = [candidate(wrong.clone(), 0.0), candidate(exact.clone(), 1e9)];
    let outcome = setup.choose(&receivers, wanted, &useless);
    assert_eq!(outcome.pick, Pick::Rays, "{:?}", outcome.trials);
    let field = [candidate(wrong, 0.0), candidate(exact, 0.0)];
    let outcome = setup.choose(&receivers, wanted, &field);
    assert_eq!(outcome.pick, Pick::Candidate(1), "{:?}", outcome.trials);
    assert!(outcome.worst().is_some_and(|error| error < 0.01));
}

#[test]
fn no_receivers_and_few_receivers_are_no_trouble() {
    let (scene, receivers) = balls();
    let setup = Setup::new(&scene);
    let none = setup.choose(&receivers.subset(&[]), (&[Aov::Occlusion], 0.02), &[]);
    assert!(none.rays.is_none() && none.worst().is_none());
    let one = setup.choose(&receivers.subset(&[7]), (&[Aov::Occlusion], 0.02), &[]);
    assert!(one.rays.is_some_and(|rays| (16..=65_536).contains(&rays)));
}

/// Visibility of all vertices of a dense ball on a ground.
struct Ball {
    scene: Scene,
    receivers: Receivers,
}

impl Ball {
    fn new() -> Self {
        let scene = dense::on_ground(dense::bumpy_ball(72, Vec3::ZERO), 8);
        let receivers = dense::vertices(&scene);
        Self { scene, receivers }
    }
}

#[test]
fn maps_are_taken_for_dense_meshes_and_keep_what_the_pilot_foretold() {
    let ball = Ball::new();
    let setup = Setup::new(&ball.scene);
    let plan = MapsPlan::new(&ball.scene);
    for tolerance in [0.05, 0.02] {
        let wanted = (&[Aov::Visibility][..], tolerance);
        let outcome = setup.choose_with(&ball.receivers, wanted, &[], Maps::IfCheaper(&plan, None));
        let Pick::Maps {
            settings,
            handed_over,
            others,
        } = outcome.pick
        else {
            panic!("{:?}", outcome.trials);
        };
        assert_eq!(others, None, "nothing else was asked for");
        let other = setup.rays(handed_over, 0.0);
        let results = maps::gather(
            setup.scene(&setup.lighting),
            (&plan, &settings),
            &other,
            (&ball.receivers, &[Aov::Visibility]),
            &setup.diagnostics,
        )
        .expect("not cancelled");
        let check = outcome.check.expect("it was measured");
        let estimate = check.errors(&results)[0].relative_rmse;
        let held_out: Vec<usize> = (5..ball.receivers.len()).step_by(101).collect();
        let few = ball.receivers.subset(&held_out);
        let half = |turn| setup.run(4096, turn, &few, Aov::Visibility);
        let truth = Truth::of_halves(&half(0.3), &half(0.58));
        let all = values(&results, Aov::Visibility).expect("asked for");
        let picked: Vec<f64> = held_out.iter().map(|&i| all[i]).collect();
        let found = statistics(&picked, &truth).relative_rmse;
        assert!(
            (1.0 / 1.3..1.3).contains(&(found / estimate)),
            "{tolerance}: {found} {estimate}"
        );
        assert!(found <= 1.15 * tolerance, "{tolerance}: {found}");
    }
}

#[test]
fn maps_see_an_image_of_the_sky_within_the_tolerance_and_beside_visibility() {
    let scene = dense::on_ground(dense::bumpy_ball(72, Vec3::ZERO), 8);
    let (scene, _folder) = sky::lit(scene);
    let receivers = dense::vertices(&scene);
    let setup = Setup::new(&scene);
    let plan = MapsPlan::new(&scene);
    let held_out: Vec<usize> = (5..receivers.len()).step_by(101).collect();
    let few = receivers.subset(&held_out);
    let lit = |times| setup.sky(times);
    let seen = |aov: Aov, light: &Lighting, turn: f32| {
        let rays = setup.rays(4096, turn);
        let results = rays.gather(setup.scene(light), &few, &[aov], &setup.diagnostics);
        values(&results.expect("not cancelled"), aov).expect("asked for")
    };
    let image = [lit(16), lit(12)].map(|light| seen(Aov::IrradianceEnvironment, &light, 0.0));
    let open = [0.3, 0.58].map(|turn| seen(Aov::Visibility, &setup.lighting, turn));
    let aovs = [Aov::IrradianceEnvironment, Aov::Visibility];
    for (aovs, tolerance) in [(&aovs[..1], 0.05), (&aovs[..1], 0.01), (&aovs, 0.02)] {
        let wanted = (aovs, tolerance);
        let outcome = setup.choose_with(&receivers, wanted, &[], Maps::Always(&plan, None));
        let Pick::Maps {
            settings,
            handed_over,
            ..
        } = outcome.pick
        else {
            panic!("{:?}", outcome.trials);
        };
        let light = lit(outcome.light_scale);
        let results = maps::gather(
            setup.scene(&light),
            (&plan, &settings),
            &setup.rays(handed_over, 0.0),
            (&receivers, aovs),
            &setup.diagnostics,
        )
        .expect("not cancelled");
        let estimates = outcome.check.expect("it was measured").errors(&results);
        assert_eq!(estimates.len(), aovs.len());
        for (&aov, [a, b]) in aovs.iter().zip([&image, &open]) {
            let truth = Truth::of_halves(a, b);
            let all = values(&results, aov).expect("asked for");
            let found = statistics(&at(&all, &held_out, receivers.len()), &truth).relative_rmse;
            let estimate = estimates.iter().find(|estimate| estimate.aov == aov);
            let estimate = estimate.expect("one an AOV").relative_rmse;
            // Below a quarter of the tolerance it does not matter how far below.
            let ratio = found / estimate.max(0.25 * tolerance);
            assert!(ratio < 1.3, "{aov} {tolerance}: {found} {estimate}");
            assert!(found <= 1.15 * tolerance, "{aov} {tolerance}: {found}");
        }
    }
}

/// Of `values` of `count` receivers those of `picks`.
fn at(values: &[f64], picks: &[usize], count: usize) -> Vec<f64> {
    let n = values.len() / count;
    let picked = picks.iter().flat_map(|&i| &values[i * n..][..n]);
    picked.copied().collect()
}

#[test]
fn a_check_sees_what_went_wrong_after_the_pilot() {
    let ball = Ball::new();
    let setup = Setup::new(&ball.scene);
    let plan = MapsPlan::new(&ball.scene);
    let wanted = (&[Aov::Occlusion][..], 0.02);
    let outcome = setup.choose_with(&ball.receivers, wanted, &[], Maps::Always(&plan, None));
    assert!(matches!(outcome.pick, Pick::Maps { .. }));
    let spoiled = AovBuffer {
        aov: Aov::Occlusion,
        data: vec![0.5; ball.receivers.len()],
    };
    let spoiled = Results {
        buffers: vec![spoiled],
        ..Results::default()
    };
    let check = outcome.check.expect("it was measured");
    assert!(check.errors(&spoiled)[0].relative_rmse > 0.1);
    // Few directions where many are needed: seen as well.
    let settings = MapsSettings {
        directions: 1,
        ..MapsSettings::SMOOTH
    };
    let seen = maps::gather(
        setup.scene(&setup.lighting),
        (&plan, &settings),
        &setup.rays(16, 0.0),
        (&ball.receivers, &[Aov::Occlusion]),
        &setup.diagnostics,
    );
    let errors = check.errors(&seen.expect("not cancelled"));
    assert!(errors[0].relative_rmse > 0.1);
}

#[test]
fn what_is_seen_on_the_way_to_light_costs_nothing_so_maps_are_not_asked() {
    let (scene, receivers) = balls();
    let setup = Setup::new(&scene);
    let plan = MapsPlan::new(&scene);
    // One bounce needs more rays than occlusion does, and they tell occlusion too.
    let aovs = [Aov::Occlusion, Aov::IrradianceIndirect];
    let maps = Maps::IfCheaper(&plan, None);
    let outcome = setup.choose_with(&receivers, (&aovs, 0.05), &[], maps);
    assert_eq!(outcome.pick, Pick::Rays, "{:?}", outcome.trials);
    assert!(outcome.trials.iter().all(|trial| trial.engine != "maps"));
}

/// Spearman's rank correlation.
fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    let ranks = |values: &[f64]| {
        let mut order: Vec<usize> = (0..values.len()).collect();
        order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
        let mut ranks = vec![0.0; values.len()];
        order
            .iter()
            .zip(0_u32..)
            .for_each(|(&i, rank)| ranks[i] = f64::from(rank));
        ranks
    };
    let (a, b) = (ranks(a), ranks(b));
    let middle = 0.5 * (a.len() - 1) as f64;
    let product: f64 = a
        .iter()
        .zip(&b)
        .map(|(a, b)| (a - middle) * (b - middle))
        .sum();
    let square: f64 = a.iter().map(|a| (a - middle).powi(2)).sum();
    product / square
}

/// Told over true rms, and the rank correlation of both.
fn quality(told: &[f64], found: &[f64], truth: &[f64]) -> (f64, f64) {
    let channels = found.len() / told.len();
    let errors = found.iter().zip(truth).map(|(x, t)| (x - t).powi(2));
    let errors: Vec<f64> = errors.collect();
    let errors: Vec<f64> = errors
        .chunks(channels)
        .map(|one| (one.iter().sum::<f64>() / channels as f64).sqrt())
        .collect();
    let rms =
        |values: &[f64]| (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt();
    (rms(told) / rms(&errors), rank_correlation(told, &errors))
}

#[test]
fn errors_of_single_receivers_are_of_the_true_size_and_mark_the_bad_ones() {
    let (scene, all) = balls();
    let setup = Setup::new(&scene);
    let receivers = all.subset(&(3..all.len()).step_by(9).collect::<Vec<_>>());
    for (aov, error) in [
        (Aov::Visibility, Aov::ErrorVisibility),
        (Aov::IrradianceIndirect, Aov::ErrorIrradianceIndirect),
    ] {
        let truth = setup.run(8192, 0.3, &receivers, aov);
        for rays in [64, 256] {
            let asked = [aov, error];
            let scene = setup.scene(&setup.lighting);
            let results = setup
                .rays(rays, 0.0)
                .gather(scene, &receivers, &asked, &setup.diagnostics)
                .expect("not cancelled");
            let [found, told] = asked.map(|aov| values(&results, aov).expect("asked for"));
            let (size, correlation) = quality(&told, &found, &truth);
            assert!(
                (1.0 / 1.5..1.5).contains(&size),
                "{aov}, {rays} rays: {size}"
            );
            // One draw of an error says little about its deviation, and here most receivers err alike. Chance: ±0.055.
            assert!(correlation > 0.2, "{aov}, {rays} rays: {correlation}");
        }
    }
}
