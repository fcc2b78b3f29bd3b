//! Binary layers (`.usdc`) checked before the crate reads them: it allocates what a count says before it looks whether
//! the file holds that much, and follows offsets without end, so that one flipped bit can end the process.
//!
//! Layout: `pxr/usd/usd/crateFile.cpp` of OpenUSD. This file checks the sections, [`super::crate_values`] the values.

use super::arc_cycles;
use super::crate_values;
use super::text::is_identifier;
use openusd::sdf::FieldKey;

/// Oldest and newest minor version (of major version 0) that can be read.
const VERSIONS: std::ops::RangeInclusive<u8> = 4..=12;
/// Deepest path; as deep as [`super::text`] allows.
const DEEPEST: usize = 2_000;
const SECTION_BYTES: usize = 32;
const MOST_SECTIONS: u64 = 64;

/// What is to know of a sound file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Soundness {
    /// It may hold inherits or specializes.
    pub(super) has_classes: bool,
    /// It may hold relocates.
    pub(super) has_relocates: bool,
    /// It may hold expression variables.
    pub(super) has_variables: bool,
}

/// # Errors
/// What is damaged, or that the version cannot be read.
pub(super) fn check(bytes: &[u8]) -> Result<Soundness, String> {
    let minor = version(bytes)?;
    let sections = sections(bytes)?;
    let section = |name: &str| {
        sections
            .iter()
            .find(|section| section.0 == name)
            .map(|section| section.1)
    };
    let words = match section("TOKENS") {
        Some(at) => tokens(Reader::new(bytes, at))?,
        None => Vec::new(),
    };
    let tokens: Vec<&[u8]> = words.split(|&byte| byte == 0).collect();
    // each ends with a 0: what follows the last is none
    let tokens = &tokens[..tokens.len() - 1];
    let has_classes =
        tokens.contains(&&b"inheritPaths"[..]) || tokens.contains(&&b"specializes"[..]);
    if let Some(at) = section("STRINGS") {
        let mut reader = Reader::new(bytes, at);
        let count = reader.count(4)?;
        for _ in 0..count {
            below(u64::from(reader.u32()?), tokens.len() as u64, "string")?;
        }
    }
    if let Some(at) = section("PATHS") {
        paths(Reader::new(bytes, at), tokens)?;
    }
    if let Some(at) = section("FIELDSETS") {
        let mut reader = Reader::new(bytes, at);
        let count = reader.u64()?;
        reader.ints(count)?;
    }
    if let Some(at) = section("SPECS") {
        let mut reader = Reader::new(bytes, at);
        let count = reader.u64()?;
        for _ in 0..3 {
            reader.ints(count)?;
        }
    }
    if let Some(at) = section("FIELDS") {
        crate_values::check(bytes, minor, &reps(Reader::new(bytes, at))?)?;
    }
    let has_relocates = arc_cycles::WORDS
        .iter()
        .any(|word| tokens.contains(&word.as_bytes()));
    Ok(Soundness {
        has_classes,
        has_relocates,
        has_variables: tokens.contains(&FieldKey::ExpressionVariables.as_str().as_bytes()),
    })
}

fn version(bytes: &[u8]) -> Result<u8, String> {
    match bytes.get(8..10) {
        Some([0, minor]) if VERSIONS.contains(minor) => Ok(*minor),
        Some([major, minor]) => Err(format!(
            "crate version {major}.{minor} cannot be read, only 0.{} to 0.{}",
            VERSIONS.start(),
            VERSIONS.end()
        )),
        _ => Err(cut_off()),
    }
}

fn sections(bytes: &[u8]) -> Result<Vec<(String, usize)>, String> {
    let table = Reader::new(bytes, 16).u64()?;
    let mut reader = Reader::new(bytes, usize::try_from(table).map_err(|_| cut_off())?);
    let count = reader.count(SECTION_BYTES)?;
    if count as u64 >= MOST_SECTIONS {
        return Err(format!("{count} sections are more than a crate file has"));
    }
    let mut sections = Vec::new();
    for _ in 0..count {
        let name = reader.take(16)?;
        let name = name.split(|&byte| byte == 0).next().unwrap_or_default();
        let start = reader.u64()?;
        let size = reader.u64()?;
        if start
            .checked_add(size)
            .is_none_or(|end| end > bytes.len() as u64)
        {
            return Err(cut_off());
        }
        let start = usize::try_from(start).map_err(|_| cut_off())?;
        sections.push((String::from_utf8_lossy(name).into_owned(), start));
    }
    Ok(sections)
}

/// All tokens, each with a 0 behind it.
fn tokens(mut reader: Reader<'_>) -> Result<Vec<u8>, String> {
    let count = reader.u64()?;
    let size = reader.u64()?;
    let text = reader.decompressed(size)?;
    let held = text.iter().filter(|&&byte| byte == 0).count() as u64;
    match held == count && text.len() as u64 == size {
        true => Ok(text),
        false => Err(format!("{count} tokens announced, {held} found")),
    }
}

