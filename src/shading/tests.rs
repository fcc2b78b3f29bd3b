use super::*;
use crate::scene::material::UvSource;
use crate::scene::{
    ColorSpace, FaceMaterials, Input, Interpolation, Material, Mesh, MeshId, Normals, PrimSource,
    Primvar, Purpose, StageInfo, TextureRead, UpAxis, Wrap,
};
use glam::{Affine2, Affine3A, DVec3, Mat3, Vec2, Vec4};
use std::path::PathBuf;

/// A square of side 2 in the XY plane, st from (0, 0) to (1, 1), displayColor as given.
fn square(display_color: Option<Vec4>) -> Mesh {
    let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    let st = corners.map(|(s, t)| Vec4::new(s, t, 0.0, 0.0)).to_vec();
    let st = Primvar {
        name: "st".to_owned(),
        components: 2,
        interpolation: Interpolation::Vertex,
        values: st,
    };
    let color = display_color.map(|color| Primvar {
        name: "displayColor".to_owned(),
        components: 3,
        interpolation: Interpolation::Constant,
        values: vec![color],
    });
    Mesh {
        positions: corners
            .map(|(x, y)| Vec3::new(2.0 * x, 2.0 * y, 0.0))
            .to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        triangle_faces: vec![0, 1],
        normals: Normals::Flat,
        primvars: [st].into_iter().chain(color).collect(),
        double_sided: false,
        closed: false,
        cage: None,
        scheme: "none".to_owned(),
    }
}

fn scene(mesh: Mesh, materials: Vec<Material>, of_faces: FaceMaterials) -> Scene {
    Scene {
        stage: StageInfo {
            path: PathBuf::new(),
            up_axis: UpAxis::Y,
            meters_per_unit: 0.01,
            default_prim: None,
            time_range: None,
            time_codes_per_second: 24.0,
            time: None,
            layers: Vec::new(),
            variants: Vec::new(),
            reader: String::new(),
        },
        origin: DVec3::ZERO,
        meshes: vec![mesh],
        prims: vec![Prim {
            path: "/square".into(),
            mesh: MeshId(0),
            world_from_object: Affine3A::IDENTITY,
            materials: of_faces,
            purpose: Purpose::Default,
            source: PrimSource::Direct,
        }],
        materials,
        lights: Vec::new(),
        cameras: Vec::new(),
        render_settings: Vec::new(),
    }
}

fn with_material(material: Material) -> Scene {
    scene(
        square(None),
        vec![material],
        FaceMaterials::Whole(Some(MaterialId(0))),
    )
}

fn read(file: &Path) -> TextureRead {
    TextureRead {
        file: file.to_owned(),
        shader: "/M/T".to_owned(),
        uv: UvSource {
            primvar: "st".to_owned(),
            fallback: Vec2::ZERO,
            transform: Affine2::IDENTITY,
        },
        wrap_s: Wrap::Repeat,
        wrap_t: Wrap::Repeat,
        scale: Vec4::ONE,
        bias: Vec4::ZERO,
        fallback: Vec4::new(0.25, 0.5, 0.75, 1.0),
        color_space: ColorSpace::Raw,
        channel: None,
    }
}

fn textured(read: TextureRead) -> Input {
    Input::Texture(Box::new(read))
}

/// The point at (x, y) of the first triangle of the square, world units before its transform.
fn point(x: f32, y: f32, footprint: f32) -> SurfacePoint {
    SurfacePoint {
        prim: PrimId(0),
        triangle: 0,
        u: (x - y) / 2.0,
        v: y / 2.0,
        footprint,
    }
}

fn at(scene: &Scene, point: SurfacePoint) -> Surface {
    Shader::new(scene, &Diagnostics::default()).surface(&point)
}

#[test]
fn unbound_prims_have_their_display_color_or_neutral_gray() {
    let bare = scene(square(None), Vec::new(), FaceMaterials::Whole(None));
    let neutral = Surface {
        albedo: NEUTRAL,
        emission: Vec3::ZERO,
        opacity: 1.0,
    };
    assert_eq!(at(&bare, point(1.0, 0.5, 0.0)), neutral);
    let color = Some(Vec4::new(0.5, 2.0, f32::NAN, 1.0));
    let colored = scene(square(color), Vec::new(), FaceMaterials::Whole(None));
    assert_eq!(
        at(&colored, point(1.0, 0.5, 0.0)).albedo,
        Vec3::new(0.5, 1.0, 0.0)
    );
}

