//! Binary files of `openusd` 0.6.0, made right for Pixar's USD.
//!
//! That version writes the lists of child prims and properties with the type of a `token[]` value; Pixar's reader
//! expects a token *vector* there and finds no children (26.11 refuses the file). The data of both are the same, only
//! the type in the table of fields differs: a corrected table is appended, and the table of contents names it.
//!
//! It also compresses integer arrays of 4 to 15 values, which Pixar's reader takes as they are: below 16 there is no
//! compression. Such arrays are appended plainly. (Arrays inside time samples are not looked at: none of ours holds
//! integers.)
//!
//! It copies every array before it writes it. Those of clouds are kept from it: it writes two numbers for each
//! ([`super::opinions`]), and the arrays are appended, each once however many attributes have it.
//!
//! Layout of the file: `pxr/usd/sdf/crateFile.h` of OpenUSD. All numbers are little-endian.

use super::opinions::{Array, PLACE};
use anyhow::{Context, bail};
use std::io::{Read, Seek, SeekFrom, Write};

/// Names of the fields that hold children, as the crate file spells them.
const CHILDREN: [&str; 2] = ["primChildren", "properties"];

/// Offset of the table of contents' own offset.
const CONTENTS_AT: u64 = 16;
/// Bytes of a section's name in the table of contents; its offset and size follow.
const NAME_LENGTH: usize = 16;

/// A value's type is in the top 16 bits of its representation: flags (array, inlined, compressed) and a number.
const TYPE_SHIFT: u32 = 48;
const TOKEN_ARRAY: u64 = 1 << 15 | 11;
const TOKEN_VECTOR: u64 = 41;
const INT_ARRAY: u64 = 1 << 15 | 3;
const PACKED_INT_ARRAY: u64 = INT_ARRAY | 1 << 13;
const INT64_ARRAY: u64 = 1 << 15 | 5;
const FLOAT_ARRAY: u64 = 1 << 15 | 8;
const VECTOR_ARRAY: u64 = 1 << 15 | 24;

/// Arrays begin at multiples of this, bytes: Pixar's reader maps them where they are then.
const ALIGNMENT: u64 = 8;

/// Arrays shorter than this are never compressed.
const SHORTEST_PACKED: usize = 16;

/// Give every list of children in `file` (a whole crate file) its right type.
/// Put `arrays` where two numbers stand for them.
pub(super) fn correct(
    file: &mut (impl Read + Write + Seek),
    arrays: &[Array],
) -> anyhow::Result<()> {
    let contents_offset = read_u64_at(file, CONTENTS_AT)?;
    let mut contents = read_contents(file, contents_offset)?;
    let tokens = section(file, &contents, "TOKENS")?;
    let fields = section(file, &contents, "FIELDS")?;
    let mut fields = Fields::read(&fields)?;
    fields.correct_children(&tokens)?;
    fields.unpack_short_arrays(file)?;
    fields.place_arrays(file, arrays)?;
    let corrected = fields.write();

    let start = file.seek(SeekFrom::End(0))?;
    file.write_all(&corrected)?;
    for section in &mut contents {
        if section.name.starts_with(b"FIELDS\0") {
            section.offset = start;
            section.size = corrected.len() as u64;
        }
    }
    let contents_offset = start + corrected.len() as u64;
    file.write_all(&(contents.len() as u64).to_le_bytes())?;
    for section in &contents {
        file.write_all(&section.name)?;
        file.write_all(&section.offset.to_le_bytes())?;
        file.write_all(&section.size.to_le_bytes())?;
    }
    file.seek(SeekFrom::Start(CONTENTS_AT))?;
    Ok(file.write_all(&contents_offset.to_le_bytes())?)
}

/// The section of fields: token indices, kept packed, and value representations.
struct Fields {
    packed_names: Vec<u8>,
    values: Vec<u64>,
}

impl Fields {
    fn read(section: &[u8]) -> anyhow::Result<Self> {
        let mut rest = section;
        let count = usize::try_from(take_u64(&mut rest)?)?;
        let packed_names = take_packed(&mut rest)?.to_vec();
        let values = unpack(take_packed(&mut rest)?, 8 * count)?;
        let values = values.as_chunks().0.iter().copied();
        Ok(Self {
            packed_names,
            values: values.map(u64::from_le_bytes).collect(),
        })
    }

