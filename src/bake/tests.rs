use super::*;
use crate::lighting::ShadePoint;
use crate::scene::Prim;
use crate::scene::{
    FaceMaterials, Interpolation, Mesh, MeshId, Normals, PrimSource, Primvar, Purpose, StageInfo,
    UpAxis,
};
use crate::shading::Surface;
use crate::surfels::Sides;
use crate::trace::testing;
use glam::{Affine3A, DVec3, Vec2, Vec4};

fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, closed: bool) -> Mesh {
    let faces = u32::try_from(triangles.len()).unwrap();
    Mesh {
        positions,
        triangles,
        triangle_faces: (0..faces).collect(),
        normals: Normals::Flat,
        primvars: vec![Primvar {
            name: "unused".into(),
            components: 1,
            interpolation: Interpolation::Constant,
            values: vec![Vec4::ONE],
        }],
        double_sided: false,
        closed,
        cage: None,
        scheme: "none".into(),
    }
}

/// The unit square in XZ, facing +Y, as `n` × `n` quads.
fn floor(n: u32) -> Mesh {
    let line = n + 1;
    let at = |i: u32| i as f32 / n as f32;
    let positions = (0..line * line).map(|i| Vec3::new(at(i % line), 0.0, at(i / line)));
    let quad = |i: u32| {
        let a = i / n * line + i % n;
        [[a, a + line, a + 1], [a + 1, a + line, a + line + 1]]
    };
    mesh(
        positions.collect(),
        (0..n * n).flat_map(quad).collect(),
        false,
    )
}

/// A box around the origin, facing outwards, inwards for a negative size.
fn cube(size: f32) -> Mesh {
    let (positions, quads) = testing::cube(size);
    let triangles = quads
        .iter()
        .flat_map(|q: &[u32; 4]| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
    mesh(positions, triangles.collect(), true)
}

fn scene(meshes: Vec<(Mesh, Affine3A)>) -> Scene {
    let prim = |(i, (_, place)): (u32, &(Mesh, Affine3A))| Prim {
        path: format!("/prim{i}").into(),
        mesh: MeshId(i),
        world_from_object: *place,
        materials: FaceMaterials::Whole(None),
        purpose: Purpose::Default,
        source: PrimSource::Direct,
    };
    Scene {
        stage: StageInfo {
            path: "test.usda".into(),
            up_axis: UpAxis::Y,
            meters_per_unit: 1.0,
            default_prim: None,
            time_range: None,
            time_codes_per_second: 24.0,
            time: None,
            layers: vec![],
            variants: Vec::new(),
            reader: "native".into(),
        },
        origin: DVec3::ZERO,
        prims: (0..).zip(&meshes).map(prim).collect(),
        meshes: meshes.into_iter().map(|(mesh, _)| mesh).collect(),
        materials: vec![],
        lights: vec![],
        cameras: vec![],
        render_settings: vec![],
    }
}

const GRAY: Surface = Surface {
    albedo: Vec3::splat(0.5),
    emission: Vec3::new(1.0, 0.0, 0.0),
    opacity: 1.0,
};

fn bake_lit(
    scene: &Scene,
    settings: BakeSettings,
    lights: &(dyn Fn(&ShadePoint) -> Vec3 + Sync),
) -> Baked {
    let look = Look {
        is_screen: &|_| false,
        surface: &|_| GRAY,
        lights,
        glance: &|point, _| lights(point),
        wide: &|points| vec![Vec3::ZERO; points.len()],
    };
    bake_with(scene, &look, &settings, &Diagnostics::default()).unwrap()
}

fn budget(surfels: usize) -> BakeSettings {
    BakeSettings {
        spacing: None,
        surfels,
        ..BakeSettings::default()
    }
}

fn total(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value)).sum()
}

/// Reflected power over area · albedo · irradiance 1, front only.
fn mean_light(baked: &Baked) -> f64 {
    let front = |i: &usize| baked.cloud.normal[*i].y > 0.0;
    let power = |i: usize| f64::from(baked.cloud.reflected(i).y * baked.cloud.area[i]);
    (0..baked.cloud.len()).filter(front).map(power).sum::<f64>() / 0.5
}

