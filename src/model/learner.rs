//! The training library's side: one network, its gradients and its steps. Nothing outside this file
//! knows the library.
//!
//! All work is done on the calling thread, so that the same seed gives the same bits and those who
//! ask questions keep the other cores; all randomness is our own.

use candle_core::{D, DType, Device, Result, Tensor, Var};
use candle_nn::ops::log_softmax;
use candle_nn::{AdamW, Optimizer, ParamsAdamW};
use ndarray::{Array1, Array2};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::member::{Layer, Member, heads};
use crate::domain::ModelKind;
use crate::information::Alphabet;

/// The step of the optimiser.
const LEARNING_RATE: f64 = 0.03;
/// How much of every weight decays in a step, as a share of the step.
const WEIGHT_DECAY: f64 = 0.1;
/// How much of the average of the weights stays in a step.
const AVERAGE: f64 = 0.99;

/// A network's form.
#[derive(Debug, Clone)]
pub struct Shape {
    /// What it predicts.
    pub kind: ModelKind,
    /// How many actions the two have.
    pub alphabet: Alphabet,
    /// Units of the hidden layer.
    pub width: usize,
    /// Numbers that a state is.
    pub inputs: usize,
}

/// States that are learned from in one step.
pub struct Batch {
    /// `[states, inputs]`.
    pub inputs: Array2<f32>,
    /// For a joint network `[states, ego x other]`, how often each pair of actions was drawn; for a
    /// direct one `[states, 1]`, P(MI > threshold).
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
    /// The hidden layer, then the heads.
    layers: Vec<(Var, Var)>,
    weights: AdamW,
    biases: AdamW,
    /// Averages of `layers`: what is served, since single steps are noisy.
    average: Vec<(Tensor, Tensor)>,
    steps: u32,
    random: Pcg64,
}

impl Learner {
    /// Makes a network that knows nothing yet: in it no action depends on any other. In each step
    /// this share of its hidden units is left out: without that and the decay, chance is learned by
    /// heart, and is dependence then.
    pub fn new(shape: Shape, dropout: f32, seed: u64) -> Result<Self> {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut layers = vec![layer(shape.width, shape.inputs, &mut random)?];
        for (name, outputs) in heads(shape.kind, shape.alphabet) {
            layers.push(match name {
                "interaction" => zero(outputs, shape.width)?,
                _ => layer(outputs, shape.width, &mut random)?,
            });
        }
        let optimiser = |vars: Vec<Var>, weight_decay| {
            AdamW::new(
                vars,
                ParamsAdamW {
                    lr: LEARNING_RATE,
                    weight_decay,
                    ..ParamsAdamW::default()
                },
            )
        };
        let (weights, biases) = layers.iter().cloned().unzip();
        Ok(Self {
            weights: optimiser(weights, WEIGHT_DECAY)?,
            biases: optimiser(biases, 0.0)?,
            average: layers
                .iter()
                .map(|(weight, bias)| (weight.as_detached_tensor(), bias.as_detached_tensor()))
                .collect(),
            layers,
            shape,
            dropout,
            steps: 0,
            random,
        })
    }

    /// Learns from a batch, and returns its loss: a number that is not finite says that learning
    /// has failed.
    pub fn step(&mut self, batch: &Batch) -> Result<f32> {
        let outputs = self.outputs(&tensor(&batch.inputs)?)?;
        let loss = loss(&self.shape, &outputs, batch)?;
        let gradients = loss.backward()?;
        self.weights.step(&gradients)?;
        self.biases.step(&gradients)?;
        self.steps += 1;
        self.follow()?;
        loss.to_scalar()
    }

    /// Returns the network as it is now.
    pub fn member(&self) -> Result<Member> {
        let mut layers = self
            .average
            .iter()
            .map(|(weight, bias)| to_layer(weight, bias));
        let trunk = layers
            .next()
            .unwrap_or_else(|| candle_core::bail!("a network has a hidden layer"))?;
        Ok(Member {
            trunk,
            heads: layers.collect::<Result<_>>()?,
        })
    }

    #[cfg(test)]
    /// Returns the outputs of every head by the training library's own arithmetic, for comparison
    /// with what is served.
    pub fn forward(&self, inputs: &Array2<f32>) -> Result<Vec<Array2<f32>>> {
        let through = |inputs: &Tensor, (weight, bias): &(Tensor, Tensor)| {
            inputs.matmul(&weight.t()?)?.broadcast_add(bias)
        };
        let hidden = through(&tensor(inputs)?, &self.average[0])?.relu()?;
        self.average[1..]
            .iter()
            .map(|head| to_array(&through(&hidden, head)?))
            .collect()
    }

