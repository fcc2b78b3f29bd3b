//! Text layers (`.usda`) as Pixar's parser takes them → as the crate's parser takes them.
//!
//! Repaired: numbers like `.5` and `5.`, quoted asset paths, `True` and `False`, `//` and `/* */` comments, whole
//! numbers among the samples of a real attribute (the crate would not interpolate them), asset paths among samples,
//! escapes in strings.
//! Refused: names of prims that are no identifiers, paths that are none, several statements for one relationship in one
//! prim (the crate would keep the last), and nesting so deep that the crate's recursion would end the process.

use std::collections::BTreeSet;
use std::ops::Range;

/// Brackets open at once, at most; the deepest real scenes have some tens of prims.
const DEEPEST: usize = 2_000;

/// `text` repaired; `None` if there is nothing to repair.
///
/// # Errors
/// Text that the crate would read wrongly or not survive.
pub(super) fn repaired(text: &str) -> Result<Option<String>, String> {
    let mut scanner = Scanner::new(text);
    scanner.run()?;
    if scanner.edits.is_empty() {
        return Ok(None);
    }
    let mut out = String::with_capacity(text.len() + 2 * scanner.edits.len());
    let mut from = 0;
    for (range, replacement) in scanner.edits {
        out += &text[from..range.start];
        out += &replacement;
        from = range.end;
    }
    out += &text[from..];
    Ok(Some(out))
}

/// What the statement at hand declares, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Declared {
    #[default]
    Other,
    Real,
    Asset,
}

/// An open bracket.
#[derive(Debug, Default)]
struct Frame {
    /// Its content is time samples of this kind.
    samples: Option<Declared>,
    /// Its content is a list of asset paths.
    assets: bool,
    /// Relationships that have been given targets in it.
    relationships: BTreeSet<String>,
}

struct Scanner<'a> {
    text: &'a str,
    bytes: &'a [u8],
    at: usize,
    edits: Vec<(Range<usize>, String)>,
    frames: Vec<Frame>,
    /// The last punctuation or 0 after anything else.
    last: u8,
    declared: Declared,
    samples: bool,
    asset_expected: bool,
    relationship: Option<Option<String>>,
    /// A specifier was read: the next string names a prim.
    names_prim: bool,
}

impl<'a> Scanner<'a> {
    fn new(text: &'a str) -> Self {
        Self {
            text,
            bytes: text.as_bytes(),
            at: 0,
            edits: Vec::new(),
            frames: vec![Frame::default()],
            last: 0,
            declared: Declared::Other,
            samples: false,
            asset_expected: false,
            relationship: None,
            names_prim: false,
        }
    }

    fn peek(&self, ahead: usize) -> u8 {
        self.bytes.get(self.at + ahead).copied().unwrap_or(0)
    }

    fn run(&mut self) -> Result<(), String> {
        while self.at < self.bytes.len() {
            match self.peek(0) {
                b'\n' => self.end_of_line(),
                byte if byte.is_ascii_whitespace() => self.at += 1,
                b'#' => self.skip_line(),
                b'/' if matches!(self.peek(1), b'/' | b'*') => self.comment(),
                b'"' | b'\'' => self.string()?,
                b'@' => self.asset(),
                b'<' => self.path()?,
                byte if byte.is_ascii_digit() => self.number(),
                b'.' if self.peek(1).is_ascii_digit() => self.number(),
                b'-' | b'+' if self.peek(1).is_ascii_digit() || self.peek(1) == b'.' => {
                    self.number();
                }
                byte if is_name(byte) => self.name(),
                byte => self.punctuation(byte)?,
            }
        }
        Ok(())
    }

    fn end_of_line(&mut self) {
        self.at += 1;
        self.declared = Declared::Other;
        self.samples = false;
        self.relationship = None;
    }

    fn skip_line(&mut self) {
        let rest = &self.bytes[self.at..];
        self.at += rest
            .iter()
            .position(|&byte| byte == b'\n')
            .unwrap_or(rest.len());
    }

    fn path(&mut self) -> Result<(), String> {
        let inside = self.at + 1;
        let length = self.text[inside..].find('>');
        let path = length.map(|length| &self.text[inside..inside + length]);
        let Some(path) = path.filter(|path| is_path(path)) else {
            let line = self.line();
            let read = path.unwrap_or(&self.text[inside..]).lines().next();
            return Err(format!(
                "line {line}: <{} is no path of a prim or property",
                read.unwrap_or_default()
            ));
        };
        self.at = inside + path.len() + 1;
        self.last = 0;
        Ok(())
    }

