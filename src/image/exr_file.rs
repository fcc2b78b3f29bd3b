//! OpenEXR files as textures: the first flat layer with RGB(A) or luminance channels.

use super::decode::{Decoded, Samples, check_size};
use exr::meta::MetaData;
use exr::meta::attribute::{SampleType, Text};
use exr::meta::header::Header;
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, Vec2, read};
use half::f16;
use std::io::Cursor;

/// First bytes of every OpenEXR file.
const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// True if `bytes` begin like an OpenEXR file.
pub(super) fn is_exr(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC)
}

/// Names of the channels to read: one of them for gray.
struct Channels {
    color: Vec<Text>,
    alpha: Option<Text>,
    all_half: bool,
}

impl Channels {
    /// The channels of `header` that make a picture: `R G B`, or `Y`, or the only one there is; with the alpha of the
    /// same layer.
    fn of(header: &Header) -> Option<Self> {
        let channels = &header.channels.list;
        let named = |name: &str| {
            let ends = |text: &str| text == name || text.ends_with(&format!(".{name}"));
            channels
                .iter()
                .find(|channel| ends(&channel.name.to_string()))
        };
        let color = match (named("R"), named("G"), named("B")) {
            (Some(r), Some(g), Some(b)) => vec![r, g, b],
            _ => match named("Y") {
                Some(y) => vec![y],
                None if channels.len() == 1 => vec![&channels[0]],
                None => return None,
            },
        };
        let alpha = named("A");
        let mut read = color.iter().chain(&alpha);
        let is_whole = |sampling: Vec2<usize>| sampling == Vec2(1, 1);
        if !read.clone().all(|channel| is_whole(channel.sampling)) {
            return None;
        }
        Some(Self {
            all_half: read.all(|channel| channel.sample_type == SampleType::F16),
            color: color.iter().map(|channel| channel.name.clone()).collect(),
            alpha: alpha.map(|channel| channel.name.clone()),
        })
    }

    fn count(&self) -> usize {
        self.color.len() + usize::from(self.alpha.is_some())
    }
}

/// Decode an OpenEXR file.
pub(super) fn decode(bytes: &[u8]) -> Result<Decoded, String> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false)
        .map_err(|error| error.to_string())?;
    let (header, channels) = (meta.headers.iter())
        .filter(|header| !header.deep)
        .find_map(|header| Some((header, Channels::of(header)?)))
        .ok_or("it has no flat layer with RGB or luminance channels")?;
    let Vec2(width, height) = header.layer_size;
    check_size(width, height, 2 * channels.count() as u64, bytes.len())?;
    let samples = match channels.all_half {
        true => Samples::Half(pixels(bytes, &channels, f16::from_f32)?),
        false => Samples::Float(pixels(bytes, &channels, |sample| sample)?),
    };
    Ok(Decoded {
        width,
        height,
        channels: channels.count(),
        samples,
    })
}

/// Interleaved samples of the chosen channels.
fn pixels<T: Copy + Default + Send + 'static>(
    bytes: &[u8],
    channels: &Channels,
    convert: impl Fn(f32) -> T + Sync + 'static,
) -> Result<Vec<T>, String> {
    let count = channels.count();
    let gray = channels.color.len() == 1;
    // The reader's list of channels is fixed: names that no file has stand for those that are not wanted.
    let or_absent =
        |name: Option<&Text>, absent: &str| name.cloned().unwrap_or_else(|| Text::from(absent));
    let layer = read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required(channels.color[0].clone())
        .optional(or_absent(channels.color.get(1), "(no G)"), 0.0_f32)
        .optional(or_absent(channels.color.get(2), "(no B)"), 0.0_f32)
        .optional(or_absent(channels.alpha.as_ref(), "(no A)"), 1.0_f32)
        .collect_pixels(
            move |size: Vec2<usize>, _| (size.width(), vec![T::default(); size.area() * count]),
            move |(width, samples), at: Vec2<usize>, (r, g, b, a): (f32, f32, f32, f32)| {
                let pixel = if gray { [r, a, 0.0, 0.0] } else { [r, g, b, a] };
                let start = (at.y() * *width + at.x()) * count;
                for (sample, value) in samples[start..start + count].iter_mut().zip(pixel) {
                    *sample = convert(value);
                }
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(|error| error.to_string())?;
    Ok(layer.layer_data.channel_data.pixels.1)
}
