//! Material and textures at a point of a surface: albedo and emission, averaged over a footprint.

pub mod gloss;
mod material;
mod screens;
mod textures;

use crate::diagnostics::Diagnostics;
use crate::scene::{Light, LightGroup, MaterialId, Prim, PrimId, Scene};
use crate::trace::Opacity;
use glam::Vec3;
use gloss::{Gloss, Lobe};
use material::Compiled;
use screens::Screens;
pub use screens::may_be_screen;
use std::path::Path;
use std::sync::Arc;
use textures::{Reads, Textures};

/// Albedo of surfaces that have neither a material nor `displayColor`: UsdPreviewSurface's default.
const NEUTRAL: Vec3 = Vec3::splat(0.18);

/// A point on a prim's triangle, with the size of the area it stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// The prim.
    pub prim: PrimId,
    /// Triangle of the prim's mesh.
    pub triangle: u32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2.
    pub v: f32,
    /// Edge length, in world units, of the square to average textures over; 0 = point-sampled at full resolution.
    pub footprint: f32,
}

/// What a surface does with light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Diffuse albedo of what there is of it, clamped to 0…1: `diffuseColor · (1 − metallic)` (all of it in the specular
    /// workflow).
    pub albedo: Vec3,
    /// Radiance that what there is of it emits from the front side, ≥ 0, finite.
    pub emission: Vec3,
    /// How much of it there is: the part of what falls on it that does not pass, 0…1. With a cut-out threshold: 0 or 1 at a
    /// point, the covered fraction over a footprint. Where it is 0 the rest is black.
    pub opacity: f32,
}

/// Evaluates materials of a scene; textures are decoded once.
#[derive(Debug)]
pub struct Shader<'a> {
    scene: &'a Scene,
    textures: Arc<Textures>,
    /// By [`MaterialId`]; `None` for materials on no prim of the scene.
    materials: Arc<[Option<Compiled<'a>>]>,
    /// What light passes through; `None` where nothing is.
    screens: Option<Arc<Screens>>,
    /// Only its sources shine; `None` = all do.
    group: Option<&'a LightGroup>,
}

impl<'a> Shader<'a> {
    /// Decode the textures that diffuse surfaces and emission of the scene's prims read. Missing or broken files become
    /// warnings naming file and material, and their reads give the fallback value.
    pub fn new(scene: &'a Scene, diagnostics: &Diagnostics) -> Self {
        Self::with_textures(scene, Reads::Diffuse, diagnostics)
    }

    /// The same, and the textures that [`Self::gloss`] reads; without them these give their fallbacks.
    pub fn glossy(scene: &'a Scene, diagnostics: &Diagnostics) -> Self {
        Self::with_textures(scene, Reads::Gloss, diagnostics)
    }

    /// The same for who asks for nothing but [`Self::opacity`]: other textures are not decoded and give their fallbacks.
    pub fn of_opacity(scene: &'a Scene, diagnostics: &Diagnostics) -> Self {
        Self::with_textures(scene, Reads::Opacity, diagnostics)
    }

    fn with_textures(scene: &'a Scene, reads: Reads, diagnostics: &Diagnostics) -> Self {
        let used = materials_in_use(scene);
        let in_use = || {
            let materials = scene.materials.iter().zip(&used);
            materials
                .filter(|(_, used)| **used)
                .map(|(material, _)| material)
        };
        let textures = Textures::load(in_use(), reads, diagnostics);
        let materials = scene.materials.iter().zip(&used);
        let materials =
            materials.map(|(material, used)| used.then(|| Compiled::new(material, &textures)));
        let materials = materials.collect();
        let textures = Arc::new(textures);
        Self {
            scene,
            materials,
            screens: Screens::of(scene, &textures).map(Arc::new),
            textures,
            group: None,
        }
    }

    /// How much surfaces stop of what falls on them, for [`crate::trace::Tracer::among`]; `None` if all of it everywhere.
    pub fn opacity(&self) -> Option<Arc<dyn Opacity>> {
        let screens = self.screens.as_ref().map(Arc::clone);
        screens.map(|screens| screens as Arc<dyn Opacity>)
    }

    /// The same materials and textures where only the sources of `group` shine.
    #[must_use]
    pub fn of_group(&self, group: &'a LightGroup) -> Self {
        Self {
            scene: self.scene,
            textures: Arc::clone(&self.textures),
            materials: Arc::clone(&self.materials),
            screens: self.screens.clone(),
            group: Some(group),
        }
    }

