//! `nudge experiment`: claims about the whole, measured on this machine.

mod planted;

use clap::Subcommand;

use super::Failure;

/// Measure what Nudge claims, where the truth is known
#[derive(Debug, Subcommand)]
#[command(
    long_about = "Measure what Nudge claims, where the truth is known.\n\n\
    An experiment starts a service of its own in a temporary directory, sends it what it draws, and judges the answers. Every figure stands beside \
    its null. The same seed, parameters and version give the same bytes.\n\n\
    Example:\n  nudge experiment planted --out ./results"
)]
pub(super) enum Experiment {
    Planted(planted::Planted),
}

impl Experiment {
    pub(super) async fn run(self) -> Result<(), Failure> {
        match self {
            Self::Planted(command) => command.run().await,
        }
    }
}
