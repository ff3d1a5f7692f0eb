//! A version ready to answer.

use std::sync::Arc;

use ndarray::Array2;
use rayon::prelude::*;

use super::encoder::Encoder;
use super::file::Content;
use super::member::{Joint, Member};
use super::told::Told;
use crate::domain::{Calibration, Card, Environment, EnvironmentId, ModelAction, ModelKind, Pair, StateKey, Verdict};

/// Added to mutual information before its logarithm is taken: what is below is as good as nothing.
const NEGLIGIBLE: f64 = 0.005;

/// How far from its own threshold a joint network may be asked, as a factor: its calibration says nothing of what is farther away.
const REACH: f64 = 4.0;

/// A version ready to answer: shared by any number of threads.
pub struct Network {
    environment: EnvironmentId,
    /// Its version.
    pub version: u64,
    /// Whose influence on whom.
    pub pair: Pair,
    /// What it predicts.
    pub kind: ModelKind,
    /// The threshold that it was trained and calibrated for, in nats.
    pub threshold: f64,
    encoder: Encoder,
    members: Vec<Member>,
    calibration: Calibration,
    told: Told,
    /// Whether it found more in the counts than the same network does in shuffled ones.
    found_something: bool,
}

/// What a network says of one state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// P(MI > threshold), the mean of its members; `None` where it cannot tell at that threshold.
    pub probability: Option<f64>,
    /// Mutual information in nats, the mean of its members; `None` for a direct network.
    pub mutual_information: Option<f64>,
    /// Whether its members say the same, each on its own side of one half.
    pub agrees: bool,
}

impl Network {
    /// Makes a version ready.
    pub fn new(environment: EnvironmentId, version: u64, content: Content, card: &Card) -> Self {
        let Content { kind, pair, threshold, encoder, members } = content;
        let shuffled = crate::domain::Baseline::Shuffled.as_str();
        let found_something = !card.not_better_than.iter().any(|name| name == shuffled);
        Self {
            environment,
            version,
            pair,
            kind,
            threshold,
            encoder,
            members,
            calibration: card.calibration,
            told: Told::default(),
            found_something,
        }
    }

    /// Returns whether it is this version of this environment.
    pub fn is_of(&self, environment: EnvironmentId, version: u64) -> bool {
        (self.environment, self.version) == (environment, version)
    }

    /// Predicts for states, which are of the network's schema, at a threshold in nats, and remembers what it said.
    pub fn predict(&self, states: &[StateKey], threshold: f64) -> Vec<Prediction> {
        self.predictions(self.told.of(states, |unknown| self.tell(unknown)), threshold)
    }

    /// Predicts for states that nobody will ask for again soon.
    pub fn predict_once(&self, states: &[StateKey], threshold: f64) -> Vec<Prediction> {
        self.predictions(self.tell(&states.iter().collect::<Vec<_>>()), threshold)
    }

    fn predictions(&self, told: Vec<Arc<[f64]>>, threshold: f64) -> Vec<Prediction> {
        let prediction = |numbers: Arc<[f64]>| match self.kind {
            ModelKind::Joint => self.joint_prediction(numbers.iter().copied(), threshold),
            ModelKind::Direct => self.direct_prediction(numbers.iter().copied(), threshold),
        };
        told.into_iter().map(prediction).collect()
    }

    /// Lets every member tell of states: mutual information in nats, or ln odds.
    fn tell(&self, states: &[&StateKey]) -> Vec<Arc<[f64]>> {
        /// States of one share: large enough that sharing among threads costs little.
        const SHARE: usize = 128;
        let share = |states: &[&StateKey]| {
            let inputs = self.encoder.encode(states.iter().copied());
            let members: Vec<Vec<f64>> = self.members.iter().map(|member| self.numbers(member, &inputs)).collect();
            (0..states.len()).map(|state| members.iter().map(|member| member[state]).collect()).collect::<Vec<_>>()
        };
        if states.len() <= SHARE { share(states) } else { states.par_chunks(SHARE).flat_map_iter(share).collect() }
    }

    fn numbers(&self, member: &Member, inputs: &Array2<f32>) -> Vec<f64> {
        match self.kind {
            ModelKind::Joint => member.information(inputs),
            ModelKind::Direct => member.ln_odds(inputs),
        }
    }

