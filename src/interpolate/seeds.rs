//! Receivers that were gathered at, and what they tell of others.

use super::Kind;
use super::fit::{self, Fit};
use super::places::Places;
use crate::receivers::Receivers;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::{Range, RangeFrom};

/// Seeds that a cell asks, at most.
pub(super) const ASKED: usize = 24;

/// Cosine between the normals of those who may speak for each other.
pub(super) const ALIKE: f32 = 0.5;

/// Seeds as columns.
#[derive(Debug)]
pub(super) struct Seeds {
    /// Which receiver.
    pub(super) receiver: Vec<u32>,
    pub(super) position: Vec<Vec3>,
    pub(super) normal: Vec<Vec3>,
    /// Who may speak for whom.
    kind: Vec<Kind>,
    /// `components` floats each.
    pub(super) values: Vec<f32>,
    /// Change of each of these with the normal.
    pub(super) turns: Vec<Vec3>,
    /// Harmonic mean of the distances to what each sees, stage units; NaN where that was not told.
    pub(super) room: Vec<f32>,
    pub(super) components: usize,
}

impl Seeds {
    pub(super) fn new(components: usize) -> Self {
        Self {
            receiver: Vec::new(),
            position: Vec::new(),
            normal: Vec::new(),
            kind: Vec::new(),
            values: Vec::new(),
            turns: Vec::new(),
            room: Vec::new(),
            components,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.receiver.len()
    }

    /// True for each of so many receivers that is a seed.
    pub(super) fn marks(&self, receivers: usize) -> Vec<bool> {
        let mut is_seed = vec![false; receivers];
        (self.receiver.iter()).for_each(|&i| is_seed[i as usize] = true);
        is_seed
    }

    /// All seeds.
    pub(super) fn all(&self) -> Range<u32> {
        0..u32::try_from(self.len()).expect("receivers are counted by u32")
    }

    /// Those to come, in order.
    pub(super) fn next(&self) -> RangeFrom<u32> {
        self.all().end..
    }

    /// Floats that are read of a receiver with so many components: its values, then their changes with the normal, then its
    /// room.
    pub(super) fn floats(components: usize) -> usize {
        4 * components + 1
    }

    /// Add the receivers `which`, each of the `kind` told, with what was read of them: [`Self::floats`] each.
    pub(super) fn extend(
        &mut self,
        (receivers, kind): (&Receivers, &dyn Fn(usize) -> Kind),
        which: &[u32],
        read: &[f32],
    ) {
        let indices = || which.iter().map(|&i| i as usize);
        self.receiver.extend_from_slice(which);
        self.kind.extend(indices().map(kind));
        self.position
            .extend(indices().map(|i| receivers.position[i]));
        self.normal.extend(indices().map(|i| receivers.normal[i]));
        for read in read.chunks_exact(Self::floats(self.components)) {
            let (values, rest) = read.split_at(self.components);
            let (turns, room) = rest.split_at(3 * self.components);
            self.values.extend_from_slice(values);
            self.turns
                .extend(turns.chunks_exact(3).map(Vec3::from_slice));
            self.room.extend_from_slice(room);
        }
    }

    /// Take the mean of what was read before and now, as of [`Self::extend`]; the new counts by `share`, 0…1.
    pub(super) fn take(&mut self, read: &[f32], share: f32) {
        let n = self.components;
        let own = (self.values.chunks_exact_mut(n)).zip(self.turns.chunks_exact_mut(n));
        for ((values, own_turns), read) in own.zip(read.chunks_exact(Self::floats(n))) {
            let (more, turns) = read.split_at(n);
            for (value, more) in values.iter_mut().zip(more) {
                *value += share * (more - *value);
            }
            for (own, turn) in own_turns.iter_mut().zip(turns.chunks_exact(3)) {
                *own += share * (Vec3::from_slice(turn) - *own);
            }
        }
    }

    /// Component `component` of seed `seed`, had it this normal.
    pub(super) fn turned(&self, seed: u32, component: usize, normal: Vec3) -> f32 {
        let (i, place) = (seed as usize, seed as usize * self.components + component);
        self.values[place] + self.turns[place].dot(normal - self.normal[i])
    }

    /// All of them, to be searched.
    pub(super) fn index(&self) -> SeedIndex<'_> {
        let mut by_kind: BTreeMap<u32, Vec<(Vec3, u32)>> = BTreeMap::new();
        for ((&position, &kind), seed) in self.position.iter().zip(&self.kind).zip(0..) {
            if let Some(kind) = kind {
                by_kind.entry(kind).or_default().push((position, seed));
            }
        }
        let tree = |(kind, places)| (kind, Places::new(places));
        SeedIndex {
            seeds: self,
            trees: by_kind.into_par_iter().map(tree).collect(),
        }
    }
}

