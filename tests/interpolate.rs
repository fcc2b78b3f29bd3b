//! Interpolation between receivers against gathering at all of them, and against closed forms.

#[allow(dead_code, reason = "shared with other tests, which use the rest")]
#[path = "support/scenes.rs"]
mod scenes;

use glam::Vec3;
use scenes::{
    SceneBuilder, Side, ball_in_a_box, bowl, floor_under_a_roof, plate, polygon_irradiance,
    receivers_in,
};
use std::cell::{Cell, RefCell};
use std::f32::consts::PI;
use surflux::bake::{BakeSettings, Baked, bake};
use surflux::diagnostics::Diagnostics;
use surflux::gather::rays::lobe::Lobes;
use surflux::gather::{
    DicedSurfels, Engine, GatherScene, RadianceSource, RaysEngine, RaysSettings, gather,
};
use surflux::interpolate::{self, Fewer, Gathering, InterpolateSettings, Interpolated, Judge};
use surflux::lighting::{LightSamples, Lighting};
use surflux::receivers::Receivers;
use surflux::results::{Aov, Results};
use surflux::scene::{FaceMaterials, Input, Material, MaterialId, PrimId, Scene};
use surflux::shading::Shader;
use surflux::trace::Tracer;

/// Surfels of `scene`, bright on top of the ball and in a spot of the floor with a sharp border, dim elsewhere.
fn spots(scene: &Scene, tracer: &Tracer) -> Baked {
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(scene, &diagnostics);
    let dark = Lighting::new(&shader, LightSamples::SURFEL, &diagnostics);
    let settings = BakeSettings {
        spacing: None,
        surfels: 30_000,
        ..BakeSettings::default()
    };
    let mut baked = bake(&shader, tracer, &dark, &settings, &diagnostics).expect("not cancelled");
    let cloud = &mut baked.cloud;
    for i in 0..cloud.len() {
        let place = cloud.position[i];
        let on_floor = place.y < -0.99 && place.distance(Vec3::new(-0.4, -1.0, 0.1)) < 0.5;
        let on_ball = cloud.prim[i] == 1 && cloud.normal[i].y > 0.7;
        let radiance = if on_floor || on_ball { 4.0 } else { 1.0 };
        cloud.radiosity[i] = Vec3::splat(PI * radiance);
        cloud.emission[i] = Vec3::ZERO;
    }
    baked
}

fn source(baked: &Baked) -> RadianceSource<'_> {
    RadianceSource::Baked(DicedSurfels::new(&baked.cloud, &baked.dice, None))
}

fn rays(rays: u32, turn: f32) -> RaysSettings {
    RaysSettings {
        rays,
        turn,
        ..RaysSettings::default()
    }
}

/// What is done in a test.
struct Run<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    engine: &'a RaysEngine<'a>,
    again: Option<&'a RaysEngine<'a>>,
    /// Two engines of fewer rays, and what these err by.
    fewer: Option<([&'a RaysEngine<'a>; 2], f64)>,
    receivers: &'a Receivers,
    aovs: &'a [Aov],
}

impl Run<'_> {
    fn whole(&self) -> Results {
        let diagnostics = Diagnostics::default();
        let shader = Shader::new(self.scene, &diagnostics);
        let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
        let scene = self.scene(&shader, &lighting);
        gather(scene, self.engine, self.receivers, self.aovs, &diagnostics).expect("not cancelled")
    }

    fn interpolated(&self, tolerance: f64, accepts: &dyn Fn(&Results) -> bool) -> Interpolated {
        self.interpolated_after(0, tolerance, accepts)
    }

    /// The same where the first `refusals` results are refused.
    fn interpolated_after(
        &self,
        refusals: u32,
        tolerance: f64,
        accepts: &dyn Fn(&Results) -> bool,
    ) -> Interpolated {
        self.judged(refusals, tolerance, &accepts)
    }

    fn judged(&self, refusals: u32, tolerance: f64, judge: &dyn Judge) -> Interpolated {
        let diagnostics = Diagnostics::default();
        let shader = Shader::new(self.scene, &diagnostics);
        let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
        let kinds = self.engine.kinds(self.receivers);
        let gathering = Gathering {
            again: self.again.map(|again| again as &dyn Engine),
            thin: None,
            fewer: (self.fewer).map(|([engine, again], errors)| Fewer {
                engine,
                again,
                errors,
            }),
            scene: self.scene(&shader, &lighting),
            engine: self.engine,
            receivers: self.receivers,
            kinds: kinds.as_deref(),
            aovs: self.aovs,
        };
        let settings = InterpolateSettings {
            tolerance,
            refusals,
        };
        interpolate::gather(gathering, settings, judge, &diagnostics).expect("not cancelled")
    }

    fn scene<'s>(&'s self, shader: &'s Shader<'s>, lighting: &'s Lighting) -> GatherScene<'s> {
        GatherScene {
            shader,
            tracer: self.tracer,
            lighting: Some(lighting),
        }
    }
}

