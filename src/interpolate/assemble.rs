//! Values of the base at all receivers → the AOVs asked for.

use super::{Gathering, Work};
use crate::diagnostics::Cancelled;
use crate::gather::{self, KnownEngine};
use crate::receivers::Receivers;
use crate::results::{Aov, AovBuffer, Results};
use glam::Vec3;
use std::borrow::Cow;

impl Work<'_> {
    /// `values` of the base at all receivers as results.
    pub(super) fn blended(&self, values: &[f32]) -> Results {
        let mut found = apart(values, self.base);
        found.buffers.iter_mut().for_each(put_in_range);
        found
    }

    /// The AOVs asked for at `receivers`, from what was `found` of the base there.
    pub(super) fn assemble(
        &self,
        mut found: Results,
        receivers: &Receivers,
    ) -> Result<Results, Cancelled> {
        let Gathering {
            scene,
            engine,
            aovs,
            ..
        } = self.gathering;
        let visibility = found.get(Aov::Visibility);
        let occlusion: Option<Vec<f32>> =
            visibility.map(|open| open.data.iter().map(|open| 1.0 - open).collect());
        let is_rest = |aov: &Aov| found.get(*aov).is_none();
        let rest: Vec<Aov> = aovs.iter().copied().filter(is_rest).collect();
        if !rest.is_empty() {
            let indirect = found.get(Aov::IrradianceIndirect);
            let known = KnownEngine {
                occlusion: occlusion.map(Cow::Owned),
                indirect: indirect.map(|buffer| Cow::Borrowed(bytemuck::cast_slice(&buffer.data))),
                max_distance: engine.max_distance(),
                name: engine.name(),
            };
            let rest = gather::gather(scene, &known, receivers, &rest, self.diagnostics)?;
            found.buffers.extend(rest.buffers);
        }
        found.buffers.retain(|buffer| aovs.contains(&buffer.aov));
        Ok(found.in_order_of(aovs))
    }
}

/// What blends may leave by a little.
fn put_in_range(buffer: &mut AovBuffer) {
    match buffer.aov {
        Aov::Visibility => buffer
            .data
            .iter_mut()
            .for_each(|open| *open = open.clamp(0.0, 1.0)),
        Aov::IrradianceIndirect | Aov::SpecularIndirect => buffer
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
        ..Results::default()
    }
}
