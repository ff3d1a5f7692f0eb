//! Training of an ensemble by cross-validation: each member learns from all folds of the states but
//! its own, and is stopped by that one (early stopping).
//!
//! **When to stop.** A joint network is stopped where the held-out gain sum n_ij [ln p(j | i,
//! s) - ln p(j | s)] / N is largest: what its dependence is worth on states that it has not seen.
//! By total likelihood it would be stopped by how well it knows habits, at which time its
//! dependence is either too small or noise; on worlds without any influence such networks call some
//! states. A direct network is stopped by its held-out loss.

use std::ops::ControlFlow;

use ndarray::{Array1, Array2};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use super::dataset::{Dataset, Example, cells};
use super::encoder::Encoder;
use super::learner::{Batch, Learner, Shape};
use super::member::{Interaction, Member};
use super::permutation_test::PermutationTest;
use crate::domain::{ModelKind, Training, Weighting, shortest};

/// Dropout: shares of hidden units to leave out, of which the better on held-out states is taken.
const DROPOUTS: [f32; 2] = [0.5, 0.2];
/// States in a step (a mini-batch).
const BATCH: usize = 128;
/// Epochs from one look at the held-out part to the next.
const LOOK: usize = 5;
/// States that are looked at together.
const LOOKED_AT: usize = 512;
/// Epochs without a better look after which learning ends (early stopping).
const PATIENCE: usize = 50;

/// Fewer states or draws than these teach nothing.
const FEWEST_STATES: usize = 20;
const FEWEST_DRAWS: u64 = 200;

/// Why there is no network.
#[derive(Debug, thiserror::Error)]
pub enum TrainingError {
    /// There is too little to learn from.
    #[error("too few data: {0}")]
    TooFew(String),
    /// The loss is no number any more.
    #[error("the loss diverged: in epoch {0} it was no number any more")]
    Diverged(usize),
    /// Somebody ended it.
    #[error("cancelled")]
    Cancelled,
}

/// Is told how much of a training is done, 0 to 1, and says whether to go on.
pub type Watch<'a> = &'a mut dyn FnMut(f64) -> ControlFlow<()>;

/// A trained ensemble.
#[derive(Debug, Clone, PartialEq)]
pub struct Ensemble {
    /// How states become inputs.
    pub encoder: Encoder,
    /// The members, in the order of the parts that they did not learn from.
    pub members: Vec<Member>,
    /// Epochs after which each was best.
    pub epochs: Vec<u64>,
    /// The share of hidden units that was left out in a step.
    pub dropout: f64,
}

/// Says what is missing where there is too little to learn from.
pub fn check(dataset: &Dataset, training: &Training) -> Result<(), TrainingError> {
    let (states, draws) = (dataset.examples.len(), dataset.draws());
    let fewest = FEWEST_STATES.max(2 * training.folds);
    if states < fewest || draws < FEWEST_DRAWS {
        let found = format!("{states} states with {draws} independent draws");
        let expected = format!("at least {fewest} states and {FEWEST_DRAWS} draws");
        return Err(TrainingError::TooFew(format!(
            "got {found}, expected {expected}"
        )));
    }
    Ok(())
}

/// Returns the states that any member learns from: all, but that a single member has its own fold
/// held out.
pub fn learned<'d>(dataset: &'d Dataset, training: &Training) -> impl Iterator<Item = &'d Example> {
    let Training {
        members,
        folds,
        seed,
        ..
    } = *training;
    dataset
        .examples
        .iter()
        .filter(move |one| members > 1 || Dataset::fold(&one.key, folds, seed) != 0)
}

/// Trains an ensemble on a dataset: a member a fold, held out in turn.
pub fn train(
    dataset: &Dataset,
    encoder: &Encoder,
    training: &Training,
    watch: Watch<'_>,
) -> Result<Ensemble, TrainingError> {
    check(dataset, training)?;
    let trainer = Trainer {
        dataset,
        encoder,
        training,
    };

    let tries = tries(dataset, training);
    let parts = tries.len() + training.members - 1;
    let mut train = |part: usize, member: usize, tried: Tried| {
        trainer.train_member(member, tried, &mut |done: f64| {
            watch((part as f64 + done) / parts as f64)
        })
    };

    let mut best = tries[0];
    let mut first = train(0, 0, best)?;
    for (part, tried) in (1..).zip(&tries[1..]) {
        let trained = train(part, 0, *tried)?;
        if trained.fit > first.fit {
            (first, best) = (trained, *tried);
        }
    }

    let mut trained = vec![first];
    for member in 1..training.members {
        trained.push(train(tries.len() + member - 1, member, best)?);
    }

    let epochs = trained.iter().map(|trained| trained.epochs).collect();
    let members = trained.into_iter().map(|trained| trained.member).collect();
    Ok(Ensemble {
        encoder: encoder.clone(),
        members,
        epochs,
        dropout: shortest(best.dropout),
    })
}

/// What is chosen by how the first member does with it on states that it has not seen.
#[derive(Clone, Copy)]
struct Tried {
    /// The share of hidden units that is left out in a step.
    dropout: f32,
    interaction: Interaction,
}

