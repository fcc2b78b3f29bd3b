//! What many small sources of light have in common: a tree of clusters of them, the cut through it that a receiver looks at, and
//! rays to sources that are picked by their share.
//!
//! The cut is found from wide to narrow: clusters around and next to the receiver are opened first, whatever is seen under half
//! that angle next. Where there are too many to open, what is left as it is then is small everywhere.

use super::pattern;
use super::stand::Stand;
use crate::math::Bounds3;
use crate::trace::{TOGETHER, Way};
use glam::{Vec2, Vec3};

/// A cluster's radius over its distance below which it counts as a point: the error of that is of second order.
pub(super) const POINT_LIKE: f32 = 0.05;
/// Most sources of a cluster that is not divided.
const LEAF_SIZE: usize = 8;
/// So many clusters are looked at for one receiver; those left then are taken as they are, roughly.
pub(super) const MOST_LOOKS: usize = 2048;
/// Subtrees of at least this many sources are built in parallel.
const PARALLEL: usize = 8192;

/// Radius over distance of the widest clusters that are left closed by one round after the other.
const ROUNDS: [f32; 7] = [1.6, 0.8, 0.4, 0.2, 0.1, POINT_LIKE, 0.0];

/// A cluster: a run of sources; its first child follows it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub(super) first: u32,
    pub(super) count: u32,
    /// The second child; 0 = none.
    pub(super) second: u32,
    /// Of power.
    pub(super) center: Vec3,
    /// Of the ball about the center that holds it.
    pub(super) radius: f32,
    /// Sum over its sources.
    pub(super) moment: Vec3,
    /// Unit, in the middle of its normals.
    pub(super) axis: Vec3,
    /// Cosine of the largest angle between a normal and the axis.
    pub(super) cone: f32,
    pub(super) power: f32,
    /// Of particles: area of their disks over that of the ball's.
    pub(super) coverage: f32,
    /// Mean emission over its luminance.
    pub(super) color: Vec3,
}

/// What a tree is built over.
pub(super) trait Item: Send + Sync + Sized {
    fn center(&self) -> Vec3;

    fn power(&self) -> f32;

    /// Sums over `items`, at least one, the first of which has the number `first`; without children.
    fn node(items: &[Self], first: u32) -> Node;
}

/// A part of the emitters and what it gives without occluders.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    pub(super) first: u32,
    pub(super) count: u32,
    /// In luminance.
    pub(super) irradiance: f32,
    pub(super) power: f32,
    pub(super) color: Vec3,
}

/// What a cluster is to a receiver.
pub(super) enum Seen {
    /// It is below the horizon or turned away.
    Nothing,
    /// As good as a point of this irradiance.
    Point(f32),
    /// Neither for certain: its radius over its distance.
    Unclear(f32),
}

/// How a receiver looks at a tree.
pub(super) trait Cut {
    /// What it sees of a cluster.
    fn seen(&mut self, node: &Node) -> Seen;

    /// In luminance, what a cluster gives, about.
    fn roughly(&self, node: &Node) -> f32;

    /// A single source, by its number.
    fn source(&self, number: u32) -> Part;

    /// The parts of the tree of `nodes` that shine on it, in order of their sources.
    fn parts(&mut self, nodes: &[Node]) -> Vec<Part> {
        let mut walk = Walk::default();
        if let Some(root) = nodes.first() {
            walk.look(self, (0, root), f32::INFINITY);
        }
        for widest in ROUNDS {
            walk.widen(widest);
            let mut next = 0;
            while let Some(&index) = walk.wide.get(next) {
                next += 1;
                let node = &nodes[index as usize];
                if walk.looks > MOST_LOOKS {
                    walk.narrow.push((index, 0.0));
                } else if node.second == 0 {
                    let all = node.first..node.first + node.count;
                    walk.parts.extend(all.map(|number| self.source(number)));
                } else {
                    for child in [index + 1, node.second] {
                        walk.look(self, (child, &nodes[child as usize]), widest);
                    }
                }
            }
        }
        let mut parts = walk.parts;
        parts.extend(walk.narrow.into_iter().map(|(index, _)| {
            let node = &nodes[index as usize];
            node.part(self.roughly(node))
        }));
        parts.retain(|part| part.irradiance > 0.0);
        parts.sort_unstable_by_key(|part| part.first);
        parts
    }
}

