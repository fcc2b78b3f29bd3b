//! The attributes of one prim, by name.

use super::raw::RawAttribute;
use std::ops::Index;
use std::{slice, vec};

/// Attributes sorted by name, without two of one name. Most prims have a handful, and there may be millions of prims: a
/// sorted list takes what the attributes take, where the node of a tree has room for eleven.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Attributes(Vec<(String, RawAttribute)>);

/// Names and attributes, in order of names.
pub type Iter<'a> = std::iter::Map<slice::Iter<'a, (String, RawAttribute)>, Borrow<'a>>;

/// Names and attributes to be changed, in order of names.
pub type IterMut<'a> = std::iter::Map<slice::IterMut<'a, (String, RawAttribute)>, BorrowMut<'a>>;

type Borrow<'a> = fn(&'a (String, RawAttribute)) -> (&'a String, &'a RawAttribute);

type BorrowMut<'a> = fn(&'a mut (String, RawAttribute)) -> (&'a String, &'a mut RawAttribute);

impl Attributes {
    /// The attribute `name`.
    pub fn get(&self, name: &str) -> Option<&RawAttribute> {
        let place = self.place(name).ok()?;
        Some(&self.0[place].1)
    }

    /// The attribute `name`, to be changed.
    pub fn get_mut(&mut self, name: &str) -> Option<&mut RawAttribute> {
        let place = self.place(name).ok()?;
        Some(&mut self.0[place].1)
    }

    /// True if there is an attribute `name`.
    pub fn contains_key(&self, name: &str) -> bool {
        self.place(name).is_ok()
    }

    /// Put `attribute` in the place of the attribute `name`, if there is one, or beside the others. Quick in the order of
    /// names.
    pub fn insert(&mut self, name: String, attribute: RawAttribute) {
        let is_last = self.0.last().is_none_or(|(last, _)| *last < name);
        if is_last {
            self.0.push((name, attribute));
            return;
        }
        match self.place(&name) {
            Ok(place) => self.0[place].1 = attribute,
            Err(place) => self.0.insert(place, (name, attribute)),
        }
    }

    /// Take the attribute `name` away.
    pub fn remove(&mut self, name: &str) -> Option<RawAttribute> {
        let place = self.place(name).ok()?;
        Some(self.0.remove(place).1)
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

    /// Names and attributes to be changed, in order of names.
    pub fn iter_mut(&mut self) -> IterMut<'_> {
        self.into_iter()
    }

    /// Names, sorted.
    pub fn keys(&self) -> impl Iterator<Item = &String> {
        self.0.iter().map(|(name, _)| name)
    }

    /// Attributes in order of names.
    pub fn values(&self) -> impl Iterator<Item = &RawAttribute> {
        self.0.iter().map(|(_, attribute)| attribute)
    }

    /// Attributes to be changed, in order of names.
    pub fn values_mut(&mut self) -> impl Iterator<Item = &mut RawAttribute> {
        self.0.iter_mut().map(|(_, attribute)| attribute)
    }

    /// Where `name` is, or where it belongs.
    fn place(&self, name: &str) -> Result<usize, usize> {
        self.0
            .binary_search_by(|(other, _)| other.as_str().cmp(name))
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

impl IntoIterator for Attributes {
    type Item = (String, RawAttribute);
    type IntoIter = vec::IntoIter<Self::Item>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter()
    }
}

impl<'a> IntoIterator for &'a Attributes {
    type Item = (&'a String, &'a RawAttribute);
    type IntoIter = Iter<'a>;

    fn into_iter(self) -> Iter<'a> {
        self.0.iter().map(|(name, attribute)| (name, attribute))
    }
}

impl<'a> IntoIterator for &'a mut Attributes {
    type Item = (&'a String, &'a mut RawAttribute);
    type IntoIter = IterMut<'a>;

    fn into_iter(self) -> IterMut<'a> {
        self.0
            .iter_mut()
            .map(|(name, attribute)| (&*name, attribute))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(type_name: &str) -> RawAttribute {
        RawAttribute {
            type_name: type_name.to_owned(),
            ..RawAttribute::default()
        }
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
        assert_eq!(attributes.remove("a"), Some(named("3")));
        assert_eq!(attributes.remove("d"), None);
        assert!(attributes.contains_key("c") && !attributes.contains_key("a"));
        assert_eq!(types(&attributes), "B4 b0 c2");
    }
}
