//! A SurfluxBakeSettings prim → opinions about flags: `surflux:maxSolidAngle` of the stage is `--max-solid-angle` of the
//! command line. `schemas/surflux` declares them; nothing here needs the schema to be registered.

use super::raw::{RawPrim, RawStage, Request, Value};
use super::{Composition, Error, Source};
use crate::diagnostics::Diagnostics;

/// The type of the prims.
pub const TYPE_NAME: &str = "SurfluxBakeSettings";

/// Where UsdRender keeps its prims, and where settings are found that no metadata name.
const SCOPE: &str = "/Render";

/// What every attribute's name begins with.
const PREFIX: &str = "surflux:";

/// What settings can say, by the names of flags. Files, threads and messages are the business of who runs the job.
pub const FLAGS: [&str; 27] = [
    "aov",
    "bounces",
    "cloud",
    "cone-angle",
    "directions",
    "display-color",
    "exr",
    "falloff",
    "gather",
    "hide-lights",
    "instances",
    "interpolate",
    "interpolation",
    "light-groups",
    "map-cell",
    "map-pixel",
    "max-distance",
    "max-solid-angle",
    "pixel-samples",
    "positions",
    "preview",
    "raster-resolution",
    "rays",
    "spacing",
    "surfels",
    "tolerance",
    "view",
];

/// The attributes that [`read`] understands besides those of RenderSettings.
pub fn attributes() -> impl Iterator<Item = String> {
    FLAGS
        .into_iter()
        .map(|flag| PREFIX.to_owned() + &camel(flag))
}

/// What one attribute says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// Name of the flag, without dashes in front.
    pub flag: String,
    /// The values as they would be typed; one, or those of a list.
    pub values: Vec<String>,
    /// The attribute: `/Render/final.surflux:rays`.
    pub attribute: String,
}

/// What a SurfluxBakeSettings prim says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BakeSettingsPrim {
    /// Its path.
    pub path: String,
    /// What is authored, in order of attribute names.
    pub settings: Vec<Setting>,
}

/// Read the settings at `wanted`, or those that the stage's `renderSettingsPrimPath` names, or the first below `/Render`;
/// `None` where there are none. Of the stage only render settings and what they point at are composed.
///
/// # Errors
/// Whatever [`Source::load`] reports; a prim `wanted` that is no SurfluxBakeSettings; values of types that no flag has.
pub fn read(
    source: &mut dyn Source,
    composition: &Composition,
    wanted: Option<&str>,
    diagnostics: &Diagnostics,
) -> Result<Option<BakeSettingsPrim>, Error> {
    // the job reads the same layers again, and what is wrong with them is told there
    let quiet = Diagnostics::new(
        Box::new(crate::diagnostics::Silent),
        diagnostics.cancel_token().clone(),
    );
    let mut load = |mask: &str| {
        let request = Request {
            time: None,
            mask: vec![mask.to_owned()],
            composition: composition.clone(),
            attributes: vec![format!("{PREFIX}*"), "includedPurposes".to_owned()],
            values_not_needed: Vec::new(),
        };
        source.load(&request, &quiet)
    };
    let raw = load(wanted.unwrap_or(SCOPE))?;
    if let Some(path) = wanted {
        let prim = named(&raw, path).ok_or_else(|| Error::Layer {
            path: raw.meta.path.clone(),
            message: format!("--settings {path}: there is no {TYPE_NAME} prim (right: its path)"),
        })?;
        return settings_of(prim, &raw).map(Some);
    }
    let chosen = raw.meta.render_settings_prim_path.clone();
    if let Some(path) = chosen.filter(|path| path.starts_with('/') && named(&raw, path).is_none()) {
        let elsewhere = load(&path)?;
        if let Some(prim) = named(&elsewhere, &path) {
            return settings_of(prim, &elsewhere).map(Some);
        }
    }
    let chosen = raw.meta.render_settings_prim_path.as_deref();
    let prim = chosen.and_then(|path| named(&raw, path));
    let below = format!("{SCOPE}/");
    let first = || {
        let mut prims = raw.prims.iter();
        prims.find(|prim| prim.type_name == TYPE_NAME && prim.path.starts_with(&below))
    };
    prim.or_else(first)
        .map(|prim| settings_of(prim, &raw))
        .transpose()
}

