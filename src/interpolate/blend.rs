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

/// Seeds that are heard side by side.
const LANES: usize = 8;

type Lanes = [f32; LANES];

/// What [`LANES`] seeds say: of each, where it stands, and what is linear in place and normal. Lanes without a seed have
/// normals of zero, and nobody is like these.
#[derive(Debug, Clone, Copy, Default)]
struct Stands {
    position: [Lanes; 3],
    normal: [Lanes; 3],
}

/// One component of what they say.
#[derive(Debug, Clone, Copy, Default)]
struct Says {
    /// With the normal 0, at the origin of the blend.
    level: Lanes,
    turn: [Lanes; 3],
    gradient: [Lanes; 3],
    /// Change from the origin to where the seed stands.
    before: Lanes,
}

/// What the seeds around tell of each: component by component.
#[derive(Debug)]
pub(super) struct Around {
    /// Change with place, per stage unit.
    pub(super) gradient: Vec<Vec3>,
    /// To be added to its values.
    pub(super) shift: Vec<f32>,
}

/// Blends values from the same seeds at one receiver after the other.
#[derive(Debug)]
pub(super) struct Blend {
    /// Positions are relative to it.
    origin: Vec3,
    stands: Vec<Stands>,
    /// Component by component, each in the order of `stands`.
    says: Vec<Says>,
}

impl Blend {
    /// From the seeds `asked`, at least one, and what is `around` every seed.
    pub(super) fn new(seeds: &Seeds, around: &Around, asked: &[u32]) -> Self {
        let origin = seeds.position[asked[0] as usize];
        let n = seeds.components;
        let groups = asked.len().div_ceil(LANES);
        let mut stands = vec![Stands::default(); groups];
        let mut says = vec![Says::default(); n * groups];
        for (k, &seed) in asked.iter().enumerate() {
            let (group, lane, i) = (k / LANES, k % LANES, seed as usize);
            let position = seeds.position[i] - origin;
            for axis in 0..3 {
                stands[group].position[axis][lane] = position[axis];
                stands[group].normal[axis][lane] = seeds.normal[i][axis];
            }
            for component in 0..n {
                let place = i * n + component;
                let (turn, gradient) = (seeds.turns[place], around.gradient[place]);
                let own = &mut says[component * groups + group];
                let level = seeds.turned(seed, component, Vec3::ZERO);
                own.level[lane] = level + around.shift[place];
                own.before[lane] = gradient.dot(position);
                for axis in 0..3 {
                    own.turn[axis][lane] = turn[axis];
                    own.gradient[axis][lane] = gradient[axis];
                }
            }
        }
        Self {
            origin,
            stands,
            says,
        }
    }

    /// Write the values at receiver `i` to `out`, and how far what seeds say is from each, root of the mean square by weight, to
    /// `apart`; false if none of the seeds may speak for it. `voices` is room to work in.
    ///
    /// Weights fall to zero at the farthest seed (Franke and Little's for Shepard's method) and grow without bound at each:
    /// values are continuous, and those of the seeds, shifted, are met.
    pub(super) fn at(
        &self,
        (receivers, i): (&Receivers, usize),
        voices: &mut Vec<Voices>,
        (out, apart): (&mut [f32], &mut [f32]),
    ) -> bool {
        let (normal, place) = (receivers.normal[i], receivers.position[i] - self.origin);
        voices.clear();
        voices.extend(self.stands.iter().map(|stands| stands.heard(place, normal)));
        let farthest = (voices.iter().flat_map(|voices| voices.distance)).fold(0.0, f32::max);
        (voices.iter_mut()).for_each(|voices| voices.weigh(farthest));
        let sum = total(voices.iter().map(|voices| voices.weight));
        if sum <= 0.0 {
            return false;
        }
        let outs = out.iter_mut().zip(apart);
        for ((out, apart), says) in outs.zip(self.says.chunks_exact(voices.len())) {
            let mut range = (f32::INFINITY, f32::NEG_INFINITY);
            let mut squares = [0.0; LANES];
            let told = says.iter().zip(voices.iter()).map(|(says, voices)| {
                let (value, told) = says.at(place, normal);
                let mut weighted = [0.0; LANES];
                for lane in 0..LANES {
                    weighted[lane] = voices.weight[lane] * told[lane];
                    squares[lane] += weighted[lane] * told[lane];
                    if voices.alike[lane] > 0.0 {
                        range = (range.0.min(value[lane]), range.1.max(value[lane]));
                    }
                }
                weighted
            });
            #[expect(clippy::cast_possible_truncation, reason = "rounded once, at its end")]
            let value = (total(told) / sum) as f32;
            #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
            let square = (total(std::iter::once(squares)) / sum) as f32;
            *apart = (square - value * value).max(0.0).sqrt();
            let beyond = BEYOND * (range.1 - range.0);
            *out = value.clamp(range.0 - beyond, range.1 + beyond);
        }
        true
    }
}

