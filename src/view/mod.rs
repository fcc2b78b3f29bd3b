//! A cloud or a baked stage → something to look at: a picture (PNG), or a page (HTML) that opens from disk.
//!
//! Both show a [`Subject`]: disks or triangles with one value of every channel each. What the channels of a file become:
//!
//! | channel | shown as |
//! |---|---|
//! | three numbers typed as colors | those colors, exposed so that few of them clip, encoded as sRGB |
//! | one number | false color between two ends, with a scale bar |
//! | directions | `0.5 n + 0.5` |
//! | whole numbers | a hue each |

mod channels;
mod colors;
mod glyphs;
mod page;
mod picture;
mod raster;
mod subject;

pub use channels::{Channel, ChannelKind};
pub use page::page;
pub use picture::{PictureSettings, picture};
pub use subject::{Shape, Subject};

/// Name of the channel of shading normals that every subject with normals has.
pub const NORMAL_CHANNEL: &str = "N";