    /// Returns the outputs of every head without some hidden units, for which the others stand in.
    fn outputs(&mut self, inputs: &Tensor) -> Result<Vec<Tensor>> {
        let through = |inputs: &Tensor, (weight, bias): &(Var, Var)| {
            inputs.matmul(&weight.t()?)?.broadcast_add(bias)
        };
        let hidden = through(inputs, &self.layers[0])?.relu()?;
        let mask =
            Array2::from_shape_simple_fn(hidden.dims2()?, || kept(&mut self.random, self.dropout));
        let hidden = (hidden * tensor(&mask)?)?;
        self.layers[1..]
            .iter()
            .map(|head| through(&hidden, head))
            .collect()
    }

    /// Lets the average follow the weights: quickly at first, for early steps are soon out of date.
    fn follow(&mut self) -> Result<()> {
        let steps = f64::from(self.steps);
        let stays = AVERAGE.min(steps / (steps + 10.0));
        let mixed = |old: &Tensor, new: &Var| {
            (old.affine(stays, 0.0)? + new.as_detached_tensor().affine(1.0 - stays, 0.0)?)?
                .contiguous()
        };
        for ((weight, bias), (new_weight, new_bias)) in self.average.iter_mut().zip(&self.layers) {
            *weight = mixed(weight, new_weight)?;
            *bias = mixed(bias, new_bias)?;
        }
        Ok(())
    }
}

/// Returns what a hidden unit is multiplied by in a step: 0, or what makes up for those that are
/// left out.
fn kept(random: &mut Pcg64, dropped: f32) -> f32 {
    if random.random::<f32>() < dropped {
        0.0
    } else {
        1.0 / (1.0 - dropped)
    }
}

/// Returns the mean loss of a batch, in nats a draw or a state.
fn loss(shape: &Shape, outputs: &[Tensor], batch: &Batch) -> Result<Tensor> {
    let targets = tensor(&batch.targets)?;
    match (shape.kind, outputs) {
        (ModelKind::Joint, [ego, other, interaction]) => {
            joint_loss(shape.alphabet, [ego, other, interaction], &targets)
        }
        (_, [ln_odds, ..]) => direct_loss(ln_odds, &targets, &batch.weights),
        (_, []) => candle_core::bail!("a network has a head"),
    }
}

/// -sum n_ij [ln p(i) + ln p(j | i)] / N.
fn joint_loss(
    alphabet: Alphabet,
    [ego, other, interaction]: [&Tensor; 3],
    draws: &Tensor,
) -> Result<Tensor> {
    let [rows, columns] = [alphabet.rows, alphabet.columns].map(|letters| letters as usize);
    let states = draws.dim(0)?;
    let draws = draws.reshape((states, rows, columns))?;
    let responses = interaction
        .reshape((states, rows, columns))?
        .broadcast_add(&other.reshape((states, 1, columns))?)?;
    let of_other = (log_softmax(&responses, D::Minus1)? * &draws)?.sum_all()?;
    let of_ego = (log_softmax(ego, D::Minus1)? * draws.sum(D::Minus1)?)?.sum_all()?;
    let total = f64::from(draws.sum_all()?.to_scalar::<f32>()?);
    (of_other + of_ego)?.affine(-1.0 / total, 0.0)
}

/// Cross-entropy of logistic(z) against p, weighted: max(z, 0) - p z + ln(1 + e^-|z|), which
/// overflows nowhere.
fn direct_loss(z: &Tensor, p: &Tensor, weights: &[f32]) -> Result<Tensor> {
    let total: f32 = weights.iter().sum();
    let weights = Tensor::from_slice(weights, (weights.len(), 1), &Device::Cpu)?;
    let each = ((z.relu()? - (z * p)?)? + (z.abs()?.neg()?.exp()? + 1.0)?.log()?)?;
    (each * weights)?
        .sum_all()?
        .affine(1.0 / f64::from(total), 0.0)
}