    fn comment(&mut self) {
        let start = self.at;
        if self.peek(1) == b'/' {
            self.edits.push((start..start + 2, "#".to_owned()));
            return self.skip_line();
        }
        let end = self.text[start + 2..].find("*/").map(|at| start + at + 4);
        self.at = end.unwrap_or(self.bytes.len());
        self.edits.push((start..self.at, " ".to_owned()));
    }

    fn string(&mut self) -> Result<(), String> {
        let start = self.at;
        let quote = self.peek(0);
        let triple = self.peek(1) == quote && self.peek(2) == quote;
        let width = if triple { 3 } else { 1 };
        self.at += width;
        while self.at < self.bytes.len() {
            let ends = self.peek(0) == quote
                && (!triple || (self.peek(1) == quote && self.peek(2) == quote));
            if ends {
                break;
            }
            self.at += if self.peek(0) == b'\\' { 2 } else { 1 };
        }
        let inside = start + width..self.at.min(self.bytes.len());
        self.at = (self.at + width).min(self.bytes.len());
        let listed = self.frames.last().is_some_and(|frame| frame.assets);
        let content = self.text.get(inside).unwrap_or_default();
        if std::mem::take(&mut self.names_prim) && !is_identifier(content) {
            let line = self.line();
            return Err(format!(
                "line {line}: {content:?} is no name of a prim (letters, digits and _, no digit first)"
            ));
        }
        if self.asset_expected || listed {
            let marks = if content.contains('@') { "@@@" } else { "@" };
            self.edits
                .push((start..self.at, format!("{marks}{content}{marks}")));
        } else if let Some(quoted) = content.contains('\\').then(|| unescaped(content)).flatten() {
            self.edits.push((start..self.at, quoted));
        }
        self.asset_expected = false;
        self.last = 0;
        Ok(())
    }

    fn asset(&mut self) {
        let start = self.at;
        let marks = if self.bytes[start..].starts_with(b"@@@") {
            "@@@"
        } else {
            "@"
        };
        let inside = start + marks.len();
        let length = self.text[inside..].find(marks);
        let end = length.map_or(self.bytes.len(), |length| inside + length);
        self.at = (end + marks.len()).min(self.bytes.len());
        let sampled = self
            .frames
            .last()
            .is_some_and(|frame| frame.samples == Some(Declared::Asset));
        if sampled {
            let quoted = self.text[inside..end]
                .replace('\\', "\\\\")
                .replace('"', "\\\"");
            self.edits.push((start..self.at, format!("\"{quoted}\"")));
        }
        self.asset_expected = false;
        self.last = 0;
    }

    fn digits(&mut self) -> usize {
        let start = self.at;
        while self.peek(0).is_ascii_digit() {
            self.at += 1;
        }
        self.at - start
    }

    fn number(&mut self) {
        let is_sample = self.last == b':'
            && self
                .frames
                .last()
                .is_some_and(|f| f.samples == Some(Declared::Real));
        if matches!(self.peek(0), b'-' | b'+') {
            self.at += 1;
        }
        let start = self.at;
        let whole = self.digits();
        let mut is_whole = true;
        if self.peek(0) == b'.' {
            is_whole = false;
            self.at += 1;
            let dot = self.at;
            if whole == 0 {
                self.edits.push((start..start, "0".to_owned()));
            }
            if self.digits() == 0 {
                self.edits.push((dot..dot, "0".to_owned()));
            }
        }
        let signed = usize::from(matches!(self.peek(1), b'-' | b'+'));
        if matches!(self.peek(0), b'e' | b'E') && self.peek(1 + signed).is_ascii_digit() {
            is_whole = false;
            self.at += 1 + signed;
            self.digits();
        }
        if is_whole && is_sample {
            self.edits.push((self.at..self.at, ".0".to_owned()));
        }
        self.last = 0;
        self.asset_expected = false;
    }

    fn name(&mut self) {
        let start = self.at;
        while is_name(self.peek(0)) || self.peek(0).is_ascii_digit() || self.peek(0) == b':' {
            self.at += 1;
        }
        let name = &self.text[start..self.at];
        match name {
            "True" | "False" if self.last == b'=' => {
                self.edits.push((start..self.at, name.to_ascii_lowercase()));
            }
            "timeSamples" if self.last == b'.' => self.samples = true,
            "half" | "float" | "double" | "timecode" => self.declared = Declared::Real,
            "asset" => self.declared = Declared::Asset,
            "rel" => self.relationship = Some(None),
            "def" | "over" | "class" => self.names_prim = true,
            _ => {
                if let Some(relationship @ None) = &mut self.relationship {
                    *relationship = Some(name.to_owned());
                }
            }
        }
        self.last = 0;
        self.asset_expected = false;
    }

