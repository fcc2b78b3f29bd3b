//! `surflux info` on one screen.

use super::print;
use crate::pipeline::StageSummary;

/// Names listed of each kind; `--json` has all.
const LISTED: usize = 6;

/// The summary on stdout, as JSON or for people.
pub(super) fn print(summary: &StageSummary, json: bool) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::to_string_pretty(summary)?);
        return Ok(());
    }
    println!(
        "{} (read with {} in {:.2} s, {} layers)",
        summary.stage, summary.usd, summary.seconds, summary.layers
    );
    println!(
        "  up {}, {} m a unit{}",
        summary.up_axis,
        summary.meters_per_unit,
        times(summary)
    );
    if let Some([low, high]) = summary.bounds {
        println!("  bounds  {} to {}", point(low), point(high));
    }
    tree(summary);
    geometry(summary);
    animation(summary);
    let light = |l: &crate::pipeline::LightSummary| {
        let [r, g, b] = l.radiance;
        let texture = l
            .texture
            .as_ref()
            .map(|file| format!(", {file}"))
            .unwrap_or_default();
        format!("{} {} ({r:.3} {g:.3} {b:.3}{texture})", l.kind, l.path)
    };
    list("lights", summary.lights.iter().map(light));
    list("cameras", summary.cameras.iter().cloned());
    looks(summary);
    print::warnings(&summary.warnings);
    Ok(())
}

/// Materials, images, render settings, flaws and what a job reads.
fn looks(summary: &StageSummary) {
    list(
        "materials",
        summary.materials.iter().map(|material| {
            let textures: Vec<String> = material
                .textures
                .iter()
                .map(|(input, file)| format!("{input} {file}"))
                .collect();
            if textures.is_empty() {
                material.path.clone()
            } else {
                format!("{}: {}", material.path, textures.join(", "))
            }
        }),
    );
    list(
        "render settings",
        summary.render_settings.iter().map(|settings| {
            let (width, height) = settings.resolution;
            let products: Vec<String> = settings
                .products
                .iter()
                .map(|(name, vars)| format!("{name} [{}]", vars.join(" ")))
                .collect();
            format!("{} {width}×{height} {}", settings.path, products.join(", "))
        }),
    );
    textures(summary);
    list(
        "broken references",
        summary
            .broken_references
            .iter()
            .map(|broken| format!("{}: {}", broken.prim, broken.message)),
    );
    list(
        "suspicious",
        summary
            .suspicions
            .iter()
            .map(|odd| format!("{}: {}", odd.prim, odd.message)),
    );
    if let Some(job) = &summary.job {
        reads(job);
    }
}

/// Levels shown; `--json` has one more.
const LEVELS: usize = 2;

/// Lines of the tree shown.
const BRANCHES: usize = 16;

fn tree(summary: &StageSummary) {
    let depth = |path: &str| path.matches('/').count();
    let shown = summary.tree.iter();
    let shown: Vec<_> = shown.filter(|entry| depth(&entry.path) <= LEVELS).collect();
    for entry in shown.iter().take(BRANCHES) {
        let holds: Vec<String> = (entry.holds.iter())
            .map(|(kind, count)| format!("{count} {kind}"))
            .collect();
        let name = entry.path.rsplit('/').next().unwrap_or_default();
        println!(
            "  {:indent$}{name}  {}",
            "",
            holds.join(", "),
            indent = 2 * (depth(&entry.path) - 1)
        );
    }
    if shown.len() > BRANCHES {
        println!("  … and {} more (all in --json)", shown.len() - BRANCHES);
    }
}

fn animation(summary: &StageSummary) {
    let moving = &summary.animation;
    if moving.attributes > 0 {
        println!(
            "  animated: {} attributes of {} prims ({} transforms, {} with points)",
            moving.attributes, moving.prims, moving.transforms, moving.points
        );
    }
}

fn textures(summary: &StageSummary) {
    list(
        "textures",
        summary.textures.iter().map(|texture| {
            let file = texture.file.display();
            match (&texture.problem, texture.width.zip(texture.height)) {
                (Some(problem), _) => format!("MISSING {file}: {problem}"),
                (None, size) => {
                    let (width, height) = size.unwrap_or_default();
                    let tiles = match texture.tiles {
                        1 => String::new(),
                        tiles => format!(", {tiles} tiles"),
                    };
                    let bytes = print::human_bytes(texture.bytes.unwrap_or(0));
                    format!("{file} {width}×{height}{tiles}, {bytes}")
                }
            }
        }),
    );
}

fn reads(job: &crate::pipeline::JobReads) {
    let or_not = |is_read: bool, what: &str| match is_read {
        true => what.to_owned(),
        false => format!("no {what}"),
    };
    println!(
        "  {} of {} reads {} layers, {} attributes ({}), {} images ({}), {}, {}",
        job.purpose,
        if job.aov.is_empty() {
            "direct light".to_owned()
        } else {
            job.aov.join(", ")
        },
        job.layers.len(),
        job.attributes,
        print::human_bytes(job.bytes as u64),
        job.textures.len(),
        print::human_bytes(job.texture_bytes),
        or_not(job.materials, "materials"),
        or_not(job.lights, "lights"),
    );
}

fn times(summary: &StageSummary) -> String {
    match summary.time_range {
        Some((start, end)) => format!(
            ", time codes {start} to {end} at {} a second",
            summary.time_codes_per_second
        ),
        None => String::new(),
    }
}

fn point(p: [f64; 3]) -> String {
    format!("({:.4} {:.4} {:.4})", p[0], p[1], p[2])
}

fn geometry(summary: &StageSummary) {
    let g = &summary.geometry;
    let schemes: Vec<String> = g
        .schemes
        .iter()
        .map(|(scheme, count)| format!("{count} {scheme}"))
        .collect();
    println!(
        "  surfaces {} ({} native, {} point instances) of {} meshes ({})",
        g.prims,
        g.native_instances,
        g.point_instances,
        g.meshes,
        schemes.join(", ")
    );
    println!(
        "  {} points to bake, {} triangles after refinement",
        g.points, g.triangles
    );
}

fn list(title: &str, items: impl ExactSizeIterator<Item = String>) {
    let count = items.len();
    if count == 0 {
        println!("  {title}: none");
        return;
    }
    println!("  {title}: {count}");
    for item in items.take(LISTED) {
        println!("    {item}");
    }
    if count > LISTED {
        println!("    … and {} more (all in --json)", count - LISTED);
    }
}
