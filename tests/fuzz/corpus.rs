//! Small sound files to damage: the stages of the conformance tests, those of the native reader and some more, as text, binary and in packages, and
//! surfel clouds.

use glam::{DVec3, Vec3};
use std::path::Path;
use surflux::scene::{StageInfo, UpAxis};
use surflux::surfels::SurfelCloud;
use surflux::writers::usd::cloud::{self, CloudOptions};

/// Tests that hold stages as raw strings, plain or as formats.
const SOURCES: [&str; 7] = [
    include_str!("../conformance/features/composition.rs"),
    include_str!("../conformance/features/faults.rs"),
    include_str!("../conformance/features/geometry.rs"),
    include_str!("../conformance/features/look.rs"),
    include_str!("../conformance/features/skinning.rs"),
    include_str!("../native_door/features/arcs.rs"),
    include_str!("../native_door/features/values.rs"),
];

/// The tests hold more; fewer means that they are written in another way.
const FEWEST: usize = 40;

/// Stands for whatever a format puts into a stage: mostly the body of a mesh or a mesh.
const MESH: &str = "def Mesh \"m\" {
    int[] faceVertexCounts = [4, 3]
    int[] faceVertexIndices = [0, 1, 2, 3, 2, 1, 4]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 1)]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1)] (interpolation = \"faceVarying\")
    int[] primvars:st:indices = [0, 1, 2, 0, 1, 2, 0]
}";

const MOVING: &str = r#"#usda 1.0
( defaultPrim = "a"
startTimeCode = 1
endTimeCode = 4 )
def Xform "a" ( kind = "group"
customData = { dictionary d = { int[] list = [1, 2, 3]
string name = "x" } } )
{
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 2: (1, 0, 0), 4: (5, 0, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Points "p"
    {
        point3f[] points.timeSamples = { 1: [(0, 0, 0), (1, 1, 1)], 3: [(0, 1, 0), (2, 1, 1)], }
        float[] widths = [0.1, 0.25] ( interpolation = "vertex" )
        int[] primvars:x = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 1000, -5]
        float[] primvars:y = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 1, 1, 1, 1, 1, 1]
        double[] primvars:z = [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 7.25]
        matrix4d m = ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) )
        quatf[] q = [(1, 0, 0, 0)]
    }
}
"#;

/// One file.
#[derive(Debug)]
pub(crate) enum Seed {
    /// Text, from which a binary layer or a package can be made.
    Stage(String),
    /// A cloud: the bytes and the extension.
    Cloud(Vec<u8>, &'static str),
}

/// All of them, in a fixed order.
pub(crate) fn seeds() -> Vec<Seed> {
    let texts = SOURCES.iter().flat_map(|source| stages(source));
    let mut seeds: Vec<Seed> = texts.chain([MOVING.to_owned()]).map(Seed::Stage).collect();
    assert!(seeds.len() > FEWEST, "{} stages in the tests", seeds.len());
    let folder = tempfile::tempdir().expect("a folder");
    for extension in ["usdc", "usda"] {
        let path = folder.path().join("cloud").with_extension(extension);
        write_cloud(&path);
        seeds.push(Seed::Cloud(
            std::fs::read(path).expect("written"),
            extension,
        ));
    }
    seeds
}

/// The stages in the source text of a test that can be parsed.
fn stages(source: &str) -> Vec<String> {
    let starts = source.split("r#\"").skip(1);
    let raw = starts.filter_map(|rest| rest.split("\"#").next());
    let texts = raw.map(|text| match text.starts_with("#usda") {
        true => text.to_owned(),
        false => format!("#usda 1.0\n{}", filled(text)),
    });
    texts
        .filter(|text| openusd::usda::parse(text).is_ok())
        .collect()
}

/// `text` as `format!` makes it, if it is made for that.
fn filled(text: &str) -> String {
    if !text.contains("{{") {
        return text.to_owned();
    }
    let mut out = String::new();
    let mut rest = text;
    while let Some(at) = rest.find(['{', '}']) {
        out += &rest[..at];
        rest = match &rest[at..] {
            doubled if doubled.starts_with("{{") || doubled.starts_with("}}") => {
                out += &doubled[..1];
                &doubled[2..]
            }
            placeholder => {
                out += MESH;
                placeholder.split_once('}').map_or("", |(_, behind)| behind)
            }
        };
    }
    out + rest
}

/// A layer of the text as a binary file; `None` where the crate cannot.
pub(crate) fn binary(text: &str) -> Option<Vec<u8>> {
    let data = openusd::usda::parse(text).ok()?;
    let mut file = std::io::Cursor::new(Vec::new());
    openusd::usdc::CrateWriter::write(&data, &mut file).ok()?;
    Some(file.into_inner())
}

/// A package of the `layer`, its only file, named with `extension`.
pub(crate) fn package(layer: &[u8], extension: &str) -> Vec<u8> {
    let name = format!("layer.{extension}");
    let size = u32::try_from(layer.len())
        .expect("a small file")
        .to_le_bytes();
    let name_size = u16::try_from(name.len())
        .expect("a short name")
        .to_le_bytes();
    // version, flags, method "stored", time, date, checksum (unchecked)
    let common = [
        &[10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
        &size[..],
        &size,
    ]
    .concat();
    let local = [b"PK\x03\x04", &common[..], &name_size, &[0, 0]].concat();
    let mut file = [&local[..], name.as_bytes(), layer].concat();
    let directory = u32::try_from(file.len()).expect("a small file");
    let entry = [b"PK\x01\x02\x0a\x00", &common[..], &name_size, &[0; 16]].concat();
    let entry = [&entry[..], name.as_bytes()].concat();
    let entry_size = u32::try_from(entry.len()).expect("a short entry");
    file.extend(entry);
    file.extend(b"PK\x05\x06\0\0\0\0\x01\0\x01\0");
    file.extend(entry_size.to_le_bytes());
    file.extend(directory.to_le_bytes());
    file.extend([0, 0]);
    file
}

fn write_cloud(path: &Path) {
    let count = 24_u8;
    let each = |value: f32| vec![Vec3::splat(value); usize::from(count)];
    let cloud = SurfelCloud {
        origin: DVec3::new(1.0, 2.0, 3.0),
        position: (0..count)
            .map(|index| Vec3::splat(f32::from(index)))
            .collect(),
        normal: vec![Vec3::Y; usize::from(count)],
        radius: (0..count).map(|index| 0.5 + f32::from(index % 3)).collect(),
        area: vec![1.0; usize::from(count)],
        radiosity: each(0.5),
        albedo: each(0.25),
        emission: each(0.0),
        prim: (0..count).map(|index| u32::from(index % 2)).collect(),
        prim_paths: vec!["/a".to_owned(), "/b".to_owned()],
        spacing: 0.5,
    };
    let options = CloudOptions::default();
    let stage = StageInfo {
        path: "shot.usda".into(),
        up_axis: UpAxis::Y,
        meters_per_unit: 0.01,
        default_prim: None,
        time_range: None,
        time_codes_per_second: 24.0,
        time: None,
        layers: Vec::new(),
        variants: Vec::new(),
        reader: "native".to_owned(),
    };
    cloud::write(&cloud, &stage, path, &options).expect("written");
}
