//! Kinds of light and of surfaces, end to end. One binary: each takes long to link.

#[allow(dead_code, reason = "every binary of tests uses some of the helpers")]
#[path = "../support/floors.rs"]
mod floors;
#[allow(dead_code, reason = "every binary of tests uses some of the helpers")]
#[path = "../support/program.rs"]
mod program;

mod displacement;
mod dome_links;
mod gloss;
mod light_groups;
mod mesh_links;
mod odd_lights;
mod opacity;
mod particles;
mod positions;
