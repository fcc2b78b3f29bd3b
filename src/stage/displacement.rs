//! Whether anything of a stage may be displaced, told without its materials.

use super::raw::{RawAttribute, RawPrim, RawStage, Value};

/// What tells it: displacement as UsdPreviewSurface calls it.
pub(super) const ATTRIBUTE: &str = "inputs:displacement";

/// True if some prim of `raw`, which was read for [`super::ReadSettings::solidity`] or materials, has a displacement that is not 0
/// or comes from elsewhere: a texture, a primvar.
pub fn may_displace(raw: &RawStage) -> bool {
    let is_flat = |attribute: &RawAttribute| {
        attribute.connections.is_empty()
            && match &attribute.value {
                Some(Value::Float(number)) => *number == 0.0,
                Some(Value::Int(number)) => *number == 0,
                _ => true,
            }
    };
    let of = |prim: &RawPrim| {
        prim.attributes
            .get(ATTRIBUTE)
            .is_some_and(|found| !is_flat(found))
    };
    raw.prims.iter().any(of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::attributes::Attributes;

    fn displaced(attribute: RawAttribute) -> bool {
        let mut attributes = Attributes::default();
        attributes.insert(ATTRIBUTE.to_owned(), attribute);
        let prims = vec![RawPrim::default().with(attributes)];
        may_displace(&RawStage {
            prims,
            ..RawStage::default()
        })
    }

    #[test]
    fn what_is_not_zero_or_comes_from_elsewhere_may_displace() {
        let valued = |value| displaced(RawAttribute::from(value));
        assert!(!valued(Value::Float(0.0)) && valued(Value::Float(-0.1)));
        assert!(valued(Value::Float(f64::NAN)));
        let mut connected = RawAttribute::default();
        connected.connections = vec!["/M/T.outputs:r".to_owned()];
        assert!(displaced(connected));
        assert!(!may_displace(&RawStage::default()));
    }
}
