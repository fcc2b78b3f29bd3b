//! Points of instancers.

use super::*;
use glam::Vec4;

/// usd-core's own numbers for this stage: `ComputeInstanceTransformsAtTime` on a PointInstancer with a prototype
/// at z = 10 below a scope that is itself moved (which must not count).
fn instancer_stage() -> Vec<RawPrim> {
    let instancer = moved(prim("/W/PI", "PointInstancer", Some(0)), 0.0, 1.0, 0.0);
    let instancer = with_ints(instancer, "protoIndices", &[0, 1, 0]);
    let positions = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]].map(Vec3::from_array);
    let scales = [[1.0; 3], [2.0, 3.0, 4.0], [-1.0, 2.0, 1.0]].map(Vec3::from_array);
    // 0.7071 as a half float.
    let half = 0.707_031_25;
    let orientations = [
        [0.0, half, 0.0, half],
        [0.0, 0.0, 0.0, 1.0],
        [0.5, 0.5, 0.5, 0.5],
    ];
    let vectors = |values: [Vec3; 3]| Value::Vec3Array(values.to_vec());
    let instancer = with_attribute(instancer, "positions", vectors(positions), None);
    let instancer = with_attribute(instancer, "scales", vectors(scales), None);
    let orientations = Value::QuatArray(orientations.map(Vec4::from_array).to_vec());
    let mut instancer = with_attribute(instancer, "orientations", orientations, None);
    let targets = vec!["/W/PI/P/A".to_owned(), "/W/PI/P/B".to_owned()];
    instancer.relationships.insert(
        "prototypes".to_owned(),
        RawRelationship {
            targets,
            bind_material_as: None,
        },
    );
    vec![
        moved(prim("/W", "Xform", None), 7.0, 0.0, 0.0),
        instancer,
        moved(prim("/W/PI/P", "Xform", Some(1)), 1000.0, 0.0, 0.0),
        moved(prim("/W/PI/P/A", "Xform", Some(2)), 0.0, 0.0, 10.0),
        under(triangle("/W/PI/P/A/t"), 3),
        under(triangle("/W/PI/P/B"), 2),
    ]
}

#[test]
fn point_instances_stand_where_usd_core_puts_them() {
    let built = build_all(instancer_stage());
    let paths: Vec<_> = built.prims.iter().map(|p| &*p.path).collect();
    assert_eq!(paths, ["/W/PI[0]/A/t", "/W/PI[1]/B", "/W/PI[2]/A/t"]);
    let rows = [
        [
            0.000213623046875,
            0.0,
            0.999786376953125,
            10.99786376953125 + 7.0,
        ],
        [0.0, 1.0, 0.0, 2.0 + 1.0],
        [-0.999786376953125, 0.0, 0.000213623046875, 3.00213623046875],
    ];
    let got = built.prims[0].world_from_object;
    for (r, row) in rows.iter().enumerate() {
        for (c, &value) in row.iter().enumerate() {
            let got = if c < 3 {
                got.matrix3.col(c)[r]
            } else {
                got.translation[r]
            };
            assert!(
                (f64::from(got) - value).abs() < 1e-6,
                "row {r} column {c}: {got}"
            );
        }
    }
    let last = built.prims[2].world_from_object;
    let images = [
        last.matrix3.x_axis,
        last.matrix3.y_axis,
        last.matrix3.z_axis,
    ];
    let expected = [Vec3::NEG_Y, 2.0 * Vec3::Z, Vec3::X];
    for (image, expected) in images.iter().zip(expected) {
        assert!(Vec3::from(*image).distance(expected) < 1e-6);
    }
    assert!(Vec3::from(last.translation).distance(Vec3::new(24.0, 9.0, 9.0)) < 1e-5);
    let single = &built.meshes[built.prims[1].mesh.index()];
    assert_eq!(single.positions[1], Vec3::new(13.0, 6.0, 6.0));
    assert_eq!(
        built.prims[2].source,
        PrimSource::PointInstance {
            instancer: "/W/PI".into(),
            index: 2,
            shared_path: "/W/PI/P/A/t".into()
        }
    );
}

#[test]
fn invisible_ids_hide_points_by_id_or_index() {
    let mut prims = instancer_stage();
    prims[1] = with_ints(prims[1].clone(), "invisibleIds", &[1]);
    assert_eq!(build_all(prims.clone()).prims.len(), 2);
    prims[1] = with_attribute(
        prims[1].clone(),
        "ids",
        Value::Int64Array(vec![1, 5, 1]),
        None,
    );
    let built = build_all(prims);
    assert_eq!(built.prims.len(), 1);
    assert_eq!(&*built.prims[0].path, "/W/PI[1]/B");
}