    fn correct_children(&mut self, tokens: &[u8]) -> anyhow::Result<()> {
        let names = decode_packed(&self.packed_names, self.values.len())?;
        let children = children_tokens(tokens)?;
        for (name, value) in names.iter().zip(&mut self.values) {
            if children.contains(name) && *value >> TYPE_SHIFT == TOKEN_ARRAY {
                *value = TOKEN_VECTOR << TYPE_SHIFT | offset_of(*value);
            }
        }
        Ok(())
    }

    fn unpack_short_arrays(&mut self, file: &mut (impl Read + Write + Seek)) -> anyhow::Result<()> {
        for value in &mut self.values {
            if *value >> TYPE_SHIFT != PACKED_INT_ARRAY {
                continue;
            }
            let count = usize::try_from(read_u64_at(file, offset_of(*value))?)?;
            if count >= SHORTEST_PACKED {
                continue;
            }
            let mut packed = vec![0; usize::try_from(read_u64(file)?)?];
            file.read_exact(&mut packed)?;
            let start = file.seek(SeekFrom::End(0))?;
            file.write_all(&(count as u64).to_le_bytes())?;
            for integer in decode_packed(&packed, count)? {
                file.write_all(&i32::try_from(integer)?.to_le_bytes())?;
            }
            *value = INT_ARRAY << TYPE_SHIFT | start;
        }
        Ok(())
    }

    fn place_arrays(
        &mut self,
        file: &mut (impl Read + Write + Seek),
        arrays: &[Array],
    ) -> anyhow::Result<()> {
        let mut written = vec![None; arrays.len()];
        for value in &mut self.values {
            if *value >> TYPE_SHIFT != INT64_ARRAY
                || read_u64_at(file, offset_of(*value))? != 2
                || read_u64(file)? != PLACE.cast_unsigned()
            {
                continue;
            }
            let index = usize::try_from(read_u64(file)?)?;
            let array = arrays.get(index).context("an array is missing")?;
            *value = match written[index] {
                Some(value) => value,
                None => append(file, array)?,
            };
            written[index] = Some(*value);
        }
        Ok(())
    }

    fn write(&self) -> Vec<u8> {
        let values: Vec<u8> = self.values.iter().flat_map(|v| v.to_le_bytes()).collect();
        // a zero first: one chunk, not several
        let mut packed_values = vec![0];
        packed_values.extend(lz4_flex::compress(&values));
        let mut section = (self.values.len() as u64).to_le_bytes().to_vec();
        for packed in [&self.packed_names, &packed_values] {
            section.extend((packed.len() as u64).to_le_bytes());
            section.extend(packed);
        }
        section
    }
}

/// Write `array` at the end of the file; its representation.
fn append(file: &mut (impl Write + Seek), array: &Array) -> anyhow::Result<u64> {
    let end = file.seek(SeekFrom::End(0))?;
    let start = end.next_multiple_of(ALIGNMENT);
    file.write_all(&[0; 8][..usize::try_from(start - end)?])?;
    file.write_all(&(array.len() as u64).to_le_bytes())?;
    file.write_all(array.bytes())?;
    let kind = match array {
        Array::Floats(_) => FLOAT_ARRAY,
        Array::Vectors(_) => VECTOR_ARRAY,
    };
    Ok(kind << TYPE_SHIFT | start)
}

fn offset_of(representation: u64) -> u64 {
    representation & ((1 << TYPE_SHIFT) - 1)
}

/// Indices of the tokens in [`CHILDREN`].
fn children_tokens(section: &[u8]) -> anyhow::Result<Vec<i64>> {
    let mut rest = section;
    let _count = take_u64(&mut rest)?;
    let size = usize::try_from(take_u64(&mut rest)?)?;
    let text = unpack(take_packed(&mut rest)?, size)?;
    let named = |token: &[u8]| CHILDREN.iter().any(|name| name.as_bytes() == token);
    let tokens = text.split(|&byte| byte == 0);
    let indexed = (0_i64..).zip(tokens).filter(|(_, token)| named(token));
    Ok(indexed.map(|(index, _)| index).collect())
}

