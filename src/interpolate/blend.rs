//! Seeds around a receiver → its values. PBGI §9.

use super::seeds::{ALIKE, Seeds};
use crate::receivers::Receivers;
use glam::Vec3;

/// Distance off a seed's plane counts this many times as much as along it.
const OFF_PLANE: f32 = 3.0;

/// A blend may leave the range of the values it is made of by this share of it: gradients foretell what is between seeds,
/// not what is beyond them.
const BEYOND: f32 = 0.25;

/// A receiver this near to a seed, as a share of the distance to the farthest, is at it.
const AT_SEED: f32 = 1e-6;

/// A seed as a blend sees it.
#[derive(Debug, Clone, Copy)]
struct Voice {
    seed: u32,
    distance: f32,
    alike: f32,
}

/// Blends values at one receiver after the other; memory is reused.
#[derive(Debug)]
pub(super) struct Blend<'a> {
    seeds: &'a Seeds,
    /// Change of each component of each seed with place, per stage unit.
    gradients: &'a [Vec3],
    voices: Vec<Voice>,
}

impl<'a> Blend<'a> {
    pub(super) fn new(seeds: &'a Seeds, gradients: &'a [Vec3]) -> Self {
        Self {
            seeds,
            gradients,
            voices: Vec::new(),
        }
    }

    /// Write the values at receiver `i` to `out`, from the seeds `asked`; false if none of these may speak for it.
    ///
    /// Weights fall to zero at the farthest seed (Franke and Little's for Shepard's method) and grow without bound at each:
    /// values are continuous, and those of the seeds are met.
    pub(super) fn at(
        &mut self,
        receivers: &Receivers,
        i: usize,
        asked: &[u32],
        out: &mut [f32],
    ) -> bool {
        let normal = receivers.normal[i];
        self.listen(receivers.position[i], normal, asked);
        let farthest = self
            .voices
            .iter()
            .map(|voice| voice.distance)
            .fold(0.0, f32::max);
        let weight = |voice: &Voice| {
            let share = (voice.distance / farthest).max(AT_SEED);
            voice.alike * (1.0 / share - 1.0).powi(2)
        };
        let mut sum = 0.0_f64;
        let mut total = [0.0_f64; MOST_COMPONENTS];
        let mut range = [(f32::INFINITY, f32::NEG_INFINITY); MOST_COMPONENTS];
        for voice in &self.voices {
            let weight = f64::from(weight(voice));
            let offset = receivers.position[i] - self.seeds.position[voice.seed as usize];
            let n = self.seeds.components;
            let gradients = &self.gradients[voice.seed as usize * n..][..n];
            let told = (0..n).zip(gradients).zip(&mut total).zip(&mut range);
            for (((component, gradient), total), range) in told {
                let value = self.seeds.turned(voice.seed, component, normal);
                *total += weight * f64::from(value + gradient.dot(offset));
                *range = (range.0.min(value), range.1.max(value));
            }
            sum += weight;
        }
        if sum <= 0.0 {
            return false;
        }
        for ((out, total), (low, high)) in out.iter_mut().zip(total).zip(range) {
            let beyond = BEYOND * (high - low);
            #[expect(clippy::cast_possible_truncation, reason = "rounded once, at its end")]
            let value = (total / sum) as f32;
            *out = value.clamp(low - beyond, high + beyond);
        }
        true
    }

    /// Find out who of `asked` may speak, and how far away they are.
    fn listen(&mut self, position: Vec3, normal: Vec3, asked: &[u32]) {
        let seeds = self.seeds;
        let voice = |&seed: &u32| {
            let other = seeds.normal[seed as usize];
            let alike = (other.dot(normal) - ALIKE) / (1.0 - ALIKE);
            let offset = position - seeds.position[seed as usize];
            let off_plane = OFF_PLANE * offset.dot(other);
            (alike > 0.0).then(|| Voice {
                seed,
                distance: offset.length().hypot(off_plane),
                alike,
            })
        };
        self.voices.clear();
        self.voices.extend(asked.iter().filter_map(voice));
    }
}

/// Components of all that is interpolated at once, at most.
pub(super) const MOST_COMPONENTS: usize = 16;

#[cfg(test)]
mod tests {
    use super::super::seeds::testing::seeds_at;
    use super::*;
    use crate::gather::testing::receivers_at;
    use crate::trace::testing::Random;

    fn blended(seeds: &Seeds, gradient: Vec3, place: Vec3, normal: Vec3) -> Option<f32> {
        let gradients = vec![gradient; seeds.len()];
        let receivers = receivers_at(&[(place, normal)]);
        let mut out = [f32::NAN];
        let asked: Vec<u32> = seeds.all().collect();
        let is_told = Blend::new(seeds, &gradients).at(&receivers, 0, &asked, &mut out);
        is_told.then_some(out[0])
    }

    fn scattered(value: impl Fn(Vec3) -> f32) -> Seeds {
        let mut random = Random(5);
        let place = |_| {
            let place = random.vector() * Vec3::new(1.0, 0.0, 1.0);
            (place, Vec3::Y, value(place), Vec3::ZERO)
        };
        seeds_at(&(0..20).map(place).collect::<Vec<_>>())
    }

    #[test]
    fn planes_are_met_everywhere_and_values_at_seeds() {
        let slope = Vec3::new(1.0, 0.0, -2.0);
        let seeds = scattered(|p| 5.0 + slope.dot(p));
        for place in [Vec3::ZERO, Vec3::new(0.3, 0.0, -0.2)] {
            let told = blended(&seeds, slope, place, Vec3::Y).unwrap();
            assert!((told - 5.0 - slope.dot(place)).abs() < 1e-4);
        }
        let bumpy = scattered(|p| (9.0 * p.x).sin());
        for seed in [0, 7, 19] {
            let told = blended(&bumpy, Vec3::ZERO, bumpy.position[seed], Vec3::Y).unwrap();
            assert!((told - bumpy.values[seed]).abs() < 1e-5);
        }
    }

    #[test]
    fn values_are_continuous() {
        let seeds = scattered(|p| (9.0 * p.x).sin() + p.z);
        let at = |x: f32| blended(&seeds, Vec3::ZERO, Vec3::new(x, 0.0, 0.1), Vec3::Y).unwrap();
        let step = 1e-3_f32;
        let steps =
            (-900..900_i16).map(|k| (at(f32::from(k + 1) * step) - at(f32::from(k) * step)).abs());
        assert!(steps.fold(0.0, f32::max) < 0.05);
    }

    #[test]
    fn only_those_who_look_the_same_way_speak_and_one_alone_does_not() {
        let seeds = scattered(|_| 1.0);
        assert_eq!(blended(&seeds, Vec3::ZERO, Vec3::ZERO, Vec3::Y), Some(1.0));
        assert_eq!(blended(&seeds, Vec3::ZERO, Vec3::ZERO, -Vec3::Y), None);
        let one = seeds_at(&[(Vec3::ZERO, Vec3::Y, 1.0, Vec3::ZERO)]);
        assert_eq!(blended(&one, Vec3::ZERO, Vec3::X, Vec3::Y), None);
    }
}
