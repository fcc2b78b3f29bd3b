//! Fewer rays where a pixel has many receivers: together they see as well as one with all rays would.
//!
//! What a pixel shows is the sum of its receivers, each times its part of it. Where receivers of a pixel see along other
//! directions than each other their errors even out, and each needs fewer rays: with errors that fall with the number of rays
//! to the power L, the pixel errs by what one receiver with all rays does, at the least cost, if a receiver of the part u
//! has u^a · (Σ u^a)^(1 / 2L) of them, a = 2 / (1 + 2L). In a pixel of hair with seven strands, each sees with a
//! quarter of the rays where L is 0.75, and the pixel takes 1.9 times what one receiver does instead of 7.

use super::Engine;
use crate::results::{PixelShare, Target};

/// Steps in which rays get fewer, each by √2, at most; and patterns that the receivers of a pixel take in turn.
const STEPS: u8 = 6;
const PATTERNS: u8 = 4;

/// Rays of all receivers, over as many for each, up to which it is worth the lost coherence.
const WORTH: f64 = 0.8;

/// How the receivers of an image see: each with all rays, or with some of one of several patterns.
#[derive(Debug, Clone, PartialEq)]
pub struct Thinning {
    classes: Vec<Class>,
    /// Part of its pixel of each receiver.
    parts: Vec<f32>,
    cost: f64,
    /// Pixels that show anything, over what of them is covered: 1 or more.
    open: f64,
}

/// One way of seeing; 0: with all rays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Class(u8);

impl Class {
    /// With all rays.
    pub const ALL: Self = Self(0);

    /// Every one but [`Self::ALL`].
    pub fn thin() -> impl Iterator<Item = Self> {
        (1..=STEPS * PATTERNS).map(Self)
    }

    /// Of a receiver that needs `share` of the rays, the one after so many others in its pixel.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a few steps and patterns"
    )]
    fn of(share: f64, before: usize) -> Self {
        let steps = (-2.0 * share.log2()).clamp(0.0, f64::from(STEPS)) as u8;
        match steps {
            0 => Self::ALL,
            _ => Self(1 + (steps - 1) * PATTERNS + (before % usize::from(PATTERNS)) as u8),
        }
    }

    /// Share of all rays, 0…1.
    pub fn share(self) -> f64 {
        let steps = self.0.div_ceil(PATTERNS);
        0.5_f64.powf(0.5 * f64::from(steps))
    }

    /// Which pattern, 0…1.
    pub fn pattern(self) -> f32 {
        let pattern = (self.0 + PATTERNS - 1) % PATTERNS;
        f32::from(pattern) / f32::from(PATTERNS)
    }
}

impl Thinning {
    /// For `count` receivers of `target`, whose errors fall with the number of rays to the power `law`. `None` where fewer rays are
    /// not worth it: next to all receivers have a pixel of their own.
    pub fn of(target: &Target, count: usize, law: f64) -> Option<Self> {
        let Target::Image { shares, .. } = target else {
            return None;
        };
        let mut thinning = Self {
            classes: vec![Class::ALL; count],
            parts: vec![1.0; count],
            cost: 1.0,
            open: 1.0,
        };
        let mut pixels = 0.0;
        for pixel in shares.chunk_by(|a, b| a.pixel == b.pixel) {
            thinning.add(pixel, law);
            pixels += 1.0;
        }
        let covered: f64 = shares.iter().map(|share| f64::from(share.weight)).sum();
        thinning.open = pixels / covered.max(f64::MIN_POSITIVE);
        let costs = thinning.classes.iter().map(|class| class.share());
        thinning.cost = costs.sum::<f64>() / count.max(1) as f64;
        (thinning.cost <= WORTH).then_some(thinning)
    }

    /// The receivers of one pixel.
    fn add(&mut self, pixel: &[PixelShare], law: f64) {
        let power = 2.0 / (1.0 + 2.0 * law);
        let covered: f64 = pixel.iter().map(|share| f64::from(share.weight)).sum();
        let part = |share: &PixelShare| (f64::from(share.weight) / covered).powf(power);
        let all = pixel.iter().map(part).sum::<f64>();
        for (before, share) in pixel.iter().enumerate() {
            let rays = part(share) * all.powf(0.5 / law);
            let i = share.receiver as usize;
            // Not a number where nothing is covered.
            self.classes[i] = Class::of(rays.min(1.0), before);
            self.parts[i] = share.weight;
        }
    }

    /// How receiver `i` sees.
    pub fn class(&self, i: usize) -> Class {
        self.classes[i]
    }

    /// Part of its pixel that receiver `i` stands for, 0…1.
    pub fn part(&self, i: usize) -> f32 {
        self.parts[i]
    }

    /// What the square of receiver `i`'s error counts in that of pixels, where receivers count by their parts of these: others of its
    /// pixel err otherwise, if it sees with few rays.
    pub fn evened(&self, i: usize) -> f64 {
        match self.classes[i] {
            Class::ALL => 1.0,
            _ => self.open * f64::from(self.parts[i]),
        }
    }

    /// Rays of all receivers over as many for each, 0…1.
    pub fn cost(&self) -> f64 {
        self.cost
    }
}

