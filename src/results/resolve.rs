//! Values of receivers → pixels: the weighted sum of what is in a pixel, or what prevails in it.

use super::{Aov, AovBuffer, PixelShare, Results, Target, ValueType};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;

/// `depth` of a pixel that sees nothing: farther than anything, but finite.
/// Blender's and Cycles' value for the background.
pub const FAR_DEPTH: f32 = 1e10;

/// `primId` of a pixel that sees nothing.
pub const NO_PRIM: f32 = -1.0;

/// One AOV as pixels, rows from the top, `aov.components()` floats a pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct AovImage {
    /// Which AOV.
    pub aov: Aov,
    /// The lights whose part it is; `None` = all of it.
    pub group: Option<Arc<str>>,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// `width * height * aov.components()` finite values.
    pub data: Vec<f32>,
}

impl AovImage {
    /// The name on disk.
    pub fn name(&self) -> Cow<'static, str> {
        super::name_of_group(self.aov.name(), self.group.as_deref())
    }

    /// Components of pixel `index` (`y * width + x`).
    pub fn pixel(&self, index: usize) -> &[f32] {
        let components = self.aov.components();
        &self.data[index * components..(index + 1) * components]
    }
}

/// How the shares of a pixel become its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    /// Weighted sum: premultiplied by coverage, so that AOVs add up to `color` at edges too.
    Sum,
    /// Weighted sum, made unit.
    Direction,
    /// The value of the receiver with the largest share (the first of equals): a mean would be on no surface.
    Prevailing,
}

impl Rule {
    fn of(aov: Aov) -> Self {
        match (aov, aov.value_type()) {
            (Aov::Depth, _) | (_, ValueType::Point | ValueType::Id) => Self::Prevailing,
            (_, ValueType::Normal) => Self::Direction,
            (
                _,
                ValueType::Float
                | ValueType::Color
                | ValueType::ColorAlpha
                | ValueType::Harmonics
                | ValueType::ColorHarmonics,
            ) => Self::Sum,
        }
    }
}

/// What a pixel holds that sees nothing.
fn background(aov: Aov) -> f32 {
    match aov {
        Aov::Depth => FAR_DEPTH,
        Aov::PrimId => NO_PRIM,
        _ => 0.0,
    }
}

/// Every AOV of `results` as an image, in their order, those of light groups after them; none when the target is not an image.
///
/// Light, albedo, `occlusion`, `visibility` and its harmonics are premultiplied by coverage and 0 where nothing is
/// seen; `N`, `bent_normal` and `illumination_direction` are made unit again; `P`, `depth` and `primId` are those of the receiver that fills most of the
/// pixel.
pub fn resolve(results: &Results, target: &Target) -> Vec<AovImage> {
    let Target::Image {
        width,
        height,
        shares,
    } = target
    else {
        return Vec::new();
    };
    let image = |(group, buffer): (Option<&Arc<str>>, &AovBuffer)| AovImage {
        aov: buffer.aov,
        group: group.cloned(),
        width: *width,
        height: *height,
        data: pixels(buffer, *width as usize * *height as usize, shares),
    };
    let whole = results.buffers.iter().map(|buffer| (None, buffer));
    let groups = results.groups.iter().flat_map(|group| {
        let buffers = group.buffers.iter();
        buffers.map(|buffer| (Some(&group.name), buffer))
    });
    let all: Vec<_> = whole.chain(groups).collect();
    all.into_par_iter().map(image).collect()
}

