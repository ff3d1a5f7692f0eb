//! Inference by an ensemble: a version ready to predict, calibrated, and what its predictions may
//! decide.

use std::sync::Arc;

use ndarray::Array2;
use rayon::prelude::*;

use super::encoder::Encoder;
use super::file::Content;
use super::member::{Joint, Member};
use super::prediction_cache::PredictionCache;
use super::seen::Seen;
use crate::domain::{
    Calibration, Card, Environment, EnvironmentId, ModelAction, ModelKind, Pair, StateKey, Verdict,
    is_same_threshold,
};

/// Added to mutual information before its logarithm is taken: what is below is as good as nothing.
const NEGLIGIBLE: f64 = 0.005;

/// How far what a network says of a state must lie from what it says of any, in odds, for a verdict
/// to be about that state.
const MOVED: f64 = 3.0;

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
    /// ln min(R, K): no mutual information is larger.
    largest: f64,
    encoder: Encoder,
    members: Vec<Member>,
    calibration: Calibration,
    /// What it says of a state on average, if that is known.
    base_rate: Option<f64>,
    seen: Seen,
    cache: PredictionCache,
    /// Whether it found more in the counts than the same network does in shuffled ones.
    found_something: bool,
}

/// What a network says of one state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// P(MI > threshold), the mean of its members; `None` at another threshold than the network's
    /// own.
    pub probability: Option<f64>,
    /// Mutual information in nats, the mean of its members; `None` for a direct network.
    pub mutual_information: Option<f64>,
    /// Whether its members say the same at its own threshold, each on its own side of one half.
    pub agrees: bool,
    /// Whether every bin of the state was seen in training.
    pub in_range: bool,
}

impl Network {
    /// Makes a version ready.
    pub fn new(environment: &Environment, version: u64, content: Content, card: &Card) -> Self {
        let Content {
            kind,
            pair,
            threshold,
            encoder,
            members,
            seen,
        } = content;
        Self {
            environment: environment.id,
            version,
            largest: pair.alphabet(&environment.schema).largest_information(),
            pair,
            kind,
            threshold,
            encoder,
            members,
            calibration: card.calibration,
            base_rate: card.base_rate,
            seen: seen.unwrap_or_default(),
            cache: PredictionCache::default(),
            found_something: card.found_something(),
        }
    }

    /// Returns whether it is this version of this environment.
    pub fn is_of(&self, environment: EnvironmentId, version: u64) -> bool {
        (self.environment, self.version) == (environment, version)
    }

    /// Returns how many strata it predicts in: how many times as long a state takes as one in the
    /// same tick.
    pub fn strata(&self) -> usize {
        self.members.first().map_or(1, Member::strata)
    }

    /// Predicts for states, which are of the network's schema, at a threshold in nats, and
    /// remembers what it said.
    pub fn predict(&self, states: &[StateKey], threshold: f64) -> Vec<Prediction> {
        self.predictions(
            states,
            self.cache
                .get_or_predict(states, |unknown| self.outputs(unknown)),
            threshold,
        )
    }

    /// Predicts for states that nobody will ask for again soon.
    pub fn predict_once(&self, states: &[StateKey], threshold: f64) -> Vec<Prediction> {
        self.predictions(
            states,
            self.outputs(&states.iter().collect::<Vec<_>>()),
            threshold,
        )
    }

    fn predictions(
        &self,
        states: &[StateKey],
        outputs: Vec<Arc<[f64]>>,
        threshold: f64,
    ) -> Vec<Prediction> {
        let can_tell = is_same_threshold(threshold, self.threshold);
        let prediction = |(state, numbers): (&StateKey, Arc<[f64]>)| {
            let (mean, agrees) =
                mean_and_agreement(numbers.iter().map(|number| self.probability(*number)));
            Prediction {
                probability: can_tell.then_some(mean),
                mutual_information: self.mutual_information(&numbers),
                agrees,
                in_range: self.seen.holds(state),
            }
        };

        states.iter().zip(outputs).map(prediction).collect()
    }

    /// Returns P(MI > the network's own threshold) by the number that a member tells.
    fn probability(&self, number: f64) -> f64 {
        match self.kind {
            ModelKind::Joint if self.threshold >= self.largest => 0.0,
            ModelKind::Joint => probability(self.calibration, number),
            ModelKind::Direct => logistic(number),
        }
    }

    fn mutual_information(&self, members: &[f64]) -> Option<f64> {
        (self.kind == ModelKind::Joint).then(|| members.iter().sum::<f64>() / members.len() as f64)
    }

    /// Returns what every member puts out for states: mutual information in nats, or ln odds.
    fn outputs(&self, states: &[&StateKey]) -> Vec<Arc<[f64]>> {
        /// States of one share: large enough that sharing among threads costs little.
        const SHARE: usize = 128;
        let share = |states: &[&StateKey]| {
            let inputs = self.encoder.encode(states.iter().copied());
            let members: Vec<Vec<f64>> = self
                .members
                .iter()
                .map(|member| self.numbers(member, &inputs))
                .collect();
            (0..states.len())
                .map(|state| members.iter().map(|member| member[state]).collect())
                .collect::<Vec<_>>()
        };

        if states.len() <= SHARE {
            share(states)
        } else {
            states.par_chunks(SHARE).flat_map_iter(share).collect()
        }
    }

    fn numbers(&self, member: &Member, inputs: &Array2<f32>) -> Vec<f64> {
        match self.kind {
            ModelKind::Joint => member.information(inputs),
            ModelKind::Direct => member.ln_odds(inputs),
        }
    }