/// Who sees for each [`Class`] of the receivers of a run.
#[derive(Debug)]
pub struct ThinEngines<'a> {
    thinning: Thinning,
    /// Of each of [`Class::thin`].
    engines: Vec<Box<dyn Engine + 'a>>,
    /// The same in other directions.
    again: Vec<Box<dyn Engine + 'a>>,
}

/// Which look of two at one place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Glance {
    /// The first.
    First,
    /// One in other directions: the mean of both is closer.
    Again,
}

/// Takes some receivers that see alike.
pub(super) type Visit<'v, E> = &'v mut dyn FnMut(Option<&dyn Engine>, &[u32]) -> Result<(), E>;

impl<'a> ThinEngines<'a> {
    /// Each of the kind that `engine` makes.
    pub fn new(thinning: Thinning, engine: &dyn Fn(Class, Glance) -> Box<dyn Engine + 'a>) -> Self {
        let all = |glance| Class::thin().map(|class| engine(class, glance)).collect();
        Self {
            thinning,
            engines: all(Glance::First),
            again: all(Glance::Again),
        }
    }

    /// How the receivers see.
    pub fn thinning(&self) -> &Thinning {
        &self.thinning
    }

    /// Hand those of `which` that see alike to `visit`, with who sees for them: nobody of these, if that is with all rays.
    ///
    /// # Errors
    /// Those of `visit`.
    pub fn try_each<E>(
        &self,
        (which, glance): (&[u32], Glance),
        visit: Visit<'_, E>,
    ) -> Result<(), E> {
        let engines = match glance {
            Glance::First => &self.engines,
            Glance::Again => &self.again,
        };
        let mut by_class = which.to_vec();
        let class = |i: u32| self.thinning.classes[i as usize];
        by_class.sort_by_key(|&i| class(i));
        for alike in by_class.chunk_by(|&a, &b| class(a) == class(b)) {
            let Class(class) = class(alike[0]);
            let engine = usize::from(class).checked_sub(1);
            visit(engine.map(|k| engines[k].as_ref()), alike)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::testing::pixels_of;

    #[test]
    fn a_pixel_errs_by_what_one_receiver_with_all_rays_does() {
        let cases = [0.5, 0.75, 1.0].map(|law| [2_u16, 3, 7, 16].map(|count| (count, law)));
        for (count, law) in cases.into_iter().flatten() {
            let (target, receivers) = (pixels_of(&[count]), usize::from(count));
            let Some(thinning) = Thinning::of(&target, receivers, law) else {
                assert!(count == 2 && law == 1.0, "{count} {law}: it is worth it");
                continue;
            };
            // Errors of parts of a pixel are of other patterns: squares add up.
            let square = |i: usize| {
                let part = f64::from(thinning.part(i));
                part.powi(2) * thinning.class(i).share().powf(-2.0 * law)
            };
            let error = (0..receivers).map(square).sum::<f64>().sqrt();
            // Rays are rounded up by up to √2, and no fewer than an eighth.
            let least = 0.5_f64.powf(0.5 * law) - 1e-9;
            let is_least = count == 16 && law == 0.5;
            assert!(
                error <= 1.0 && (error >= least || is_least),
                "{count} {law}: {error}"
            );
            let rays = f64::from(count) * thinning.cost();
            let power = (law - 0.5) / law;
            let most = f64::from(count).powf(power).max(f64::from(count) / 8.0);
            assert!(rays < 1.415 * most, "{count} {law}: {rays}");
        }
    }

    #[test]
    fn lone_receivers_see_with_all_rays_and_large_parts_with_more_than_small_ones() {
        assert!(Thinning::of(&pixels_of(&[1; 50]), 50, 0.75).is_none());
        assert!(Thinning::of(&Target::Surfels, 50, 0.75).is_none());
        let (mut target, count) = (pixels_of(&[1, 4, 4]), 9);
        if let Target::Image { shares, .. } = &mut target {
            shares[1].weight = 0.7;
            (2..5).for_each(|i| shares[i].weight = 0.1);
            // Half of the pixel is sky, and nothing of it is seen.
            (5..9).for_each(|i| shares[i].weight = 0.0);
        }
        let thinning = Thinning::of(&target, count, 0.75).expect("it is worth it");
        let shares: Vec<f64> = (0..count).map(|i| thinning.class(i).share()).collect();
        assert_eq!(shares[0], 1.0);
        assert!(shares[1] > shares[2] && shares[2] == shares[3] && shares[2] < 0.3);
        assert!(shares[5..].iter().all(|share| (0.1..=1.0).contains(share)));
        // Those of one pixel see along other directions than each other.
        let patterns: Vec<f32> = (2..5).map(|i| thinning.class(i).pattern()).collect();
        assert_eq!(patterns, [0.25, 0.5, 0.75]);
    }

    #[test]
    fn classes_are_told_apart() {
        let all: Vec<Class> = Class::thin().collect();
        assert_eq!(all.len(), 24);
        assert_eq!((Class::ALL.share(), all[0].share()), (1.0, 0.5_f64.sqrt()));
        assert_eq!(all[23].share(), 0.125);
        assert_eq!(Class::of(0.71, 3), Class::ALL);
        assert_eq!((Class::of(0.5, 0), Class::of(0.5, 5)), (all[4], all[5]));
        assert_eq!(Class::of(1e-9, 7), all[23]);
        assert_eq!(all.iter().map(|c| c.pattern()).fold(0.0, f32::max), 0.75);
    }
}
