//! Held-out evaluation: what a network, its shuffled twin (the control) and baselines without a
//! network predict of states that they did not learn from.

use std::borrow::Cow;

use ndarray::Array2;

use super::back_off::BackOff;
use super::calibration::fit_calibration;
use super::dataset::{Dataset, Example};
use super::member::{Joint, Member};
use super::network::{ln_information, logistic, probability};
use super::permutation_test::PermutationTest;
use super::score::{Judged, score};
use super::training::Ensemble;
use crate::domain::{Baseline, Calibration, ModelKind, Score, Training, Weighting};
use crate::evidence::{ExpectedResponse, ExpectedState, bayes_factors};
use crate::information::Table;

/// Draws of a state from which its evidence is a truth to be calibrated and judged by: of rarely
/// seen states it says little but what all states have on average, and whoever says the same of
/// every state would win.
const ENOUGH: u64 = 8;

/// What was said of one judged state by those who did not learn from it.
pub struct HeldOutPrediction {
    /// Mutual information in nats by each judging member, or its ln odds where it predicts nothing
    /// else.
    numbers: Vec<f64>,
    /// What both agents do, by a joint network.
    joint: Option<Joint>,
}

/// The held-out states, and the members that predict each.
pub struct HeldOutEvaluation<'a> {
    dataset: &'a Dataset,
    training: Training,
    /// Draws from which a state is scored.
    enough: u64,
    states: Vec<(usize, std::ops::Range<usize>)>,
}

impl<'a> HeldOutEvaluation<'a> {
    /// Prepares the evaluation of states, each with the members that did not learn from it.
    pub fn new(
        dataset: &'a Dataset,
        training: Training,
        states: Vec<(usize, std::ops::Range<usize>)>,
    ) -> Self {
        let most = states
            .iter()
            .map(|(at, _)| dataset.examples[*at].table.total())
            .max()
            .unwrap_or(0);
        Self {
            dataset,
            training,
            enough: if most < ENOUGH { 0 } else { ENOUGH },
            states,
        }
    }

