//! Light after several reflections: gather at the surfels, update their radiosity, again. PBGI §8.3.
//!
//! What a cloud reflects after one reflection is in it from the start: B₁ = albedo · direct irradiance. With
//! Tₖ = B₁ + … + Bₖ, one gather over the surfels gives Tₖ₊₁ = B₁ + albedo · gather(Tₖ), as gathering is linear.
//! Emission takes no part: it is direct light.

use crate::bake::Baked;
use crate::diagnostics::{Cancelled, Diagnostics, Phase};
use crate::gather::radiance::surfel_of;
use crate::gather::{CloudGather, Pass};
use crate::receivers::{Receivers, surfel};
use crate::surfels::SurfelCloud;
use crate::trace::Tracer;
use glam::Vec3;
use rayon::prelude::*;

/// The cloud to update, and the one to compute on.
#[derive(Debug, Clone, Copy)]
pub struct BounceClouds<'a> {
    /// The cloud that gets the light.
    pub fine: &'a SurfelCloud,
    /// A coarser bake of the same scene to gather at; `None` = at the fine cloud itself.
    pub coarse: Option<CoarseCloud<'a>>,
}

/// A coarser bake, and the way to it from the surfels of the fine one.
#[derive(Debug, Clone, Copy)]
pub struct CoarseCloud<'a> {
    /// The coarse surfels.
    pub baked: &'a Baked,
    /// Rays against the scene both were diced from.
    pub tracer: &'a Tracer,
}

impl CoarseCloud<'_> {
    /// The coarse surfel whose cell surfel `i` of `fine` lies in, on the same side; `None` where the short ray down to
    /// the surface finds none.
    fn cell_of(&self, fine: &SurfelCloud, i: usize) -> Option<u32> {
        let (position, normal) = (fine.position[i], fine.normal[i]);
        let above = self.tracer.lift(position, normal);
        let reach = above.distance(position) + fine.radius[i];
        let hit = self.tracer.closest(above, -normal, reach)?;
        surfel_of(&self.baked.dice, &hit)
    }
}

/// How often light is reflected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bounces {
    /// So many times.
    Count(u32),
    /// Until what is left to come is less than this part of all reflected light, [`Bounces::MOST`] times at most.
    Until(f64),
}

impl Bounces {
    /// Reflections after which even a furnace whose walls reflect 0.9 has 99.9 % of its light.
    pub const MOST: u32 = 64;

    /// True if light is reflected once, or never.
    pub fn is_at_most_once(self) -> bool {
        matches!(self, Self::Count(0 | 1))
    }

    fn most(self) -> u32 {
        match self {
            Self::Count(count) => count,
            Self::Until(_) => Self::MOST,
        }
    }
}

/// Let light be reflected `bounces` times in all: a cloud like `clouds.fine` whose reflected radiosity is that of
/// light after that many reflections, and their number. 0 and 1 change nothing, as one reflection is what a bake delivers.
///
/// `light` gathers from the cloud that is computed on (the coarse one if there is one).
/// Cost: a gather at every surfel of that cloud for each reflection but the first.
///
/// # Errors
/// When cancelled.
pub fn bounce(
    clouds: BounceClouds<'_>,
    light: &dyn CloudGather,
    bounces: Bounces,
    diagnostics: &Diagnostics,
) -> Result<(SurfelCloud, u32), Cancelled> {
    let fine = clouds.fine;
    let gathers = bounces.most().saturating_sub(1);
    let cloud = clouds.coarse.map_or(fine, |coarse| &coarse.baked.cloud);
    if gathers == 0 || cloud.is_empty() {
        return Ok((fine.clone(), bounces.most()));
    }
    let receivers = surfel::place(cloud);
    let foretold = match bounces {
        Bounces::Count(_) => gathers,
        Bounces::Until(_) => 0,
    };
    let phase = diagnostics.phase(
        "bounce",
        "surfels",
        cloud.len() as u64 * u64::from(foretold),
    );
    let step = Step {
        light,
        diagnostics,
        phase: &phase,
    };
    let pass = |count: u32| match bounces {
        Bounces::Count(asked) if count >= asked => Pass::Last,
        _ => Pass::Early,
    };
    // All but the last gather update the cloud itself, the last one gives the light that the fine cloud takes.
    let mut lit = cloud.clone();
    let mut count = 2;
    let mut irradiance = step.gather(&lit, &receivers, pass(count))?;
    let mut growth = Growth::new(cloud, &lit);
    loop {
        let more = reflect(cloud, &irradiance);
        let is_done = match bounces {
            Bounces::Count(asked) => count >= asked,
            Bounces::Until(part) => growth.rest(&more) <= part || count >= Bounces::MOST,
        };
        if is_done {
            break;
        }
        lit = more;
        count += 1;
        irradiance = step.gather(&lit, &receivers, pass(count))?;
    }
    if pass(count) == Pass::Early {
        irradiance = step.gather(&lit, &receivers, Pass::Last)?;
    }
    let Some(coarse) = clouds.coarse else {
        return Ok((reflect(fine, &irradiance), count));
    };
    let cells: Vec<_> = (0..fine.len())
        .into_par_iter()
        .map(|i| coarse.cell_of(fine, i))
        .collect();
    let irradiance = step.transfer(fine, &cells, &irradiance, &lit)?;
    Ok((reflect(fine, &irradiance), count))
}