/// Returns what is tried: where strata may differ, whether they do.
fn tries(dataset: &Dataset, training: &Training) -> Vec<Tried> {
    let is_stratified = dataset.letters.strata > 1 && training.kind == ModelKind::Joint;
    let interactions: &[Interaction] = match is_stratified {
        true => &[Interaction::Shared, Interaction::ByStratum],
        false => &[Interaction::Shared],
    };
    let with = |interaction: &Interaction| {
        let interaction = *interaction;
        DROPOUTS.map(|dropout| Tried {
            dropout,
            interaction,
        })
    };
    interactions.iter().flat_map(with).collect()
}

/// A member as it was when it did best.
struct Trained {
    member: Member,
    /// Epochs until then.
    epochs: u64,
    /// How well it tells its held-out part: the log-likelihood of what the other did there, or less
    /// its loss.
    fit: f64,
}

/// The best network so far, by its held-out score.
struct Best {
    score: f64,
    member: Member,
    epoch: usize,
}

/// Trains members, which have all of this in common.
struct Trainer<'a> {
    dataset: &'a Dataset,
    encoder: &'a Encoder,
    training: &'a Training,
}

impl Trainer<'_> {
    /// Trains one member, until its held-out fold gains no more.
    fn train_member(
        &self,
        member: usize,
        tried: Tried,
        watch: Watch<'_>,
    ) -> Result<Trained, TrainingError> {
        let Training { seed, epochs, .. } = *self.training;
        let (held_out, mut learned) = self.split(member)?;
        let mut random = Pcg64::seed_from_u64(seed.wrapping_mul(31).wrapping_add(member as u64));
        let mut learner = Learner::new(
            self.shape(tried.interaction),
            tried.dropout,
            seed.wrapping_add(1_000 * (member as u64 + 1)),
        );
        if let Some(habits) = self.habits(&learned, learner.outputs()) {
            learner = learner.with_biases(habits);
        }

        let mut best: Option<Best> = None;
        for epoch in 1..=epochs {
            let mut goes_on = || watch((epoch - 1) as f64 / epochs as f64).is_continue();
            learned.shuffle(&mut random);
            self.epoch(&mut learner, &learned, epoch, &mut goes_on)?;
            if epoch % LOOK != 0 && epoch != epochs {
                continue;
            }

            let now = learner.member();
            let score = self.held_out_score(&now, &held_out);
            if !score.is_finite() {
                return Err(TrainingError::Diverged(epoch));
            }
            if best.as_ref().is_none_or(|best| score > best.score) {
                best = Some(Best {
                    score,
                    member: now,
                    epoch,
                });
            }
            if best
                .as_ref()
                .is_some_and(|best| epoch - best.epoch >= PATIENCE)
            {
                break;
            }
        }

        let best = best.ok_or(TrainingError::Diverged(epochs))?;
        Ok(Trained {
            fit: self.fit(&best.member, &held_out),
            epochs: best.epoch as u64,
            member: self.proven(best.member, &held_out),
        })
    }

    /// Splits the states, by position, into those that a member is stopped by and those that it
    /// learns from.
    fn split(&self, member: usize) -> Result<(Vec<usize>, Vec<usize>), TrainingError> {
        let Training { folds, seed, .. } = *self.training;
        let examples = &self.dataset.examples;
        let (held_out, learned): (Vec<usize>, Vec<usize>) = (0..examples.len())
            .partition(|at| Dataset::fold(&examples[*at].key, folds, seed) == member);

        if held_out.is_empty() || learned.is_empty() {
            return Err(TrainingError::TooFew(
                "a part of the states is empty; fewer folds make larger ones".into(),
            ));
        }
        Ok((held_out, learned))
    }

    /// Returns a joint network without its interaction, unless what it has learned of dependence
    /// gains something on states that it has not seen: chance that was learned by heart (an
    /// overfit) must not be served.
    fn proven(&self, mut member: Member, states: &[usize]) -> Member {
        if self.training.kind != ModelKind::Joint {
            return member;
        }

        let mut test = PermutationTest::new(self.dataset.letters);
        for part in states.chunks(LOOKED_AT) {
            let joints = member.joint(&self.inputs(part));
            self.examples(part)
                .zip(&joints)
                .for_each(|(example, joint)| test.add(&example.table, joint));
        }

        if !test.is_more_than_chance() {
            member.forget_interaction();
        }
        member
    }

    /// Returns what a joint network at a lag begins with: what is done on the whole, in each stratum,
    /// in the states that it learns from. What the other does after its own action is often nearly
    /// certain, and by steps from nothing that is learned long after learning has ended.
    fn habits(&self, learned: &[usize], outputs: usize) -> Option<Array1<f32>> {
        let letters = self.dataset.letters;
        if letters.strata == 1 || self.training.kind != ModelKind::Joint {
            return None;
        }

        let (rows, columns) = (
            letters.actions.rows as usize,
            letters.actions.columns as usize,
        );
        let [mut own, mut ego, mut other] =
            [1, rows, columns].map(|each| vec![0.5; letters.strata as usize * each]);
        for example in self.examples(learned) {
            for (row, column, n) in cells(&example.table) {
                let stratum = row / rows;
                own[stratum] += n;
                ego[row] += n;
                other[stratum * columns + column] += n;
            }
        }

        let mut biases = ln_shares(&own);
        biases.extend(ego.chunks(rows).flat_map(ln_shares));
        biases.extend(other.chunks(columns).flat_map(ln_shares));
        biases.resize(outputs, 0.0);
        Some(Array1::from_vec(biases))
    }

    fn shape(&self, interaction: Interaction) -> Shape {
        let Training { kind, width, .. } = *self.training;
        Shape {
            kind,
            letters: self.dataset.letters,
            interaction,
            width,
            inputs: self.encoder.width(),
        }
    }

    fn epoch(
        &self,
        learner: &mut Learner,
        learned: &[usize],
        epoch: usize,
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Result<(), TrainingError> {
        // What is left over after whole batches has its turn in another order.
        for states in learned.chunks_exact(BATCH.min(learned.len())) {
            if !goes_on() {
                return Err(TrainingError::Cancelled);
            }
            if !learner.step(&self.batch(states)).is_finite() {
                return Err(TrainingError::Diverged(epoch));
            }
        }
        Ok(())
    }

    fn batch(&self, states: &[usize]) -> Batch {
        let weights = self
            .examples(states)
            .map(|example| self.weight(example))
            .collect();

        let targets = match self.training.kind {
            ModelKind::Joint => draws(self.dataset, states),
            ModelKind::Direct => {
                let above: Vec<f32> = self
                    .examples(states)
                    .map(|example| example.above as f32)
                    .collect();
                Array2::from_shape_vec((states.len(), 1), above).expect("one a state")
            }
        };

        Batch {
            inputs: self.inputs(states),
            targets,
            weights,
        }
    }

    fn examples<'s>(&'s self, states: &'s [usize]) -> impl ExactSizeIterator<Item = &'s Example> {
        states.iter().map(|at| &self.dataset.examples[*at])
    }

    /// Returns the inputs of states: `[states, inputs]`. They are made for each use, since those of
    /// all states would fill the memory.
    fn inputs(&self, states: &[usize]) -> Array2<f32> {
        self.encoder
            .encode(self.examples(states).map(|example| &example.key))
    }

    fn weight(&self, example: &Example) -> f32 {
        match (self.training.kind, self.training.weighting) {
            (ModelKind::Direct, Weighting::Visits) => example.table.total() as f32,
            _ => 1.0,
        }
    }

    /// Returns what a network is worth on states that it has not learned from: the more the better.
    fn held_out_score(&self, member: &Member, states: &[usize]) -> f64 {
        states
            .chunks(LOOKED_AT)
            .map(|part| self.score_of_part(member, part))
            .sum()
    }

    /// Returns how well a network tells states that it has not learned from.
    fn fit(&self, member: &Member, states: &[usize]) -> f64 {
        states
            .chunks(LOOKED_AT)
            .map(|part| self.fit_of_part(member, part))
            .sum()
    }

    fn fit_of_part(&self, member: &Member, states: &[usize]) -> f64 {
        match self.training.kind {
            ModelKind::Joint => {
                let joints = member.joint(&self.inputs(states));
                let states = self.examples(states).zip(&joints);
                states
                    .map(|(example, joint)| joint.log_likelihood(&example.table))
                    .sum()
            }
            ModelKind::Direct => self.score_of_part(member, states),
        }
    }

    fn score_of_part(&self, member: &Member, states: &[usize]) -> f64 {
        let (examples, inputs) = (self.examples(states), self.inputs(states));
        match self.training.kind {
            ModelKind::Joint => examples
                .zip(member.joint(&inputs))
                .map(|(example, joint)| joint.gain(&example.table))
                .sum(),
            ModelKind::Direct => {
                let loss = |(example, z): (&Example, f64)| {
                    f64::from(self.weight(example)) * cross_entropy(example.above, z)
                };
                -examples.zip(member.ln_odds(&inputs)).map(loss).sum::<f64>()
            }
        }
    }
}

/// Returns the log loss -p ln q - (1 - p) ln(1 - q), q = logistic(z), in a form that overflows
/// nowhere.
fn cross_entropy(p: f64, z: f64) -> f64 {
    z.max(0.0) - p * z + (-z.abs()).exp().ln_1p()
}

/// Returns the logarithm of each share of a sum.
fn ln_shares(counts: &[f64]) -> Vec<f32> {
    let sum: f64 = counts.iter().sum();
    counts.iter().map(|n| (n / sum).ln() as f32).collect()
}

/// Returns how often each pair of actions was drawn: `[states, ego x other]`, at a lag in each
/// stratum.
fn draws(dataset: &Dataset, states: &[usize]) -> Array2<f32> {
    let columns = dataset.letters.actions.columns as usize;
    let mut draws = Array2::zeros((states.len(), dataset.letters.cells() as usize));
    for (mut row, at) in draws.rows_mut().into_iter().zip(states) {
        cells(&dataset.examples[*at].table).for_each(|(i, j, n)| row[i * columns + j] = n as f32);
    }
    draws
}
