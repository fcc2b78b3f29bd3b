//! The values of a binary layer: everything their counts and offsets announce must lie in the file.

use super::crate_check::{Reader, cut_off, lz4_length};

const ARRAY: u64 = 1 << 63;
const INLINED: u64 = 1 << 62;
const COMPRESSED: u64 = 1 << 61;
const PAYLOAD: u64 = (1 << 48) - 1;

/// Values in values (dictionaries, samples), at most.
const DEEPEST: usize = 64;
/// Values visited for each byte of the file, at most: offsets that share or loop would visit more.
const VISITS_A_BYTE: usize = 2;

/// Arrays shorter than this are never compressed.
const SHORTEST_COMPRESSED: u64 = 4;

/// Check the values `reps` of the file `bytes` of version 0.`minor`.
///
/// # Errors
/// When one of them leaves the file, or they are nested without end.
pub(super) fn check(bytes: &[u8], minor: u8, reps: &[u64]) -> Result<(), String> {
    let mut values = Values {
        bytes,
        minor,
        visits: bytes.len() * VISITS_A_BYTE + reps.len(),
    };
    reps.iter().try_for_each(|&rep| values.value(rep, 0))
}

struct Values<'a> {
    bytes: &'a [u8],
    minor: u8,
    visits: usize,
}

impl<'a> Values<'a> {
    fn value(&mut self, rep: u64, depth: usize) -> Result<(), String> {
        self.visits = self
            .visits
            .checked_sub(1)
            .ok_or_else(|| "values refer to each other without end".to_owned())?;
        if depth > DEEPEST {
            return Err(format!("values are nested more than {DEEPEST} deep"));
        }
        let payload = rep & PAYLOAD;
        let kind = (rep >> 48) & 0xff;
        if rep & INLINED != 0 {
            return may_be_inlined(kind, rep & ARRAY != 0);
        }
        let at = usize::try_from(payload).map_err(|_| cut_off())?;
        let reader = Reader::new(self.bytes, at);
        // Of what has no arrays the crate reads one, whatever this bit says.
        match element_bytes(kind).filter(|_| rep & ARRAY != 0) {
            Some(_) if payload == 0 => Ok(()),
            Some(size) => self.array((kind, size), rep & COMPRESSED != 0, reader),
            None => self.single(kind, reader, depth),
        }
    }

    fn array(
        &self,
        (kind, size): (u64, usize),
        compressed: bool,
        mut reader: Reader<'a>,
    ) -> Result<(), String> {
        // string, asset and path expression: lists of indices, always with a 64-bit count
        let listed = matches!(kind, 10 | 12 | 57);
        if self.minor < 5 && !listed {
            reader.u32()?;
        }
        let count = match self.minor < 7 && !listed {
            true => u64::from(reader.u32()?),
            false => reader.u64()?,
        };
        let integers = matches!(kind, 3..=6) && self.minor >= 5;
        let reals = matches!(kind, 7..=9 | 56) && self.minor >= 6;
        if !compressed || !(integers || reals) || count < SHORTEST_COMPRESSED {
            return reader.holds(count, size).map(drop);
        }
        if reals && reader.u8()? == b't' {
            let table = u64::from(reader.u32()?);
            let table = reader.holds(table, size)?;
            reader.take(table * size)?;
        }
        compressed_ints(&mut reader, count)
    }

    fn single(&mut self, kind: u64, mut reader: Reader<'a>, depth: usize) -> Result<(), String> {
        match kind {
            31 => self.dictionary(&mut reader, depth),
            32..=34 | 36 | 38 | 54 => list_op(&mut reader, |reader| list(reader, 4)),
            37 | 39 => list_op(&mut reader, |reader| list(reader, 8)),
            35 => self.references(&mut reader, depth),
            55 => list_op(&mut reader, |reader| {
                let count = reader.count(8)?;
                let size = if self.minor >= 8 { 24 } else { 8 };
                reader.take(count * size).map(drop)
            }),
            40 | 41 | 50 => list(&mut reader, 4),
            45 | 48 | 58 => list(&mut reader, 8),
            49 => list(&mut reader, 16),
            46 => self.samples(&mut reader, depth),
            _ => Ok(()),
        }
    }

    fn dictionary(&mut self, reader: &mut Reader<'a>, depth: usize) -> Result<(), String> {
        let count = reader.count(12)?;
        for _ in 0..count {
            reader.u32()?;
            follow(reader)?;
            let rep = reader.u64()?;
            self.value(rep, depth + 1)?;
        }
        Ok(())
    }

