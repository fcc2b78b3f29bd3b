//! Reading against usd-core: `cargo bench --bench reading`. Needs a Python with usd-core and numpy (see
//! `tests/support/python.rs`) and 2 GiB of temporary space.
//!
//! Every number is of a process of its own, from its start, so that imports and workers are in it: processor time (user
//! and system, the worker's too) and the largest memory in use. Rivals take turns; medians of the rounds.
//!
//! On two busy cores, dev profile (opt-level 2), medians of five rounds: of 10 M points natively 0.71 and through the
//! worker 1.07 of usd-core's 0.79 s, with 1.46 and 1.02 times the arrays in memory (the worker's own process: 1.41);
//! natively the crate's copy of the file is 0.38 of that. A scene of them, single runs: 1.08 times its arrays at the peak (1.83
//! before meshes gave theirs up), 1.18 with normals, `st` and a color. Of 4000 layers 1.78 times its open and walk through the worker;
//! natively 0.65 s, where opening them one by one took 15.
//!
//! Single runs: 100 000 points of an instancer in 0.1 s natively and 0.4 s through the worker; 100 000 native instances,
//! each a prim, in 1.64 s (median of three) and 9.7 s, where usd-core's open and walk take 3.2. The crate parses the root
//! layer twice, which is 0.5 s of that. At the peak 0.3 GB are in use; what is kept is 144 bytes an instance and its path.

#![expect(clippy::print_stdout, reason = "a benchmark prints what it measured")]

#[path = "../support/python.rs"]
mod python;

use python::{python, run_python};
use serde_json::{Value as Json, json};
use std::path::{Path, PathBuf};
use std::process::Command;
use surflux::diagnostics::Diagnostics;
use surflux::scene::{Interpolation, Mesh, Normals};
use surflux::stage::native::NativeSource;
use surflux::stage::worker::WorkerSource;
use surflux::stage::{self, ReadSettings, Source, process_peak_memory};

const ROUNDS: usize = 5;

/// Makes the stages in the folder `sys.argv[1]`.
const MAKE: &str = r#"
import os, sys
import numpy
from pxr import Gf, Sdf, Usd, UsdGeom, Vt
folder = sys.argv[1]

def grid(stage, path, side):
    mesh = UsdGeom.Mesh.Define(stage, path)
    at = numpy.arange(side, dtype=numpy.float32)
    x, z = numpy.meshgrid(at, at)
    points = numpy.stack([x, numpy.sin(x) * numpy.cos(z), z], -1).reshape(-1, 3).astype(numpy.float32)
    corner = (numpy.arange(side - 1)[:, None] * side + numpy.arange(side - 1)[None, :]).reshape(-1, 1)
    indices = (corner + numpy.array([0, side, side + 1, 1])).astype(numpy.int32).reshape(-1)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(numpy.full(len(corner), 4, numpy.int32)))
    mesh.CreateSubdivisionSchemeAttr("none")

stage = Usd.Stage.CreateNew(os.path.join(folder, "mesh.usdc"))
grid(stage, "/mesh", 3163)
stage.Save()

stage = Usd.Stage.CreateNew(os.path.join(folder, "rich.usdc"))
grid(stage, "/mesh", 3163)
mesh = UsdGeom.Mesh.Get(stage, "/mesh")
points = numpy.array(mesh.GetPointsAttr().Get())
up = points / numpy.maximum(numpy.linalg.norm(points, axis=1, keepdims=True), 1e-3)
mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(up.astype(numpy.float32)))
mesh.SetNormalsInterpolation("vertex")
api = UsdGeom.PrimvarsAPI(mesh)
color = api.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, "vertex")
color.Set(Vt.Vec3fArray.FromNumpy(up.astype(numpy.float32)))
st = api.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
st.Set(Vt.Vec2fArray.FromNumpy(numpy.ascontiguousarray(points[:, ::2])))
st.SetIndices(mesh.GetFaceVertexIndicesAttr().Get())
stage.Save()

os.mkdir(os.path.join(folder, "layers"))
for i in range(4000):
    part = Usd.Stage.CreateNew(os.path.join(folder, "layers", "%d.usdc" % i))
    part.SetDefaultPrim(UsdGeom.Xform.Define(part, "/part").GetPrim())
    grid(part, "/part/mesh", 4)
    part.Save()
