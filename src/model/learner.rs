//! Stochastic gradient descent on one network: the forward pass with dropout, the loss, its
//! gradient by back-propagation, a step of AdamW.
//!
//! With hidden layer h = relu(x W^T + b) * mask and outputs y = h V^T + c, of a gradient G = dL/dy
//! follow dL/dV = G^T h, dL/dc = sum of G over states, dL/dh = G V, and from that, where h is above
//! 0, dL/dW and dL/db alike. All heads are one layer here, so that each of these is one product.
//!
//! All work is done on the calling thread in a fixed order, so that the same seed gives the same
//! bits and those who ask questions keep the other cores.

use ndarray::linalg::general_mat_mul;
use ndarray::{Array1, Array2, ArrayView2, Axis, Ix1, Ix2, Slice, concatenate};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::adam::{Parameter, Step};
use super::letters::Letters;
use super::loss::{binary_cross_entropy, joint_cross_entropy};
use super::member::{Interaction, Layer, Member, heads};
use crate::domain::ModelKind;

/// A network's form.
#[derive(Debug, Clone)]
pub struct Shape {
    /// What it predicts.
    pub kind: ModelKind,
    /// How many actions the two have, and what is held fixed.
    pub letters: Letters,
    /// How the ego's action acts on the other's.
    pub interaction: Interaction,
    /// Units of the hidden layer.
    pub width: usize,
    /// Numbers that a state is.
    pub inputs: usize,
}

impl Shape {
    fn heads(&self) -> Vec<(&'static str, usize)> {
        heads(self.kind, self.letters, self.interaction)
    }
}

/// States that are learned from in one step (a mini-batch).
pub struct Batch {
    /// `[states, inputs]`.
    pub inputs: Array2<f32>,
    /// For a joint network `[states, ego x other]`, how often each pair of actions was drawn, at a
    /// lag in each stratum; for a direct one `[states, 1]`, P(MI > threshold).
    pub targets: Array2<f32>,
    /// How much each state counts: its draws in a joint network's targets are counted already, and
    /// this is 1.
    pub weights: Vec<f32>,
}

/// A network that learns.
pub struct Learner {
    shape: Shape,
    /// The share of hidden units that are left out in a step.
    dropout: f32,
    /// From the inputs to the hidden layer.
    trunk: Linear,
    /// From the hidden layer to all outputs: the heads one below the other.
    heads: Linear,
    activations: Activations,
    steps: u32,
    random: Pcg64,
}

/// A linear layer that learns.
struct Linear {
    /// `[out, in]`.
    weight: Parameter<Ix2>,
    /// `[out]`.
    bias: Parameter<Ix1>,
}

/// What the layers make of a batch. Kept from step to step, for they are as large in each.
struct Activations {
    /// `[states, width]`: 0 where a unit is not active, or is left out.
    hidden: Array2<f32>,
    /// Derivatives of the loss by `hidden`.
    by_hidden: Array2<f32>,
    /// `[states, out]`; after the loss its derivatives by them.
    outputs: Array2<f32>,
}

impl Learner {
    /// Makes a network that knows nothing yet: in it no action depends on any other. In each step
    /// this share of its hidden units is left out (dropout): without that and the decay, chance is
    /// learned by heart, and is dependence then.
    pub fn new(shape: Shape, dropout: f32, seed: u64) -> Self {
        let mut random = Pcg64::seed_from_u64(seed);
        let trunk = uniform(shape.width, shape.inputs, &mut random);
        let stacked: Vec<Array2<f32>> = shape
            .heads()
            .into_iter()
            .map(|(name, outputs)| match name {
                "interaction" => Array2::zeros((outputs, shape.width)),
                _ => uniform(outputs, shape.width, &mut random),
            })
            .collect();
        let views: Vec<ArrayView2<'_, f32>> = stacked.iter().map(|head| head.view()).collect();
        let heads = concatenate(Axis(0), &views).expect("every head takes the hidden layer");

        Self {
            activations: Activations::zeros(0, shape.width, heads.nrows()),
            trunk: Linear::new(trunk),
            heads: Linear::new(heads),
            shape,
            dropout,
            steps: 0,
            random,
        }
    }

    /// Returns how many outputs the heads have together.
    pub fn outputs(&self) -> usize {
        self.heads.bias.value.len()
    }

    /// Begins with these biases of the outputs: the heads one after the other.
    pub fn with_biases(mut self, biases: Array1<f32>) -> Self {
        self.heads.bias = Parameter::steady(biases);
        self
    }

    /// Learns from a batch, and returns its mean loss, in nats a draw or a state: a number that is
    /// not finite says that learning has failed.
    pub fn step(&mut self, batch: &Batch) -> f32 {
        let loss = self.differentiate(batch);

        self.steps += 1;
        let step = Step::number(self.steps);
        self.trunk.update(step);
        self.heads.update(step);

        loss
    }