/// How light grows from one reflection to the next: a geometric series before long.
struct Growth<'a> {
    /// For areas.
    cloud: &'a SurfelCloud,
    power: f64,
    /// What the reflection before added.
    added: f64,
}

impl<'a> Growth<'a> {
    /// `lit`: after one reflection.
    fn new(cloud: &'a SurfelCloud, lit: &SurfelCloud) -> Self {
        let power = reflected_power(cloud, lit);
        Self {
            cloud,
            power,
            added: power,
        }
    }

    /// What later reflections will add to `lit`, one reflection more than before, over all that is reflected in the end.
    fn rest(&mut self, lit: &SurfelCloud) -> f64 {
        let power = reflected_power(self.cloud, lit);
        let added = (power - self.power).max(0.0);
        if added <= 0.0 || self.added <= 0.0 {
            return 0.0;
        }
        let ratio = (added / self.added).min(MOST_GROWTH);
        (self.power, self.added) = (power, added);
        let rest = added * ratio / (1.0 - ratio);
        rest / (power + rest)
    }
}

/// No more than this part of light is left by a reflection, or nothing could be said of its rest.
const MOST_GROWTH: f64 = 0.99;

/// Power that `lit`, which has the surfels of `cloud`, reflects: all channels together.
fn reflected_power(cloud: &SurfelCloud, lit: &SurfelCloud) -> f64 {
    let of = |i| f64::from(cloud.area[i]) * f64::from(lit.reflected(i).element_sum());
    (0..lit.len()).map(of).sum()
}

/// What one gather over surfels needs besides the cloud.
struct Step<'a> {
    light: &'a dyn CloudGather,
    diagnostics: &'a Diagnostics,
    phase: &'a Phase<'a>,
}

impl Step<'_> {
    /// Irradiance at `receivers` from the light that `cloud` reflects.
    fn gather(
        &self,
        cloud: &SurfelCloud,
        receivers: &Receivers,
        pass: Pass,
    ) -> Result<Vec<Vec3>, Cancelled> {
        let irradiance = (self.light).irradiance(cloud, receivers, pass, self.diagnostics)?;
        self.phase.advance(receivers.len() as u64);
        Ok(irradiance)
    }

    /// Irradiance at the surfels of `fine`: that of the coarse cell each lies in, gathered from `lit` where it lies
    /// in none.
    fn transfer(
        &self,
        fine: &SurfelCloud,
        cells: &[Option<u32>],
        coarse_irradiance: &[Vec3],
        lit: &SurfelCloud,
    ) -> Result<Vec<Vec3>, Cancelled> {
        let lost: Vec<usize> = (0..cells.len()).filter(|&i| cells[i].is_none()).collect();
        let gathered = self.gather(lit, &surfel::place(fine).subset(&lost), Pass::Last)?;
        let mut irradiance: Vec<Vec3> = cells
            .iter()
            .map(|cell| cell.map_or(Vec3::ZERO, |cell| coarse_irradiance[cell as usize]))
            .collect();
        for (i, value) in lost.into_iter().zip(gathered) {
            irradiance[i] = value;
        }
        Ok(irradiance)
    }
}