shot = Sdf.Layer.CreateNew(os.path.join(folder, "shot.usda"))
for i in range(4000):
    prim = Sdf.CreatePrimInLayer(shot, "/shot/p%d" % i)
    prim.specifier = Sdf.SpecifierDef
    prim.referenceList.prependedItems = [Sdf.Reference("./layers/%d.usdc" % i)]
shot.GetPrimAtPath("/shot").specifier = Sdf.SpecifierDef
shot.Save()

for name, count in (("few", 1000), ("native", 100000)):
    stage = Usd.Stage.CreateNew(os.path.join(folder, name + ".usdc"))
    stage.CreateClassPrim("/kit")
    grid(stage, "/kit/mesh", 4)
    with Sdf.ChangeBlock():
        layer = stage.GetRootLayer()
        for i in range(count):
            prim = Sdf.CreatePrimInLayer(layer, "/shot/i%d" % i)
            prim.specifier = Sdf.SpecifierDef
            prim.typeName = "Xform"
            prim.SetInfo("instanceable", True)
            prim.referenceList.prependedItems = [Sdf.Reference("", "/kit")]
            Sdf.AttributeSpec(prim, "xformOp:translate", Sdf.ValueTypeNames.Double3).default = Gf.Vec3d(i, 0, 0)
            order = Sdf.AttributeSpec(prim, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, Sdf.VariabilityUniform)
            order.default = Vt.TokenArray(["xformOp:translate"])
        layer.GetPrimAtPath("/shot").specifier = Sdf.SpecifierDef
    stage.Save()

stage = Usd.Stage.CreateNew(os.path.join(folder, "points.usdc"))
points = UsdGeom.PointInstancer.Define(stage, "/points")
grid(stage, "/points/mesh", 4)
points.CreatePrototypesRel().SetTargets(["/points/mesh"])
points.CreateProtoIndicesAttr(Vt.IntArray(100000, 0))
points.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(numpy.random.default_rng(1).random((100000, 3), dtype=numpy.float32)))
stage.Save()
"#;

/// What usd-core does by itself with the stage `sys.argv[2]`: open it and walk it; `arrays` = keep every array too.
const RIVAL: &str = r#"
import sys, time
import numpy
from pxr import Usd
stage = Usd.Stage.Open(sys.argv[2])
kept = []
for prim in stage.Traverse():
    if sys.argv[1] == "arrays":
        for attribute in prim.GetAuthoredAttributes():
            value = attribute.Get()
            if attribute.GetTypeName().isArray:
                kept.append(numpy.array(value))
import json
peak = [int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith("VmHWM:")]
print(json.dumps({"cpu": time.process_time(), "peak": (peak or [0])[0], "kept": sum(array.nbytes for array in kept if array.dtype != object)}))
"#;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, mode, door, path] = &arguments[..] {
        println!("{}", read(mode, door, Path::new(path)));
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    run_python(MAKE, &[folder.path()]);
    println!(
        "{:34} {:>8} {:>7} {:>9} {:>9} {:>9}",
        "", "cpu s", "ratio", "peak MiB", "worker", "kept MiB"
    );
    let stage = |name: &str| folder.path().join(name);
    compare(
        "10 M points, arrays",
        &stage("mesh.usdc"),
        ("compose", "arrays"),
        &["native", "usd-core"],
    );
    compare(
        "10 M points, scene",
        &stage("mesh.usdc"),
        ("read", "arrays"),
        &["native", "usd-core"],
    );
    compare(
        "10 M points, more arrays, scene",
        &stage("rich.usdc"),
        ("read", "arrays"),
        &["native", "usd-core"],
    );
    compare(
        "4000 referenced layers",
        &stage("shot.usda"),
        ("compose", "walk"),
        &["native", "usd-core"],
    );
    for name in ["few", "native", "points"] {
        let title = format!("instances: {name}");
        compare(
            &title,
            &stage(&format!("{name}.usdc")),
            ("read", "walk"),
            &["native", "usd-core"],
        );
    }
}

