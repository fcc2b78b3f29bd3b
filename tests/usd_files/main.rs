//! Clouds and bakes of ours, opened with the programs they are for: Pixar's usd-core and Blender.

mod bakes;
mod clouds;
mod written_back;

#[path = "../support/program.rs"]
#[expect(dead_code, reason = "for other tests")]
mod program;
#[path = "../support/python.rs"]
mod python;

use serde_json::Value as Json;
use std::path::Path;
use surflux::scene::{StageInfo, UpAxis};
use surflux::writers::usd::Provenance;

const VALIDATE: &str = r#"
import sys
from pxr import Usd, UsdValidation
stage = Usd.Stage.Open(sys.argv[1])
registry = UsdValidation.ValidationRegistry()
context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
for error in context.Validate(stage):
    print(error.GetName(), error.GetMessage())
"#;

fn stage_info(path: &Path) -> StageInfo {
    StageInfo {
        path: path.to_owned(),
        up_axis: UpAxis::Z,
        meters_per_unit: 0.1,
        default_prim: Some("World".to_owned()),
        time_range: None,
        time_codes_per_second: 25.0,
        time: None,
        layers: Vec::new(),
        variants: Vec::new(),
        reader: "usd-core".to_owned(),
    }
}

fn provenance() -> Provenance {
    Provenance {
        version: "1.2.3".to_owned(),
        command: ["surflux", "bake", "a \"b\""].map(str::to_owned).to_vec(),
        comment: Some("a note".to_owned()),
    }
}

fn json(text: &str) -> Json {
    serde_json::from_str(text.lines().last().expect("a line")).expect("JSON")
}

fn floats(value: &Json) -> Vec<f32> {
    match value {
        Json::Array(values) => values.iter().flat_map(floats).collect(),
        other => vec![single(other.as_f64().expect("a number"))],
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "values are compared in single precision"
)]
fn single(value: f64) -> f32 {
    value as f32
}

/// Numbers without structure, the same every time.
fn noise(seed: u32) -> f32 {
    let mut x = seed.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
    x = (x ^ (x >> 15)).wrapping_mul(0x2C1B_3C6D);
    x = (x ^ (x >> 12)).wrapping_mul(0x297A_2D39);
    ((x ^ (x >> 15)) >> 8) as f32 / (1 << 24) as f32
}
