//! Triangles in the shape in which maps draw them: sixteen to a block, each coordinate in a row.

use super::crowd::{LANES, Lanes};
use glam::Vec3;
use std::borrow::Cow;
use std::sync::OnceLock;

/// Sixteen triangles: `corners[corner][axis]`, relative to their shell's center. Lanes without a triangle hold a
/// single point, which covers nothing.
#[derive(Debug, Clone)]
pub(super) struct TriangleBlock {
    pub(super) corners: [[Lanes; 3]; 3],
}

impl TriangleBlock {
    const EMPTY: Self = Self {
        corners: [[[0.0; LANES]; 3]; 3],
    };

    fn of(positions: &[Vec3], triangles: &[[u32; 3]], center: Vec3) -> Self {
        let mut block = Self::EMPTY;
        for (lane, triangle) in triangles.iter().enumerate() {
            for (corner, &index) in block.corners.iter_mut().zip(triangle) {
                let position = positions[index as usize] - center;
                for (row, value) in corner.iter_mut().zip(position.to_array()) {
                    row[lane] = value;
                }
            }
        }
        block
    }
}

/// Triangles of one mesh, in object space.
#[derive(Debug)]
pub(super) struct Shell<'a> {
    /// Coordinates are relative to this point, so that they are as small as the mesh is.
    pub(super) center: Vec3,
    positions: Cow<'a, [Vec3]>,
    triangles: Cow<'a, [[u32; 3]]>,
    /// All of them in blocks, once that was asked for; before they are made again for each map.
    blocks: OnceLock<Vec<TriangleBlock>>,
}

/// Blocks made at once where they are not kept: half of the first cache.
const BLOCKS_AT_ONCE: usize = 32;

impl<'a> Shell<'a> {
    pub(super) fn new(
        positions: impl Into<Cow<'a, [Vec3]>>,
        triangles: impl Into<Cow<'a, [[u32; 3]]>>,
        center: Vec3,
    ) -> Self {
        Self {
            center,
            positions: positions.into(),
            triangles: triangles.into(),
            blocks: OnceLock::new(),
        }
    }

    /// Bytes that its blocks take if they are kept.
    pub(super) fn block_bytes(&self) -> usize {
        self.triangles.len().div_ceil(LANES) * size_of::<TriangleBlock>()
    }

    /// Keep all blocks from now on.
    pub(super) fn keep_blocks(&self) {
        let block = |triangles: &[_]| TriangleBlock::of(&self.positions, triangles, self.center);
        let blocks = || self.triangles.chunks(LANES).map(block).collect();
        self.blocks.get_or_init(blocks);
    }

    /// Call `work` with all blocks, some at a time.
    pub(super) fn for_each(&self, mut work: impl FnMut(&[TriangleBlock])) {
        if let Some(blocks) = self.blocks.get() {
            work(blocks);
            return;
        }
        let mut some = Vec::with_capacity(BLOCKS_AT_ONCE);
        for triangles in self.triangles.chunks(LANES * BLOCKS_AT_ONCE) {
            let blocks = triangles.chunks(LANES);
            some.clear();
            some.extend(blocks.map(|t| TriangleBlock::of(&self.positions, t, self.center)));
            work(&some);
        }
    }
}