#[test]
fn areas_sum_to_the_surface_also_of_stretched_and_mirrored_instances() {
    let place = Affine3A::from_scale(Vec3::new(-2.0, 1.0, 3.0));
    let scene = scene(vec![
        (floor(3), place),
        (cube(2.0), Affine3A::from_translation(Vec3::splat(9.0))),
    ]);
    let baked = bake_lit(&scene, budget(5000), &|_| Vec3::ZERO);
    let expected = 2.0 * 6.0 + 24.0;
    assert!((total(&baked.cloud.area) / expected - 1.0).abs() < 1e-5);
    assert!(
        (4900..5100).contains(&baked.cloud.len()),
        "{}",
        baked.cloud.len()
    );
    assert_eq!(baked.cloud.len(), baked.dice.surfel_count());
    // Front of the mirrored floor is still +Y; emission is there only.
    let front = baked.dice.surfel_at(0, 0, 0.2, 0.2, true).unwrap() as usize;
    let back = baked.dice.surfel_at(0, 0, 0.2, 0.2, false).unwrap() as usize;
    assert_eq!(baked.cloud.normal[front], Vec3::Y);
    assert_eq!(baked.cloud.normal[back], -Vec3::Y);
    assert_eq!(baked.cloud.radiosity[front], PI * Vec3::X);
    assert_eq!(baked.cloud.radiosity[back], Vec3::ZERO);
    // The box: outside only, every normal away from its center.
    assert_eq!(baked.dice.surfel_at(1, 0, 0.2, 0.2, false), None);
    for i in 0..baked.cloud.len() {
        let outwards = (baked.cloud.position[i] - 9.0).dot(baked.cloud.normal[i]);
        assert!(baked.cloud.prim[i] == 0 || outwards > 0.99);
    }
}

#[test]
fn disks_of_surfels_cover_every_point_of_their_triangle() {
    let scene = scene(vec![(floor(2), Affine3A::from_rotation_x(0.3))]);
    let baked = bake_lit(&scene, budget(500), &|_| Vec3::ZERO);
    let world = PlacedMesh::of(&scene, crate::scene::PrimId(0));
    for t in 0..world.triangle_count() {
        let [a, b, c] = world.corners(t);
        for i in 0..1000 {
            let (u, v) = ((i % 33) as f32 / 33.0, (i / 33) as f32 / 33.0);
            if u + v <= 1.0 {
                let surfel = baked.dice.surfel_at(0, t, u, v, true).unwrap() as usize;
                let point = a + (b - a) * u + (c - a) * v;
                let distance = point.distance(baked.cloud.position[surfel]);
                assert!(distance <= baked.cloud.radius[surfel] * 1.001);
            }
        }
    }
}

#[test]
fn a_room_has_surfels_inside_and_a_solid_outside() {
    let sides = |meshes: Vec<Mesh>| {
        let meshes = meshes.into_iter();
        let scene = scene(meshes.map(|mesh| (mesh, Affine3A::IDENTITY)).collect());
        sides::of_prims(&scene, &|_| false)
    };
    let inside_out = |size| Mesh {
        triangles: cube(size)
            .triangles
            .into_iter()
            .map(|[a, b, c]| [a, c, b])
            .collect(),
        ..cube(size)
    };
    assert_eq!(sides(vec![cube(1.0)]), [Sides::Front]);
    assert_eq!(sides(vec![inside_out(1.0)]), [Sides::Both]);
    assert_eq!(
        sides(vec![inside_out(9.0), cube(1.0)]),
        [Sides::Front, Sides::Both]
    );
    assert_eq!(sides(vec![floor(1)]), [Sides::Both]);
    // A small box off the middle of the large one lies in it, but not the other way round.
    let off = (cube(1.0), Affine3A::from_translation(Vec3::X * 3.0));
    let scene = scene(vec![(cube(9.0), Affine3A::IDENTITY), off]);
    assert_eq!(
        sides::of_prims(&scene, &|_| false),
        [Sides::Both, Sides::Front]
    );
    // The back of what is seen through is seen.
    assert_eq!(
        sides::of_prims(&scene, &|prim| prim == crate::scene::PrimId(1)),
        [Sides::Both, Sides::Both]
    );
}

#[test]
fn power_behind_a_sharp_shadow_edge_is_that_of_fine_truth_within_one_percent() {
    let normal = Vec2::new(0.8, 0.6);
    let lit = |p: &ShadePoint| {
        Vec3::splat(f32::from(
            Vec2::new(p.position.x, p.position.z).dot(normal) < 0.63,
        ))
    };
    // Area of the unit square on the lit side of the line, by counting 10⁶ points.
    let steps = |i: u32| (i as f32 + 0.5) / 1000.0;
    let truth = (0..1_000_000_u32)
        .filter(|i| Vec2::new(steps(i % 1000), steps(i / 1000)).dot(normal) < 0.63)
        .count() as f64
        / 1e6;
    for (quads, surfels) in [(1, 400), (10, 100), (3, 800)] {
        let scene = scene(vec![(floor(quads), Affine3A::IDENTITY)]);
        let baked = bake_lit(&scene, budget(surfels), &lit);
        let light = mean_light(&baked);
        assert!(
            (light / truth - 1.0).abs() < 0.01,
            "{quads}: {light} for {truth}"
        );
    }
}

