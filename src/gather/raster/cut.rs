//! What a group of receivers sees of the octree: areas in full view, areas partly hidden, surfels that are near.
//!
//! How finely it is opened is two questions. Whether a cluster is seen is asked by rays, which are dear, of large ones
//! first: where all rays agree, all of it is seen or not. How much light it sends is computed, which is cheap, of parts
//! that are much smaller.

use super::RasterEngine;
use super::group::{Disk, Group};
use super::probe::{self, Answers};
use super::transport::Area;
use crate::octree::{Node, NodeKind};
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};
use std::ops::Range;

/// Surfels closer than this many of their radii are seen by short rays.
pub(super) const NEAR_RADII: f32 = 3.0;

/// Clusters closer than this many of their radii are opened.
const OPENED_RADII: f32 = 1.5;

/// Something that part of a group does not see.
#[derive(Debug)]
pub(super) struct Doubt {
    pub(super) surfels: Range<u32>,
    /// Their mean brightness.
    pub(super) mean: f32,
    /// What it consists of, in [`Cut::doubtful`].
    pub(super) areas: Range<usize>,
    /// What the group was told about it.
    pub(super) answers: Answers,
}

/// A surfel that some receivers see by short rays, and others as an area.
#[derive(Debug)]
pub(super) struct Close {
    pub(super) area: Area,
    pub(super) disk: Disk,
    /// In [`Cut::doubts`]; `None`: it is in full view.
    pub(super) doubt: Option<usize>,
}

/// The cut of a group.
#[derive(Debug, Default)]
pub(super) struct Cut {
    pub(super) seen: Vec<Area>,
    pub(super) doubtful: Vec<Area>,
    pub(super) doubts: Vec<Doubt>,
    pub(super) close: Vec<Close>,
    /// Surfels by their place in leaf order, and bits of the members that they are near to.
    pub(super) near: Vec<(u32, u64)>,
}

/// Whether a group sees something.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Sight {
    Unknown,
    Full,
    /// Only part of it: the doubt about that.
    Partly(usize),
}

/// A cut in the making.
struct Cutter<'a> {
    engine: &'a RasterEngine<'a>,
    group: &'a Group,
    cut: Cut,
}

/// Cut the octree for `group`.
#[inline(always)]
pub(super) fn find(engine: &RasterEngine<'_>, group: &Group) -> Cut {
    let mut cutter = Cutter {
        engine,
        group,
        cut: Cut::default(),
    };
    let mut pending = Vec::new();
    if engine.octree.node_count() != 0 {
        pending.push((0_usize, Sight::Unknown));
    }
    // What a node pushes is done before its siblings are, so that the areas of a doubt stand together.
    while let Some((index, sight)) = pending.pop() {
        cutter.visit(index, sight, &mut pending);
    }
    cutter.cut
}

