//! Clouds ↔ `.ptc`, by an own small decoder and encoder in Python.

use super::ply::{READ_USD, cloud, numbers};
use super::{convert, must_fail, python_json, survives};
use crate::python::run_python;
use serde_json::Value as Json;
use std::fs;

/// The layout as public readers have it: version 0 to 2.
const DECODE: &str = "
import sys, json, math, struct
data = open(sys.argv[1], 'rb').read()
at = 0
def take(form):
    global at
    values = struct.unpack_from('<' + form, data, at)
    at += struct.calcsize('<' + form)
    return values
assert take('4s')[0] == b'pptc'
version = take('i')[0]
count = int(take('d')[0])
bounds = take('6f')
if version >= 1: take('4f')
if version >= 2: take('33f')
take('16f'); take('16f'); take('3f')
channels, size = take('2i')
specs = []
for _ in range(channels):
    end = data.index(b'\\n', at)
    kind, name = data[at:end].decode().split(' ', 1)
    at = end + 1
    specs.append((kind, name, {'float': 1, 'matrix': 16}.get(kind, 3)))
assert sum(s[2] for s in specs) == size
if version >= 1: take('2f')
out = {'P': [], 'N': [], 'radius': [], 'bounds': list(bounds)} | {name: [] for _, name, _ in specs}
for _ in range(count):
    out['P'].append(take('3f'))
    phi, z = take('2H')
    if (phi, z) == (65535, 65535):
        out['N'].append((0, 0, 0))
    else:
        nz = 2 * z / 65535 - 1
        angle, r = 2 * math.pi * (phi / 65535 - 0.5), math.sqrt(max(0, 1 - nz * nz))
        out['N'].append((r * math.sin(angle), r * math.cos(angle), nz))
    out['radius'].append(take('f')[0])
    for _, name, width in specs:
        out[name].append(take('%df' % width))
assert at == len(data), (at, len(data))
print(json.dumps(out))
";

#[test]
fn a_cloud_in_ptc_has_the_numbers_that_usd_core_reads() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(folder.path());
    let ptc = folder.path().join("cloud.ptc");
    let report = convert(&cloud, &ptc, &[]);
    assert_eq!(report["warnings"], Json::Array(Vec::new()));
    let (read, usd) = (
        python_json(DECODE, &[&ptc]),
        python_json(READ_USD, &[&cloud]),
    );
    assert_eq!(numbers(&read["P"]), numbers(&usd["points"]));
    assert_eq!(
        numbers(&read["_radiosity"]),
        numbers(&usd["primvars:radiosity"])
    );
    assert_eq!(numbers(&read["_area"]), numbers(&usd["primvars:area"]));
    let radii: Vec<f64> = numbers(&usd["widths"])
        .iter()
        .map(|width| 0.5 * width)
        .collect();
    assert_eq!(numbers(&read["radius"]), radii);
    for (n, truth) in numbers(&read["N"]).iter().zip(numbers(&usd["normals"])) {
        // half a step of 2/65535 in height is this much across where the height turns
        assert!((n - truth).abs() < 6e-3, "{n} {truth}");
    }
    // and back: the same but for normals
    let back = folder.path().join("back.usdc");
    convert(&ptc, &back, &["--meters-per-unit", "0.01"]);
    let after = python_json(READ_USD, &[&back]);
    for name in [
        "points",
        "widths",
        "primvars:radiosity",
        "primvars:albedo",
        "primvars:displayColor",
    ] {
        assert_eq!(numbers(&after[name]), numbers(&usd[name]), "{name}");
    }
}

#[test]
fn files_of_every_version_are_read() {
    let folder = tempfile::tempdir().unwrap();
    for version in ["0", "1", "2"] {
        const ENCODE: &str = "
import sys, struct
v = int(sys.argv[2])
out = b'pptc' + struct.pack('<id6f', v, 2, 0, 0, 0, 1, 2, 3)
out += struct.pack('<4f', 9, 9, 9, 9) * (v >= 1) + struct.pack('<33f', *[7] * 33) * (v >= 2)
out += struct.pack('<35f', *range(35)) + struct.pack('<2i', 3, 20)
out += b'float _area\\nmatrix _m\\ncolor _radiosity\\n' + struct.pack('<2f', 5, 5) * (v >= 1)
for i in range(2):
    out += struct.pack('<3fHHf', i, 2, 3, 65535 if i else 0, 65535, 0.5 + i) + struct.pack('<20f', 0.25, *[1] * 16, 0.1, 0.2, 0.3)
open(sys.argv[1], 'wb').write(out)
";
        let ptc = folder.path().join("v.ptc");
        run_python(ENCODE, &[ptc.as_path(), std::path::Path::new(version)]);
        let usd = folder.path().join("v.usda");
        let report = convert(&ptc, &usd, &["--up-axis", "z"]);
        assert_eq!(report["warnings"][0]["kind"], "lost");
        assert!(
            report["warnings"][0]["message"]
                .as_str()
                .unwrap()
                .contains("_m")
        );
        let read = python_json(READ_USD, &[&usd]);
        assert_eq!(numbers(&read["points"]), [0.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
        assert_eq!(numbers(&read["widths"]), [1.0, 3.0]);
        // straight up, and none
        assert_eq!(numbers(&read["normals"])[3..], [0.0; 3]);
        assert_eq!(numbers(&read["normals"])[2], 1.0);
        assert_eq!(numbers(&read["primvars:area"]), [0.25, 0.25]);
        assert_eq!(read["upAxis"], "Z");
    }
}

#[test]
fn damaged_files_are_errors_and_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (cloud, ptc) = (cloud(folder.path()), folder.path().join("c.ptc"));
    convert(&cloud, &ptc, &[]);
    let good = fs::read(&ptc).unwrap();
    must_fail("a.ptc", b"", "pptc");
    must_fail("a.ptc", b"pptx0000", "pptc");
    must_fail("a.ptc", &good[..60], "ends within its header");
    must_fail("a.ptc", &good[..good.len() - 1], "points");
    for count in [-1.0, 0.5, 1e300, f64::NAN, f64::INFINITY] {
        let mut damaged = good.clone();
        damaged[8..16].copy_from_slice(&count.to_le_bytes());
        must_fail("a.ptc", &damaged, "points");
    }
    let mut newer = good.clone();
    newer[4] = 3;
    must_fail("a.ptc", &newer, "version");
    survives("a.ptc", &good);
}
