//! Huge, tiny and far away scenes hold the same light as the scene at its own size.

use super::trial::{DOORS, Trial, bake};

/// A box on a floor, `scale` times its size by its points, moved by a transform.
fn scene(scale: f64, offset: f64) -> String {
    let number = |x: f64| format!("{}", x * scale);
    let list = |points: &[[f64; 3]]| {
        let points = points.iter();
        let texts =
            points.map(|[x, y, z]| format!("({},{},{})", number(*x), number(*y), number(*z)));
        texts.collect::<Vec<_>>().join(",")
    };
    let floor = list(&[[-1., 0., -1.], [-1., 0., 1.], [1., 0., 1.], [1., 0., -1.]]);
    let corners = [0.0, 1.0].map(|y| {
        [[-0.3, -0.2], [-0.25, 0.3], [0.35, 0.25], [0.3, -0.3]].map(|[x, z]| [x, 0.05 + y * 0.5, z])
    });
    let walls = list(&corners.concat());
    format!(
        r#"#usda 1.0
( metersPerUnit = 1
  upAxis = "Y" )
def Xform "far"
{{
    double3 xformOp:translate = ({offset}, {offset}, {offset})
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "floor"
    {{
        point3f[] points = [{floor}]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0,1,2,3]
        uniform token subdivisionScheme = "none"
    }}
    def Mesh "box"
    {{
        point3f[] points = [{walls}]
        int[] faceVertexCounts = [4,4,4,4,4,4]
        int[] faceVertexIndices = [3,2,1,0, 4,5,6,7, 0,1,5,4, 1,2,6,5, 2,3,7,6, 3,0,4,7]
        uniform token subdivisionScheme = "none"
    }}
}}
"#
    )
}

fn close(reference: &Trial, trial: &Trial, what: &str) {
    let (want, got) = (reference.values("occlusion"), trial.values("occlusion"));
    assert_eq!((want.len(), got.len()), (12, 12), "{what}");
    for (want, got) in want.iter().zip(&got) {
        assert!((want - got).abs() <= 1e-3, "{what}: {got}, not {want}");
    }
}

#[test]
fn occlusion_does_not_depend_on_units_or_place() {
    for door in DOORS {
        let reference = bake(door, "size 1", &scene(1.0, 0.0));
        let covered = reference.values("occlusion");
        assert!(covered.iter().any(|&covered| covered > 0.1), "{covered:?}");
        for (scale, offset) in [
            (1e5, 0.0),
            (1e-4, 0.0),
            (1.0, 1e6),
            (1e5, 1e6),
            (100.0, 1e6),
        ] {
            let trial = bake(door, "size", &scene(scale, offset));
            close(
                &reference,
                &trial,
                &format!("{door}: size {scale} at {offset}"),
            );
        }
    }
}

#[test]
fn a_scene_lit_by_one_surfel_is_a_scene() {
    let text = scene(1.0, 0.0);
    let (folder, path) = super::program::stage(&text);
    let layer = folder.path().join("out.usda");
    for engine in ["rays", "paper"] {
        let args = [
            "bake",
            &path.to_string_lossy(),
            "-o",
            &layer.to_string_lossy(),
            "--usd",
            "native",
            "--surfels",
            "1",
            "--rays",
            "16",
            "--gather",
            engine,
            "--aov",
            "occlusion,irradiance",
        ]
        .map(str::to_owned);
        let output = super::program::run(&args);
        assert!(
            output.status.success(),
            "{}",
            super::program::stderr(&output)
        );
    }
}
