//! Arrays of meshes taken out of a stage that nobody needs them in any more, so that they are not in memory twice once a scene
//! is made of them.

use super::super::super::raw::{RawAttribute, RawPrim, RawStage, Value};
use super::Layout;
use super::placement::Kind;
use super::primvars::AuthoredPrimvar;
use std::borrow::Cow;
use std::collections::HashMap;
use std::ops::Deref;

/// Arrays below this many bytes stay where they are.
const WORTH_TAKING: usize = 1 << 16;

/// A stage to make a scene of.
#[derive(Debug)]
pub enum Lent<'a> {
    /// It stays as it is.
    Whole(&'a RawStage),
    /// Long arrays of meshes may be taken out of it.
    Spent(&'a mut RawStage),
}

/// Meshes with arrays that are theirs alone, by their place among the prims.
pub(super) struct Bodies(HashMap<usize, RawPrim>);

impl Deref for Lent<'_> {
    type Target = RawStage;

    fn deref(&self) -> &RawStage {
        match self {
            Self::Whole(raw) => raw,
            Self::Spent(raw) => raw,
        }
    }
}

impl<'a> Lent<'a> {
    /// The stage, and what `layout` draws of it that has long arrays.
    pub(super) fn opened(self, layout: &Layout<'_>) -> (&'a RawStage, Bodies) {
        let mut bodies = Bodies(HashMap::new());
        let raw = match self {
            Self::Whole(raw) => return (raw, bodies),
            Self::Spent(raw) => raw,
        };
        for placement in &layout.placements {
            let index = layout.occurrences[placement.occurrence].prim;
            let prim = &mut raw.prims[index];
            if matches!(Kind::of(prim), Kind::Mesh) && prim.attributes.values().any(is_long) {
                let body = prim.clone();
                prim.attributes.retain(|attribute| !is_long(attribute));
                bodies.0.insert(index, body);
            }
        }
        (raw, bodies)
    }
}

impl Bodies {
    /// Prim `index` of `raw` with all its attributes.
    pub(super) fn of<'a>(&self, raw: &'a RawStage, index: usize) -> Cow<'a, RawPrim> {
        match self.0.get(&index) {
            Some(body) => Cow::Owned(body.clone()),
            None => Cow::Borrowed(&raw.prims[index]),
        }
    }
}

/// What other prims inherit stays, and so does what tells how many faces there are.
fn is_long(attribute: &RawAttribute) -> bool {
    let value = attribute
        .value
        .as_ref()
        .filter(|value| value.array_len().is_some());
    let is_primvar =
        attribute.name.starts_with("primvars:") && !attribute.name.ends_with(":indices");
    value.is_some_and(|value| value.bytes() >= WORTH_TAKING)
        && attribute.name != "faceVertexCounts"
        && !(is_primvar && AuthoredPrimvar::is_inheritable(attribute))
}

/// The array `name` of `prim` as `pick` finds it: taken out where the prim is one's own.
pub(super) fn array<'a, T: Clone>(
    prim: &mut Cow<'a, RawPrim>,
    name: &str,
    pick: impl Fn(Value) -> Option<Vec<T>>,
    look: impl Fn(&'a RawPrim) -> &'a [T],
) -> Cow<'a, [T]> {
    match prim {
        Cow::Borrowed(prim) => Cow::Borrowed(look(prim)),
        Cow::Owned(prim) => {
            let value = prim
                .attributes
                .remove(name)
                .and_then(|attribute| attribute.value);
            Cow::Owned(value.and_then(pick).unwrap_or_default())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{mesh, with_attribute, with_ints};
    use super::*;
    use crate::diagnostics::Diagnostics;
    use crate::stage::ReadSettings;
    use crate::stage::passes::{scene, scene_of_spent};
    use glam::{Vec2, Vec3};

    /// Squares along an edge.
    const SIDE: i32 = 100;

    /// A bumpy sheet with normals, indexed face-varying `st` and a constant color, and a triangle below it.
    fn stage() -> RawStage {
        let line = SIDE + 1;
        let points: Vec<Vec3> = (0..line * line)
            .map(|i| Vec3::new((i % line) as f32, (i % 7) as f32, (i / line) as f32))
            .collect();
        let indices: Vec<i32> = (0..SIDE * SIDE)
            .map(|face| face / SIDE * line + face % SIDE)
            .flat_map(|corner| [corner, corner + line, corner + line + 1, corner + 1])
            .collect();
        let sheet = mesh("/a", &points, &[4; (SIDE * SIDE) as usize], &indices);
        let normals = points.iter().map(|point| Vec3::Y + 0.01 * *point).collect();
        let sheet = with_attribute(sheet, "normals", Value::Vec3Array(normals), None);
        let st = points.iter().map(|p| Vec2::new(p.x, p.z)).collect();
        let sheet = with_attribute(
            sheet,
            "primvars:st",
            Value::Vec2Array(st),
            Some("faceVarying"),
        );
        let sheet = with_ints(sheet, "primvars:st:indices", &indices);
        let color = Value::Vec3Array(vec![Vec3::X]);
        let sheet = with_attribute(sheet, "primvars:displayColor", color, None);
        let mut small = mesh("/a/b", &[Vec3::ZERO, Vec3::X, Vec3::Y], &[3], &[0, 1, 2]);
        small.parent = Some(0);
        RawStage {
            prims: vec![sheet, small],
            prototype_start: 2,
            ..RawStage::default()
        }
    }

    #[test]
    fn a_spent_stage_gives_the_same_scene_and_has_lost_its_long_arrays() {
        let settings = ReadSettings::default();
        let whole = scene(&stage(), &settings, &Diagnostics::default()).unwrap();
        let mut raw = stage();
        let spent = scene_of_spent(&mut raw, &settings, &Diagnostics::default()).unwrap();
        assert_eq!(whole.meshes, spent.meshes);
        assert_eq!(whole.meshes[0].primvars.len(), 2);
        assert_eq!(whole.meshes[1].primvars.len(), 1, "inherited");
        let left: Vec<&String> = raw.prims[0].attributes.keys().collect();
        let stays = |name: &str| left.iter().any(|left| *left == name);
        assert!(!stays("points") && !stays("faceVertexIndices") && !stays("normals"));
        assert!(!stays("primvars:st") && !stays("primvars:st:indices"));
        assert!(stays("primvars:displayColor") && stays("faceVertexCounts"));
        assert!(
            raw.prims[1].attributes.contains_key("points"),
            "it is short"
        );
    }
}
