//! AOVs → OpenEXR, laid out as compositors and Blender read it without help.
//!
//! One part by default: `color` as bare `R G B A`, every other AOV as `NAME.R/G/B`, `NAME.X/Y/Z`, `NAME.Y`, `depth.Z`
//! or `primId.id`; colors in half precision, the rest in 32 bits, ZIP. Several parts (one an AOV, named like it) on
//! request. The same pixels and settings make the same bytes.

use super::exr_header::sort_attributes;
use super::{Error, write_whole};
use crate::results::{Aov, AovImage, ValueType, name_of_group};
use ::exr::meta::attribute::{AttributeValue, Chromaticities, IntegerBounds, LineOrder, Text};
use ::exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, ImageAttributes,
    Layer, LayerAttributes, Vec2, WritableImage,
};
use glam::DMat4;
use half::f16;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

/// How AOVs are spread over the parts of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ExrLayout {
    /// All in one part: what every program shows.
    #[default]
    SinglePart,
    /// A part an AOV, each with its own `colorInteropID`.
    MultiPart,
}

/// What the header says besides the pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct ExrInfo {
    /// Width over height of one pixel.
    pub pixel_aspect_ratio: f32,
    /// World to camera space (USD's: right-handed, looking along −Z), column vectors as everywhere in this crate.
    pub world_to_camera: Option<DMat4>,
    /// World to (0, 0) upper left … (1, 1) lower right of the image.
    pub world_to_ndc: Option<DMat4>,
    /// Near and far clipping distances, stage units.
    pub clipping_range: Option<(f64, f64)>,
    /// For an image of a sequence.
    pub frames_per_second: Option<f64>,
    /// Program and version.
    pub software: String,
    /// More, by name: `usd/stage`, `surflux/command`, …
    pub texts: BTreeMap<String, String>,
}

impl Default for ExrInfo {
    fn default() -> Self {
        Self {
            pixel_aspect_ratio: 1.0,
            world_to_camera: None,
            world_to_ndc: None,
            clipping_range: None,
            frames_per_second: None,
            software: concat!("surflux ", env!("CARGO_PKG_VERSION")).to_owned(),
            texts: BTreeMap::new(),
        }
    }
}

/// Write `images` (at least one, all of one size) as `path`, under a temporary name first.
///
/// # Errors
/// If they cannot be encoded or the file cannot be written; nothing is left behind then.
pub fn write_exr(
    path: &Path,
    images: &[AovImage],
    info: &ExrInfo,
    layout: ExrLayout,
) -> Result<(), Error> {
    let size = common_size(path, images)?;
    let layers = match layout {
        ExrLayout::SinglePart => {
            let channels = images.iter().flat_map(channels).collect();
            vec![layer(
                size,
                layer_attributes(info, "lin_rec709_scene", None),
                channels,
            )]
        }
        ExrLayout::MultiPart => {
            let part = |image: &AovImage| {
                let name = Some(image.name());
                layer(
                    size,
                    layer_attributes(info, interop_id(image.aov), name.as_deref()),
                    channels(image),
                )
            };
            images.iter().map(part).collect()
        }
    };
    let mut bytes = Cursor::new(Vec::new());
    let image = Image::from_layers(image_attributes(size, info), layers);
    image
        .write()
        .to_buffered(&mut bytes)
        .map_err(|source| Error::Exr {
            path: path.to_owned(),
            source,
        })?;
    let mut bytes = bytes.into_inner();
    sort_attributes(&mut bytes);
    write_whole(path, &bytes)
}

fn common_size(path: &Path, images: &[AovImage]) -> Result<Vec2<usize>, Error> {
    let unsuitable = |problem: &str| Error::Unsuitable {
        path: path.to_owned(),
        problem: problem.to_owned(),
    };
    let first = images
        .first()
        .ok_or_else(|| unsuitable("no AOV to write, at least one is needed"))?;
    let size = (first.width, first.height);
    if images
        .iter()
        .any(|image| (image.width, image.height) != size)
    {
        return Err(unsuitable(
            "AOVs differ in size, those of one file must be equal",
        ));
    }
    if size.0 == 0 || size.1 == 0 {
        return Err(unsuitable(
            "the image has no pixels, width and height must be 1 or more",
        ));
    }
    Ok(Vec2(size.0 as usize, size.1 as usize))
}

fn layer(
    size: Vec2<usize>,
    attributes: LayerAttributes,
    channels: Vec<AnyChannel<FlatSamples>>,
) -> Layer<AnyChannels<FlatSamples>> {
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        // Any other order would be that in which threads finish.
        line_order: LineOrder::Increasing,
    };
    Layer::new(
        size,
        attributes,
        encoding,
        AnyChannels::sort(channels.into()),
    )
}

fn image_attributes(size: Vec2<usize>, info: &ExrInfo) -> ImageAttributes {
    let mut attributes = ImageAttributes::new(IntegerBounds::from_dimensions(size));
    attributes.pixel_aspect = info.pixel_aspect_ratio;
    // ITU-R BT.709 primaries, D65.
    attributes.chromaticities = Some(Chromaticities {
        red: Vec2(0.64, 0.33),
        green: Vec2(0.30, 0.60),
        blue: Vec2(0.15, 0.06),
        white: Vec2(0.3127, 0.3290),
    });
    attributes
}