#[test]
fn flawed_instancers_are_left_out_with_a_warning() {
    let mut prims = instancer_stage();
    prims[1] = with_ints(prims[1].clone(), "protoIndices", &[0, 7, -1]);
    let built = build_all(prims.clone());
    assert_eq!(
        (built.prims.len(), built.warnings),
        (1, vec!["bad-instance".to_owned()])
    );
    prims[1] = with_ints(prims[1].clone(), "protoIndices", &[0, 1]);
    let built = build_all(prims);
    assert_eq!(
        (built.prims.len(), built.warnings),
        (0, vec!["bad-instancer".to_owned()])
    );
}

#[test]
fn nested_instancers_multiply_and_one_in_itself_ends() {
    let points = |prim: RawPrim, target: &str| {
        let positions = vec![Vec3::X, 2.0 * Vec3::X];
        let prim = with_attribute(prim, "positions", Value::Vec3Array(positions), None);
        let mut prim = with_ints(prim, "protoIndices", &[0, 0]);
        let relationship = RawRelationship {
            targets: vec![target.to_owned()],
            bind_material_as: None,
        };
        prim.relationships
            .insert("prototypes".to_owned(), relationship);
        prim
    };
    let outer = points(prim("/o", "PointInstancer", None), "/o/i");
    let inner = points(prim("/o/i", "PointInstancer", Some(0)), "/o/i/t");
    let leaf = under(triangle("/o/i/t"), 1);
    let built = build_all(vec![outer, inner, leaf.clone()]);
    let placed: Vec<_> = built
        .prims
        .iter()
        .map(|p| (&*p.path, p.world_from_object.translation.x))
        .collect();
    let expected = [
        ("/o[0]/i[0]/t", 2.0),
        ("/o[0]/i[1]/t", 3.0),
        ("/o[1]/i[0]/t", 3.0),
        ("/o[1]/i[1]/t", 4.0),
    ];
    assert_eq!(placed, expected);

    let own = points(prim("/o", "PointInstancer", None), "/o");
    let built = build_all(vec![own]);
    assert!(built.prims.is_empty());
    assert_eq!(built.warnings, ["cyclic-instance"]);
}

#[test]
fn instancers_inside_native_instances_find_the_prototypes_of_their_instance() {
    let mut prims = vec![
        prim("/A", "Xform", None),
        moved(prim("/B", "Xform", None), 5.0, 0.0, 0.0),
    ];
    prims[0].prototype = Some(2);
    prims[1].prototype = Some(2);
    prims.push(prim("/__Prototype_1", "Xform", None));
    let instancer = prim("/__Prototype_1/pi", "PointInstancer", Some(2));
    let instancer = with_ints(instancer, "protoIndices", &[0]);
    let positions = Value::Vec3Array(vec![Vec3::Y]);
    let mut instancer = with_attribute(instancer, "positions", positions, None);
    instancer.relationships.insert(
        "prototypes".to_owned(),
        RawRelationship {
            targets: vec!["/__Prototype_1/pi/t".to_owned()],
            bind_material_as: None,
        },
    );
    prims.push(instancer);
    prims.push(under(triangle("/__Prototype_1/pi/t"), 3));
    let built = build(prims, 2);
    let paths: Vec<_> = built.prims.iter().map(|p| &*p.path).collect();
    assert_eq!(paths, ["/A/pi[0]/t", "/B/pi[0]/t"]);
    assert_eq!(built.prims[1].world_from_object.translation.x, 5.0);
}

#[test]
fn a_hundred_thousand_points_take_less_than_a_second() {
    let count = 100_000_u32;
    let mut prims = instancer_stage();
    #[expect(clippy::cast_precision_loss, reason = "below 2^24")]
    let positions = (0..count).map(|i| Vec3::splat(i as f32)).collect();
    prims[1].attributes.remove("scales");
    prims[1].attributes.remove("orientations");
    prims[1] = with_attribute(
        prims[1].clone(),
        "positions",
        Value::Vec3Array(positions),
        None,
    );
    prims[1] = with_ints(prims[1].clone(), "protoIndices", &vec![0; count as usize]);
    let start = std::time::Instant::now();
    let built = build_all(prims);
    let seconds = start.elapsed().as_secs_f64();
    assert_eq!((built.prims.len(), built.meshes.len()), (count as usize, 1));
    assert!(seconds < 1.0, "took {seconds} s");
}
