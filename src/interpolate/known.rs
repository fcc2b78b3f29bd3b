//! Answers that are known already, as an [`Engine`]: what hangs on them is computed as if they had been seen.

use super::{Gathering, Work};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::{self, Engine, Hemisphere};
use crate::receivers::Receivers;
use crate::results::{Aov, AovBuffer, Results};
use glam::Vec3;
use std::f32::consts::PI;
use std::ops::Range;

/// The AOVs asked for, from `values` of the base at all receivers.
pub(super) fn assemble(work: &Work<'_>, values: &[f32]) -> Result<Results, Cancelled> {
    let Gathering {
        scene,
        engine,
        receivers,
        aovs,
    } = work.gathering;
    let mut found = apart(values, work.base);
    found.buffers.iter_mut().for_each(put_in_range);
    let visibility = found.get(Aov::Visibility);
    let occlusion: Option<Vec<f32>> =
        visibility.map(|open| open.data.iter().map(|open| 1.0 - open).collect());
    let is_rest = |aov: &Aov| found.get(*aov).is_none();
    let rest: Vec<Aov> = aovs.iter().copied().filter(is_rest).collect();
    if !rest.is_empty() {
        let indirect = found.get(Aov::IrradianceIndirect);
        let known = KnownEngine {
            occlusion: occlusion.as_deref(),
            indirect: indirect.map(|buffer| buffer.data.as_slice()),
            max_distance: engine.max_distance(),
        };
        let rest = gather::gather(scene, &known, receivers, &rest, work.diagnostics)?;
        found.buffers.extend(rest.buffers);
    }
    found.buffers.retain(|buffer| aovs.contains(&buffer.aov));
    Ok(found.in_order_of(aovs))
}

/// What blends may leave by a little.
fn put_in_range(buffer: &mut AovBuffer) {
    match buffer.aov {
        Aov::Visibility => buffer
            .data
            .iter_mut()
            .for_each(|open| *open = open.clamp(0.0, 1.0)),
        Aov::IrradianceIndirect => buffer
            .data
            .iter_mut()
            .for_each(|light| *light = light.max(0.0)),
        Aov::BentNormal => {
            for direction in buffer.data.chunks_exact_mut(3) {
                let unit = Vec3::from_slice(direction).normalize_or_zero();
                direction.copy_from_slice(&unit.to_array());
            }
        }
        _ => {}
    }
}

/// One buffer an AOV, of values that stand side by side, receiver by receiver.
fn apart(values: &[f32], aovs: &[Aov]) -> Results {
    let n: usize = aovs.iter().map(|aov| aov.components()).sum();
    let mut start = 0;
    let buffer = |&aov: &Aov| {
        let range = start..start + aov.components();
        start = range.end;
        let data = (values.chunks_exact(n)).flat_map(|values| &values[range.clone()]);
        AovBuffer {
            aov,
            data: data.copied().collect(),
        }
    };
    Results {
        buffers: aovs.iter().map(buffer).collect(),
    }
}

/// Occlusion and reflected light of every receiver, without directions: good for irradiance, and for what only hangs on how
/// much is open.
#[derive(Debug, Clone, Copy)]
struct KnownEngine<'a> {
    /// 0…1; `None` where nobody asks what is open.
    occlusion: Option<&'a [f32]>,
    /// Red, green, blue, radiance·sr; `None` where nobody asks for light.
    indirect: Option<&'a [f32]>,
    /// Nothing beyond it was seen, stage units.
    max_distance: f32,
}

impl KnownEngine<'_> {
    /// One direction that is open and one that is covered and sends all the light.
    fn fill(&self, i: usize, normal: Vec3, seen: &mut Hemisphere) {
        let covered = self.occlusion.map_or(1.0, |occlusion| occlusion[i]);
        let irradiance = self.indirect.map_or(Vec3::ZERO, |indirect| {
            Vec3::from_slice(&indirect[3 * i..3 * i + 3])
        });
        // Light without anything that covers: rounding, or a blend of receivers that see a little.
        let least = if irradiance == Vec3::ZERO {
            0.0
        } else {
            f32::EPSILON
        };
        let weight = PI * covered.max(least);
        let radiance = if weight > 0.0 {
            irradiance / weight
        } else {
            Vec3::ZERO
        };
        seen.clear();
        for (weight, coverage, distance, radiance) in [
            (PI - weight, 0.0, f32::INFINITY, Vec3::ZERO),
            (weight, 1.0, 0.0, radiance),
        ] {
            seen.direction.push(normal);
            seen.weight.push(weight);
            seen.coverage.push(coverage);
            seen.distance.push(distance);
            seen.reflected.push(radiance);
            seen.emitted.push(Vec3::ZERO);
        }
    }
}

impl Engine for KnownEngine<'_> {
    fn see(
        &self,
        receivers: &Receivers,
        block: Range<usize>,
        scratch: &mut Hemisphere,
        visit: &mut dyn FnMut(usize, &Hemisphere),
    ) {
        for i in block {
            self.fill(i, receivers.normal[i], scratch);
            visit(i, scratch);
        }
    }

    fn max_distance(&self) -> f32 {
        self.max_distance
    }

    fn name(&self) -> &'static str {
        "known"
    }

    fn survey(
        &self,
        _receivers: &Receivers,
        _diagnostics: &Diagnostics,
    ) -> Result<Option<Box<dyn Engine + '_>>, Cancelled> {
        Ok(Some(Box::new(*self)))
    }
}
