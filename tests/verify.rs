//! `surflux verify` on a small stage: its JSON, its page, and the laws that its numbers must obey.

use serde_json::Value;
use std::fs;
use std::process::Command;

/// A sphere and a cube on a floor under a lamp and a gray sky.
const STAGE: &str = r#"#usda 1.0
(
    defaultPrim = "World"
    upAxis = "Y"
)
def Xform "World"
{
    def Mesh "floor"
    {
        point3f[] points = [(-2, 0, -2), (-2, 0, 0), (-2, 0, 2), (0, 0, -2), (0, 0, 0), (0, 0, 2), (2, 0, -2), (2, 0, 0), (2, 0, 2)]
        int[] faceVertexCounts = [4, 4, 4, 4]
        int[] faceVertexIndices = [0, 1, 4, 3, 1, 2, 5, 4, 3, 4, 7, 6, 4, 5, 8, 7]
        uniform token subdivisionScheme = "none"
        color3f[] primvars:displayColor = [(0.8, 0.5, 0.3)]
    }
    def Sphere "ball"
    {
        double radius = 0.6
        double3 xformOp:translate = (-0.7, 0.62, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Cube "block"
    {
        double size = 0.8
        double3 xformOp:translate = (0.6, 0.41, 0.2)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def RectLight "lamp"
    {
        float inputs:intensity = 10
        double3 xformOp:translate = (0, 4, 0)
        double xformOp:rotateX = -90
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
    }
    def DomeLight "sky"
    {
        float inputs:intensity = 0.5
    }
    def Camera "cam"
    {
        float focalLength = 30
        float horizontalAperture = 24
        float verticalAperture = 16
        float2 clippingRange = (0.01, 100)
        double3 xformOp:translate = (0, 1.5, 5)
        double xformOp:rotateX = -12
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
    }
}
"#;

fn number(value: &Value, key: &str) -> f64 {
    value[key]
        .as_f64()
        .unwrap_or_else(|| panic!("{key} is a number in {value}"))
}

/// relRMSE of the swept (not picked) rows of `engine`, by rays or resolution.
fn sweep(
    rows: &[Value],
    (aov, set): (&str, &str),
    (engine, knob): (&str, &str),
) -> Vec<(f64, f64)> {
    let mut found: Vec<_> = rows
        .iter()
        .filter(|row| row["aov"] == aov && row["set"] == set && row["engine"] == engine)
        .filter(|row| row["auto"].is_null())
        .map(|row| (number(&row["settings"], knob), number(row, "relative_rmse")))
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found
}

#[test]
fn a_small_scene_gives_sane_numbers_and_a_page_that_stands_alone() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let stage = folder.path().join("a <b> & c.usda");
    fs::write(&stage, STAGE).expect("writable");
    let page = folder.path().join("report.html");
    let output = Command::new(env!("CARGO_BIN_EXE_surflux"))
        .arg("verify")
        .arg(&stage)
        .arg("-o")
        .arg(&page)
        .args("--json --usd native --receivers 96 --truth-rays 2048 --surfels 10000".split(' '))
        .output()
        .expect("the program starts");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let report: Value = serde_json::from_slice(&output.stdout).expect("stdout is JSON");
    fields(&report);
    laws(report["rows"].as_array().expect("rows"));
    let html = fs::read_to_string(&page).expect("the page");
    assert!(html.contains("a &lt;b&gt; &amp; c.usda") && !html.contains("<b> & c"));
    assert!(html.contains("<svg") && html.contains("data:image/png;base64,iVBOR"));
    assert!(
        !html.contains("http://") && !html.contains("https://"),
        "needs the network"
    );
}

#[test]
fn only_what_is_asked_for_is_measured() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let stage = folder.path().join("stage.usda");
    fs::write(&stage, STAGE).expect("writable");
    let verify = |flags: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_surflux"));
        command.arg("verify").arg(&stage).args(flags.split(' '));
        command.output().expect("the program starts")
    };
    let flags = "--json --usd native --receivers 32 --truth-rays 512 --surfels 3000";
    let output = verify(&format!(
        "{flags} --aov visibility --sets points --only-auto"
    ));
    let report: Value = serde_json::from_slice(&output.stdout).expect("stdout is JSON");
    let rows = report["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 3, "one a tolerance: {report}");
    for row in rows {
        assert_eq!(
            (&row["aov"], &row["set"]),
            (&"visibility".into(), &"points".into())
        );
        assert!(!row["auto"].is_null());
    }
    assert_eq!(verify("--aov bent_normal").status.code(), Some(2));
    assert_eq!(verify("--sets vertices").status.code(), Some(2));
}

fn fields(report: &Value) {
    for key in [
        "surflux", "command", "stage", "usd", "machine", "truth", "rows", "warnings",
    ] {
        assert!(!report[key].is_null(), "no {key}");
    }
    assert!(number(report, "seconds") > 0.0 && number(report, "surfels") > 1000.0);
    let rows = report["rows"].as_array().expect("rows");
    for row in rows {
        for key in ["microseconds", "relative_rmse", "bias", "p99", "max"] {
            assert!(number(row, key).is_finite(), "{key} of {row}");
        }
        assert_eq!(row["non_finite"], 0, "{row}");
        assert!(number(row, "p99") <= number(row, "max") && number(row, "microseconds") > 0.0);
    }
    let names = |key: &str| {
        let mut names: Vec<&str> = rows.iter().filter_map(|row| row[key].as_str()).collect();
        names.sort_unstable();
        names.dedup();
        names
    };
    assert_eq!(names("set"), ["pixels", "points", "surfels"]);
    assert_eq!(names("engine"), ["maps", "paper", "raster", "rays"]);
    assert_eq!(
        names("aov"),
        [
            "irradiance_environment",
            "irradiance_indirect",
            "visibility"
        ]
    );
    let tolerances = rows.iter().filter(|row| !row["auto"].is_null()).count();
    assert_eq!(tolerances, 3 * 3 * 3, "three tolerances a set and AOV");
}

fn laws(rows: &[Value]) {
    for set in ["pixels", "points", "surfels"] {
        // 256 times the rays: even at the power 0.5 of random ones the error falls 16-fold; the truth itself errs.
        let rays = sweep(rows, ("visibility", set), ("rays", "rays"));
        let (first, last) = (rays[0].1, rays[rays.len() - 1].1);
        assert!(first > 8.0 * last, "{set}: {rays:?}");
        // The paper's method has a floor: surfels stand for surfaces.
        let paper = sweep(rows, ("visibility", set), ("paper", "raster_resolution"));
        let best = paper.iter().map(|row| row.1).fold(f64::INFINITY, f64::min);
        assert!(best > 2.0 * last && best < 0.5, "{set}: {paper:?}");
    }
    for set in ["pixels", "points", "surfels"] {
        // The scene is a floor, a ball and a block: fine maps with many directions show it to a few per cent.
        let maps = sweep(rows, ("visibility", set), ("maps", "directions"));
        let best = maps.iter().map(|row| row.1).fold(f64::INFINITY, f64::min);
        assert!(maps.len() == 6 && best < 0.05, "{set}: {maps:?}");
        let none = sweep(rows, ("irradiance_indirect", set), ("maps", "directions"));
        assert!(none.is_empty(), "maps see no reflected light");
    }
    // One bounce at a tolerance of 1 % may be out of reach of the surfels asked for: it is told, not promised.
    let picked = |row: &&Value| !row["auto"].is_null() && row["aov"] == "visibility";
    for row in rows.iter().filter(picked) {
        let tolerance = number(&row["auto"], "tolerance");
        let (found, told) = (
            number(row, "relative_rmse"),
            number(&row["auto"], "estimate"),
        );
        // 96 receivers that the pilot has not chosen by: their error is that of all within a third.
        assert!(told <= tolerance, "{row}");
        assert!(found < 1.5 * tolerance, "{row}");
    }
}
