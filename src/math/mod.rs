//! Geometry and light arithmetic without state: bounds, frames, solid angles, harmonics, direction sequences.

pub mod bits;
pub mod bounds;
pub mod frame;
pub mod packing;
pub mod parts;
pub mod sequence;
pub mod sh;
pub mod solid_angle;
pub mod srgb;

pub use bounds::Bounds3;
pub use frame::Frame;

use glam::Vec3;

/// Relative luminance of a linear Rec.709 color.
pub fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}
