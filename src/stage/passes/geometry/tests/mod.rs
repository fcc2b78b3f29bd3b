//! What is drawn where, as one mesh or several.

mod instancers;

use super::super::super::raw::{RawAttribute, RawRelationship, Value};
use super::super::flatten::flatten;
use super::*;
use crate::scene::{Interpolation, MaterialId, Normals, Purpose};
use glam::{DQuat, Vec3};

pub(super) fn with_attribute(
    mut prim: RawPrim,
    name: &str,
    value: Value,
    interpolation: Option<&str>,
) -> RawPrim {
    let mut attribute = RawAttribute::from(value);
    attribute.interpolation = interpolation.map(str::to_owned);
    prim.attributes.insert(name.to_owned(), attribute);
    prim
}

pub(super) fn with_ints(prim: RawPrim, name: &str, values: &[i32]) -> RawPrim {
    with_attribute(prim, name, Value::IntArray(values.to_vec()), None)
}

/// A polygon mesh.
pub(super) fn mesh(path: &str, points: &[Vec3], counts: &[i32], indices: &[i32]) -> RawPrim {
    let prim = prim(path, "Mesh", None);
    let prim = with_attribute(prim, "points", Value::Vec3Array(points.to_vec()), None);
    let prim = with_ints(prim, "faceVertexCounts", counts);
    let prim = with_ints(prim, "faceVertexIndices", indices);
    with_token(prim, "subdivisionScheme", "none")
}

pub(super) fn with_token(prim: RawPrim, name: &str, word: &str) -> RawPrim {
    with_attribute(prim, name, Value::Token(word.to_owned()), None)
}

pub(super) fn prim(path: &str, type_name: &str, parent: Option<usize>) -> RawPrim {
    RawPrim::typed(path, type_name, parent)
}

fn under(mut prim: RawPrim, parent: usize) -> RawPrim {
    prim.parent = Some(parent);
    prim
}

fn transformed(prim: RawPrim, matrix: DMat4) -> RawPrim {
    let order = Value::TokenArray(vec!["xformOp:transform".to_owned()]);
    let prim = with_attribute(prim, "xformOpOrder", order, None);
    with_attribute(
        prim,
        "xformOp:transform",
        Value::Matrix(Box::new(matrix)),
        None,
    )
}

pub(super) fn moved(prim: RawPrim, x: f64, y: f64, z: f64) -> RawPrim {
    transformed(prim, DMat4::from_translation(DVec3::new(x, y, z)))
}

fn triangle(path: &str) -> RawPrim {
    mesh(path, &[Vec3::ZERO, Vec3::X, Vec3::Y], &[3], &[0, 1, 2])
}

struct Built {
    meshes: Vec<Mesh>,
    prims: Vec<Prim>,
    origin: DVec3,
    warnings: Vec<String>,
}

fn try_build(raw: &RawStage, look: &Look) -> Result<Built, Error> {
    build_in(raw, look, Detail::Full).map(|(built, _)| built)
}

/// What is made, and the triangles told of it.
fn build_in(raw: &RawStage, look: &Look, detail: Detail) -> Result<(Built, Vec<usize>), Error> {
    let settings = ReadSettings::default();
    let diagnostics = Diagnostics::default();
    let occurrences = flatten(raw, &settings, &diagnostics);
    let layout = lay_out(raw, &occurrences, &settings, &diagnostics)?;
    let (raw, making) = (Lent::Whole(raw), Making::Once(detail));
    let made = layout.build(raw, look, making, &diagnostics)?;
    let warnings = diagnostics.warnings().into_iter().map(|w| w.kind).collect();
    let built = Built {
        meshes: made.meshes,
        prims: made.prims,
        origin: layout.origin(),
        warnings,
    };
    Ok((built, made.triangles))
}

fn build(prims: Vec<RawPrim>, prototype_start: usize) -> Built {
    let raw = RawStage {
        prims,
        prototype_start,
        ..RawStage::default()
    };
    try_build(&raw, &Look::default()).unwrap()
}

fn build_all(prims: Vec<RawPrim>) -> Built {
    let count = prims.len();
    build(prims, count)
}

