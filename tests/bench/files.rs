//! Plain files of numbers: what benchmarks and `embree_rival.c` tell each other.

use std::io::Write;
use std::path::Path;

/// `numbers` as little-endian floats, nothing else.
pub(crate) fn save(path: &Path, numbers: impl Iterator<Item = f32>) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    for number in numbers {
        file.write_all(&number.to_le_bytes())?;
    }
    file.flush()
}

/// What [`save`] or the rival wrote.
#[allow(dead_code, reason = "one of the benchmarks only writes")]
pub(crate) fn load(path: &Path) -> std::io::Result<Vec<f32>> {
    let bytes = std::fs::read(path)?;
    let numbers = bytes.chunks_exact(4);
    let number = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    Ok(numbers.map(number).collect())
}
