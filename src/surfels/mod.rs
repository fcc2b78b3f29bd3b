//! Surfel clouds: small disks that cover the surfaces of a scene, with their light. PBGI §4.

mod clusters;
pub mod dice_map;
pub mod dice_table;
pub mod nearest;
pub mod points;
pub mod splats;
pub mod triangle_dice;

pub use dice_map::{DiceMap, PrimDice, Sides};
pub use dice_table::DiceTable;
pub use nearest::NearestMap;

use glam::{DVec3, Vec3};

/// Surfels as columns of equal length. World space relative to `origin`, stage units, linear light.
///
/// Promises: unit normals, finite values, `radius > 0`, `area >= 0`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfelCloud {
    /// World position that `position` is relative to.
    pub origin: DVec3,
    /// Centers.
    pub position: Vec<Vec3>,
    /// Unit normals; a surfel is one-sided, it shines and occludes towards its normal. A surface seen from both
    /// sides has two surfels.
    pub normal: Vec<Vec3>,
    /// Radius of a disk that covers the micropolygon or cluster of triangles (footprint; for most larger than
    /// `sqrt(area/π)`).
    pub radius: Vec<f32>,
    /// True area of the micropolygon or cluster, without what is cut out of it or transparent, stage units².
    pub area: Vec<f32>,
    /// Radiosity: emission + reflected light (π · outgoing radiance of a diffuse surface).
    pub radiosity: Vec<Vec3>,
    /// Diffuse albedo, 0…1.
    pub albedo: Vec<Vec3>,
    /// The emitted part of `radiosity` (π · emitted radiance).
    pub emission: Vec<Vec3>,
    /// Index into `prim_paths` of the source prim (equal to its `PrimId` in a cloud baked in this run).
    pub prim: Vec<u32>,
    /// Stage paths of the source prims.
    pub prim_paths: Vec<String>,
    /// Spacing it was diced at, stage units; 0 when unknown.
    pub spacing: f32,
}

impl SurfelCloud {
    /// Number of surfels.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// True without surfels.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// All surfels of `clouds`, which share one origin, as one cloud; prims are renumbered in the clouds' order.
    /// The spacing is that of the finest.
    ///
    /// # Panics
    /// With more than 2³² prims in all.
    pub fn joined(clouds: &[Self]) -> Self {
        let mut all = clouds
            .first()
            .map(|first| Self {
                origin: first.origin,
                ..Self::default()
            })
            .unwrap_or_default();
        for cloud in clouds {
            debug_assert_eq!(
                cloud.origin, all.origin,
                "clouds are read relative to one origin"
            );
            let first_prim = u32::try_from(all.prim_paths.len()).expect("fewer than 2³² prims");
            all.position.extend_from_slice(&cloud.position);
            all.normal.extend_from_slice(&cloud.normal);
            all.radius.extend_from_slice(&cloud.radius);
            all.area.extend_from_slice(&cloud.area);
            all.radiosity.extend_from_slice(&cloud.radiosity);
            all.albedo.extend_from_slice(&cloud.albedo);
            all.emission.extend_from_slice(&cloud.emission);
            all.prim
                .extend(cloud.prim.iter().map(|prim| prim + first_prim));
            all.prim_paths.extend_from_slice(&cloud.prim_paths);
            let finer = all.spacing == 0.0 || (cloud.spacing > 0.0 && cloud.spacing < all.spacing);
            all.spacing = if finer { cloud.spacing } else { all.spacing };
        }
        all
    }

    /// The same without surfels that nothing is left of: they have no area.
    #[must_use]
    pub fn without_holes(self) -> Self {
        fn kept<T: Copy>(area: &[f32], column: Vec<T>) -> Vec<T> {
            let rows = area.iter().zip(column);
            rows.filter(|(area, _)| **area > 0.0)
                .map(|(_, value)| value)
                .collect()
        }
        if self.area.iter().all(|area| *area > 0.0) {
            return self;
        }
        let area = &self.area;
        Self {
            position: kept(area, self.position),
            normal: kept(area, self.normal),
            radius: kept(area, self.radius),
            radiosity: kept(area, self.radiosity),
            albedo: kept(area, self.albedo),
            emission: kept(area, self.emission),
            prim: kept(area, self.prim),
            area: kept(area, self.area.clone()),
            ..self
        }
    }

    /// The reflected part of the radiosity of surfel `i`: never negative.
    pub fn reflected(&self, i: usize) -> Vec3 {
        (self.radiosity[i] - self.emission[i]).max(Vec3::ZERO)
    }

    /// Total bytes held by the columns.
    pub fn bytes(&self) -> usize {
        self.len() * (5 * size_of::<Vec3>() + 2 * size_of::<f32>() + size_of::<u32>())
    }
}
