//! What a network says of itself: judged by the evidence on states that it has not learned from, beside what it has to beat.

use super::court::Court;
use super::dataset::{Dataset, Example};
use super::score::{Judged, reliability, score};
use super::training::Ensemble;
use crate::domain::{Baseline, Card, Score, Training};

/// The most numbers that are kept in judging: inputs, or probabilities of pairs of actions, over all states.
const MOST_NUMBERS: usize = 8 << 20;

/// Which of the members judges each state: the one that did not learn from it.
pub enum Split<'a> {
    /// By the parts of the training.
    HeldOut(&'a Training),
    /// All members: nobody knows what they learned from.
    Unknown,
}

impl Split<'_> {
    /// Returns the states that are judged, each with the members that judge it: by position. Of very many, every second, third, ...
    fn states(&self, dataset: &Dataset, ensemble: &Ensemble) -> Vec<(usize, std::ops::Range<usize>)> {
        let members = ensemble.members.len();
        let judges = |example: &Example| match self {
            Self::Unknown => 0..members,
            Self::HeldOut(training) => {
                let fold = Dataset::fold(&example.key, training.folds, training.seed);
                fold..fold + 1
            }
        };
        let all = dataset.examples.iter().enumerate().map(|(at, example)| (at, judges(example)));
        let judged: Vec<_> = all.filter(|(_, judges)| judges.end <= members).collect();
        let cells = (dataset.alphabet.rows * dataset.alphabet.columns) as usize;
        let numbers = judged.len() * cells.max(ensemble.encoder.width());
        let every = numbers.div_ceil(MOST_NUMBERS).max(1);
        judged.into_iter().step_by(every).collect()
    }

    fn told(&self) -> String {
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

/// Judges an ensemble beside its shuffled twin, which was trained the same way on counts in which nothing depends on anything; an imported one has none.
pub fn card(
    dataset: &Dataset,
    training: Training,
    ensemble: &Ensemble,
    shuffled: Option<&Ensemble>,
    split: &Split<'_>,
) -> Card {
    let court = Court::new(dataset, training, split.states(dataset, ensemble));
    let network = court.told(ensemble);
    let calibration = court.calibration(&network);
    let judged = court.judged(&network, calibration);
    let own = score("network", &judged, court.log_likelihood(&network));
    let mut baselines = court.simple_baselines();
    let twin = shuffled.map(|shuffled| court.told(shuffled));
    baselines.extend(twin.as_ref().map(|twin| {
        let judged = court.judged(twin, court.calibration(twin));
        score(Baseline::Shuffled.as_str(), &judged, court.log_likelihood(twin))
    }));
    let found = court.has_found_something(&network, twin.as_deref());
    Card {
        training,
        imported: matches!(split, Split::Unknown),
        schema_hash: dataset.schema_hash.clone(),
        threshold: dataset.threshold,
        revision: dataset.revision,
        fit: dataset.fit(),
        states: dataset.examples.len() as u64,
        visits: dataset.draws(),
        inputs: ensemble.encoder.width() as u64,
        split: split.told(),
        epochs: ensemble.epochs.clone(),
        dropout: ensemble.dropout,
        judged_states: judged.len() as u64,
        positive_share: positive_share(&judged),
        calibration,
        base_rate: court.base_rate(&network, calibration),
        not_better_than: not_better_than(&own, &baselines, found),
        score: own,
        baselines,
        reliability: reliability(&judged),
    }
}

/// Returns the names of the baselines that a network does not beat; where it has found nothing, its shuffled twin is among them.
fn not_better_than(network: &Score, baselines: &[Score], found_something: bool) -> Vec<String> {
    let beaten = |baseline: &Score| match baseline.name == Baseline::Shuffled.as_str() {
        true => found_something && is_better(network, baseline),
        false => is_better(network, baseline),
    };
    let mut names: Vec<String> =
        baselines.iter().filter(|baseline| !beaten(baseline)).map(|baseline| baseline.name.clone()).collect();
    let has_twin = baselines.iter().any(|baseline| baseline.name == Baseline::Shuffled.as_str());
    if !found_something && !has_twin {
        names.push(Baseline::Shuffled.as_str().to_owned());
    }
    names
}

/// Returns whether a network is better than a baseline: by the likelihood of what the other did, where both tell it, else by the squared error of the
/// probabilities. The former is measured on the counts themselves, the latter on what the evidence makes of them. Knowing habits is not enough: the
/// average must be beaten by both. And who calls nothing rightly, where it predicts nothing but influence, beats nobody.
fn is_better(network: &Score, baseline: &Score) -> bool {
    let errs_less = network.brier < baseline.brier && (network.log_likelihood.is_some() || network.f1 > 0.0);
    match (network.log_likelihood, baseline.log_likelihood) {
        (Some(own), Some(other)) if baseline.name == Baseline::Majority.as_str() => own > other && errs_less,
        (Some(own), Some(other)) => own > other,
        _ => errs_less,
    }
}

fn positive_share(judged: &[Judged]) -> f64 {
    let total: f64 = judged.iter().map(|one| one.weight).sum();
    judged.iter().map(|one| one.weight * one.evidence).sum::<f64>() / total.max(f64::MIN_POSITIVE)
}
