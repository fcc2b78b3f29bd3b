//! What is interpolated: AOVs from which all others follow.

use crate::gather::quantities::{self, BLACK_SURFACE, Seen, irradiance, turn};
use crate::gather::{self, GatherScene, Hemisphere};
use crate::receivers::Receivers;
use crate::results::Aov;
use glam::Vec3;

/// AOVs from which all of `aovs` follow, as far as they hang on the hemisphere.
pub(super) fn of(scene: GatherScene<'_>, aovs: &[Aov]) -> Vec<Aov> {
    let mut base = Vec::new();
    if (aovs.iter()).any(|&aov| gather::asks_open(aov, scene.lighting)) {
        base.push(Aov::Visibility);
    }
    base.extend(
        [
            Aov::BentNormal,
            Aov::VisibilitySh,
            Aov::RadianceSh,
            Aov::SpecularIndirect,
        ]
        .iter()
        .filter(|aov| aovs.contains(aov)),
    );
    if (aovs.iter()).any(|aov| aov.needs_indirect() && !aov.needs_gloss()) {
        base.push(Aov::IrradianceIndirect);
    }
    base
}

/// Write the values of `base` at receiver `i`, which sees `hemisphere`, side by side.
pub(super) fn read(
    base: &[Aov],
    (receivers, i): (&Receivers, usize),
    hemisphere: &Hemisphere,
    mut out: &mut [f32],
) {
    let seen = Seen {
        receivers,
        index: i,
        hemisphere,
        surface: BLACK_SURFACE,
        direct: Vec3::ZERO,
        environment: Vec3::ZERO,
        illumination: Vec3::ZERO,
        indirect: irradiance::indirect(hemisphere),
    };
    for &aov in base {
        let (own, rest) = out.split_at_mut(aov.components());
        quantities::write(aov, &seen, own);
        out = rest;
    }
}

/// Write their change with the normal: three floats a component, zero where it is not known.
pub(super) fn read_turns(base: &[Aov], normal: Vec3, hemisphere: &Hemisphere, mut out: &mut [f32]) {
    for &aov in base {
        let (own, rest) = out.split_at_mut(3 * aov.components());
        match aov {
            Aov::Visibility => {
                own.copy_from_slice(&turn::visibility(hemisphere, normal).to_array());
            }
            Aov::IrradianceIndirect => {
                for (own, turn) in own
                    .chunks_exact_mut(3)
                    .zip(turn::indirect(hemisphere, normal))
                {
                    own.copy_from_slice(&turn.to_array());
                }
            }
            _ => own.fill(0.0),
        }
        out = rest;
    }
}

/// The largest of the errors of one receiver's base AOVs, `off` by so much: rms over components, over their scales.
pub(super) fn relative(base: &[Aov], mut off: &[f32], scales: &[Option<f64>]) -> f64 {
    let mut most = 0.0_f64;
    for (aov, scale) in base.iter().zip(scales) {
        let (own, rest) = off.split_at(aov.components());
        off = rest;
        if let Some(scale) = scale {
            let square: f64 = own.iter().map(|&x| f64::from(x).powi(2)).sum();
            most = most.max((square / own.len() as f64).sqrt() / scale);
        }
    }
    most
}
