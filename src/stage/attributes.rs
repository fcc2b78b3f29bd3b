//! Attributes, and those of one prim by name.

use super::raw::{Sample, Value};
use std::ops::{Deref, DerefMut, Index};
use std::slice;
use std::sync::Arc;

/// An authored attribute: its value, and what it may share with the same attribute of other prims (a [`Declaration`],
/// which it stands for: `attribute.type_name`).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RawAttribute {
    /// Resolved value at the requested time; `None` if there is none (only connections, a block, or an empty type).
    pub value: Option<Value>,
    declaration: Arc<Declaration>,
}

/// All of an attribute but its value.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Declaration {
    /// Name among the attributes of a prim; empty until it is one of them.
    pub name: String,
    /// USD type name, e.g. `color3f[]`.
    pub type_name: String,
    /// `interpolation` metadata.
    pub interpolation: Option<String>,
    /// `elementSize` metadata.
    pub element_size: Option<i32>,
    /// `weight` metadata, of shapes in between.
    pub weight: Option<f32>,
    /// `colorSpace` metadata.
    pub color_space: Option<String>,
    /// Connection targets.
    pub connections: Vec<String>,
    /// More than one time sample (or clips); or time samples and no value at the requested time.
    pub varying: bool,
    /// Of what [`MOVED`](super::raw::MOVED) lists, on a PointInstancer that moves so: the last sample up to the requested time, or the
    /// first of all.
    pub held: Option<Box<Sample>>,
}

impl Declaration {
    /// Of an attribute `name` of the type `type_name`, without anything else.
    pub fn plain(name: &str, type_name: &str) -> Self {
        Self {
            name: name.to_owned(),
            type_name: type_name.to_owned(),
            ..Self::default()
        }
    }

    /// True if there is nothing but a name and a type.
    pub(super) fn is_plain(&self) -> bool {
        let has_metadata = self.interpolation.is_some()
            || self.element_size.is_some()
            || self.weight.is_some()
            || self.color_space.is_some();
        let has_more = self.varying || self.held.is_some() || !self.connections.is_empty();
        !has_metadata && !has_more
    }
}

impl RawAttribute {
    /// An attribute with `value`.
    pub fn new(declaration: impl Into<Arc<Declaration>>, value: Option<Value>) -> Self {
        Self {
            value,
            declaration: declaration.into(),
        }
    }

    /// All but the value.
    pub fn declaration(&self) -> &Arc<Declaration> {
        &self.declaration
    }
}

impl From<Value> for RawAttribute {
    /// An attribute of no declared type.
    fn from(value: Value) -> Self {
        Self::new(Declaration::default(), Some(value))
    }
}

impl Deref for RawAttribute {
    type Target = Declaration;

    fn deref(&self) -> &Declaration {
        &self.declaration
    }
}

impl DerefMut for RawAttribute {
    fn deref_mut(&mut self) -> &mut Declaration {
        Arc::make_mut(&mut self.declaration)
    }
}

/// Attributes sorted by name, without two of one name. Most prims have a handful, and there may be millions of prims: a
/// sorted list takes what the attributes take, where the node of a tree has room for eleven; and what many prims have alike
/// is kept once. An attribute that is changed is first made the prim's own.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Attributes(Vec<Arc<RawAttribute>>);

/// Names and attributes, in order of names.
pub type Iter<'a> = std::iter::Map<slice::Iter<'a, Arc<RawAttribute>>, Borrow<'a>>;

type Borrow<'a> = fn(&'a Arc<RawAttribute>) -> (&'a String, &'a RawAttribute);

impl Attributes {
    /// The attribute `name`.
    pub fn get(&self, name: &str) -> Option<&RawAttribute> {
        let place = self.place(name).ok()?;
        Some(&self.0[place])
    }

    /// The attribute `name`, to be changed.
    pub fn get_mut(&mut self, name: &str) -> Option<&mut RawAttribute> {
        let place = self.place(name).ok()?;
        Some(Arc::make_mut(&mut self.0[place]))
    }

    /// True if there is an attribute `name`.
    pub fn contains_key(&self, name: &str) -> bool {
        self.place(name).is_ok()
    }

    /// Put `attribute` in the place of the attribute `name`, if there is one, or beside the others. Quick in the order of
    /// names.
    pub fn insert(&mut self, name: String, mut attribute: RawAttribute) {
        if attribute.name != name {
            attribute.name = name;
        }
        self.insert_shared(Arc::new(attribute));
    }

