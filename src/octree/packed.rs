//! [`Node`]s and [`Lobes`] as they are stored: a cache line a node.

use super::FEW;
use super::lobe_sums::{LobeSums, Rows};
use super::node::{Lobes, Node};
use crate::math::packing::{
    DIRECTION_ERROR, pack_color, pack_direction, power_of_two, rounded, unpack_color,
    unpack_direction,
};
use crate::math::sh::Sh9;
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Mantissa bits of reflected power: 4e−6 of the largest channel.
const REFLECTED_BITS: u32 = 18;

/// Mantissa bits of emitted power, which no quantity depends on closely: 0.1 % of the largest channel.
const EMITTED_BITS: u32 = 10;

/// What facing area of all the area is stored as.
const FACING_STEPS: f32 = 65_535.0;

/// What an angle of π is stored as, before it is rounded up.
const ANGLE_STEPS: f32 = 65_534.0;

/// What a variance of the scale or the largest coefficient of a series is stored as.
const SIGNED_STEPS: f32 = 32_767.0;

/// What a box's edge of the ball's diameter is stored as.
const SIZE_STEPS: f32 = 255.0;

/// Bits of `flags`: the count less one, and what kind of node it is.
const COUNT_MASK: u8 = 0b1111;
const IS_LEAF: u8 = 1 << 4;
const IS_SCATTERED: u8 = 1 << 5;

/// A node in 64 bytes. What bounds is rounded up: radius, spread, size.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(super) struct PackedNode {
    reflected_power: u64,
    center: Vec3,
    area: f32,
    first: u32,
    lobes: u32,
    normal: u32,
    /// By 2 to the power of `variance_exponent` − 127.
    covariance: [i16; 6],
    /// The upper half of an f32.
    radius: u16,
    spread: u16,
    /// Of the area.
    facing: u16,
    variance_exponent: u8,
    flags: u8,
    emitted_power: [u8; 5],
    /// Of the ball's diameter.
    size: [u8; 3],
}

const _: () = assert!(size_of::<PackedNode>() == 64);

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "fractions of the steps there are, rounded; casts of floats saturate"
)]
impl PackedNode {
    pub(super) fn of(node: &Node) -> Self {
        let normal = pack_direction(node.normal);
        let radius_bits = (node.radius.to_bits().saturating_add(0xffff) >> 16) as u16;
        let spread = (node.spread + DIRECTION_ERROR).min(PI) * (ANGLE_STEPS / PI);
        let facing = if node.area > 0.0 {
            node.facing_area / node.area * FACING_STEPS + 0.5
        } else {
            0.0
        };
        let largest = node.covariance.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        let variance_exponent = ((largest.to_bits() >> 23) + 1).min(254);
        let per_step = power_of_two(variance_exponent.cast_signed() - 127) / SIGNED_STEPS;
        let diameter = 2.0 * unpack_radius(radius_bits);
        let per_edge = if diameter > 0.0 {
            SIZE_STEPS / diameter
        } else {
            0.0
        };
        let emitted = pack_color(node.emitted_power, EMITTED_BITS).to_le_bytes();
        let flag = |is: bool, bit: u8| if is { bit } else { 0 };
        Self {
            reflected_power: pack_color(node.reflected_power, REFLECTED_BITS),
            center: node.center,
            area: node.area,
            first: node.first,
            lobes: node.lobes,
            normal,
            covariance: node.covariance.map(|c| rounded(c / per_step)),
            radius: radius_bits,
            spread: spread as u16 + 1,
            facing: facing as u16,
            variance_exponent: variance_exponent as u8,
            flags: (node.count as u8).wrapping_sub(1) & COUNT_MASK
                | flag(node.is_leaf, IS_LEAF)
                | flag(node.is_scattered, IS_SCATTERED),
            emitted_power: std::array::from_fn(|i| emitted[i]),
            size: (node.size * per_edge)
                .to_array()
                .map(|edge| (edge as u8).saturating_add(1)),
        }
    }