fn pixels(buffer: &AovBuffer, pixel_count: usize, shares: &[PixelShare]) -> Vec<f32> {
    let components = buffer.aov.components();
    let mut data = vec![background(buffer.aov); pixel_count * components];
    let rule = Rule::of(buffer.aov);
    for shares in shares.chunk_by(|a, b| a.pixel == b.pixel) {
        let first = shares[0].pixel as usize * components;
        let pixel = &mut data[first..first + components];
        let value = |share: &PixelShare| {
            let first = share.receiver as usize * components;
            &buffer.data[first..first + components]
        };
        if rule == Rule::Prevailing {
            let larger = |a, b| if weight(b) > weight(a) { b } else { a };
            pixel.copy_from_slice(value(shares.iter().reduce(larger).unwrap_or(&shares[0])));
            continue;
        }
        for share in shares {
            for (sum, value) in pixel.iter_mut().zip(value(share)) {
                *sum += share.weight * value;
            }
        }
        if rule == Rule::Direction {
            normalize(pixel);
        }
    }
    data
}

fn weight(share: &PixelShare) -> f32 {
    share.weight
}

/// Opposed directions may cancel: then it stays 0.
fn normalize(direction: &mut [f32]) {
    let length = direction.iter().map(|x| x * x).sum::<f32>().sqrt();
    if length > 0.0 {
        direction.iter_mut().for_each(|x| *x /= length);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(pixel: u32, receiver: u32, weight: f32) -> PixelShare {
        PixelShare {
            pixel,
            receiver,
            weight,
        }
    }

    /// 3 × 1 pixels: one receiver; nothing; two receivers that cover three quarters.
    fn target() -> Target {
        Target::Image {
            width: 3,
            height: 1,
            shares: vec![share(0, 0, 1.0), share(2, 1, 0.25), share(2, 2, 0.5)],
        }
    }

    fn resolved(aov: Aov, data: &[f32]) -> AovImage {
        let results = Results {
            buffers: vec![AovBuffer {
                aov,
                data: data.to_vec(),
            }],
            ..Results::default()
        };
        resolve(&results, &target()).remove(0)
    }

    #[test]
    fn colors_are_weighted_sums_with_coverage_as_alpha() {
        let image = resolved(
            Aov::Color,
            &[1.0, 2.0, 3.0, 1.0, 4.0, 0.0, 0.0, 1.0, 0.0, 8.0, 0.0, 1.0],
        );
        assert_eq!(image.pixel(0), [1.0, 2.0, 3.0, 1.0]);
        assert_eq!(image.pixel(1), [0.0; 4]);
        assert_eq!(image.pixel(2), [1.0, 4.0, 0.0, 0.75]);
        assert_eq!(
            resolved(Aov::Occlusion, &[0.5, 1.0, 1.0]).data,
            [0.5, 0.0, 0.75]
        );
    }

    #[test]
    fn directions_are_unit_again() {
        let image = resolved(Aov::Normal, &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let expected = [0.25_f32, 0.5, 0.0].map(|x| x / 0.3125_f32.sqrt());
        assert_eq!(image.pixel(0), [0.0, 0.0, 1.0]);
        assert_eq!(image.pixel(1), [0.0; 3]);
        assert!(
            image
                .pixel(2)
                .iter()
                .zip(expected)
                .all(|(a, b)| (a - b).abs() < 1e-6)
        );
    }

    #[test]
    fn geometry_is_that_of_the_largest_share_and_far_where_there_is_none() {
        assert_eq!(
            resolved(Aov::Depth, &[5.0, 1.0, 9.0]).data,
            [5.0, 1e10, 9.0]
        );
        assert_eq!(
            resolved(Aov::PrimId, &[0.0, 7.0, 3.0]).data,
            [0.0, -1.0, 3.0]
        );
        let image = resolved(
            Aov::Position,
            &[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0],
        );
        assert_eq!(image.pixel(2), [2.0; 3]);
    }

    #[test]
    fn only_images_have_pixels() {
        assert!(resolve(&Results::default(), &target()).is_empty());
        let results = Results {
            buffers: vec![AovBuffer {
                aov: Aov::Depth,
                data: vec![],
            }],
            ..Results::default()
        };
        assert!(resolve(&results, &Target::Surfels).is_empty());
        let empty = Target::Image {
            width: 0,
            height: 0,
            shares: vec![],
        };
        assert!(resolve(&results, &empty)[0].data.is_empty());
    }
}
