//! Axis-aligned boxes.

use glam::Vec3;

/// An axis-aligned box; empty when `min > max` on any axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds3 {
    /// Lowest corner.
    pub min: Vec3,
    /// Highest corner.
    pub max: Vec3,
}

impl Default for Bounds3 {
    /// The empty box.
    fn default() -> Self {
        Self::EMPTY
    }
}

impl Bounds3 {
    /// Contains nothing; the neutral element of [`Self::union`].
    pub const EMPTY: Self = Self {
        min: Vec3::INFINITY,
        max: Vec3::NEG_INFINITY,
    };

    /// The smallest box around `points`; [`Self::EMPTY`] for none.
    pub fn around(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, Self::including)
    }

    /// The smallest box around this one and `point`.
    #[must_use]
    pub fn including(self, point: Vec3) -> Self {
        Self {
            min: self.min.min(point),
            max: self.max.max(point),
        }
    }

    /// The smallest box around both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    /// True when it contains no point at all.
    pub fn is_empty(&self) -> bool {
        self.min.cmpgt(self.max).any()
    }

    /// Length of the diagonal, 0 when empty.
    pub fn diagonal(&self) -> f32 {
        if self.is_empty() {
            0.0
        } else {
            (self.max - self.min).length()
        }
    }

    /// Middle of the box; meaningless when empty.
    pub fn center(&self) -> Vec3 {
        0.5 * (self.min + self.max)
    }

    /// True when `point` lies inside or on the box.
    pub fn contains(&self, point: Vec3) -> bool {
        point.cmpge(self.min).all() && point.cmple(self.max).all()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_box_is_neutral_under_union_and_has_no_size() {
        let unit = Bounds3::around([Vec3::ZERO, Vec3::ONE]);
        assert_eq!(Bounds3::EMPTY.union(unit), unit);
        assert!(Bounds3::EMPTY.is_empty());
        assert_eq!(Bounds3::EMPTY.diagonal(), 0.0);
        assert!(unit.contains(Vec3::splat(0.5)) && !unit.contains(Vec3::splat(1.5)));
    }
}