#[test]
fn cells_far_from_a_shadow_edge_cost_one_evaluation() {
    let count = std::sync::atomic::AtomicUsize::new(0);
    let lit = |p: &ShadePoint| {
        count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        Vec3::splat(f32::from(p.position.x < 0.5))
    };
    for quads in [1, 50] {
        count.store(0, std::sync::atomic::Ordering::Relaxed);
        let scene = scene(vec![(floor(quads), Affine3A::IDENTITY)]);
        let baked = bake_lit(&scene, budget(10_000), &lit);
        let evaluations = count.load(std::sync::atomic::Ordering::Relaxed);
        assert!(
            evaluations < baked.cloud.len() * 5 / 4,
            "{evaluations} for {}",
            baked.cloud.len()
        );
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let scene = scene(vec![
        (floor(1), Affine3A::from_scale(Vec3::splat(3.0))),
        (cube(0.5), Affine3A::IDENTITY),
        (ball(50), Affine3A::from_scale(Vec3::splat(0.2))),
    ]);
    let lit = |p: &ShadePoint| Vec3::splat(p.position.x.sin().abs());
    let clouds = [1, 7].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| bake_lit(&scene, budget(30_000), &lit))
            .cloud
    });
    assert_eq!(clouds[0], clouds[1]);
}

#[test]
fn scenes_without_area_give_empty_clouds() {
    let flat = Affine3A::from_scale(Vec3::new(0.0, 0.0, 1.0));
    for scene in [
        scene(vec![]),
        scene(vec![(floor(2), flat)]),
        scene(vec![(mesh(vec![], vec![], false), flat)]),
    ] {
        let baked = bake_lit(&scene, BakeSettings::default(), &|_| Vec3::ONE);
        assert!(baked.cloud.is_empty());
    }
}

#[test]
fn an_absurd_spacing_is_coarsened_with_a_warning() {
    let scene = scene(vec![(floor(1), Affine3A::IDENTITY)]);
    let diagnostics = Diagnostics::default();
    let settings = BakeSettings {
        spacing: Some(1e-9),
        surfels: 1,
        ..BakeSettings::default()
    };
    let (_, spacing) = spacing::dice(&scene, &[Sides::Both], &settings, &diagnostics).unwrap();
    assert!(spacing > 1e-5);
    assert_eq!(diagnostics.warnings()[0].kind, "spacing-too-fine");
}

#[test]
fn a_dense_mesh_does_not_leave_the_floor_undiced() {
    let small = Affine3A::from_scale(Vec3::splat(0.1));
    let scene = scene(vec![(floor(100), small), (floor(1), Affine3A::IDENTITY)]);
    let baked = bake_lit(&scene, budget(10_000), &|_| Vec3::ZERO);
    assert!(baked.dice.prims()[1].table().cell_count() > 1000);
}

#[test]
fn a_cancelled_bake_ends() {
    let diagnostics = Diagnostics::default();
    diagnostics.cancel_token().cancel();
    let look = Look {
        is_screen: &|_| false,
        surface: &|_| GRAY,
        lights: &|_| Vec3::ZERO,
        glance: &|_, _| Vec3::ZERO,
        wide: &|points| vec![Vec3::ZERO; points.len()],
    };
    let scene = scene(vec![(floor(1), Affine3A::IDENTITY)]);
    assert!(bake_with(&scene, &look, &BakeSettings::default(), &diagnostics).is_err());
}

/// The unit sphere as `4 n²` triangles times two, facing outwards.
fn ball(n: u32) -> Mesh {
    let (columns, rows) = (4 * n, 2 * n);
    let at = |i: u32| {
        let (row, column) = (i / columns, i % columns);
        let (theta, phi) = (
            PI * row as f32 / rows as f32,
            2.0 * PI * column as f32 / columns as f32,
        );
        Vec3::new(
            theta.sin() * phi.cos(),
            theta.cos(),
            -theta.sin() * phi.sin(),
        )
    };
    let quad = |i: u32| {
        let (row, column) = (i / columns, i % columns);
        let right = row * columns + (column + 1) % columns;
        [
            [i, i + columns, right + columns],
            [i, right + columns, right],
        ]
    };
    mesh(
        (0..columns * (rows + 1)).map(at).collect(),
        (0..columns * rows).flat_map(quad).collect(),
        true,
    )
}

