//! Settings that are not typed: what a `--config` file and the stage say, what is told by `--print-config`.

use super::layers::Opinion;
use anyhow::{Context, bail};
use clap::{Arg, ArgAction, ArgMatches, Command, parser::ValueSource};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// Flags about the settings themselves.
const NOT_SETTINGS: [&str; 4] = ["config", "print-config", "help", "version"];

/// What the configuration file at `path` says to `command` of `program`: flags of the whole file first, then those of the
/// command alone.
///
/// # Errors
/// When it cannot be read, is no JSON object, or names what no command has.
pub(super) fn read(
    path: &Path,
    program: &Command,
    command: &str,
) -> anyhow::Result<[Vec<Opinion>; 2]> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read --config {}", path.display()))?;
    let all: Map<String, Value> = serde_json::from_str(&text)
        .with_context(|| format!("--config {} is no JSON object", path.display()))?;
    let (mut everywhere, mut here) = (Vec::new(), Vec::new());
    for (name, value) in &all {
        let place = format!("{}: {name}", path.display());
        if name == "$schema" {
            continue;
        }
        let Some(of) = program.find_subcommand(name) else {
            let mut commands = program.get_subcommands();
            if !commands.any(|command| has_flag(command, name)) {
                bail!("{place}: no command has a flag --{name}");
            }
            if program
                .find_subcommand(command)
                .is_some_and(|command| has_flag(command, name))
            {
                everywhere.extend(opinion(name, value, &place)?);
            }
            continue;
        };
        let flags = value.as_object();
        let flags = flags.with_context(|| format!("{place}: an object of flags is needed"))?;
        for (name, value) in flags {
            let place = format!("{place}.{name}");
            if !has_flag(of, name) {
                bail!("{place}: {} has no flag --{name}", of.get_name());
            }
            if of.get_name() == command {
                here.extend(opinion(name, value, &place)?);
            }
        }
    }
    Ok([here, everywhere])
}

fn has_flag(command: &Command, name: &str) -> bool {
    let mut flags = settings(command);
    flags.any(|flag| flag.get_long() == Some(name))
}

/// The flags of `command` that are settings.
fn settings(command: &Command) -> impl Iterator<Item = &Arg> {
    let flags = command.get_arguments();
    flags.filter(|flag| {
        flag.get_long()
            .is_some_and(|long| !NOT_SETTINGS.contains(&long))
    })
}

/// `value` as typed; `None` for null. An object is what `--print-config` tells.
fn opinion(flag: &str, value: &Value, place: &str) -> anyhow::Result<Option<Opinion>> {
    let value = match value {
        Value::Object(told) => told.get("value").with_context(|| {
            format!("{place}: a value is needed, or an object with one, as --print-config tells it")
        })?,
        value => value,
    };
    let text = |value: &Value| match value {
        Value::String(text) => Ok(text.clone()),
        Value::Bool(_) | Value::Number(_) => Ok(value.to_string()),
        _ => bail!("{place}: text, a number, true, false, or a list of those is needed"),
    };
    let values = match value {
        Value::Null => return Ok(None),
        Value::Array(values) => values.iter().map(text).collect::<Result<_, _>>()?,
        value => vec![text(value)?],
    };
    Ok(Some(Opinion {
        flag: flag.to_owned(),
        values,
        place: place.to_owned(),
    }))
}

/// Every setting of `command` as JSON, one a line: its value (null: the command decides) and where it comes from.
/// `places` tells of those that were neither typed nor variables.
pub(super) fn told(
    command: &Command,
    matches: &ArgMatches,
    places: &BTreeMap<String, String>,
) -> String {
    let lines = settings(command).map(|flag| {
        let long = flag.get_long().unwrap_or_default();
        let from = match (
            places.get(long),
            matches.value_source(flag.get_id().as_str()),
        ) {
            (Some(place), _) => place.clone(),
            (None, Some(ValueSource::CommandLine)) => "typed".to_owned(),
            (None, Some(ValueSource::EnvVariable)) => {
                let variable = flag.get_env().unwrap_or_default();
                variable.to_string_lossy().into_owned()
            }
            (None, Some(_)) => "default".to_owned(),
            (None, None) => "not set".to_owned(),
        };
        let setting = json!({"value": value(flag, matches), "from": from});
        format!("    {}: {setting}", Value::from(long))
    });
    let lines: Vec<String> = lines.collect();
    format!(
        "{{\n  {}: {{\n{}\n  }}\n}}",
        Value::from(command.get_name()),
        lines.join(",\n")
    )
}

fn value(flag: &Arg, matches: &ArgMatches) -> Value {
    let id = flag.get_id().as_str();
    match flag.get_action() {
        ArgAction::SetTrue => return json!(matches.get_flag(id)),
        ArgAction::Count => return json!(matches.get_count(id)),
        _ => {}
    }
    let Some(values) = matches.get_raw(id) else {
        return Value::Null;
    };
    let mut values: Vec<Value> = values
        .map(|text| json_of(&text.to_string_lossy()))
        .collect();
    let is_list =
        matches!(flag.get_action(), ArgAction::Append) || flag.get_value_delimiter().is_some();
    match values.len() {
        1 if !is_list => values.remove(0),
        _ => Value::Array(values),
    }
}

/// `text` as a number where it is spelled as JSON would spell it.
fn json_of(text: &str) -> Value {
    match serde_json::from_str::<Value>(text) {
        Ok(Value::Number(number)) if is_spelled(&number, text) => Value::Number(number),
        _ => Value::from(text),
    }
}

fn is_spelled(number: &serde_json::Number, text: &str) -> bool {
    let spelled = number.to_string();
    spelled == text
}
