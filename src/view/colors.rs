//! Values → 8-bit colors.

use super::channels::{Channel, ChannelKind};
use crate::math::srgb;
use glam::Vec3;

/// Color of nothing.
pub(super) const BACKGROUND: [u8; 3] = [38, 38, 42];

/// Color of what has no value in the channel shown.
pub(super) const MISSING: [u8; 3] = [104, 92, 104];

/// Anchors of the scale of false colors, sRGB, evenly spaced: dark blue over green to yellow with brightness rising all the
/// way, so that it can be read in gray too.
pub(super) const SCALE: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 45, 123],
    [59, 82, 139],
    [44, 114, 142],
    [33, 145, 140],
    [40, 174, 128],
    [94, 201, 98],
    [173, 220, 48],
    [253, 231, 37],
];

/// How the values of one channel become colors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Look {
    kind: ChannelKind,
    /// Factor on colors.
    gain: f32,
    /// Ends of the scale.
    range: (f32, f32),
}

impl Look {
    /// The look of `channel`, with the user's own range and stops where there are some.
    pub(super) fn new(channel: &Channel, range: Option<(f32, f32)>, exposure: Option<f32>) -> Self {
        Self {
            kind: channel.kind,
            gain: exposure.unwrap_or_else(|| channel.exposure()).exp2(),
            range: range.unwrap_or_else(|| channel.scale()),
        }
    }

    /// sRGB of `value`.
    pub(super) fn color(&self, value: Vec3) -> [u8; 3] {
        if value.is_nan() {
            return MISSING;
        }
        match self.kind {
            ChannelKind::Color => (value * self.gain).to_array().map(srgb::code),
            ChannelKind::Direction => (0.5 * value + 0.5).to_array().map(srgb::byte),
            ChannelKind::Id => hue(value.x),
            ChannelKind::Scalar => {
                let (low, high) = self.range;
                false_color((value.x - low) / (high - low))
            }
        }
    }
}

/// Color at 0…1 of the scale.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "an index of nine anchors"
)]
pub(super) fn false_color(at: f32) -> [u8; 3] {
    let last = SCALE.len() - 1;
    let place = at.clamp(0.0, 1.0) * last as f32;
    let index = (place as usize).min(last - 1);
    let part = place - index as f32;
    let mix = |k: usize| {
        let [a, b] = [index, index + 1].map(|i| f32::from(SCALE[i][k]));
        srgb::byte((a + (b - a) * part) / 255.0)
    };
    [mix(0), mix(1), mix(2)]
}

/// Hues in steps of the golden angle: neighbors differ; gray for none.
fn hue(id: f32) -> [u8; 3] {
    if id < 0.0 {
        return MISSING;
    }
    srgb::of_id(id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn false_colors_rise_in_brightness_all_the_way() {
        let luma = |at: f32| {
            let [r, g, b] = false_color(at).map(f32::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let steps: Vec<f32> = (0..=100_u8).map(|i| luma(f32::from(i) / 100.0)).collect();
        assert!(steps.windows(2).all(|pair| pair[1] >= pair[0] - 0.5));
        assert_eq!(false_color(-3.0), SCALE[0]);
        assert_eq!(false_color(f32::INFINITY), SCALE[8]);
    }
}