/// Area · radiosity over all surfels.
fn power(cloud: &SurfelCloud) -> f64 {
    let of = |i: usize| f64::from(cloud.radiosity[i].y * cloud.area[i]);
    (0..cloud.len()).map(of).sum()
}

fn spaced(spacing: f32) -> BakeSettings {
    BakeSettings {
        spacing: Some(spacing),
        surfels: 1,
        ..BakeSettings::default()
    }
}

#[test]
fn a_dense_mesh_keeps_to_the_budget_and_its_area() {
    for (mesh, place) in [
        (ball(100), Affine3A::IDENTITY),
        (floor(200), Affine3A::from_rotation_x(0.7)),
    ] {
        let scene = scene(vec![(mesh, place)]);
        let dense = bake_lit(&scene, spaced(0.01), &|_| Vec3::ZERO);
        let all = dense.cloud.len();
        for surfels in [400, 2000, all / 4] {
            let baked = bake_lit(&scene, budget(surfels), &|_| Vec3::ZERO);
            let ratio = baked.cloud.len() as f64 / surfels as f64;
            // A square of whole cells has 13² or 15², not 14.1².
            assert!((0.8..1.2).contains(&ratio), "{ratio} of {surfels}");
            let areas = total(&baked.cloud.area) / total(&dense.cloud.area);
            assert!((areas - 1.0).abs() < 1e-5, "{areas}");
        }
    }
}

#[test]
fn clusters_are_compact_face_one_way_and_cover_their_triangles() {
    let scene = scene(vec![(ball(60), Affine3A::from_scale(Vec3::splat(2.0)))]);
    let spacing = 0.25;
    let baked = bake_lit(&scene, spaced(spacing), &|_| Vec3::ZERO);
    let world = PlacedMesh::of(&scene, crate::scene::PrimId(0));
    for t in 0..world.triangle_count() {
        let Some(surfel) = baked.dice.surfel_at(0, t, 0.3, 0.3, true) else {
            assert!(world.area(t) < 1e-9, "only the poles have no area");
            continue;
        };
        let surfel = surfel as usize;
        let facing = world.plane_normal(t).dot(baked.cloud.normal[surfel]);
        assert!(facing > 40_f32.to_radians().cos(), "{facing}");
        for corner in world.corners(t) {
            let distance = corner.distance(baked.cloud.position[surfel]);
            assert!(distance <= baked.cloud.radius[surfel] * 1.001);
        }
        // On the surface, and no wider than a cell and the triangles at its rim.
        assert!((baked.cloud.position[surfel].length() - 2.0).abs() < 0.01);
        assert!(baked.cloud.radius[surfel] < 1.7 * spacing);
    }
    let mean = total(&baked.cloud.area) / baked.cloud.len() as f64;
    let cells = mean / f64::from(spacing).powi(2);
    assert!((0.4..1.1).contains(&cells), "{cells}");
}

#[test]
fn opposite_sheets_close_together_are_clustered_apart() {
    let sheet = floor(40);
    let count = u32::try_from(sheet.positions.len()).unwrap();
    let below = sheet.positions.iter().map(|p| *p - Vec3::Y * 1e-3);
    let flipped = sheet
        .triangles
        .iter()
        .map(|t| [t[0], t[2], t[1]].map(|i| i + count));
    let same = sheet.triangles.iter().map(|t| t.map(|i| i + count));
    for (triangles, ways) in [
        (flipped.collect::<Vec<_>>(), [Vec3::Y, -Vec3::Y]),
        (same.collect(), [Vec3::Y, Vec3::Y]),
    ] {
        let scene = scene(vec![(
            mesh(
                sheet
                    .positions
                    .iter()
                    .copied()
                    .chain(below.clone())
                    .collect(),
                sheet.triangles.iter().copied().chain(triangles).collect(),
                false,
            ),
            Affine3A::IDENTITY,
        )]);
        // Nine cells across: none is cut at the rim.
        let baked = bake_lit(&scene, spaced(1.0 / 9.0), &|_| Vec3::ZERO);
        assert!(baked.cloud.len() < 1000, "{}", baked.cloud.len());
        for t in 0..6400 {
            let surfel = baked.dice.surfel_at(0, t, 0.3, 0.3, true).unwrap() as usize;
            assert!(baked.cloud.normal[surfel].distance(ways[(t / 3200) as usize]) < 1e-5);
            // A cluster has triangles of one sheet: its position is on that one.
            let height = -1e-3 * (t / 3200) as f32;
            assert!((baked.cloud.position[surfel].y - height).abs() < 1e-6);
        }
    }
}

