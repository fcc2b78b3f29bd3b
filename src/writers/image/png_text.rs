//! Text inside PNGs: who made them. PNG 1.2 §4.2.3, `iTXt`.

/// Bytes of the signature and of the header chunk, which comes first.
const HEADER: usize = 8 + 25;

/// `png` with `texts` (keyword, 1 to 79 Latin letters; text) after its header, where readers find them before the pixels;
/// as it is where it is no PNG.
pub fn annotated(mut png: Vec<u8>, texts: &[(&str, &str)]) -> Vec<u8> {
    if png.len() < HEADER || !png.starts_with(b"\x89PNG\r\n\x1a\n") {
        return png;
    }
    let rest = png.split_off(HEADER);
    for (keyword, text) in texts {
        png.extend(chunk(keyword, text));
    }
    png.extend(rest);
    png
}

fn chunk(keyword: &str, text: &str) -> Vec<u8> {
    let mut body = b"iTXt".to_vec();
    body.extend(keyword.bytes());
    // not compressed, no language, no translated keyword
    body.extend([0; 5]);
    // a zero would end the text
    body.extend(text.bytes().filter(|byte| *byte != 0));
    let length = u32::try_from(body.len() - 4).unwrap_or(u32::MAX);
    let mut chunk = length.to_be_bytes().to_vec();
    chunk.extend(&body);
    chunk.extend(crc32fast::hash(&body).to_be_bytes());
    chunk
}

#[cfg(test)]
mod tests {
    use super::super::png_of_rgb;
    use super::annotated;

    #[test]
    fn a_picture_with_text_is_the_same_picture() {
        let rgb = [1, 2, 3, 4, 5, 6];
        let plain = png_of_rgb(2, 1, &rgb);
        let told = annotated(plain.clone(), &[("Software", "surflux"), ("Comment", "ä")]);
        assert!(told.len() > plain.len());
        let read = ::image::load_from_memory(&told).unwrap().to_rgb8();
        assert_eq!(read.into_raw(), rgb);
        assert_eq!(annotated(vec![1], &[("a", "b")]), [1]);
    }
}
