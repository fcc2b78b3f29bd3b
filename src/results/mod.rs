//! What a gather delivers: one buffer an AOV, one value a receiver, and where the values go.

pub mod aov;
pub mod resolve;

pub use aov::{Aov, ValueType};
pub use resolve::{AovImage, resolve};

use crate::scene::PrimId;
use std::borrow::Cow;
use std::sync::Arc;

/// Values of one AOV, one a receiver, `components` floats each, in receiver order.
#[derive(Debug, Clone, PartialEq)]
pub struct AovBuffer {
    /// Which AOV.
    pub aov: Aov,
    /// `receiver_count * aov.components()` finite values.
    pub data: Vec<f32>,
}

/// All AOVs of a run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Results {
    /// In the order asked for.
    pub buffers: Vec<AovBuffer>,
    /// The same of parts of the light, where light groups are told apart.
    pub groups: Vec<GroupResults>,
}

/// What one group of lights makes of AOVs that are sums over lights.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupResults {
    /// Name of the group.
    pub name: Arc<str>,
    /// In the order asked for.
    pub buffers: Vec<AovBuffer>,
}

/// What `name` of an AOV or of a component of it is called on disk where it holds the light of `group`.
pub fn name_of_group(name: &'static str, group: Option<&str>) -> Cow<'static, str> {
    match group {
        None => Cow::Borrowed(name),
        Some(group) => Cow::Owned(format!("{name}_{group}")),
    }
}

impl Results {
    /// The buffer of `aov`, if it was computed.
    pub fn get(&self, aov: Aov) -> Option<&AovBuffer> {
        self.buffers.iter().find(|buffer| buffer.aov == aov)
    }

    /// The values of the receivers `picked`, in that order, without how they were laid out.
    ///
    /// # Panics
    /// If an index is not one of a receiver.
    #[must_use]
    pub fn subset(&self, picked: &[usize]) -> Self {
        let few = |buffer: &AovBuffer| {
            let n = buffer.aov.components();
            let values = picked.iter().flat_map(|&i| &buffer.data[i * n..][..n]);
            AovBuffer {
                aov: buffer.aov,
                data: values.copied().collect(),
            }
        };
        Self {
            buffers: self.buffers.iter().map(few).collect(),
            ..Self::default()
        }
    }

    /// The same buffers in the order of `aovs`.
    #[must_use]
    pub fn in_order_of(mut self, aovs: &[Aov]) -> Self {
        let place = |buffer: &AovBuffer| aovs.iter().position(|&aov| aov == buffer.aov);
        self.buffers.sort_by_key(place);
        self
    }
}

/// Interpolation of a baked primvar on the authored mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BakeInterpolation {
    /// One value a point of the cage.
    #[default]
    Vertex,
    /// One value a face-vertex of the cage.
    FaceVarying,
}

/// Values of one prim within the receivers' order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PrimvarSpan {
    /// The prim.
    pub prim: PrimId,
    /// Layout on the prim.
    pub interpolation: BakeInterpolation,
    /// For each point (or face-vertex) of the prim's cage, the receiver that holds its value (several face-vertices
    /// may share one). Length = point count or face-vertex count.
    pub receiver_of_value: Vec<u32>,
}

/// One receiver's share in one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelShare {
    /// Pixel index, `y * width + x`, rows from the top.
    pub pixel: u32,
    /// Receiver index.
    pub receiver: u32,
    /// Share of the pixel's samples that this receiver stands for, 0…1. The shares of a pixel sum to its coverage.
    pub weight: f32,
}

/// Where the values of a run go.
#[derive(Debug, Clone, PartialEq)]
pub enum Target {
    /// An image.
    Image {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// Sorted by pixel; pixels that see nothing have no entry.
        shares: Vec<PixelShare>,
    },
    /// Primvars on meshes.
    Primvars(Vec<PrimvarSpan>),
    /// One value a surfel of a cloud, in its order.
    Surfels,
}
