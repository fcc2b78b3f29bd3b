//! Results → files: EXR, PNG, primvar layers, clouds, pages. Each under a temporary name, then renamed.

mod base64;
pub mod image;
pub mod page;
pub mod usd;
mod whole;

pub use base64::{base64, from_base64};
pub use whole::{write_streamed, write_whole};
