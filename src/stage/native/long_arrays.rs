//! Binary layers as the crate gets them without their long arrays, which are read from the file when they are asked for.
//!
//! The crate holds the bytes of a layer as long as the stage, beside the arrays that were made of them. A layer is
//! written anew, each long default with a mark in its place; if what is read of that differs from the file in anything
//! else, the crate gets the file as it is.

use openusd::sdf::{self, AbstractData, ChildrenKey, Data, FieldKey, Value};
use openusd::usdc::{CrateData, CrateFile, CrateWriter, version};
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

/// Arrays of more elements than this are long.
const LONG: u64 = 1 << 16;

/// A file is written anew if all but this part of it is long arrays.
const MOST_OF_IT: u64 = 4;

/// What a mark begins with; USD's names have no such character.
const MARK: &str = "\u{1}surflux:array";

/// The name of the children that are properties, as binary layers spell it.
const PROPERTIES_IN_FILE: &str = "properties";

/// Long arrays that have marks in place of them.
#[derive(Default)]
pub(super) struct LongArrays(RefCell<Vec<Source>>);

/// A file, and the places of its fields with long arrays.
struct Source {
    file: CrateFile<BufReader<File>>,
    fields: Vec<usize>,
}

impl LongArrays {
    /// The sound binary layer at `path` with marks in place of its long arrays, as bytes; `None` where it has none, or
    /// time samples, or cannot be written again as it is.
    pub(super) fn without(&self, path: &Path) -> Option<Vec<u8>> {
        let mut file = CrateFile::open(BufReader::new(File::open(path).ok()?)).ok()?;
        file.validate().ok()?;
        let fields = long_defaults(&mut file, path)?;
        let number = self.0.borrow().len();
        let marked = marked(&mut file, number, &fields)?;
        let mut bytes = Cursor::new(Vec::new());
        CrateWriter::write(&marked, &mut bytes).ok()?;
        let bytes = bytes.into_inner();
        if !is_same(&marked, &CrateData::open(Cursor::new(&bytes), true).ok()?) {
            return None;
        }
        self.0.borrow_mut().push(Source { file, fields });
        Some(bytes)
    }

    /// `value`, or the array that it stands for.
    ///
    /// # Errors
    /// When the file has changed meanwhile.
    pub(super) fn restored<'a>(&self, value: Cow<'a, Value>) -> anyhow::Result<Cow<'a, Value>> {
        let Some((source, field)) = place_of(&value) else {
            return Ok(value);
        };
        let mut sources = self.0.borrow_mut();
        let Some(source) = sources.get_mut(source) else {
            return Ok(value);
        };
        let Some(&field) = source.fields.get(field) else {
            return Ok(value);
        };
        let rep = source.file.fields[field].value_rep;
        Ok(Cow::Owned(source.file.value(rep)?))
    }
}

fn mark(source: usize, field: usize) -> Value {
    Value::Token(format!("{MARK}:{source}:{field}").as_str().into())
}

fn place_of(value: &Value) -> Option<(usize, usize)> {
    let Value::Token(token) = value else {
        return None;
    };
    let places = token.as_str().strip_prefix(MARK)?.strip_prefix(':')?;
    let (source, field) = places.split_once(':')?;
    Some((source.parse().ok()?, field.parse().ok()?))
}

/// Places of the fields of `file` that are defaults with long arrays; `None` if there are none or there are time samples.
fn long_defaults(file: &mut CrateFile<BufReader<File>>, path: &Path) -> Option<Vec<usize>> {
    if file.version() < version(0, 7, 0) {
        return None;
    }
    let is = |token: usize, key: FieldKey| file.tokens[token] == key.as_str();
    let mut fields = file.fields.iter();
    if fields.any(|field| is(field.token_index, FieldKey::TimeSamples)) {
        return None;
    }
    let arrays = file.fields.iter().enumerate().filter(|(_, field)| {
        let rep = field.value_rep;
        let is_array = rep.is_array() && !rep.is_inlined() && rep.payload() > 0;
        is_array && is(field.token_index, FieldKey::Default)
    });
    let mut lengths = File::open(path).ok()?;
    let mut length = |at: u64| {
        let mut length = [0; 8];
        lengths.seek(SeekFrom::Start(at)).ok()?;
        lengths.read_exact(&mut length).ok()?;
        Some(u64::from_le_bytes(length))
    };
    let long = arrays
        .filter(|(_, field)| length(field.value_rep.payload()).is_some_and(|length| length > LONG));
    let long: Vec<usize> = long.map(|(place, _)| place).collect();
    let rest = bytes_beside(file, &long, path)?;
    (rest <= path.metadata().ok()?.len() / MOST_OF_IT).then_some(long)
}