    fn examples(&self) -> impl Iterator<Item = &'a Example> {
        self.states
            .iter()
            .map(|(at, _)| &self.dataset.examples[*at])
    }

    fn weight(&self, example: &Example) -> f64 {
        match self.training.weighting {
            Weighting::Visits => example.table.total() as f64,
            Weighting::States => 1.0,
        }
    }

    /// Predicts every state by the members that did not learn from it.
    pub fn predict(&self, ensemble: &Ensemble) -> Vec<HeldOutPrediction> {
        let mut said: Vec<HeldOutPrediction> = self
            .states
            .iter()
            .map(|_| HeldOutPrediction {
                numbers: Vec::new(),
                joint: None,
            })
            .collect();

        for (member, network) in ensemble.members.iter().enumerate() {
            let of = |at: &usize| self.states[*at].1.contains(&member);
            let judged: Vec<usize> = (0..self.states.len()).filter(of).collect();
            let keys = judged
                .iter()
                .map(|at| &self.dataset.examples[self.states[*at].0].key);
            self.add_predictions(network, &ensemble.encoder.encode(keys), judged, &mut said);
        }
        said
    }

    fn add_predictions(
        &self,
        network: &Member,
        inputs: &Array2<f32>,
        judged: Vec<usize>,
        said: &mut [HeldOutPrediction],
    ) {
        match self.training.kind {
            ModelKind::Joint => {
                for (at, joint) in judged.into_iter().zip(network.joint(inputs)) {
                    let others = said[at].numbers.len() as f64;
                    said[at].numbers.push(joint.mutual_information());
                    said[at].joint = Some(match said[at].joint.take() {
                        Some(mean) => mean.mixed_with(&joint, 1.0 / (others + 1.0)),
                        None => joint,
                    });
                }
            }
            ModelKind::Direct => {
                for (at, z) in judged.into_iter().zip(network.ln_odds(inputs)) {
                    said[at].numbers.push(z);
                }
            }
        }
    }

    /// Fits a joint network's calibration (Platt scaling), to the states with enough draws and to
    /// no others; a direct one needs none.
    pub fn calibration(&self, said: &[HeldOutPrediction]) -> Calibration {
        if self.training.kind == ModelKind::Direct {
            return Calibration {
                intercept: 0.0,
                slope: 1.0,
            };
        }
        let often = self
            .examples()
            .zip(said)
            .filter(|(example, _)| example.table.total() >= ENOUGH);
        let (numbers, tables): (Vec<f64>, Vec<_>) = often
            .filter_map(|(example, said)| {
                let joint = said.joint.as_ref()?;
                let strata = self.dataset.letters.strata_of(&example.table);
                Some((ln_information(mean(&said.numbers)), (strata, joint)))
            })
            .unzip();
        let unseen = Table::default();
        let states: Vec<ExpectedState<'_>> = tables
            .iter()
            .map(|(strata, joint)| expected(strata, joint, &unseen))
            .collect();

        let base = self.dataset.base(&self.dataset.examples);
        let factors = bayes_factors(
            &states,
            self.dataset.letters.actions,
            &base,
            self.dataset.threshold,
        );
        fit_calibration(&numbers.into_iter().zip(factors).collect::<Vec<_>>())
    }

    /// Returns what a network says of a state on average: of all that were told, each once, however
    /// rarely it was seen.
    pub fn base_rate(&self, said: &[HeldOutPrediction], calibration: Calibration) -> Option<f64> {
        let told: Vec<f64> = said
            .iter()
            .map(|said| self.predicted(said, calibration))
            .collect();
        (!told.is_empty()).then(|| mean(&told))
    }

    /// Returns predictions beside the evidence of the states with enough draws.
    pub fn judged(&self, said: &[HeldOutPrediction], calibration: Calibration) -> Vec<Judged> {
        let paired = |(example, said): (&Example, &HeldOutPrediction)| {
            self.with_evidence(example, self.predicted(said, calibration))
        };
        self.examples().zip(said).filter_map(paired).collect()
    }

    /// Returns the mean of the probabilities of the members that judge a state.
    fn predicted(&self, said: &HeldOutPrediction, calibration: Calibration) -> f64 {
        let probability = |number: &f64| match self.training.kind {
            ModelKind::Joint => probability(calibration, *number),
            ModelKind::Direct => logistic(*number),
        };
        mean(&said.numbers.iter().map(probability).collect::<Vec<f64>>())
    }

    /// Pairs a prediction with the evidence of a state, if that has enough draws.
    fn with_evidence(&self, example: &Example, predicted: f64) -> Option<Judged> {
        let judged = Judged {
            predicted,
            evidence: example.above,
            weight: self.weight(example),
        };
        (example.table.total() >= self.enough).then_some(judged)
    }

    /// Returns the mean of ln p(other's action | ego's action) over all draws.
    pub fn log_likelihood(&self, said: &[HeldOutPrediction]) -> Option<f64> {
        let of = |(example, said): (&Example, &HeldOutPrediction)| {
            let joint = said.joint.as_ref()?;
            Some(joint.log_likelihood(&example.table))
        };
        let sums: Option<Vec<f64>> = self.examples().zip(said).map(of).collect();
        self.per_draw(sums?.into_iter().sum())
    }

    fn per_draw(&self, sum: f64) -> Option<f64> {
        let draws: u64 = self.examples().map(|example| example.table.total()).sum();
        (draws > 0).then(|| sum / draws as f64)
    }

    /// Returns whether a network has found something: a joint one, if its dependence is worth more
    /// than chance; a direct one, if its squared error is below that of the average, and of its
    /// shuffled twin where it has one, by more than chance.
    pub fn has_found_something(
        &self,
        network: &[HeldOutPrediction],
        twin: Option<&[HeldOutPrediction]>,
    ) -> bool {
        if self.training.kind == ModelKind::Joint {
            let mut test = PermutationTest::new(self.dataset.letters);
            for (example, said) in self.examples().zip(network) {
                said.joint
                    .iter()
                    .for_each(|joint| test.add(&example.table, joint));
            }
            return test.is_more_than_chance();
        }

        let average = self.average(&(0..self.dataset.examples.len()).collect::<Vec<_>>());

        let told = |said: &HeldOutPrediction| {
            mean(
                &said
                    .numbers
                    .iter()
                    .copied()
                    .map(logistic)
                    .collect::<Vec<_>>(),
            )
        };
        self.errs_less(network.iter().map(told), network.iter().map(|_| average))
            && twin
                .is_none_or(|twin| self.errs_less(network.iter().map(told), twin.iter().map(told)))
    }

    /// Returns whether the squared errors of one are below those of another by more than chance.
    fn errs_less(&self, one: impl Iterator<Item = f64>, other: impl Iterator<Item = f64>) -> bool {
        let difference = |(example, (one, other)): (&Example, (f64, f64))| {
            let error = |q: f64| example.above * (1.0 - q).powi(2) + (1.0 - example.above) * q * q;
            self.weight(example) * (error(other) - error(one))
        };
        is_above_zero(
            &self
                .examples()
                .zip(one.zip(other))
                .map(difference)
                .collect::<Vec<_>>(),
        )
    }

    /// Scores what needs no network; each learns from the parts that a state is not in.
    pub fn simple_baselines(&self) -> Vec<Score> {
        let Training { folds, seed, .. } = self.training;
        let fold = |at: usize| Dataset::fold(&self.dataset.examples[at].key, folds, seed);

        let mut sums = [0.0; 2];
        let mut judged: [Vec<Judged>; 3] = Default::default();
        for part in 0..folds {
            let here: Vec<&Example> = self
                .states
                .iter()
                .filter(|(at, _)| fold(*at) == part)
                .map(|(at, _)| &self.dataset.examples[*at])
                .collect();
            if here.is_empty() {
                continue;
            }

            let learned: Vec<usize> = (0..self.dataset.examples.len())
                .filter(|at| fold(*at) != part)
                .collect();
            let average = self.average(&learned);
            let back_off = BackOff::new(self.dataset, &learned);

            for example in here {
                let table = back_off.table(&example.key);
                sums[0] += back_off.log_likelihood(None, example);
                sums[1] += back_off.log_likelihood(table, example);
                let told = table.map_or(average, |table| self.dataset.above(table));
                for (judged, predicted) in judged.iter_mut().zip([1.0, average, told]) {
                    judged.extend(self.with_evidence(example, predicted));
                }
            }
        }

        let joint = self.training.kind == ModelKind::Joint;
        let [average, back_off] = sums.map(|sum| self.per_draw(sum).filter(|_| joint));
        let [all, majority, coarser] = &judged;
        // The average of the other parts is low where that of the own is high: that is no ranking.
        let unranked = |name: &str| Score {
            auroc: None,
            ..score(name, majority, average)
        };

        vec![
            score(Baseline::AllPositive.as_str(), all, None),
            unranked(Baseline::Majority.as_str()),
            // A held-out state was not seen by anybody: the table of what was seen in it is empty.
            unranked(Baseline::LookUp.as_str()),
            score(Baseline::BackOff.as_str(), coarser, back_off),
        ]
    }

    fn average(&self, learned: &[usize]) -> f64 {
        let examples = || learned.iter().map(|at| &self.dataset.examples[*at]);
        let total: f64 = examples().map(|example| self.weight(example)).sum();
        examples()
            .map(|example| self.weight(example) * example.above)
            .sum::<f64>()
            / total.max(f64::MIN_POSITIVE)
    }
}

