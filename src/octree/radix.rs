//! Keys → sorted keys, from the highest digit down: threads first deal out pieces of the whole, then sort what was dealt.
//!
//! Stable: equal keys keep their order without being compared.

use super::order::Entry;
use rayon::prelude::*;

/// Bits of a digit.
const DIGIT_BITS: u32 = 8;

/// Values of a digit.
const VALUES: usize = 1 << DIGIT_BITS;

/// Entries that are dealt out in one go. Fixed, so that threads do not change what is done.
const PIECE: usize = 1 << 15;

/// Fewer entries than this are sorted by comparing them: dealing out to 256 places takes longer.
const FEW: usize = 256;

/// Sort by key, equal keys by id, given entries in ascending order of ids.
pub(super) fn sort(mut entries: Vec<Entry>) -> Vec<Entry> {
    let mut spare = entries.clone();
    sort_part(&mut entries, &mut spare);
    entries
}

/// Sort `entries`; `spare` is as long, what it holds does not matter.
fn sort_part(entries: &mut [Entry], spare: &mut [Entry]) {
    if entries.len() <= FEW {
        entries.sort_unstable_by_key(|entry| (entry.key, entry.id));
        return;
    }
    let Some(shift) = digit_shift(entries) else {
        return;
    };
    let ends = deal(entries, spare, shift);
    let parts = parts_of(entries, spare, &ends);
    let sort_one = |(entries, spare): (&mut [Entry], &mut [Entry])| {
        entries.copy_from_slice(spare);
        sort_part(entries, spare);
    };
    if ends[VALUES - 1] > PIECE {
        parts.into_par_iter().for_each(sort_one);
    } else {
        parts.into_iter().for_each(sort_one);
    }
}

/// Where the highest digit that is not the same in all `entries` begins; `None` if all keys are equal.
fn digit_shift(entries: &[Entry]) -> Option<u32> {
    let first = entries[0].key;
    let differs =
        |piece: &[Entry]| (piece.iter()).fold(0, |bits, entry| bits | (entry.key ^ first));
    let bits = if entries.len() > PIECE {
        (entries.par_chunks(PIECE).map(differs)).reduce(|| 0, |a, b| a | b)
    } else {
        differs(entries)
    };
    let highest = bits.checked_ilog2()?;
    Some((highest + 1).saturating_sub(DIGIT_BITS))
}

#[expect(clippy::cast_possible_truncation, reason = "one digit is kept")]
fn digit(entry: &Entry, shift: u32) -> usize {
    (entry.key >> shift) as usize & (VALUES - 1)
}

/// Entries of `piece` for each value of the digit.
fn count(piece: &[Entry], shift: u32) -> [usize; VALUES] {
    let mut counts = [0; VALUES];
    for entry in piece {
        counts[digit(entry, shift)] += 1;
    }
    counts
}

/// Put `entries` into `sorted`, by the digit at `shift`, equal ones in the order they had; where each value ends.
fn deal(entries: &[Entry], sorted: &mut [Entry], shift: u32) -> [usize; VALUES] {
    if entries.len() <= PIECE {
        let mut places = count(entries, shift);
        let mut start = 0;
        for place in &mut places {
            start += std::mem::replace(place, start);
        }
        for entry in entries {
            let place = &mut places[digit(entry, shift)];
            sorted[*place] = *entry;
            *place += 1;
        }
        return places;
    }
    // Each piece is dealt out by itself; then each value collects its share of all pieces.
    let dealt: Vec<(Vec<Entry>, [usize; VALUES])> = (entries.par_chunks(PIECE))
        .map(|piece| {
            let mut own = piece.to_vec();
            let ends = deal(piece, &mut own, shift);
            (own, ends)
        })
        .collect();
    let mut ends = [0; VALUES];
    let mut end = 0;
    for value in 0..VALUES {
        end += dealt
            .iter()
            .map(|(_, ends)| share(ends, value).len())
            .sum::<usize>();
        ends[value] = end;
    }
    let values = split_at_ends(sorted, &ends).into_par_iter().enumerate();
    values.for_each(|(value, place)| {
        let mut rest = place;
        for (own, ends) in &dealt {
            let from = &own[share(ends, value)];
            let (head, tail) = rest.split_at_mut(from.len());
            head.copy_from_slice(from);
            rest = tail;
        }
    });
    ends
}

/// The range of `value`.
fn share(ends: &[usize; VALUES], value: usize) -> std::ops::Range<usize> {
    let start = value.checked_sub(1).map_or(0, |before| ends[before]);
    start..ends[value]
}

fn split_at_ends<'a>(mut whole: &'a mut [Entry], ends: &[usize; VALUES]) -> Vec<&'a mut [Entry]> {
    let mut parts = Vec::with_capacity(VALUES);
    for value in 0..VALUES {
        let (head, tail) = whole.split_at_mut(share(ends, value).len());
        parts.push(head);
        whole = tail;
    }
    parts
}

/// The parts of `entries` and `spare` for each value that occurs.
fn parts_of<'a>(
    entries: &'a mut [Entry],
    spare: &'a mut [Entry],
    ends: &[usize; VALUES],
) -> Vec<(&'a mut [Entry], &'a mut [Entry])> {
    let pairs = split_at_ends(entries, ends)
        .into_iter()
        .zip(split_at_ends(spare, ends));
    pairs.filter(|(part, _)| !part.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(count: u32, key: impl Fn(u64) -> u64) -> Vec<Entry> {
        let mixed = |id: u32| (u64::from(id) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        (0..count)
            .map(|id| Entry {
                key: key(mixed(id)),
                id,
            })
            .collect()
    }

    #[test]
    fn sorted_as_by_comparing() {
        for count in [0, 1, 2, 257, 5_000, 200_000] {
            for (shift, mask) in [(1, u64::MAX), (60, u64::MAX), (0, 0xff00_00ff), (0, 0)] {
                let given = entries(count, |bits| (bits >> shift) & mask);
                let mut expected = given.clone();
                expected.sort_by_key(|entry| (entry.key, entry.id));
                assert!(sort(given) == expected, "{count} keys, {shift}, {mask:x}");
            }
        }
    }
}
