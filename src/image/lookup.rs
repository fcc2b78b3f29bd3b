//! Filtered texture lookup: the mean over a parallelogram of texture space, from the mip levels.
//!
//! The square to average over becomes a parallelogram in texels. It is covered by a grid of lookups, at least 2 × 2 and
//! more along its long axis, each averaging over a square cell of width f. A lookup at level *l* (texels of size
//! s = 2^l: a box of variance s²/12, then a tent of s²/6 between texels) has variance s²/4, a box as wide as the cell
//! has f²/12: they agree at s = f/√3, which is the level used, blending linearly between levels. So neighboring samples
//! neither miss texels nor blur beyond their own footprint. (One lookup instead of four: errors up to a tenth of the
//! texture's contrast where it changes within a footprint, against a fiftieth.)

use super::pyramid::{self, Level};
use super::{Error, decode};
use crate::scene::{ColorSpace, Wrap};
use glam::{Mat2, Vec2, Vec4};
use std::path::Path;

/// Lookups across a footprint that is wider than a texel.
const TAPS_ACROSS: u8 = 2;

/// Longest footprint that is covered in its own width, as a multiple of it; longer ones are averaged too wide across.
const MAX_ASPECT: f32 = 4.0;

/// Half the binary logarithm of 3: how many levels the matching level lies below the footprint's size.
const LEVEL_BELOW_FOOTPRINT: f32 = 0.792_481_25;

/// A texture with its mip levels, linear. 8-bit files stay 8-bit in memory, their smaller levels are 16-bit.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    levels: Vec<Level>,
    repaired: usize,
}

impl Image {
    /// Read the image at `path` (package paths allowed, no UDIM sets). `Auto` decodes sRGB from 8-bit images with 3 or
    /// 4 channels, as UsdPreviewSurface specifies.
    ///
    /// # Errors
    /// Files that are missing, damaged, of another format, or absurdly large.
    pub fn load(path: &Path, color_space: ColorSpace) -> Result<Self, Error> {
        Ok(Self::new(decode::file(path)?, color_space))
    }

    pub(super) fn new(decoded: decode::Decoded, color_space: ColorSpace) -> Self {
        let is_color_code =
            decoded.channels >= 3 && matches!(decoded.samples, decode::Samples::Bytes(_));
        let srgb = match color_space {
            ColorSpace::Auto => is_color_code,
            ColorSpace::Raw => false,
            ColorSpace::SRgb => true,
        };
        let (levels, repaired) = pyramid::build(decoded, srgb);
        Self { levels, repaired }
    }

    /// Pixels of the full resolution.
    pub fn width(&self) -> usize {
        self.levels[0].width
    }

    /// Pixels of the full resolution.
    pub fn height(&self) -> usize {
        self.levels[0].height
    }

    /// How many samples were NaN or infinite; they are 0.
    pub fn repaired(&self) -> usize {
        self.repaired
    }

    /// Mean of all pixels.
    pub fn mean(&self) -> Vec4 {
        self.levels[self.levels.len() - 1].texel(0, 0)
    }

    /// Linear RGBA of pixel (`x`, `y`), rows from the top; gray is spread to RGB, missing alpha is 1.
    ///
    /// # Panics
    /// If the pixel is outside of the image.
    pub fn pixel(&self, x: usize, y: usize) -> Vec4 {
        self.levels[0].texel(x, y)
    }

    /// Linear RGBA around `st` ((0, 0) is the lower left corner, (1, 1) the upper right), averaged over the
    /// parallelogram around it whose edges are the columns of `footprint` (in st); zero footprint = bilinear lookup at
    /// full resolution. Outside of the unit square `wrap` (for s and t) decides.
    pub fn sample(&self, st: Vec2, footprint: Mat2, wrap: [Wrap; 2]) -> Vec4 {
        if !st.is_finite() {
            return Vec4::ZERO;
        }
        // Rows run from the top: v = 1 − t.
        let at = Vec2::new(st.x, 1.0 - st.y);
        let size = Vec2::new(self.width() as f32, self.height() as f32);
        let spread = Spread::of(
            Mat2::from_diagonal(size) * Mat2::from_diagonal(Vec2::new(1.0, -1.0)) * footprint,
        );
        let level = spread.cell.log2() - LEVEL_BELOW_FOOTPRINT;
        let [along, across] = spread.axes.map(|axis| axis / size);
        let sum: Vec4 = spread
            .steps()
            .map(|step| self.trilinear(at + along * step.x + across * step.y, level, wrap))
            .sum();
        sum / f32::from(spread.taps[0] * spread.taps[1])
    }