/// Returns a layer before it has learned: weights uniform within 1 / sqrt(inputs), and nothing
/// added.
fn layer(outputs: usize, inputs: usize, random: &mut Pcg64) -> Result<(Var, Var)> {
    let bound = 1.0 / (inputs.max(1) as f32).sqrt();
    let weight = Array2::from_shape_fn((outputs, inputs), |_| random.random_range(-bound..bound));
    Ok((
        Var::from_tensor(&tensor(&weight)?)?,
        Var::zeros(outputs, DType::F32, &Device::Cpu)?,
    ))
}

fn zero(outputs: usize, inputs: usize) -> Result<(Var, Var)> {
    let zeros = Var::zeros((outputs, inputs), DType::F32, &Device::Cpu)?;
    Ok((zeros, Var::zeros(outputs, DType::F32, &Device::Cpu)?))
}

fn tensor(array: &Array2<f32>) -> Result<Tensor> {
    let values: Vec<f32> = array.iter().copied().collect();
    Tensor::from_vec(values, array.dim(), &Device::Cpu)
}

fn to_array(tensor: &Tensor) -> Result<Array2<f32>> {
    let values = tensor.contiguous()?.flatten_all()?.to_vec1()?;
    Array2::from_shape_vec(tensor.dims2()?, values).map_err(candle_core::Error::wrap)
}

fn to_layer(weight: &Tensor, bias: &Tensor) -> Result<Layer> {
    Ok(Layer {
        weight: to_array(weight)?,
        bias: Array1::from_vec(bias.to_vec1()?),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Between the training library's outputs and ours.
    const PRECISION: f32 = 1e-5;

    fn learner(kind: ModelKind, targets: usize) -> (Learner, Batch) {
        let shape = Shape {
            kind,
            alphabet: Alphabet {
                rows: 3,
                columns: 4,
            },
            width: 16,
            inputs: 5,
        };
        let mut random = Pcg64::seed_from_u64(5);
        let inputs = Array2::from_shape_simple_fn((40, 5), || random.random_range(-2.0..2.0));
        let targets = Array2::from_shape_simple_fn((40, targets), || random.random_range(0.0..1.0));
        (
            Learner::new(shape, 0.5, 3).expect("a network"),
            Batch {
                inputs,
                targets,
                weights: vec![1.0; 40],
            },
        )
    }

    #[test]
    fn what_is_served_is_what_was_trained() {
        for (kind, targets) in [(ModelKind::Joint, 12), (ModelKind::Direct, 1)] {
            let (mut learner, batch) = learner(kind, targets);
            (0..20).for_each(|_| assert!(learner.step(&batch).expect("learned").is_finite()));
            let served = learner.member().expect("weights").outputs(&batch.inputs);
            for (served, own) in served
                .iter()
                .zip(learner.forward(&batch.inputs).expect("outputs"))
            {
                let difference = (served - &own)
                    .iter()
                    .fold(0.0, |most: f32, d| most.max(d.abs()));
                assert!(difference < PRECISION, "{kind:?}: {difference}");
            }
        }
    }

    #[test]
    fn a_new_network_knows_of_no_dependence() {
        let (learner, batch) = learner(ModelKind::Joint, 12);
        let joint = learner.member().expect("weights").joint(&batch.inputs);
        assert!(joint.iter().all(|joint| joint.mutual_information() < 1e-12));
    }

    #[test]
    fn the_loss_falls_and_the_same_seed_gives_the_same_bits() {
        let losses = |kind, targets| {
            let (mut learner, batch) = learner(kind, targets);
            (0..200)
                .map(|_| learner.step(&batch).expect("learned"))
                .collect::<Vec<f32>>()
        };
        for (kind, targets) in [(ModelKind::Joint, 12), (ModelKind::Direct, 1)] {
            let first = losses(kind, targets);
            assert_eq!(first, losses(kind, targets));
            let mean = |part: &[f32]| part.iter().sum::<f32>() / part.len() as f32;
            assert!(mean(&first[180..]) < mean(&first[..20]), "{kind:?}");
        }
    }

    #[test]
    fn extreme_odds_have_a_finite_loss() {
        let z =
            Tensor::from_slice(&[-1e30_f32, 1e30, 0.0], (3, 1), &Device::Cpu).expect("a tensor");
        let p = Tensor::from_slice(&[0.0_f32, 1.0, 0.5], (3, 1), &Device::Cpu).expect("a tensor");
        let loss = direct_loss(&z, &p, &[1.0; 3])
            .expect("a loss")
            .to_scalar::<f32>()
            .expect("a number");
        assert!((loss - 2_f32.ln() / 3.0).abs() < 1e-6, "{loss}");
    }
}
