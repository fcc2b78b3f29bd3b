//! A job whose settings the stage may have a say in: the stage is opened, asked, and handed on to the job.

use super::args::{Cli, Command, JobCommand};
use super::job::{self, SettingsChoice};
use super::layers::{self, Opinion, Resolved};
use super::{Failure, usage};
use crate::diagnostics::{CancelToken, Diagnostics, Silent};
use crate::pipeline::Job;
use crate::stage::bake_settings::{self, BakeSettingsPrim};
use crate::stage::{self, Source};
use anyhow::anyhow;
use clap::{ArgMatches, FromArgMatches};
use std::ffi::OsString;

/// A command line that is resolved but for what the stage says.
#[derive(Debug)]
pub(super) struct Asked<'a> {
    /// All commands, built.
    pub(super) program: &'a mut clap::Command,
    /// The words.
    pub(super) argv: &'a [OsString],
    /// What they and variables mean.
    pub(super) typed: &'a ArgMatches,
    /// What the configuration file says.
    pub(super) config: &'a [&'a [Opinion]],
    /// Who may end it.
    pub(super) cancel: &'a CancelToken,
}

/// A job with all its settings.
#[derive(Debug)]
pub(super) struct Shot {
    /// The job, or why there is none.
    pub(super) job: anyhow::Result<Job>,
    /// Its stage, where it had to be opened.
    pub(super) source: Option<Box<dyn Source>>,
    /// All flags.
    pub(super) resolved: Resolved,
}

impl Asked<'_> {
    /// `resolved` and `command` are what typed words, variables and the configuration file say.
    ///
    /// # Errors
    /// A stage that cannot be read, or says what no flag takes. What is wrong with the command line comes first.
    pub(super) fn resolve(self, command: JobCommand, resolved: Resolved) -> Result<Shot, Failure> {
        let words = self.argv.iter();
        let words: Vec<String> = words
            .map(|word| word.to_string_lossy().into_owned())
            .collect();
        let asked = command
            .settings()
            .map(|choice| prim_of(&command, choice, self.cancel));
        let (source, prim) = match asked {
            None => (None, None),
            Some(Ok((source, prim))) => (Some(source), prim),
            Some(Err(error)) => {
                job::from_args(command, &words).map_err(usage)?;
                return Err(anyhow::Error::from(error).into());
            }
        };
        let Some(prim) = prim else {
            return Ok(Shot {
                job: job::from_args(command, &words),
                source,
                resolved,
            });
        };
        let path = command.stage().stage.display().to_string();
        let stage = opinions(&prim, &path);
        let layers: Vec<&[Opinion]> = [&stage[..]]
            .into_iter()
            .chain(self.config.iter().copied())
            .collect();
        let resolved = layers::resolve(self.program, self.argv, self.typed, &layers)?;
        let meant = Cli::from_arg_matches(&resolved.matches).map_err(anyhow::Error::from)?;
        let Command::Job(command) = meant.command else {
            return Err(anyhow!("settings of the stage cannot change the command").into());
        };
        let job = job::from_args(command, &words).map(|mut job| {
            if let Some(stage) = job.lit_stage_mut() {
                stage.settings = Some(prim.path);
            }
            job
        });
        Ok(Shot {
            job,
            source,
            resolved,
        })
    }
}

type Opened = (Box<dyn Source>, Option<BakeSettingsPrim>);

fn prim_of(
    command: &JobCommand,
    choice: SettingsChoice<'_>,
    cancel: &CancelToken,
) -> Result<Opened, stage::Error> {
    let diagnostics = Diagnostics::new(Box::new(Silent), cancel.clone());
    let (path, door, composition) = job::stage_of(command);
    let mut source = stage::open(path, door, &diagnostics)?;
    let wanted = match choice {
        SettingsChoice::OfStage => None,
        SettingsChoice::At(path) => Some(path),
    };
    let prim = bake_settings::read(source.as_mut(), &composition, wanted, &diagnostics)?;
    Ok((source, prim))
}

fn opinions(prim: &BakeSettingsPrim, stage: &str) -> Vec<Opinion> {
    let settings = prim.settings.iter();
    let opinion = |setting: &bake_settings::Setting| Opinion {
        flag: setting.flag.clone(),
        values: setting.values.clone(),
        place: format!("{stage}: {}", setting.attribute),
    };
    settings.map(opinion).collect()
}