    fn trilinear(&self, at: Vec2, level: f32, wrap: [Wrap; 2]) -> Vec4 {
        let last = self.levels.len() - 1;
        if level.is_nan() || level <= 0.0 {
            return self.levels[0].bilinear(at, wrap);
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "positive, saturates"
        )]
        let below = level as usize;
        if below >= last {
            return self.levels[last].bilinear(at, wrap);
        }
        let fine = self.levels[below].bilinear(at, wrap);
        let coarse = self.levels[below + 1].bilinear(at, wrap);
        fine.lerp(coarse, level.fract())
    }
}

/// A footprint as a grid of lookups.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Spread {
    /// The whole long and short axis, texels.
    axes: [Vec2; 2],
    /// How many lookups along each.
    taps: [u8; 2],
    /// Width that each lookup averages over, texels.
    cell: f32,
}

impl Spread {
    const POINT: Self = Self {
        axes: [Vec2::ZERO; 2],
        taps: [1; 2],
        cell: 0.0,
    };

    /// From the parallelogram's edges in texels: its principal axes are those of `edges · edgesᵀ`.
    fn of(edges: Mat2) -> Self {
        let scale = edges.x_axis.abs().max(edges.y_axis.abs()).max_element();
        if !(scale.is_normal() && edges.is_finite()) {
            return Self::POINT;
        }
        // Scaled to about 1, squares neither overflow nor vanish.
        let unit = edges * scale.recip();
        let square = unit * unit.transpose();
        let (xx, xy, yy) = (square.x_axis.x, square.x_axis.y, square.y_axis.y);
        let long = (0.5 * (xx + yy) + (0.5 * (xx - yy)).hypot(xy)).sqrt();
        // The product of the singular values is the determinant: the difference of squares would cancel.
        let short = (unit.determinant().abs() / long).max(long / MAX_ASPECT);
        let direction = Vec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy));
        let across = if short * scale > 1.0 { TAPS_ACROSS } else { 1 };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1 to MAX_ASPECT"
        )]
        let aspect = (long / short).round().clamp(1.0, MAX_ASPECT) as u8;
        Self {
            axes: [
                direction * (long * scale),
                direction.perp() * (short * scale),
            ],
            taps: [aspect * across, across],
            cell: short * scale / f32::from(across),
        }
    }

    /// Where the lookups are, as fractions of the axes from the centre.
    fn steps(&self) -> impl Iterator<Item = Vec2> {
        let [along, across] = self.taps;
        let at = |index: u8, count: u8| (f32::from(index) + 0.5) / f32::from(count) - 0.5;
        (0..across)
            .flat_map(move |y| (0..along).map(move |x| Vec2::new(at(x, along), at(y, across))))
    }
}

impl Level {
    /// RGBA of a texel: gray is spread to RGB, missing alpha is 1.
    fn texel(&self, x: usize, y: usize) -> Vec4 {
        let [r, g, b, a] = self.linear(y * self.width + x);
        match self.channels {
            1 => Vec4::new(r, r, r, 1.0),
            2 => Vec4::new(r, r, r, g),
            3 => Vec4::new(r, g, b, 1.0),
            _ => Vec4::new(r, g, b, a),
        }
    }

    /// Between the four texel centers around `at` (0 to 1, from the upper left corner).
    fn bilinear(&self, at: Vec2, wrap: [Wrap; 2]) -> Vec4 {
        let columns = Pair::around(at.x, self.width, wrap[0]);
        let rows = Pair::around(at.y, self.height, wrap[1]);
        let texel = |x: Option<usize>, y: Option<usize>| match (x, y) {
            (Some(x), Some(y)) => self.texel(x, y),
            _ => Vec4::ZERO,
        };
        let row = |y: Option<usize>| {
            texel(columns.first, y).lerp(texel(columns.second, y), columns.blend)
        };
        row(rows.first).lerp(row(rows.second), rows.blend)
    }
}

