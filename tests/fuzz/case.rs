//! A case: a folder with a stage, of which one file is damaged.

use crate::corpus::{self, Seed};
use crate::random::Random;
use crate::{mutate, sections};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Layers with more brackets are not turned into binary ones: the crate's parser recurses, and only surflux guards it.
const MOST_BRACKETS: usize = 1000;

/// What stands beside the case.
const SIBLING: &str = r#"#usda 1.0
( defaultPrim = "a" )
def Xform "a" { def Sphere "s" { double radius = 2 } }
def Xform "b" { def Cube "c" { } }
"#;

/// What brings the case in when it is not the root itself.
const ROOTS: [&str; 4] = [
    "#usda 1.0\n( subLayers = [@CASE@ (offset = 2)] )\nover \"a\" { def Cube \"own\" { } }",
    "#usda 1.0\ndef \"a\" ( references = @CASE@ ) { }\ndef \"b\" ( references = @CASE@</a> ) { }",
    "#usda 1.0\ndef \"a\" ( payload = @CASE@\n instanceable = true ) { }\ndef \"b\" ( payload = @CASE@\n instanceable = true ) { }",
    "#usda 1.0\n( subLayers = [@sibling.usda@, @CASE@] )\nover \"a\" ( references = @CASE@</a> ) { }",
];

/// The files of a case, written.
#[derive(Debug)]
pub(crate) struct Case {
    /// What to read.
    pub(crate) root: PathBuf,
    /// The damaged file.
    pub(crate) damaged: PathBuf,
    /// It was a cloud.
    pub(crate) is_cloud: bool,
    pub(crate) time: Option<f64>,
}

impl Case {
    /// Make the case that `random` stands for in `folder`, which is emptied before.
    pub(crate) fn write(seeds: &[Seed], random: &mut Random, folder: &Path) -> io::Result<Self> {
        if folder.exists() {
            fs::remove_dir_all(folder)?;
        }
        fs::create_dir_all(folder)?;
        fs::write(folder.join("sibling.usda"), SIBLING)?;
        let (content, extension, is_cloud) = damaged(seeds, random);
        let name = format!("case.{extension}");
        let damaged = folder.join(&name);
        fs::write(&damaged, content)?;
        let root = match random.below(4) {
            0 => {
                let root = folder.join("root.usda");
                fs::write(&root, random.one_of(&ROOTS).replace("CASE", &name))?;
                root
            }
            _ => damaged.clone(),
        };
        Ok(Self {
            root,
            damaged,
            is_cloud,
            time: [None, None, Some(2.5), Some(-1e300)][random.below(4)],
        })
    }
}

/// Content and extension of the damaged file, and whether it was a cloud.
fn damaged(seeds: &[Seed], random: &mut Random) -> (Vec<u8>, &'static str, bool) {
    let other = match &seeds[random.below(seeds.len())] {
        Seed::Stage(text) => text,
        Seed::Cloud(..) => SIBLING,
    };
    // clouds are few but not rarely read
    let cloud = seeds.len() - 1 - random.below(2);
    let chosen = if random.below(8) == 0 {
        cloud
    } else {
        random.below(seeds.len())
    };
    match &seeds[chosen] {
        Seed::Stage(text) => {
            let (content, extension) = damaged_stage(text, other, random);
            (content, extension, false)
        }
        Seed::Cloud(content, extension) => {
            let content = match *extension {
                "usdc" => damaged_binary(content.clone(), other.as_bytes(), random),
                _ => damaged_text(&String::from_utf8_lossy(content), other, random),
            };
            (content, extension, true)
        }
    }
}

fn damaged_stage(text: &str, other: &str, random: &mut Random) -> (Vec<u8>, &'static str) {
    match random.below(8) {
        0..=2 => (damaged_text(text, other, random), "usda"),
        3 | 4 => match reworded_binary(text, other, random) {
            Some(content) => (content, "usdc"),
            None => (damaged_text(text, other, random), "usda"),
        },
        5 | 6 => {
            let content = corpus::binary(text).unwrap_or_default();
            (damaged_binary(content, other.as_bytes(), random), "usdc")
        }
        _ => (damaged_package(text, other, random), "usdz"),
    }
}

fn damaged_text(text: &str, other: &str, random: &mut Random) -> Vec<u8> {
    match random.below(6) {
        0 => {}
        1 | 2 => return mutate::text(text, other, random).into_bytes(),
        _ => return mutate::meaning(text, other, random).into_bytes(),
    }
    let mut content = text.as_bytes().to_vec();
    for _ in 0..1 + random.below(4) {
        mutate::bytes(&mut content, other.as_bytes(), random);
    }
    content
}

fn damaged_binary(mut content: Vec<u8>, other: &[u8], random: &mut Random) -> Vec<u8> {
    let is_damaged = random.below(3) > 0 && sections::damage(&mut content, random).is_some();
    if !is_damaged || random.below(4) == 0 {
        for _ in 0..1 + random.below(6) {
            mutate::bytes(&mut content, other, random);
        }
    }
    content
}

/// A sound binary layer of what a damaged text says.
fn reworded_binary(text: &str, other: &str, random: &mut Random) -> Option<Vec<u8>> {
    let text = match random.below(3) {
        0 => mutate::text(text, other, random),
        _ => mutate::meaning(text, other, random),
    };
    let brackets = text.chars().filter(|c| "[{(".contains(*c)).count();
    if brackets > MOST_BRACKETS {
        return None;
    }
    let made = std::panic::catch_unwind(|| corpus::binary(&text));
    made.ok().flatten()
}

fn damaged_package(text: &str, other: &str, random: &mut Random) -> Vec<u8> {
    if random.below(2) == 0 {
        let layer = damaged_binary(
            corpus::binary(text).unwrap_or_default(),
            other.as_bytes(),
            random,
        );
        return corpus::package(&layer, "usdc");
    }
    let mut content = corpus::package(text.as_bytes(), "usda");
    for _ in 0..1 + random.below(4) {
        mutate::bytes(&mut content, &[], random);
    }
    content
}
