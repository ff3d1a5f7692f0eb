//! `nudge simulate`: worlds that produce transitions, sent as a game server sends them, written to
//! a file, or drawn.

mod ndjson;
mod observed;
mod options;
mod sending;

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

pub(super) use self::sending::{Moment, Pace, Run};
use super::Failure;
use super::lags::Lags;
use super::output::{cannot_write, count};
use super::progress::Progress;
use super::report::Report;
use super::server::Server;
use crate::error::Problem;
use crate::simulation::drawing;
use crate::simulation::hallway::Hallway as World;

/// Simulate a world and send what happens in it
#[derive(Debug, Subcommand)]
#[command(
    long_about = "Simulate a world and send what happens in it.\n\nExample:\n  nudge simulate hallway --trials 100"
)]
pub(super) enum Simulate {
    Hallway(Box<Hallway>),
}

/// Pedestrians who avoid each other in a hallway (the social force model)
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
#[command(
    long_about = "Simulate pedestrians who avoid each other in a hallway (Helbing and Molnar's social force model, 1995), and send what \
    they do to a service as a game server would: each pedestrian and its two closest neighbours, every 0.2 s.\n\n\
    The environment is made if it is missing (examples/hallway.json). A trial is a segment, seed-0.trial-1: give another hallway \
    an environment of its own. The producer is named after the parameters and the \
    seed, so a second run changes nothing, a run that was interrupted goes on where it stopped, and a run of more trials goes on behind it.\n\n\
    Example:\n  nudge simulate hallway --preset 30x6 --trials 100 --seed 7\n  \
    nudge simulate hallway --pace real-time --trials 1\n  \
    nudge simulate hallway --out hallway.ndjson\n  \
    nudge simulate hallway --pedestrians 20 --svg trial-3.svg --trial 3"
)]
pub(super) struct Hallway {
    #[command(flatten)]
    options: options::Options,
    #[command(flatten)]
    server: Server,
    /// Name of the environment
    #[arg(long, default_value = "hallway")]
    environment: String,
    /// Lags at which what both do later is sent too: none, 1..12 or 1,2,3, in steps of a record
    #[arg(long, default_value_t)]
    lags: Lags,
    /// How fast simulated time passes
    #[arg(long, value_enum, default_value_t = Pace::Fast)]
    pace: Pace,
    /// Write transitions to a file in place of sending them, one a line as REST takes them; - is
    /// standard output
    #[arg(long, value_name = "FILE", conflicts_with_all = ["svg", "json"])]
    out: Option<PathBuf>,
    /// Draw one trial to a file in place of sending any
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    svg: Option<PathBuf>,
    /// The trial that is drawn
    #[arg(long, value_name = "NUMBER", default_value_t = 1, requires = "svg", value_parser = clap::value_parser!(u32).range(1..))]
    trial: u32,
    /// The time at which pedestrians are drawn; when most of them meet unless given
    #[arg(long, value_name = "SECONDS", requires = "svg")]
    at: Option<f64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Simulate {
    pub(super) async fn run(self) -> Result<(), Failure> {
        match self {
            Self::Hallway(command) => command.run().await,
        }
    }
}

impl Hallway {
    async fn run(self) -> Result<(), Failure> {
        let world = self.options.hallway()?;
        match (&self.svg, &self.out) {
            (Some(file), _) => self.draw(&world, file),
            (_, Some(file)) => ndjson::write(&world, file, &self.lags),
            (None, None) => self.send(world).await,
        }
    }

    async fn send(self, hallway: World) -> Result<(), Failure> {
        let connection = self.server.connect().await?;
        let (name, another) = (&self.environment, "--environment NAME");
        self.lags.check(&connection, name, another).await?;
        let progress = Progress::new(u64::from(hallway.protocol().trials));
        let run = Run {
            hallway,
            environment: self.environment,
            lags: self.lags,
            pace: self.pace,
        };

        let totals = run
            .send(&connection, |moment| show(&progress, moment))
            .await?;
        progress.part_done(&run.environment, totals.sent);
        progress.finish();
        let mut report = Report::default();
        report.add(run.environment, totals);
        report.print(self.json)
    }

    fn draw(&self, world: &World, file: &Path) -> Result<(), Failure> {
        let svg = drawing::svg(world, self.trial, self.at).map_err(|fault| {
            Failure::from(Problem::invalid("drawing", vec![options::by_flag(fault)]))
        })?;
        std::fs::write(file, svg).map_err(|error| cannot_write(file, &error))
    }
}

fn show(progress: &Progress, moment: Moment) {
    let Moment {
        trial,
        time,
        transitions,
    } = moment;
    progress.part(&format!(
        "trial {trial} at {time:.0} s: {} transitions",
        count(transitions)
    ));
    progress.at(u64::from(trial) - 1);
}