fn reps(mut reader: Reader<'_>) -> Result<Vec<u64>, String> {
    let count = reader.u64()?;
    reader.ints(count)?;
    let bytes = reader.decompressed(count.saturating_mul(8))?;
    let reps: Vec<u64> = bytes
        .chunks_exact(8)
        .map(|rep| Reader::new(rep, 0).u64())
        .collect::<Result<_, _>>()?;
    match reps.len() as u64 == count {
        true => Ok(reps),
        false => Err(format!("{count} fields announced, {} found", reps.len())),
    }
}

/// Follow the tree of paths as the crate will: every entry must be reached at most once.
fn paths(mut reader: Reader<'_>, tokens: &[&[u8]]) -> Result<(), String> {
    let path_count = reader.u64()?;
    let count = reader.u64()?;
    let indices = reader.ints(count)?;
    let elements = reader.ints(count)?;
    let jumps = reader.ints(count)?;
    // the empty path, which a reference without a prim has, is counted and not in the tree
    if path_count != count && path_count != count.saturating_add(1) {
        return Err(format!("{path_count} paths announced, {count} found"));
    }
    let mut reached = vec![false; jumps.len()];
    let mut pending = if jumps.is_empty() {
        vec![]
    } else {
        vec![(0_usize, 0_usize)]
    };
    while let Some((mut index, mut depth)) = pending.pop() {
        loop {
            let Some(seen) = reached.get_mut(index) else {
                return Err("the tree of paths leaves its section".to_owned());
            };
            if std::mem::replace(seen, true) || depth > DEEPEST {
                return Err("the tree of paths is damaged or too deep".to_owned());
            }
            below(
                u64::from(indices[index].cast_unsigned()),
                path_count,
                "path",
            )?;
            if index > 0 {
                element(elements[index], tokens)?;
            }
            let jump = jumps[index];
            let has_child = jump > 0 || jump == -1;
            if !has_child && jump < 0 {
                break;
            }
            if jump > 0 {
                pending.push((index + jump.unsigned_abs() as usize, depth));
            }
            depth += usize::from(has_child);
            index += 1;
        }
    }
    Ok(())
}

/// A step of a path: a property (below 0), a prim, a variant in braces, or a target in brackets.
fn element(index: i32, tokens: &[&[u8]]) -> Result<(), String> {
    let at = index.unsigned_abs();
    below(u64::from(at), tokens.len() as u64, "token")?;
    let name = String::from_utf8_lossy(tokens[at as usize]);
    let is_other = name.starts_with(['[', '.']) || is_variant(&name);
    let is_sound = index < 0 || is_other || is_identifier(&name);
    match is_sound {
        true => Ok(()),
        false => Err(format!(
            "{name:?} is no name of a prim (letters, digits and _, no digit first)"
        )),
    }
}

/// `{set=choice}`.
fn is_variant(name: &str) -> bool {
    name.starts_with('{') && name.ends_with('}') && name.contains('=')
}

fn below(index: u64, count: u64, what: &str) -> Result<(), String> {
    match index < count {
        true => Ok(()),
        false => Err(format!("{what} {index} of {count}")),
    }
}

pub(super) fn cut_off() -> String {
    "the file is cut off or damaged".to_owned()
}

/// Reads a crate file from a position on; every read is checked against the file's end.
#[derive(Clone, Copy)]
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    pub(super) at: usize,
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at }
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let end = self.at.checked_add(count);
        let taken = end
            .and_then(|end| self.bytes.get(self.at..end))
            .ok_or_else(cut_off)?;
        self.at += count;
        Ok(taken)
    }

    pub(super) fn u8(&mut self) -> Result<u8, String> {
        Ok(self.take(1)?[0])
    }

    pub(super) fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(
            self.take(4)?.try_into().map_err(|_| cut_off())?,
        ))
    }

    pub(super) fn u64(&mut self) -> Result<u64, String> {
        Ok(u64::from_le_bytes(
            self.take(8)?.try_into().map_err(|_| cut_off())?,
        ))
    }

    /// A count of items of at least `size` bytes each, all of which the rest of the file can hold.
    pub(super) fn count(&mut self, size: usize) -> Result<usize, String> {
        let count = self.u64()?;
        self.holds(count, size)
    }

    /// `count`, if the rest of the file can hold that many items of `size` bytes.
    pub(super) fn holds(&self, count: u64, size: usize) -> Result<usize, String> {
        let rest = self.bytes.len().saturating_sub(self.at);
        let count = usize::try_from(count).map_err(|_| cut_off())?;
        match count.checked_mul(size).is_some_and(|bytes| bytes <= rest) {
            true => Ok(count),
            false => Err(cut_off()),
        }
    }

    /// A compressed block of at most `most` bytes.
    fn decompressed(&mut self, most: u64) -> Result<Vec<u8>, String> {
        let size = self.count(1)?;
        let block = self.take(size)?;
        let most = usize::try_from(most).map_err(|_| cut_off())?;
        if block.is_empty() && most == 0 {
            return Ok(Vec::new());
        }
        lz4(block, most)
    }

    /// `count` compressed 32-bit integers: deltas of 0, 1, 2 or 4 bytes after 2-bit codes (`integerCoding.cpp`).
    fn ints(&mut self, count: u64) -> Result<Vec<i32>, String> {
        let data = self.decompressed(int_bytes(count))?;
        if count == 0 {
            return Ok(Vec::new());
        }
        let count = usize::try_from(count).map_err(|_| cut_off())?;
        let mut codes = Reader::new(&data, 0);
        let common = codes.u32()?;
        let code_bytes = codes.take(count.div_ceil(4))?;
        let mut deltas = codes;
        let mut value = 0_u32;
        let mut ints = Vec::with_capacity(count);
        for index in 0..code_bytes.len() * 4 {
            let delta = match (code_bytes[index / 4] >> (2 * (index % 4))) & 3 {
                0 => common,
                1 => i32::from(deltas.u8()?.cast_signed()).cast_unsigned(),
                2 => {
                    let pair = deltas.take(2)?;
                    i32::from(i16::from_le_bytes([pair[0], pair[1]])).cast_unsigned()
                }
                _ => deltas.u32()?,
            };
            value = value.wrapping_add(delta);
            if index < count {
                ints.push(value.cast_signed());
            }
        }
        Ok(ints)
    }
}

