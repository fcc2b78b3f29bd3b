//! Follows shader connections to what produces a value: through interface inputs and outputs of node graphs and
//! materials, as `UsdShadeUtils::GetValueProducingAttributes` does.

use super::super::super::raw::{RawPrim, Value};
use super::paths::{Paths, split_property};
use super::values::Values;

/// Longer chains than this are cycles.
const MAX_HOPS: usize = 64;

/// What feeds an input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Source<'a> {
    /// An authored value, and the `colorSpace` metadata of its attribute.
    Value(&'a Value, Option<&'a str>),
    /// Output `output` (without `outputs:`) of the shader node `prim`.
    Node {
        /// Index of the Shader prim.
        prim: usize,
        /// Name of the output.
        output: &'a str,
    },
    /// Nothing: the schema's default holds.
    Nothing,
}

/// What feeds attribute `attribute` (`inputs:…` or `outputs:…`) of `prim`. A connection to a prim that does not exist
/// does not count.
pub(super) fn source<'a>(paths: &Paths<'a>, prim: usize, attribute: &str) -> Source<'a> {
    let (mut prim, mut attribute) = (prim, attribute);
    for _ in 0..MAX_HOPS {
        let Some(found) = paths.prim(prim).attributes.get(attribute) else {
            return Source::Nothing;
        };
        let connected = found.connections.iter().find_map(|target| {
            let (path, property) = split_property(target);
            let is_port = property.starts_with("inputs:") || property.starts_with("outputs:");
            is_port
                .then(|| paths.find(path))
                .flatten()
                .map(|prim| (prim, property))
        });
        match (connected, &found.value) {
            (Some((node, property)), _) => {
                let output = property.strip_prefix("outputs:");
                if let Some(output) = output.filter(|_| paths.prim(node).type_name == "Shader") {
                    return Source::Node { prim: node, output };
                }
                (prim, attribute) = (node, property);
            }
            (None, Some(value)) => return Source::Value(value, found.color_space.as_deref()),
            (None, None) => return Source::Nothing,
        }
    }
    Source::Nothing
}

/// The value that feeds an input, if it is a plain value.
pub(super) fn value<'a>(paths: &Paths<'a>, prim: usize, input: &str) -> Option<&'a Value> {
    match source(paths, prim, &format!("inputs:{input}")) {
        Source::Value(value, _) => Some(value),
        _ => None,
    }
}

/// What a shader node is: its `info:id`, or the name inside the source asset of an MDL or OSL shader; empty if neither
/// is authored.
pub(super) fn shader_id(prim: &RawPrim) -> &str {
    let sub_identifier = || {
        let mut names = prim.attributes.keys();
        let name = names.find(|name| name.ends_with(":sourceAsset:subIdentifier"))?;
        prim.token(name)
    };
    prim.token("info:id").or_else(sub_identifier).unwrap_or("")
}