fn decode_packed(packed: &[u8], count: usize) -> anyhow::Result<Vec<i64>> {
    // four bytes and two bits a number at most, and the commonest difference
    decode_integers(&unpack(packed, 5 * count + 8)?, count)
}

/// Integers stored as differences: the commonest difference, two bits a number that tell how wide its difference is
/// (0: the commonest, 1, 2, 3: one, two, four bytes), then those that are not the commonest.
fn decode_integers(packed: &[u8], count: usize) -> anyhow::Result<Vec<i64>> {
    let short = "the table of fields ends early";
    let (common, rest) = packed.split_first_chunk::<4>().context(short)?;
    let common = i64::from(i32::from_le_bytes(*common));
    let (codes, mut rest) = rest.split_at_checked(count.div_ceil(4)).context(short)?;
    let mut value = 0;
    let mut values = Vec::with_capacity(count);
    for i in 0..count {
        value += match codes[i / 4] >> (2 * (i % 4)) & 3 {
            0 => common,
            1 => i64::from(i8::from_le_bytes(take(&mut rest).context(short)?)),
            2 => i64::from(i16::from_le_bytes(take(&mut rest).context(short)?)),
            _ => i64::from(i32::from_le_bytes(take(&mut rest).context(short)?)),
        };
        values.push(value);
    }
    Ok(values)
}

fn unpack(packed: &[u8], largest: usize) -> anyhow::Result<Vec<u8>> {
    match packed.split_first() {
        Some((0, block)) => Ok(lz4_flex::decompress(block, largest)?),
        _ => bail!("a section is packed in several chunks"),
    }
}

fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (first, rest) = bytes.split_first_chunk::<N>()?;
    *bytes = rest;
    Some(*first)
}

fn take_u64(bytes: &mut &[u8]) -> anyhow::Result<u64> {
    Ok(u64::from_le_bytes(
        take(bytes).context("a section ends early")?,
    ))
}

fn take_packed<'a>(bytes: &mut &'a [u8]) -> anyhow::Result<&'a [u8]> {
    let size = usize::try_from(take_u64(bytes)?)?;
    let (packed, rest) = bytes
        .split_at_checked(size)
        .context("a section ends early")?;
    *bytes = rest;
    Ok(packed)
}

/// An entry of the table of contents.
struct Section {
    name: [u8; NAME_LENGTH],
    offset: u64,
    size: u64,
}

fn read_contents(file: &mut (impl Read + Seek), offset: u64) -> anyhow::Result<Vec<Section>> {
    let count = read_u64_at(file, offset)?;
    (0..count)
        .map(|_| {
            let mut name = [0; NAME_LENGTH];
            file.read_exact(&mut name)?;
            Ok(Section {
                name,
                offset: read_u64(file)?,
                size: read_u64(file)?,
            })
        })
        .collect()
}

fn section(
    file: &mut (impl Read + Seek),
    contents: &[Section],
    name: &str,
) -> anyhow::Result<Vec<u8>> {
    let named =
        |section: &&Section| section.name.split(|&b| b == 0).next() == Some(name.as_bytes());
    let section = contents
        .iter()
        .find(named)
        .context("a section is missing")?;
    let mut bytes = vec![0; usize::try_from(section.size)?];
    file.seek(SeekFrom::Start(section.offset))?;
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn read_u64_at(file: &mut (impl Read + Seek), offset: u64) -> anyhow::Result<u64> {
    file.seek(SeekFrom::Start(offset))?;
    read_u64(file)
}

fn read_u64(file: &mut impl Read) -> anyhow::Result<u64> {
    let mut bytes = [0; 8];
    file.read_exact(&mut bytes)?;
    Ok(u64::from_le_bytes(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_summed_differences_of_their_width() {
        // common 1; codes: common, 1 byte, 2 bytes, 4 bytes, common
        let mut packed = 1_i32.to_le_bytes().to_vec();
        packed.extend([0b1110_0100, 0]);
        packed.extend((-3_i8).to_le_bytes());
        packed.extend(300_i16.to_le_bytes());
        packed.extend(70_000_i32.to_le_bytes());
        assert_eq!(
            decode_integers(&packed, 5).unwrap(),
            [1, -2, 298, 70_298, 70_299]
        );
        assert!(decode_integers(&packed[..8], 5).is_err());
    }
}
