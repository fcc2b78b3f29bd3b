//! The surfels of an octree, 32 bytes each, in leaf order.

use crate::math::packing::{
    RATIO_BITS, color_bits, pack_color, pack_direction, pack_ratio, unpack_color, unpack_direction,
    unpack_ratio,
};
use crate::surfels::SurfelCloud;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;

/// Mantissa bits of a surfel's radiance: 0.006 % of its largest channel. What is left of 64 bits tells the area.
const MANTISSA_BITS: u32 = 13;

/// One surfel. Two share a cache line.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(32))]
struct Packed {
    position: Vec3,
    id: u32,
    normal: u32,
    radius: f32,
    /// Reflected radiance, above it area by radius².
    light: u64,
}

const _: () = assert!(size_of::<Packed>() == 32 && color_bits(MANTISSA_BITS) + RATIO_BITS <= 64);

impl Packed {
    fn of(cloud: &SurfelCloud, id: u32) -> Self {
        let i = id as usize;
        let radius = cloud.radius[i];
        let ratio = u64::from(pack_ratio(cloud.area[i] / radius / radius));
        let reflected = pack_color(cloud.reflected(i) * FRAC_1_PI, MANTISSA_BITS);
        Self {
            position: cloud.position[i],
            id,
            normal: pack_direction(cloud.normal[i]),
            radius,
            light: reflected | ratio << color_bits(MANTISSA_BITS),
        }
    }
}

/// The surfels of an octree in leaf order; places in this order are what the methods take. Positions and radii are those
/// of the cloud, normals are off by up to 0.004°, areas by 0.012 %, radiance by 0.006 % of its largest channel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LeafSurfels {
    packed: Vec<Packed>,
    /// Places of surfels that emit, ascending, and their emitted radiance.
    emitted: Vec<(u32, Vec3)>,
}

impl LeafSurfels {
    /// The surfels `ids` of `cloud`, in that order.
    pub(super) fn new(cloud: &SurfelCloud, ids: &[u32]) -> Self {
        let count = u32::try_from(cloud.len()).expect("a cloud has less than 2³² surfels");
        // In the order of the cloud first: columns are read from end to end, and only rows jump.
        let rows: Vec<Packed> = (0..count)
            .into_par_iter()
            .map(|id| Packed::of(cloud, id))
            .collect();
        let emits: Vec<bool> = (cloud.emission.par_iter())
            .map(|&light| light != Vec3::ZERO)
            .collect();
        let emitted = |(place, &id): (u32, &u32)| {
            let light = || (place, cloud.emission[id as usize] * FRAC_1_PI);
            emits[id as usize].then(light)
        };
        Self {
            packed: ids.par_iter().map(|&id| rows[id as usize]).collect(),
            emitted: if emits.par_iter().any(|&emits| emits) {
                let places = (0..count).into_par_iter().zip(ids);
                places.filter_map(emitted).collect()
            } else {
                Vec::new()
            },
        }
    }

    /// Number of surfels.
    pub fn len(&self) -> usize {
        self.packed.len()
    }

    /// True without surfels.
    pub fn is_empty(&self) -> bool {
        self.packed.is_empty()
    }

    /// Index of the surfel in the cloud.
    #[inline]
    pub fn id(&self, place: usize) -> u32 {
        self.packed[place].id
    }

    /// Center, relative to the tree's origin.
    #[inline]
    pub fn position(&self, place: usize) -> Vec3 {
        self.packed[place].position
    }

    /// Unit normal.
    #[inline]
    pub fn normal(&self, place: usize) -> Vec3 {
        unpack_direction(self.packed[place].normal)
    }

    /// Radius of the disk that covers the micropolygon.
    #[inline]
    pub fn radius(&self, place: usize) -> f32 {
        self.packed[place].radius
    }

    /// True area.
    #[inline]
    pub fn area(&self, place: usize) -> f32 {
        let Packed { radius, light, .. } = self.packed[place];
        #[expect(clippy::cast_possible_truncation, reason = "the highest 17 bits")]
        let ratio = (light >> color_bits(MANTISSA_BITS)) as u32;
        unpack_ratio(ratio) * radius * radius
    }

    /// Reflected radiance: reflected radiosity / π.
    #[inline]
    pub fn reflected(&self, place: usize) -> Vec3 {
        unpack_color(self.packed[place].light, MANTISSA_BITS)
    }

    /// Emitted radiance: emission / π.
    #[inline]
    pub fn emitted(&self, place: usize) -> Vec3 {
        if self.emitted.is_empty() {
            return Vec3::ZERO;
        }
        let found = (self.emitted).binary_search_by_key(&place, |&(place, _)| place as usize);
        found.map_or(Vec3::ZERO, |i| self.emitted[i].1)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.packed.len() * size_of::<Packed>() + self.emitted.len() * size_of::<(u32, Vec3)>()
    }
}