/// Returns what a network expects of every stratum of a state, beside the tables of those that were
/// seen.
fn expected<'a>(
    seen: &'a [(u64, Cow<'_, Table>)],
    joint: &'a Joint,
    unseen: &'a Table,
) -> ExpectedState<'a> {
    let (actions, columns) = (joint.actions(), joint.response.ncols());
    let response = joint.response.as_slice().expect("it is made row by row");
    let strata = joint
        .ego
        .chunks(actions)
        .zip(response.chunks(actions * columns))
        .zip(&joint.own);

    let table = |stratum: u64| {
        let found = seen.iter().find(|(number, _)| *number == stratum);
        found.map_or(unseen, |(_, table)| table)
    };
    (0..)
        .zip(strata)
        .map(|(stratum, ((ego, response), share))| ExpectedResponse {
            table: table(stratum),
            share: *share,
            ego,
            response,
        })
        .collect()
}

/// Returns whether the mean of differences is above zero by three standard errors.
fn is_above_zero(differences: &[f64]) -> bool {
    let n = differences.len() as f64;
    let mean = mean(differences);
    let variance = differences
        .iter()
        .map(|difference| (difference - mean).powi(2))
        .sum::<f64>()
        / (n - 1.0).max(1.0);

    mean > 3.0 * (variance / n.max(1.0)).sqrt()
}

fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len().max(1) as f64
}