    #[inline(always)]
    pub(super) fn unpack(&self) -> Node {
        let radius = unpack_radius(self.radius);
        let exponent = i32::from(self.variance_exponent) - 127;
        let per_step = power_of_two(exponent) / SIGNED_STEPS;
        let [a, b, c, d, e] = self.emitted_power;
        let emitted = u64::from_le_bytes([a, b, c, d, e, 0, 0, 0]);
        Node {
            center: self.center,
            radius,
            normal: unpack_direction(self.normal),
            spread: f32::from(self.spread) * (PI / ANGLE_STEPS),
            area: self.area,
            facing_area: f32::from(self.facing) * (self.area / FACING_STEPS),
            size: Vec3::from(self.size.map(f32::from)) * (2.0 * radius / SIZE_STEPS),
            covariance: self.covariance.map(|c| f32::from(c) * per_step),
            reflected_power: unpack_color(self.reflected_power, REFLECTED_BITS),
            emitted_power: unpack_color(emitted, EMITTED_BITS),
            is_scattered: self.flags & IS_SCATTERED != 0,
            first: self.first,
            count: u32::from(self.flags & COUNT_MASK) + 1,
            is_leaf: self.flags & IS_LEAF != 0,
            lobes: self.lobes,
        }
    }
}

#[inline(always)]
fn unpack_radius(bits: u16) -> f32 {
    f32::from_bits(u32::from(bits) << 16)
}

/// A series, each coefficient off by at most 2⁻¹⁶ of the largest.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PackedSeries {
    scale: f32,
    coefficients: [i16; 9],
}

impl PackedSeries {
    /// One for each column of `rows`.
    fn of(rows: &Rows) -> [Self; 4] {
        let largest = rows
            .iter()
            .fold(Vec4::ZERO, |most, row| most.max(row.abs()));
        let scale = largest / SIGNED_STEPS;
        let inverse = Vec4::select(scale.cmpgt(Vec4::ZERO), scale.recip(), Vec4::ZERO);
        let steps = rows.map(|row| (row * inverse).to_array().map(rounded));
        std::array::from_fn(|column| Self {
            scale: scale[column],
            coefficients: steps.map(|row| row[column]),
        })
    }

    fn unpack(&self) -> Sh9 {
        Sh9(self.coefficients.map(|c| f32::from(c) * self.scale))
    }
}

/// Lobes of all spread nodes; emission only of those that emit.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct PackedLobes {
    shown: Vec<[PackedSeries; 4]>,
    /// Lobes that emit, ascending.
    emitted: Vec<(u32, [PackedSeries; 3])>,
}

impl PackedLobes {
    pub(super) fn len(&self) -> usize {
        self.shown.len()
    }

    /// Append those of spread nodes.
    pub(super) fn append(&mut self, lobes: &[&LobeSums]) {
        let places = u32::try_from(self.shown.len()).expect("fewer nodes than surfels")..;
        let shown = lobes.par_iter().with_min_len(FEW);
        (self.shown).par_extend(shown.map(|lobe| PackedSeries::of(&lobe.shown)));
        let emitted = places.zip(lobes).filter_map(|(place, lobe)| {
            let [_, channels @ ..] = PackedSeries::of(lobe.emitted.as_ref()?);
            Some((place, channels))
        });
        self.emitted.extend(emitted);
    }

    pub(super) fn get(&self, index: u32) -> Lobes {
        let [area, reflected @ ..] = self.shown[index as usize]
            .each_ref()
            .map(PackedSeries::unpack);
        let found = self
            .emitted
            .binary_search_by_key(&index, |&(index, _)| index);
        let emitted = found.map(|i| self.emitted[i].1.each_ref().map(PackedSeries::unpack));
        Lobes {
            area,
            reflected,
            emitted: emitted.unwrap_or_default(),
        }
    }

    pub(super) fn bytes(&self) -> usize {
        self.shown.len() * size_of::<[PackedSeries; 4]>()
            + self.emitted.len() * size_of::<(u32, [PackedSeries; 3])>()
    }
}
