//! The command line: a file a command. Each reads its arguments, calls one room, and prints;
//! nothing is decided here.
//!
//! Results go to standard output, everything else to standard error. Exit code 0: done; 1: the
//! service refused, or rejected something; 2: the command cannot be done as it was given (a wrong
//! flag, no such file, no service there); 130: a signal ended what it waited for.

mod addresses;
mod answers;
mod asking;
mod card;
mod check;
mod config;
mod demo;
mod duration;
mod env;
mod experiment;
mod failure;
mod graph;
mod health;
mod ingest;
mod key;
mod lags;
mod making;
mod model;
mod output;
mod profile;
mod progress;
mod query;
mod region;
mod regions;
mod report;
mod serve;
mod server;
mod signals;
mod simulate;
mod track;
mod train;
mod twin;

use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

pub use failure::Failure;

use crate::access::redacted;

/// Tells when one agent's action influences another's
#[derive(Debug, Parser)]
#[command(
    name = "nudge",
    version = env!("NUDGE_VERSION"),
    long_about = "Tells when one agent's action influences another's: in this state, how strongly, how sure, and which actions do it.\n\n\
        A first look, with a service running (`nudge serve`):\n  \
        nudge ingest --format overcooked data/overcooked/train.csv.gz\n  \
        nudge query cramped_room --lag 3 --state player_0.x=1 player_0.y=1 player_0.orientation=N player_0.held=nothing \
        player_1.x=3 player_1.y=1 player_1.orientation=S player_1.held=onion"
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// A comment on a variant would replace the help of the command's own type, so there is none.
#[derive(Debug, Subcommand)]
enum Command {
    Serve(Box<serve::Serve>),
    Demo(demo::Demo),
    #[command(subcommand)]
    Env(env::Env),
    Ingest(ingest::Ingest),
    Query(Box<query::Query>),
    Regions(Box<regions::Regions>),
    Train(train::Train),
    #[command(subcommand)]
    Model(model::Model),
    #[command(subcommand)]
    Simulate(simulate::Simulate),
    #[command(subcommand)]
    Experiment(experiment::Experiment),
    Check(check::Check),
    #[command(subcommand)]
    Key(key::Command),
    Health(health::Health),
}

/// Reads the arguments of the process, does what they say, and returns the exit code.
pub fn run() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => return unread(&error),
        // Help, and the version.
        Err(told) => told.exit(),
    };
    match execute(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

/// Tells what is wrong with the arguments or the variables, in which a secret may stand by mistake.
fn unread(error: &clap::Error) -> ExitCode {
    // Where standard error is closed nobody is left to tell.
    let _ = write!(
        std::io::stderr(),
        "{}",
        redacted(&error.render().to_string())
    );
    ExitCode::from(2)
}

fn execute(cli: Cli) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build();
    let runtime =
        runtime.map_err(|error| Failure::usage(format!("cannot start threads: {error}")))?;
    let done = runtime.block_on(async {
        match cli.command {
            Command::Serve(command) => command.run().await,
            Command::Demo(command) => command.run().await,
            Command::Env(command) => command.run().await,
            Command::Ingest(command) => command.run().await,
            Command::Query(command) => command.run().await,
            Command::Regions(command) => command.run().await,
            Command::Train(command) => command.run().await,
            Command::Model(command) => command.run().await,
            Command::Simulate(command) => command.run().await,
            Command::Experiment(command) => command.run().await,
            Command::Check(command) => command.run().await,
            Command::Key(command) => command.run(),
            Command::Health(command) => command.run().await,
        }
    });

    // Whatever still computes has nobody left to tell: the command is over, and all that it
    // promised is done.
    runtime.shutdown_background();
    done
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_arguments_do_not_contradict_each_other() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_command_teaches_by_an_example() {
        let cli = Cli::command();
        let nested =
            |command: &clap::Command| command.get_subcommands().cloned().collect::<Vec<_>>();
        for command in nested(&cli)
            .iter()
            .flat_map(|command| [vec![command.clone()], nested(command)].concat())
        {
            let help = command
                .get_long_about()
                .map(ToString::to_string)
                .unwrap_or_default();
            assert!(
                help.contains("\n  nudge "),
                "{} has no example",
                command.get_name()
            );
        }
    }
}