/// `cloud`, which holds one reflection, with its albedo · `irradiance` added.
fn reflect(cloud: &SurfelCloud, irradiance: &[Vec3]) -> SurfelCloud {
    let radiosity = (0..cloud.len())
        .map(|i| cloud.radiosity[i] + cloud.albedo[i] * irradiance[i])
        .collect();
    SurfelCloud {
        radiosity,
        ..cloud.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::{self, Engine, Hemisphere};
    use std::f32::consts::PI;
    use std::ops::Range;

    /// Sees the six walls of a cube from the middle of each: a fifth of the hemisphere each, near enough for light
    /// that is the same everywhere.
    #[derive(Debug)]
    struct CubeEngine<'a>(&'a SurfelCloud);

    impl Engine for CubeEngine<'_> {
        fn see(
            &self,
            receivers: &Receivers,
            block: Range<usize>,
            scratch: &mut Hemisphere,
            visit: &mut dyn FnMut(usize, &Hemisphere),
        ) {
            for i in block {
                scratch.clear();
                for j in 0..6 {
                    let to = self.0.position[j] - receivers.position[i];
                    if to.dot(receivers.normal[i]) > 0.1 {
                        scratch.direction.push(to.normalize());
                        scratch.weight.push(PI / 5.0);
                        scratch.coverage.push(1.0);
                        scratch.distance.push(to.length());
                        scratch.reflected.push(self.0.reflected(j) / PI);
                        scratch.emitted.push(self.0.emission[j] / PI);
                    }
                }
                visit(i, scratch);
            }
        }

        fn name(&self) -> &'static str {
            "cube"
        }
    }

    #[derive(Debug)]
    struct InCube;

    impl CloudGather for InCube {
        fn irradiance(
            &self,
            cloud: &SurfelCloud,
            receivers: &Receivers,
            _pass: Pass,
            diagnostics: &Diagnostics,
        ) -> Result<Vec<Vec3>, Cancelled> {
            gather::irradiance(&CubeEngine(cloud), receivers, diagnostics)
        }
    }

    /// The inside of a cube whose walls all emit radiance 1 and reflect `albedo`, lit directly.
    fn furnace(albedo: Vec3) -> SurfelCloud {
        let normal = [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z, -Vec3::Z];
        let emission = Vec3::splat(PI);
        SurfelCloud {
            position: normal.iter().map(|n| -0.5 * *n).collect(),
            normal: normal.to_vec(),
            radius: vec![0.8; 6],
            area: vec![1.0; 6],
            radiosity: vec![emission + albedo * PI; 6],
            albedo: vec![albedo; 6],
            emission: vec![emission; 6],
            prim: vec![0; 6],
            ..SurfelCloud::default()
        }
    }

    fn on_itself(cloud: &SurfelCloud) -> BounceClouds<'_> {
        BounceClouds {
            fine: cloud,
            coarse: None,
        }
    }

    #[test]
    fn a_furnace_reflects_the_geometric_series_up_to_its_number_of_bounces() {
        let albedo = Vec3::new(0.6, 0.3, 0.0);
        let cloud = furnace(albedo);
        for bounces in [0, 1, 2, 3, 12] {
            let (lit, count) = bounce(
                on_itself(&cloud),
                &InCube,
                Bounces::Count(bounces),
                &Diagnostics::default(),
            )
            .unwrap();
            assert_eq!(count, bounces);
            let exact = (1..=bounces.max(1).cast_signed())
                .fold(Vec3::ZERO, |sum, k| sum + PI * albedo.map(|x| x.powi(k)));
            for i in 0..6 {
                let got = lit.reflected(i);
                assert!(got.abs_diff_eq(exact, 1e-4), "{bounces}: {got} {exact}");
            }
            assert_eq!(lit.emission, cloud.emission);
            assert_eq!(lit.position, cloud.position);
        }
    }

    #[test]
    fn reflections_go_on_until_little_of_the_series_is_left() {
        let albedo = 0.5_f32;
        let cloud = furnace(Vec3::splat(albedo));
        for part in [0.1, 0.01] {
            let until = Bounces::Until(part);
            let (lit, count) =
                bounce(on_itself(&cloud), &InCube, until, &Diagnostics::default()).unwrap();
            // After k reflections ½ᵏ of the light is to come.
            assert_eq!(f64::from(count), (1.0 / part).log2().ceil(), "{part}");
            let whole = PI * albedo / (1.0 - albedo);
            let rest = f64::from(1.0 - lit.reflected(0).x / whole);
            assert!(rest <= part && rest > 0.25 * part, "{rest}");
        }
    }

    #[test]
    fn surfels_take_the_light_of_their_coarse_cell_and_gather_their_own_without_one() {
        let coarse = furnace(Vec3::splat(0.5));
        let fine = furnace(Vec3::splat(0.25));
        let diagnostics = Diagnostics::default();
        let phase = diagnostics.phase("bounce", "surfels", 0);
        let step = Step {
            light: &InCube,
            diagnostics: &diagnostics,
            phase: &phase,
        };
        let mut cells = vec![Some(0), Some(1), Some(2), Some(3), Some(4), None];
        let known: Vec<Vec3> = (0..6).map(|i| Vec3::splat(i as f32)).collect();
        let light = step.transfer(&fine, &cells, &known, &coarse).unwrap();
        assert_eq!(light[..5], known[..5]);
        assert!(light[5].abs_diff_eq(Vec3::splat(0.5 * PI), 1e-5));
        cells.clear();
        let none = SurfelCloud::default();
        assert!(step.transfer(&none, &cells, &[], &none).unwrap().is_empty());
    }

    #[test]
    fn an_empty_cloud_stays_empty_and_a_cancelled_run_ends() {
        let diagnostics = Diagnostics::default();
        let empty = SurfelCloud::default();
        let five = Bounces::Count(5);
        let (lit, _) = bounce(on_itself(&empty), &InCube, five, &diagnostics).unwrap();
        assert!(lit.is_empty());
        diagnostics.cancel_token().cancel();
        let cloud = furnace(Vec3::ONE);
        assert_eq!(
            bounce(on_itself(&cloud), &InCube, Bounces::Count(2), &diagnostics),
            Err(Cancelled)
        );
    }
}
