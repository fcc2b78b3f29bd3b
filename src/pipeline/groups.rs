//! Light of groups of sources, and of clouds, told apart. PBGI §7.2.
//!
//! Each part is gathered for itself with the settings of the whole, and the whole is their sum: they add up to rounding.

use super::Error;
use super::gather::gather;
use super::job::GatherJob;
use super::report::Report;
use super::world::World;
use crate::diagnostics::Diagnostics;
use crate::receivers::Receivers;
use crate::results::{Aov, AovBuffer, GroupResults, Results};
use crate::stage::cloud;
use std::path::Path;
use std::sync::Arc;

/// [`gather`], and with light groups, or clouds that are told apart, the parts of AOVs that are sums over them.
pub(super) fn gather_parts(
    world: &World<'_>,
    receivers: &Receivers,
    aovs: &[Aov],
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let by_cloud = job.splits_clouds && !job.clouds.is_empty();
    let adds_up = |aov: &Aov| match by_cloud {
        // The other sums hold light of other sources too.
        true => matches!(
            aov,
            Aov::IrradianceIndirect | Aov::DiffuseIndirect | Aov::RadianceSh
        ),
        false => !world.groups.is_empty() && aov.adds_up(),
    };
    let (split, others): (Vec<_>, Vec<_>) = aovs.iter().copied().partition(adds_up);
    let mut results = Results::default();
    // What a pilot finds about the whole holds for its parts.
    let whole = if job.tolerance.is_some() {
        split.as_slice()
    } else {
        &[]
    };
    for asked in [&others[..], whole] {
        if !asked.is_empty() {
            let run = (&mut *report, diagnostics);
            let found = gather(world, receivers, asked, job, run)?;
            results.buffers.extend(found.buffers);
        }
    }
    if !split.is_empty() {
        let run = (&mut *report, diagnostics);
        results.groups = match by_cloud {
            true => clouds(world, receivers, &split, job, run)?,
            false => groups(world, receivers, &split, job, run)?,
        };
        results
            .buffers
            .retain(|buffer| !split.contains(&buffer.aov));
        results.buffers.extend(sums(&results.groups));
    }
    Ok(results.in_order_of(aovs))
}

/// `aovs` for each light group that has sources.
fn groups(
    world: &World<'_>,
    receivers: &Receivers,
    aovs: &[Aov],
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Vec<GroupResults>, Error> {
    refuse_surfels(world, job)?;
    let mut all = Vec::new();
    for group in world.groups {
        let shader = world.shader.of_group(group);
        let part = world.lit_by(&shader, diagnostics);
        if part.lighting.is_dark() && &*group.name == crate::scene::LightGroup::DEFAULT {
            continue;
        }
        let run = (&mut *report, diagnostics);
        let buffers = part_of(&part, receivers, aovs, job, run)?;
        all.push(GroupResults {
            name: Arc::clone(&group.name),
            buffers,
        });
    }
    Ok(all)
}

/// Particles of clouds are sources like others; the light of surfels cannot be told apart.
fn refuse_surfels(world: &World<'_>, job: &GatherJob) -> Result<(), Error> {
    // What is wrong with a cloud is told where it is read to be used.
    let quiet = Diagnostics::default();
    for path in &job.clouds {
        if !cloud::read_cloud(path, world.scene().origin, &quiet)?.is_empty() {
            return Err(Error::GroupsOfCloud { path: path.clone() });
        }
    }
    Ok(())
}

/// `aovs` for each cloud, which is called by the name of its file.
fn clouds(
    world: &World<'_>,
    receivers: &Receivers,
    aovs: &[Aov],
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Vec<GroupResults>, Error> {
    let mut all = Vec::new();
    for cloud in &job.clouds {
        let alone = GatherJob {
            clouds: vec![cloud.clone()],
            ..job.clone()
        };
        let run = (&mut *report, diagnostics);
        let buffers = part_of(world, receivers, aovs, &alone, run)?;
        all.push(GroupResults {
            name: cloud_name(cloud).into(),
            buffers,
        });
    }
    Ok(all)
}

/// The stem of a cloud's file with `_` for what no name of a channel or primvar may have.
pub(super) fn cloud_name(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let word = |c: char| {
        if c.is_ascii_alphanumeric() || c == '_' {
            c
        } else {
            '_'
        }
    };
    stem.chars().map(word).collect()
}

/// One part; what the report tells of settings and errors stays that of the whole.
fn part_of(
    world: &World<'_>,
    receivers: &Receivers,
    aovs: &[Aov],
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Vec<AovBuffer>, Error> {
    let mut own = report.part();
    let results = gather(world, receivers, aovs, job, (&mut own, diagnostics))?;
    report.add_part(own);
    Ok(results.buffers)
}

/// The whole of each AOV of `groups`; alpha is the same in all of them.
fn sums(groups: &[GroupResults]) -> Vec<AovBuffer> {
    let Some((first, others)) = groups.split_first() else {
        return Vec::new();
    };
    let mut sums = first.buffers.clone();
    for group in others {
        for (sum, part) in sums.iter_mut().zip(&group.buffers) {
            let (n, is_color) = (sum.aov.components(), sum.aov == Aov::Color);
            let values = sum.data.iter_mut().zip(&part.data).enumerate();
            for (i, (sum, part)) in values {
                let is_alpha = is_color && i % n == n - 1;
                *sum = if is_alpha { *part } else { *sum + *part };
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_add_up_and_their_alpha_does_not() {
        let group = |name: &str, data: [f32; 4]| GroupResults {
            name: name.into(),
            buffers: vec![AovBuffer {
                aov: Aov::Color,
                data: data.to_vec(),
            }],
        };
        let groups = [
            group("key", [1.0, 2.0, 3.0, 1.0]),
            group("fill", [0.5, 0.25, 0.0, 1.0]),
        ];
        assert_eq!(sums(&groups)[0].data, [1.5, 2.25, 3.0, 1.0]);
        assert!(sums(&[]).is_empty());
    }

    #[test]
    fn clouds_are_called_by_what_a_name_may_have_of_their_files() {
        assert_eq!(
            cloud_name(Path::new("a/key light.0101.usdc")),
            "key_light_0101"
        );
    }
}
