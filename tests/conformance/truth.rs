//! The usd-core process that evaluates stages, and its answers.

use crate::Reading;
use crate::python::python;
use serde_json::Value;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use surflux::stage::Load;

const SCRIPT: &str = include_str!("evaluate_stage.py");

/// A running `evaluate_stage.py`.
pub(crate) struct Evaluator {
    child: Child,
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
    folder: tempfile::TempDir,
}

/// What usd-core computes of one stage at one time.
pub(crate) struct Truth {
    /// See `evaluate_stage.py`.
    pub(crate) index: Value,
    arrays: Vec<f64>,
}

impl Evaluator {
    pub(crate) fn start() -> Self {
        let mut child = Command::new(python())
            .args(["-c", SCRIPT])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // what usd-core warns of is the doors' to pass on
            .stderr(Stdio::null())
            .spawn()
            .expect("the test Python starts");
        Self {
            input: child.stdin.take(),
            output: BufReader::new(child.stdout.take().expect("its stdout is a pipe")),
            child,
            folder: tempfile::tempdir().expect("a temporary folder"),
        }
    }

    /// `Err` with usd-core's message where it cannot open the stage.
    pub(crate) fn evaluate(&mut self, stage: &Path, reading: &Reading) -> Result<Truth, String> {
        let arrays = self.folder.path().join("arrays");
        let composition = &reading.composition;
        let variants = composition.variants.iter();
        let variants = variants.map(|choice| [&choice.prim, &choice.set, &choice.choice]);
        let request = serde_json::json!({
            "path": stage,
            "time": reading.time,
            "arrays": arrays,
            "unloaded": composition.load == Load::None,
            "variants": variants.collect::<Vec<_>>(),
            "session": composition.session_layer,
            "muted": composition.muted_layers,
        });
        let input = self.input.as_mut().expect("open until dropped");
        writeln!(input, "{request}").expect("the evaluator listens");
        let mut line = String::new();
        self.output
            .read_line(&mut line)
            .expect("the evaluator answers");
        let index: Value = serde_json::from_str(&line).expect("the evaluator answers in JSON");
        if let Some(problem) = index["error"].as_str() {
            return Err(problem.to_owned());
        }
        let bytes = std::fs::read(&arrays).expect("the evaluator wrote its arrays");
        let values = bytes
            .chunks_exact(8)
            .map(|bytes| f64::from_le_bytes(bytes.try_into().expect("chunks of eight")));
        Ok(Truth {
            arrays: values.collect(),
            index,
        })
    }
}

impl Drop for Evaluator {
    fn drop(&mut self) {
        drop(self.input.take());
        // it ends with its input; a failure to wait leaves nothing to do
        let _ = self.child.wait();
    }
}

impl Truth {
    /// The array that `slot` names.
    pub(crate) fn array(&self, slot: &Value) -> &[f64] {
        let at = |index: usize| {
            let number = slot[index].as_u64().expect("a slot of two numbers");
            usize::try_from(number).expect("fits in memory")
        };
        &self.arrays[at(0)..at(0) + at(1)]
    }

    /// The same as indices; negative ones do not occur in what is compared.
    pub(crate) fn indices(&self, slot: &Value) -> Vec<usize> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "indices of valid meshes"
        )]
        self.array(slot)
            .iter()
            .map(|&index| index as usize)
            .collect()
    }
}

/// A number of an answer: those that JSON lacks are spelled out.
pub(crate) fn number(value: &Value) -> f64 {
    let spelled = || value.as_str().and_then(|text| text.parse().ok());
    value.as_f64().or_else(spelled).expect("a number")
}

/// All numbers of a list.
pub(crate) fn list(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .expect("a list")
        .iter()
        .map(number)
        .collect()
}
