//! A glTF file with its buffers, checked.

use super::check;
use crate::diagnostics::Diagnostics;
use crate::exchange::{Error, malformed, read_file};
use crate::writers::from_base64;
use serde_json::Value;
use std::borrow::Cow;
use std::path::{Path, PathBuf};

/// A file as read.
pub(super) struct Document {
    pub(super) gltf: gltf::Document,
    /// One a buffer.
    pub(super) buffers: Vec<Vec<u8>>,
    /// Where relative names start from.
    pub(super) folder: PathBuf,
    pub(super) path: PathBuf,
}

impl Document {
    pub(super) fn open(path: &Path, diagnostics: &Diagnostics) -> Result<Self, Error> {
        let bytes = read_file(path)?;
        let malformed = malformed(path);
        let (text, blob) = split(&bytes).map_err(&malformed)?;
        let mut value: Value = serde_json::from_slice(&text)
            .map_err(|error| malformed(format!("its JSON is damaged: {error}")))?;
        check::version(&value).map_err(&malformed)?;
        check::required(&mut value, path, diagnostics).map_err(&malformed)?;
        check::complete(&mut value);
        let root: gltf::json::Root = serde_json::from_value(value)
            .map_err(|error| malformed(format!("it is no glTF 2.0: {error}")))?;
        check::valid(&root).map_err(&malformed)?;
        let gltf = gltf::Document::from_json_without_validation(root);
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let buffers = buffers(&gltf, blob, &folder).map_err(&malformed)?;
        Ok(Self {
            gltf,
            buffers,
            folder,
            path: path.to_owned(),
        })
    }

    /// The bytes of a view of a buffer.
    pub(super) fn view(&self, view: &gltf::buffer::View<'_>) -> Result<&[u8], String> {
        let buffer = &self.buffers[view.buffer().index()];
        let end = view.offset().checked_add(view.length());
        let bytes = end.and_then(|end| buffer.get(view.offset()..end));
        bytes.ok_or_else(|| {
            format!(
                "bufferView {} reaches to byte {} + {} of a buffer of {} bytes",
                view.index(),
                view.offset(),
                view.length(),
                buffer.len()
            )
        })
    }
}

/// JSON, and the binary part if there is one.
type Parts<'a> = (Cow<'a, [u8]>, Option<Cow<'a, [u8]>>);

/// The parts of a file.
fn split(bytes: &[u8]) -> Result<Parts<'_>, String> {
    if !bytes.starts_with(b"glTF") {
        return Ok((Cow::Borrowed(bytes), None));
    }
    if bytes.get(4..8) == Some(&1_u32.to_le_bytes()) {
        return Err(check::OLD.to_owned());
    }
    let glb = gltf::binary::Glb::from_slice(bytes);
    let glb = glb.map_err(|error| format!("it is no complete GLB: {error}"))?;
    Ok((glb.json, glb.bin))
}

fn buffers(
    gltf: &gltf::Document,
    blob: Option<Cow<'_, [u8]>>,
    folder: &Path,
) -> Result<Vec<Vec<u8>>, String> {
    let mut blob = blob.map(Cow::into_owned);
    let mut buffers = Vec::new();
    for buffer in gltf.buffers() {
        let bytes = match buffer.source() {
            gltf::buffer::Source::Bin => blob.take().ok_or("its binary part is missing")?,
            gltf::buffer::Source::Uri(uri) => resolve(uri, folder)?,
        };
        if bytes.len() < buffer.length() {
            return Err(format!(
                "buffer {} has {} of {} bytes",
                buffer.index(),
                bytes.len(),
                buffer.length()
            ));
        }
        buffers.push(bytes);
    }
    Ok(buffers)
}

/// What a URI names: data in it, or a file.
pub(super) fn resolve(uri: &str, folder: &Path) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, text) = data
            .split_once(";base64,")
            .ok_or("a data URI is not base64")?;
        return from_base64(text).ok_or_else(|| "a data URI is not base64".to_owned());
    }
    let path = folder.join(file_name(uri)?);
    std::fs::read(&path).map_err(|error| format!("{} cannot be read: {error}", path.display()))
}

/// A URI's path as a file's, `%20` and its like decoded.
pub(super) fn file_name(uri: &str) -> Result<String, String> {
    if uri.contains("://") {
        return Err(format!("{uri} is not a file"));
    }
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, after @ ..] = rest {
        let digits = after
            .get(..2)
            .and_then(|digits| std::str::from_utf8(digits).ok());
        let decoded = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
        match decoded.filter(|_| *first == b'%') {
            Some(byte) => {
                bytes.push(byte);
                rest = &after[2..];
            }
            None => {
                bytes.push(*first);
                rest = after;
            }
        }
    }
    String::from_utf8(bytes).map_err(|_| format!("{uri} is not the name of a file"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_are_decoded() {
        assert_eq!(file_name("a%20b/c%C3%A9.png").unwrap(), "a b/cé.png");
        assert_eq!(file_name("100%.png").unwrap(), "100%.png");
        assert!(file_name("http://x/y.png").is_err());
        assert!(file_name("%FF").is_err());
    }
}