#[test]
fn cages_tell_how_many_triangles_their_surfaces_have() {
    let corners = [
        Vec3::ZERO,
        Vec3::X,
        Vec3::new(1.0, 1.0, 0.3),
        Vec3::Y,
        Vec3::new(0.5, 0.5, 1.0),
    ];
    let pyramid = |path: &str, counts: &[i32], indices: &[i32], scheme: &str| {
        with_token(
            mesh(path, &corners, counts, indices),
            "subdivisionScheme",
            scheme,
        )
    };
    let sides = [0, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 4];
    let closed = [&sides[..], &[0, 3, 2, 1]].concat();
    let holed = pyramid("/holed", &[3, 3, 3, 3, 4], &closed, "catmullClark");
    let raw = RawStage {
        prims: vec![
            pyramid("/mixed", &[3, 3, 3, 3, 4], &closed, "catmullClark"),
            with_ints(holed, "holeIndices", &[4]),
            pyramid("/loop", &[3; 4], &sides, "loop"),
            pyramid("/bilinear", &[4], &[0, 3, 2, 1], "bilinear"),
            pyramid("/polygons", &[3, 3, 3, 3, 4], &closed, "none"),
        ],
        prototype_start: 5,
        ..RawStage::default()
    };
    let look = Look::default();
    let (full, of_full) = build_in(&raw, &look, Detail::Full).unwrap();
    let (cages, of_cages) = build_in(&raw, &look, Detail::Cages).unwrap();
    let counts = |built: &Built| -> Vec<usize> {
        built
            .meshes
            .iter()
            .map(|mesh| mesh.triangles.len())
            .collect()
    };
    assert_eq!(of_full, counts(&full));
    assert_eq!(of_cages, counts(&full));
    assert_eq!(counts(&cages), [6, 4, 4, 2, 6]);
    let schemes = |built: &Built| -> Vec<String> {
        built
            .meshes
            .iter()
            .map(|mesh| mesh.scheme.clone())
            .collect()
    };
    assert_eq!(schemes(&cages), schemes(&full));
}

#[test]
fn a_mesh_drawn_once_is_in_world_space_and_twice_is_shared() {
    let mut instances: Vec<RawPrim> = (0..2_u8)
        .map(|i| {
            moved(
                prim(&format!("/i{i}"), "Xform", None),
                f64::from(i),
                0.0,
                0.0,
            )
        })
        .collect();
    for instance in &mut instances {
        instance.prototype = Some(3);
    }
    let single = moved(triangle("/single"), 5.0, 0.0, 0.0);
    let prims = [
        instances,
        vec![
            single,
            prim("/__Prototype_1", "Xform", None),
            under(triangle("/__Prototype_1/t"), 3),
        ],
    ];
    let built = build(prims.concat(), 3);
    assert_eq!(built.meshes.len(), 2);
    let paths: Vec<_> = built.prims.iter().map(|p| &*p.path).collect();
    assert_eq!(paths, ["/i0/t", "/i1/t", "/single"]);
    assert_eq!(built.prims[0].mesh, built.prims[1].mesh);
    assert_eq!(built.prims[1].world_from_object.translation.x, 1.0);
    assert_eq!(
        built.meshes[built.prims[0].mesh.index()].positions[0],
        Vec3::ZERO
    );
    assert_eq!(built.prims[2].world_from_object, Affine3A::IDENTITY);
    let world = &built.meshes[built.prims[2].mesh.index()];
    assert_eq!(world.positions[1], Vec3::new(6.0, 0.0, 0.0));
    assert_eq!(built.origin, DVec3::ZERO);
}

#[test]
fn invisible_prims_guides_and_proxies_are_not_drawn() {
    let prims = vec![
        with_token(triangle("/hidden"), "visibility", "invisible"),
        with_token(triangle("/guide"), "purpose", "guide"),
        with_token(triangle("/render"), "purpose", "render"),
        triangle("/plain"),
    ];
    let built = build_all(prims);
    let paths: Vec<_> = built.prims.iter().map(|p| &*p.path).collect();
    assert_eq!(paths, ["/render", "/plain"]);
    assert_eq!(built.prims[0].purpose, Purpose::Render);
}

#[test]
fn mirrored_meshes_keep_their_front_on_the_same_side() {
    let mirror = DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    let prim = with_attribute(
        triangle("/m"),
        "normals",
        Value::Vec3Array(vec![Vec3::Z; 3]),
        None,
    );
    let st = Value::Vec2Array(vec![glam::Vec2::ZERO, glam::Vec2::X, glam::Vec2::Y]);
    let prim = with_attribute(prim, "primvars:st", st, Some("faceVarying"));
    let built = build_all(vec![transformed(prim, mirror)]);
    let mesh = &built.meshes[0];
    assert_eq!(mesh.positions[1], Vec3::NEG_X);
    assert_eq!(mesh.plane_normal(0), Vec3::Z);
    assert_eq!(mesh.shading_normal(0, 0.3, 0.3), Vec3::Z);
    assert_eq!(mesh.triangles[0], [0, 2, 1]);
    let st = mesh.primvar("st").unwrap();
    assert_eq!(st.interpolation, Interpolation::Corner(vec![[0, 2, 1]]));
    assert_eq!(mesh.cage.as_ref().unwrap().point_normals, [Vec3::Z; 3]);
}

