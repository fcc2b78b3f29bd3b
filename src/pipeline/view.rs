//! What a render shows: which camera, how many pixels, which AOVs, which file.

use super::Error;
use super::job::RenderJob;
use crate::diagnostics::Diagnostics;
use crate::receivers::camera::framing_camera;
use crate::receivers::lens::{ConformPolicy, Frame};
use crate::results::Aov;
use crate::scene::{Camera, RenderProduct, RenderSettings, Scene};
use std::path::{Path, PathBuf};

/// Pixels across when neither the command line nor the stage says: usdrecord's.
const DEFAULT_WIDTH: u32 = 960;

/// Most pixels down: an aperture as thin as a line must not fill the memory.
const MOST_HEIGHT: u32 = 65_536;

/// One image to render.
#[derive(Debug)]
pub(super) struct View {
    /// The camera.
    pub camera: Camera,
    /// Pixels.
    pub frame: Frame,
    /// In order; not empty.
    pub aovs: Vec<Aov>,
    /// File name, with `####` for the frame.
    pub output: PathBuf,
}

/// The images that `job` asks for on `scene`: one as `--output` names, or one for each render product of the stage.
pub(super) fn views(
    job: &RenderJob,
    scene: &Scene,
    diagnostics: &Diagnostics,
) -> Result<Vec<View>, Error> {
    let settings = scene.render_settings.first();
    let products: Vec<&RenderProduct> = settings
        .iter()
        .flat_map(|settings| &settings.products)
        .filter(|product| is_raster(product, diagnostics))
        .collect();
    if let Some(output) = &job.output.path {
        let product = products.first().copied();
        return Ok(vec![view(
            job,
            (scene, settings, product),
            output.clone(),
            diagnostics,
        )?]);
    }
    if products.is_empty() {
        return Err(Error::NoProduct);
    }
    products
        .into_iter()
        .map(|product| {
            view(
                job,
                (scene, settings, Some(product)),
                PathBuf::from(&product.name),
                diagnostics,
            )
        })
        .collect()
}

fn is_raster(product: &RenderProduct, diagnostics: &Diagnostics) -> bool {
    let raster = product.product_type.is_empty() || product.product_type == "raster";
    if !raster {
        let message = format!(
            "productType {} cannot be written: the product is left out",
            product.product_type
        );
        diagnostics.warn("unsupported-render-product", &product.path, message);
    }
    raster
}

fn view(
    job: &RenderJob,
    (scene, settings, product): (&Scene, Option<&RenderSettings>, Option<&RenderProduct>),
    output: PathBuf,
    diagnostics: &Diagnostics,
) -> Result<View, Error> {
    let wanted = job
        .camera
        .as_deref()
        .or_else(|| product?.camera.as_deref())
        .or_else(|| settings?.camera.as_deref());
    let camera = camera(scene, wanted)?;
    let frame = frame(job, &camera, settings, product);
    let aovs = if job.gather.aovs.is_empty() {
        product_aovs(product, diagnostics)
    } else {
        job.gather.aovs.clone()
    };
    Ok(View {
        camera,
        frame,
        aovs,
        output: with_extension(&output),
    })
}

fn with_extension(output: &Path) -> PathBuf {
    if output
        .extension()
        .is_some_and(|extension| extension == "exr")
    {
        output.to_path_buf()
    } else {
        let mut name = output.as_os_str().to_owned();
        name.push(".exr");
        PathBuf::from(name)
    }
}

/// The camera called `wanted` (path or name), else `main_cam` as usdrecord has it, else the stage's first, else an
/// automatic one.
pub(super) fn camera(scene: &Scene, wanted: Option<&str>) -> Result<Camera, Error> {
    let named = |name: &str| {
        scene
            .cameras
            .iter()
            .find(|camera| camera.path == name || camera.path.rsplit('/').next() == Some(name))
    };
    match wanted {
        Some(name) => named(name).cloned().ok_or_else(|| Error::NoCamera {
            name: name.to_owned(),
            known: if scene.cameras.is_empty() {
                "none".to_owned()
            } else {
                scene
                    .cameras
                    .iter()
                    .map(|camera| camera.path.as_str())
                    .collect::<Vec<_>>()
                    .join(" ")
            },
        }),
        None => Ok(named("main_cam")
            .or_else(|| scene.cameras.first())
            .cloned()
            .unwrap_or_else(|| framing_camera(scene))),
    }
}

fn frame(
    job: &RenderJob,
    camera: &Camera,
    settings: Option<&RenderSettings>,
    product: Option<&RenderProduct>,
) -> Frame {
    let resolution = product
        .map(|product| product.resolution)
        .or_else(|| settings.map(|settings| settings.resolution));
    let conform_policy = product
        .and_then(|product| ConformPolicy::from_token(&product.aspect_ratio_conform_policy))
        .unwrap_or_default();
    let aspect = match resolution {
        Some((width, height)) if width > 0 && height > 0 => f64::from(height) / f64::from(width),
        _ if camera.horizontal_aperture > 0.0 && camera.vertical_aperture > 0.0 => {
            camera.vertical_aperture / camera.horizontal_aperture
        }
        _ => 1.0,
    };
    let width = job
        .image_width
        .or(resolution
            .map(|(width, _)| width)
            .filter(|width| *width > 0))
        .unwrap_or(DEFAULT_WIDTH);
    let height = (f64::from(width) * aspect)
        .round()
        .clamp(1.0, f64::from(MOST_HEIGHT));
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 1…65536"
    )]
    let height = height as u32;
    Frame {
        pixel_aspect_ratio: product.map_or(1.0, |product| f64::from(product.pixel_aspect_ratio)),
        conform_policy,
        ..Frame::new(width, height)
    }
}

/// AOVs of `product`'s render vars, by AOV name or source name; `color` when there are none.
fn product_aovs(product: Option<&RenderProduct>, diagnostics: &Diagnostics) -> Vec<Aov> {
    let mut aovs = Vec::new();
    for var in product.iter().flat_map(|product| &product.vars) {
        match known(&var.name).or_else(|| known(&var.source_name)) {
            Some(aov) if !aovs.contains(&aov) => aovs.push(aov),
            Some(_) => {}
            None => diagnostics.warn(
                "unsupported-render-var",
                product.map_or("", |product| product.path.as_str()),
                format!(
                    "render var {} ({} {}) is not computed: it is left out",
                    var.name, var.source_type, var.source_name
                ),
            ),
        }
    }
    if aovs.is_empty() {
        vec![Aov::Color]
    } else {
        aovs
    }
}

/// The AOV of that name, in our, Hydra's or other renderers' words.
fn known(name: &str) -> Option<Aov> {
    let ours = match name {
        "Ci" | "C" | "RGBA" | "rgba" | "beauty" | "Combined" => "color",
        "normal" | "Nn" => "N",
        "Z" | "cameraDepth" => "depth",
        other => other,
    };
    ours.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn render_vars_are_known_by_hydras_and_renderers_names() {
        assert_eq!(known("Ci"), Some(Aov::Color));
        assert_eq!(known("normal"), Some(Aov::Normal));
        assert_eq!(known("diffuse_indirect"), Some(Aov::DiffuseIndirect));
        assert_eq!(known("sss"), None);
    }

    #[test]
    fn a_product_name_without_extension_gets_one() {
        assert_eq!(
            with_extension(Path::new("a/beauty.v1")),
            Path::new("a/beauty.v1.exr")
        );
        assert_eq!(with_extension(Path::new("a/b.exr")), Path::new("a/b.exr"));
    }
}