fn values(results: &Results, aov: Aov) -> &[f32] {
    &results.get(aov).expect("it was asked for").data
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&x| f64::from(x)).sum::<f64>() / values.len() as f64
}

fn relative_rmse(found: &[f32], truth: &[f32]) -> f64 {
    let off = |(&a, &b): (&f32, &f32)| f64::from(a - b).powi(2);
    let square: f64 = found.iter().zip(truth).map(off).sum();
    (square / truth.len() as f64).sqrt() / mean(truth)
}

/// 27 648 receivers on walls, a light with sharp borders, contact with the floor: an error no larger than that of rays at
/// every receiver by more than a fifth of the tolerance, by less than half of the receivers.
#[test]
fn few_receivers_tell_as_much_as_all_of_them() {
    let scene = ball_in_a_box(48);
    let tracer = Tracer::new(&scene);
    let baked = spots(&scene, &tracer);
    let receivers = receivers_in(&scene, PrimId(0), 1);
    let engine = RaysEngine::new(&tracer, Some(source(&baked)), rays(256, 0.0));
    let finer = RaysEngine::new(&tracer, Some(source(&baked)), rays(4096, 0.3));
    let run = |engine| Run {
        scene: &scene,
        tracer: &tracer,
        engine,
        again: None,
        fewer: None,
        receivers: &receivers,
        aovs: &[Aov::IrradianceIndirect, Aov::Visibility],
    };
    let truth = run(&finer).whole();
    let whole = run(&engine).whole();
    let found = run(&engine).interpolated(0.04, &|_| true);
    let error = |results| {
        let [found, truth] = [results, &truth].map(|all| values(all, Aov::IrradianceIndirect));
        relative_rmse(found, truth)
    };
    let (of_all, of_few) = (error(&whole), error(&found.results));
    assert!(
        2 * found.gathered < receivers.len(),
        "{} {of_all} {of_few}",
        found.gathered
    );
    assert!(of_few < of_all + 0.004, "{of_few} {of_all}");
    // A closed box: nothing is open, exactly.
    let open = values(&found.results, Aov::Visibility);
    assert!(open.iter().all(|&open| open == 0.0));
    // Next to where the ball stands too.
    let contact = Vec3::new(0.2, -1.0, 0.1);
    let light = |results| values(results, Aov::IrradianceIndirect);
    let brightness = mean(light(&truth));
    for (i, place) in receivers.position.iter().enumerate() {
        if place.distance(contact) < 0.3 {
            let off = f64::from(light(&found.results)[3 * i] - light(&whole)[3 * i]);
            assert!(
                off.abs() < 0.1 * brightness,
                "{place}: {off} of {brightness}"
            );
        }
    }
}

/// Reflected light at every `step`-th receiver on the walls, by 64 rays, and 64 others.
fn with_walls(step: usize, check: impl FnOnce(Run<'_>)) {
    let scene = ball_in_a_box(48);
    let tracer = Tracer::new(&scene);
    let baked = spots(&scene, &tracer);
    let engine = |settings| RaysEngine::new(&tracer, Some(source(&baked)), settings);
    check(Run {
        scene: &scene,
        tracer: &tracer,
        engine: &engine(rays(64, 0.0)),
        again: Some(&engine(rays(64, 0.0).again())),
        fewer: None,
        receivers: &receivers_in(&scene, PrimId(0), step),
        aovs: &[Aov::IrradianceIndirect],
    });
}

#[test]
fn the_same_bits_come_from_one_thread_and_from_eight() {
    with_walls(2, |run| {
        let by = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = pool.expect("threads");
            pool.install(|| run.interpolated(0.05, &|_| true))
        };
        let (one, eight) = (by(1), by(8));
        assert!(one == eight, "{} {}", one.gathered, eight.gathered);
    });
}

