//! Damage inside the compressed sections of a binary layer, compressed anew: what a flipped bit alone never reaches.
//!
//! Layout: `pxr/usd/usd/crateFile.cpp` of OpenUSD.

use crate::mutate;
use crate::random::Random;
use std::ops::Range;

/// Name and number of 64-bit numbers in front of the compressed blocks.
const SECTIONS: [(&[u8], usize); 5] = [
    (b"TOKENS", 2),
    (b"FIELDS", 1),
    (b"FIELDSETS", 1),
    (b"PATHS", 2),
    (b"SPECS", 1),
];

/// Decompressed blocks are at most this large in the stages that are damaged here.
const LARGEST_BLOCK: usize = 1 << 22;

/// Damage one section of the layer `file` in its decompressed form; the section goes to the file's end. Nothing is done
/// to what is no binary layer.
pub(crate) fn damage(file: &mut Vec<u8>, random: &mut Random) -> Option<()> {
    let (name, numbers) = SECTIONS[random.below(SECTIONS.len())];
    let entry = entry(file, name)?;
    let range = range(file, entry)?;
    let mut section = file.get(range.clone())?.get(..8 * numbers)?.to_vec();
    let mut blocks = blocks(file.get(range)?.get(8 * numbers..)?)?;
    let chosen = random.below(blocks.len());
    let other = blocks[random.below(blocks.len())].clone();
    for _ in 0..1 + random.below(3) {
        mutate::bytes(&mut blocks[chosen], &other, random);
    }
    if random.below(4) == 0 {
        mutate::bytes(&mut section, &[], random);
    }
    for block in blocks {
        let mut packed = vec![0];
        packed.extend(lz4_flex::block::compress(&block));
        section.extend((packed.len() as u64).to_le_bytes());
        section.extend(packed);
    }
    let start = file.len() as u64;
    file[entry + 16..entry + 24].copy_from_slice(&start.to_le_bytes());
    file[entry + 24..entry + 32].copy_from_slice(&(section.len() as u64).to_le_bytes());
    file.extend(section);
    Some(())
}

/// Where the table of contents tells of the section `name`.
fn entry(file: &[u8], name: &[u8]) -> Option<usize> {
    let table = number(file, 16)?;
    let count = number(file, table)?;
    let entries = (0..count.min(64)).map(|index| table + 8 + 32 * index);
    let is_named = |at: usize| {
        let found = file.get(at..at + 16)?;
        let end = found.iter().position(|&byte| byte == 0)?;
        (found[..end] == *name).then_some(at)
    };
    entries.into_iter().find_map(is_named)
}

fn range(file: &[u8], entry: usize) -> Option<Range<usize>> {
    let start = number(file, entry + 16)?;
    Some(start..start.checked_add(number(file, entry + 24)?)?)
}

fn blocks(mut rest: &[u8]) -> Option<Vec<Vec<u8>>> {
    let mut blocks = Vec::new();
    while !rest.is_empty() {
        let size = number(rest, 0)?;
        let packed = rest.get(9..8_usize.checked_add(size)?)?;
        blocks.push(lz4_flex::block::decompress(packed, LARGEST_BLOCK).ok()?);
        rest = &rest[8 + size..];
    }
    (!blocks.is_empty()).then_some(blocks)
}

fn number(bytes: &[u8], at: usize) -> Option<usize> {
    let bytes = bytes.get(at..at.checked_add(8)?)?;
    usize::try_from(u64::from_le_bytes(bytes.try_into().ok()?)).ok()
}