#[test]
fn albedo_loses_what_is_metallic_and_is_of_what_is_not_transparent() {
    let material = Material {
        diffuse_color: Input::color(0.8, 0.4, 2.0),
        metallic: Input::scalar(0.5),
        opacity: Input::scalar(0.5),
        emissive_color: Input::color(4.0, -1.0, f32::NAN),
        ..Material::default()
    };
    let surface = at(&with_material(material.clone()), point(1.0, 0.5, 0.0));
    assert_eq!(surface.albedo, Vec3::new(0.4, 0.2, 0.5));
    assert_eq!(
        (surface.emission, surface.opacity),
        (Vec3::new(4.0, 0.0, 0.0), 0.5)
    );
    let specular = Material {
        specular_workflow: true,
        ..material
    };
    let surface = at(&with_material(specular), point(1.0, 0.5, 0.0));
    assert_eq!(surface.albedo, Vec3::new(0.8, 0.4, 1.0));
}

#[test]
fn cut_outs_are_holes_or_opaque_and_a_fraction_over_a_footprint() {
    let cutout = |opacity: Input| {
        let threshold = Input::scalar(0.5);
        with_material(Material {
            opacity,
            opacity_threshold: threshold,
            ..Material::default()
        })
    };
    assert_eq!(
        at(&cutout(Input::scalar(0.49)), point(1.0, 0.5, 0.0)).opacity,
        0.0
    );
    assert_eq!(
        at(&cutout(Input::scalar(0.5)), point(1.0, 0.5, 0.0)).opacity,
        1.0
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("quarter.png");
    // Opaque in the left quarter only: the mean, a quarter, is below the threshold.
    image::GrayImage::from_fn(64, 64, |x, _| image::Luma([if x < 16 { 255 } else { 0 }]))
        .save(&path)
        .unwrap();
    let leaf = cutout(textured(TextureRead {
        channel: Some(0),
        ..read(&path)
    }));
    assert_eq!(at(&leaf, point(0.3, 0.1, 0.0)).opacity, 1.0);
    assert_eq!(at(&leaf, point(1.5, 0.1, 0.0)).opacity, 0.0);
    let covered = at(&leaf, point(1.0, 0.99, 2.0)).opacity;
    assert!((covered - 0.25).abs() < 0.01, "{covered}");
}

/// A texture whose value is its s, smoothly up and down again.
fn wave(folder: &Path) -> PathBuf {
    let path = folder.join("wave.exr");
    let value = |x: usize, y: usize| {
        let angle = |i: usize| (i as f32 + 0.5) / 128.0 * std::f32::consts::TAU;
        0.5 + 0.3 * angle(x).sin() + 0.15 * (2.0 * angle(y)).cos()
    };
    exr::prelude::write_rgb_file(&path, 128, 128, |x, y| (value(x, y), 0.0, 0.0)).unwrap();
    path
}

#[test]
fn footprints_average_as_many_point_samples_over_the_square_do() {
    let folder = tempfile::tempdir().unwrap();
    let scene = with_material(Material {
        diffuse_color: textured(read(&wave(folder.path()))),
        ..Material::default()
    });
    let shader = Shader::new(&scene, &Diagnostics::default());
    for footprint in [0.1, 0.3, 0.6] {
        for (x, y) in [(1.0, 0.5), (1.4, 0.9), (1.5, 0.4)] {
            let count = 32;
            let offset = |i: usize| ((i as f32 + 0.5) / count as f32 - 0.5) * footprint;
            let samples = (0..count * count).map(|i| {
                let sample = point(x + offset(i % count), y + offset(i / count), 0.0);
                shader.surface(&sample).albedo.x
            });
            let expected = samples.sum::<f32>() / (count * count) as f32;
            let found = shader.surface(&point(x, y, footprint)).albedo.x;
            // Texels of a level lie on a fixed grid: a fiftieth of the waves' height (0.9) at most.
            assert!(
                (found - expected).abs() < 0.018,
                "{footprint} {x} {y}: {found} {expected}"
            );
        }
    }
}

#[test]
fn footprints_are_lengths_in_the_world_not_on_the_object() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = with_material(Material {
        diffuse_color: textured(read(&wave(folder.path()))),
        ..Material::default()
    });
    let expected = at(&scene, point(1.3, 0.6, 0.5)).albedo;
    let turned = Mat3::from_rotation_x(1.0) * 8.0;
    scene.prims[0].world_from_object = Affine3A::from_mat3(turned);
    let found = at(&scene, point(1.3, 0.6, 4.0)).albedo;
    assert!(found.distance(expected) < 1e-4, "{found} {expected}");
    assert!(found.distance(at(&scene, point(1.3, 0.6, 0.5)).albedo) > 1e-3);
}