    /// The lights that shine: those of the group if this is one's, else all of the scene.
    pub fn lights(&self) -> impl Iterator<Item = &'a Light> {
        let group = self.group;
        let shines = move |i: usize| group.is_none_or(|group| group.lights[i]);
        let lights = self.scene.lights.iter().enumerate();
        lights
            .filter(move |(i, _)| shines(*i))
            .map(|(_, light)| light)
    }

    /// True if the emission of `prim` counts.
    fn shines(&self, prim: PrimId) -> bool {
        self.group.is_none_or(|group| group.has_prim(prim))
    }

    /// What reflects glossily at `point`. Prims without material: what UsdPreviewSurface does by default.
    pub fn gloss(&self, point: &SurfacePoint) -> Gloss {
        let prim = &self.scene.prims[point.prim.index()];
        match self.material_at(prim, point.triangle) {
            Some(material) => material.gloss(&self.textures, self.scene.mesh_of(prim), prim, point),
            None => Gloss {
                base: Lobe::new(material::reflectance(1.5), Vec3::ONE, 0.5),
                coat: Lobe::NONE,
            },
        }
    }

    /// Files of the textures that were decoded.
    pub fn images(&self) -> impl Iterator<Item = &Path> {
        self.textures.files()
    }

    /// The scene it shades.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// The surface at `point`. Prims without material: `displayColor` and `displayOpacity`, else 0.18 gray.
    pub fn surface(&self, point: &SurfacePoint) -> Surface {
        let prim = &self.scene.prims[point.prim.index()];
        let Some(material) = self.material_at(prim, point.triangle) else {
            return self.unbound(prim, point);
        };
        let surface = material.surface(&self.textures, self.scene.mesh_of(prim), prim, point);
        match self.shines(point.prim) {
            true => surface,
            false => Surface {
                emission: Vec3::ZERO,
                ..surface
            },
        }
    }

    /// True if triangle `triangle` of `prim` may emit (its material's emission is not constantly black).
    pub fn may_emit(&self, prim: PrimId, triangle: u32) -> bool {
        if !self.shines(prim) {
            return false;
        }
        let prim = &self.scene.prims[prim.index()];
        self.material_at(prim, triangle)
            .is_some_and(Compiled::may_emit)
    }

    fn material_at(&self, prim: &Prim, triangle: u32) -> Option<&Compiled<'a>> {
        let face = self.scene.mesh_of(prim).triangle_faces[triangle as usize];
        let material = prim.materials.of_face(face)?;
        self.materials[material.index()].as_ref()
    }

    fn unbound(&self, prim: &Prim, point: &SurfacePoint) -> Surface {
        let mesh = self.scene.mesh_of(prim);
        let primvar = |name: &str| {
            let primvar = mesh.primvar(name)?;
            Some(primvar.sample(mesh, point.triangle as usize, point.u, point.v))
        };
        let color = primvar("displayColor").map_or(NEUTRAL, glam::Vec4::truncate);
        let opacity = clamped(primvar("displayOpacity").map_or(1.0, |opacity| opacity.x));
        let albedo = match opacity > 0.0 {
            true => Vec3::from_array(color.to_array().map(clamped)),
            false => Vec3::ZERO,
        };
        Surface {
            albedo,
            emission: Vec3::ZERO,
            opacity,
        }
    }
}

/// To 0…1; NaN is 0.
fn clamped(value: f32) -> f32 {
    if value.is_nan() {
        0.0
    } else {
        value.clamp(0.0, 1.0)
    }
}

/// Which materials some prim has on some face.
fn materials_in_use(scene: &Scene) -> Vec<bool> {
    use crate::scene::FaceMaterials;
    let mut used = vec![false; scene.materials.len()];
    let mut mark = |material: &Option<MaterialId>| {
        if let Some(id) = material {
            used[id.index()] = true;
        }
    };
    for prim in &scene.prims {
        match &prim.materials {
            FaceMaterials::Whole(material) => mark(material),
            FaceMaterials::PerFace(materials) => materials.iter().for_each(&mut mark),
        }
    }
    used
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::material::UvSource;
    use crate::scene::{
        ColorSpace, FaceMaterials, Input, Interpolation, Material, Mesh, MeshId, Normals,
        PrimSource, Primvar, Purpose, StageInfo, TextureRead, UpAxis, Wrap,
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
}