    /// [`Self::insert`] by the attribute's own name, which other prims may have too.
    pub(super) fn insert_shared(&mut self, attribute: Arc<RawAttribute>) {
        let last = self.0.last();
        if last.is_none_or(|last| last.name < attribute.name) {
            self.0.push(attribute);
            return;
        }
        match self.place(&attribute.name) {
            Ok(place) => self.0[place] = attribute,
            Err(place) => self.0.insert(place, attribute),
        }
    }

    /// Take the attribute `name` away.
    pub fn remove(&mut self, name: &str) -> Option<RawAttribute> {
        let place = self.place(name).ok()?;
        Some(Arc::unwrap_or_clone(self.0.remove(place)))
    }

    /// Leave only those that `stays` says yes to.
    pub(super) fn retain(&mut self, stays: impl Fn(&RawAttribute) -> bool) {
        self.0.retain(|attribute| stays(attribute));
    }

    /// Room for `count` attributes.
    pub(super) fn reserve_exact(&mut self, count: usize) {
        self.0.reserve_exact(count);
    }

    /// Room for as many attributes as there are, no more.
    pub fn shrink_to_fit(&mut self) {
        self.0.shrink_to_fit();
    }

    /// Number of attributes.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// True without attributes.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Names and attributes, in order of names.
    pub fn iter(&self) -> Iter<'_> {
        self.into_iter()
    }

    /// Names, sorted.
    pub fn keys(&self) -> impl Iterator<Item = &String> {
        self.0.iter().map(|attribute| &attribute.name)
    }

    /// Attributes in order of names.
    pub fn values(&self) -> impl Iterator<Item = &RawAttribute> {
        self.0.iter().map(|attribute| &**attribute)
    }

    /// Attributes in order of names, each with what other prims may have too.
    pub(super) fn shared(&self) -> impl Iterator<Item = &Arc<RawAttribute>> {
        self.0.iter()
    }

    /// Where `name` is, or where it belongs.
    fn place(&self, name: &str) -> Result<usize, usize> {
        self.0
            .binary_search_by(|other| other.name.as_str().cmp(name))
    }
}

impl Index<&str> for Attributes {
    type Output = RawAttribute;

    /// # Panics
    /// Where there is no attribute `name`.
    fn index(&self, name: &str) -> &RawAttribute {
        self.get(name).expect("the prim has the attribute")
    }
}

impl FromIterator<(String, RawAttribute)> for Attributes {
    fn from_iter<I: IntoIterator<Item = (String, RawAttribute)>>(all: I) -> Self {
        let mut attributes = Self::default();
        for (name, attribute) in all {
            attributes.insert(name, attribute);
        }
        attributes.shrink_to_fit();
        attributes
    }
}

impl<'a> IntoIterator for &'a Attributes {
    type Item = (&'a String, &'a RawAttribute);
    type IntoIter = Iter<'a>;

    fn into_iter(self) -> Iter<'a> {
        self.0
            .iter()
            .map(|attribute| (&attribute.name, &**attribute))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(type_name: &str) -> RawAttribute {
        RawAttribute::new(Declaration::plain("", type_name), None)
    }

    #[test]
    fn attributes_are_in_order_of_names_and_the_last_of_a_name_stays() {
        let order = ["b", "a", "c", "a", "B"];
        let all = (0..).zip(order);
        let mut attributes: Attributes = all
            .map(|(number, name): (u32, _)| (name.to_owned(), named(&number.to_string())))
            .collect();
        let types = |attributes: &Attributes| {
            let types = attributes
                .iter()
                .map(|(name, of)| format!("{name}{}", of.type_name));
            types.collect::<Vec<_>>().join(" ")
        };
        assert_eq!(types(&attributes), "B4 a3 b0 c2");
        assert_eq!(attributes.remove("a").unwrap().type_name, "3");
        assert_eq!(attributes.remove("d"), None);
        assert!(attributes.contains_key("c") && !attributes.contains_key("a"));
        let before = attributes.clone();
        attributes.get_mut("b").unwrap().type_name = "5".to_owned();
        assert_eq!(before["b"].type_name, "0", "shared until it is changed");
        assert_eq!(types(&attributes), "B4 b5 c2");
        let attributes = before;
        assert_eq!(types(&attributes), "B4 b0 c2");
    }
}
