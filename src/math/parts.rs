//! Sums of many items into many targets, by several threads.

use rayon::prelude::*;
use std::ops::Range;

/// Fewer items than this are not worth a second thread.
const FEW: usize = 1 << 16;

/// Every part passes over all items: more parts than this do not pay.
const MOST_PARTS: usize = 8;

/// Some of the targets, next to each other.
#[derive(Debug)]
pub struct Part<'a, T> {
    first: usize,
    targets: &'a mut [T],
}

impl<T> Part<'_, T> {
    /// Indices of its targets among all.
    pub fn range(&self) -> Range<usize> {
        self.first..self.first + self.targets.len()
    }

    /// Target `index` of all, if it is in this part.
    pub fn get_mut(&mut self, index: usize) -> Option<&mut T> {
        self.targets.get_mut(index.wrapping_sub(self.first))
    }
}

/// True if [`in_parts`] may have several threads at work on so many items.
pub fn takes_threads(items: usize) -> bool {
    items >= FEW
}

/// Let `add` pass over `items` items, in their order, for each part of `targets`, and give each target of the part what is
/// for it. As every target gets all of its items in their order, the results do not depend on the number of threads.
pub fn in_parts<T: Send>(targets: &mut [T], items: usize, add: impl Fn(Part<'_, T>) + Sync) {
    let parts = if takes_threads(items) {
        rayon::current_num_threads().min(MOST_PARTS)
    } else {
        1
    };
    if parts < 2 {
        add(Part { first: 0, targets });
        return;
    }
    let length = targets.len().div_ceil(parts).max(1);
    let parts = targets.par_chunks_mut(length).enumerate();
    parts.for_each(|(k, targets)| {
        add(Part {
            first: k * length,
            targets,
        });
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_target_gets_its_items_in_their_order_however_many_parts_there_are() {
        let target = |item: usize| item * 7919 % 1000;
        let add = |mut part: Part<'_, f32>| {
            for item in 0..FEW {
                if let Some(sum) = part.get_mut(target(item)) {
                    *sum = *sum * 0.9 + item as f32;
                }
            }
        };
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let mut sums = vec![0.0; 1000];
            pool.unwrap().install(|| in_parts(&mut sums, FEW, add));
            sums
        };
        let alone = with(1);
        assert!(alone.iter().all(|&sum| sum > 0.0));
        assert_eq!(with(3), alone);
        assert_eq!(with(16), alone);
        let none: &mut [f32] = &mut [];
        in_parts(none, FEW, add);
    }
}