/// Most bytes that `count` integers of 32 bits are coded in.
pub(super) fn int_bytes(count: u64) -> u64 {
    count.saturating_mul(5).saturating_add(8)
}

/// Decompress an LZ4 block (`lz4_Block_format.md`) behind its chunk count, which must be 0, to at most `most` bytes.
fn lz4(block: &[u8], most: usize) -> Result<Vec<u8>, String> {
    let mut out = Vec::new();
    sequences(block, |literals, offset, length| {
        out.extend_from_slice(literals);
        if out.len() + length > most || offset > out.len() {
            return Err(cut_off());
        }
        for _ in 0..length {
            out.push(out[out.len() - offset]);
        }
        Ok(())
    })?;
    Ok(out)
}

/// Bytes that the LZ4 block decompresses to, without decompressing it.
pub(super) fn lz4_length(block: &[u8]) -> Result<u64, String> {
    let mut total = 0_u64;
    sequences(block, |literals, _, length| {
        total += (literals.len() + length) as u64;
        Ok(())
    })?;
    Ok(total)
}

/// Call `each` with the literals, the match's offset and its length, of every sequence of the block.
fn sequences(
    block: &[u8],
    mut each: impl FnMut(&[u8], usize, usize) -> Result<(), String>,
) -> Result<(), String> {
    let mut reader = Reader::new(block, 0);
    if reader.u8()? != 0 {
        return Err("blocks in several chunks are not supported".to_owned());
    }
    while reader.at < block.len() {
        let token = reader.u8()?;
        let count = extended(&mut reader, usize::from(token >> 4))?;
        let literals = reader.take(count)?;
        if reader.at == block.len() {
            return each(literals, 0, 0);
        }
        let offset = usize::from(reader.u8()?) | (usize::from(reader.u8()?) << 8);
        if offset == 0 {
            return Err(cut_off());
        }
        let length = extended(&mut reader, usize::from(token & 15))? + 4;
        each(literals, offset, length)?;
    }
    Ok(())
}

/// A length of 15 goes on in the bytes that follow, up to the first that is not 255.
fn extended(reader: &mut Reader<'_>, short: usize) -> Result<usize, String> {
    let mut length = short;
    if short == 15 {
        loop {
            let more = reader.u8()?;
            length += usize::from(more);
            if more != 255 {
                break;
            }
        }
    }
    Ok(length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_lz4_block_of_the_format_s_description_decompresses() {
        // chunk count, then: 3 literals "abc", match of 9 at offset 3; 1 literal "!"
        let block = [0, 0x35, b'a', b'b', b'c', 3, 0, 0x10, b'!'];
        assert_eq!(lz4(&block, 13).unwrap(), b"abcabcabcabc!");
        assert_eq!(lz4_length(&block).unwrap(), 13);
        assert!(lz4(&block, 11).is_err());
    }

    #[test]
    fn old_and_future_versions_are_named() {
        let mut bytes = b"PXR-USDC\0\x03\0\0\0\0\0\0".to_vec();
        assert!(check(&bytes).unwrap_err().contains("0.3"));
        bytes[9] = 13;
        assert!(check(&bytes).unwrap_err().contains("0.13"));
    }

    #[test]
    fn what_the_crate_writes_is_sound_and_its_truncations_are_not() {
        let text = "#usda 1.0\ndef \"P\" { float[] a = [1, 2, 3, 4, 5]\n rel r = </P> }";
        let data = openusd::usda::parse(text).unwrap();
        let mut file = std::io::Cursor::new(Vec::new());
        openusd::usdc::CrateWriter::write(&data, &mut file).unwrap();
        let bytes = file.into_inner();
        let sound = Soundness {
            has_classes: false,
            has_relocates: false,
            has_variables: false,
        };
        assert_eq!(check(&bytes), Ok(sound));
        for length in 0..bytes.len() {
            assert!(
                check(&bytes[..length]).is_err(),
                "{length} of {}",
                bytes.len()
            );
        }
    }
}
