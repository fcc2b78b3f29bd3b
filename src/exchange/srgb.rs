//! Linear light ↔ 8-bit sRGB (IEC 61966-2-1), by tables: exact to the rounding of the formula.

/// Values below 2^−13 are code 0: the first code begins at 1.5e-4 = 2^−12.7.
const LOWEST_EXPONENT: u32 = 127 - 13;

/// Bits of the mantissa that index the table of codes.
const MANTISSA_BITS: u32 = 8;

/// Tables both ways.
#[derive(Debug)]
pub(super) struct Srgb {
    /// Linear value of each code.
    linear: [f32; 256],
    /// Smallest linear value that rounds to each code.
    start: [f32; 257],
    /// Code of the lowest value of each interval of floats in 2^−13…1.
    codes: Vec<u8>,
}

impl Srgb {
    pub(super) fn new() -> Self {
        let mut linear = [0.0; 256];
        let mut start = [f32::INFINITY; 257];
        for code in 0..=u8::MAX {
            let at = usize::from(code);
            linear[at] = single(to_linear(f64::from(code) / 255.0));
            start[at] = single(to_linear((f64::from(code) - 0.5) / 255.0));
        }
        let count = (127 - LOWEST_EXPONENT) << MANTISSA_BITS;
        let low =
            |index: u32| f32::from_bits((LOWEST_EXPONENT << 23) + (index << (23 - MANTISSA_BITS)));
        let code = |value: f32| {
            start
                .iter()
                .skip(1)
                .filter(|start| **start <= value)
                .count()
        };
        let codes = (0..count).map(|index| u8::try_from(code(low(index))).unwrap_or(u8::MAX));
        Self {
            codes: codes.collect(),
            linear,
            start,
        }
    }

    /// Linear value of `code`.
    pub(super) fn decode(&self, code: u8) -> f32 {
        self.linear[usize::from(code)]
    }

    /// Code nearest to `value` after encoding; clipped, NaN is 0.
    pub(super) fn encode(&self, value: f32) -> u8 {
        if value >= 1.0 {
            return u8::MAX;
        }
        let first = LOWEST_EXPONENT << 23;
        if value.is_nan() || value < f32::from_bits(first) {
            return 0;
        }
        // an interval is narrower than a code, so that it meets one border at most
        let index = (value.to_bits() - first) >> (23 - MANTISSA_BITS);
        let code = self.codes[index as usize];
        code + u8::from(value >= self.start[usize::from(code) + 1])
    }
}

fn to_linear(encoded: f64) -> f64 {
    if encoded <= 0.040_45 {
        encoded / 12.92
    } else {
        ((encoded + 0.055) / 1.055).powf(2.4)
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "tables are single precision"
)]
fn single(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_the_formula_everywhere() {
        let tables = Srgb::new();
        let formula = |x: f64| {
            let encoded = match x <= 0.003_130_8 {
                true => 12.92 * x,
                false => 1.055 * x.powf(1.0 / 2.4) - 0.055,
            };
            (255.0 * encoded).round()
        };
        for i in 0..=1_000_000_u32 {
            let x = f64::from(i) / 1e6;
            let code = f64::from(tables.encode(single(x)));
            // at the border of two codes the formula itself depends on the last digits
            assert!(
                code == formula(x) || code == formula(x * (1.0 + 1e-6)),
                "{x}"
            );
        }
        for code in 0..=u8::MAX {
            assert_eq!(tables.encode(tables.decode(code)), code);
        }
        assert_eq!([f32::NAN, -1.0, 7.0].map(|x| tables.encode(x)), [0, 0, 255]);
    }
}
