//! Small stages, one for each feature of composition and of the schemas that the shared assets lack, through both doors.

mod composition;
mod faults;
mod geometry;
mod instances;
mod look;
mod skinning;

use crate::truth::Evaluator;
use crate::{Reading, judge};
use std::fs;
use std::path::Path;
use surflux::stage::Door;

/// A file of a stage: name and text; the first is the root.
type File<'a> = (&'a str, &'a str);

/// What a door makes of a feature.
#[derive(Debug, PartialEq, Eq)]
enum Outcome {
    /// All values equal; how many drawables, lights, cameras and settings were compared.
    Equal(usize),
    /// Some are not, and a warning of these kinds names the prims.
    Unsupported(Vec<String>),
    /// The door's message.
    Refused(String),
}

/// How both doors, usd-core's first, read `files` at `time`. Panics at silent differences.
#[track_caller]
fn outcomes(files: &[File], time: Option<f64>) -> [Outcome; 2] {
    outcomes_of(files, |_| time.into())
}

/// How both doors read `files`, written to a folder, in the way that `reading` says for that folder.
#[track_caller]
fn outcomes_of(files: &[File], reading: impl Fn(&Path) -> Reading) -> [Outcome; 2] {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let reading = &reading(folder.path());
    for (name, text) in files {
        let is_layer = name.ends_with(".usda");
        let text = if is_layer {
            format!("#usda 1.0\n{text}")
        } else {
            (*text).to_owned()
        };
        fs::write(folder.path().join(name), text).expect("written");
    }
    let root = folder.path().join(files[0].0);
    let mut evaluator = Evaluator::start();
    [Door::UsdCore, Door::Native].map(|door| match judge(&mut evaluator, &root, door, reading) {
        Err(refusal) => Outcome::Refused(refusal),
        Ok(tally) => {
            let silent = tally.differences;
            assert!(
                silent.is_empty(),
                "{door:?}, {reading:?}:\n{}",
                silent.join("\n")
            );
            let mut kinds: Vec<String> = tally.reasons.into_keys().collect();
            kinds.sort();
            match kinds.is_empty() {
                true => Outcome::Equal(tally.prims),
                false => Outcome::Unsupported(kinds),
            }
        }
    })
}

/// Both doors read `text` without a difference, with `prims` things compared.
#[track_caller]
fn equal(text: &str, time: Option<f64>, prims: usize) {
    equal_files(&[("root.usda", text)], time, prims);
}

#[track_caller]
fn equal_files(files: &[File], time: Option<f64>, prims: usize) {
    assert_eq!(
        outcomes(files, time),
        [Outcome::Equal(prims), Outcome::Equal(prims)]
    );
}

/// Both doors name what they leave out of `text` by warnings of `kind`.
#[track_caller]
fn unsupported(text: &str, kind: &str) {
    for outcome in outcomes(&[("root.usda", text)], None) {
        assert_eq!(outcome, Outcome::Unsupported(vec![kind.to_owned()]));
    }
}

/// A mesh's body; its points can be told from those of other meshes by `height`.
fn quad(height: f32) -> String {
    format!(
        "int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = \"none\"
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, {height}), (0, 1, 0)]\n"
    )
}

fn mesh(name: &str, height: f32) -> String {
    format!("def Mesh \"{name}\" {{\n {} }}\n", quad(height))
}

#[test]
fn a_difference_in_silence_is_found() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [one, other] = [1.0, 1.5].map(|height| {
        let path = folder.path().join(format!("{height}.usda"));
        fs::write(&path, format!("#usda 1.0\n{}", mesh("m", height))).expect("written");
        path
    });
    let mut evaluator = Evaluator::start();
    let truth = evaluator
        .evaluate(&other, &Reading::default())
        .expect("usd-core reads it");
    let scene = crate::scene_of(&one, Door::Native, &Reading::default())
        .expect("so do we")
        .0;
    let tally = crate::compare(&scene, &truth, &[]);
    assert_eq!(
        tally.different, 1,
        "one coordinate: {:?}",
        tally.differences
    );
    assert!(tally.differences[0].starts_with("/m world positions"));
}
