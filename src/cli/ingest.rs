//! `nudge ingest`: recorded play, sent so that every transition counts once however often the
//! command is run.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::Failure;
use super::lags::Lags;
use super::making::make;
use super::progress::Progress;
pub(super) use super::report::Report;
use super::server::Server;
use super::track::send_track;
use super::twin::{Twin, TwinArguments};
use crate::client::{Connection, Step, Totals};
use crate::domain::Schema;
use crate::domain::draft::DescriptionDraft;
use crate::recordings::overcooked::{self, Abstraction, Game, Kitchen, World};

/// What is part of every producer id: another way to cut the same file into batches must take
/// another.
const WAY: &str = "overcooked.1";

/// Transitions of a batch; see [`WAY`].
const BATCH_SIZE: usize = 1_000;

/// Send recorded play to a service, each transition once
#[derive(Debug, Args)]
#[command(
    long_about = "Send recorded play to a service, each transition once.\n\n\
    Environments that are missing are made, one a layout: counter_circuit, or counter_circuit.pos for another abstraction \
    than the usual one. A trial is a segment. The producer is named after the file's content, so a second run \
    changes nothing, and a run that was interrupted goes on where it stopped. With --twin the same games are sent without influence, to hold \
    what is found in the others against: into environments of their own, counter_circuit.shifted.\n\n\
    Example:\n  nudge ingest --format overcooked data/overcooked/train.csv.gz data/overcooked/test.csv.gz\n  \
    nudge ingest --format overcooked train.csv --abstraction pos --lags none\n  \
    nudge ingest --format overcooked train.csv --twin shifted --seed 7"
)]
pub(super) struct Ingest {
    /// Files to send, gzipped or not
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// What the files are
    #[arg(long, value_enum)]
    format: Format,
    /// How much of the state is kept: pos, pos_ori, pos_ori_held or pos_ori_held_pot
    #[arg(long, default_value_t)]
    abstraction: Abstraction,
    /// Lags at which what both players do later is sent too, with what each holds one step later:
    /// none, 1..12 or 1,2,3. Without any, a player's place is a label, as it was before there were
    /// lags
    #[arg(long, default_value_t)]
    lags: Lags,
    /// Begins the names of the environments: kitchens.counter_circuit
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    #[command(flatten)]
    twin: TwinArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

/// What a file is.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// Games of Overcooked: layout, trial, t, state, action0, action1
    Overcooked,
}

/// The games of one file on one layout.
#[derive(Clone)]
pub(super) struct Part {
    world: World,
    environment: String,
    games: Vec<Game>,
    producer: String,
    /// The file that it is from.
    file: String,
    /// What is sent in the place of what was played.
    twin: Option<Twin>,
}

impl Ingest {
    pub(super) async fn run(self) -> Result<(), Failure> {
        let Format::Overcooked = self.format;
        // Every file is read before the first is sent, so a mistake in the last one costs nothing.
        let mut parts = Vec::new();
        for file in &self.files {
            let name = file.display().to_string();
            let bytes = std::fs::read(file)
                .map_err(|error| Failure::usage(format!("cannot read {name}: {error}")))?;
            let found = parts_of(&name, &bytes, self.abstraction, &self.lags)?;
            let twin = self.twin.twin();
            let named = |part: Part| part.under(self.name.as_deref()).with_twin(twin);
            parts.extend(found.into_iter().map(named));
        }

        let connection = self.server.connect().await?;
        for part in &parts {
            let (name, another) = (&part.environment, "--name NAME");
            self.lags.check(&connection, name, another).await?;
        }
        let progress = Progress::new(parts.iter().map(Part::steps).sum());
        let report = Report::send_parts(&parts, &connection, &progress).await?;
        progress.finish();
        report.print(self.json)
    }
}