fn named<'a>(raw: &'a RawStage, path: &str) -> Option<&'a RawPrim> {
    let mut prims = raw.prims.iter();
    prims.find(|prim| prim.path == path && prim.type_name == TYPE_NAME)
}

fn settings_of(prim: &RawPrim, raw: &RawStage) -> Result<BakeSettingsPrim, Error> {
    let mut settings = Vec::new();
    for (name, attribute) in &prim.attributes {
        let Some(value) = &attribute.value else {
            continue;
        };
        let place = format!("{}.{name}", prim.path);
        let wrong = |message: String| Error::Layer {
            path: raw.meta.path.clone(),
            message: format!("{place}: {message}"),
        };
        let flag = match name.strip_prefix(PREFIX) {
            Some(rest) => kebab(rest),
            None => "purposes".to_owned(),
        };
        if name.starts_with(PREFIX) && !FLAGS.contains(&&*flag) {
            return Err(wrong(format!(
                "{TYPE_NAME} has no such attribute (it has {})",
                attributes().collect::<Vec<_>>().join(" ")
            )));
        }
        let texts = texts(value).ok_or_else(|| {
            wrong(format!(
                "a value of type {} says nothing about --{flag}",
                attribute.type_name
            ))
        })?;
        settings.push(Setting {
            values: match flag.as_str() {
                // the schema has a number, -1 for auto
                "bounces" if texts == ["-1"] => vec!["auto".to_owned()],
                _ => texts,
            },
            flag,
            attribute: place,
        });
    }
    Ok(BakeSettingsPrim {
        path: prim.path.clone(),
        settings,
    })
}

/// `maxSolidAngle` → `max-solid-angle`.
fn kebab(name: &str) -> String {
    let mut kebab = String::new();
    for letter in name.chars() {
        if letter.is_ascii_uppercase() {
            kebab.push('-');
        }
        kebab.push(letter.to_ascii_lowercase());
    }
    kebab
}

/// `max-solid-angle` → `maxSolidAngle`.
fn camel(flag: &str) -> String {
    let mut words = flag.split('-');
    let mut name = words.next().unwrap_or_default().to_owned();
    for word in words {
        let (first, rest) = word.split_at(1);
        name += &first.to_ascii_uppercase();
        name += rest;
    }
    name
}

/// `value` as it would be typed.
fn texts(value: &Value) -> Option<Vec<String>> {
    Some(match value {
        Value::Bool(is_on) => vec![is_on.to_string()],
        Value::Int(number) => vec![number.to_string()],
        Value::Float(number) => vec![typed(*number)],
        Value::Token(text) => vec![text.clone()],
        Value::Asset { authored, resolved } => vec![match resolved.is_empty() {
            true => authored.clone(),
            false => resolved.clone(),
        }],
        Value::TokenArray(texts) => texts.clone(),
        _ => return None,
    })
}

/// The shortest text that is the same single number, 0.02 for what a float makes of it.
fn typed(number: f64) -> String {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "attributes are single precision, flags too"
    )]
    let single = number as f32;
    single.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_attributes_are_those_of_flags() {
        assert_eq!(kebab("maxSolidAngle"), "max-solid-angle");
        for flag in FLAGS {
            assert_eq!(kebab(&camel(flag)), flag);
        }
    }

    #[test]
    fn single_numbers_are_spelled_as_they_were_typed() {
        assert_eq!(typed(f64::from(0.02_f32)), "0.02");
        assert_eq!(typed(0.02), "0.02");
        assert_eq!(typed(3.0), "3");
    }
}
