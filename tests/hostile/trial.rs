//! One run of the program on one stage through one door, and what every run owes its user.

use super::program::{files, stage, stderr, surflux};
use super::python::python;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Both ways to read USD.
pub(crate) const DOORS: [&str; 2] = ["native", "usd-core"];

/// The program reading through `door`.
pub(crate) fn surflux_by(door: &str, command: &str) -> Command {
    let mut program = surflux();
    program.env("SURFLUX_USD_PYTHON", python());
    program.args([command, "--usd", door]);
    program
}

/// A run that ended well or with a refusal, and what is left in its folder.
pub(crate) struct Trial {
    pub(crate) output: Output,
    /// The layer of primvars, if it was written.
    pub(crate) layer: Option<String>,
    what: String,
}

/// Bake `text` through `door`: few rays, few surfels, every kind of light.
pub(crate) fn bake(door: &str, what: &str, text: &str) -> Trial {
    let (folder, path) = stage(text);
    let output = surflux_by(door, "bake")
        .arg(&path)
        .args(["-o", &folder.path().join("out.usda").to_string_lossy()])
        .args(["--aov", "occlusion,irradiance,diffuse_direct,bent_normal"])
        .args([
            "--rays",
            "32",
            "--surfels",
            "200",
            "--display-color",
            "none",
        ])
        .output()
        .expect("the program starts");
    Trial::judge(output, folder.path(), format!("{what} ({door})"))
}

/// Render `text` through `door`, 16 pixels wide.
pub(crate) fn render(door: &str, what: &str, text: &str) -> Trial {
    let (folder, path) = stage(text);
    let output = surflux_by(door, "render")
        .arg(&path)
        .args(["-o", &folder.path().join("out.exr").to_string_lossy()])
        .args(["--aov", "color,depth,N,P", "--rays", "16"])
        .args([
            "--surfels",
            "200",
            "--image-width",
            "16",
            "--pixel-samples",
            "1",
        ])
        .output()
        .expect("the program starts");
    Trial::judge(output, folder.path(), format!("{what} ({door})"))
}

impl Trial {
    /// Exit code 0 with complete, finite files or 1 with a message and none; never a panic.
    fn judge(output: Output, folder: &Path, what: String) -> Self {
        let said = stderr(&output);
        let code = output.status.code();
        assert!(matches!(code, Some(0 | 1)), "{what}: {code:?}\n{said}");
        assert!(!said.contains("panicked"), "{what}: {said}");
        let written = files(folder);
        let layer = fs::read_to_string(folder.join("out.usda")).ok();
        if code == Some(1) {
            assert_eq!(written, ["stage.usda"], "{what}: {said}");
            assert!(!said.trim().is_empty(), "{what}: no message");
        } else {
            assert!(written.len() > 1, "{what}: nothing was written");
        }
        if let Some(layer) = &layer {
            let values = layer.split(|c: char| !(c.is_alphanumeric() || c == '-'));
            for value in values {
                let is_number = !matches!(value, "nan" | "-nan" | "inf" | "-inf");
                assert!(is_number, "{what}: {value} in {layer}");
            }
        }
        Self {
            output,
            layer,
            what,
        }
    }

    /// It was refused, with all `words` in the message.
    pub(crate) fn refused(&self, words: &[&str]) {
        assert_eq!(
            self.output.status.code(),
            Some(1),
            "{} was taken",
            self.what
        );
        self.says(words);
    }

    /// It succeeded, with all `words` in the warnings.
    pub(crate) fn warned(&self, words: &[&str]) {
        let said = stderr(&self.output);
        assert!(self.output.status.success(), "{}: {said}", self.what);
        self.says(words);
    }

    /// It succeeded without a warning.
    pub(crate) fn fine(&self) {
        self.warned(&[]);
        let said = stderr(&self.output);
        assert!(!said.contains("warning"), "{}: {said}", self.what);
    }

    /// All `words` are in what it said, whether it succeeded or not.
    pub(crate) fn says(&self, words: &[&str]) {
        let said = stderr(&self.output);
        for word in words {
            assert!(said.contains(word), "{}: no {word:?} in: {said}", self.what);
        }
    }

    /// All numbers of `primvars:NAME` of every prim, in order of the file.
    pub(crate) fn values(&self, name: &str) -> Vec<f64> {
        let layer = self.layer.as_deref().expect("a layer was written");
        let key = format!("primvars:{name} = [");
        let arrays = layer.split(&key).skip(1);
        arrays
            .flat_map(|rest| {
                let numbers = rest.split(']').next().unwrap_or_default();
                numbers.split(|c: char| "(), ".contains(c))
            })
            .filter(|number| !number.is_empty())
            .map(|number| number.parse().expect("a number"))
            .collect()
    }
}