    fn references(&mut self, reader: &mut Reader<'a>, depth: usize) -> Result<(), String> {
        let bits = reader.u8()?;
        for _ in 0..lists_of(bits) {
            let count = reader.count(32)?;
            for _ in 0..count {
                reader.take(24)?;
                self.dictionary(reader, depth + 1)?;
            }
        }
        Ok(())
    }

    fn samples(&mut self, reader: &mut Reader<'a>, depth: usize) -> Result<(), String> {
        follow(reader)?;
        let times = reader.u64()?;
        self.value(times, depth + 1)?;
        follow(reader)?;
        let count = reader.count(8)?;
        for _ in 0..count {
            let rep = reader.u64()?;
            self.value(rep, depth + 1)?;
        }
        Ok(())
    }
}

/// The crate takes what stands in place of an offset for one where nothing but an offset makes sense.
fn may_be_inlined(kind: u64, is_array: bool) -> Result<(), String> {
    let is_list = matches!(kind, 32..=41 | 45 | 46 | 48..=50 | 54 | 55 | 58);
    match is_array || is_list {
        true => Err(format!(
            "a value of kind {kind} stands where only an offset can"
        )),
        false => Ok(()),
    }
}

/// Offsets are relative to where they stand.
fn follow(reader: &mut Reader<'_>) -> Result<(), String> {
    let from = reader.at;
    let offset = reader.u64()?.cast_signed();
    let to = i64::try_from(from)
        .ok()
        .and_then(|from| from.checked_add(offset));
    reader.at = to
        .and_then(|to| usize::try_from(to).ok())
        .ok_or_else(cut_off)?;
    Ok(())
}

fn list(reader: &mut Reader<'_>, size: usize) -> Result<(), String> {
    let count = reader.count(size)?;
    reader.take(count * size).map(drop)
}

fn list_op(
    reader: &mut Reader<'_>,
    mut one: impl FnMut(&mut Reader<'_>) -> Result<(), String>,
) -> Result<(), String> {
    let bits = reader.u8()?;
    (0..lists_of(bits)).try_for_each(|_| one(reader))
}

/// The lowest bit says "explicit", each of the others that a list follows.
fn lists_of(bits: u8) -> u32 {
    (bits & 0b0111_1110).count_ones()
}

fn compressed_ints(reader: &mut Reader<'_>, count: u64) -> Result<(), String> {
    let size = reader.count(1)?;
    let held = lz4_length(reader.take(size)?)?;
    // two bits a number at least
    match count.div_ceil(4) <= held {
        true => Ok(()),
        false => Err(cut_off()),
    }
}

/// Bytes of an element of an array, by `CrateDataTypes`; `None` for kinds without arrays.
fn element_bytes(kind: u64) -> Option<usize> {
    Some(match kind {
        // bool, uchar; half
        1 | 2 => 1,
        7 => 2,
        // int, uint, float, indices of strings, half2
        3 | 4 | 8 | 10 | 11 | 12 | 21 | 57 => 4,
        25 => 6,
        // int64, uint64, double, quath, float2, int2, half4, timecode
        5 | 6 | 9 | 18 | 20 | 22 | 29 | 56 => 8,
        24 | 26 => 12,
        // quatf, double2, float4, int4
        17 | 19 | 28 | 30 => 16,
        23 => 24,
        // quatd, double4, matrix2d
        13 | 16 | 27 => 32,
        14 => 72,
        15 => 128,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Found by the fuzz run of seed 601, case 187364: the crate reserved 75 PB for an array of strings at offset 1.
    #[test]
    fn lists_do_not_stand_in_place_of_their_offset_and_lie_in_the_file() {
        let rep = |kind: u64, flags: u64| flags | (kind << 48) | 1;
        assert!(check(&[], 8, &[rep(10, ARRAY | INLINED)]).is_err());
        assert!(check(&[], 8, &[rep(34, INLINED)]).is_err());
        // Seed 3011, case 228225: 2 TB for a list of paths that says it is an array of these.
        let mut bytes = vec![0; 16];
        bytes.push(0b10);
        bytes.extend(u64::MAX.to_le_bytes());
        let list = |flags: u64| flags | (34 << 48) | 16;
        assert!(check(&bytes, 8, &[list(0)]).is_err());
        assert!(check(&bytes, 8, &[list(ARRAY)]).is_err());
        assert!(check(&bytes, 8, &[list(ARRAY | COMPRESSED)]).is_err());
        // an int, an empty dictionary
        assert_eq!(check(&[], 8, &[rep(3, INLINED), rep(31, INLINED)]), Ok(()));
    }
}