/// What errs as another AOV does is interpolated as that is, whether it is asked for or not.
#[test]
fn who_speaks_for_others_does_not_hang_on_whether_the_measure_is_asked_for() {
    with_walls(1, |run| {
        let of = |aovs| Run { aovs, ..run }.interpolated(0.04, &|_| true);
        let alone = of(&[Aov::RadianceSh]);
        let together = of(&[Aov::RadianceSh, Aov::IrradianceIndirect]);
        assert_eq!(alone.gathered, together.gathered);
        let [a, b] = [&alone, &together].map(|found| values(&found.results, Aov::RadianceSh));
        assert!(a == b, "{}", relative_rmse(a, b));
    });
    let (scene, floor, _) = floor_under_a_roof(96);
    let tracer = Tracer::new(&scene);
    let engine = RaysEngine::new(&tracer, None, rays(64, 0.0));
    let receivers = receivers_in(&scene, floor, 1);
    let of = |aovs| {
        let run = Run {
            scene: &scene,
            tracer: &tracer,
            engine: &engine,
            again: None,
            fewer: None,
            receivers: &receivers,
            aovs,
        };
        run.interpolated(0.04, &|_| true)
    };
    let alone = of(&[Aov::BentNormal]);
    let together = of(&[Aov::BentNormal, Aov::Visibility]);
    assert_eq!(alone.gathered, together.gathered);
}

#[test]
fn what_is_refused_is_gathered_at_every_receiver() {
    with_walls(1, |run| {
        let found = run.interpolated(0.3, &|_| false);
        assert!(found.is_refused && found.gathered >= run.receivers.len());
        let whole = run.whole();
        let [a, b] = [&found.results, &whole].map(|all| values(all, Aov::IrradianceIndirect));
        assert!(a == b, "{}", relative_rmse(a, b));
    });
}

/// Results that are refused however smooth their cells are: every seed looks once more, in other directions, and no other
/// receiver has to.
#[test]
fn what_is_refused_is_first_looked_at_again() {
    with_walls(1, |run| {
        let accepting = |offer: usize| {
            let offers = Cell::new(0);
            let found = run.interpolated(0.1, &|_| offers.replace(offers.get() + 1) + 1 >= offer);
            assert!(
                offers.get() == offer + 1 && !found.is_refused,
                "{} {offer} {} {}",
                offers.get(),
                found.is_refused,
                found.gathered
            );
            found
        };
        // Twice cells are made smoother first.
        let (once, twice) = (accepting(2), accepting(3));
        assert_eq!((once.refusals, twice.refusals), (1, 2));
        assert!(
            run.interpolated_after(2, 0.1, &|_| true) == twice,
            "another frame"
        );
        assert!(
            2 * twice.gathered < run.receivers.len(),
            "{}",
            twice.gathered
        );
        let baked = spots(run.scene, run.tracer);
        let finer = RaysEngine::new(run.tracer, Some(source(&baked)), rays(2048, 0.7));
        let truth = Run {
            engine: &finer,
            ..run
        }
        .whole();
        let error = |found: &Interpolated| {
            let [found, truth] =
                [&found.results, &truth].map(|it| values(it, Aov::IrradianceIndirect));
            relative_rmse(found, truth)
        };
        let (once, twice) = (error(&once), error(&twice));
        assert!(twice < 0.85 * once, "{twice} {once}");
    });
}

