//! What a network says of itself: judged by the evidence on states that it has not learned from, beside what it has to beat.

use ndarray::Axis;

use super::back_off::BackOff;
use super::calibrate::calibrated;
use super::dataset::{Dataset, Example, cells};
use super::member::{Joint, Member};
use super::network::{ln_information, logistic, probability};
use super::score::{Judged, reliability, score};
use super::training::Ensemble;
use super::worth::is_worth_something;
use crate::domain::{Baseline, Calibration, Card, ModelKind, Score, Training, Weighting};
use crate::evidence::{Expected, factors};

/// Draws of a state from which its evidence is a truth to be judged by: of rarely seen states it says little but what all states have on average, and
/// whoever says the same of every state would win.
const ENOUGH: u64 = 8;

/// Which of the members judges each state: the one that did not learn from it.
pub enum Split<'a> {
    /// By the parts of the training.
    HeldOut(&'a Training),
    /// All members: nobody knows what they learned from.
    Unknown,
}

impl Split<'_> {
    /// Returns the states that are judged, each with the members that judge it: by position.
    fn states(&self, dataset: &Dataset, members: usize) -> Vec<(usize, std::ops::Range<usize>)> {
        let all = dataset.examples.iter().enumerate();
        match self {
            Self::Unknown => all.map(|(at, _)| (at, 0..members)).collect(),
            Self::HeldOut(training) => {
                let fold = |example: &Example| Dataset::fold(&example.key, training.folds, training.seed);
                let judged = all.map(|(at, example)| (at, fold(example))).filter(|(_, fold)| *fold < members);
                judged.map(|(at, fold)| (at, fold..fold + 1)).collect()
            }
        }
    }

    fn told(&self) -> String {
        match self {
            Self::Unknown => {
                "trained elsewhere: it was judged on every state here, and may have learned from some of them".into()
            }
            Self::HeldOut(Training { folds, members, .. }) => format!(
                "states were cut into {folds} parts by key; each of {members} members learned from all but its own part, was stopped by that part, \
                 and judged on it"
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
    let court = Court::new(dataset, training, split.states(dataset, ensemble.members.len()));
    let network = court.verdicts(ensemble);
    let calibration = court.calibration(&network);
    let twin = shuffled.map(|shuffled| court.verdicts(shuffled));
    let judged = court.judged(&network, calibration);
    let own = score("network", &judged, court.log_likelihood(&network));
    let mut baselines = court.simple_baselines();
    if let Some(twin) = &twin {
        let judged = court.judged(twin, court.calibration(twin));
        baselines.push(score(Baseline::Shuffled.as_str(), &judged, court.log_likelihood(twin)));
    }
    let better = |baseline: &&Score| !is_better(&own, baseline);
    let mut not_better_than: Vec<String> =
        baselines.iter().filter(better).map(|baseline| baseline.name.clone()).collect();
    let shuffled = Baseline::Shuffled.as_str();
    if !court.has_found_something(&network, twin.as_deref().unwrap_or_default())
        && !not_better_than.iter().any(|name| name == shuffled)
    {
        not_better_than.push(shuffled.to_owned());
    }
    Card {
        training,
        imported: matches!(split, Split::Unknown),
        schema_hash: String::new(),
        threshold: dataset.threshold,
        revision: dataset.revision,
        fit: dataset.fit(),
        states: dataset.examples.len() as u64,
        visits: dataset.draws(),
        inputs: ensemble.encoder.width() as u64,
        split: split.told(),
        epochs: ensemble.epochs.clone(),
        judged_states: judged.len() as u64,
        positive_share: positive_share(&judged),
        calibration,
        score: own,
        baselines,
        reliability: reliability(&judged),
        not_better_than,
    }
}

/// Returns whether a network is better than a baseline: by the likelihood of what the other did, where both tell it, else by the squared error of the
/// probabilities. The former is measured on the counts themselves, the latter on what the evidence makes of them.
fn is_better(network: &Score, baseline: &Score) -> bool {
    match (network.log_likelihood, baseline.log_likelihood) {
        (Some(own), Some(other)) => own > other,
        _ => network.brier < baseline.brier,
    }
}

/// What was said of one judged state by those who did not learn from it.
struct Said {
    /// Mutual information in nats by each judging member, or its ln odds where it predicts nothing else.
    numbers: Vec<f64>,
    /// What both agents do, by a joint network.
    joint: Option<Joint>,
}

/// The states that are judged, and by whom.
struct Court<'a> {
    dataset: &'a Dataset,
    training: Training,
    /// Draws from which a state is scored.
    enough: u64,
    states: Vec<(usize, std::ops::Range<usize>)>,
}

impl<'a> Court<'a> {
    fn new(dataset: &'a Dataset, training: Training, states: Vec<(usize, std::ops::Range<usize>)>) -> Self {
        let most = states.iter().map(|(at, _)| dataset.examples[*at].table.total()).max().unwrap_or(0);
        Self { dataset, training, enough: if most < ENOUGH { 0 } else { ENOUGH }, states }
    }

    fn examples(&self) -> impl Iterator<Item = &'a Example> {
        self.states.iter().map(|(at, _)| &self.dataset.examples[*at])
    }

    fn weight(&self, example: &Example) -> f64 {
        match self.training.weighting {
            Weighting::Visits => example.table.total() as f64,
            Weighting::States => 1.0,
        }
    }

    /// Lets every state be told by the members that judge it.
    fn verdicts(&self, ensemble: &Ensemble) -> Vec<Said> {
        let keys: Vec<_> = self.examples().map(|example| example.key.clone()).collect();
        let inputs = ensemble.encoder.encode(&keys);
        let mut said: Vec<Said> = keys.iter().map(|_| Said { numbers: Vec::new(), joint: None }).collect();
        for (member, network) in ensemble.members.iter().enumerate() {
            let of = |at: &usize| self.states[*at].1.contains(&member);
            let judged: Vec<usize> = (0..self.states.len()).filter(of).collect();
            self.hear(network, &inputs.select(Axis(0), &judged), judged, &mut said);
        }
        said
    }

    fn hear(&self, network: &Member, inputs: &ndarray::Array2<f32>, judged: Vec<usize>, said: &mut [Said]) {
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

    /// Fits a joint network's calibration; a direct one needs none.
    fn calibration(&self, said: &[Said]) -> Calibration {
        if self.training.kind == ModelKind::Direct {
            return Calibration { intercept: 0.0, slope: 1.0 };
        }
        let told: Vec<(&Example, &Joint)> =
            self.examples().zip(said).filter_map(|(example, said)| Some((example, said.joint.as_ref()?))).collect();
        let responses: Vec<Vec<f64>> = told.iter().map(|(_, joint)| joint.response.iter().copied().collect()).collect();
        let states: Vec<Expected<'_>> = told
            .iter()
            .zip(&responses)
            .map(|((example, joint), response)| Expected { table: &example.table, ego: &joint.ego, response })
            .collect();
        let factors =
            factors(&states, self.dataset.alphabet, &self.dataset.base(&self.dataset.examples), self.dataset.threshold);
        let numbers = said.iter().map(|said| ln_information(mean(&said.numbers)));
        calibrated(&numbers.zip(factors).collect::<Vec<_>>())
    }

    fn judged(&self, said: &[Said], calibration: Calibration) -> Vec<Judged> {
        let probability = |number: &f64| match self.training.kind {
            ModelKind::Joint => probability(calibration, *number),
            ModelKind::Direct => logistic(*number),
        };
        let predicted = |said: &Said| mean(&said.numbers.iter().map(probability).collect::<Vec<f64>>());
        self.examples().zip(said).filter_map(|(example, said)| self.judge(example, predicted(said))).collect()
    }

    /// Puts a prediction beside the evidence of a state, if that has enough draws.
    fn judge(&self, example: &Example, predicted: f64) -> Option<Judged> {
        let judged = Judged { predicted, evidence: example.above, weight: self.weight(example) };
        (example.table.total() >= self.enough).then_some(judged)
    }

    /// Returns the mean of ln p(other's action | ego's action) over all draws.
    fn log_likelihood(&self, said: &[Said]) -> Option<f64> {
        let of = |(example, said): (&Example, &Said)| {
            let joint = said.joint.as_ref()?;
            Some(cells(&example.table).map(|(i, j, n)| n * joint.response[[i, j]].ln()).sum::<f64>())
        };
        let sums: Option<Vec<f64>> = self.examples().zip(said).map(of).collect();
        self.per_draw(sums?.into_iter().sum())
    }

    fn per_draw(&self, sum: f64) -> Option<f64> {
        let draws: u64 = self.examples().map(|example| example.table.total()).sum();
        (draws > 0).then(|| sum / draws as f64)
    }

    /// Returns whether a network has found something: a joint one, if its dependence is worth more than chance; a direct one, if its squared error is
    /// below that of its shuffled twin by more than chance.
    fn has_found_something(&self, network: &[Said], twin: &[Said]) -> bool {
        match self.training.kind {
            ModelKind::Joint => {
                let tables = self.examples().map(|example| &example.table);
                is_worth_something(tables.zip(network.iter().filter_map(|said| said.joint.as_ref())))
            }
            ModelKind::Direct => {
                let error = |example: &Example, said: &Said| {
                    let (q, y) = (logistic(mean(&said.numbers)), example.above);
                    self.weight(example) * (y * (1.0 - q).powi(2) + (1.0 - y) * q * q)
                };
                let pairs = self.examples().zip(network.iter().zip(twin));
                is_above_zero(
                    &pairs
                        .map(|(example, (own, other))| error(example, other) - error(example, own))
                        .collect::<Vec<_>>(),
                )
            }
        }
    }

    /// Scores what needs no network; each learns from the parts that a state is not in.
    fn simple_baselines(&self) -> Vec<Score> {
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
            let learned: Vec<usize> = (0..self.dataset.examples.len()).filter(|at| fold(*at) != part).collect();
            let average = self.average(&learned);
            let back_off = BackOff::new(self.dataset, &learned);
            for example in here {
                let table = back_off.table(&example.key);
                sums[0] += back_off.log_likelihood(None, example);
                sums[1] += back_off.log_likelihood(table, example);
                let told = table.map_or(average, |table| self.dataset.above(table));
                for (judged, predicted) in judged.iter_mut().zip([1.0, average, told]) {
                    judged.extend(self.judge(example, predicted));
                }
            }
        }
        let joint = self.training.kind == ModelKind::Joint;
        let [average, back_off] = sums.map(|sum| self.per_draw(sum).filter(|_| joint));
        let [all, majority, coarser] = &judged;
        vec![
            score(Baseline::AllPositive.as_str(), all, None),
            score(Baseline::Majority.as_str(), majority, average),
            // A held-out state was not seen by anybody: the table of what was seen in it is empty.
            score(Baseline::LookUp.as_str(), majority, average),
            score(Baseline::BackOff.as_str(), coarser, back_off),
        ]
    }

    fn average(&self, learned: &[usize]) -> f64 {
        let examples = || learned.iter().map(|at| &self.dataset.examples[*at]);
        let total: f64 = examples().map(|example| self.weight(example)).sum();
        examples().map(|example| self.weight(example) * example.above).sum::<f64>() / total.max(f64::MIN_POSITIVE)
    }
}

/// Returns whether the mean of differences is above zero by three standard errors.
fn is_above_zero(differences: &[f64]) -> bool {
    let n = differences.len() as f64;
    let mean = mean(differences);
    let variance = differences.iter().map(|difference| (difference - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    mean > 3.0 * (variance / n.max(1.0)).sqrt()
}

fn positive_share(judged: &[Judged]) -> f64 {
    let total: f64 = judged.iter().map(|one| one.weight).sum();
    judged.iter().map(|one| one.weight * one.evidence).sum::<f64>() / total.max(f64::MIN_POSITIVE)
}

fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len().max(1) as f64
}