/// Two neighboring texels along one axis and how far the second counts; `None` = outside, black.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pair {
    first: Option<usize>,
    second: Option<usize>,
    blend: f32,
}

impl Pair {
    fn around(at: f32, size: usize, wrap: Wrap) -> Self {
        // Reducing the coordinate first keeps its fraction exact far from the unit square.
        let at = match wrap {
            Wrap::Repeat => at - at.floor(),
            Wrap::Mirror => at - 2.0 * (at * 0.5).floor(),
            Wrap::Clamp => at.clamp(0.0, 1.0),
            Wrap::Black => at.clamp(-1.0, 2.0),
        };
        let texel = at * size as f32 - 0.5;
        let first = texel.floor();
        #[expect(
            clippy::cast_possible_truncation,
            reason = "at most twice an image's size"
        )]
        let index = first as i64;
        Self {
            first: wrapped(index, size, wrap),
            second: wrapped(index + 1, size, wrap),
            blend: texel - first,
        }
    }
}

/// Texel `index` of `size`, brought into the image; `None` where it is black.
fn wrapped(index: i64, size: usize, wrap: Wrap) -> Option<usize> {
    let count = i64::try_from(size).ok()?;
    let inside = match wrap {
        Wrap::Black => index,
        Wrap::Clamp => index.clamp(0, count - 1),
        Wrap::Repeat => index.rem_euclid(count),
        Wrap::Mirror => {
            let period = index.rem_euclid(2 * count);
            period.min(2 * count - 1 - period)
        }
    };
    usize::try_from(inside).ok().filter(|&index| index < size)
}

#[cfg(test)]
mod tests {
    use super::super::decode::{Decoded, Samples};
    use super::*;

    const REPEAT: [Wrap; 2] = [Wrap::Repeat; 2];

    fn gray(width: usize, height: usize, values: Vec<f32>) -> Image {
        let samples = Samples::Float(values);
        Image::new(
            Decoded {
                width,
                height,
                channels: 1,
                samples,
            },
            ColorSpace::Raw,
        )
    }

    fn at(image: &Image, s: f32, t: f32, wrap: Wrap) -> f32 {
        image.sample(Vec2::new(s, t), Mat2::ZERO, [wrap; 2]).x
    }

    #[test]
    fn the_origin_of_st_is_the_lower_left_corner() {
        let image = gray(2, 2, vec![1.0, 2.0, 3.0, 4.0]);
        assert_eq!(at(&image, 0.25, 0.25, Wrap::Clamp), 3.0);
        assert_eq!(at(&image, 0.75, 0.75, Wrap::Clamp), 2.0);
        assert_eq!(at(&image, 0.5, 0.5, Wrap::Clamp), 2.5);
    }

    #[test]
    fn wrap_modes_continue_a_row_as_their_names_say() {
        let image = gray(4, 1, vec![1.0, 2.0, 3.0, 4.0]);
        let row = |wrap: Wrap| -> Vec<f32> {
            (-5..9)
                .map(|texel| at(&image, (texel as f32 + 0.5) / 4.0, 0.5, wrap))
                .collect()
        };
        assert_eq!(
            row(Wrap::Repeat),
            [4., 1., 2., 3., 4., 1., 2., 3., 4., 1., 2., 3., 4., 1.]
        );
        assert_eq!(
            row(Wrap::Clamp),
            [1., 1., 1., 1., 1., 1., 2., 3., 4., 4., 4., 4., 4., 4.]
        );
        assert_eq!(
            row(Wrap::Mirror),
            [4., 4., 3., 2., 1., 1., 2., 3., 4., 4., 3., 2., 1., 1.]
        );
        assert_eq!(
            row(Wrap::Black),
            [0., 0., 0., 0., 0., 1., 2., 3., 4., 0., 0., 0., 0., 0.]
        );
        assert_eq!(at(&image, 1e30, 0.5, Wrap::Black), 0.0);
        assert_eq!(at(&image, f32::NAN, 0.5, Wrap::Repeat), 0.0);
    }

