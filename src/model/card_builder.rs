//! The model card: how a network does on held-out states, beside the baselines that it has to beat.

use super::dataset::{Dataset, Example};
use super::held_out_evaluation::HeldOutEvaluation;
use super::score::{Judged, reliability, score};
use super::training::Ensemble;
use crate::domain::{Baseline, Calibration, Card, Score, Training, is_same_threshold};

/// The most numbers that are kept in judging: inputs, or probabilities of pairs of actions, over
/// all states.
const MOST_NUMBERS: usize = 8 << 20;

/// Where an ensemble comes from.
pub enum Origin<'a> {
    /// It was trained here, as was its shuffled twin: on counts in which nothing depends on
    /// anything.
    Trained(&'a Ensemble),
    /// It was brought here, by a file of other tools or of a build that kept no card.
    Foreign,
    /// It was brought here by a file that Nudge wrote, with the card that it had there.
    Exported(&'a Card),
}

impl Origin<'_> {
    fn twin(&self) -> Option<&Ensemble> {
        match self {
            Self::Trained(twin) => Some(twin),
            Self::Foreign | Self::Exported(_) => None,
        }
    }

    /// Returns what a network says of itself wherever it is brought, unless it has to be made for
    /// another threshold.
    fn kept(&self, threshold: f64) -> Option<Kept> {
        match self {
            Self::Exported(card) if is_same_threshold(card.threshold, threshold) => {
                Some(Kept::of_card(card))
            }
            _ => None,
        }
    }
}

/// What its answers rest on beside its weights. It was found on states that the network had not
/// learned from; on those here, which it may know by heart, its calibration would be too sure.
struct Kept {
    threshold: f64,
    calibration: Calibration,
    base_rate: Option<f64>,
    found_something: bool,
    /// How its shuffled twin did there, which did not come along.
    shuffled: Option<Score>,
}

impl Kept {
    fn of_card(card: &Card) -> Self {
        let Card {
            threshold,
            calibration,
            base_rate,
            ..
        } = *card;
        let shuffled = card
            .baselines
            .iter()
            .find(|score| score.name == Baseline::Shuffled.as_str())
            .cloned();
        Self {
            threshold,
            calibration,
            base_rate,
            found_something: card.found_something(),
            shuffled,
        }
    }
}

/// Which of the members judges each state: the one that did not learn from it.
enum Split<'a> {
    /// By the parts of the training.
    HeldOut(&'a Training),
    /// All members: nobody knows what they learned from.
    Unknown,
}

impl<'a> Split<'a> {
    /// Parts are cut by key: of a network that Nudge trained, wherever that was, it is known which
    /// states each member did not learn from.
    fn of_origin(origin: &Origin<'_>, training: &'a Training) -> Self {
        match origin {
            Origin::Trained(_) => Self::HeldOut(training),
            Origin::Exported(card) if card.is_split_known() => Self::HeldOut(training),
            Origin::Exported(_) | Origin::Foreign => Self::Unknown,
        }
    }

    /// Returns the states that are judged, each with the members that judge it: by position. Of
    /// very many, every second, third, ...
    fn states(
        &self,
        dataset: &Dataset,
        ensemble: &Ensemble,
    ) -> Vec<(usize, std::ops::Range<usize>)> {
        let members = ensemble.members.len();
        let judges = |example: &Example| match self {
            Self::Unknown => 0..members,
            Self::HeldOut(training) => {
                let fold = Dataset::fold(&example.key, training.folds, training.seed);
                fold..fold + 1
            }
        };

        let all = dataset
            .examples
            .iter()
            .enumerate()
            .map(|(at, example)| (at, judges(example)));
        let judged: Vec<_> = all.filter(|(_, judges)| judges.end <= members).collect();

        let cells = dataset.letters.cells() as usize;
        let numbers = judged.len() * cells.max(ensemble.encoder.width());
        let every = numbers.div_ceil(MOST_NUMBERS).max(1);
        judged.into_iter().step_by(every).collect()
    }

    fn description(&self) -> String {
        match self {
            Self::Unknown => {
                "trained elsewhere: it was judged on every state here, and may have learned from some of them".into()
            }
            Self::HeldOut(Training { folds, members, .. }) => format!(
                "states were cut into {folds} parts by key; each of {members} members learned from all but its own part, was stopped by that part, \
                 and calibrated and judged on it"
            ),
        }
    }
}