#[test]
fn sheared_normals_stay_perpendicular() {
    // x += z: a face in the plane x = 0 leans, its normal becomes (1, 0, −1).
    let shear = DMat4::from_cols(
        DVec3::X.extend(0.0),
        DVec3::Y.extend(0.0),
        DVec3::new(1.0, 0.0, 1.0).extend(0.0),
        glam::DVec4::W,
    );
    let points = [Vec3::ZERO, Vec3::Y, Vec3::Z];
    let prim = mesh("/m", &points, &[3], &[0, 1, 2]);
    let normals = Value::Vec3Array(vec![Vec3::X; 3]);
    let prim = with_attribute(prim, "normals", normals, None);
    let built = build_all(vec![transformed(prim, shear)]);
    let mesh = &built.meshes[0];
    assert!(
        mesh.shading_normal(0, 0.2, 0.2)
            .distance(mesh.plane_normal(0))
            < 1e-6
    );
}

#[test]
fn a_scene_far_from_zero_keeps_its_shape_relative_to_its_origin() {
    let built = build_all(vec![moved(triangle("/m"), 1e6, 0.0, -3e6)]);
    assert!(built.origin.x > 9e5);
    let [a, b, c] = built.meshes[0].corners(0);
    assert_eq!((b - a, c - a), (Vec3::X, Vec3::Y));
    let world = built.origin + a.as_dvec3();
    assert_eq!(world, DVec3::new(1e6, 0.0, -3e6));
}

#[test]
fn subsets_of_the_material_bind_family_give_faces_their_materials() {
    let subset = |path: &str, family: &str, faces: &[i32]| {
        let prim = with_token(prim(path, "GeomSubset", Some(0)), "familyName", family);
        with_ints(prim, "indices", faces)
    };
    let points = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE];
    let indices = [0, 1, 2, 1, 3, 2, 0, 2, 1];
    let raw = RawStage {
        prims: vec![
            mesh("/m", &points, &[3, 3, 3], &indices),
            subset("/m/a", "materialBind", &[1, 99]),
            subset("/m/b", "other", &[2]),
        ],
        prototype_start: 3,
        ..RawStage::default()
    };
    let look = Look {
        binding: vec![
            Some(MaterialId(4)),
            Some(MaterialId(7)),
            Some(MaterialId(9)),
        ],
        ..Look::default()
    };
    let materials = &try_build(&raw, &look).unwrap().prims[0].materials;
    let of_faces = [0, 1, 2].map(|face| materials.of_face(face));
    assert_eq!(of_faces, [4, 7, 4].map(|id| Some(MaterialId(id))));
}

#[test]
fn occurrences_that_inherit_different_primvars_do_not_share_a_mesh() {
    let color = |prim: RawPrim, value: f32| {
        let value = Value::Vec3Array(vec![Vec3::splat(value)]);
        with_attribute(prim, "primvars:displayColor", value, None)
    };
    let mut prims = vec![
        color(prim("/a", "Xform", None), 0.25),
        color(prim("/b", "Xform", None), 0.5),
        prim("/a/i", "Xform", Some(0)),
        prim("/b/i", "Xform", Some(1)),
        prim("/b/j", "Xform", Some(1)),
    ];
    for instance in &mut prims[2..] {
        instance.prototype = Some(5);
    }
    prims.push(prim("/__Prototype_1", "Xform", None));
    prims.push(under(triangle("/__Prototype_1/t"), 5));
    let built = build(prims, 5);
    assert_eq!((built.meshes.len(), built.prims.len()), (2, 3));
    let colors: Vec<_> = built
        .prims
        .iter()
        .map(|p| {
            built.meshes[p.mesh.index()]
                .primvar("displayColor")
                .unwrap()
                .values[0]
                .x
        })
        .collect();
    assert_eq!(colors, [0.25, 0.5, 0.5]);
}