    /// Returns the network as it is now.
    pub fn member(&self) -> Member {
        let mut from = 0;
        let heads = self
            .shape
            .heads()
            .into_iter()
            .map(|(_, outputs)| {
                from += outputs;
                self.heads.averaged(Slice::from(from - outputs..from))
            })
            .collect();

        Member {
            trunk: self.trunk.averaged(Slice::from(..)),
            heads,
        }
    }

    /// Fills the gradients of the mean loss of a batch, which it returns.
    fn differentiate(&mut self, batch: &Batch) -> f32 {
        self.forward(&batch.inputs);
        let loss = self.loss(batch);
        self.backward(&batch.inputs);
        loss
    }

    /// Makes the outputs of every head without some hidden units, for which the others stand in.
    fn forward(&mut self, inputs: &Array2<f32>) {
        let states = inputs.nrows();
        if self.activations.hidden.nrows() != states {
            let outputs = self.heads.bias.value.len();
            self.activations = Activations::zeros(states, self.shape.width, outputs);
        }

        let Activations {
            hidden, outputs, ..
        } = &mut self.activations;
        self.trunk.apply(inputs, hidden);
        for unit in flat(hidden) {
            let kept = kept(&mut self.random, self.dropout);
            // What is no number stays none, so that the loss tells of it.
            *unit = if *unit < 0.0 { 0.0 } else { *unit * kept };
        }
        self.heads.apply(hidden, outputs);
    }

    /// Returns the mean loss, and leaves its derivatives in place of the outputs.
    fn loss(&mut self, batch: &Batch) -> f32 {
        let (outputs, targets) = (self.activations.outputs.view_mut(), batch.targets.view());
        match self.shape.kind {
            ModelKind::Joint => joint_cross_entropy(self.shape.letters, outputs, targets),
            ModelKind::Direct => binary_cross_entropy(outputs, targets, &batch.weights),
        }
    }

    /// Takes the derivatives by the outputs back through both layers.
    fn backward(&mut self, inputs: &Array2<f32>) {
        let Activations {
            hidden,
            by_hidden,
            outputs: by_outputs,
        } = &mut self.activations;
        self.heads.collect(by_outputs, hidden);
        general_mat_mul(1.0, by_outputs, &self.heads.weight.value, 0.0, by_hidden);

        // Units that are active and not left out were made larger, to stand in for the others.
        let larger = 1.0 / (1.0 - self.dropout);
        for (derivative, unit) in flat(by_hidden).iter_mut().zip(flat(hidden)) {
            *derivative *= if *unit > 0.0 { larger } else { 0.0 };
        }
        self.trunk.collect(by_hidden, inputs);
    }
}

impl Linear {
    fn new(weight: Array2<f32>) -> Self {
        Self {
            bias: Parameter::steady(Array1::zeros(weight.nrows())),
            weight: Parameter::decaying(weight),
        }
    }

    /// Writes `[states, out]` of `[states, in]`.
    fn apply(&self, inputs: &Array2<f32>, outputs: &mut Array2<f32>) {
        outputs.assign(&self.bias.value);
        general_mat_mul(1.0, inputs, &self.weight.value.t(), 1.0, outputs);
    }

    /// Fills the gradients, of the derivatives by its outputs and of its inputs.
    fn collect(&mut self, by_outputs: &Array2<f32>, inputs: &Array2<f32>) {
        let gradient = &mut self.weight.gradient;
        general_mat_mul(1.0, &by_outputs.t(), inputs, 0.0, gradient);

        self.bias.gradient.fill(0.0);
        for row in by_outputs.rows() {
            self.bias.gradient += &row;
        }
    }

    fn update(&mut self, step: Step) {
        self.weight.update(step);
        self.bias.update(step);
    }

    /// Returns the averages of some outputs.
    fn averaged(&self, outputs: Slice) -> Layer {
        Layer {
            weight: self.weight.average.slice_axis(Axis(0), outputs).to_owned(),
            bias: self.bias.average.slice_axis(Axis(0), outputs).to_owned(),
        }
    }
}

impl Activations {
    fn zeros(states: usize, width: usize, outputs: usize) -> Self {
        Self {
            hidden: Array2::zeros((states, width)),
            by_hidden: Array2::zeros((states, width)),
            outputs: Array2::zeros((states, outputs)),
        }
    }
}

fn flat(array: &mut Array2<f32>) -> &mut [f32] {
    array
        .as_slice_mut()
        .expect("it is made in the standard layout, and nobody changes that")
}

/// Returns what a hidden unit is multiplied by in a step: 0, or what makes up for those that are
/// left out (inverted dropout).
fn kept(random: &mut Pcg64, dropped: f32) -> f32 {
    if random.random::<f32>() < dropped {
        0.0
    } else {
        1.0 / (1.0 - dropped)
    }
}

