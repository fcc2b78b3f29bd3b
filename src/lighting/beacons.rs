//! What is quickly told of the strength of many lights at a place, so that few of them need a closer look.

use super::ShadePoint;
use glam::Vec3;

/// A ball around a light and what it sends out, about.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beacon {
    pub(super) center: Vec3,
    pub(super) radius: f32,
    /// Radiance, its channels summed, times area.
    pub(super) strength: f32,
}

/// Lights that are weighed at a time.
const ROW: usize = 64;

/// Those of all lights, one column a quantity: places weigh all lights. Lights infinitely far have none.
#[derive(Debug, Default)]
pub(super) struct Beacons {
    center: [Vec<f32>; 3],
    radius: Vec<f32>,
    strength: Vec<f32>,
    /// Indices of the lights without one.
    far: Vec<usize>,
}

impl Beacons {
    /// One a light, in their order.
    pub(super) fn new(all: impl Iterator<Item = Option<Beacon>>) -> Self {
        let mut beacons = Self::default();
        for (index, beacon) in all.enumerate() {
            let Beacon {
                center,
                radius,
                strength,
            } = beacon.unwrap_or(Beacon {
                center: Vec3::ZERO,
                radius: 0.0,
                strength: 0.0,
            });
            let columns = beacons.center.iter_mut().zip(center.to_array());
            columns.for_each(|(column, x)| column.push(x));
            beacons.radius.push(radius);
            beacons.strength.push(strength);
            if beacon.is_none() {
                beacons.far.push(index);
            }
        }
        beacons
    }

    /// Calls `look` with the index and [`Self::at`] of each light, a row of them weighed at a time.
    #[inline(always)]
    pub(super) fn for_each(&self, point: &ShadePoint, mut look: impl FnMut(usize, f32)) {
        let mut weights = [0.0; ROW];
        for first in (0..self.radius.len()).step_by(ROW) {
            let count = (self.radius.len() - first).min(ROW);
            self.weigh(point, first, &mut weights[..count]);
            (first..)
                .zip(&weights[..count])
                .for_each(|(index, &weight)| look(index, weight));
        }
    }

    /// Indices of the lights that are infinitely far, ascending.
    pub(super) fn far(&self) -> &[usize] {
        &self.far
    }

    /// About the irradiance at `point` from light `index`, its channels summed, if nothing is in the way: within a factor where
    /// the light faces it, above 0 wherever there is any. 0 for lights infinitely far.
    pub(super) fn at(&self, index: usize, point: &ShadePoint) -> f32 {
        let center = Vec3::from_array([0, 1, 2].map(|k| self.center[k][index]));
        weight(point, center, (self.radius[index], self.strength[index]))
    }

    /// [`Self::at`] of as many lights as `weights`, from `first` on.
    pub(super) fn weigh(&self, point: &ShadePoint, first: usize, weights: &mut [f32]) {
        let row = first..first + weights.len();
        let [x, y, z] = (self.center.each_ref()).map(|column| &column[row.clone()]);
        let (radius, strength) = (&self.radius[row.clone()], &self.strength[row]);
        for k in 0..weights.len() {
            weights[k] = weight(point, Vec3::new(x[k], y[k], z[k]), (radius[k], strength[k]));
        }
    }
}

/// Without branches: rows of lights are weighed side by side.
#[inline(always)]
fn weight(point: &ShadePoint, center: Vec3, (radius, strength): (f32, f32)) -> f32 {
    let way = center - point.position;
    let squared = way.length_squared().max(f32::MIN_POSITIVE);
    let inverse = squared.sqrt().recip();
    let (cosine, edge) = (point.normal.dot(way) * inverse, radius * inverse);
    let share = (cosine.max(0.0) + edge).min(1.0);
    let weight = strength * share / (squared + radius * radius);
    if cosine + edge > 0.0 { weight } else { 0.0 }
}
