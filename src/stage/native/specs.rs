//! The specs of one property, strongest first, each asked only for the fields that it has.

use super::sites::{Fault, Opinions};
use openusd::sdf::{self, FieldKey, SpecType};
use std::borrow::Cow;

/// What one site says of a property.
pub(super) struct Spec<'a> {
    pub(super) opinions: &'a Opinions<'a>,
    /// Its path in the layer.
    pub(super) at: sdf::Path,
    /// Names of its fields. A layer takes as long to find the spec as it takes to list them.
    fields: Vec<String>,
}

/// A property's specs, strongest first.
pub(super) struct Specs<'a>(Vec<Spec<'a>>);

impl Spec<'_> {
    pub(super) fn has(&self, field: FieldKey) -> bool {
        self.fields.iter().any(|own| own == field.as_str())
    }

    pub(super) fn has_spline(&self) -> bool {
        self.fields.iter().any(|own| own == "spline")
    }

    /// The value of `field`.
    ///
    /// # Errors
    /// When it cannot be decoded.
    pub(super) fn field(&self, field: &str) -> Result<Option<Cow<'_, sdf::Value>>, Fault> {
        match self.fields.iter().any(|own| own == field) {
            true => self.opinions.field(&self.at, field),
            false => Ok(None),
        }
    }
}

impl<'a> Specs<'a> {
    /// Of the property `name` of the prim that has `opinions`.
    ///
    /// # Errors
    /// When no property can have the name.
    pub(super) fn of(opinions: &'a [Opinions<'a>], name: &str) -> Result<Self, Fault> {
        let mut specs = Vec::new();
        for opinions in opinions {
            let at = opinions.site.path.append_property(name);
            let at = at.map_err(|error| Fault::new(&opinions.site.layer, format!("{error:#}")))?;
            if let Some(fields) = opinions.data().list_fields(&at) {
                specs.push(Spec {
                    opinions,
                    at,
                    fields,
                });
            }
        }
        Ok(Self(specs))
    }

    /// Strongest first.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Spec<'a>> {
        self.0.iter()
    }

    /// What the strongest says that it is.
    pub(super) fn kind(&self) -> Option<SpecType> {
        let strongest = self.0.first()?;
        strongest.opinions.data().spec_type(&strongest.at)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The strongest opinion of `field`.
    ///
    /// # Errors
    /// When it cannot be decoded.
    pub(super) fn strongest(&self, field: &str) -> Result<Option<sdf::Value>, Fault> {
        for spec in &self.0 {
            if let Some(value) = spec.field(field)? {
                return Ok(Some(value.into_owned()));
            }
        }
        Ok(None)
    }

    /// The strongest opinion of `field`, if it is a token or string.
    ///
    /// # Errors
    /// When it cannot be decoded.
    pub(super) fn token(&self, field: &str) -> Result<Option<String>, Fault> {
        Ok(self.strongest(field)?.and_then(text))
    }
}

/// The text of a token or string.
pub(super) fn text(value: sdf::Value) -> Option<String> {
    match value {
        sdf::Value::Token(token) => Some(token.as_str().to_owned()),
        sdf::Value::String(string) => Some(string),
        _ => None,
    }
}
