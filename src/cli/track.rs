//! Whole games on their way into an environment.

use super::Failure;
use super::progress::Progress;
use crate::client::{Producer, Step, Track};

/// Sends a game as a segment of that name.
pub(super) async fn send_track(
    producer: &mut Producer,
    segment: &str,
    steps: Vec<Step>,
    progress: &Progress,
) -> Result<(), Failure> {
    producer.segment(Some(segment)).await?;
    let mut track = Track::new(producer.schema());
    for step in steps {
        if let Some(transition) = track.step(step) {
            producer.send(transition).await?;
        }
        progress.step();
    }
    for transition in track.end() {
        producer.send(transition).await?;
    }
    Ok(())
}
