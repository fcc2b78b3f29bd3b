//! What the program tells about itself: completions for shells, manual pages. Both are made from the arguments.

use super::args::Cli;
use crate::writers::write_whole;
use anyhow::Context;
use clap::CommandFactory;
use std::io::Write;
use std::path::Path;

/// Write what `shell` has to know to stdout.
pub(super) fn completions(shell: clap_complete::Shell) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "surflux", &mut script);
    std::io::stdout()
        .write_all(&script)
        .context("the completions cannot be written to stdout")
}

/// Write `surflux.1` and a page for each command into `folder`.
pub(super) fn manual(folder: &Path) -> anyhow::Result<()> {
    if !folder.is_dir() {
        anyhow::bail!("{} is not a folder (create it first)", folder.display());
    }
    let mut program = Cli::command();
    program.build();
    page(folder, &program)?;
    let commands = program.get_subcommands();
    for command in commands.filter(|command| command.get_name() != "help") {
        page(folder, command)?;
    }
    Ok(())
}

fn page(folder: &Path, command: &clap::Command) -> anyhow::Result<()> {
    let manual = clap_mangen::Man::new(command.clone());
    let path = folder.join(manual.get_filename());
    let mut text = Vec::new();
    let wrong = || format!("{} cannot be written", path.display());
    manual.render(&mut text).with_context(wrong)?;
    write_whole(&path, &text).with_context(wrong)
}
