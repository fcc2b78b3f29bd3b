//! What a binary layer holds of the many children of one prim, from the layer's own tables.
//!
//! The crate finds each spec by its path and each field by its name. A binary layer says the same in numbers: specs with
//! equal fields have one set of fields, and of 100 000 instances beside each other only the transforms differ.

use crate::files::Bytes;
use crate::stage::raw::RawAttribute;
use openusd::sdf::{self, FieldKey, SpecType, Value};
use openusd::tf::Token;
use openusd::usdc::CrateFile;
use std::cmp::Ordering;
use std::collections::HashMap;
use std::io::Cursor;
use std::mem;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// The children of one prim, sorted by path, each followed by its properties.
pub(super) struct ChildTable {
    /// Without its paths and specs.
    file: CrateFile<Cursor<Bytes>>,
    /// The paths below the prim, one behind the other.
    names: String,
    entries: Vec<Entry>,
    /// Behind the child found last.
    next: usize,
    /// Words by their representation in the file.
    words: HashMap<u64, Value>,
    /// Attributes by the number of their fields.
    known: HashMap<usize, Vec<Arc<RawAttribute>>>,
}

#[derive(Clone, Copy)]
struct Entry {
    /// Where its path ends in the names; it begins where that of the entry before ends.
    end: usize,
    fields: usize,
    kind: SpecType,
}

/// A child.
pub(super) struct Child {
    /// Children with the same number have the same fields. (Pixar's writer sees to the reverse.)
    pub(super) fields: usize,
    /// Its properties.
    pub(super) properties: Range<usize>,
}

/// An attribute without other metadata than its type.
pub(super) struct PlainAttribute {
    pub(super) type_name: Option<Token>,
    pub(super) default: Option<Value>,
    /// The default is made of words, which many attributes have alike.
    pub(super) is_word: bool,
}

impl ChildTable {
    /// The children of the prim at `path` in the layer in the file `layer`; `None` if that is not binary.
    pub(super) fn of(layer: &str, path: &sdf::Path) -> Option<Self> {
        if path.as_str().contains('{') {
            return None;
        }
        let bytes = Bytes::of(Path::new(layer)).ok()?;
        let mut file = CrateFile::open(Cursor::new(bytes)).ok()?;
        file.validate().ok()?;
        let prefix = format!("{}/", path.as_str().trim_end_matches('/'));
        let (paths, specs) = (mem::take(&mut file.paths), mem::take(&mut file.specs));
        let below = specs.iter().filter_map(|spec| {
            let name = paths.get(spec.path_index)?.as_str().strip_prefix(&prefix)?;
            (!name.contains(['/', '{', '['])).then_some((name, spec))
        });
        let mut below: Vec<_> = below.collect();
        // mostly sorted already, which this sort is quick with
        below.sort_by_key(|(name, _)| *name);
        let mut names = String::with_capacity(below.iter().map(|(name, _)| name.len()).sum());
        let entries = below.iter().map(|(name, spec)| {
            names.push_str(name);
            Entry {
                end: names.len(),
                fields: spec.fieldset_index,
                kind: spec.spec_type,
            }
        });
        let entries = entries.collect();
        Some(Self {
            file,
            names,
            entries,
            next: 0,
            words: HashMap::new(),
            known: HashMap::new(),
        })
    }

    /// The child `name`.
    pub(super) fn child(&mut self, name: &str) -> Option<Child> {
        let is_next = self.next < self.entries.len() && self.name(self.next) == name;
        let at = match is_next {
            true => self.next,
            false => self.place(name)?,
        };
        let is_its = |at: &usize| {
            let below = self.name(*at).strip_prefix(name);
            below.is_some_and(|below| below.starts_with('.'))
        };
        let count = (at + 1..self.entries.len()).take_while(is_its).count();
        let properties = at + 1..at + 1 + count;
        self.next = properties.end;
        Some(Child {
            fields: self.entries[at].fields,
            properties,
        })
    }

    /// Name of the property at `place`.
    pub(super) fn property_name(&self, place: usize) -> &str {
        let name = self.name(place);
        name.split_once('.').map_or(name, |(_, property)| property)
    }

    /// The attribute at `place`, its default if it `has_value`; `None` where there is more to it, or it cannot be decoded.
    pub(super) fn attribute(&mut self, place: usize, has_value: bool) -> Option<PlainAttribute> {
        let entry = self.entries[place];
        if entry.kind != SpecType::Attribute {
            return None;
        }
        let (mut type_name, mut default) = (None, None);
        for at in entry.fields.. {
            let Some(place) = *self.file.fieldsets.get(at)? else {
                break;
            };
            let field = self.file.fields.get(place)?;
            let name = self.file.tokens.get(field.token_index)?.as_str();
            if name == FieldKey::TypeName.as_str() {
                let Value::Token(word) = self.value(place)? else {
                    return None;
                };
                type_name = Some(word);
            } else if name == FieldKey::Default.as_str() {
                default = has_value.then_some(place);
            } else if name != FieldKey::Variability.as_str() && name != FieldKey::Custom.as_str() {
                return None;
            }
        }
        let default = match default {
            Some(place) => Some(self.value(place)?),
            None => None,
        };
        Some(PlainAttribute {
            type_name,
            is_word: default.as_ref().is_some_and(is_word),
            default,
        })
    }