    fn punctuation(&mut self, byte: u8) -> Result<(), String> {
        self.names_prim = false;
        match byte {
            b'=' => self.assignment()?,
            b'{' | b'[' | b'(' => self.open(byte)?,
            b'}' | b']' | b')' if self.frames.len() > 1 => drop(self.frames.pop()),
            b';' => {
                self.end_of_line();
                self.at -= 1;
            }
            _ => {}
        }
        self.last = byte;
        self.at += 1;
        Ok(())
    }

    fn assignment(&mut self) -> Result<(), String> {
        if !self.samples {
            self.asset_expected = self.declared == Declared::Asset;
            self.declared = Declared::Other;
        }
        let Some(Some(name)) = self.relationship.take() else {
            return Ok(());
        };
        let frame = self
            .frames
            .last_mut()
            .expect("the outermost frame is never popped");
        match frame.relationships.insert(name.clone()) {
            true => Ok(()),
            false => {
                let line = self.line();
                Err(format!(
                    "line {line}: several statements edit the targets of relationship {name} in one prim, \
                     which is not supported in text layers"
                ))
            }
        }
    }

    /// Number of the line at hand.
    fn line(&self) -> usize {
        let before = self.bytes[..self.at].iter();
        1 + before.filter(|&&byte| byte == b'\n').count()
    }

    fn open(&mut self, byte: u8) -> Result<(), String> {
        if self.frames.len() >= DEEPEST {
            return Err(format!("brackets are nested more than {DEEPEST} deep"));
        }
        let samples = (byte == b'{' && self.samples && self.last == b'=').then_some(self.declared);
        if samples.is_some() {
            (self.samples, self.declared) = (false, Declared::Other);
        }
        self.frames.push(Frame {
            samples,
            assets: byte == b'[' && self.asset_expected,
            relationships: BTreeSet::new(),
        });
        self.asset_expected = false;
        Ok(())
    }
}

/// `content` with its escapes carried out (the crate keeps them as they are), in quotes it does not hold itself; `None`
/// for rare escapes and where no quotes fit.
fn unescaped(content: &str) -> Option<String> {
    let mut plain = String::new();
    let mut characters = content.chars();
    while let Some(character) = characters.next() {
        plain.push(match character {
            '\\' => match characters.next()? {
                'n' => '\n',
                't' => '\t',
                'r' => '\r',
                quoted @ ('\\' | '"' | '\'') => quoted,
                _ => return None,
            },
            character => character,
        });
    }
    let fits = |quote: &&str| {
        let holds_lines = quote.len() == 3 || !plain.contains('\n');
        let ends_apart = !plain.ends_with(&quote[..1]) && !plain.ends_with('\\');
        holds_lines && ends_apart && !plain.contains(*quote)
    };
    let quote = ["\"", "'", "\"\"\"", "'''"].into_iter().find(fits)?;
    Some(format!("{quote}{plain}{quote}"))
}

/// True for what a prim may be called. The crate does not survive the prim path `/}`.
pub(super) fn is_identifier(name: &str) -> bool {
    let is_letter = |letter: char| letter == '_' || letter.is_alphabetic();
    name.starts_with(is_letter) && name.chars().all(|c| is_letter(c) || c.is_alphanumeric())
}

/// True for what may stand between `<` and `>`. The crate does not come to an end with some that may not.
fn is_path(path: &str) -> bool {
    let mut open = Vec::new();
    let is_sound = path
        .chars()
        .all(|character| match (character, open.last()) {
            ('{' | '[', _) => {
                open.push(character);
                true
            }
            ('}', Some('{')) | (']', Some('[')) => open.pop().is_some(),
            ('\n' | '<' | '}' | ']', _) => false,
            (_, Some(_)) | ('/' | '.' | ':' | '_', None) => true,
            (other, None) => other.is_alphanumeric(),
        });
    let is_plain = path == "/" || !(path.ends_with('/') || path.contains("//"));
    is_sound && open.is_empty() && is_plain
}