    #[test]
    fn a_footprint_of_the_whole_image_is_its_mean() {
        let image = gray(8, 4, (0..32).map(|i| i as f32).collect());
        assert_eq!(image.mean(), Vec4::new(15.5, 15.5, 15.5, 1.0));
        for scale in [8.0, 1e10, 1e30] {
            let found = image.sample(Vec2::new(0.3, 0.9), Mat2::IDENTITY * scale, REPEAT);
            assert!((found.x - 15.5).abs() < 1e-4, "{found}");
        }
    }

    #[test]
    fn averages_of_noise_have_the_spread_of_a_box_of_the_footprint() {
        // Independent texels averaged over f² of them: the deviation falls by 1/f. Too low = overblurred.
        let size = 256_usize;
        let mut state = 1_u32;
        let values = (0..size * size).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 16_777_216.0
        });
        let image = gray(size, size, values.collect());
        let deviation = |footprint: Mat2| {
            let samples = (0..4000).map(|i| {
                let st = Vec2::new(
                    (i as f32 * 0.618_034).fract(),
                    (i as f32 * 0.754_877).fract(),
                );
                f64::from(image.sample(st, footprint, REPEAT).x - 0.5)
            });
            (samples.map(|x| x * x).sum::<f64>() / 4000.0).sqrt()
        };
        let texel = 1.0 / size as f32;
        for f in [4.0_f32, 6.0, 8.0, 16.0] {
            let square = deviation(Mat2::IDENTITY * (f * texel));
            let expected = (1.0_f64 / 12.0).sqrt() / f64::from(f);
            let ratio = square / expected;
            assert!((0.7..1.4).contains(&ratio), "{f}: {ratio}");
            // Four times as long as wide, on a diagonal: the same area as a square of twice the width.
            let long = Mat2::from_angle(0.6) * Mat2::from_diagonal(Vec2::new(4.0, 1.0) * f * texel);
            let ratio = deviation(long) / (expected / 2.0);
            assert!((0.7..1.4).contains(&ratio), "long {f}: {ratio}");
        }
    }

    #[test]
    fn long_footprints_do_not_blur_across() {
        // Stripes along s: a footprint long in s and thin in t must still see them.
        let image = gray(
            64,
            64,
            (0..64 * 64)
                .map(|i| f32::from(u8::from(i / 64 % 16 < 8)))
                .collect(),
        );
        let long = Mat2::from_diagonal(Vec2::new(16.0, 1.0) / 64.0);
        let inside = image
            .sample(Vec2::new(0.5, 1.0 - 4.0 / 64.0), long, REPEAT)
            .x;
        let between = image
            .sample(Vec2::new(0.5, 1.0 - 12.0 / 64.0), long, REPEAT)
            .x;
        assert!(inside > 0.95 && between < 0.05, "{inside} {between}");
    }

    #[test]
    fn automatic_color_space_decodes_only_8_bit_color() {
        let bytes = |channels: usize| Decoded {
            width: 1,
            height: 1,
            channels,
            samples: Samples::Bytes(vec![188; channels]),
        };
        let value =
            |channels: usize, space: ColorSpace| Image::new(bytes(channels), space).pixel(0, 0).x;
        let (raw, linear) = (188.0 / 255.0, 0.502_886);
        let cases = [
            (1, ColorSpace::Auto, raw),
            (2, ColorSpace::Auto, raw),
            (3, ColorSpace::Auto, linear),
            (4, ColorSpace::Auto, linear),
            (3, ColorSpace::Raw, raw),
            (1, ColorSpace::SRgb, linear),
        ];
        for (channels, space, expected) in cases {
            assert!(
                (value(channels, space) - expected).abs() < 1e-5,
                "{channels} {space:?}"
            );
        }
        let half = Samples::Half(vec![half::f16::from_f32(0.75); 3]);
        let image = Image::new(
            Decoded {
                width: 1,
                height: 1,
                channels: 3,
                samples: half,
            },
            ColorSpace::Auto,
        );
        assert_eq!(image.pixel(0, 0).x, 0.75);
    }
}
