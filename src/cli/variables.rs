//! Flags as environment variables: `--image-width` of every command is `SURFLUX_IMAGE_WIDTH` too. What is typed wins.

use super::args::Cli;
use clap::builder::BoolishValueParser;
use clap::{Arg, ArgAction, Command, CommandFactory};

/// What every variable begins with.
const PREFIX: &str = "SURFLUX_";

/// The command line, with a variable for every flag. Of switches, `1`, `true`, `yes` and `on` mean that they are there.
pub(super) fn command() -> Command {
    let program = Cli::command();
    let commands = program.get_subcommands();
    let names: Vec<String> = commands
        .map(|command| command.get_name().to_owned())
        .collect();
    names.into_iter().fold(program, |program, name| {
        program.mut_subcommand(name, |command| command.mut_args(with_variable))
    })
}

fn with_variable(flag: Arg) -> Arg {
    let Some(long) = flag.get_long() else {
        return flag;
    };
    let name = PREFIX.to_owned() + &long.to_uppercase().replace('-', "_");
    // clap keeps names for as long as the program runs; there is one for each flag
    let name: &'static str = name.leak();
    let flag = match flag.get_action() {
        ArgAction::Help | ArgAction::HelpLong | ArgAction::HelpShort | ArgAction::Version => {
            return flag;
        }
        ArgAction::SetTrue => flag.value_parser(BoolishValueParser::new()),
        _ => flag,
    };
    flag.env(name).hide_env(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flag_has_a_variable_of_its_own_name() {
        let mut program = command();
        program.build();
        let render = program.find_subcommand("render").unwrap();
        let variable = |id: &str| {
            let flag = render.get_arguments().find(|arg| arg.get_id() == id);
            flag.and_then(Arg::get_env).map(|name| name.to_owned())
        };
        assert_eq!(variable("image_width").unwrap(), "SURFLUX_IMAGE_WIDTH");
        assert_eq!(variable("json").unwrap(), "SURFLUX_JSON");
        assert_eq!(variable("usd").unwrap(), "SURFLUX_USD");
        assert_eq!(variable("stage"), None);
        assert_eq!(variable("help"), None);
        command().debug_assert();
    }
}