#[test]
fn skinning_is_named_where_a_skeleton_is_bound_with_or_without_the_api() {
    let skeleton = |mut prim: RawPrim| {
        let targets = vec!["/r/skel".to_owned()];
        let relationship = RawRelationship {
            targets,
            bind_material_as: None,
        };
        prim.relationships
            .insert("skel:skeleton".to_owned(), relationship);
        prim
    };
    let inherited = vec![
        skeleton(prim("/r", "SkelRoot", None)),
        prim("/r/g", "Xform", Some(0)),
        under(triangle("/r/g/t"), 1),
    ];
    assert_eq!(
        build_all(inherited.clone()).warnings,
        ["unsupported-skinning"]
    );
    let mut outside = inherited;
    outside[0].type_name = "Xform".to_owned();
    assert!(build_all(outside.clone()).warnings.is_empty());
    outside[2].api_schemas.push("SkelBindingAPI".to_owned());
    assert_eq!(build_all(outside).warnings, ["unsupported-skinning"]);
}

#[test]
fn types_that_cannot_be_drawn_are_named() {
    let built = build_all(vec![
        prim("/fog", "Volume", None),
        prim("/x", "Xform", None),
    ]);
    assert_eq!(built.warnings, ["unsupported-prim"]);
}

#[test]
fn flattening_transforms_are_kept_for_single_meshes_only_if_something_is_left() {
    let flat = DMat4::from_scale(DVec3::new(1.0, 1.0, 0.0));
    let built = build_all(vec![transformed(triangle("/m"), flat)]);
    assert_eq!(built.prims.len(), 1);
    assert_eq!(built.meshes[0].plane_normal(0), Vec3::Z);
}

#[test]
fn equal_gprims_of_like_size_share_a_mesh() {
    let sphere = |path: &str, radius: f64, scale: f64, x: f64| {
        let matrix = DMat4::from_translation(DVec3::X * x) * DMat4::from_scale(DVec3::splat(scale));
        let made = transformed(prim(path, "Sphere", None), matrix);
        with_attribute(made, "radius", Value::Float(radius), None)
    };
    let flat = transformed(
        prim("/flat", "Sphere", None),
        DMat4::from_scale(DVec3::new(1.0, 1.0, 0.0)),
    );
    let built = build_all(vec![
        sphere("/big", 1.0, 1.0, 0.0),
        sphere("/small", 1.0, 0.01, 2.0),
        sphere("/pebble", 0.5, 0.02, 3.0),
        sphere("/again", 1.0, 0.02, 4.0),
        sphere("/big2", 1.0, 0.95, 6.0),
        flat,
    ]);
    let of: Vec<_> = built.prims.iter().map(|p| p.mesh.index()).collect();
    assert_eq!(of, [0, 1, 2, 1, 0, 3]);
    let triangles: Vec<_> = built.meshes.iter().map(|m| m.triangles.len()).collect();
    // 100 around and 50 from pole to pole; 32 and 16 for those of a hundredth of the scene.
    assert_eq!(triangles[..3], [9_800, 960, 960]);
    assert!(built.warnings.is_empty(), "{:?}", built.warnings);
    let again = &built.prims[3].world_from_object;
    assert_eq!(again.transform_point3(Vec3::X), Vec3::new(4.02, 0.0, 0.0));
}

#[test]
fn the_first_bad_mesh_in_stage_order_is_reported() {
    let bad = |path: &str| mesh(path, &[Vec3::ZERO], &[3], &[0, 1, 2]);
    let raw = RawStage {
        prims: vec![triangle("/ok"), bad("/bad1"), bad("/bad2")],
        prototype_start: 3,
        ..RawStage::default()
    };
    let error = try_build(&raw, &Look::default()).err().unwrap();
    assert!(error.to_string().starts_with("mesh /bad1: "));
}

#[test]
fn an_empty_stage_gives_an_empty_scene() {
    let built = build_all(Vec::new());
    assert!(built.meshes.is_empty() && built.prims.is_empty());
    assert_eq!(built.origin, DVec3::ZERO);
}

#[test]
fn a_sphere_and_a_quaternion_turn_meet_in_world_space() {
    let turn = DMat4::from_quat(DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2));
    let cone = transformed(prim("/c", "Cone", None), turn);
    let built = build_all(vec![cone]);
    assert!(matches!(built.meshes[0].normals, Normals::Vertex(_)));
    let tip = built.meshes[0]
        .positions
        .iter()
        .map(|p| p.y)
        .fold(f32::MAX, f32::min);
    assert!((tip + 1.0).abs() < 1e-6, "{tip}");
}