    fn joint_prediction(&self, members: impl ExactSizeIterator<Item = f64> + Clone, threshold: f64) -> Prediction {
        let factor = if threshold == self.threshold { 1.0 } else { threshold / self.threshold };
        // What is calibrated for one threshold holds for another if mutual information is measured in thresholds.
        let probability = |nats: f64| probability(self.calibration, nats / factor);
        let possible = threshold < self.largest();
        let (mean, agrees) =
            mean_and_agreement(members.clone().map(|nats| if possible { probability(nats) } else { 0.0 }));
        Prediction {
            probability: (1.0 / REACH..=REACH).contains(&factor).then_some(mean),
            mutual_information: Some(members.clone().sum::<f64>() / members.len() as f64),
            agrees,
        }
    }

    /// Returns ln min(R, K): no mutual information is larger.
    fn largest(&self) -> f64 {
        let actions = |head: usize| self.members.first().map_or(1, |member| member.heads[head].shape().1);
        (actions(0).min(actions(1)) as f64).ln()
    }

    fn direct_prediction(&self, members: impl ExactSizeIterator<Item = f64>, threshold: f64) -> Prediction {
        let (mean, agrees) = mean_and_agreement(members.map(logistic));
        let probability = (threshold == self.threshold).then_some(mean);
        Prediction { probability, mutual_information: None, agrees }
    }

    /// Returns whether a prediction can decide anything: not at a threshold that the network cannot tell about, and not where it has found nothing in
    /// the counts that it learned from.
    pub fn can_decide(&self, prediction: &Prediction) -> bool {
        self.found_something && prediction.probability.is_some()
    }

    /// Decides by a prediction: at the same confidence as for counts, and only where the members agree.
    pub fn decide(&self, prediction: &Prediction, confidence: f64) -> Verdict {
        match prediction.probability.filter(|_| self.can_decide(prediction) && prediction.agrees) {
            Some(p) if p >= confidence => Verdict::Influences,
            Some(p) if 1.0 - p >= confidence => Verdict::NoInfluence,
            _ => Verdict::Undecided,
        }
    }

    /// Predicts what each of the ego's actions does in a state; empty for a direct network. Divergences are in nats.
    pub fn by_action(&self, environment: &Environment, state: &StateKey) -> Vec<ModelAction> {
        let inputs = self.encoder.encode(std::iter::once(state));
        let members: Vec<Joint> = match self.kind {
            ModelKind::Joint => self.members.iter().filter_map(|member| member.joint(&inputs).pop()).collect(),
            ModelKind::Direct => Vec::new(),
        };
        let Some(first) = members.first() else { return Vec::new() };
        let ego = &environment.schema.agents()[self.pair.ego];
        let mean = |figure: &dyn Fn(&Joint) -> f64| members.iter().map(figure).sum::<f64>() / members.len() as f64;
        let action = |index: usize| ModelAction {
            index: index as u64,
            action: ego.action_label(index as u64),
            probability: mean(&|joint| joint.ego[index]),
            divergence: mean(&|joint| joint.divergence(index)),
            response: (0..first.other.len()).map(|other| mean(&|joint| joint.response[[index, other]])).collect(),
        };
        (0..first.ego.len()).map(action).collect()
    }
}

/// Returns the mean of probabilities, and whether all are on the same side of one half.
fn mean_and_agreement(probabilities: impl ExactSizeIterator<Item = f64>) -> (f64, bool) {
    let members = probabilities.len();
    let (sum, above) = probabilities.fold((0.0, 0), |(sum, above), p| (sum + p, above + usize::from(p >= 0.5)));
    (sum / members as f64, above == 0 || above == members)
}

/// Returns the number that is calibrated of a mutual information in nats.
pub fn ln_information(nats: f64) -> f64 {
    (nats + NEGLIGIBLE).ln()
}

/// Returns P(MI > threshold) of a network's mutual information in nats.
pub fn probability(calibration: Calibration, nats: f64) -> f64 {
    logistic(calibration.intercept + calibration.slope * ln_information(nats))
}

/// Returns 1 / (1 + e^-z).
pub fn logistic(z: f64) -> f64 {
    1.0 / (1.0 + (-z).exp())
}
