//! Draw modes that stand in for geometry (`UsdGeomModelAPI`): not followed, but named.
//!
//! The rules are those of `UsdImaging`: `model:drawMode` is inherited from the nearest prim that authors another mode
//! than `inherited`; it applies at component models, and at prims where `model:applyDrawMode` is true.

use super::super::super::raw::{RawPrim, RawStage};
use super::super::flatten::Occurrence;
use super::attributes::{boolean, token};
use crate::diagnostics::Diagnostics;

/// Warn once for every prim whose geometry a viewport would replace by cards, a box or its axes.
pub(super) fn warn(raw: &RawStage, occurrences: &[Occurrence], diagnostics: &Diagnostics) {
    let mut modes: Vec<&str> = Vec::with_capacity(occurrences.len());
    // Below a prim that is replaced nothing is drawn that could be replaced again.
    let mut is_replaced: Vec<bool> = Vec::with_capacity(occurrences.len());
    for occurrence in occurrences {
        let prim = &raw.prims[occurrence.prim];
        let above = occurrence.parent.map_or("default", |parent| modes[parent]);
        let mode = match token(prim, "model:drawMode", "inherited") {
            "inherited" => above,
            own => own,
        };
        let inside = occurrence.parent.is_some_and(|parent| is_replaced[parent]);
        let applies = mode != "default" && is_model_drawn_so(prim);
        if applies && !inside && occurrence.visible {
            diagnostics.warn(
                "draw-mode",
                occurrence.path.clone(),
                format!("draw mode {mode:?} is not followed: the full geometry is used"),
            );
        }
        modes.push(mode);
        is_replaced.push(inside || applies);
    }
}

fn is_model_drawn_so(prim: &RawPrim) -> bool {
    prim.kind.as_deref() == Some("component") || boolean(prim, "model:applyDrawMode", false)
}

#[cfg(test)]
mod tests {
    use super::super::super::super::ReadSettings;
    use super::super::super::super::raw::Value;
    use super::super::super::flatten::flatten;
    use super::super::tests::{prim, with_attribute, with_token};
    use super::*;

    fn warned(prims: Vec<RawPrim>) -> Vec<String> {
        let raw = RawStage {
            prototype_start: prims.len(),
            prims,
            ..RawStage::default()
        };
        let diagnostics = Diagnostics::default();
        let occurrences = flatten(&raw, &ReadSettings::default(), &diagnostics);
        warn(&raw, &occurrences, &diagnostics);
        let warnings = diagnostics.warnings();
        warnings.iter().map(|w| w.prim.clone()).collect()
    }

    fn component(mut prim: RawPrim) -> RawPrim {
        prim.kind = Some("component".into());
        prim
    }

    #[test]
    fn modes_are_inherited_and_apply_at_components_and_where_asked() {
        let applied = |prim| with_attribute(prim, "model:applyDrawMode", Value::Bool(true), None);
        let mode = |prim, word| with_token(prim, "model:drawMode", word);
        let xform = |path, parent| prim(path, "Xform", parent);
        assert_eq!(
            warned(vec![
                mode(xform("/a", None), "cards"),
                component(xform("/a/chair", Some(0))),
                component(xform("/a/chair/leg", Some(1))),
                mode(component(xform("/a/full", Some(0))), "default"),
                xform("/a/group", Some(0)),
                mode(applied(xform("/a/box", Some(0))), "bounds"),
                component(xform("/plain", None)),
            ]),
            ["/a/box", "/a/chair"]
        );
    }
}
