//! Names of the files a job writes, and checks before anything is computed.

use super::{Error, OutputJob};
use std::path::{Path, PathBuf};

/// `pattern` with each run of `#` replaced by the frame, zero-padded to its length; fractional frames as `0101.250`
/// where a second run of `#` follows a dot. A pattern without `#` stays as it is.
pub(super) fn frame_path(pattern: &Path, time: Option<f64>) -> PathBuf {
    let text = pattern.to_string_lossy();
    let (Some(time), Some(start)) = (time, text.find('#')) else {
        return pattern.to_path_buf();
    };
    let digits = text[start..].chars().take_while(|c| *c == '#').count();
    let rest = &text[start + digits..];
    let decimals = rest
        .strip_prefix('.')
        .map_or(0, |rest| rest.chars().take_while(|c| *c == '#').count());
    let (width, rest) = if decimals > 0 {
        (digits + 1 + decimals, &rest[1 + decimals..])
    } else {
        (digits, rest)
    };
    PathBuf::from(format!("{}{time:0width$.decimals$}{rest}", &text[..start]))
}

/// The small picture beside `output`.
pub(super) fn thumbnail_path(output: &Path) -> PathBuf {
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    output.with_file_name(format!("{stem}_thumbnail.png"))
}

/// Refuse, before anything is computed, folders that do not exist and, with `--no-clobber`, files that do.
pub(super) fn check(job: &OutputJob, paths: &[PathBuf]) -> Result<(), Error> {
    for path in paths {
        if job.no_clobber && path.exists() {
            return Err(Error::Exists { path: path.clone() });
        }
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
            return Err(Error::NoFolder {
                path: path.clone(),
                folder: folder.to_path_buf(),
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_become_padded_frames() {
        let path = |pattern: &str, time| frame_path(Path::new(pattern), time).display().to_string();
        assert_eq!(path("a/s.####.exr", Some(7.0)), "a/s.0007.exr");
        assert_eq!(path("a/s.####.###.exr", Some(101.25)), "a/s.0101.250.exr");
        assert_eq!(path("a/s.exr", Some(7.0)), "a/s.exr");
        assert_eq!(path("a/s.##.exr", None), "a/s.##.exr");
        assert_eq!(path("s.####.exr", Some(-3.0)), "s.-003.exr");
    }
}