/// Takes a file of that name apart by layout; games stay in the file's order.
pub(super) fn parts_of(
    name: &str,
    bytes: &[u8],
    abstraction: Abstraction,
    lags: &Lags,
) -> Result<Vec<Part>, Failure> {
    let wrong = |why: &dyn std::fmt::Display| Failure::usage(format!("cannot read {name}: {why}"));
    let text = overcooked::decompressed(bytes).map_err(|error| wrong(&error))?;
    let games = overcooked::read_games(&text).map_err(|error| wrong(&error))?;
    let digest = blake3::hash(&text).to_hex();
    let mut by_layout: BTreeMap<String, Vec<Game>> = BTreeMap::new();
    for game in games {
        by_layout.entry(game.layout.clone()).or_default().push(game);
    }

    let part = |(layout, games): (String, Vec<Game>)| {
        let world = World::new(Kitchen::named(&layout)?, abstraction);
        Some(Part {
            environment: world.environment_name(),
            world: world.at_lags(lags.numbers().to_vec()),
            games,
            producer: format!("{WAY}:{layout}:{abstraction}:{}", &digest[..32]),
            file: name.to_owned(),
            twin: None,
        })
    };
    Ok(by_layout.into_iter().filter_map(part).collect())
}

impl Part {
    /// Returns the same for an environment whose name begins so.
    pub(super) fn under(self, name: Option<&str>) -> Self {
        let environment = match name {
            Some(name) => format!("{name}.{}", self.environment),
            None => self.environment,
        };
        Self {
            environment,
            ..self
        }
    }

    /// Returns a twin of the games, for an environment and from a producer of its own; the same where
    /// none is wanted.
    pub(super) fn with_twin(self, twin: Option<Twin>) -> Self {
        let Some(twin) = twin else { return self };
        Self {
            environment: format!("{}.{twin}", self.environment),
            producer: format!("{}:{twin}", self.producer),
            twin: Some(twin),
            ..self
        }
    }

    /// Returns the name of the environment that it goes into.
    pub(super) fn environment_name(&self) -> String {
        self.environment.clone()
    }

    /// Returns how many transitions it holds.
    pub(super) fn steps(&self) -> u64 {
        self.games.iter().map(|game| game.steps.len() as u64).sum()
    }

    fn description(&self) -> DescriptionDraft {
        DescriptionDraft {
            derived: Some(self.world.derived()),
            ..self.world.description().into()
        }
    }

    /// Makes the environment if it is missing, and sends what the service has not committed yet.
    async fn send(&self, connection: &Connection, progress: &Progress) -> Result<Totals, Failure> {
        let name = &self.environment;
        progress.part(name);
        make(connection, name, self.description()).await?;
        let producer = connection
            .producer(name, &self.producer)
            .batch_size(BATCH_SIZE)
            .replay();
        let mut producer = producer.open().await?;
        for game in &self.games {
            let steps = self.played(game, producer.schema());
            send_track(&mut producer, &game.trial, steps, progress).await?;
        }

        let totals = producer.close().await?;
        progress.part_done(&format!("{}: {name}", self.file), totals.sent);
        Ok(totals)
    }

    /// Returns the steps of a game, or of its twin; none where it is too short for one.
    fn played(&self, game: &Game, schema: &Schema) -> Vec<Step> {
        let step = |step: &overcooked::Step| {
            let (state, actions) = self.world.values(step);
            Step::new(state, actions).observing(self.world.observed(step))
        };
        let steps = game.steps.iter().map(step).collect();
        match self.twin {
            None => steps,
            Some(twin) => twin.of(schema, &steps, &game.trial).unwrap_or_default(),
        }
    }
}

impl Report {
    /// Sends parts, one after the other.
    pub(super) async fn send_parts(
        parts: &[Part],
        connection: &Connection,
        progress: &Progress,
    ) -> Result<Self, Failure> {
        let mut report = Self::default();
        for part in parts {
            report.add(
                part.environment_name(),
                part.send(connection, progress).await?,
            );
        }
        Ok(report)
    }
}