#[test]
fn soups_of_unconnected_triangles_are_clustered_too() {
    let sheet = floor(60);
    let corners = sheet
        .triangles
        .iter()
        .flat_map(|t| t.map(|i| sheet.positions[i as usize]));
    let positions: Vec<Vec3> = corners.collect();
    let triangles = (0..7200).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let scene = scene(vec![(
        mesh(positions, triangles, false),
        Affine3A::IDENTITY,
    )]);
    let baked = bake_lit(&scene, budget(400), &|_| Vec3::ZERO);
    assert!(
        (320..480).contains(&baked.cloud.len()),
        "{}",
        baked.cloud.len()
    );
}

#[test]
fn instances_of_a_size_share_their_cells_and_keep_their_own_area() {
    let mut scene = scene(vec![(ball(30), Affine3A::IDENTITY)]);
    let template = scene.prims[0].clone();
    let turn =
        |i: u32| Affine3A::from_rotation_y(i as f32) * Affine3A::from_rotation_x(2.0 * i as f32);
    scene.prims = (0..100)
        .map(|i| Prim {
            world_from_object: Affine3A::from_translation(Vec3::X * 5.0 * i as f32) * turn(i),
            ..template.clone()
        })
        .collect();
    let baked = bake_lit(&scene, budget(20_000), &|_| Vec3::ZERO);
    assert!(
        (18_000..22_000).contains(&baked.cloud.len()),
        "{}",
        baked.cloud.len()
    );
    assert!(baked.dice.bytes() < 2 * baked.dice.prims()[0].table().bytes());
    let area: f64 = {
        let world = PlacedMesh::new(&scene, &template);
        (0..world.triangle_count()).map(|t| world.area(t)).sum()
    };
    assert!((total(&baked.cloud.area) / (100.0 * area) - 1.0).abs() < 1e-5);
    // Unlike sizes and proportions have tables of their own.
    scene.prims[1].world_from_object = Affine3A::from_scale(Vec3::splat(3.0));
    scene.prims[2].world_from_object = Affine3A::from_scale(Vec3::new(1.0, 2.0, 1.0));
    let baked = bake_lit(&scene, budget(20_000), &|_| Vec3::ZERO);
    let counts: Vec<_> = (0..4)
        .map(|i| baked.dice.prims()[i].table().cell_count())
        .collect();
    // The large one has 9 times the area, less what the turning of its surface asks of the small ones.
    assert!(counts[1] > 4 * counts[0], "{counts:?}");
    assert!(
        counts[2] > counts[0] && counts[3] == counts[0],
        "{counts:?}"
    );
}

#[test]
fn clusters_reflect_and_emit_what_their_triangles_do() {
    // Emission and albedo differ between triangles; light falls off to a terminator, with a sharp shadow beside it.
    let surface = |point: &SurfacePoint| {
        let odd = (point.triangle / 7 % 3) as f32;
        Surface {
            albedo: Vec3::splat(0.2 + 0.3 * odd),
            emission: Vec3::splat(0.1 * odd),
            opacity: 1.0,
        }
    };
    let lights =
        |p: &ShadePoint| Vec3::splat(p.normal.y.max(0.0) * 3.0 * f32::from(p.position.x < 0.3));
    let scene = scene(vec![(ball(60), Affine3A::IDENTITY)]);
    let bake = |settings: BakeSettings| {
        let look = Look {
            is_screen: &|_| false,
            surface: &surface,
            lights: &lights,
            glance: &|point, _| lights(point),
            wide: &|points| {
                points
                    .iter()
                    .map(|p| Vec3::splat(0.5 + 0.5 * p.normal.x))
                    .collect()
            },
        };
        bake_with(&scene, &look, &settings, &Diagnostics::default()).unwrap()
    };
    let fine = bake(spaced(0.01)).cloud;
    for surfels in [1000, 4000] {
        let coarse = bake(budget(surfels)).cloud;
        assert!(coarse.len() < 2 * surfels);
        let ratio = power(&coarse) / power(&fine);
        assert!((ratio - 1.0).abs() < 0.01, "{surfels}: {ratio}");
    }
}

#[test]
fn emission_stays_on_the_front_of_clusters() {
    let scene = scene(vec![(floor(40), Affine3A::IDENTITY)]);
    let baked = bake_lit(&scene, budget(100), &|_| Vec3::ZERO).cloud;
    assert!(baked.len() < 200);
    let of_side = |up: bool| {
        let sum = (0..baked.len()).filter(|i| (baked.normal[*i].y > 0.0) == up);
        sum.map(|i| f64::from(baked.emission[i].x * baked.area[i]))
            .sum::<f64>()
    };
    assert!((of_side(true) / f64::from(PI) - 1.0).abs() < 1e-4);
    assert_eq!(of_side(false), 0.0);
}
