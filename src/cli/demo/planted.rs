//! The planted follower of the demo, whose truth is known, and its twin in which nobody follows.

use crate::cli::Failure;
use crate::cli::making::make;
use crate::cli::progress::Progress;
use crate::cli::track::send_track;
use crate::cli::twin::Twin;
use crate::client::{Connection, Totals};
use crate::domain::draft::DescriptionDraft;
use crate::simulation::follower;

/// The environment of the follower.
const FOLLOWER: &str = "demo.follower";

/// Of the games.
const SEED: u64 = 1;

/// The greatest lag that is looked at.
const MOST_LAG: u32 = 6;

/// Transitions of a batch; another number must have another producer.
const BATCH_SIZE: usize = 1_000;

/// Returns the name of the environment of the follower, or of its twin.
pub(super) fn environment_name(twin: Option<Twin>) -> String {
    match twin {
        None => FOLLOWER.into(),
        Some(twin) => format!("{FOLLOWER}.{twin}"),
    }
}

/// Sends the games of the follower, or of its twin, as far as they are not counted yet.
pub(super) async fn send(
    connection: &Connection,
    twin: Option<Twin>,
) -> Result<(String, Totals), Failure> {
    let name = environment_name(twin);
    let lags: Vec<u32> = (1..=MOST_LAG).collect();
    let description = DescriptionDraft::from(follower::description(&lags));
    make(connection, &name, description).await?;

    let producer = connection.producer(&name, "follower.1");
    let mut producer = producer.batch_size(BATCH_SIZE).replay().open().await?;
    let games = follower::games(SEED);
    for (number, game) in games.into_iter().enumerate() {
        let segment = format!("game-{}", number + 1);
        let steps = match twin {
            None => game,
            Some(twin) => {
                let twin = twin.of(producer.schema(), &game, &segment);
                twin.unwrap_or_default()
            }
        };
        send_track(&mut producer, &segment, steps, &Progress::silent()).await?;
    }
    Ok((name, producer.close().await?))
}