/// Evaluates an ensemble by the counts here, and writes its card. What an exported one says of a
/// state stays what it was.
pub fn build_card(
    dataset: &Dataset,
    training: Training,
    ensemble: &Ensemble,
    origin: &Origin<'_>,
) -> Card {
    let split = Split::of_origin(origin, &training);
    let evaluation = HeldOutEvaluation::new(dataset, training, split.states(dataset, ensemble));

    let network = evaluation.predict(ensemble);
    let kept = origin.kept(dataset.threshold);
    let calibration = kept
        .as_ref()
        .map_or_else(|| evaluation.calibration(&network), |kept| kept.calibration);
    let judged = evaluation.judged(&network, calibration);
    let own = score("network", &judged, evaluation.log_likelihood(&network));

    let mut baselines = evaluation.simple_baselines();
    let twin = origin.twin().map(|twin| evaluation.predict(twin));
    let shuffled = twin.as_ref().map(|twin| {
        let judged = evaluation.judged(twin, evaluation.calibration(twin));
        score(
            Baseline::Shuffled.as_str(),
            &judged,
            evaluation.log_likelihood(twin),
        )
    });

    let beats_shuffled = match &kept {
        Some(kept) => kept.found_something,
        None => {
            let found = evaluation.has_found_something(&network, twin.as_deref());
            found
                && shuffled
                    .as_ref()
                    .is_none_or(|shuffled| is_better(&own, shuffled))
        }
    };

    let not_better_than = not_better_than(&own, &baselines, beats_shuffled);
    baselines.extend(shuffled.or_else(|| kept.as_ref().and_then(|kept| kept.shuffled.clone())));

    Card {
        training,
        lag: dataset.lag,
        imported: !matches!(origin, Origin::Trained(_)),
        schema_hash: dataset.schema_hash.clone(),
        threshold: kept
            .as_ref()
            .map_or(dataset.threshold, |kept| kept.threshold),
        revision: dataset.revision,
        fit: dataset.fit(),
        states: dataset.examples.len() as u64,
        visits: dataset.draws(),
        inputs: ensemble.encoder.width() as u64,
        split: split.description(),
        epochs: ensemble.epochs.clone(),
        dropout: ensemble.dropout,
        judged_states: judged.len() as u64,
        positive_share: positive_share(&judged),
        calibration,
        base_rate: kept.map_or_else(
            || evaluation.base_rate(&network, calibration),
            |kept| kept.base_rate,
        ),
        not_better_than,
        score: own,
        baselines,
        reliability: reliability(&judged),
    }
}

/// Returns the names of the baselines that a network does not beat, its shuffled twin the last of
/// them.
fn not_better_than(network: &Score, baselines: &[Score], beats_shuffled: bool) -> Vec<String> {
    let unbeaten = baselines
        .iter()
        .filter(|baseline| !is_better(network, baseline))
        .map(|baseline| baseline.name.clone());

    let shuffled = (!beats_shuffled).then(|| Baseline::Shuffled.as_str().to_owned());
    unbeaten.chain(shuffled).collect()
}

/// Returns whether a network is better than a baseline: by the likelihood of what the other did,
/// where both tell it, else by the squared error of the probabilities. The former is measured on
/// the counts themselves, the latter on what the evidence makes of them. Knowing habits is not
/// enough: the average must be beaten by both. And who calls nothing rightly, where it predicts
/// nothing but influence, beats nobody.
fn is_better(network: &Score, baseline: &Score) -> bool {
    let errs_less =
        network.brier < baseline.brier && (network.log_likelihood.is_some() || network.f1 > 0.0);

    match (network.log_likelihood, baseline.log_likelihood) {
        (Some(own), Some(other)) if baseline.name == Baseline::Majority.as_str() => {
            own > other && errs_less
        }
        (Some(own), Some(other)) => own > other,
        _ => errs_less,
    }
}

fn positive_share(judged: &[Judged]) -> f64 {
    let total: f64 = judged.iter().map(|one| one.weight).sum();
    judged
        .iter()
        .map(|one| one.weight * one.evidence)
        .sum::<f64>()
        / total.max(f64::MIN_POSITIVE)
}
