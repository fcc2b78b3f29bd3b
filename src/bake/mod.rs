//! Scene → [`SurfelCloud`]: dice every surface, shade every micropolygon, light it. PBGI §4.
//!
//! One surfel a cell and side that can be seen (`sides`). Large triangles are cut into cells: exact area and centroid,
//! the plane's normal, a radius that reaches the cell's farthest corner. Small triangles are clustered into cells
//! (`cluster`), the same ones for all instances of a mesh that are of a size (`shapes`). Albedo and emission are averaged over the cell by the shader;
//! emission is of the front only, while every surface reflects on both sides. Light is averaged as `light` says.

mod blocks;
mod cluster;
mod light;
mod shapes;
mod sides;
mod spacing;
mod world;

use crate::diagnostics::{Cancelled, Diagnostics};
use crate::lighting::{Lighting, ShadePoint};
use crate::scene::{FaceMaterials, Scene};
use crate::shading::{Shader, Surface, SurfacePoint};
use crate::surfels::triangle_dice::{Part, Row};
use crate::surfels::{DiceMap, SurfelCloud};
use crate::trace::Tracer;
use blocks::{Block, BlockColumns, front};
use cluster::{Cluster, mean_light};
use glam::Vec3;
use light::{Look, Side, Steepness, quartered};
use rayon::prelude::*;
use std::f32::consts::PI;
use world::WorldMesh;

/// How finely to dice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BakeSettings {
    /// Edge length of a micropolygon, stage units; `None` = from `surfels`. Triangles smaller than that are clustered.
    pub spacing: Option<f32>,
    /// Number of surfels aimed at when no spacing is given. Every prim has some for each direction its surface faces
    /// (up to 26) on each side that can be seen; where that alone exceeds the number, the rest is diced up to 4 times
    /// as coarsely as it would be.
    pub surfels: usize,
}

impl Default for BakeSettings {
    fn default() -> Self {
        Self {
            spacing: None,
            surfels: 200_000,
        }
    }
}

/// A cloud and the way from a point on a surface to its surfel.
#[derive(Debug)]
pub struct Baked {
    /// The surfels.
    pub cloud: SurfelCloud,
    /// Which surfel covers which part of which triangle.
    pub dice: DiceMap,
}

/// Dice, shade and light the scene of `shader`. The same bits for any number of threads.
///
/// # Errors
/// When cancelled.
pub fn bake(
    shader: &Shader<'_>,
    tracer: &Tracer,
    lighting: &Lighting,
    settings: &BakeSettings,
    diagnostics: &Diagnostics,
) -> Result<Baked, Cancelled> {
    let look = Look {
        surface: &|point| shader.surface(point),
        lights: &|point| lighting.lights(tracer, point),
        wide: &|point| {
            lighting.environment(tracer, point) + lighting.emitters(shader, tracer, point)
        },
    };
    bake_with(shader.scene(), &look, settings, diagnostics)
}

fn bake_with(
    scene: &Scene,
    look: &Look<'_>,
    settings: &BakeSettings,
    diagnostics: &Diagnostics,
) -> Result<Baked, Cancelled> {
    let sides = sides::of_prims(scene);
    let (dice, spacing) = spacing::dice(scene, &sides, settings, diagnostics)?;
    diagnostics.check()?;
    let mut cloud = empty_cloud(scene, dice.surfel_count(), spacing);
    let mut lights = vec![Vec3::ZERO; cloud.len()];
    let blocks = Block::of_all(&dice);
    let phase = diagnostics.phase("points", "surfels", cloud.len() as u64);
    let columns = BlockColumns::split(&blocks, &mut cloud, &mut lights);
    blocks
        .par_iter()
        .zip(columns)
        .try_for_each(|(block, columns)| {
            diagnostics.check()?;
            fill(scene, look, &dice, (block, columns));
            phase.advance(u64::from(block.cell_count));
            Ok(())
        })?;
    let baking = Baking {
        scene,
        look,
        dice: &dice,
        blocks: &blocks,
        lights: &lights,
        diagnostics,
    };
    baking.add_lights(&mut cloud)?;
    drop(phase);
    Ok(Baked { cloud, dice })
}

fn empty_cloud(scene: &Scene, count: usize, spacing: f32) -> SurfelCloud {
    SurfelCloud {
        origin: scene.origin,
        position: vec![Vec3::ZERO; count],
        normal: vec![Vec3::ZERO; count],
        radius: vec![0.0; count],
        area: vec![0.0; count],
        radiosity: vec![Vec3::ZERO; count],
        albedo: vec![Vec3::ZERO; count],
        emission: vec![Vec3::ZERO; count],
        prim: vec![0; count],
        prim_paths: scene.prims.iter().map(|prim| prim.path.clone()).collect(),
        spacing,
    }
}

