//! Errors at a camera's receivers → a false-color picture: blue too dark, white right, red too bright.

use crate::results::Target;

/// Errors as the camera sees them.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorPicture {
    /// What is shown.
    pub title: String,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Error over the truth's mean at full color.
    pub scale: f64,
    /// 8-bit sRGB, rows from the top; gray where nothing is seen.
    pub rgb: Vec<u8>,
}

/// Color where nothing is seen.
const NOTHING: [u8; 3] = [110, 110, 110];

/// A picture of `errors` (signed, `components` a receiver, averaged), one a receiver of `target`; `None` if that is no
/// image.
pub fn picture(title: String, errors: &[f64], target: &Target, scale: f64) -> Option<ErrorPicture> {
    let Target::Image {
        width,
        height,
        shares,
    } = target
    else {
        return None;
    };
    let pixels = *width as usize * *height as usize;
    let receivers = shares.iter().map(|share| share.receiver as usize + 1).max();
    let components = errors.len() / receivers.unwrap_or(1).max(1);
    let mut sums = vec![(0.0, 0.0); pixels];
    for share in shares {
        let start = share.receiver as usize * components;
        let Some(values) = errors.get(start..start + components) else {
            continue;
        };
        let (sum, weight) = &mut sums[share.pixel as usize];
        let share = f64::from(share.weight);
        *sum += share * values.iter().sum::<f64>() / components.max(1) as f64;
        *weight += share;
    }
    let color = |&(sum, weight): &(f64, f64)| {
        if weight > 0.0 {
            color(sum / weight / scale)
        } else {
            NOTHING
        }
    };
    Some(ErrorPicture {
        title,
        width: *width,
        height: *height,
        scale,
        rgb: sums.iter().flat_map(color).collect(),
    })
}

/// Color of `x` from −1 (blue) over 0 (white) to 1 (red).
pub(super) fn color(x: f64) -> [u8; 3] {
    const ENDS: [[f64; 3]; 2] = [[33.0, 102.0, 172.0], [178.0, 24.0, 43.0]];
    let end = ENDS[usize::from(x > 0.0)];
    let amount = if x.is_finite() { x.abs().min(1.0) } else { 1.0 };
    end.map(|channel| byte(255.0 + (channel - 255.0) * amount))
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 0…255"
)]
fn byte(value: f64) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::PixelShare;

    #[test]
    fn pixels_take_the_color_of_their_receivers_error() {
        let share = |pixel, receiver| PixelShare {
            pixel,
            receiver,
            weight: 1.0,
        };
        let target = Target::Image {
            width: 3,
            height: 1,
            shares: vec![share(0, 0), share(2, 1)],
        };
        let made = picture("t".to_owned(), &[0.1, -0.1], &target, 0.1).unwrap();
        assert_eq!(made.rgb[..3], color(1.0));
        assert_eq!(made.rgb[3..6], NOTHING);
        assert_eq!(made.rgb[6..], color(-1.0));
        assert!(picture(String::new(), &[], &Target::Surfels, 1.0).is_none());
    }

    #[test]
    fn no_error_is_white() {
        assert_eq!(color(0.0), [255; 3]);
        assert_eq!(color(9.0), color(1.0));
    }
}
