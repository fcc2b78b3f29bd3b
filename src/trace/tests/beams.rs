//! Rays that lie close together.

use super::*;

#[test]
fn beams_hit_what_their_rays_hit_to_the_last_bit() {
    let mut random = Random(57);
    let scene = mixed_scene(&mut random);
    let mut beam = Beam::default();
    let (mut hits, mut rays) = (0, 0);
    for most_copies in [usize::MAX, 0] {
        let tracer = Tracer::with_copies(&scene, most_copies, |_| true);
        for i in 0..1500 {
            // From rays that are one to such that look everywhere; every 20th is no ray.
            let width = [0.0, 1e-6, 1e-3, 0.05, 2.0][i % 5];
            let (eye, ahead) = (1.5 * random.vector(), random.direction());
            let asked: Vec<_> = (0..i % 70)
                .map(|k| {
                    let direction = (ahead + width * random.vector()).normalize();
                    let origin = eye + 0.1 * width * random.vector();
                    let broken = if k % 20 == 19 { f32::NAN } else { 1.0 };
                    (origin * broken, direction, 0.2 + 2.0 * random.next())
                })
                .collect();
            beam.clear();
            for &(origin, direction, length) in &asked {
                beam.push(origin, direction, length);
            }
            tracer.solid_closest_in(&mut beam);
            for (k, &(origin, direction, length)) in asked.iter().enumerate() {
                let alone = tracer.solid_closest(origin, direction, length);
                assert_eq!(beam.hit(k), alone, "{i} {k}");
                hits += usize::from(alone.is_some());
                rays += 1;
            }
        }
    }
    assert!(hits > rays / 10 && hits < rays, "{hits} of {rays}");
}

#[test]
fn ways_are_as_open_together_as_alone_to_the_last_bit() {
    let mut random = Random(91);
    let scene = mixed_scene(&mut random);
    let (mut open, mut all) = (0, 0);
    for most_copies in [usize::MAX, 0] {
        let tracer = Tracer::with_copies(&scene, most_copies, |_| true);
        for i in 0..1500 {
            // From a place to a light that is a point or as large as the scene; every 9th is no way.
            let size = [0.0, 1e-3, 0.1, 2.0][i % 4];
            let (place, light) = (1.5 * random.vector(), 1.5 * random.vector());
            let ways: Vec<Way> = (0..i % (TOGETHER + 1))
                .map(|k| {
                    let offset = light + size * random.vector() - place;
                    let broken = if k % 9 == 8 { f32::NAN } else { 1.0 };
                    Way {
                        origin: place * broken,
                        direction: offset.normalize(),
                        max_distance: offset.length() * random.next(),
                    }
                })
                .collect();
            let found = tracer.transmittances(&ways);
            for (way, found) in ways.iter().zip(found) {
                let alone = tracer.transmittance(way.origin, way.direction, way.max_distance);
                assert_eq!(found, alone, "{i}");
                open += usize::from(found == 1.0);
                all += 1;
            }
            assert!(found[ways.len()..].iter().all(|&open| open == 0.0));
        }
    }
    assert!(open > all / 10 && open < all - all / 10, "{open} of {all}");
}