fn is_name(byte: u8) -> bool {
    byte.is_ascii_alphabetic() || byte == b'_' || !byte.is_ascii()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn repair(text: &str) -> String {
        repaired(text).unwrap().unwrap_or_else(|| text.to_owned())
    }

    #[test]
    fn numbers_get_the_digits_the_crate_wants() {
        assert_eq!(repair("a = .5"), "a = 0.5");
        assert_eq!(
            repair("a = (-.5, 5., 2.e3, 1.5)"),
            "a = (-0.5, 5.0, 2.0e3, 1.5)"
        );
        assert_eq!(
            repair("inputs:a5.connect = </A.b5.c>"),
            "inputs:a5.connect = </A.b5.c>"
        );
    }

    #[test]
    fn strings_paths_assets_and_comments_are_left_alone() {
        for text in [
            "a = \"x .5 5. True\"",
            "a = '''it's .5'''",
            "@./.5@",
            "</A.5>",
            "# .5 5.\n",
        ] {
            assert_eq!(repaired(text).unwrap(), None, "{text}");
        }
    }

    #[test]
    fn quoted_asset_paths_become_asset_paths() {
        assert_eq!(repair("asset a = \"x.png\""), "asset a = @x.png@");
        assert_eq!(
            repair("asset[] a = [\"x\", 'y@z']"),
            "asset[] a = [@x@, @@@y@z@@@]"
        );
        assert_eq!(
            repair("asset a = @x@ (doc = \"d\")"),
            "asset a = @x@ (doc = \"d\")"
        );
        assert_eq!(
            repair("asset a.timeSamples = { 0: @x@ }"),
            "asset a.timeSamples = { 0: \"x\" }"
        );
        assert_eq!(
            repair("asset a\nstring b = \"x\""),
            "asset a\nstring b = \"x\""
        );
    }

    #[test]
    fn whole_numbers_among_samples_of_reals_become_reals() {
        let text = "double a.timeSamples = { 0: 1, 5: -2.5 }\nint b.timeSamples = { 0: 1 }";
        assert_eq!(
            repair(text),
            "double a.timeSamples = { 0: 1.0, 5: -2.5 }\nint b.timeSamples = { 0: 1 }"
        );
    }

    #[test]
    fn escapes_are_carried_out() {
        assert_eq!(repair(r#"a = "say \"hi\"""#), r#"a = 'say "hi"'"#);
        assert_eq!(repair(r#"a = "x\ny""#), "a = \"\"\"x\ny\"\"\"");
        assert_eq!(repair(r#"a = "C:\\dir""#), r#"a = "C:\dir""#);
    }

    #[test]
    fn comments_and_booleans_of_cpp_are_translated() {
        assert_eq!(repair("// c\nactive = False"), "# c\nactive = false");
        assert_eq!(repair("a /* b\n c */ = True"), "a   = true");
    }

    #[test]
    fn two_statements_for_one_relationship_are_refused() {
        let twice = "def \"P\" {\n prepend rel r = </A>\n append rel r = </B>\n}";
        assert!(repaired(twice).unwrap_err().contains("line 3"));
        let apart =
            "def \"P\" {\n rel r = </A>\n def \"Q\" {\n rel r = </B>\n }\n rel s\n rel s = </C>\n}";
        assert_eq!(repaired(apart).unwrap(), None);
    }

    #[test]
    fn prims_must_have_names_that_usd_allows() {
        for name in ["}", "", "a-b", "1", "a b", "a{v=x}", ".."] {
            let text = format!("#usda 1.0\ndef Xform \"{name}\" {{\n}}");
            assert!(repaired(&text).unwrap_err().starts_with("line 2"), "{name}");
        }
        for text in [
            "def \"_a1\" {}",
            "def X \"größe\" (doc = \"}\") { string def = \"a-b\" }",
            "over 'a' { variantSet \"v\" = { \"1-x\" { def \"b\" {} } } }",
        ] {
            assert_eq!(repaired(text), Ok(None), "{text}");
        }
    }

    #[test]
    fn paths_must_be_paths() {
        for path in [
            "</a b>", "</a\n>", "</a//b>", "</a/>", "</}>", "</a{v=x>", "</a", "< /a>", "</a\">",
        ] {
            let text = format!("def \"A\" (\n references = {path}\n) {{}}");
            assert!(repaired(&text).unwrap_err().starts_with("line 2"), "{path}");
        }
        for path in [
            "<>",
            "</>",
            "</a/b>",
            "<../b.c:d>",
            "<a{v=x-1}b.r[/t/u].w>",
            "</größe.x>",
            "<.x>",
        ] {
            assert_eq!(repaired(&format!("rel r = {path}")), Ok(None), "{path}");
        }
    }

    #[test]
    fn nesting_is_bounded() {
        assert!(repaired(&"{".repeat(100_000)).is_err());
        assert!(repaired(&"def \"a\" {".repeat(1_000)).is_ok());
    }

    #[test]
    fn text_that_ends_anywhere_is_survived() {
        let text = "def \"é\" { asset a = \"x\\\"\" /* */ // x\n double b.timeSamples = { .5: 1 } rel r = </A> @@@x@@@ '''y''' }";
        for (end, _) in text.char_indices() {
            let _ = repaired(&text[..end]);
        }
    }
}
