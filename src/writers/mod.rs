//! Results → files: EXR, PNG, primvar layers, clouds. Each under a temporary name, then renamed.

pub mod image;
pub mod usd;
mod whole;

pub use whole::write_whole;
