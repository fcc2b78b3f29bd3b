//! How a triangle is cut into micropolygons, and which surfel a point of it belongs to.

/// Finds the surfel of a point on a triangle in constant time.
#[derive(Debug, Clone, Default)]
pub struct DiceMap {}

impl DiceMap {
    /// Index of the surfel that covers barycentric `(u, v)` of `triangle` of prim `prim`, on the front or back side;
    /// `None` where that side was not diced (the inside of a closed mesh) or the triangle has no area.
    pub fn surfel_at(&self, prim: u32, triangle: u32, u: f32, v: f32, front: bool) -> Option<u32> {
        let _ = (prim, triangle, u, v, front);
        todo!("bake helper")
    }
}
