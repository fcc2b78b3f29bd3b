//! Damage: to bytes wherever they stand, and to the words of text.

use crate::random::Random;

/// Counts and offsets that reach beyond any file, wrap around, or are nearly right.
const ABSURD: [u64; 12] = [
    0,
    1,
    0x7f,
    0xff,
    0xffff,
    0x7fff_ffff,
    0xffff_ffff,
    0x1_0000_0000,
    0x00ff_ffff_ffff,
    0x7fff_ffff_ffff_ffff,
    0x8000_0000_0000_0000,
    u64::MAX,
];

/// Flip, overwrite, cut, repeat or move bytes; `other` is where foreign bytes come from.
pub(crate) fn bytes(bytes: &mut Vec<u8>, other: &[u8], random: &mut Random) {
    if bytes.is_empty() {
        return;
    }
    let at = random.below(bytes.len());
    match random.below(9) {
        0..=2 => bytes[at] ^= 1 << random.below(8),
        3 => bytes[at] = random.next().to_le_bytes()[0],
        4 => {
            let absurd = ABSURD[random.below(ABSURD.len())].to_le_bytes();
            let size = [1, 2, 4, 8][random.below(4)];
            let end = (at + size).min(bytes.len());
            bytes[at..end].copy_from_slice(&absurd[..end - at]);
        }
        5 => bytes.truncate(at),
        6 => drop(bytes.drain(random.part(bytes.len()))),
        7 => {
            let part = bytes[random.part(bytes.len())].to_vec();
            bytes.splice(at..at, part);
        }
        _ if other.is_empty() => {}
        _ => {
            let part = &other[random.part(other.len())];
            let end = (at + part.len()).min(bytes.len());
            bytes.splice(at..end, part.iter().copied());
        }
    }
}

/// Words that stand for much in a layer.
const WORDS: [&str; 60] = [
    "def",
    "over",
    "class",
    "Xform",
    "Mesh",
    "Points",
    "PointInstancer",
    "Scope",
    "\"a\"",
    "\"\"",
    "\"..\"",
    "</>",
    "</a>",
    "<../a>",
    "<>",
    "@case.usda@",
    "@sibling.usda@",
    "@@",
    "@./missing.usda@",
    "@sibling.usda@</a>",
    "references = </a>",
    "references = @case.usda@",
    "payload = @sibling.usda@</a>",
    "inherits = </a>",
    "specializes = </a>",
    "prepend references = [@sibling.usda@, </a>]",
    "variantSets = \"v\"",
    "variants = { string v = \"a\" }",
    "instanceable = true",
    "active = false",
    "subLayers = [@case.usda@]",
    "subLayers = [@sibling.usda@ (offset = 1; scale = 0)]",
    "relocates = { </a>: </b> }",
    "None",
    "[]",
    "{}",
    "()",
    "[",
    "]",
    "{",
    "}",
    "(",
    ")",
    "0",
    "-1",
    "1e999",
    "-inf",
    "nan",
    "4294967296",
    "2147483647",
    "-2147483648",
    "999999999999999999999",
    "0.000000000000000000001",
    "1e38",
    "timeSamples",
    "int[] faceVertexCounts = [1000000000]",
    "int[] faceVertexIndices = [2000000000, -1, 5]",
    "point3f[] points = []",
    "rel prototypes = </a>",
    "uniform token subdivisionScheme = \"loop\"",
];

/// What a word is, so that it can give way to one of its kind and the text stays sound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Space,
    Number,
    Name,
    Text,
    Asset,
    Path,
    Sign,
}

impl Kind {
    fn of(word: &str) -> Self {
        match word.chars().next() {
            None => Self::Space,
            Some(c) if c.is_whitespace() => Self::Space,
            Some(c) if c.is_ascii_digit() || "-+.".contains(c) => Self::Number,
            Some(c) if c.is_alphabetic() || c == '_' => Self::Name,
            Some('"') => Self::Text,
            Some('@') => Self::Asset,
            Some('<') => Self::Path,
            Some(_) => Self::Sign,
        }
    }
}

/// Put words of the same kind in place of some words of `text`: from itself, `other` or [`WORDS`]. Most of what comes out
/// can be parsed.
pub(crate) fn meaning(text: &str, other: &str, random: &mut Random) -> String {
    let mut words = words(text);
    let foreign = words_of_one(other);
    for _ in 0..1 + random.below(5) {
        let at = random.below(words.len());
        let kind = Kind::of(words[at]);
        if matches!(kind, Kind::Space | Kind::Sign) {
            continue;
        }
        let source: &[&str] = [&WORDS, &words[..], &foreign[..]][random.below(3)];
        let alike = source.iter().filter(|word| Kind::of(word) == kind);
        let alike: Vec<&str> = alike.copied().collect();
        if !alike.is_empty() {
            words[at] = alike[random.below(alike.len())];
        }
    }
    words.concat()
}

/// Swap, drop, repeat, replace or multiply the words of `text`; `other` is where foreign words come from.
pub(crate) fn text(text: &str, other: &str, random: &mut Random) -> String {
    let mut words = words(text);
    let foreign = words_of_one(other);
    for _ in 0..1 + random.below(4) {
        if words.is_empty() {
            break;
        }
        let at = random.below(words.len());
        match random.below(8) {
            0 => words[at] = random.one_of(&WORDS),
            1 => words.insert(at, random.one_of(&WORDS)),
            2 => drop(words.remove(at)),
            3 => {
                let with = random.below(words.len());
                words.swap(at, with);
            }
            4 => {
                let part = words[random.part(words.len())].to_vec();
                words.splice(at..at, part);
            }
            5 => drop(words.drain(random.part(words.len()))),
            6 => {
                let many = 1 << random.below(14);
                words.splice(
                    at..at,
                    std::iter::repeat_n(words[at], many).collect::<Vec<_>>(),
                );
            }
            _ => {
                let part = random.part(foreign.len());
                words.splice(at..at, foreign[part].iter().copied());
            }
        }
    }
    words.concat()
}

fn words_of_one(text: &str) -> Vec<&str> {
    if text.is_empty() {
        vec![" "]
    } else {
        words(text)
    }
}

/// `text` cut into names, numbers, quoted parts, single signs and spaces.
fn words(text: &str) -> Vec<&str> {
    let mut words = Vec::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let is_name = |c: char| c.is_alphanumeric() || "_.-+:".contains(c);
        let length = match first {
            '"' | '@' => rest[1..].find(first).map_or(rest.len(), |end| end + 2),
            '<' => rest.find('>').map_or(rest.len(), |end| end + 1),
            c if is_name(c) => rest.find(|c| !is_name(c)).unwrap_or(rest.len()),
            c if c.is_whitespace() => rest
                .find(|c: char| !c.is_whitespace())
                .unwrap_or(rest.len()),
            c => c.len_utf8(),
        };
        let (word, behind) = rest.split_at(length);
        words.push(word);
        rest = behind;
    }
    words
}