/// On a floor below a square roof: fewer rays see where neighbors even out what these err by. Where that is refused as many
/// others see too, and the mean is closer than what all of them alone come to.
#[test]
fn fewer_rays_see_first_and_others_where_that_is_refused() {
    let (scene, floor, corners) = floor_under_a_roof(96);
    let tracer = Tracer::new(&scene);
    let receivers = receivers_in(&scene, floor, 1);
    let (all, few) = (rays(256, 0.0), rays(160, 0.0).otherwise());
    let [usual, first, second] =
        [all, few, few.again()].map(|settings| RaysEngine::new(&tracer, None, settings));
    let run = Run {
        scene: &scene,
        tracer: &tracer,
        engine: &usual,
        again: None,
        fewer: Some(([&first, &second], 1.42)),
        receivers: &receivers,
        aovs: &[Aov::Visibility],
    };
    #[expect(clippy::cast_possible_truncation, reason = "compared with f32")]
    let open = |&place: &Vec3| 1.0 - polygon_irradiance(place, Vec3::Y, &corners) as f32 / PI;
    let truth: Vec<f32> = receivers.position.iter().map(open).collect();
    let error = |found: &Interpolated| {
        let found = values(&found.results, Aov::Visibility);
        relative_rmse(found, &truth)
    };
    let once = run.interpolated(0.02, &|_| true);
    assert!(once.is_by_fewer && once.refusals == 0, "{}", once.gathered);
    assert!(4 * once.gathered < receivers.len(), "{}", once.gathered);
    let offers = Cell::new(0);
    let twice = run.interpolated(0.02, &|_| offers.replace(offers.get() + 1) > 0);
    assert!(!twice.is_by_fewer && twice.refusals == 1 && !twice.is_refused);
    let other_frame = run.interpolated_after(1, 0.02, &|_| true);
    assert!(other_frame == twice);
    let alone = Run { fewer: None, ..run }.interpolated(0.02, &|_| true);
    let [once, twice, alone] = [&once, &twice, &alone].map(error);
    assert!(
        once < 0.02 && twice < alone && twice < once,
        "{once} {twice} {alone}"
    );
}

/// Refuses what it sees first at its few receivers, and keeps what it sees there last.
#[derive(Default)]
struct Picky {
    /// How often it saw all, and a few.
    asked: Cell<[u32; 2]>,
    last: RefCell<Results>,
}

impl Judge for Picky {
    fn accepts(&self, results: &Results) -> bool {
        assert!(results.get(Aov::Visibility).is_some() || results.get(Aov::Occlusion).is_some());
        let [all, few] = self.asked.get();
        self.asked.set([all + 1, few]);
        true
    }

    fn picks(&self) -> &[usize] {
        &[7, 1000, 3]
    }

    fn accepts_at_picks(&self, few: &Results) -> bool {
        let [all, asked] = self.asked.get();
        self.asked.set([all, asked + 1]);
        self.last.replace(few.clone());
        asked > 0
    }
}

/// Before what follows from blended values is found everywhere it is at the few receivers that a judge looks at.
#[test]
fn a_judge_sees_few_receivers_first() {
    let (scene, floor, _) = floor_under_a_roof(96);
    let tracer = Tracer::new(&scene);
    let run = Run {
        scene: &scene,
        tracer: &tracer,
        engine: &RaysEngine::new(&tracer, None, rays(128, 0.0)),
        again: None,
        fewer: None,
        receivers: &receivers_in(&scene, floor, 1),
        aovs: &[Aov::Occlusion, Aov::DiffuseAlbedo],
    };
    let judge = Picky::default();
    let found = run.judged(0, 0.02, &judge);
    // What is blended twice, all that is asked for once.
    assert!(judge.asked.get() == [3, 2] && found.refusals == 1);
    assert!(found.results.subset(judge.picks()) == judge.last.take());
}

/// Receivers so far apart that none speaks for its neighbors: what fewer rays err by would be seen.
#[test]
fn fewer_rays_do_not_see_where_little_is_smooth() {
    with_walls(5, |run| {
        let alone = run.interpolated(0.02, &|_| true);
        let again = run.again.expect("a box's walls are looked at again");
        let found = Run {
            fewer: Some(([again, again], 1.4)),
            ..run
        }
        .interpolated(0.02, &|_| true);
        assert!(!found.is_by_fewer && found == alone);
    });
}

