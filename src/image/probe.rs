//! What an image file is, by its header: no pixel is decoded.

use super::{Error, exr_file};
use crate::files::package;
use image::{ImageFormat, ImageReader};
use std::io::{BufRead, BufReader, Cursor, Read, Seek};
use std::path::{Path, PathBuf};

/// Numbers of the tiles of a UDIM set.
const TILES: std::ops::RangeInclusive<u32> = 1001..=1100;
const UDIM: &str = "<UDIM>";

/// Size of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Probe {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Bytes of the file.
    pub bytes: u64,
}

/// The files that `path` names: itself, or the tiles that exist where it has `<UDIM>`.
pub fn tiles(path: &Path) -> Vec<PathBuf> {
    let pattern = path.to_string_lossy();
    if !pattern.contains(UDIM) {
        return vec![path.to_owned()];
    }
    let files = TILES.map(|tile| PathBuf::from(pattern.replace(UDIM, &tile.to_string())));
    files.filter(|file| package::exists(file)).collect()
}

/// Size of the image at `path`, which may be inside a package. Reads the header of a plain file, the whole entry of a
/// package.
///
/// # Errors
/// Files that are missing, or whose header is that of no known image.
pub fn probe(path: &Path) -> Result<Probe, Error> {
    let unreadable = |source| Error::Unreadable {
        path: path.to_owned(),
        source,
    };
    let undecodable = |message: String| Error::Undecodable {
        path: path.to_owned(),
        message,
    };
    let text = path.to_string_lossy();
    let (size, bytes) = if package::split(&text).is_some() {
        let bytes = package::read(path).map_err(unreadable)?;
        let length = bytes.len() as u64;
        (size(Cursor::new(bytes), &text), length)
    } else {
        let file = std::fs::File::open(path).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        (size(BufReader::new(file), &text), length)
    };
    let (width, height) = size.map_err(undecodable)?;
    Ok(Probe {
        width,
        height,
        bytes,
    })
}

fn size(mut file: impl BufRead + Seek, name: &str) -> Result<(usize, usize), String> {
    /// Longest signature of the formats read.
    const SIGNATURE: usize = 16;
    let mut start = Vec::with_capacity(SIGNATURE);
    let read = file.by_ref().take(SIGNATURE as u64).read_to_end(&mut start);
    read.map_err(|error| error.to_string())?;
    file.rewind().map_err(|error| error.to_string())?;
    if exr_file::is_exr(&start) {
        let meta = exr::meta::MetaData::read_from_buffered(file, false);
        let meta = meta.map_err(|error| error.to_string())?;
        let header = meta.headers.first().ok_or("no image is in it")?;
        return Ok((header.layer_size.0, header.layer_size.1));
    }
    let by_name = || ImageFormat::from_path(name.trim_end_matches(']'));
    let format = image::guess_format(&start).or_else(|_| by_name());
    let format =
        format.map_err(|_| "not a PNG, JPEG, TGA, BMP, TIFF, HDR or EXR file".to_owned())?;
    let size = ImageReader::with_format(file, format).into_dimensions();
    let (width, height) = size.map_err(|error| error.to_string())?;
    Ok((width as usize, height as usize))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_those_of_the_header_and_missing_files_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let png = folder.path().join("a.png");
        image::GrayImage::new(7, 5).save(&png).unwrap();
        let found = probe(&png).unwrap();
        assert_eq!((found.width, found.height), (7, 5));
        assert_eq!(found.bytes, std::fs::metadata(&png).unwrap().len());
        assert!(probe(&folder.path().join("b.png")).is_err());
        std::fs::write(folder.path().join("c.png"), "no image").unwrap();
        assert!(probe(&folder.path().join("c.png")).is_err());
    }

    #[test]
    fn a_set_is_its_tiles() {
        let folder = tempfile::tempdir().unwrap();
        for tile in ["t.1001.png", "t.1012.png"] {
            std::fs::write(folder.path().join(tile), "x").unwrap();
        }
        let found = tiles(&folder.path().join("t.<UDIM>.png"));
        let names: Vec<_> = found.iter().filter_map(|path| path.file_name()).collect();
        assert_eq!(names, ["t.1001.png", "t.1012.png"]);
    }
}