/// Seeds of each kind by place.
#[derive(Debug)]
pub(super) struct SeedIndex<'a> {
    pub(super) seeds: &'a Seeds,
    trees: BTreeMap<u32, Places>,
}

impl SeedIndex<'_> {
    /// Up to `count` seeds nearest to seed `around`, itself first, that may speak for what is there: of its kind, on its
    /// side. Nearest first.
    pub(super) fn near(&self, around: u32, count: usize) -> Vec<u32> {
        let seeds = self.seeds;
        let (normal, kind) = (seeds.normal[around as usize], seeds.kind[around as usize]);
        let position = seeds.position[around as usize];
        let is_other =
            |seed: u32| seed != around && seeds.normal[seed as usize].dot(normal) > ALIKE;
        let mut found = Vec::with_capacity(count);
        if let Some(places) = kind.and_then(|kind| self.trees.get(&kind)) {
            places.nearest(position, count.saturating_sub(1), is_other, &mut found);
        }
        let others = found.iter().map(|found| found.1);
        std::iter::once(around).chain(others).take(count).collect()
    }

    /// A plane through the values around seed `around`.
    pub(super) fn fit(&self, around: u32) -> Option<Fit> {
        fit::fit(self.seeds, &self.near(around, fit::NEIGHBORS + 1))
    }

    /// The same through more of them.
    pub(super) fn wide_fit(&self, around: u32) -> Option<Fit> {
        fit::fit(self.seeds, &self.near(around, fit::MANY_NEIGHBORS + 1))
    }
}

#[cfg(test)]
pub(super) mod testing {
    use super::*;
    use crate::gather::testing::receivers_at;

    /// Seeds at (position, normal), of prim 0, with the values and turns of one component.
    pub(crate) fn seeds_at(all: &[(Vec3, Vec3, f32, Vec3)]) -> Seeds {
        let places: Vec<_> = all.iter().map(|seed| (seed.0, seed.1)).collect();
        let read: Vec<f32> = all
            .iter()
            .flat_map(|seed| [seed.2, seed.3.x, seed.3.y, seed.3.z, f32::NAN])
            .collect();
        let mut seeds = Seeds::new(1);
        let which: Vec<u32> = (0..).take(all.len()).collect();
        seeds.extend((&receivers_at(&places), &|_| Some(0)), &which, &read);
        seeds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_near_another_are_of_its_kind_and_side_and_it_is_the_first() {
        let place = |i: i16| {
            let normal = if i % 3 == 0 { -Vec3::Y } else { Vec3::Y };
            (Vec3::X * f32::from(i), normal, 0.0, Vec3::ZERO)
        };
        let mut seeds = testing::seeds_at(&(0..30).map(place).collect::<Vec<_>>());
        seeds.kind[11] = Some(1);
        assert_eq!(seeds.index().near(10, 5), [10, 8, 7, 13, 14]);
        // Two at one place: its own value comes first.
        seeds.position[13] = seeds.position[10];
        assert_eq!(seeds.index().near(13, 1), [13]);
        assert_eq!(seeds.index().near(10, 1), [10]);
        // Nobody speaks for one without a kind.
        seeds.kind[10] = None;
        assert_eq!(seeds.index().near(10, 5), [10]);
        assert!(!seeds.index().near(13, 20).contains(&10));
    }
}
