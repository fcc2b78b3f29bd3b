//! Color of a black body as `UsdLuxBlackbodyTemperatureAsRgb` defines it: a Catmull-Rom spline through the linear
//! Rec.709 colors at every 500 K, scaled to the luminance of white.

use glam::Vec3;

/// Temperature of the first knot, kelvin; lower ones are clamped.
const FIRST: f32 = 1000.0;
/// Between knots, kelvin.
const STEP: f32 = 500.0;

/// Linear Rec.709 with the largest component 1 (J. Walker, *Colour Rendering of Spectra*).
const KNOTS: [[f32; 3]; 19] = [
    [1.0, 0.027_490, 0.0],
    [1.0, 0.149_664, 0.0],
    [1.0, 0.256_644, 0.008_095],
    [1.0, 0.372_033, 0.067_450],
    [1.0, 0.476_725, 0.153_601],
    [1.0, 0.570_376, 0.259_196],
    [1.0, 0.653_480, 0.377_155],
    [1.0, 0.726_878, 0.501_606],
    [1.0, 0.791_543, 0.628_050],
    [1.0, 0.848_462, 0.753_228],
    [1.0, 0.898_581, 0.874_905],
    [1.0, 0.942_771, 0.991_642],
    [0.906_947, 0.890_456, 1.0],
    [0.828_247, 0.841_838, 1.0],
    [0.765_791, 0.801_896, 1.0],
    [0.715_255, 0.768_579, 1.0],
    [0.673_683, 0.740_423, 1.0],
    [0.638_992, 0.716_359, 1.0],
    [0.609_681, 0.695_588, 1.0],
];

/// Color of a black body at `kelvin` (clamped to 1000…10000), luminance 1, components ≥ 0. NaN stays NaN.
pub(super) fn color(kelvin: f32) -> Vec3 {
    let last = KNOTS.len() - 1;
    let steps = ((kelvin - FIRST) / STEP).clamp(0.0, 18.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "0…18, or NaN, which becomes 0"
    )]
    let segment = (steps as usize).min(last - 1);
    let knot = |index: usize| Vec3::from_array(KNOTS[index.min(last)]);
    let before = knot(segment.saturating_sub(1));
    let (start, end) = (knot(segment), knot(segment + 1));
    let after = knot(segment + 2);
    let (from, to) = ((end - before) * 0.5, (after - start) * 0.5);
    let t = steps - f32::from(u8::try_from(segment).unwrap_or(0));
    let hermite = start * ((1.0 + 2.0 * t) * (1.0 - t) * (1.0 - t))
        + from * (t * (1.0 - t) * (1.0 - t))
        + end * (t * t * (3.0 - 2.0 * t))
        + to * (t * t * (t - 1.0));
    let luminance = hermite.dot(Vec3::new(0.2126, 0.7152, 0.0722));
    (hermite / luminance).max(Vec3::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Printed by `pxr.UsdLux.BlackbodyTemperatureAsRgb` (usd-core 26.11).
    const USD_CORE: [(f32, [f32; 3]); 12] = [
        (100.0, [4.305_504_3, 0.118_358_31, 0.0]),
        (1000.0, [4.305_504_3, 0.118_358_31, 0.0]),
        (2000.0, [2.520_566_2, 0.646_888_26, 0.020_403_985]),
        (1300.0, [3.555_754_2, 0.341_437_8, 0.0]),
        (2250.0, [2.273_284_7, 0.714_906, 0.074_777_424]),
        (3333.0, [1.625_849_2, 0.878_426_8, 0.361_408_6]),
        (4000.0, [1.414_028_2, 0.924_039_07, 0.533_307_8]),
        (5000.0, [1.213_508_6, 0.960_544_3, 0.762_144_15]),
        (6500.0, [1.043_333_4, 0.983_624_46, 1.034_613_3]),
        (8000.0, [0.947_147_85, 0.991_803_35, 1.236_823]),
        (9800.0, [0.876_758_9, 0.994_605_9, 1.416_327_7]),
        (12000.0, [0.871_841_3, 0.994_687_9, 1.429_995_9]),
    ];

    #[test]
    fn colors_equal_those_of_usd_core() {
        for (kelvin, expected) in USD_CORE {
            let found = color(kelvin);
            assert!(
                (found - Vec3::from_array(expected)).abs().max_element() < 1e-5,
                "{kelvin}: {found}"
            );
        }
    }
}
