//! Networks that were trained elsewhere: checked against the environment, evaluated by the counts
//! here, and kept.

use std::sync::Arc;

use tracing::instrument;

use super::card_builder::{self, Origin};
use super::dataset::Dataset;
use super::file::Content;
use super::idle_priority::at_idle_priority;
use super::refusals::{check_size, internal, no_network};
use super::training::{self, Ensemble};
use super::{Networks, file};
use crate::domain::{Card, Environment, Model, ModelKind, Training, is_same_threshold};
use crate::error::{Fault, Problem};

impl Networks {
    /// Keeps a network that was trained elsewhere: a safetensors file as [`export`](Self::export)
    /// writes it. It is evaluated by the counts here, and not made active. With the card of an
    /// export it says of every state what it said before; without one, or for a rule with another
    /// threshold, it is calibrated here.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn import(
        &self,
        environment: &Arc<Environment>,
        file: Vec<u8>,
    ) -> Result<Model, Problem> {
        let (mut content, exported) = read_file(environment, file).await?;
        self.registry.check_room(environment).await?;
        let training = exported
            .as_ref()
            .map_or_else(|| foreign_training(&content), |card| card.training);
        check_size(environment, &content.pair, &training)?;

        let turn = self.turn.clone().lock_owned().await;
        let dataset = self.dataset(environment, &content.pair).await?;
        settle_threshold(&mut content, dataset.threshold)?;
        training::check(&dataset, &training).map_err(|error| no_network(&error))?;
        if content.seen.is_none() {
            // Who does not say what it was trained on is believed where something is counted, as it
            // is where it comes from.
            content.seen = Some(self.registry.counted(environment).await?);
        }

        let evaluated = tokio::task::spawn_blocking(move || {
            // The next has its turn when this one is evaluated, even if nobody waits for it any
            // more.
            let _turn = turn;
            let card = evaluate(&dataset, training, &content, exported.as_ref());
            (content, card)
        });
        let (content, card) = evaluated.await.map_err(|error| internal(&error))?;
        check_calibration(&card)?;

        let version = self.registry.keep(environment, &content, &card).await?;
        tracing::info!(environment = %environment.name, version, "a network was imported");
        self.get(environment, version).await
    }
}

/// Reads a file beside everything else, for it may be large: the network, and its card where Nudge
/// exported it.
async fn read_file(
    environment: &Arc<Environment>,
    file: Vec<u8>,
) -> Result<(Content, Option<Card>), Problem> {
    let environment = environment.clone();
    let reading = tokio::task::spawn_blocking(move || file::imported(&environment, &file));
    reading.await.map_err(|error| internal(&error))?
}

/// Returns what can be told of a training that no card tells of.
fn foreign_training(content: &Content) -> Training {
    let first = content.members.first();

    Training {
        kind: content.kind,
        width: first.map_or(0, |member| member.trunk.shape().1),
        members: content.members.len(),
        epochs: 0,
        ..Training::default()
    }
}

/// Makes a joint network one for the rule's threshold, since it is calibrated here; a direct one
/// has to be for it already.
fn settle_threshold(content: &mut Content, threshold: f64) -> Result<(), Problem> {
    if is_same_threshold(content.threshold, threshold) {
        return Ok(());
    }
    if content.kind == ModelKind::Joint {
        content.threshold = threshold;
        return Ok(());
    }

    let detail = format!(
        "got {}, expected that of the rule, {threshold} nats",
        content.threshold
    );
    Err(invalid("/metadata/threshold", detail))
}

fn evaluate(
    dataset: &Dataset,
    training: Training,
    content: &Content,
    exported: Option<&Card>,
) -> Card {
    let (epochs, dropout) =
        exported.map_or_else(Default::default, |card| (card.epochs.clone(), card.dropout));
    let ensemble = Ensemble {
        encoder: content.encoder.clone(),
        members: content.members.clone(),
        epochs,
        dropout,
    };
    let origin = exported.map_or(Origin::Foreign, Origin::Exported);

    at_idle_priority(|| card_builder::build_card(dataset, training, &ensemble, &origin))
}

fn check_calibration(card: &Card) -> Result<(), Problem> {
    let calibration = card.calibration;
    if calibration.intercept.is_finite() && calibration.slope.is_finite() {
        return Ok(());
    }
    let detail = "its outputs are no numbers on the states here";
    Err(invalid("/members", detail.to_owned()))
}

fn invalid(pointer: &str, detail: String) -> Problem {
    Problem::invalid("network", vec![Fault::new(pointer, detail)])
}
