//! The definition of painting: what one triangle adds to a map, pixel by pixel.

use super::super::shell::TriangleBlock;
use super::{Brush, COVER, DepthMap, TAG_BITS};

/// Paint lane `lane` of `block`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "pixels and depths within the map"
)]
pub(super) fn paint(map: &mut DepthMap, brush: &Brush, block: &TriangleBlock, lane: usize) {
    let [a, b, c] = block.corners.each_ref().map(|corner| {
        let [px, py, pz] = corner.each_ref().map(|row| row[lane]);
        brush
            .rows
            .map(|(to, offset)| px * to.x + py * to.y + pz * to.z + offset)
    });
    let low = |k: usize| (a[k].min(b[k]).min(c[k]) - 0.5).max(0.0).ceil();
    let high = |k: usize, count: u32| {
        let last = (count - 1) as f32;
        (a[k].max(b[k]).max(c[k]) - 0.5).min(last).floor()
    };
    let (first, last) = ([low(0), low(1)], [high(0, map.width), high(1, map.height)]);
    let (u, v) = (
        [0, 1, 2].map(|k| b[k] - a[k]),
        [0, 1, 2].map(|k| c[k] - a[k]),
    );
    let area = u[0] * v[1] - u[1] * v[0];
    if first[0] > last[0] || first[1] > last[1] || area == 0.0 {
        return;
    }
    let faces = area > 0.0;
    let sign = if faces { 1.0 } else { -1.0 };
    let slack = (u[0].abs() + u[1].abs() + v[0].abs() + v[1].abs() + 1.0) * COVER;
    let middle = first.map(|x| x + 0.5);
    let near = [a, b, c].map(|p| [p[0] - middle[0], p[1] - middle[1]]);
    let edges = [0, 1, 2].map(|k| {
        let (p, q) = (near[k], near[(k + 1) % 3]);
        let along = [(q[0] - p[0]) * sign, (q[1] - p[1]) * sign];
        let start = along[1] * p[0] - along[0] * p[1] + slack;
        [start, -along[1], along[0]]
    });
    let inverse = 1.0 / area;
    let slope = [
        (u[2] * v[1] - v[2] * u[1]) * inverse,
        (v[2] * u[0] - u[2] * v[0]) * inverse,
    ];
    let start = a[2] - slope[0] * near[0][0] - slope[1] * near[0][1];
    let (least, most) = (a[2].min(b[2]).min(c[2]), a[2].max(b[2]).max(c[2]));
    let (columns, rows) = ((last[0] - first[0]) as u32, (last[1] - first[1]) as u32);
    for (j, i) in (0..=rows).flat_map(|j| (0..=columns).map(move |i| (j, i))) {
        let (x, y) = (i as f32, j as f32);
        if edges.iter().any(|e| e[0] + (e[1] * x + e[2] * y) < 0.0) {
            continue;
        }
        let depth = (start + (slope[0] * x + slope[1] * y)).max(least).min(most);
        let pixel = ((first[1] as u32 + j) * map.width + first[0] as u32 + i) as usize;
        let side = map.side();
        let (along, against) = if faces {
            (brush.front, brush.back)
        } else {
            (brush.back, brush.front)
        };
        let mut keep = |at: usize, depth: f32, tag: u32| {
            if !brush.is_solid || tag & 1 == 1 {
                map.keys[at] = map.keys[at].max((depth as u32) << TAG_BITS | tag);
            }
        };
        keep(pixel, depth, along);
        keep(pixel + side, brush.top - depth, against);
    }
}
