//! Surrogate data: twins of recorded or simulated play without influence, which are sent as the
//! play itself is.

use std::fmt;

use clap::{Args, ValueEnum};

use crate::client::Step;
use crate::domain::Schema;
use crate::tracks::twins;

/// Which twin of a game is sent in its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Args)]
pub(super) struct TwinArguments {
    /// Send a twin without influence in place of what was played
    #[arg(long, value_enum)]
    twin: Option<Kind>,
    /// Seed of what the twin is drawn by
    #[arg(long, value_name = "NUMBER", default_value_t = 0, requires = "twin")]
    seed: u64,
}

/// A kind of twin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Kind {
    /// Each player's actions exchanged at random within each state of a game
    Shuffled,
    /// The second player's actions taken from elsewhere in the game, at least 60 steps away, in a
    /// circle; shorter games than 120 steps are left out
    Shifted,
}

/// A twin, by its kind and its seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Twin {
    pub(super) kind: Kind,
    pub(super) seed: u64,
}

impl TwinArguments {
    /// Returns the twin that is wanted, if any.
    pub(super) fn twin(self) -> Option<Twin> {
        let Self { twin, seed } = self;
        twin.map(|kind| Twin { kind, seed })
    }
}

impl Twin {
    /// Returns the twin of a game of that name, `None` where it is too short for one.
    pub(super) fn of(self, schema: &Schema, steps: &[Step], game: &str) -> Option<Vec<Step>> {
        let seed = self.seed_of(game);
        match self.kind {
            Kind::Shuffled => Some(twins::shuffled(schema, steps, seed)),
            Kind::Shifted => twins::shifted(schema, steps, 1, seed),
        }
    }

    /// Returns the seed of one game: no two games are drawn alike.
    fn seed_of(self, game: &str) -> u64 {
        let digest = blake3::hash(format!("{}:{game}", self.seed).as_bytes());
        let (first, _) = digest.as_bytes().split_first_chunk().expect("32 bytes");
        u64::from_le_bytes(*first)
    }
}

/// As a part of names: `shifted`, and `shifted-7` with a seed.
impl fmt::Display for Twin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self.kind {
            Kind::Shuffled => "shuffled",
            Kind::Shifted => "shifted",
        };
        match self.seed {
            0 => f.write_str(kind),
            seed => write!(f, "{kind}-{seed}"),
        }
    }
}