impl Cutter<'_> {
    #[inline(always)]
    fn visit(&mut self, index: usize, mut sight: Sight, pending: &mut Vec<(usize, Sight)>) {
        let (engine, group) = (self.engine, self.group);
        let node = &engine.octree.node(index);
        if is_hidden(node, engine.heights[index], group) {
            return;
        }
        let squared = group.nearest_squared(node.center);
        if node.reflected_power == Vec3::ZERO && !is_lit_anew(engine, squared, node.radius) {
            return;
        }
        let knobs = &engine.knobs;
        if squared.sqrt() - node.radius > knobs.max_distance {
            return;
        }
        let solid_angle = node.area.max(node.extent_area()) / squared;
        let is_outside =
            squared > (OPENED_RADII * node.radius).powi(2) && node.reflected_power != Vec3::ZERO;
        let kind = node.kind();
        let is_small = solid_angle <= knobs.max_solid_angle;
        if sight == Sight::Unknown && is_outside && solid_angle <= knobs.max_asked {
            let surfels = engine.below[index].clone();
            let mean = node.reflected_power.element_sum() / (PI * node.area);
            let answers = probe::ask(engine, group, (&surfels, mean), (knobs.rays, None));
            sight = match (answers.verdict(), is_small) {
                (Some(false), _) => return,
                (Some(true), _) => Sight::Full,
                // Nothing of it is above the horizons but for what no ray met.
                (None, true) if answers.is_empty() => return,
                (None, true) => self.doubt((surfels, mean), answers),
                // Doubt about a cluster is doubt about each of its parts.
                (None, false) => Sight::Unknown,
            };
        }
        if sight != Sight::Unknown && is_outside && solid_angle <= knobs.max_area {
            if let Some(area) = area_of(engine, node, group.center) {
                self.add(area, sight, None);
            }
            return;
        }
        match kind {
            NodeKind::Inner(children) => pending.extend(children.map(|child| (child, sight))),
            NodeKind::Leaf(surfels) => {
                for surfel in surfels {
                    self.add_surfel(surfel, sight);
                }
            }
        }
    }

    /// A new doubt about `surfels` of `mean` brightness.
    fn doubt(&mut self, (surfels, mean): (Range<u32>, f32), answers: Answers) -> Sight {
        let next = self.cut.doubtful.len();
        self.cut.doubts.push(Doubt {
            surfels,
            mean,
            areas: next..next,
            answers,
        });
        Sight::Partly(self.cut.doubts.len() - 1)
    }

    /// An area; of a surfel that some receivers are `near` to.
    fn add(&mut self, area: Area, sight: Sight, near: Option<Disk>) {
        let doubt = match sight {
            Sight::Partly(doubt) => Some(doubt),
            Sight::Unknown | Sight::Full => None,
        };
        if let Some(disk) = near {
            self.cut.close.push(Close { area, disk, doubt });
        } else if let Some(doubt) = doubt {
            self.cut.doubtful.push(area);
            self.cut.doubts[doubt].areas.end = self.cut.doubtful.len();
        } else {
            self.cut.seen.push(area);
        }
    }

    #[inline(always)]
    fn add_surfel(&mut self, i: usize, mut sight: Sight) {
        let (engine, group) = (self.engine, self.group);
        let surfels = engine.octree.surfels();
        let (position, normal, radius) =
            (surfels.position(i), surfels.normal(i), surfels.radius(i));
        let is_dark = surfels.reflected(i) == Vec3::ZERO;
        if (is_dark && engine.surfels.near().is_none())
            || !group.is_above(position, normal, (radius, 0.0))
            || !group.is_faced_by(position, normal, radius)
        {
            return;
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "surfels have 32-bit numbers"
        )]
        let place = i as u32;
        let near = self.near((place, position, normal, radius));
        if is_dark {
            return;
        }
        if sight == Sight::Unknown {
            let one = place..place + 1;
            let mean = surfels.reflected(i).element_sum();
            let rays = (engine.knobs.rays, near.as_ref());
            let answers = probe::ask(engine, group, (&one, mean), rays);
            sight = match answers.verdict() {
                Some(true) => Sight::Full,
                None if !answers.is_empty() => self.doubt((one, mean), answers),
                _ => return,
            };
        }
        let area = Area {
            position,
            normal,
            area: surfels.area(i),
            light: surfels.reflected(i),
        };
        self.add(area, sight, near);
    }

    /// The surfel as a disk, if it is near to any receiver.
    fn near(&mut self, (place, position, normal, radius): (u32, Vec3, Vec3, f32)) -> Option<Disk> {
        let reach = self.engine.knobs.near_radii * radius;
        if self.group.nearest_squared(position) >= reach * reach {
            return None;
        }
        let disk = Disk {
            position,
            normal,
            radius,
            reach,
        };
        let is_near = |&i: &usize| self.group.is_near(i, &disk);
        let near = (0..self.group.len()).filter(is_near);
        let near = near.fold(0, |mask, i| mask | 1 << i);
        if near == 0 {
            return None;
        }
        self.cut.near.push((place, near));
        Some(disk)
    }
}

/// True if what is dark within `radius` of a place at this squared distance may have to be lit anew: what is seen from near
/// by has the light of its own place, not the mean of its surfel, which a few rays to the lights found to be nothing.
#[inline(always)]
fn is_lit_anew(engine: &RasterEngine<'_>, squared: f32, radius: f32) -> bool {
    let reach = radius * (1.0 + engine.knobs.near_radii);
    engine.surfels.near().is_some() && squared < reach * reach
}

/// True if nothing of `node` is seen by any receiver.
#[inline(always)]
fn is_hidden(node: &Node, height: f32, group: &Group) -> bool {
    let size = (node.radius, height);
    if !group.is_above(node.center, node.normal, size) {
        return true;
    }
    let offset = group.center - node.center;
    let (distance, around) = (offset.length(), node.radius + group.radius);
    distance > around
        && offset.angle_between(node.normal) - node.spread - (around / distance).asin() >= FRAC_PI_2
}

/// `node` as one area.
fn area_of(engine: &RasterEngine<'_>, node: &Node, viewer: Vec3) -> Option<Area> {
    let toward = (viewer - node.center).try_normalize()?;
    if node.is_flat() {
        let light = node.reflected_power / (PI * node.area);
        return (node.area > 0.0).then_some(Area {
            position: node.center,
            normal: node.normal,
            area: node.facing_area,
            light,
        });
    }
    let seen = engine.octree.appearance(node, toward)?;
    Some(Area {
        position: node.center,
        normal: Vec3::ZERO,
        area: seen.projected_area,
        light: seen.reflected,
    })
}
