//! How a stage is composed before it is read: payloads, variant choices, a session layer, muted layers. What usdview
//! offers by hand, for jobs.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// Which payloads are brought in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Load {
    /// All.
    #[default]
    All,
    /// None: prims with a payload, and what is below them, are not on the stage.
    None,
}

/// What composes a stage besides its root layer.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Composition {
    /// Payloads.
    pub load: Load,
    /// Opinions of the session layer, stronger than those of [`Self::session_layer`]; of two for the same set of the
    /// same prim the last one holds.
    pub variants: Vec<VariantChoice>,
    /// A layer stronger than the root layer; never written to.
    pub session_layer: Option<PathBuf>,
    /// Identifiers of layers to leave out, as a layer's `subLayers` spell them (relative to the root layer) or absolute.
    pub muted_layers: Vec<String>,
}

/// One variant of one variant set of one prim, written `/prim{set=choice}` as in Sdf paths.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VariantChoice {
    /// Absolute prim path.
    pub prim: String,
    /// Name of the variant set.
    pub set: String,
    /// Name of the variant.
    pub choice: String,
}

impl fmt::Display for VariantChoice {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(to, "{}{{{}={}}}", self.prim, self.set, self.choice)
    }
}

impl VariantChoice {
    /// Prim path, set, variant.
    pub(super) fn parts(&self) -> [String; 3] {
        [&self.prim, &self.set, &self.choice].map(String::clone)
    }
}

impl FromStr for VariantChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let shape = || format!("{text:?} is no variant choice like /World/Hero{{look=red}}");
        let (prim, rest) = text.split_once('{').ok_or_else(shape)?;
        let inner = rest.strip_suffix('}').ok_or_else(shape)?;
        let (set, choice) = inner.split_once('=').ok_or_else(shape)?;
        let (prim, set, choice) = (prim.trim(), set.trim(), choice.trim());
        let is_name = |name: &str| {
            let is_part = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '|' | '.');
            name.chars().all(is_part)
        };
        let is_prim = prim.len() > 1
            && prim.starts_with('/')
            && prim[1..].split('/').all(|part| {
                !part.is_empty() && part.chars().all(|c| c.is_alphanumeric() || c == '_')
            });
        if !is_prim
            || [set, choice]
                .iter()
                .any(|name| name.is_empty() || !is_name(name))
        {
            return Err(shape());
        }
        Ok(Self {
            prim: prim.to_owned(),
            set: set.to_owned(),
            choice: choice.to_owned(),
        })
    }
}

/// What became of a [`VariantChoice`] on the composed stage.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum ChoiceOutcome {
    /// The prim's set has the variant.
    Applied,
    /// The prim is below a native instance, where no opinion of the session layer reaches.
    BelowInstance,
    /// The stage has no such prim: not there at all, or behind the mask or an unloaded payload.
    NoPrim,
    /// The prim has no such set; the names of those it has.
    NoSet(Vec<String>),
    /// The set has no such variant; the names of those it has.
    NoVariant(Vec<String>),
}

impl ChoiceOutcome {
    /// What is wrong with `choice`; `None` if nothing is.
    fn complaint(&self, choice: &VariantChoice) -> Option<String> {
        let list = |names: &[String]| match names.is_empty() {
            true => "none".to_owned(),
            false => names.join(", "),
        };
        match self {
            Self::Applied => None,
            Self::NoPrim => Some(format!(
                "the variant choice {choice} has no effect: there is no such prim (or it is outside the mask, or below an \
                 unloaded payload)"
            )),
            Self::BelowInstance => Some(format!(
                "variant choice {choice}: the prim is below a native instance, where it cannot be made; choose a variant \
                 of the instance"
            )),
            Self::NoSet(sets) => Some(format!(
                "variant choice {choice}: the prim has no variant set {:?}; it has: {}",
                choice.set,
                list(sets)
            )),
            Self::NoVariant(variants) => Some(format!(
                "variant choice {choice}: the set has no variant {:?}; it has: {}",
                choice.choice,
                list(variants)
            )),
        }
    }

    /// True if the stage cannot be meant; else it is enough to warn.
    fn is_fatal(&self) -> bool {
        !matches!(self, Self::Applied | Self::NoPrim)
    }
}

/// Warnings (prim and message) of what became of choices.
///
/// # Errors
/// The complaint about a choice that the stage cannot make.
pub(super) fn judge<'a>(
    outcomes: impl Iterator<Item = (&'a VariantChoice, ChoiceOutcome)>,
) -> Result<Vec<(String, String)>, String> {
    let mut warnings = Vec::new();
    for (choice, outcome) in outcomes {
        match outcome.complaint(choice) {
            Some(complaint) if outcome.is_fatal() => return Err(complaint),
            Some(complaint) => warnings.push((choice.prim.clone(), complaint)),
            None => {}
        }
    }
    Ok(warnings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variant_choices_are_spelled_as_in_sdf_paths() {
        let choice: VariantChoice = "/World/Hero{look=red-2}".parse().unwrap();
        assert_eq!(
            (&*choice.prim, &*choice.set, &*choice.choice),
            ("/World/Hero", "look", "red-2")
        );
        assert_eq!(choice.to_string(), "/World/Hero{look=red-2}");
        for wrong in [
            "",
            "/A",
            "A{x=y}",
            "/{x=y}",
            "/A{x}",
            "/A{=y}",
            "/A{x=}",
            "/A{x=y",
            "/A/{x=y}",
            "/A.b{x=y}",
            "/A{x=y}B",
            "/A{x=\"y\"}",
        ] {
            assert!(wrong.parse::<VariantChoice>().is_err(), "{wrong}");
        }
    }
}
