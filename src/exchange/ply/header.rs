//! The header of a PLY file.

/// Longest header looked for, bytes: files with thousands of properties stay below.
const LONGEST: usize = 1 << 20;

/// Type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_word(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    pub(super) fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// How numbers are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Ascii,
    Little,
    Big,
}

/// A property of an element.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Property {
    One(String, Scalar),
    /// Type of the count, type of the items.
    List(Scalar, Scalar),
}

/// An element as declared.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
}

/// A header.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub(super) format: Format,
    pub(super) elements: Vec<Element>,
    pub(super) comments: Vec<String>,
    /// Where the data begins.
    pub(super) end: usize,
}

impl Header {
    /// The header of the file with content `bytes`. The error says what is wrong.
    pub(super) fn parse(bytes: &[u8]) -> Result<Self, String> {
        if !bytes.starts_with(b"ply\n") && !bytes.starts_with(b"ply\r") {
            return Err("it is not a PLY file: its first line is not \"ply\"".to_owned());
        }
        let mut header = Self {
            format: Format::Ascii,
            elements: Vec::new(),
            comments: Vec::new(),
            end: 0,
        };
        let mut format = None;
        let mut at = 0;
        loop {
            let rest = &bytes[at..bytes.len().min(LONGEST)];
            let length = rest
                .iter()
                .position(|&byte| byte == b'\n')
                .ok_or("its header has no end_header line")?;
            let line = std::str::from_utf8(&rest[..length])
                .map_err(|_| "its header is not text".to_owned())?;
            at += length + 1;
            let line = line.trim();
            if line == "end_header" {
                break;
            }
            header.line(line, &mut format)?;
        }
        header.format = format.ok_or("its header names no format")?;
        header.end = at;
        Ok(header)
    }

    fn line(&mut self, line: &str, format: &mut Option<Format>) -> Result<(), String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let unknown = || format!("its header has the line {line:?}, which PLY does not know");
        match words[..] {
            [] | ["ply"] | ["obj_info", ..] => {}
            ["comment", ..] => {
                let text = line.strip_prefix("comment").unwrap_or_default();
                self.comments.push(text.trim().to_owned());
            }
            ["format", word, _] => {
                *format = Some(match word {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::Little,
                    "binary_big_endian" => Format::Big,
                    _ => return Err(unknown()),
                });
            }
            ["element", name, count] => self.elements.push(Element {
                name: name.to_owned(),
                count: count.parse().map_err(|_| unknown())?,
                properties: Vec::new(),
            }),
            ["property", "list", count, item, _] => {
                let types = Scalar::from_word(count).zip(Scalar::from_word(item));
                let (count, item) = types.ok_or_else(unknown)?;
                self.add(Property::List(count, item))?;
            }
            ["property", word, name] => {
                let scalar = Scalar::from_word(word).ok_or_else(unknown)?;
                self.add(Property::One(name.to_owned(), scalar))?;
            }
            _ => return Err(unknown()),
        }
        Ok(())
    }

    fn add(&mut self, property: Property) -> Result<(), String> {
        let element = self.elements.last_mut();
        let element = element.ok_or("its header has a property before any element")?;
        element.properties.push(property);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_read_as_the_format_has_it() {
        let text = b"ply\r\nformat binary_big_endian 1.0\r\ncomment hi there\r\nelement vertex 3\r\n\
            property float x\r\nproperty uchar red\r\nelement face 1\r\nproperty list uchar int vertex_indices\r\n\
            end_header\r\nrest";
        let header = Header::parse(text).unwrap();
        assert_eq!(header.format, Format::Big);
        assert_eq!(header.comments, ["hi there"]);
        assert_eq!(header.elements[0].count, 3);
        assert_eq!(
            header.elements[0].properties[1],
            Property::One("red".to_owned(), Scalar::U8)
        );
        assert_eq!(
            header.elements[1].properties,
            [Property::List(Scalar::U8, Scalar::I32)]
        );
        assert_eq!(&text[header.end..], b"rest");
    }

    #[test]
    fn what_is_no_header_is_told() {
        for (text, word) in [
            ("plx\n", "first line"),
            ("ply\nformat ascii 1.0\n", "end_header"),
            ("ply\nend_header\n", "format"),
            ("ply\nproperty float x\n", "before any element"),
            ("ply\nelement vertex -1\n", "element vertex -1"),
            ("ply\nformat middle_endian 1.0\n", "middle"),
        ] {
            let error = Header::parse(text.as_bytes()).unwrap_err();
            assert!(error.contains(word), "{error}");
        }
    }
}