    /// Returns the names of the features whose bin in a state was not seen in training.
    pub fn out_of_range(&self, environment: &Environment, state: &StateKey) -> Vec<String> {
        self.seen
            .outside(state)
            .map(|feature| environment.schema.state()[feature].name.to_string())
            .collect()
    }

    /// Returns whether a prediction can decide anything: not at another threshold than the
    /// network's own, not where a bin of the state was not seen in training, and not where it has
    /// found nothing in the counts that it learned from.
    pub fn can_decide(&self, prediction: &Prediction) -> bool {
        self.found_something && prediction.in_range && prediction.probability.is_some()
    }

    /// Decides by a prediction: at the same confidence as for counts, only where the members agree,
    /// and only by what is said of this very state. Its odds must be at least three times, or at
    /// most a third, of those of a state about which nothing is known: both of those by the
    /// environment's fit, `unseen`, and of those that the network itself gives on average. Else one
    /// that says the same of every state would decide them all, and one that says too much of all
    /// would gain by the difference.
    pub fn decide(&self, prediction: &Prediction, confidence: f64, unseen: f64) -> Verdict {
        match prediction
            .probability
            .filter(|_| self.can_decide(prediction) && prediction.agrees)
        {
            Some(probability) => verdict(
                probability,
                confidence,
                [unseen, self.base_rate.unwrap_or(unseen)],
            ),
            None => Verdict::Undecided,
        }
    }

    /// Returns whether it predicts what each of the ego's actions does.
    pub fn tells_actions(&self) -> bool {
        self.kind == ModelKind::Joint
    }

    /// Predicts what each of the ego's actions does in a state, on average over what is held fixed;
    /// empty for a direct network. Divergences are in nats.
    pub fn by_action(&self, environment: &Environment, state: &StateKey) -> Vec<ModelAction> {
        let inputs = self.encoder.encode(std::iter::once(state));
        let members: Vec<Joint> = match self.kind {
            ModelKind::Joint => self
                .members
                .iter()
                .filter_map(|member| member.joint(&inputs).pop())
                .collect(),
            ModelKind::Direct => Vec::new(),
        };
        let Some(first) = members.first() else {
            return Vec::new();
        };
        let ego = &environment.schema.agents()[self.pair.ego];
        let mean = |figure: &dyn Fn(&Joint) -> f64| {
            members.iter().map(figure).sum::<f64>() / members.len() as f64
        };
        let action = |index: usize| ModelAction {
            index: index as u64,
            action: ego.action_label(index as u64),
            probability: mean(&|joint| joint.policy(index)),
            divergence: mean(&|joint| joint.given_action(index, |row| joint.divergence(row))),
            response: (0..first.response.ncols())
                .map(|other| {
                    mean(&|joint| joint.given_action(index, |row| joint.response[[row, other]]))
                })
                .collect(),
        };
        (0..first.actions()).map(action).collect()
    }
}

/// Returns the mean of probabilities, and whether all are on the same side of one half.
fn mean_and_agreement(probabilities: impl ExactSizeIterator<Item = f64>) -> (f64, bool) {
    let members = probabilities.len();
    let (sum, above) = probabilities.fold((0.0, 0), |(sum, above), p| {
        (sum + p, above + usize::from(p >= 0.5))
    });
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

/// Returns the verdict that a probability earns beside both of these base rates.
fn verdict(probability: f64, confidence: f64, bases: [f64; 2]) -> Verdict {
    let complement = 1.0 - probability;
    if probability >= confidence && bases.into_iter().all(|base| is_moved(base, probability)) {
        Verdict::Influences
    } else if complement >= confidence && bases.into_iter().all(|base| is_moved(probability, base))
    {
        Verdict::NoInfluence
    } else {
        Verdict::Undecided
    }
}

/// Returns whether the odds of the larger probability are at least three times those of the
/// smaller.
fn is_moved(smaller: f64, larger: f64) -> bool {
    smaller < larger && larger * (1.0 - smaller) >= MOVED * smaller * (1.0 - larger)
}

/// Returns 1 / (1 + e^-z).
pub fn logistic(z: f64) -> f64 {
    1.0 / (1.0 + (-z).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_says_the_same_of_every_state_decides_none() {
        for p in [0.0, 0.05, 0.8, 0.95, 1.0] {
            assert_eq!(
                verdict(p, 0.8, [0.3, p]),
                Verdict::Undecided,
                "{p} of every state"
            );
        }
        // Odds of 4 are three times those of 4/7, and less than those of .6.
        assert_eq!(verdict(0.8, 0.8, [0.02, 4.0 / 7.0]), Verdict::Influences);
        assert_eq!(verdict(0.8, 0.8, [0.02, 0.6]), Verdict::Undecided);
    }

    #[test]
    fn nobody_gains_by_saying_too_much_or_too_little_of_all() {
        // A third of its own odds, but more than the environment has.
        assert_eq!(verdict(0.05, 0.8, [0.02, 0.3]), Verdict::Undecided);
        assert_eq!(verdict(0.006, 0.8, [0.02, 0.3]), Verdict::NoInfluence);
        // Three times its own odds, but not the environment's.
        assert_eq!(verdict(0.9, 0.8, [0.8, 0.1]), Verdict::Undecided);
    }

    #[test]
    fn confidence_is_wanted_beside_it() {
        assert_eq!(verdict(0.79, 0.8, [0.01, 0.01]), Verdict::Undecided);
        assert_eq!(verdict(0.21, 0.8, [0.9, 0.9]), Verdict::Undecided);
    }
}
