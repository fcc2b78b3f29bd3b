//! Gaussian splats: PLY as the authors' implementation writes it ↔ USD's particle fields.

use super::ply::numbers;
use super::{convert, must_fail, python_json};
use crate::python::run_python;
use std::fs;

/// Three splats of degree 1, and what they are.
const MAKE: &str = "
import sys, struct
rows = []
for i in range(3):
    row = [i, 2, 3, 0, 0, 0, 0.1 + i, 0.2, 0.3] + [10 * c + k for c in range(3) for k in range(3)]
    row += [[-2.0, 0.0, 3.0][i], -1.0, 0.0, 0.5] + [[2, 0, 0, 0], [1, 1, 0, 0], [0, 0, 0.5, 0]][i]
    rows.append(row)
names = 'x y z nx ny nz f_dc_0 f_dc_1 f_dc_2'.split() + ['f_rest_%d' % i for i in range(9)]
names += 'opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split()
head = 'ply\\nformat binary_little_endian 1.0\\nelement vertex 3\\n' + ''.join('property float %s\\n' % n for n in names) + 'end_header\\n'
open(sys.argv[1], 'wb').write(head.encode() + b''.join(struct.pack('<%df' % len(r), *r) for r in rows))
";

/// What usd-core makes of them.
const READ: &str = "
import sys, json
from pxr import Usd, UsdVol, UsdValidation
stage = Usd.Stage.Open(sys.argv[1])
prim = stage.GetPrimAtPath('/root/splats')
assert UsdVol.ParticleField3DGaussianSplat(prim)
get = lambda n: prim.GetAttribute(n).Get()
c = prim.GetAttribute('radiance:sphericalHarmonicsCoefficients')
context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
print(json.dumps({'P': [list(v) for v in get('positions')], 'scales': [list(v) for v in get('scales')], 'opacities': list(get('opacities')),
    'q': [[q.real, *q.imaginary] for q in get('orientations')], 'degree': get('radiance:sphericalHarmonicsDegree'),
    'size': c.GetMetadata('elementSize'), 'c': [list(v) for v in c.Get()],
    'errors': [e.GetName() for e in context.Validate(stage)]}))
";

#[test]
fn usd_core_reads_splats_as_their_ply_means_them() {
    let folder = tempfile::tempdir().unwrap();
    let (ply, usd) = (folder.path().join("s.ply"), folder.path().join("s.usdc"));
    run_python(MAKE, &[&ply]);
    convert(&ply, &usd, &[]);
    let read = python_json(READ, &[&usd]);
    assert_eq!(read["errors"], serde_json::json!([]));
    assert_eq!(
        (read["degree"].as_i64(), read["size"].as_i64()),
        (Some(1), Some(4))
    );
    let near = |key: &str, truth: &[f64]| {
        let values = numbers(&read[key]);
        assert_eq!(values.len(), truth.len(), "{key}");
        for (value, truth) in values.iter().zip(truth) {
            assert!((value - truth).abs() < 1e-6, "{key} {value} {truth}");
        }
    };
    near("P", &[0.0, 2.0, 3.0, 1.0, 2.0, 3.0, 2.0, 2.0, 3.0]);
    near("scales", &[(-1.0_f64).exp(), 1.0, 0.5_f64.exp()].repeat(3));
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    near("opacities", &[sigmoid(-2.0), 0.5, sigmoid(3.0)]);
    let half = 0.5_f64.sqrt();
    near(
        "q",
        &[1.0, 0.0, 0.0, 0.0, half, half, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    );
    // coefficient k of the three channels: f_rest is all of red, of green, of blue
    let rest = [0.0, 10.0, 20.0, 1.0, 11.0, 21.0, 2.0, 12.0, 22.0];
    let of = |i: f64| [[0.1 + i, 0.2, 0.3].as_slice(), &rest].concat();
    near("c", &[of(0.0), of(1.0), of(2.0)].concat());
    // and back: the same numbers but for the rounding of exp and ln, and rotations at unit length
    let back = folder.path().join("back.ply");
    convert(&usd, &back, &[]);
    let body = |path: &std::path::Path| {
        let bytes = fs::read(path).unwrap();
        let start = bytes
            .windows(11)
            .position(|w| w == b"end_header\n")
            .unwrap()
            + 11;
        let words = bytes[start..].chunks_exact(4);
        words
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect::<Vec<_>>()
    };
    let (before, after) = (body(&ply), body(&back));
    assert_eq!(before.len(), after.len());
    for (i, (a, b)) in before.iter().zip(&after).enumerate() {
        if i % 26 < 22 {
            assert!((a - b).abs() < 1e-5, "{i}: {a} {b}");
        }
    }
}

#[test]
fn splats_that_lack_something_are_an_error() {
    let with = |names: &str| {
        let names: String = names
            .split(' ')
            .map(|name| format!("property float {name}\n"))
            .collect();
        format!("ply\nformat ascii 1.0\nelement vertex 0\n{names}end_header\n").into_bytes()
    };
    must_fail("a.ply", &with("x y z f_dc_0 f_dc_1 f_dc_2"), "rot_0");
    must_fail(
        "a.ply",
        &with("x y z f_dc_0 f_dc_1 f_dc_2 f_rest_0"),
        "1 f_rest",
    );
}
