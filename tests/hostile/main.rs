//! Bad input through the built program: an error that names what is wrong, or a warning and a sensible result; never
//! a panic, a hang, a value that is not finite, or a rest of a file.
#![expect(clippy::print_stdout, reason = "the seed of a failure must be known")]

#[path = "../support/python.rs"]
mod python;

#[allow(dead_code, reason = "every test file uses some of the helpers")]
#[path = "../support/program.rs"]
mod program;

mod broken_files;
mod doors;
mod interrupts;
mod numbers;
mod outputs;
mod sizes;
mod trial;