/// How a receiver hears [`LANES`] seeds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Voices {
    /// 0 for those that may not speak.
    distance: Lanes,
    /// How much a seed looks the same way, up to 1; 0 and less for those that may not speak.
    alike: Lanes,
    weight: Lanes,
}

impl Voices {
    /// Fill `weight`, if the farthest of all that may speak is so far away.
    fn weigh(&mut self, farthest: f32) {
        for lane in 0..LANES {
            let share = (self.distance[lane] / farthest).max(AT_SEED);
            self.weight[lane] = self.alike[lane].max(0.0) * (1.0 / share - 1.0).powi(2);
        }
    }
}

impl Stands {
    fn heard(&self, place: Vec3, normal: Vec3) -> Voices {
        let mut voices = Voices {
            distance: [0.0; LANES],
            alike: [0.0; LANES],
            weight: [0.0; LANES],
        };
        let ([x, y, z], [a, b, c]) = (&self.position, &self.normal);
        for lane in 0..LANES {
            let (x, y, z) = (place.x - x[lane], place.y - y[lane], place.z - z[lane]);
            let (a, b, c) = (a[lane], b[lane], c[lane]);
            let alike = a * normal.x + b * normal.y + c * normal.z - ALIKE;
            let off_plane = OFF_PLANE * (x * a + y * b + z * c);
            let distance = (x * x + y * y + z * z + off_plane * off_plane).sqrt();
            voices.alike[lane] = alike / (1.0 - ALIKE);
            voices.distance[lane] = if alike > 0.0 { distance } else { 0.0 };
        }
        voices
    }
}

impl Says {
    /// With that normal where each stands, and at `place`.
    fn at(&self, place: Vec3, normal: Vec3) -> (Lanes, Lanes) {
        let (mut value, mut told) = ([0.0; LANES], [0.0; LANES]);
        let ([a, b, c], [x, y, z]) = (&self.turn, &self.gradient);
        for lane in 0..LANES {
            value[lane] =
                self.level[lane] + a[lane] * normal.x + b[lane] * normal.y + c[lane] * normal.z;
            told[lane] = value[lane] - self.before[lane]
                + (x[lane] * place.x + y[lane] * place.y + z[lane] * place.z);
        }
        (value, told)
    }
}

/// Sum of all lanes.
fn total(all: impl Iterator<Item = Lanes>) -> f64 {
    let mut sum = [0.0_f32; LANES];
    for lanes in all {
        for (sum, lane) in sum.iter_mut().zip(lanes) {
            *sum += lane;
        }
    }
    sum.into_iter().map(f64::from).sum()
}

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
        let around = Around {
            shift: vec![0.0; gradients.len()],
            gradient: gradients,
        };
        let blend = Blend::new(seeds, &around, &asked);
        let is_told = blend.at((&receivers, 0), &mut Vec::new(), (&mut out, &mut [0.0]));
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