/// Returns the weights of a layer before it has learned: uniform within 1 / sqrt(inputs).
fn uniform(outputs: usize, inputs: usize, random: &mut Pcg64) -> Array2<f32> {
    let bound = 1.0 / (inputs.max(1) as f32).sqrt();
    Array2::from_shape_simple_fn((outputs, inputs), || random.random_range(-bound..bound))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::Alphabet;

    /// Between outputs while learning and those that are served.
    const PRECISION: f32 = 1e-5;
    /// Between gradients in 32 bits and differences of losses in 64.
    const GRADIENT_PRECISION: f64 = 1e-5;
    const KINDS: [(ModelKind, usize); 2] = [(ModelKind::Joint, 12), (ModelKind::Direct, 1)];

    fn learner(kind: ModelKind, targets: usize, dropout: f32) -> (Learner, Batch) {
        let shape = Shape {
            kind,
            letters: Letters {
                actions: Alphabet {
                    rows: 3,
                    columns: 4,
                },
                strata: 1,
            },
            interaction: Interaction::Shared,
            width: 16,
            inputs: 5,
        };
        let mut random = Pcg64::seed_from_u64(5);
        let inputs = Array2::from_shape_simple_fn((40, 5), || random.random_range(-2.0..2.0));
        let targets = Array2::from_shape_simple_fn((40, targets), || random.random_range(0.0..1.0));
        let weights = (1..=40).map(|at| at as f32 / 8.0).collect();
        (
            Learner::new(shape, dropout, 3),
            Batch {
                inputs,
                targets,
                weights,
            },
        )
    }

    /// The network and its loss as they are written, in 64 bits: no matrices, nothing in place.
    struct Reference {
        layers: Vec<(Array2<f64>, Array1<f64>)>,
        /// What each hidden unit of each state is multiplied by.
        mask: Array2<f64>,
    }

    impl Reference {
        /// Copies a network, and draws what will be drawn in its next step.
        fn of_learner(learner: &Learner, states: usize) -> Self {
            let mut random = learner.random.clone();
            let wide = |layer: &Linear| {
                let (weight, bias) = (&layer.weight.value, &layer.bias.value);
                (weight.mapv(f64::from), bias.mapv(f64::from))
            };
            Self {
                layers: vec![wide(&learner.trunk), wide(&learner.heads)],
                mask: Array2::from_shape_simple_fn((states, learner.shape.width), || {
                    f64::from(kept(&mut random, learner.dropout))
                }),
            }
        }

        fn loss(&self, kind: ModelKind, batch: &Batch) -> f64 {
            let inputs = batch.inputs.mapv(f64::from);
            let through = |layer: usize, inputs: &[f64]| -> Vec<f64> {
                let (weight, bias) = &self.layers[layer];
                let output = |(row, bias): (ndarray::ArrayView1<'_, f64>, &f64)| {
                    row.iter().zip(inputs).map(|(w, x)| w * x).sum::<f64>() + bias
                };
                weight.rows().into_iter().zip(bias).map(output).collect()
            };
            let (mut sum, mut total) = (0.0, 0.0);
            for (state, inputs) in inputs.rows().into_iter().enumerate() {
                let hidden: Vec<f64> = through(0, &inputs.to_vec())
                    .iter()
                    .zip(self.mask.row(state))
                    .map(|(unit, kept)| unit.max(0.0) * kept)
                    .collect();
                let outputs = through(1, &hidden);
                let targets = batch.targets.row(state).mapv(f64::from).to_vec();
                let weight = f64::from(batch.weights[state]);
                let (loss, share) = match kind {
                    ModelKind::Joint => (joint(&outputs, &targets), targets.iter().sum()),
                    ModelKind::Direct => (weight * direct(outputs[0], targets[0]), weight),
                };
                sum += loss;
                total += share;
            }
            sum / total
        }

        /// Returns the slope of the loss along one weight or bias, by central differences.
        fn slope(&mut self, at: (usize, usize, Option<usize>), of: &(ModelKind, &Batch)) -> f64 {
            const STEP: f64 = 1e-6;
            let mut moved = |by: f64| {
                let (weight, bias) = &mut self.layers[at.0];
                match at.2 {
                    Some(column) => weight[[at.1, column]] += by,
                    None => bias[at.1] += by,
                }
                self.loss(of.0, of.1)
            };
            let above = moved(STEP);
            let below = moved(-2.0 * STEP);
            moved(STEP);
            (above - below) / (2.0 * STEP)
        }
    }

    fn joint(outputs: &[f64], draws: &[f64]) -> f64 {
        let ln_softmax = |logits: &[f64], at: usize| {
            logits[at] - logits.iter().map(|logit| logit.exp()).sum::<f64>().ln()
        };
        let cost = |(cell, n): (usize, &f64)| {
            let (i, j) = (cell / 4, cell % 4);
            let logits: Vec<f64> = (0..4)
                .map(|j| outputs[3 + j] + outputs[7 + 4 * i + j])
                .collect();
            -n * (ln_softmax(&outputs[..3], i) + ln_softmax(&logits, j))
        };
        draws.iter().enumerate().map(cost).sum()
    }

    fn direct(z: f64, p: f64) -> f64 {
        let q = 1.0 / (1.0 + (-z).exp());
        -p * q.ln() - (1.0 - p) * (1.0 - q).ln()
    }

    #[test]
    fn gradients_are_the_finite_differences_of_the_loss() {
        for ((kind, targets), dropout) in KINDS.into_iter().zip([0.5, 0.2]) {
            let (mut learner, batch) = learner(kind, targets, dropout);
            // After some steps nothing is zero any more.
            (0..5).for_each(|_| assert!(learner.step(&batch).is_finite()));
            let mut reference = Reference::of_learner(&learner, 40);
            let expected = reference.loss(kind, &batch);
            let loss = f64::from(learner.differentiate(&batch));
            assert!(
                (loss - expected).abs() < GRADIENT_PRECISION,
                "{loss} {expected}"
            );

            for (at, layer) in [&learner.trunk, &learner.heads].into_iter().enumerate() {
                let weights = layer.weight.gradient.indexed_iter();
                let weights = weights.map(|((out, column), slope)| (out, Some(column), slope));
                let biases = layer.bias.gradient.iter().enumerate();
                for (out, column, slope) in weights.chain(biases.map(|(out, b)| (out, None, b))) {
                    let expected = reference.slope((at, out, column), &(kind, &batch));
                    assert!(
                        (f64::from(*slope) - expected).abs() < GRADIENT_PRECISION,
                        "{kind:?}, layer {at}, {out}, {column:?}: {slope} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_is_served_is_what_was_trained() {
        for (kind, targets) in KINDS {
            let (mut learner, batch) = learner(kind, targets, 0.0);
            (0..20).for_each(|_| assert!(learner.step(&batch).is_finite()));
            for layer in [&mut learner.trunk, &mut learner.heads] {
                layer.weight.value = layer.weight.average.clone();
                layer.bias.value = layer.bias.average.clone();
            }
            learner.forward(&batch.inputs);

            // The heads stand side by side while learning.
            let served = learner.member().outputs(&batch.inputs);
            let served: Vec<ArrayView2<'_, f32>> = served.iter().map(|head| head.view()).collect();
            let served = concatenate(Axis(1), &served).expect("as many states");
            assert_eq!(served.dim(), learner.activations.outputs.dim());
            let differences = (&served - &learner.activations.outputs).mapv(f32::abs);
            assert!(differences.iter().all(|d| *d < PRECISION), "{kind:?}");
        }
    }

    #[test]
    fn a_new_network_knows_of_no_dependence() {
        let (learner, batch) = learner(ModelKind::Joint, 12, 0.5);
        let joint = learner.member().joint(&batch.inputs);
        assert!(joint.iter().all(|joint| joint.mutual_information() < 1e-12));
    }

    #[test]
    fn the_loss_falls_and_the_same_seed_gives_the_same_bits() {
        let losses = |kind, targets| {
            let (mut learner, batch) = learner(kind, targets, 0.5);
            let losses: Vec<f32> = (0..200).map(|_| learner.step(&batch)).collect();
            (losses, learner.member())
        };
        for (kind, targets) in KINDS {
            let (first, member) = losses(kind, targets);
            assert!((&first, &member) == (&losses(kind, targets).0, &losses(kind, targets).1));
            let mean = |part: &[f32]| part.iter().sum::<f32>() / part.len() as f32;
            assert!(mean(&first[180..]) < mean(&first[..20]), "{kind:?}");
        }
    }

    #[test]
    fn batches_may_differ_in_size() {
        let (mut learner, batch) = learner(ModelKind::Joint, 12, 0.5);
        let few = Batch {
            inputs: batch
                .inputs
                .slice_axis(Axis(0), Slice::from(..7))
                .to_owned(),
            targets: batch
                .targets
                .slice_axis(Axis(0), Slice::from(..7))
                .to_owned(),
            weights: batch.weights[..7].to_vec(),
        };
        for batch in [&batch, &few, &batch] {
            assert!(learner.step(batch).is_finite());
        }
    }

    #[test]
    fn inputs_that_are_no_numbers_are_told() {
        let (mut learner, mut batch) = learner(ModelKind::Joint, 12, 0.2);
        batch.inputs[[0, 0]] = f32::NAN;
        assert!(!learner.step(&batch).is_finite());
    }
}
