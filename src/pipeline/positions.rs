//! `surflux bake --positions`: light at the points of a file, which is written again with it.

use super::gather::record;
use super::groups::gather_parts;
use super::job::BakeJob;
use super::report::{Report, peak_memory_bytes, timed};
use super::world::{Needs, World, with_world};
use super::{Error, outputs, provenance, source_of};
use crate::diagnostics::Diagnostics;
use crate::receivers::points::place;
use crate::results::{Aov, AovBuffer, Results, ValueType, name_of_group};
use crate::stage::{Source, cloud};
use crate::surfels::points::{Column, ColumnValues, PointSet, VectorKind};
use crate::writers::usd::points::write;
use glam::Vec3;
use std::path::Path;

/// Bake at the points of `positions`.
///
/// # Errors
/// Whatever reading, gathering and writing report; points without normals.
pub(super) fn run(
    (job, positions): (&BakeJob, &Path),
    opened: Option<Box<dyn Source>>,
    diagnostics: &Diagnostics,
) -> Result<Report, Error> {
    let mut report = Report::new(&job.stage.command);
    let pattern = job.output.path.as_deref();
    let pattern = pattern.unwrap_or_else(|| Path::new("bake.usdc"));
    let frames: Vec<_> = (job.stage.times().into_iter())
        .map(|time| (time, outputs::frame_path(pattern, time)))
        .collect();
    report.outputs = frames.iter().map(|(_, path)| path.clone()).collect();
    outputs::check(&job.output, &report.outputs)?;
    if job.output.dry_run {
        return Ok(report);
    }
    record(&job.gather, &job.gather.aovs, &mut report);
    let mut source = source_of(&job.stage, opened, diagnostics)?;
    let needs = Needs::of(&job.gather.aovs).within(job.gather.tolerance);
    for (time, path) in &frames {
        let (points, about) =
            cloud::read_points(&outputs::frame_path(positions, *time), diagnostics)?;
        with_world(
            &mut source,
            (&job.stage, *time, needs),
            &mut report,
            diagnostics,
            |world, report| {
                let lit = lit(world, points, job, (&mut *report, diagnostics))?;
                timed(&mut report.seconds.write, || {
                    let _phase = diagnostics.phase("write", "file", 0);
                    write(lit, &about, &provenance(&job.stage), path)
                })?;
                Ok(())
            },
        )?;
    }
    report.peak_memory_bytes = peak_memory_bytes(source.source());
    Ok(report)
}

/// `points` with the results in columns of their names.
fn lit(
    world: &World<'_>,
    mut points: PointSet,
    job: &BakeJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<PointSet, Error> {
    let (receivers, kept) = place(&points, world.scene().origin);
    let path = || job.positions.clone().unwrap_or_default();
    if receivers.is_empty() {
        return Err(Error::NoNormals { path: path() });
    }
    if kept.len() < points.len() {
        let message = format!(
            "{} of its {} points have no normal: their values are 0",
            points.len() - kept.len(),
            points.len()
        );
        diagnostics.warn("points", path().display().to_string(), message);
    }
    let aovs = &job.gather.aovs;
    let results = gather_parts(world, &receivers, aovs, &job.gather, (report, diagnostics))?;
    let count = points.len();
    let mut columns = columns(&results, (&kept, count));
    if let Some(shown) = job.display_color {
        let own = results.get(shown);
        columns.extend(own.map(|buffer| display_color(buffer, (&kept, count))));
    }
    points
        .columns
        .retain(|old| columns.iter().all(|new| new.name != old.name));
    points.columns.extend(columns);
    Ok(points)
}

/// Places of results: numbers of the points that have some, and how many points there are.
type Places<'a> = (&'a [usize], usize);

fn columns(results: &Results, places: Places<'_>) -> Vec<Column> {
    let whole = results.buffers.iter().map(|buffer| (buffer, None));
    let groups = results.groups.iter().flat_map(|group| {
        let name = Some(&*group.name);
        group.buffers.iter().map(move |buffer| (buffer, name))
    });
    let all = whole.chain(groups);
    all.flat_map(|(buffer, group)| of_buffer(buffer, group, places))
        .collect()
}

/// One column, or one for each component that is a result of its own.
fn of_buffer(buffer: &AovBuffer, group: Option<&str>, places: Places<'_>) -> Vec<Column> {
    let aov = buffer.aov;
    let column = |name: &'static str, values| Column {
        name: name_of_group(name, group).into_owned(),
        values,
    };
    let (width, names) = (aov.components(), aov.part_names().iter().enumerate());
    let floats =
        |index: usize| ColumnValues::Floats(spread(places, |row| buffer.data[row * width + index]));
    let colors = |part: usize| {
        let color = |row: usize| Vec3::from_slice(&buffer.data[row * width + 3 * part..]);
        ColumnValues::Vectors(VectorKind::Color, spread(places, color))
    };
    match aov.value_type() {
        ValueType::Color => vec![column(aov.name(), colors(0))],
        ValueType::Normal => vec![column(
            aov.name(),
            vectors(VectorKind::Normal, buffer, places),
        )],
        ValueType::Point => vec![column(
            aov.name(),
            vectors(VectorKind::Vector, buffer, places),
        )],
        ValueType::Harmonics => names
            .map(|(part, name)| column(name, floats(part)))
            .collect(),
        ValueType::ColorHarmonics => names
            .map(|(part, name)| column(name, colors(part)))
            .collect(),
        ValueType::Float | ValueType::Id | ValueType::ColorAlpha => {
            vec![column(aov.name(), floats(0))]
        }
    }
}

/// What shows `buffer`: its values, numbers in gray.
fn display_color(buffer: &AovBuffer, places: Places<'_>) -> Column {
    let width = buffer.aov.components();
    let values = match buffer.aov.part_components() {
        3 => spread(places, |row| Vec3::from_slice(&buffer.data[width * row..])),
        _ => spread(places, |row| Vec3::splat(buffer.data[width * row])),
    };
    Column {
        name: "displayColor".to_owned(),
        values: ColumnValues::Vectors(VectorKind::Color, values),
    }
}

fn vectors(kind: VectorKind, buffer: &AovBuffer, places: Places<'_>) -> ColumnValues {
    let at = |row: usize| Vec3::from_slice(&buffer.data[3 * row..]);
    ColumnValues::Vectors(kind, spread(places, at))
}

/// A value for each point: `of` the rows of results where there are some, else 0.
fn spread<T: Default + Clone>((kept, count): Places<'_>, of: impl Fn(usize) -> T) -> Vec<T> {
    let mut all = vec![T::default(); count];
    for (row, &place) in kept.iter().enumerate() {
        all[place] = of(row);
    }
    all
}

/// The AOV of `aovs` that points without a surface cannot have, if any.
pub fn unknown_at_points(aovs: &[Aov]) -> Option<Aov> {
    let needs_surface = |aov: &Aov| aov.needs_material() || matches!(aov, Aov::PrimId | Aov::Depth);
    aovs.iter().copied().find(needs_surface)
}