/// Everything but the light of [`Look::lights`], which goes to a column of its own.
fn fill(
    scene: &Scene,
    look: &Look<'_>,
    dice: &DiceMap,
    (block, mut columns): (&Block, BlockColumns<'_>),
) {
    let world = WorldMesh::of(scene, block.prim);
    let side = Side {
        world: &world,
        prim: block.prim,
        back: block.back,
    };
    let table = dice.prims()[block.prim.index()].table();
    let mut next = 0;
    let mut put = |cell: &Shaded| {
        columns.put(look, &side, cell, next);
        next += 1;
    };
    block.for_each_row(table, |t, _, part, row| {
        let triangle = Triangle {
            t,
            plane_normal: world.plane_normal(t),
            area: world.area(t),
        };
        for column in 0..row.count {
            put(&shade_cell(look, &side, &triangle, (part, row, column)));
        }
    });
    let materials = &scene.prims[block.prim.index()].materials;
    for cell in block.clusters() {
        put(&shade_cluster(look, &side, table.members(cell), materials));
    }
}

/// A cell before it is lit.
struct Shaded {
    /// Where it stands and is lit.
    point: ShadePoint,
    normal: Vec3,
    radius: f32,
    area: f32,
    surface: Surface,
}

/// What the cells of a triangle share.
struct Triangle {
    t: u32,
    plane_normal: Vec3,
    area: f64,
}

#[expect(clippy::cast_possible_truncation, reason = "an area, rounded to f32")]
fn shade_cell(
    look: &Look<'_>,
    side: &Side<'_>,
    triangle: &Triangle,
    (part, row, column): (&Part, Row, u32),
) -> Shaded {
    let cell = part.cell(row, column);
    let area = (triangle.area * f64::from(cell.area)) as f32;
    let point = side.shade_point(triangle.t, cell.center, triangle.plane_normal);
    let [a, b, c] = side.world.corners(triangle.t);
    let reach = cell
        .corners
        .map(|w| (a * w.x + b * w.y + c * w.z).distance_squared(point.position));
    Shaded {
        point,
        normal: point.geometric_normal,
        radius: reach.into_iter().fold(0.0, f32::max).sqrt(),
        area,
        surface: (look.surface)(&SurfacePoint {
            prim: side.prim,
            triangle: triangle.t,
            u: cell.center.y,
            v: cell.center.z,
            footprint: area.sqrt(),
        }),
    }
}

#[expect(clippy::cast_possible_truncation, reason = "an area, rounded to f32")]
fn shade_cluster(
    look: &Look<'_>,
    side: &Side<'_>,
    members: &[u32],
    materials: &FaceMaterials,
) -> Shaded {
    let cluster = Cluster::new(side.world, members);
    let (point, surface) = cluster.shade(look, side, materials);
    Shaded {
        point,
        normal: if side.back {
            -cluster.normal
        } else {
            cluster.normal
        },
        radius: cluster.reach(point.position),
        area: cluster.area as f32,
        surface,
    }
}

impl BlockColumns<'_> {
    /// Light `cell` and write it to row `i`.
    fn put(&mut self, look: &Look<'_>, side: &Side<'_>, cell: &Shaded, i: usize) {
        self.position[i] = cell.point.position;
        self.normal[i] = cell.normal;
        self.radius[i] = cell.radius.max(f32::MIN_POSITIVE);
        self.area[i] = cell.area;
        self.albedo[i] = cell.surface.albedo;
        self.emission[i] = if side.back {
            Vec3::ZERO
        } else {
            PI * cell.surface.emission
        };
        self.prim[i] = side.prim.0;
        self.radiosity[i] = self.emission[i];
        // Black surfaces reflect nothing, whatever falls on them.
        if cell.surface.albedo != Vec3::ZERO {
            self.radiosity[i] += cell.surface.albedo * (look.wide)(&cell.point);
            self.lights[i] = (look.lights)(&cell.point);
        }
    }
}

/// What the second pass works with.
struct Baking<'a> {
    scene: &'a Scene,
    look: &'a Look<'a>,
    dice: &'a DiceMap,
    blocks: &'a [Block],
    /// Irradiance of [`Look::lights`] at the centers of all cells.
    lights: &'a [Vec3],
    diagnostics: &'a Diagnostics,
}

