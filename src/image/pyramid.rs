//! Mip levels: each half the size of the one before (rounded down), every texel the area-weighted mean of what it
//! covers, in linear light. All levels have the same mean.

use super::decode::Samples;
use crate::math::srgb;
use half::f16;
use std::sync::LazyLock;

/// Linear value of every 8-bit sRGB code (IEC 61966-2-1).
static FROM_SRGB: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| srgb::to_linear(code as f32 / 255.0)));

/// Linear value of every 8-bit code that is linear already.
static FROM_LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| code as f32 / 255.0));

/// Texels of one level, interleaved, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Texels {
    /// 8-bit codes, sRGB-encoded (alpha is not) or linear.
    Bytes { codes: Vec<u8>, srgb: bool },
    /// Linear, 0 to 65535 meaning 0 to 1: smaller levels of 8-bit images.
    Fixed(Vec<u16>),
    /// Linear.
    Half(Vec<f16>),
    /// Linear.
    Float(Vec<f32>),
}

/// One level.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Level {
    pub(super) width: usize,
    pub(super) height: usize,
    /// 1 gray, 2 gray and alpha, 3 RGB, 4 RGBA.
    pub(super) channels: usize,
    pub(super) texels: Texels,
}

impl Level {
    /// Linear channels of texel `index`; those that the image does not have are 0.
    pub(super) fn linear(&self, index: usize) -> [f32; 4] {
        let span = index * self.channels..(index + 1) * self.channels;
        let mut linear = [0.0; 4];
        match &self.texels {
            Texels::Bytes { codes, srgb } => {
                let plain: &[f32; 256] = &FROM_LINEAR;
                let table = if *srgb { &*FROM_SRGB } else { plain };
                for (value, code) in linear.iter_mut().zip(&codes[span]) {
                    *value = table[usize::from(*code)];
                }
                if self.channels.is_multiple_of(2) {
                    let alpha = index * self.channels + self.channels - 1;
                    linear[self.channels - 1] = plain[usize::from(codes[alpha])];
                }
            }
            Texels::Fixed(values) => {
                for (value, fixed) in linear.iter_mut().zip(&values[span]) {
                    *value = f32::from(*fixed) * (1.0 / FIXED_ONE);
                }
            }
            Texels::Half(values) => {
                for (value, half) in linear.iter_mut().zip(&values[span]) {
                    *value = half.to_f32();
                }
            }
            Texels::Float(values) => {
                for (value, float) in linear.iter_mut().zip(&values[span]) {
                    *value = *float;
                }
            }
        }
        linear
    }
}

/// What 1 is in [`Texels::Fixed`].
const FIXED_ONE: f32 = 65_535.0;

/// A level before it is rounded for storage: the next one is made from it, so that errors do not add up.
struct Precise {
    width: usize,
    height: usize,
    channels: usize,
    values: Vec<f32>,
}

impl Precise {
    /// The next smaller level of an image of this size whose texels `texel` gives.
    fn halved(
        (width, height, channels): (usize, usize, usize),
        texel: impl Fn(usize) -> [f32; 4],
    ) -> Self {
        let across = Cover::all(width, half_of(width));
        let down = Cover::all(height, half_of(height));
        let mut column = vec![[0.0_f32; 4]; width];
        let mut values = Vec::with_capacity(across.len() * down.len() * channels);
        for rows in &down {
            column.fill([0.0; 4]);
            for (y, weight) in rows.weights() {
                for (x, sums) in column.iter_mut().enumerate() {
                    let values = texel(y * width + x);
                    for (sum, value) in sums.iter_mut().zip(values) {
                        *sum += weight * value;
                    }
                }
            }
            for columns in &across {
                values.extend((0..channels).map(|channel| -> f32 {
                    let terms = columns.weights();
                    terms.map(|(x, weight)| weight * column[x][channel]).sum()
                }));
            }
        }
        Self {
            width: across.len(),
            height: down.len(),
            channels,
            values,
        }
    }

    fn texel(&self, index: usize) -> [f32; 4] {
        let mut texel = [0.0; 4];
        let start = index * self.channels;
        texel[..self.channels].copy_from_slice(&self.values[start..start + self.channels]);
        texel
    }

    /// Rounded to what levels below `base` are stored in.
    fn level(&self, base: &Texels) -> Level {
        let values = self.values.iter();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "means of 8-bit codes are 0 to 1"
        )]
        let fixed = |value: &f32| (value * FIXED_ONE).round() as u16;
        let texels = match base {
            Texels::Bytes { .. } | Texels::Fixed(_) => Texels::Fixed(values.map(fixed).collect()),
            Texels::Half(_) => Texels::Half(values.map(|value| f16::from_f32(*value)).collect()),
            Texels::Float(_) => Texels::Float(self.values.clone()),
        };
        Level {
            width: self.width,
            height: self.height,
            channels: self.channels,
            texels,
        }
    }
}

fn half_of(size: usize) -> usize {
    (size / 2).max(1)
}

/// The up to three texels that a texel of the next level covers along one axis, with weights that sum to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cover {
    first: usize,
    weights: [f32; 3],
}

impl Cover {
    /// Covers of `to` texels that share `from` texels evenly (`from / to` is 1 to 3).
    fn all(from: usize, to: usize) -> Vec<Self> {
        #[expect(clippy::cast_possible_truncation, reason = "0 to 1")]
        let weight = |x: f64| x as f32;
        let size = from as f64 / to as f64;
        let cover = |index: usize| {
            // Integer division: where texel `index` begins, without rounding.
            let first = index * from / to;
            let (start, end) = (index as f64 * size, (index + 1) as f64 * size);
            let overlap = |k: usize| {
                let texel = (first + k) as f64;
                weight((end.min(texel + 1.0) - start.max(texel)).max(0.0) / size)
            };
            Self {
                first,
                weights: [overlap(0), overlap(1), overlap(2)],
            }
        };
        (0..to).map(cover).collect()
    }

