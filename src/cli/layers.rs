//! Layers of settings → one command line: what is typed, then variables, then what weaker layers say of flags that are in
//! neither. What they say is checked as if it had been typed.

use anyhow::{anyhow, bail};
use clap::{Arg, ArgAction, ArgMatches, Command, parser::ValueSource};
use std::collections::BTreeMap;
use std::ffi::OsString;

/// What somebody else than the command line says of a flag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Opinion {
    /// The flag, without dashes.
    pub(super) flag: String,
    /// Values as typed; switches have `true` or `false`.
    pub(super) values: Vec<String>,
    /// Who says so.
    pub(super) place: String,
}

/// A command line with all that counts.
#[derive(Debug)]
pub(super) struct Resolved {
    /// All flags.
    pub(super) matches: ArgMatches,
    /// Flags that a layer said something of that counts, and who.
    pub(super) places: BTreeMap<String, String>,
}

/// An opinion that counts, as words of a command line.
struct Heard<'a> {
    opinion: &'a Opinion,
    words: Vec<OsString>,
}

/// `typed` (what `program` made of `argv`) with what `layers`, strongest first, say of flags that are not there, and that
/// do not contradict what is. Layers may tell of flags that the command does not have.
///
/// # Errors
/// Values that the command does not take, with their place.
pub(super) fn resolve(
    program: &mut Command,
    argv: &[OsString],
    typed: &ArgMatches,
    layers: &[&[Opinion]],
) -> anyhow::Result<Resolved> {
    let (name, given) = typed
        .subcommand()
        .unwrap_or_else(|| unreachable!("a command is required"));
    let command = program.find_subcommand(name);
    let command = command.unwrap_or_else(|| unreachable!("it was found before"));
    let mut taken: Vec<&Arg> = command
        .get_arguments()
        .filter(|arg| is_given(given, arg))
        .collect();
    let heard = hear(command, &mut taken, layers)?;
    let line = |heard: &[Heard<'_>]| {
        let added = heard.iter().flat_map(|heard| &heard.words);
        let (start, rest) = argv.split_at(argv.len().min(2));
        start
            .iter()
            .chain(added)
            .chain(rest)
            .cloned()
            .collect::<Vec<_>>()
    };
    let places = heard.iter();
    let places = places.map(|heard| (heard.opinion.flag.clone(), heard.opinion.place.clone()));
    let places = places.collect();
    let whole = line(&heard);
    let lines: Vec<_> = heard
        .iter()
        .map(|one| (one.opinion, line(std::slice::from_ref(one))))
        .collect();
    match program.try_get_matches_from_mut(whole) {
        Ok(matches) => Ok(Resolved { matches, places }),
        Err(error) => {
            for (opinion, line) in lines {
                if let Err(error) = program.try_get_matches_from_mut(line) {
                    bail!("{}: {}", opinion.place, first_lines(&error));
                }
            }
            let all: Vec<&str> = layers
                .iter()
                .copied()
                .flatten()
                .map(|one| &*one.place)
                .collect();
            Err(anyhow!("{} ({})", first_lines(&error), all.join(", ")))
        }
    }
}

/// What counts of `layers`, strongest first, beside flags that are `taken`, which it adds to.
fn hear<'c, 'o>(
    command: &'c Command,
    taken: &mut Vec<&'c Arg>,
    layers: &[&'o [Opinion]],
) -> anyhow::Result<Vec<Heard<'o>>> {
    let mut heard: Vec<Heard<'o>> = Vec::new();
    for layer in layers {
        let mut adds: Vec<&'c Arg> = Vec::new();
        for opinion in *layer {
            let mut flags = command.get_arguments();
            let Some(flag) = flags.find(|flag| flag.get_long() == Some(&opinion.flag)) else {
                continue;
            };
            if taken.iter().any(|other| excludes(command, flag, other)) {
                continue;
            }
            heard.push(Heard {
                opinion,
                words: words(flag, opinion)?,
            });
            adds.push(flag);
        }
        taken.extend(adds);
    }
    Ok(heard)
}