#[expect(clippy::cast_possible_truncation, reason = "header fields are f32")]
fn layer_attributes(info: &ExrInfo, interop_id: &str, name: Option<&str>) -> LayerAttributes {
    let mut attributes = LayerAttributes {
        layer_name: name.map(text),
        software_name: Some(text(&info.software)),
        world_to_camera: info.world_to_camera.as_ref().map(row_vector_matrix),
        world_to_normalized_device: info.world_to_ndc.as_ref().map(row_vector_matrix),
        near_clip_plane: info.clipping_range.map(|(near, _)| near as f32),
        far_clip_plane: info
            .clipping_range
            .map(|(_, far)| far.min(f64::from(f32::MAX)) as f32),
        frames_per_second: info.frames_per_second.and_then(rational),
        ..LayerAttributes::default()
    };
    let texts = info
        .texts
        .iter()
        .map(|(name, value)| (name.as_str(), value.as_str()));
    for (name, value) in texts.chain([("colorInteropID", interop_id)]) {
        attributes
            .other
            .insert(text(name), AttributeValue::Text(text(value)));
    }
    attributes
}

/// The bytes of a string: EXR says nothing of encodings, and paths are UTF-8 in USD.
fn text(string: &str) -> Text {
    Text::from_slice_unchecked(string.as_bytes())
}

/// OpenEXR stores matrices row by row for row vectors, which is our columns one after the other.
#[expect(clippy::cast_possible_truncation, reason = "header matrices are f32")]
fn row_vector_matrix(matrix: &DMat4) -> [f32; 16] {
    matrix.to_cols_array().map(|element| element as f32)
}

/// Frame rates are whole, or whole times 1000/1001 (NTSC), or else thousandths.
#[expect(
    clippy::cast_possible_truncation,
    reason = "frame rates are checked to be below 10^6"
)]
fn rational(rate: f64) -> Option<(i32, u32)> {
    if !(rate > 0.0 && rate < 1e6) {
        return None;
    }
    // Rates are written with two to six decimals: 23.976 is meant as 24000/1001.
    let is_whole = |rate: f64| (rate - rate.round()).abs() < 1e-3 && rate.round() >= 1.0;
    if (rate - rate.round()).abs() < 1e-9 {
        Some((rate.round() as i32, 1))
    } else if is_whole(rate * 1.001) {
        Some(((rate * 1.001).round() as i32 * 1000, 1001))
    } else {
        Some(((rate * 1000.0).round() as i32, 1000))
    }
}

/// Color space identifier of the ASWF's Color Interop Forum.
fn interop_id(aov: Aov) -> &'static str {
    match aov.value_type() {
        ValueType::Color | ValueType::ColorAlpha => "lin_rec709_scene",
        ValueType::Float
        | ValueType::Normal
        | ValueType::Point
        | ValueType::Id
        | ValueType::Harmonics
        | ValueType::ColorHarmonics => "data",
    }
}

/// Channel suffixes of an AOV, in the order of its components, or of those of each of its parts.
fn suffixes(aov: Aov) -> &'static [&'static str] {
    match (aov, aov.part_type()) {
        (Aov::Depth, _) => &["Z"],
        (_, ValueType::Float | ValueType::Harmonics) => &["Y"],
        (_, ValueType::Color | ValueType::ColorHarmonics) => &["R", "G", "B"],
        (_, ValueType::ColorAlpha) => &["R", "G", "B", "A"],
        (_, ValueType::Normal | ValueType::Point) => &["X", "Y", "Z"],
        (_, ValueType::Id) => &["id"],
    }
}

fn channels(image: &AovImage) -> Vec<AnyChannel<FlatSamples>> {
    let aov = image.aov;
    let suffixes = suffixes(aov);
    let channel = |component: usize| {
        let suffix = suffixes[component % suffixes.len()];
        let part = aov.part_names().get(component / suffixes.len());
        let name = match (aov, part) {
            (Aov::Color, _) if image.group.is_none() => suffix.to_owned(),
            (_, Some(part)) => format!("{}.{suffix}", name_of_group(part, image.group.as_deref())),
            (_, None) => format!("{}.{suffix}", image.name()),
        };
        AnyChannel::new(text(&name), samples(image, component))
    };
    (0..aov.components()).map(channel).collect()
}

fn samples(image: &AovImage, component: usize) -> FlatSamples {
    let values = image
        .data
        .iter()
        .skip(component)
        .step_by(image.aov.components())
        .copied();
    match image.aov.value_type() {
        ValueType::Color | ValueType::ColorAlpha => FlatSamples::F16(values.map(half).collect()),
        ValueType::Float
        | ValueType::Normal
        | ValueType::Point
        | ValueType::Harmonics
        | ValueType::ColorHarmonics => FlatSamples::F32(values.collect()),
        ValueType::Id => FlatSamples::U32(values.map(id).collect()),
    }
}

/// Half precision, values beyond its range at its largest value: an infinity would spread in every filter.
fn half(value: f32) -> f16 {
    f16::from_f32(value.clamp(-f16::MAX.to_f32(), f16::MAX.to_f32()))
}

/// −1 (nothing) becomes `0xFFFF_FFFF`, which is −1 to readers of signed ids.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "ids are whole and exact in f32; −1 wraps by intention"
)]
fn id(value: f32) -> u32 {
    value as i64 as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_rates_are_exact_ratios() {
        for (rate, expected) in [
            (24.0, Some((24, 1))),
            (23.976, Some((24_000, 1001))),
            (23.976_023_976, Some((24_000, 1001))),
            (29.97, Some((30_000, 1001))),
            (59.94, Some((60_000, 1001))),
            (12.5, Some((12_500, 1000))),
            (0.0, None),
            (f64::NAN, None),
        ] {
            assert_eq!(rational(rate), expected, "{rate}");
        }
    }
}