/// A cut that is being found.
#[derive(Default)]
struct Walk {
    parts: Vec<Part>,
    /// To be opened in this round, in turn.
    wide: Vec<u32>,
    /// Perhaps to be opened in a later one: with the radius over the distance.
    narrow: Vec<(u32, f32)>,
    looks: usize,
}

impl Walk {
    fn look(&mut self, cut: &mut (impl Cut + ?Sized), (index, node): (u32, &Node), widest: f32) {
        self.looks += 1;
        match cut.seen(node) {
            Seen::Nothing => {}
            Seen::Point(irradiance) => self.parts.push(node.part(irradiance)),
            Seen::Unclear(width) if width > widest => self.wide.push(index),
            Seen::Unclear(width) => self.narrow.push((index, width)),
        }
    }

    /// Go on with what is wider than `widest`.
    fn widen(&mut self, widest: f32) {
        let wide = &mut self.wide;
        wide.clear();
        self.narrow.retain(|&(index, width)| {
            let stays = width <= widest;
            if !stays {
                wide.push(index);
            }
            stays
        });
    }
}

impl Node {
    fn part(&self, irradiance: f32) -> Part {
        Part {
            first: self.first,
            count: self.count,
            irradiance,
            power: self.power,
            color: self.color,
        }
    }
}

/// A point of a part of the emitters.
pub(super) struct Look {
    /// What it gives, over what it should give by its share.
    pub(super) weight: Vec3,
    /// To the receiver; `None` where its own surface hides it.
    pub(super) way: Option<Way>,
}

/// Irradiance by `parts`: rays go to the points that `picks`, those of a quarter side by side and then the rest, pick, `look`
/// finds such a point of a part. A quarter of the rays if these agree.
pub(super) fn visible(
    parts: &[Part],
    stand: &Stand<'_>,
    picks: &[Vec2],
    look: impl Fn(&Part, Vec2) -> Option<Look>,
) -> Vec3 {
    let mut sum = 0.0;
    let sums: Vec<f32> = (parts.iter())
        .map(|part| {
            sum += part.irradiance;
            sum
        })
        .collect();
    if sum.is_nan() || sum <= 0.0 {
        return Vec3::ZERO;
    }
    let unoccluded: Vec3 = parts.iter().map(|part| part.color * part.irradiance).sum();
    let picked = |pick: &Vec2| {
        let place = pick.x * sum;
        let at = sums
            .partition_point(|&sum| sum <= place)
            .min(parts.len() - 1);
        let before = if at == 0 { 0.0 } else { sums[at - 1] };
        let within = ((place - before) / parts[at].irradiance).clamp(0.0, 1.0);
        look(&parts[at], Vec2::new(within, pick.y))
    };
    let (mut all, mut lit) = (Vec3::ZERO, Vec3::ZERO);
    let (quarter, rest) = picks.split_at(pattern::quarter_of(picks.len()));
    for (part, is_first) in [(quarter, true), (rest, false)] {
        if !is_first && all != Vec3::ZERO && (lit == Vec3::ZERO || lit == all) {
            break;
        }
        for some in part.chunks(TOGETHER) {
            let (mut weights, mut ways) = ([Vec3::ZERO; TOGETHER], [Way::NONE; TOGETHER]);
            let mut count = 0;
            for look in some.iter().filter_map(picked) {
                all += look.weight;
                if let Some(way) = look.way {
                    (weights[count], ways[count]) = (look.weight, way);
                    count += 1;
                }
            }
            let open = stand.tracer.transmittances(&ways[..count]);
            for (weight, open) in weights.iter().zip(open).take(count) {
                lit += weight * open;
            }
        }
    }
    let share = |lit: f32, all: f32| if all > 0.0 { lit / all } else { 0.0 };
    unoccluded
        * Vec3::new(
            share(lit.x, all.x),
            share(lit.y, all.y),
            share(lit.z, all.z),
        )
}

/// How many of the rising `sums` are not above `pick`, less than all: looked for first where it is if they rise evenly, up to
/// `place`, 0…1, of them.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "below a count of at most 2^31"
)]
fn place_in(sums: &[f64], pick: f64, place: f32) -> usize {
    let last = sums.len() - 1;
    let guess = ((place.max(0.0) * sums.len() as f32) as usize).min(last);
    let is_behind = guess == 0 || sums[guess - 1] <= pick;
    let range = match (is_behind, sums[guess] <= pick) {
        (true, false) => return guess,
        (true, true) => guess..sums.len(),
        (false, _) => 0..guess,
    };
    (range.start + sums[range].partition_point(|&sum| sum <= pick)).min(last)
}