impl Baking<'_> {
    /// Add the reflected light of [`Look::lights`], averaged over cells at steep places.
    fn add_lights(&self, cloud: &mut SurfelCloud) -> Result<(), Cancelled> {
        let mut rest = cloud.radiosity.as_mut_slice();
        let mut tasks = Vec::new();
        // One task a side of a prim, its blocks are shared out again below.
        for run in self
            .blocks
            .chunk_by(|a, b| (a.prim, a.back) == (b.prim, b.back))
        {
            let count = run.iter().map(|block| block.cell_count as usize).sum();
            tasks.push((run, front(&mut rest, count)));
        }
        let albedo = &cloud.albedo;
        tasks
            .into_par_iter()
            .try_for_each(|(run, radiosity)| self.add_lights_to(run, albedo, radiosity))
    }

    fn add_lights_to(
        &self,
        run: &[Block],
        albedo: &[Vec3],
        mut rest: &mut [Vec3],
    ) -> Result<(), Cancelled> {
        let (prim, back) = (run[0].prim, run[0].back);
        let dice = &self.dice.prims()[prim.index()];
        let (table, surfels) = (dice.table(), dice.surfels(back));
        let surfels = surfels.start as usize..surfels.end as usize;
        let (center, albedo) = (&self.lights[surfels.clone()], &albedo[surfels]);
        if center.iter().all(|light| *light == Vec3::ZERO) {
            return Ok(());
        }
        let world = WorldMesh::of(self.scene, prim);
        let side = Side {
            world: &world,
            prim,
            back,
        };
        let steepness = Steepness::new(&world, table, center);
        let split: Vec<_> = run
            .iter()
            .map(|block| (block, front(&mut rest, block.cell_count as usize)))
            .collect();
        split.into_par_iter().try_for_each(|(block, radiosity)| {
            self.diagnostics.check()?;
            let mut next = 0;
            block.for_each_row(table, |t, first, part, row| {
                for column in 0..row.count {
                    let cell = (first + row.first + column) as usize;
                    let is_steep = albedo[cell] != Vec3::ZERO
                        && if table.is_whole(t) {
                            steepness.at_triangles(&world, &[t])
                        } else {
                            steepness.at_cell(first, part, row, column)
                        };
                    let irradiance = if is_steep {
                        quartered(self.look, &side, t, part, (row, column))
                    } else {
                        center[cell]
                    };
                    radiosity[next] += albedo[cell] * irradiance;
                    next += 1;
                }
            });
            for (radiosity, cell) in radiosity.iter_mut().zip(block.clusters()) {
                let (members, cell) = (table.members(cell), cell as usize);
                let is_steep =
                    albedo[cell] != Vec3::ZERO && steepness.at_triangles(&world, members);
                let irradiance = if is_steep {
                    mean_light(self.look, &side, members)
                } else {
                    center[cell]
                };
                *radiosity += albedo[cell] * irradiance;
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lighting::ShadePoint;
    use crate::scene::{
        FaceMaterials, Interpolation, Mesh, MeshId, Normals, PrimSource, Primvar, Purpose,
        StageInfo, UpAxis,
    };
    use crate::shading::Surface;
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
        let positions = (0..8).map(|i| {
            Vec3::new(
                (i & 1) as f32 - 0.5,
                (i >> 1 & 1) as f32 - 0.5,
                (i >> 2) as f32 - 0.5,
            ) * size
        });
        let quads = [
            [0, 4, 6, 2],
            [1, 3, 7, 5],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 2, 3, 1],
            [4, 5, 7, 6],
        ];
        let triangles = quads
            .iter()
            .flat_map(|q: &[u32; 4]| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
        mesh(positions.collect(), triangles.collect(), true)
    }

    fn scene(meshes: Vec<(Mesh, Affine3A)>) -> Scene {
        let prim = |(i, (_, place)): (u32, &(Mesh, Affine3A))| Prim {
            path: format!("/prim{i}"),
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
            surface: &|_| GRAY,
            lights,
            wide: &|_| Vec3::ZERO,
        };
        bake_with(scene, &look, &settings, &Diagnostics::default()).unwrap()
    }

    fn budget(surfels: usize) -> BakeSettings {
        BakeSettings {
            spacing: None,
            surfels,
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
        let world = WorldMesh::of(&scene, crate::scene::PrimId(0));
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
            sides::of_prims(&scene(
                meshes
                    .into_iter()
                    .map(|mesh| (mesh, Affine3A::IDENTITY))
                    .collect(),
            ))
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
        assert_eq!(sides::of_prims(&scene), [Sides::Both, Sides::Front]);
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
        };
        let spacing = spacing::solve(&scene, &[Sides::Both], &settings, &diagnostics);
        assert!(spacing > 1e-5);
        assert_eq!(diagnostics.warnings()[0].kind, "spacing-too-fine");
    }

    #[test]
    fn a_dense_mesh_does_not_leave_the_floor_undiced() {
        let small = Affine3A::from_scale(Vec3::splat(0.1));
        let scene = scene(vec![(floor(100), small), (floor(1), Affine3A::IDENTITY)]);
        let baked = bake_lit(&scene, budget(10_000), &|_| Vec3::ZERO);
        assert!(baked.dice.prims()[1].cell_count() > 1000);
    }

    #[test]
    fn a_cancelled_bake_ends() {
        let diagnostics = Diagnostics::default();
        diagnostics.cancel_token().cancel();
        let look = Look {
            surface: &|_| GRAY,
            lights: &|_| Vec3::ZERO,
            wide: &|_| Vec3::ZERO,
        };
        let scene = scene(vec![(floor(1), Affine3A::IDENTITY)]);
        assert!(bake_with(&scene, &look, &BakeSettings::default(), &diagnostics).is_err());
    }
}