#[test]
fn texture_values_are_scaled_and_channels_picked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flat.png");
    image::RgbaImage::from_pixel(2, 2, image::Rgba([51, 102, 153, 204]))
        .save(&path)
        .unwrap();
    let scaled = TextureRead {
        scale: Vec4::splat(0.5),
        bias: Vec4::splat(0.1),
        ..read(&path)
    };
    let green = TextureRead {
        channel: Some(1),
        ..scaled.clone()
    };
    let moved = Affine2::from_translation(Vec2::new(5.0, 0.0));
    let mut outside = TextureRead {
        wrap_s: Wrap::Black,
        ..scaled.clone()
    };
    outside.uv.transform = moved;
    let cases = [
        (scaled, Vec3::new(0.2, 0.3, 0.4)),
        (green, Vec3::splat(0.3)),
        (outside, Vec3::splat(0.1)),
    ];
    for (read, expected) in cases {
        let scene = with_material(Material {
            diffuse_color: textured(read),
            ..Material::default()
        });
        let found = at(&scene, point(1.0, 0.5, 0.0)).albedo;
        assert!(found.distance(expected) < 1e-5, "{found} {expected}");
    }
}

#[test]
fn missing_textures_give_their_fallback_and_name_file_and_material() {
    let material = Material {
        path: "/Looks/M".to_owned(),
        diffuse_color: textured(read(Path::new("/nowhere/wood.png"))),
        ..Material::default()
    };
    let scene = with_material(material);
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(&scene, &diagnostics);
    let albedo = shader.surface(&point(1.0, 0.5, 0.1)).albedo;
    assert_eq!(albedo, Vec3::new(0.25, 0.5, 0.75));
    let warnings = diagnostics.warnings();
    assert_eq!(warnings.len(), 1);
    assert_eq!(warnings[0].prim, "/Looks/M");
    assert!(
        warnings[0].message.contains("/nowhere/wood.png"),
        "{}",
        warnings[0].message
    );
}

#[test]
fn textures_of_unused_materials_are_not_opened() {
    let unused = Material {
        diffuse_color: textured(read(Path::new("/nowhere/a.png"))),
        ..Material::default()
    };
    let scene = scene(square(None), vec![unused], FaceMaterials::Whole(None));
    let diagnostics = Diagnostics::default();
    Shader::new(&scene, &diagnostics);
    assert!(diagnostics.warnings().is_empty());
}

#[test]
fn primvars_feed_inputs_and_faces_have_their_own_materials() {
    let glow = Input::Primvar {
        name: "displayColor".to_owned(),
        fallback: Vec4::ONE,
    };
    let missing = Input::Primvar {
        name: "none".to_owned(),
        fallback: Vec4::splat(0.7),
    };
    let materials = vec![
        Material {
            emissive_color: glow,
            diffuse_color: missing,
            ..Material::default()
        },
        Material::default(),
    ];
    let faces = FaceMaterials::PerFace([Some(MaterialId(0)), Some(MaterialId(1))].into());
    let scene = scene(
        square(Some(Vec4::new(3.0, 2.0, 1.0, 1.0))),
        materials,
        faces,
    );
    let shader = Shader::new(&scene, &Diagnostics::default());
    let first = shader.surface(&point(1.0, 0.5, 0.0));
    assert_eq!(
        (first.emission, first.albedo),
        (Vec3::new(3.0, 2.0, 1.0), Vec3::splat(0.7))
    );
    assert!(shader.may_emit(PrimId(0), 0) && !shader.may_emit(PrimId(0), 1));
    let second = shader.surface(&SurfacePoint {
        triangle: 1,
        ..point(1.0, 0.5, 0.0)
    });
    assert_eq!((second.emission, second.albedo), (Vec3::ZERO, NEUTRAL));
}

#[test]
fn triangles_without_area_are_point_sampled() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = with_material(Material {
        diffuse_color: textured(read(&wave(folder.path()))),
        ..Material::default()
    });
    scene.meshes[0].positions = vec![Vec3::ONE; 4];
    let (sharp, wide) = (
        at(&scene, point(1.0, 0.5, 0.0)),
        at(&scene, point(1.0, 0.5, 1.0)),
    );
    assert_eq!(sharp, wide);
    assert!(sharp.albedo.is_finite());
}