    fn weights(&self) -> impl Iterator<Item = (usize, f32)> {
        let first = self.first;
        let weights = self.weights.into_iter().enumerate();
        weights
            .filter(|(_, weight)| *weight > 0.0)
            .map(move |(k, weight)| (first + k, weight))
    }
}

/// All levels of an image, largest first. `srgb` decodes the color channels; non-finite samples become 0 and are
/// counted.
pub(super) fn build(decoded: super::decode::Decoded, srgb: bool) -> (Vec<Level>, usize) {
    let channels = decoded.channels;
    let is_color = |index: usize| channels % 2 == 1 || index % channels != channels - 1;
    let mut repaired = 0;
    let mut linear = |(index, value): (usize, f32)| {
        if !value.is_finite() {
            repaired += 1;
            return 0.0;
        }
        if srgb && is_color(index) {
            srgb::to_linear(value)
        } else {
            value
        }
    };
    let texels = match decoded.samples {
        Samples::Bytes(codes) => Texels::Bytes { codes, srgb },
        Samples::Half(values) => {
            let values = values.into_iter().map(f16::to_f32).enumerate();
            Texels::Half(values.map(|sample| f16::from_f32(linear(sample))).collect())
        }
        Samples::Float(values) => {
            Texels::Float(values.into_iter().enumerate().map(linear).collect())
        }
    };
    let base = Level {
        width: decoded.width,
        height: decoded.height,
        channels,
        texels,
    };
    let mut next = (base.width.max(base.height) > 1).then(|| {
        let size = (base.width, base.height, channels);
        Precise::halved(size, |index| base.linear(index))
    });
    let mut levels = vec![base];
    while let Some(samples) = next {
        levels.push(samples.level(&levels[0].texels));
        next = (samples.width.max(samples.height) > 1).then(|| {
            let size = (samples.width, samples.height, channels);
            Precise::halved(size, |index| samples.texel(index))
        });
    }
    (levels, repaired)
}

#[cfg(test)]
mod tests {
    use super::super::decode::Decoded;
    use super::*;

    fn mean(level: &Level) -> f64 {
        let count = level.width * level.height;
        let sums = (0..count).map(|index| f64::from(level.linear(index).iter().sum::<f32>()));
        sums.sum::<f64>() / count as f64
    }

    fn ramp(width: usize, height: usize, channels: usize) -> Decoded {
        let codes = (0..width * height * channels)
            .map(|i| u8::try_from(i * i * 37 % 251).unwrap())
            .collect();
        Decoded {
            width,
            height,
            channels,
            samples: Samples::Bytes(codes),
        }
    }

    #[test]
    fn every_level_has_the_mean_of_the_image() {
        for (width, height) in [(16, 16), (5, 7), (1, 9), (33, 2), (3, 3), (1, 1)] {
            for srgb in [false, true] {
                let (levels, repaired) = build(ramp(width, height, 3), srgb);
                let last = levels.last().unwrap();
                assert_eq!((last.width, last.height, repaired), (1, 1, 0));
                let expected = mean(&levels[0]);
                for level in &levels {
                    // 16 bits of 1: half a step is 1e-5.
                    assert!(
                        (mean(level) - expected).abs() < 3e-5 * expected,
                        "{width} × {height}"
                    );
                }
            }
        }
    }

    #[test]
    fn texels_of_a_level_are_means_of_two_by_two() {
        let samples = Samples::Float(vec![1.0, 3.0, 10.0, 20.0, 5.0, 7.0, 30.0, 40.0]);
        let (levels, _) = build(
            Decoded {
                width: 4,
                height: 2,
                channels: 1,
                samples,
            },
            false,
        );
        assert_eq!(levels[1].texels, Texels::Float(vec![4.0, 25.0]));
        assert_eq!(levels[2].texels, Texels::Float(vec![14.5]));
    }

    #[test]
    fn srgb_codes_have_their_standard_values() {
        // IEC 61966-2-1: (119, 0.1845), (188, 0.5029) are the usual landmarks; 10 is on the linear part.
        for (code, linear) in [
            (0, 0.0),
            (10, 10.0 / 255.0 / 12.92),
            (119, 0.184_475),
            (188, 0.502_886),
            (255, 1.0),
        ] {
            assert!(
                (FROM_SRGB[code] - linear).abs() < 1e-5,
                "{code}: {}",
                FROM_SRGB[code]
            );
        }
    }

    #[test]
    fn alpha_is_never_srgb_decoded() {
        let samples = Samples::Bytes(vec![188, 188, 188, 128]);
        let (levels, _) = build(
            Decoded {
                width: 1,
                height: 1,
                channels: 4,
                samples,
            },
            true,
        );
        assert_eq!(levels[0].linear(0)[3], 128.0 / 255.0);
        assert!((levels[0].linear(0)[0] - 0.502_886).abs() < 1e-5);
    }

    #[test]
    fn samples_that_are_not_finite_become_zero_and_are_counted() {
        let samples = Samples::Float(vec![f32::NAN, 1.0, f32::INFINITY, 2.0]);
        let (levels, repaired) = build(
            Decoded {
                width: 2,
                height: 2,
                channels: 1,
                samples,
            },
            false,
        );
        assert_eq!(repaired, 2);
        assert_eq!(levels[1].texels, Texels::Float(vec![0.75]));
    }
}