/// The source of `part` that `place`, 0…1, picks by power, `sums` being its running sums over all sources, and what is left
/// of `place` within it, 0…1.
pub(super) fn pick(sums: &[f64], part: &Part, place: f32) -> (usize, f32) {
    let first = part.first as usize;
    let run = &sums[first..first + part.count as usize];
    let before = if first == 0 { 0.0 } else { sums[first - 1] };
    let pick = before + f64::from(place) * (run[run.len() - 1] - before);
    let index = place_in(run, pick, place);
    let low = if index == 0 { before } else { run[index - 1] };
    #[expect(clippy::cast_possible_truncation, reason = "a part of 1")]
    let within = ((pick - low) / (run[index] - low)).clamp(0.0, 1.0) as f32;
    (first + index, within)
}

/// The nodes of a tree over `sources`, which are put in its order, and the running sums of their power.
///
/// # Panics
/// With 2^31 sources or more.
pub(super) fn grow<T: Item>(sources: &mut [T]) -> (Vec<Node>, Vec<f64>) {
    assert!(
        sources.len() < 1 << 31,
        "sources of light are numbered with 31 bits"
    );
    let nodes = if sources.is_empty() {
        Vec::new()
    } else {
        build(sources, 0)
    };
    let mut sum = 0.0;
    let sums = sources.iter().map(|source| {
        sum += f64::from(source.power());
        sum
    });
    (nodes, sums.collect())
}

/// Nodes over `sources`, the first of which has the number `first`; reorders them. Preorder, so that a first child
/// follows its parent.
#[expect(clippy::cast_possible_truncation, reason = "grow asserts the count")]
fn build<T: Item>(sources: &mut [T], first: u32) -> Vec<Node> {
    let node = T::node(sources, first);
    if sources.len() <= LEAF_SIZE {
        return vec![node];
    }
    let bounds = Bounds3::around(sources.iter().map(Item::center));
    let size = bounds.max - bounds.min;
    let axis = (0..3)
        .max_by(|&a, &b| size[a].total_cmp(&size[b]))
        .expect("there are three axes");
    let middle = sources.len() / 2;
    sources.select_nth_unstable_by(middle, |a, b| a.center()[axis].total_cmp(&b.center()[axis]));
    let is_large = sources.len() >= PARALLEL;
    let (low, high) = sources.split_at_mut(middle);
    let second_first = first + middle as u32;
    let (low, high) = if is_large {
        rayon::join(|| build(low, first), || build(high, second_first))
    } else {
        (build(low, first), build(high, second_first))
    };
    let mut nodes = Vec::with_capacity(1 + low.len() + high.len());
    nodes.push(Node {
        second: 1 + low.len() as u32,
        ..node
    });
    let second = nodes[0].second;
    for (shift, part) in [(1, low), (second, high)] {
        nodes.extend(part.into_iter().map(|node| Node {
            second: if node.second == 0 {
                0
            } else {
                node.second + shift
            },
            ..node
        }));
    }
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::testing::Random;

    #[test]
    fn places_are_found_however_sums_rise() {
        let mut random = Random(11);
        let rises: [&dyn Fn(f32) -> f64; 3] = [&|_| 1.0, &|x| f64::from(x * x * x), &|x| {
            if x > 0.4 { 0.0 } else { 3.0 }
        }];
        for rise in rises {
            for count in [1, 2, 7, 300] {
                let mut sum = 5.0;
                let step = |_| {
                    sum += rise(0.5 + 0.5 * random.vector().x);
                    sum
                };
                let sums: Vec<f64> = (0..count).map(step).collect();
                for i in 0..=1000_u16 {
                    let place = f32::from(i) / 1000.0;
                    let pick = 5.0 + f64::from(place) * (sums[count - 1] - 5.0);
                    let all = sums.partition_point(|&sum| sum <= pick);
                    assert_eq!(place_in(&sums, pick, place), all.min(count - 1));
                }
            }
        }
    }
}
