//! Scene → [`SurfelCloud`]: dice every surface, shade every micropolygon, light it. PBGI §4.
//!
//! One surfel a cell and side that can be seen (`sides`). Large triangles are cut into cells: exact area and centroid,
//! the plane's normal, a radius that reaches the cell's farthest corner. Small triangles are clustered into cells
//! (`cluster`), the same ones for all instances of a mesh that are of a size (`shapes`). Albedo and emission are averaged over the cell by the shader;
//! emission is of the front only, while every surface reflects on both sides. What is cut out or transparent of a cell is not
//! in its area. Light is averaged as `light` says.

mod blocks;
mod cluster;
mod light;
mod shapes;
mod sides;
mod spacing;

use crate::diagnostics::{Cancelled, Diagnostics};
use crate::lighting::{Lighting, ShadePoint};
use crate::scene::{FaceMaterials, PlacedMesh, Scene};
use crate::shading::{Shader, Surface, SurfacePoint};
use crate::surfels::triangle_dice::{Part, Row};
use crate::surfels::{DiceMap, SurfelCloud};
use crate::trace::Tracer;
use blocks::{Block, BlockColumns, front};
use cluster::{Cluster, mean_light};
use glam::Vec3;
use light::{Look, Side, Steepness, glance_number, plane_normal, quartered, whole_number};
use rayon::prelude::*;
use std::f32::consts::PI;

/// How finely to dice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BakeSettings {
    /// Edge length of a micropolygon, stage units; `None` = from `surfels`. Triangles smaller than that are clustered.
    pub spacing: Option<f32>,
    /// Number of surfels aimed at when no spacing is given. Every prim has some for each direction its surface faces
    /// (up to 26) on each side that can be seen; where that alone exceeds the number, the rest is diced up to 4 times
    /// as coarsely as it would be.
    pub surfels: usize,
    /// Whether each of many lights is looked at from each surfel; see [`Lighting::for_surfels`]. Clouds that are gathered
    /// from need that less than those that are looked at.
    pub every_light: bool,
}

impl Default for BakeSettings {
    fn default() -> Self {
        Self {
            spacing: None,
            surfels: 200_000,
            every_light: true,
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
    let lighting = lighting.for_surfels(settings.every_light);
    let opacity = shader.opacity();
    let look = Look {
        is_screen: &|prim| opacity.as_ref().is_some_and(|all| all.is_screen(prim)),
        surface: &|point| shader.surface(point),
        lights: &|point| lighting.lights(tracer, point),
        glance: &|point, number| lighting.glance(tracer, point, number),
        wide: &|points| lighting.wide(shader, tracer, points),
    };
    bake_with(shader.scene(), &look, settings, diagnostics)
}

fn bake_with(
    scene: &Scene,
    look: &Look<'_>,
    settings: &BakeSettings,
    diagnostics: &Diagnostics,
) -> Result<Baked, Cancelled> {
    let sides = sides::of_prims(scene, look.is_screen);
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
        prim_paths: scene
            .prims
            .iter()
            .map(|prim| prim.path.to_string())
            .collect(),
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
    let world = PlacedMesh::of(scene, block.prim);
    let side = Side {
        world: &world,
        prim: block.prim,
        back: block.back,
    };
    let table = dice.prims()[block.prim.index()].table();
    let mut waiting = Waiting::default();
    let mut next = 0;
    let mut put = |cell: &Shaded| {
        columns.put(look, &side, cell, next);
        // Black surfaces reflect nothing, whatever falls on them.
        if cell.surface.albedo != Vec3::ZERO {
            waiting.push((next, cell.point), look, &mut columns);
        }
        next += 1;
    };
    block.for_each_row(table, |t, _, part, row| {
        let triangle = Triangle {
            t,
            plane_normal: plane_normal(&world, t),
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
    waiting.light(look, &mut columns);
}

/// Cells that wait for the light of [`Look::wide`], which is found faster for many at a time.
#[derive(Default)]
struct Waiting {
    rows: Vec<usize>,
    points: Vec<ShadePoint>,
}

impl Waiting {
    /// As many as look along one direction together.
    const FULL: usize = 64;

    /// Add one; all are lit once they are enough.
    fn push(
        &mut self,
        (row, point): (usize, ShadePoint),
        look: &Look<'_>,
        columns: &mut BlockColumns<'_>,
    ) {
        self.rows.push(row);
        self.points.push(point);
        if self.rows.len() == Self::FULL {
            self.light(look, columns);
        }
    }

    /// Light all that wait.
    fn light(&mut self, look: &Look<'_>, columns: &mut BlockColumns<'_>) {
        let light = (look.wide)(&self.points);
        for (&row, light) in self.rows.iter().zip(light) {
            columns.radiosity[row] += columns.albedo[row] * light;
        }
        self.rows.clear();
        self.points.clear();
    }
}

/// A cell before it is lit.
struct Shaded {
    /// Where it stands and is lit.
    point: ShadePoint,
    normal: Vec3,
    radius: f32,
    area: f32,
    /// For [`Look::glance`].
    number: usize,
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
        number: glance_number(triangle.t, row, column),
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
        number: members.first().map_or(0, |&t| whole_number(t)),
        surface,
    }
}

impl BlockColumns<'_> {
    /// Write `cell` to row `i`, with its light but that of [`Look::wide`].
    fn put(&mut self, look: &Look<'_>, side: &Side<'_>, cell: &Shaded, i: usize) {
        self.position[i] = cell.point.position;
        self.normal[i] = cell.normal;
        self.radius[i] = cell.radius.max(f32::MIN_POSITIVE);
        self.area[i] = cell.area * cell.surface.opacity;
        self.albedo[i] = cell.surface.albedo;
        self.emission[i] = if side.back {
            Vec3::ZERO
        } else {
            PI * cell.surface.emission
        };
        self.prim[i] = side.prim.0;
        self.radiosity[i] = self.emission[i];
        if cell.surface.albedo != Vec3::ZERO {
            self.lights[i] = (look.glance)(&cell.point, cell.number);
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
        let world = PlacedMesh::of(self.scene, prim);
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
mod tests;
