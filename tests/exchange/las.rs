//! LAS scans → clouds, against a writer of the format in Python (LAS 1.2, ASPRS) and usd-core.

use super::{convert, must_fail, python_json, survives, text};
use crate::program::{run, stderr};
use serde_json::Value as Json;
use std::fs;
use std::path::Path;

/// Writes points of format 2, and tells what they are.
const WRITE: &str = "
import sys, json, struct, random
random.seed(5)
path, kind = sys.argv[1:]
scale, offset, count = (0.01, 0.01, 0.001), (500000.25, 4000000.5, 100.0), 500
head = b'LASF' + struct.pack('<HH16sBB32s32sHHHIIBHI5I', 0, 0, b'', 1, 2, b'test', b'test', 1, 2026, 227, 227, 0, 2, 26, count, count, 0, 0, 0, 0)
head += struct.pack('<12d', *scale, *offset, 0, 0, 0, 0, 0, 0)
assert len(head) == 227
out, body = [], b''
for i in range(count):
    place = [random.randrange(-100000, 100000) for _ in range(3)]
    color = [random.randrange(65536 if kind == 'wide' else 256) for _ in range(3)]
    intensity, group = random.randrange(65536), random.randrange(12)
    body += struct.pack('<3iHBBbBH3H', *place, intensity, 0x11, group, 0, 0, 7, *color)
    out.append([[p * s + o for p, s, o in zip(place, scale, offset)], color, intensity, group])
open(path, 'wb').write(head + body)
print(json.dumps(out))
";

/// Reads a cloud with usd-core: places in the world.
const READ: &str = "
import sys, json
from pxr import Usd, UsdGeom, Gf
stage = Usd.Stage.Open(sys.argv[1])
prim = stage.GetPrimAtPath('/root/surfels')
world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
get = lambda name: prim.GetAttribute(name).Get()
rows = zip(get('points'), get('primvars:displayColor'), get('primvars:intensity'), get('primvars:classification'))
out = [[list(world.Transform(Gf.Vec3d(p))), list(c), i, g] for p, c, i, g in rows]
print(json.dumps({'rows': out, 'up': UsdGeom.GetStageUpAxis(stage), 'unit': UsdGeom.GetStageMetersPerUnit(stage)}))
";

fn linear(encoded: f64) -> f64 {
    match encoded <= 0.040_45 {
        true => encoded / 12.92,
        false => ((encoded + 0.055) / 1.055).powf(2.4),
    }
}

fn number(value: &Json) -> f64 {
    value.as_f64().expect("a number")
}

/// Compares a cloud with the points that were written, colors of `whole` codes.
fn compare(usd: &Path, written: &Json, whole: f64) {
    let read = python_json(READ, &[usd]);
    assert_eq!((&read["up"], number(&read["unit"])), (&"Z".into(), 1.0));
    let (rows, truth) = (
        read["rows"].as_array().expect("sound"),
        written.as_array().expect("sound"),
    );
    assert_eq!(rows.len(), truth.len());
    for (row, truth) in rows.iter().zip(truth) {
        for k in 0..3 {
            // within a kilometer of the origin single precision has steps of 6e-5
            let off = number(&row[0][k]) - number(&truth[0][k]);
            assert!(off.abs() < 1e-4, "{row} {truth}");
            let color = linear(number(&truth[1][k]) / whole);
            assert!((number(&row[1][k]) - color).abs() < 1e-5, "{row} {truth}");
        }
        assert_eq!(number(&row[2]), number(&truth[2]));
        assert_eq!(row[3], truth[3]);
    }
}

#[test]
fn scans_have_the_places_colors_and_intensities_that_were_written() {
    let folder = tempfile::tempdir().expect("sound");
    for (kind, whole, warnings) in [("wide", 65_535.0, 1), ("narrow", 255.0, 2)] {
        let scan = folder.path().join("scan.las");
        let written = python_json(WRITE, &[&scan, Path::new(kind)]);
        let usd = folder.path().join("scan.usdc");
        let report = convert(&scan, &usd, &[]);
        assert_eq!(
            report["warnings"].as_array().expect("sound").len(),
            warnings
        );
        compare(&usd, &written, whole);
        // packed by the crate that reads it: the same
        let packed = folder.path().join("scan.laz");
        pack(&scan, &packed);
        assert!(
            fs::metadata(&packed).expect("sound").len() < fs::metadata(&scan).expect("sound").len()
        );
        let from_packed = folder.path().join("packed.usdc");
        convert(&packed, &from_packed, &[]);
        compare(&from_packed, &written, whole);
    }
}

fn pack(from: &Path, to: &Path) {
    let mut reader = las::Reader::from_path(from).expect("sound");
    let mut header = las::Builder::from(reader.header().clone());
    header.point_format.is_compressed = true;
    let mut writer =
        las::Writer::from_path(to, header.into_header().expect("sound")).expect("sound");
    for point in reader.read_all().expect("sound").points() {
        writer.write_point(point.expect("sound")).expect("sound");
    }
    writer.close().expect("sound");
}

#[test]
fn damaged_scans_are_errors_and_write_nothing() {
    let folder = tempfile::tempdir().expect("sound");
    let scan = folder.path().join("scan.las");
    python_json(WRITE, &[&scan, Path::new("wide")]);
    let good = fs::read(&scan).expect("sound");
    must_fail("a.las", b"", "LASF");
    must_fail("a.las", b"LASX0000", "LASF");
    must_fail("a.las", &good[..100], "ends within its header");
    must_fail("a.las", &good[..good.len() - 1], "500 points");
    let mut absurd = good.clone();
    absurd[107..111].copy_from_slice(&u32::MAX.to_le_bytes());
    must_fail("a.las", &absurd, "4294967295 points");
    let mut scaled = good.clone();
    scaled[131..139].copy_from_slice(&f64::NAN.to_le_bytes());
    must_fail("a.las", &scaled, "a.las");
    survives("a.las", &good);
    let packed = folder.path().join("scan.laz");
    pack(&scan, &packed);
    let good = fs::read(&packed).expect("sound");
    must_fail("a.laz", &good[..good.len() / 2], "a.laz");
    survives("a.laz", &good);
    // and only read
    let result = run(&["convert", text(&scan), text(&folder.path().join("out.las"))]);
    assert_eq!(result.status.code(), Some(2), "{}", stderr(&result));
}
