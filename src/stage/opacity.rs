//! Whether anything of a stage may let light through, told without its materials.

use super::raw::{RawAttribute, RawPrim, RawStage, Value};

/// What tells it: opacity as the surface shaders that are read call it, and that of prims without material.
pub(super) const ATTRIBUTES: [&str; 5] = [
    "inputs:opacity",
    "inputs:geometry_opacity",
    "inputs:alpha",
    "inputs:opacity_constant",
    "primvars:displayOpacity",
];

/// True if some prim of `raw`, which was read for [`super::ReadSettings::solidity`] or materials, has an opacity that is below 1
/// or comes from elsewhere: a texture, a primvar.
pub fn may_pass(raw: &RawStage) -> bool {
    let passes = |prim: &RawPrim| {
        let mut found = ATTRIBUTES
            .iter()
            .filter_map(|name| prim.attributes.get(name));
        found.any(|attribute| !attribute.connections.is_empty() || is_below_one(attribute))
    };
    raw.prims.iter().any(passes)
}

/// Numbers that are none count as below.
fn is_below_one(attribute: &RawAttribute) -> bool {
    let is_full = match &attribute.value {
        Some(Value::Float(number)) => *number >= 1.0,
        Some(Value::Int(number)) => *number >= 1,
        Some(Value::Vec3(numbers)) => numbers.min_element() >= 1.0,
        Some(Value::FloatArray(numbers)) => numbers.iter().all(|number| *number >= 1.0),
        _ => true,
    };
    !is_full
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::attributes::Attributes;

    fn stage(name: &str, attribute: RawAttribute) -> RawStage {
        let mut attributes = Attributes::default();
        attributes.insert(name.to_owned(), attribute);
        let prims = vec![RawPrim::default().with(attributes)];
        RawStage {
            prims,
            ..RawStage::default()
        }
    }

    fn valued(value: Value) -> RawAttribute {
        RawAttribute::from(value)
    }

    #[test]
    fn what_is_below_one_or_comes_from_elsewhere_may_pass() {
        let opacity = |value| may_pass(&stage("inputs:opacity", valued(value)));
        assert!(!opacity(Value::Float(1.0)) && opacity(Value::Float(0.9)));
        assert!(opacity(Value::Float(f64::NAN)));
        let display = |values| {
            let value = valued(Value::FloatArray(values));
            may_pass(&stage("primvars:displayOpacity", value))
        };
        assert!(!display(vec![1.0, 1.0]) && display(vec![1.0, 0.0]));
        let mut connected = RawAttribute::default();
        connected.connections = vec!["/M/T.outputs:a".to_owned()];
        assert!(may_pass(&stage("inputs:opacity", connected)));
        assert!(!may_pass(&stage(
            "inputs:roughness",
            valued(Value::Float(0.0))
        )));
    }
}
