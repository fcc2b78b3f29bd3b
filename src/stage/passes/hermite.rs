//! `HermiteCurves` → `BasisCurves` of the same shape: a cubic by its ends and its derivatives there is one by four
//! Bézier points.

use super::super::raw::{RawPrim, RawStage, Value};
use crate::diagnostics::Diagnostics;
use glam::Vec3;

/// The type that is rewritten.
const TYPE: &str = "HermiteCurves";

/// `raw` with its Hermite curves as Bézier curves. What is wrong with one is a warning, and it stays what it is.
pub fn as_bezier(mut raw: RawStage, diagnostics: &Diagnostics) -> RawStage {
    for prim in raw.prims.iter_mut().filter(|prim| prim.type_name == TYPE) {
        match bezier(prim) {
            Ok((points, counts)) => rewrite(prim, points, counts),
            Err(flaw) => diagnostics.warn("bad-curves", prim.path.clone(), flaw),
        }
    }
    raw
}

/// Points and their counts of the Bézier curves that `prim` is; the error says what does not fit.
fn bezier(prim: &RawPrim) -> Result<(Vec<Vec3>, Vec<i32>), String> {
    let value = |name: &str| prim.attributes.get(name)?.value.as_ref();
    let vectors = |name| match value(name) {
        Some(Value::Vec3Array(values)) => values.as_slice(),
        _ => &[],
    };
    let (points, tangents) = (vectors("points"), vectors("tangents"));
    if points.len() != tangents.len() {
        let (points, tangents) = (points.len(), tangents.len());
        return Err(format!(
            "{tangents} tangents for {points} points, there must be as many"
        ));
    }
    let Some(Value::IntArray(counts)) = value("curveVertexCounts") else {
        return Err("there are no curveVertexCounts".to_owned());
    };
    let (mut made, mut made_counts, mut first) = (Vec::new(), Vec::new(), 0);
    for &count in counts {
        let end = usize::try_from(count).ok().filter(|&count| count > 1);
        let end = end.map(|count| first + count);
        let end = end.filter(|&end| end <= points.len()).ok_or_else(|| {
            format!(
                "curveVertexCounts has a {count}, right: 2 or more, the number of points in all"
            )
        })?;
        let start = made.len();
        made.push(points[first]);
        for at in first + 1..end {
            made.push(points[at - 1] + tangents[at - 1] / 3.0);
            made.push(points[at] - tangents[at] / 3.0);
            made.push(points[at]);
        }
        let count = i32::try_from(made.len() - start);
        made_counts.push(count.map_err(|_| "there are too many points".to_owned())?);
        first = end;
    }
    match first == points.len() {
        true => Ok((made, made_counts)),
        false => Err(format!(
            "curveVertexCounts sum up to {first}, there are {} points",
            points.len()
        )),
    }
}

fn rewrite(prim: &mut RawPrim, points: Vec<Vec3>, counts: Vec<i32>) {
    let of_points = prim.attributes.iter().filter(|(name, attribute)| {
        match attribute.interpolation.as_deref() {
            Some(interpolation) => interpolation == "vertex",
            None => matches!(name.as_str(), "widths" | "normals"),
        }
    });
    let of_points: Vec<String> = of_points.map(|(name, _)| name.clone()).collect();
    for name in of_points {
        // one value at each end of a segment, linear between
        if let Some(attribute) = prim.attributes.get_mut(&name) {
            attribute.interpolation = Some("varying".to_owned());
        }
    }
    prim.attributes.remove("tangents");
    let mut set = |name: &str, value| {
        let mut attribute = prim.attributes.remove(name).unwrap_or_default();
        attribute.value = Some(value);
        prim.attributes.insert(name.to_owned(), attribute);
    };
    set("points", Value::Vec3Array(points));
    set("curveVertexCounts", Value::IntArray(counts));
    for (name, word) in [
        ("type", "cubic"),
        ("basis", "bezier"),
        ("wrap", "nonperiodic"),
    ] {
        set(name, Value::Token(word.to_owned()));
    }
    prim.type_name = "BasisCurves".to_owned();
}

#[cfg(test)]
mod tests {
    use super::super::super::raw::RawAttribute;
    use super::*;

    fn curves(points: &[Vec3], tangents: &[Vec3], counts: &[i32]) -> RawStage {
        let attribute = |value| RawAttribute::from(value);
        let values = [
            ("points", Value::Vec3Array(points.to_vec())),
            ("tangents", Value::Vec3Array(tangents.to_vec())),
            ("curveVertexCounts", Value::IntArray(counts.to_vec())),
            ("widths", Value::FloatArray(vec![0.1; points.len()])),
        ];
        let attributes = values.map(|(name, value)| (name.to_owned(), attribute(value)));
        let prim = RawPrim::typed("/curves", TYPE, None).with(attributes.into_iter().collect());
        RawStage {
            prims: vec![prim],
            prototype_start: 1,
            ..RawStage::default()
        }
    }

    /// (u, u²) for u in 0…1 and 1…2: a parabola has the Bézier points of itself, raised by one degree.
    #[test]
    fn a_parabola_stays_one() {
        let xy = |x: f32, y: f32| Vec3::new(x, y, 0.0);
        let stage = curves(
            &[xy(0.0, 0.0), xy(1.0, 1.0), xy(2.0, 4.0)],
            &[xy(1.0, 0.0), xy(1.0, 2.0), xy(1.0, 4.0)],
            &[3],
        );
        let diagnostics = Diagnostics::default();
        let prim = &as_bezier(stage, &diagnostics).prims[0];
        assert_eq!(prim.type_name, "BasisCurves");
        let Some(Value::Vec3Array(points)) = &prim.attributes["points"].value else {
            panic!("{prim:?}");
        };
        let third = 1.0 / 3.0;
        let expected = [
            xy(0.0, 0.0),
            xy(third, 0.0),
            xy(2.0 * third, third),
            xy(1.0, 1.0),
            xy(4.0 * third, 5.0 * third),
            xy(5.0 * third, 8.0 * third),
            xy(2.0, 4.0),
        ];
        for (point, expected) in points.iter().zip(expected) {
            assert!(point.distance(expected) < 4.0 * f32::EPSILON, "{point}");
        }
        assert_eq!(points.len(), expected.len());
        let counts = &prim.attributes["curveVertexCounts"].value;
        assert_eq!(*counts, Some(Value::IntArray(vec![7])));
        let widths = prim.attributes["widths"].interpolation.as_deref();
        assert_eq!(widths, Some("varying"));
        assert!(diagnostics.warnings().is_empty());
    }

    #[test]
    fn what_does_not_fit_is_told_and_left_as_it_is() {
        let one = Vec3::ONE;
        for (points, tangents, counts) in [
            (vec![one; 3], vec![one; 2], vec![3]),
            (vec![one; 3], vec![one; 3], vec![2]),
            (vec![one; 3], vec![one; 3], vec![2, 1]),
            (vec![one; 3], vec![one; 3], vec![4]),
            (vec![one; 3], vec![one; 3], vec![-3]),
        ] {
            let stage = curves(&points, &tangents, &counts);
            let diagnostics = Diagnostics::default();
            assert_eq!(as_bezier(stage.clone(), &diagnostics), stage);
            assert_eq!(diagnostics.warnings().len(), 1, "{counts:?}");
        }
    }
}
