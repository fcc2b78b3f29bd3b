//! Sorts the attributes of EXR headers by name.
//!
//! The exr crate keeps custom attributes in hash maps and writes them in the order of these, which changes from run
//! to run. Equal images should be equal files, and OpenEXR's own writers sort by name. Chunk offsets are absolute
//! and sorting keeps all sizes, so nothing else changes.

/// Magic number and version.
const PREAMBLE: usize = 8;
/// Bit of the version field: several headers, ended by an empty one.
const MULTI_PART: u8 = 0x10;

/// Sort the attributes of every header of an EXR file in memory; leaves anything it cannot parse as it is.
pub(super) fn sort_attributes(file: &mut [u8]) {
    let is_multi_part = file.get(5).is_some_and(|flags| flags & MULTI_PART != 0);
    let mut start = PREAMBLE;
    while let Some(ends) = attribute_ends(file, start) {
        let Some(&end) = ends.last() else { return };
        let mut from = start;
        let mut attributes: Vec<Vec<u8>> = Vec::with_capacity(ends.len());
        for to in ends {
            attributes.push(file[from..to].to_vec());
            from = to;
        }
        attributes.sort_unstable_by(|a, b| name(a).cmp(name(b)));
        file[start..end].copy_from_slice(&attributes.concat());
        // Past the zero that ends the header.
        start = end + 1;
        if !is_multi_part {
            return;
        }
    }
}

fn name(attribute: &[u8]) -> &[u8] {
    attribute
        .split(|byte| *byte == 0)
        .next()
        .unwrap_or_default()
}

/// Where each attribute of the header at `start` ends; empty for an empty header, `None` if it is broken.
fn attribute_ends(file: &[u8], start: usize) -> Option<Vec<usize>> {
    let mut ends = Vec::new();
    let mut at = start;
    while *file.get(at)? != 0 {
        let after_name = at + zero_in(file.get(at..)?)? + 1;
        let after_type = after_name + zero_in(file.get(after_name..)?)? + 1;
        let size = file.get(after_type..after_type + 4)?.try_into().ok()?;
        at = after_type + 4 + usize::try_from(i32::from_le_bytes(size)).ok()?;
        file.get(at)?;
        ends.push(at);
    }
    Some(ends)
}

fn zero_in(bytes: &[u8]) -> Option<usize> {
    bytes.iter().position(|byte| *byte == 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attribute(name: &str, data: &[u8]) -> Vec<u8> {
        let size = i32::try_from(data.len()).unwrap().to_le_bytes();
        [name.as_bytes(), b"\0string\0", &size, data].concat()
    }

    #[test]
    fn attributes_of_all_headers_are_sorted_and_the_rest_is_kept() {
        let (a, b, c) = (
            attribute("a", b"1\0\0"),
            attribute("b", b""),
            attribute("c", b"xyz"),
        );
        for (flags, headers) in [(0, 1), (MULTI_PART, 2)] {
            let preamble = [0x76, 0x2f, 0x31, 0x01, 2, flags, 0, 0];
            let mut mixed = preamble.to_vec();
            let mut sorted = preamble.to_vec();
            for _ in 0..headers {
                mixed.extend([&c[..], &a, &b, &[0]].concat());
                sorted.extend([&a[..], &b, &c, &[0]].concat());
            }
            mixed.extend(b"\0pixels");
            sorted.extend(b"\0pixels");
            sort_attributes(&mut mixed);
            assert_eq!(mixed, sorted);
        }
    }

    #[test]
    fn broken_headers_are_left_alone() {
        let whole = [
            &[0; PREAMBLE][..],
            &attribute("b", b"12"),
            &attribute("a", b""),
            &[0],
        ]
        .concat();
        for length in 0..whole.len() {
            let mut cut = whole[..length].to_vec();
            sort_attributes(&mut cut);
            assert_eq!(cut, whole[..length]);
        }
    }
}
