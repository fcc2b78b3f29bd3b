//! Boxes while a tree is built: four numbers to a register, of which three count.

use super::Item;
use glam::{Vec4, Vec4Swizzles};

/// An item's box, and its index in the bits of the fourth number.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bound {
    /// Lowest corner, and the index as the bits of a small normal number.
    pub(super) low: Vec4,
    /// Highest corner, and 1, which the small number vanishes beside.
    pub(super) high: Vec4,
}

/// Bits of the least normal number: indices are below 2^29, so that their sums with it are numbers too.
const NORMAL: u32 = 1 << 23;

impl Bound {
    pub(super) fn of(item: Item) -> Self {
        Self {
            low: item.bounds.min.extend(f32::from_bits(item.index + NORMAL)),
            high: item.bounds.max.extend(1.0),
        }
    }

    /// True if the box is: the index always is a finite number.
    pub(super) fn is_finite(&self) -> bool {
        self.low.is_finite() && self.high.is_finite()
    }

    pub(super) fn index(&self) -> u32 {
        self.low.w.to_bits() - NORMAL
    }

    /// Twice the middle; its fourth number means nothing.
    pub(super) fn center(&self) -> Vec4 {
        self.low + self.high
    }
}

/// What items span. Fourth numbers mean nothing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extent {
    /// Of their boxes.
    pub(super) low: Vec4,
    pub(super) high: Vec4,
    /// Of twice their middles.
    pub(super) low_center: Vec4,
    pub(super) high_center: Vec4,
}

impl Extent {
    /// Lowest and highest corner of no box.
    pub(super) const NO_BOX: (Vec4, Vec4) = (Vec4::INFINITY, Vec4::NEG_INFINITY);

    /// Of no item.
    pub(super) const EMPTY: Self = Self {
        low: Vec4::INFINITY,
        high: Vec4::NEG_INFINITY,
        low_center: Vec4::INFINITY,
        high_center: Vec4::NEG_INFINITY,
    };

    pub(super) fn around(items: &[Bound]) -> Self {
        let mut extent = Self::EMPTY;
        for &item in items {
            extent.include(item);
        }
        extent
    }

    pub(super) fn include(&mut self, item: Bound) {
        let center = item.center();
        self.low = self.low.min(item.low);
        self.high = self.high.max(item.high);
        self.low_center = self.low_center.min(center);
        self.high_center = self.high_center.max(center);
    }

    /// Of both.
    pub(super) fn union(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            low_center: self.low_center.min(other.low_center),
            high_center: self.high_center.max(other.high_center),
        }
    }

    pub(super) fn half_area(&self) -> f32 {
        half_area(self.high - self.low)
    }

    /// Along which the middles are farthest apart.
    pub(super) fn longest_axis(&self) -> usize {
        let size = self.high_center - self.low_center;
        (0..3)
            .max_by(|&a, &b| size[a].total_cmp(&size[b]))
            .expect("there are three axes")
    }
}

/// Half the surface of a box of this size.
pub(super) fn half_area(size: Vec4) -> f32 {
    size.xyz().dot(size.yzx())
}