/// How many bytes of `file` hold something else than the fields `long`, taking each as long as there is no other behind it.
fn bytes_beside(file: &CrateFile<BufReader<File>>, long: &[usize], path: &Path) -> Option<u64> {
    let places = file.fields.iter().map(|field| field.value_rep);
    let places = places.filter(|rep| !rep.is_inlined());
    let sections = file.sections.iter().map(|section| section.start);
    let ends = places.map(|rep| rep.payload()).chain(sections);
    let ends: BTreeSet<u64> = ends.collect();
    let starts = long
        .iter()
        .map(|&field| file.fields[field].value_rep.payload());
    let starts: BTreeSet<u64> = starts.collect();
    let length = path.metadata().ok()?.len();
    let of_one = |&start: &u64| {
        let mut behind = ends.range(start + 1..);
        behind.next().map_or(0, |end| end - start)
    };
    Some(length.saturating_sub(starts.iter().map(of_one).sum()))
}

/// Everything that `file` holds, with marks in place of what `long` lists.
fn marked(file: &mut CrateFile<BufReader<File>>, source: usize, long: &[usize]) -> Option<Data> {
    let mut data = Data::new();
    for at in 0..file.specs.len() {
        let spec = file.specs[at];
        let path = file.paths.get(spec.path_index)?.clone();
        let mut fields = Vec::new();
        let own = file.fieldsets.get(spec.fieldset_index..)?.iter();
        for field in own.map_while(|field| *field).collect::<Vec<_>>() {
            let value = match long.binary_search(&field) {
                Ok(place) => mark(source, place),
                Err(_) => file.value(file.fields[field].value_rep).ok()?,
            };
            let name = match file.tokens[file.fields[field].token_index].as_str() {
                PROPERTIES_IN_FILE => ChildrenKey::PropertyChildren.as_str(),
                name => name,
            };
            fields.push((name.to_owned(), value));
        }
        let spec = data.create_spec(path, spec.spec_type);
        for (name, value) in fields {
            spec.add(&name, value);
        }
    }
    Some(data)
}

fn is_same(one: &dyn AbstractData, other: &dyn AbstractData) -> bool {
    let paths = one.spec_paths();
    paths == other.spec_paths() && paths.iter().all(|path| is_same_spec(path, one, other))
}

fn is_same_spec(path: &sdf::Path, one: &dyn AbstractData, other: &dyn AbstractData) -> bool {
    let names = |data: &dyn AbstractData| {
        let mut names = data.list_fields(path).unwrap_or_default();
        names.sort_unstable();
        names
    };
    let own = names(one);
    let is_same_field = |name: &String| {
        let (one, other) = (one.try_field(path, name), other.try_field(path, name));
        matches!((one, other), (Ok(Some(one)), Ok(Some(other))) if one == other)
    };
    one.spec_type(path) == other.spec_type(path)
        && own == names(other)
        && own.iter().all(is_same_field)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "#usda 1.0\ndef \"M\" (customData = { double d = 0.1 }) {\n";

    fn written(folder: &Path, body: &str) -> std::path::PathBuf {
        let data = openusd::usda::parse(&format!("{HEAD}{body}}}\n")).unwrap();
        let path = folder.join("a.usdc");
        let mut file = File::create(&path).unwrap();
        CrateWriter::write(&data, &mut file).unwrap();
        path
    }

    fn long_list() -> String {
        let numbers: Vec<String> = (0..=LONG).map(|i| (i * i % 65_521).to_string()).collect();
        numbers.join(", ")
    }

    #[test]
    fn long_arrays_are_left_out_and_found_again() {
        let folder = tempfile::tempdir().unwrap();
        let body = format!("int[] long = [{}]\nint[] short = [1, 2]\n", long_list());
        let path = written(folder.path(), &body);
        let arrays = LongArrays::default();
        let bytes = arrays.without(&path).unwrap();
        assert!(bytes.len() < 4000, "{}", bytes.len());
        let thin = CrateData::open(Cursor::new(&bytes), true).unwrap();
        let whole = CrateData::open(File::open(&path).unwrap(), true).unwrap();
        for (name, is_left_out) in [("/M.long", true), ("/M.short", false)] {
            let path = sdf::Path::new(name).unwrap();
            let field = FieldKey::Default.as_str();
            let found = thin.try_field(&path, field).unwrap().unwrap();
            assert_eq!(matches!(*found, Value::Token(_)), is_left_out);
            let found = arrays.restored(found).unwrap();
            assert_eq!(found, whole.try_field(&path, field).unwrap().unwrap());
        }
    }

    #[test]
    fn layers_without_long_arrays_and_those_that_move_stay_as_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let moving = format!(
            "int[] a = [{}]\nint b.timeSamples = {{ 1: 2 }}\n",
            long_list()
        );
        for body in ["int[] a = [1, 2]\n", &moving] {
            let path = written(folder.path(), body);
            assert!(LongArrays::default().without(&path).is_none());
        }
    }

    /// A token of a file that looks like a mark is the token that it is.
    #[test]
    fn what_only_looks_like_a_mark_stays() {
        let token = mark(0, 0);
        let restored = LongArrays::default().restored(Cow::Borrowed(&token));
        assert_eq!(*restored.unwrap(), token);
    }
}