/// What walls reflect towards the middle of the box, by so many rays: one half is plastic (roughness 0.5), one smooth metal.
fn with_gloss(count: u32, check: impl FnOnce(Run<'_>)) {
    let mut scene = ball_in_a_box(48);
    let metal = Material {
        metallic: Input::scalar(1.0),
        roughness: Input::scalar(0.2),
        ..Material::default()
    };
    scene.materials = vec![Material::default(), metal];
    let faces = scene.mesh_of(&scene.prims[0]).triangles.len();
    let look = |face| Some(MaterialId(u32::from(2 * face >= faces)));
    scene.prims[0].materials = FaceMaterials::PerFace((0..faces).map(look).collect());
    let tracer = Tracer::new(&scene);
    let baked = spots(&scene, &tracer);
    let mut receivers = receivers_in(&scene, PrimId(0), 3);
    receivers.toward_eye = (receivers.position.iter())
        .map(|position| (-*position).normalize())
        .collect();
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(&scene, &diagnostics);
    let lobes = Lobes {
        shader: &shader,
        lighting: None,
        tracer: &tracer,
    };
    let settings = rays(count, 0.0);
    let engine = RaysEngine::new(&tracer, Some(source(&baked)), settings);
    check(Run {
        scene: &scene,
        tracer: &tracer,
        engine: &engine.of_lobes(lobes, settings),
        again: None,
        fewer: None,
        receivers: &receivers,
        aovs: &[Aov::SpecularIndirect],
    });
}

/// Few receivers on plastic speak for the others, and none for what is as smooth as the metal.
#[test]
fn rough_gloss_is_interpolated_and_smooth_gloss_is_not() {
    let gloss = |results: &Results| values(results, Aov::SpecularIndirect).to_vec();
    let mut truth = Vec::new();
    with_gloss(384, |run| truth = gloss(&run.whole()));
    with_gloss(64, |run| {
        let kinds = run.engine.kinds(run.receivers).expect("lobes");
        let half = kinds.len() / 2;
        assert!(kinds[..half].iter().all(|kind| *kind == Some(0)));
        assert!(kinds[half..].iter().all(Option::is_none));
        let whole = gloss(&run.whole());
        let found = run.interpolated(0.05, &|_| true);
        let few = gloss(&found.results);
        assert!(found.gathered > half && 4 * found.gathered < 7 * half);
        assert!(few[3 * half..] == whole[3 * half..]);
        let [all, few] =
            [&whole, &few].map(|it| relative_rmse(&it[..3 * half], &truth[..3 * half]));
        assert!(few < all + 0.01 && few > 0.0, "{few} {all}");
    });
}

/// The same receivers, and once more with their normals reversed.
fn on_both_sides(above: &Receivers) -> Receivers {
    let mut both = above.clone();
    let turned = |normals: &[Vec3]| normals.iter().map(|normal| -normal).collect::<Vec<_>>();
    both.position.extend_from_slice(&above.position);
    both.prim.extend_from_slice(&above.prim);
    both.surface.extend_from_slice(&above.surface);
    both.normal.extend(turned(&above.normal));
    both.geometric_normal
        .extend(turned(&above.geometric_normal));
    both
}

/// Two sheets a thousandth apart under a sky: their outer sides see all of it, their inner sides none.
#[test]
fn the_sides_of_thin_walls_do_not_speak_for_each_other() {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    let corner = Vec3::new(-1.0, 0.0, -1.0);
    let (u, v) = (2.0 * Vec3::Z, 2.0 * Vec3::X);
    let upper = builder.mesh("upper", plate(corner, u, v, 64), gray);
    builder.mesh("lower", plate(corner - Vec3::Y * 1e-3, u, v, 1), gray);
    builder.sky(Vec3::ONE);
    let scene = builder.build();
    let tracer = Tracer::new(&scene);
    let receivers = on_both_sides(&receivers_in(&scene, upper, 1));
    let engine = RaysEngine::new(&tracer, None, rays(64, 0.0));
    let run = Run {
        scene: &scene,
        tracer: &tracer,
        engine: &engine,
        again: None,
        fewer: None,
        receivers: &receivers,
        aovs: &[
            Aov::Occlusion,
            Aov::BentNormal,
            Aov::IrradianceEnvironment,
            Aov::VisibilitySh,
        ],
    };
    let found = run.interpolated(0.02, &|_| true);
    let (occlusion, sky) = (
        values(&found.results, Aov::Occlusion),
        values(&found.results, Aov::IrradianceEnvironment),
    );
    for (i, normal) in receivers.normal.iter().enumerate() {
        if normal.y > 0.0 {
            assert_eq!(occlusion[i], 0.0);
            assert!((sky[3 * i] - PI).abs() < 1e-4);
        } else if receivers.position[i].abs().max_element() < 0.9 {
            assert!(
                occlusion[i] > 0.99 && sky[3 * i] < 0.03 * PI,
                "{}",
                occlusion[i]
            );
        }
    }
    let bent = values(&found.results, Aov::BentNormal);
    assert!(
        bent.chunks(3)
            .all(|bent| (Vec3::from_slice(bent).length() - 1.0).abs() < 1e-3)
    );
    let order: Vec<Aov> = found
        .results
        .buffers
        .iter()
        .map(|buffer| buffer.aov)
        .collect();
    assert_eq!(order, run.aovs);
    // The inner side has no room: all of it is gathered at, and little of the outer one.
    assert!(
        found.gathered < receivers.len() / 2 + receivers.len() / 20,
        "{}",
        found.gathered
    );
}

/// What hangs on occlusion and reflected light, but is not interpolated itself, follows from them.
#[test]
fn parts_add_up() {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::new(0.2, 0.5, 0.8), Vec3::splat(0.1));
    let floor = plate(Vec3::new(-2.0, 0.0, -2.0), 4.0 * Vec3::Z, 4.0 * Vec3::X, 64);
    let floor = builder.mesh("floor", floor, gray);
    let ball = bowl(Vec3::new(0.0, 0.5, 0.0), 0.5, PI, 24, Side::Outside);
    builder.mesh("ball", ball, gray);
    builder.sky(Vec3::new(1.0, 0.5, 0.25));
    let scene = builder.build();
    let tracer = Tracer::new(&scene);
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(&scene, &diagnostics);
    let lighting = Lighting::new(&shader, LightSamples::SURFEL, &diagnostics);
    let settings = BakeSettings {
        spacing: None,
        surfels: 10_000,
        ..BakeSettings::default()
    };
    let baked = bake(&shader, &tracer, &lighting, &settings, &diagnostics).expect("not cancelled");
    let receivers = receivers_in(&scene, floor, 1);
    let engine = RaysEngine::new(&tracer, Some(source(&baked)), rays(64, 0.0));
    let aovs = [
        Aov::IrradianceDirect,
        Aov::IrradianceEnvironment,
        Aov::IrradianceIndirect,
        Aov::Irradiance,
        Aov::DiffuseIndirect,
        Aov::Visibility,
        Aov::Color,
    ];
    let run = Run {
        scene: &scene,
        tracer: &tracer,
        engine: &engine,
        again: None,
        fewer: None,
        receivers: &receivers,
        aovs: &aovs,
    };
    let found = run.interpolated(0.05, &|_| true).results;
    let at = |aov: Aov, i: usize| Vec3::from_slice(&values(&found, aov)[aov.components() * i..]);
    let albedo = Vec3::new(0.2, 0.5, 0.8);
    for i in 0..receivers.len() {
        let open = values(&found, Aov::Visibility)[i];
        let sky = Vec3::new(1.0, 0.5, 0.25) * PI * open;
        let (direct, indirect) = (at(Aov::IrradianceDirect, i), at(Aov::IrradianceIndirect, i));
        let all = at(Aov::Irradiance, i);
        assert!(at(Aov::IrradianceEnvironment, i).abs_diff_eq(sky, 1e-4));
        assert!(all.abs_diff_eq(direct + sky + indirect, 1e-4), "{all}");
        assert!(at(Aov::DiffuseIndirect, i).abs_diff_eq(albedo / PI * indirect, 1e-4));
        let color = at(Aov::Color, i);
        assert!(color.abs_diff_eq(albedo / PI * all + 0.1, 1e-4), "{color}");
    }
}

#[test]
fn few_receivers_and_kinds_that_hang_on_the_eye_are_all_gathered_at() {
    for (step, aov) in [(20, Aov::Visibility), (2, Aov::ErrorIrradianceIndirect)] {
        with_walls(step, |run| {
            let aovs = &[aov];
            let run = Run { aovs, ..run };
            let found = run.interpolated(0.05, &|_| false);
            assert_eq!(found.gathered, run.receivers.len());
            assert!(!found.is_refused && found.results == run.whole());
        });
    }
}