/// One process of ours: read `path` and say what that took.
fn read(mode: &str, door: &str, path: &Path) -> Json {
    let quiet = Diagnostics::default();
    let failed = "the stage of the benchmark is read";
    let mut worker = None;
    let mut source: Box<dyn Source> = match door {
        "native" => Box::new(NativeSource::open(path).expect(failed)),
        _ => {
            let source = WorkerSource::open_with(&python(), path, &quiet).expect(failed);
            worker = Some(source.process_id());
            Box::new(source)
        }
    };
    let settings = ReadSettings::default();
    let kept = match mode {
        "compose" => {
            let raw = stage::compose(&mut *source, &settings, &quiet).expect(failed);
            let attributes = raw.prims.iter().flat_map(|prim| prim.attributes.values());
            let values = attributes.filter_map(|attribute| attribute.value.as_ref());
            values.map(|value| value.bytes()).sum::<usize>()
        }
        _ => {
            let scene = stage::read(&mut *source, &settings, &quiet).expect(failed);
            let prims = scene.prims.len() * size_of::<surflux::scene::Prim>();
            prims + scene.meshes.iter().map(bytes_of).sum::<usize>()
        }
    };
    let processes = [Some(std::process::id()), worker];
    let cpu: f64 = processes.iter().flatten().map(|&id| cpu_seconds(id)).sum();
    json!({
        "cpu": cpu,
        "peak": process_peak_memory("self"),
        "worker": source.peak_memory_bytes(),
        "kept": kept,
    })
}

/// Bytes of the arrays of `mesh`.
fn bytes_of(mesh: &Mesh) -> usize {
    let normals = match &mesh.normals {
        Normals::Flat => 0,
        Normals::Vertex(values) => size_of_val(&values[..]),
        Normals::Corner { corners, values } => size_of_val(&corners[..]) + size_of_val(&values[..]),
    };
    let primvars = mesh.primvars.iter().map(|primvar| {
        let corners = match &primvar.interpolation {
            Interpolation::Corner(corners) => size_of_val(&corners[..]),
            _ => 0,
        };
        corners + size_of_val(&primvar.values[..])
    });
    let cage = mesh.cage.as_ref().map_or(0, |cage| {
        size_of_val(&cage.face_vertex_counts[..])
            + size_of_val(&cage.face_vertex_indices[..])
            + size_of_val(&cage.point_normals[..])
            + size_of_val(&cage.corner_normals[..])
            + cage.on_boundary.len()
    });
    let surface = size_of_val(&mesh.positions[..])
        + size_of_val(&mesh.triangles[..])
        + size_of_val(&mesh.triangle_faces[..]);
    surface + normals + cage + primvars.sum::<usize>()
}

/// User and system time of the process `id` so far.
fn cpu_seconds(id: u32) -> f64 {
    /// What `/proc` counts in, on every Linux.
    const TICKS_A_SECOND: f64 = 100.0;
    let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
    let behind_name = stat.rsplit(')').next().unwrap_or_default();
    let fields = behind_name.split_whitespace().skip(11).take(2);
    fields
        .filter_map(|ticks| ticks.parse::<f64>().ok())
        .sum::<f64>()
        / TICKS_A_SECOND
}

/// Print a line for usd-core alone and one for each door.
fn compare(title: &str, path: &Path, (mode, rival): (&str, &str), doors: &[&str]) {
    let mut runs: Vec<Vec<Json>> = vec![Vec::new(); 1 + doors.len()];
    for _ in 0..ROUNDS {
        let name = path.display().to_string();
        runs[0].push(parsed(&run_python(RIVAL, &[rival, &name])));
        for (door, runs) in doors.iter().zip(&mut runs[1..]) {
            let program: PathBuf = std::env::current_exe().expect("this program");
            let output = Command::new(program).args([mode, door, &name]).output();
            let output = output.expect("it starts itself");
            runs.push(parsed(&String::from_utf8_lossy(&output.stdout)));
        }
    }
    let median = |runs: &[Json], key: &str| {
        let mut values: Vec<f64> = runs.iter().filter_map(|run| run[key].as_f64()).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let names = ["usd-core alone"].iter().chain(doors);
    for (name, of) in names.zip(&runs) {
        let mebibytes = |key| median(of, key) / f64::from(1 << 20);
        println!(
            "{:34} {:8.2} {:7.2} {:9.0} {:9.0} {:9.1}",
            format!("{title}: {name}"),
            median(of, "cpu"),
            median(of, "cpu") / median(&runs[0], "cpu"),
            mebibytes("peak"),
            mebibytes("worker"),
            mebibytes("kept"),
        );
    }
}

fn parsed(line: &str) -> Json {
    serde_json::from_str(line.trim()).expect("a line of JSON")
}
