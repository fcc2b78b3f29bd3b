//! Loads of one source at several times: what does not vary is read once, and every load is what a source opened for it
//! alone gives.

use crate::features::features;
use crate::stages::stages_below;
use crate::{Case, shared};
use std::path::{Path, PathBuf};
use surflux::diagnostics::Diagnostics;
use surflux::stage::native::NativeSource;
use surflux::stage::raw::{RawStage, ReadCounts};
use surflux::stage::{Error, Source};

/// Before, on, between and behind samples of the small stages.
const TIMES: [f64; 4] = [-1.0, 3.0, 6.5, 12.0];

/// A still mesh, a camera that moves, and instances moved by their velocities.
const SHOT: &str = r#"#usda 1.0
def Mesh "still" {
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
}
def Camera "moving" {
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 9: (8, 0, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def PointInstancer "crowd" {
    rel prototypes = </still>
    int[] protoIndices = [0, 0]
    point3f[] positions.timeSamples = { 1: [(0, 0, 0), (1, 0, 0)] }
    vector3f[] velocities.timeSamples = { 1: [(1, 0, 0), (0, 1, 0)] }
    float3[] scales = [(1, 1, 1), (2, 2, 2)]
}
"#;

fn load(source: &mut NativeSource, case: &Case) -> Result<RawStage, Error> {
    source.load(&case.request(), &Diagnostics::default())
}

/// What each load of one source, told how many come, has read.
fn compare_loads(path: &Path, times: &[f64]) -> Vec<ReadCounts> {
    let Ok(mut shared) = NativeSource::open(path) else {
        return Vec::new();
    };
    shared.expect_loads(times.len());
    let mut counts = Vec::new();
    for &time in times {
        let case = Case::new(path, Some(time));
        let mut fresh = NativeSource::open(path).expect("opened before");
        match (load(&mut shared, &case), load(&mut fresh, &case)) {
            (Ok(mut ours), Ok(truth)) => {
                counts.push(ours.meta.read);
                ours.meta.read = truth.meta.read;
                // as text, where what is not a number equals itself
                let same = format!("{ours:?}") == format!("{truth:?}");
                assert!(same, "{} at {time}", path.display());
            }
            (Err(ours), Err(truth)) => assert_eq!(ours.to_string(), truth.to_string()),
            (ours, truth) => panic!("{}: {ours:?} and {truth:?}", path.display()),
        }
    }
    counts
}

#[test]
fn loads_at_other_times_are_what_a_source_of_their_own_reads() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (number, feature) in features().enumerate() {
        let folder = folder.path().join(number.to_string());
        std::fs::create_dir(&folder).expect("a folder");
        for (name, text) in feature.files {
            std::fs::write(folder.join(name), text).expect("a file");
        }
        compare_loads(&folder.join(feature.files[0].0), &TIMES);
    }
    let Some(shared) = shared() else {
        return;
    };
    let mut paths: Vec<PathBuf> = Vec::new();
    stages_below(&shared.join("assets"), &mut paths);
    for path in paths {
        compare_loads(&path, &[1.0, 12.3]);
    }
}

#[test]
fn what_does_not_vary_is_read_once() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("shot.usda");
    std::fs::write(&path, SHOT).expect("a file");
    let counts = compare_loads(&path, &[1.0, 2.0, 3.5]);
    let attributes: Vec<usize> = counts.iter().map(|count| count.attributes).collect();
    // the mesh has 3, the camera 2, the instancer 4, of which 3 move its points together
    assert_eq!(attributes, [9, 4, 4]);
}
