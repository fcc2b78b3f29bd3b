//! What a user of the commands meets, end to end. One binary: each takes long to link.

#[allow(dead_code, reason = "every binary of tests uses some of the helpers")]
#[path = "../support/program.rs"]
mod program;
#[allow(dead_code, reason = "every binary of tests uses some of the helpers")]
#[path = "../support/python.rs"]
mod python;

mod cli;
mod habits;
mod needs;
mod recipes;
mod settings;
mod told;
mod validate;
