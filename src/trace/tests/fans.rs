//! Rays that start between the faces around a vertex, some of which stand on edge, far from the scene's origin: the
//! same search in `f64` is the truth.

use super::*;

/// Faces about `vertex` with a rim of that `size`: two rim points a little apart in azimuth but not in height span a
/// face that holds the upward direction, nearly.
fn fan(vertex: Vec3, size: f32, random: &mut Random) -> Vec<[Vec3; 3]> {
    let count = 3 + (random.next() * 4.0) as usize;
    let mut rim = Vec::new();
    for i in 0..count {
        let azimuth = std::f32::consts::TAU * (i as f32 + 0.5 * random.next()) / count as f32;
        let mut at = |azimuth: f32| {
            let (sin, cos) = azimuth.sin_cos();
            vertex + size * Vec3::new(cos, random.next() - 0.5, sin)
        };
        let (first, second) = (at(azimuth), at(azimuth));
        let step = Vec3::new(random.next(), 0.0, random.next()) * 1e-3 * size;
        rim.extend([first, second + step]);
    }
    (0..rim.len())
        .map(|i| [vertex, rim[(i + 1) % rim.len()], rim[i]])
        .collect()
}

/// First triangle and its distance; `None` where a ray passes too close to an edge for the oracle to tell.
type Truth = Option<Option<(usize, f64)>>;

fn truth(triangles: &[[Vec3; 3]], origin: Vec3, direction: Vec3) -> Truth {
    const EDGE: f64 = 1e-9;
    let hits = (triangles.iter().enumerate())
        .filter_map(|(i, triangle)| exact(triangle, origin, direction).map(|hit| (i, hit)));
    let near: Vec<_> = hits.filter(|(_, hit)| hit.1 > -EDGE).collect();
    if near.iter().any(|(_, hit)| hit.1 < EDGE) {
        return None;
    }
    let first = near.iter().min_by(|a, b| a.1.0.total_cmp(&b.1.0));
    Some(first.map(|&(i, (distance, ..))| (i, distance)))
}

fn agrees(hit: Option<Hit>, truth: Option<(usize, f64)>) -> bool {
    match (hit, truth) {
        (None, None) => true,
        (Some(hit), Some((triangle, distance))) => {
            let error = (f64::from(hit.distance) - distance).abs();
            hit.triangle as usize == triangle && error <= f64::from(f32::EPSILON) * distance
        }
        _ => false,
    }
}

#[test]
fn faces_on_edge_around_a_receiver_hide_what_they_hide_in_double_precision() {
    let mut random = Random(81);
    let (mut checked, mut hit) = (0, 0);
    for k in 0..120 {
        let size = [1e-3, 0.05, 1.0][k % 3];
        let vertex = [Vec3::ZERO, random.vector(), random.vector() * 90.0][k / 3 % 3];
        let triangles = fan(vertex, size, &mut random);
        let tracer = single(&triangles);
        let height = tracer.lift_height(vertex);
        // As many as a packet holds, between the faces about the vertex.
        let origins: Vec<_> = (0..64)
            .map(|i| {
                let aside = Vec3::new(random.next() - 0.5, 0.0, random.next() - 0.5) * height;
                tracer.lift(vertex, Vec3::Y) + aside * (i % 8) as f32
            })
            .collect();
        for _ in 0..20 {
            let direction = random.direction();
            let (mut hits, all) = ([None; 64], f32::INFINITY);
            tracer.closest_along(direction, &origins, (all, u64::MAX), &mut hits);
            let blocked = tracer.occluded_along(direction, &origins, all, u64::MAX);
            for (i, &origin) in origins.iter().enumerate() {
                let Some(truth) = truth(&triangles, origin, direction) else {
                    continue;
                };
                let what = format!("{k} {origin} {direction} {truth:?}");
                let single = tracer.closest(origin, direction, all);
                assert!(agrees(single, truth), "{what} {single:?}");
                assert_eq!(tracer.occluded(origin, direction, all), truth.is_some());
                assert!(agrees(hits[i], truth), "{what} {:?}", hits[i]);
                assert_eq!(blocked >> i & 1 == 1, truth.is_some(), "{what}");
                checked += 1;
                hit += usize::from(truth.is_some());
            }
        }
    }
    assert!(checked > 140_000 && hit > 40_000, "{checked} {hit}");
}
