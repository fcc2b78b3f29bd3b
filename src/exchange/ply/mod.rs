//! PLY ↔ points: ascii, binary little and big endian.
//!
//! | a point's | PLY properties |
//! |---|---|
//! | position | `x y z`; `double` when written with an origin off 0 |
//! | normal | `nx ny nz` |
//! | radius | `radius` (read: also `pscale`, and `width` or `widths` halved) |
//! | `displayColor` | `red green blue` as uchar sRGB, what every viewer shows, and `displayColor_r _g _b` as linear floats |
//! | other colors | `NAME_r NAME_g NAME_b`, linear |
//! | other vectors | `NAME_x NAME_y NAME_z` |
//! | numbers | `NAME` |
//!
//! Read, linear floats win over `red green blue`. Up axis and units are in a comment of surflux's own; files without it
//! are +Y up, a meter a unit, unless the caller says otherwise.
//!
//! An own reader: columns are not known when the program is built. For 2 M rows of 10 numbers in memory `ply-rs-bw` 4.0 takes
//! 7.1 s with its maps and 0.26 s with names looked up a number, `serde-ply` 0.2 0.11 s with a struct, columns 0.06 s.

mod header;
mod read;
pub mod splats;
mod table;
mod write;

pub use read::read;
pub use write::{Encoding, write};

/// Start of the comment that says what PLY has no word for.
const ABOUT: &str = "surflux: upAxis ";