    /// The attribute at `place`, if one like it was remembered.
    pub(super) fn known(&self, place: usize) -> Option<Arc<RawAttribute>> {
        let all = self.known.get(&self.entries[place].fields)?;
        let name = self.property_name(place);
        all.iter().find(|it| it.name == name).cloned()
    }

    /// What the attribute at `place` was read as, and others with the same name and fields are.
    pub(super) fn remember(&mut self, place: usize, attribute: &Arc<RawAttribute>) {
        let all = self.known.entry(self.entries[place].fields).or_default();
        all.push(Arc::clone(attribute));
    }

    /// The value of the field at `place` of the file's fields.
    fn value(&mut self, place: usize) -> Option<Value> {
        let rep = self.file.fields[place].value_rep;
        if let Some(word) = self.words.get(&rep.0) {
            return Some(word.clone());
        }
        let value = self.file.value(rep).ok()?;
        if is_word(&value) {
            self.words.insert(rep.0, value.clone());
        }
        Some(value)
    }

    /// Path of the entry at `place` below the prim.
    fn name(&self, place: usize) -> &str {
        let start = place
            .checked_sub(1)
            .map_or(0, |before| self.entries[before].end);
        &self.names[start..self.entries[place].end]
    }

    fn place(&self, name: &str) -> Option<usize> {
        let (mut low, mut high) = (0, self.entries.len());
        while low < high {
            let middle = low.midpoint(high);
            match self.name(middle).cmp(name) {
                Ordering::Less => low = middle + 1,
                Ordering::Greater => high = middle,
                Ordering::Equal => return Some(middle),
            }
        }
        None
    }
}

fn is_word(value: &Value) -> bool {
    matches!(value, Value::Token(_) | Value::TokenVec(_))
}

#[cfg(test)]
mod tests {
    use super::*;
    use openusd::usdc::CrateWriter;
    use std::fs::File;

    const LAYER: &str = "#usda 1.0\ndef \"W\" {\n\
        def \"a\" {\nint n = 4\ncustom token w = \"x\"\nrel r\nint t.timeSamples = { 1: 2 }\n}\n\
        def \"a1\" {\nint n = 4\ncustom token w = \"x\"\nrel r\nint t.timeSamples = { 1: 2 }\n}\n\
        def \"a_b\" (kind = \"group\") {\ndef \"deep\" {\nint m = 1\n}\n}\n}\n\
        def \"Wa\" {\nint n = 5\n}\n";

    fn table() -> ChildTable {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.usdc");
        let data = openusd::usda::parse(LAYER).unwrap();
        CrateWriter::write(&data, &mut File::create(&path).unwrap()).unwrap();
        let parent = sdf::Path::new("/W").unwrap();
        ChildTable::of(&path.to_string_lossy(), &parent).unwrap()
    }

    #[test]
    fn children_are_found_in_any_order_with_their_own_properties() {
        let mut table = table();
        for name in ["a_b", "a", "a1", "a", "a1", "a_b"] {
            let child = table.child(name).unwrap();
            let names = child
                .properties
                .map(|place| table.property_name(place).to_owned());
            let names: Vec<String> = names.collect();
            match name {
                "a_b" => assert!(names.is_empty()),
                _ => assert_eq!(names, ["n", "r", "t", "w"]),
            }
        }
        for name in ["", "n", "b", "deep", "a_b/deep"] {
            assert!(table.child(name).is_none(), "{name}");
        }
    }

    #[test]
    fn different_children_have_different_numbers_and_plain_attributes_their_values() {
        let mut table = table();
        let [a, other, again] = ["a", "a_b", "a"].map(|name| table.child(name).unwrap());
        assert_eq!(a.fields, again.fields);
        assert_ne!(a.fields, other.fields);
        let places: Vec<usize> = a.properties.collect();
        let plain = table.attribute(places[0], true).unwrap();
        assert_eq!(plain.type_name, Some("int".into()));
        assert!(!plain.is_word);
        assert_eq!(plain.default, Some(Value::Int(4)));
        assert_eq!(table.attribute(places[0], false).unwrap().default, None);
        assert!(table.attribute(places[1], true).is_none(), "a relationship");
        assert!(table.attribute(places[2], true).is_none(), "samples");
        let word = table.attribute(places[3], true).unwrap();
        assert_eq!(word.default, Some(Value::Token("x".into())));
    }
}
