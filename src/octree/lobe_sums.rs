//! [`Lobes`](super::Lobes) while they are summed: four quantities side by side, added by one instruction.

use crate::math::sh::{CLAMPED_COSINE, COEFFICIENT_COUNT, Sh9};
use glam::{Vec3, Vec4};

/// Series of four quantities, coefficient by coefficient.
pub(super) type Rows = [Vec4; COEFFICIENT_COUNT];

/// What a leaf, a node or a flat part of one shows, as series of the direction.
#[derive(Debug, Clone, Default)]
pub(super) struct LobeSums {
    /// Of the area in the first column, of reflected power in the others.
    pub shown: Rows,
    /// Of nothing in the first column, of emitted power in the others. None where nothing emits.
    pub emitted: Option<Box<Rows>>,
}

impl LobeSums {
    /// Add `area`, all of whose normals are `normal`, of `reflected` and `emitted` power an area.
    #[inline(always)]
    pub(super) fn add_disk(&mut self, normal: Vec3, area: f32, (reflected, emitted): (Vec3, Vec3)) {
        let cosine = Sh9::clamped_cosine(normal) * area;
        self.add_series(&cosine, 1.0, (reflected, emitted));
    }

    /// Add `area` of power `reflected` and `emitted` in all, whose normals are scattered about `normal`; their mean has
    /// the length `flatness`. That weakens band l of the clamped cosine as diffusion on the sphere does, by
    /// flatness^(l(l+1)/2): band 0, the sum of the areas, stays exact.
    pub(super) fn add_flat(
        &mut self,
        (normal, flatness): (Vec3, f32),
        area: f32,
        (reflected, emitted): (Vec3, Vec3),
    ) {
        let [band0, band1, band2] = CLAMPED_COSINE;
        let cosine = Sh9::zonal(normal, [band0, band1 * flatness, band2 * flatness.powi(3)]);
        self.add_series(&cosine, area, (reflected, emitted));
    }

    /// Add `series` times each of these.
    #[inline(always)]
    fn add_series(&mut self, series: &Sh9, area: f32, (reflected, emitted): (Vec3, Vec3)) {
        add(&mut self.shown, series, behind(area, reflected));
        if emitted != Vec3::ZERO {
            add(self.emitted_rows(), series, behind(0.0, emitted));
        }
    }

    /// Add those of a child.
    pub(super) fn add_child(&mut self, child: &Self) {
        let plus = |sums: &mut Rows, own: &Rows| {
            sums.iter_mut().zip(own).for_each(|(sum, &own)| *sum += own);
        };
        plus(&mut self.shown, &child.shown);
        if let Some(own) = &child.emitted {
            plus(self.emitted_rows(), own);
        }
    }

    fn emitted_rows(&mut self) -> &mut Rows {
        self.emitted.get_or_insert_default()
    }
}

#[inline(always)]
fn add(sums: &mut Rows, series: &Sh9, factors: Vec4) {
    for (sum, &coefficient) in sums.iter_mut().zip(&series.0) {
        *sum += factors * coefficient;
    }
}

#[inline(always)]
fn behind(first: f32, color: Vec3) -> Vec4 {
    Vec4::new(first, color.x, color.y, color.z)
}
