//! Thousands of instances beside each other in binary layers, alike but for some; and large binary layers.

use crate::compare::compare;
use crate::{Case, native};
use openusd::sdf::{ChildrenKey, Data, Path as SdfPath, SpecType, Specifier, Value, Variability};
use openusd::usdc::CrateWriter;
use std::fmt::Write;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;
use surflux::diagnostics::Diagnostics;
use surflux::stage::raw;

/// More than are looked up one by one.
const COUNT: usize = 2400;

/// What makes instance `i` differ from its neighbors: metadata of the prim, and further properties.
fn own(i: usize) -> (&'static str, &'static str) {
    match i % 97 {
        11 => ("kind = \"component\"", ""),
        12 => ("customData = {\nint id = 3\n}", ""),
        13 => ("", "rel proxyPrim = </Kit>\n"),
        14 => ("", "float size = 2 ( interpolation = \"vertex\" )\n"),
        15 => (
            "",
            "double3 xformOp:scale.timeSamples = { 1: (1, 2, 3), 5: (2, 3, 4) }\n",
        ),
        16 => (
            "",
            "token word = \"a\"\nstring text = \"b\"\nasset file = @./none.png@\n",
        ),
        17 => (
            "",
            "float inputs:x = 1\nfloat inputs:x.connect = </Kit.size>\n",
        ),
        18 => ("", "def \"child\" {\nint n = 1\n}\n"),
        19 => ("active = false", ""),
        20 => (
            "",
            "timecode when = 5\nint[] list = [1, 2, 3]\nfloat gone = None\n",
        ),
        21 => ("", "custom uniform bool flag = true\nint nothing\n"),
        22 => ("prepend apiSchemas = [\"GeomModelAPI\"]", ""),
        _ => ("", ""),
    }
}

/// `alone`: what the instances refer to has no properties of its own.
fn crowd(alone: bool) -> String {
    let size = if alone {
        ""
    } else {
        "float size = 7\nint of_kit = 1\n"
    };
    let mut text = format!(
        "#usda 1.0\n(\n)\ndef \"Kit\" {{\n{size}def Cube \"cube\" {{\n}}\n}}\n\
         def \"Other\" {{\ndef Sphere \"ball\" {{\n}}\n}}\ndef Xform \"W\" {{\n"
    );
    for i in 0..COUNT {
        let (metadata, properties) = own(i);
        // names in another order than that of the file, and with dots and digits to sort among
        let name = format!(
            "i{}{}",
            i * 7919 % COUNT,
            if i % 3 == 0 { "_b" } else { "" }
        );
        let target = if i % 5 == 4 { "Other" } else { "Kit" };
        writeln!(
            text,
            "def Xform \"{name}\" (\ninstanceable = true\nreferences = </{target}>\n{metadata}\n) {{\n\
             double3 xformOp:translate = ({i}, 0, 1)\n\
             uniform token[] xformOpOrder = [\"xformOp:translate\"]\n{properties}}}"
        )
        .expect("text");
    }
    text + "}\n"
}

fn write_binary(data: &Data, path: &Path) {
    let mut file = BufWriter::new(File::create(path).expect("a file"));
    CrateWriter::write(data, &mut file).expect("a binary layer");
}

/// Pixar's writer gives specs with equal fields one set of fields.
const EXPORT: &str =
    "import sys\nfrom pxr import Sdf\nSdf.Layer.FindOrOpen(sys.argv[1]).Export(sys.argv[2])";

#[test]
fn crowds_of_instances_read_like_usd_core_reads_them() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut cases = Vec::new();
    for alone in [true, false] {
        let text = folder.path().join(format!("crowd_{alone}.usda"));
        fs::write(&text, crowd(alone)).expect("a file");
        let path = text.with_extension("usdc");
        crate::python::run_python(EXPORT, &[&text, &path]);
        cases.extend([None, Some(2.5)].map(|time| Case::new(&path, time)));
    }
    let tally = compare(&cases);
    assert!(tally.different.is_empty(), "{}", tally.different.join("\n"));
}

/// A layer of 10 MB: its array is not held by the crate, and is what was written.
#[test]
fn long_arrays_are_what_the_file_has() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("large.usdc");
    let points: Vec<f32> = (0..2_500_000)
        .map(|i| f32::from_bits(0x3f80_0000 + i))
        .collect();
    let mut data = Data::new();
    let root = data.create_spec(SdfPath::abs_root(), SpecType::PseudoRoot);
    root.add(
        ChildrenKey::PrimChildren.as_str(),
        Value::TokenVec(vec!["M".into()]),
    );
    let prim = data.create_spec(SdfPath::new("/M").expect("a path"), SpecType::Prim);
    prim.add("specifier", Value::Specifier(Specifier::Def));
    prim.add("typeName", Value::Token("Points".into()));
    let names = ["heights", "short"].map(Into::into).to_vec();
    prim.add(
        ChildrenKey::PropertyChildren.as_str(),
        Value::TokenVec(names),
    );
    for (name, values) in [("heights", points.clone()), ("short", vec![1.0, 2.0])] {
        let path = SdfPath::new(&format!("/M.{name}")).expect("a path");
        let attribute = data.create_spec(path, SpecType::Attribute);
        attribute.add("typeName", Value::Token("float[]".into()));
        attribute.add("variability", Value::Variability(Variability::Varying));
        attribute.add("default", Value::FloatVec(values));
    }
    write_binary(&data, &path);
    for time in [None, Some(1.0)] {
        let stage = native(&Case::new(&path, time), &Diagnostics::default()).expect("a stage");
        let attributes = &stage.prims[0].attributes;
        assert!(attributes["heights"].value == Some(raw::Value::FloatArray(points.clone())));
        assert_eq!(
            attributes["short"].value,
            Some(raw::Value::FloatArray(vec![1.0, 2.0]))
        );
    }
}