fn is_given(matches: &ArgMatches, arg: &Arg) -> bool {
    matches!(
        matches.value_source(arg.get_id().as_str()),
        Some(ValueSource::CommandLine | ValueSource::EnvVariable)
    )
}

/// True if `flag` has no say where `other` is given.
fn excludes(command: &Command, flag: &Arg, other: &Arg) -> bool {
    let names = |one: &Arg, two: &Arg| {
        let mut conflicts = command.get_arg_conflicts_with(one).into_iter();
        conflicts.any(|conflict| conflict.get_id() == two.get_id())
    };
    flag.get_id() == other.get_id() || names(flag, other) || names(other, flag)
}

fn words(flag: &Arg, opinion: &Opinion) -> anyhow::Result<Vec<OsString>> {
    let Opinion {
        flag: long,
        values,
        place,
    } = opinion;
    let once = || OsString::from(format!("--{long}"));
    Ok(match (flag.get_action(), values.as_slice()) {
        (ArgAction::SetTrue, [value]) if value == "true" => vec![once()],
        (ArgAction::SetTrue, [value]) if value == "false" => Vec::new(),
        (ArgAction::SetTrue, _) => bail!("{place}: true or false is needed"),
        (ArgAction::Count, [value]) => match value.parse::<u8>() {
            Ok(count) => vec![once(); usize::from(count)],
            Err(_) => bail!("{place}: a small number is needed"),
        },
        (ArgAction::Count, _) => bail!("{place}: one number is needed"),
        (_, values) => values
            .iter()
            .map(|value| format!("--{long}={value}").into())
            .collect(),
    })
}

/// What clap says, without the advice of a command line.
fn first_lines(error: &clap::Error) -> String {
    let text = error.to_string();
    let lines = text.lines().take_while(|line| !line.trim().is_empty());
    let lines: Vec<&str> = lines.map(str::trim).collect();
    let text = lines.join(" ");
    text.strip_prefix("error: ").unwrap_or(&text).to_owned()
}

#[cfg(test)]
mod tests {
    use super::super::variables;
    use super::*;

    fn opinion(flag: &str, value: &str) -> Opinion {
        Opinion {
            flag: flag.to_owned(),
            values: vec![value.to_owned()],
            place: format!("stage.{flag}"),
        }
    }

    fn resolved(typed: &[&str], layers: &[&[Opinion]]) -> anyhow::Result<Resolved> {
        let mut program = variables::command();
        program.build();
        let argv: Vec<OsString> = typed.iter().map(OsString::from).collect();
        let matches = program.try_get_matches_from_mut(&argv)?;
        resolve(&mut program, &argv, &matches, layers)
    }

    #[test]
    fn what_is_typed_wins_and_weaker_layers_fill_in() {
        let strong = [
            opinion("rays", "64"),
            opinion("preview", "true"),
            opinion("map-cell", "2"),
        ];
        let weak = [
            opinion("rays", "99"),
            opinion("pixel-samples", "2"),
            opinion("spacing", "1"),
        ];
        let line = [
            "surflux",
            "render",
            "a.usda",
            "--map-cell",
            "3",
            "--surfels",
            "9",
        ];
        let done = resolved(&line, &[&strong, &weak]).unwrap();
        let (_, flags) = done.matches.subcommand().unwrap();
        assert_eq!(flags.get_one::<u32>("rays"), Some(&64));
        assert_eq!(flags.get_one::<u32>("pixel_samples"), Some(&2));
        assert_eq!(flags.get_one::<f32>("map_cell"), Some(&3.0));
        assert_eq!(flags.get_one::<f32>("spacing"), None, "surfels are typed");
        assert!(flags.get_flag("preview"));
        let places: Vec<&str> = done.places.keys().map(|name| &**name).collect();
        assert_eq!(places, ["pixel-samples", "preview", "rays"]);
    }

    #[test]
    fn a_value_out_of_range_is_told_with_its_place() {
        let layer = [opinion("surfels", "5"), opinion("rays", "3")];
        let wrong = resolved(&["surflux", "bake", "a.usda"], &[&layer]).unwrap_err();
        let wrong = wrong.to_string();
        assert!(
            wrong.starts_with("stage.rays: invalid value '3'"),
            "{wrong}"
        );
    }
}
