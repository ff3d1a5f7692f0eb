//! A multilayer perceptron as it is served: its weights, and its forward pass. A hidden layer of
//! rectified linear units, and one head or three.
//!
//! * joint: e, o and D are linear in the hidden layer; p(ego's action | s) = softmax(e), p(other's
//!   action | s, ego's action i) = softmax(o + D_i).
//! * direct: P(MI > threshold | s) = logistic(z), z linear in the hidden layer.

use ndarray::{Array1, Array2, ArrayView1, Axis};

use super::dataset::cells;
use crate::domain::ModelKind;
use crate::information::{Alphabet, Table};

/// A linear layer: weights `[out, in]` as PyTorch has them, and `[out]` that are added.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// `[out, in]`.
    pub weight: Array2<f32>,
    /// `[out]`.
    pub bias: Array1<f32>,
}

/// The weights of one network: the hidden layer, then its heads in the order of [`heads`].
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// From the inputs to the hidden layer.
    pub trunk: Layer,
    /// From the hidden layer to what is predicted.
    pub heads: Vec<Layer>,
}

/// Returns the heads of a kind of network: what each is called, and how many outputs it has.
pub fn heads(kind: ModelKind, alphabet: Alphabet) -> Vec<(&'static str, usize)> {
    let [rows, columns] = [alphabet.rows, alphabet.columns].map(|letters| letters as usize);
    match kind {
        ModelKind::Joint => vec![
            ("ego", rows),
            ("other", columns),
            ("interaction", rows * columns),
        ],
        ModelKind::Direct => vec![("influence", 1)],
    }
}

impl Layer {
    /// Returns `[states, out]` of `[states, in]`.
    fn apply(&self, inputs: &Array2<f32>) -> Array2<f32> {
        inputs.dot(&self.weight.t()) + &self.bias
    }

    /// Returns how many numbers it takes and how many it makes.
    pub fn shape(&self) -> (usize, usize) {
        (self.weight.ncols(), self.weight.nrows())
    }
}

impl Member {
    /// Returns the outputs of every head, `[states, out]` each, of inputs `[states, in]`.
    pub fn outputs(&self, inputs: &Array2<f32>) -> Vec<Array2<f32>> {
        let mut hidden = self.trunk.apply(inputs);
        hidden.mapv_inplace(|unit| unit.max(0.0));
        self.heads.iter().map(|head| head.apply(&hidden)).collect()
    }

    /// Returns what a joint network says of states.
    pub fn joint(&self, inputs: &Array2<f32>) -> Vec<Joint> {
        let [ego, other, interaction] = &self.outputs(inputs)[..] else {
            return Vec::new();
        };
        let state = |at: usize| Joint::new(ego.row(at), other.row(at), interaction.row(at));
        (0..inputs.nrows()).map(state).collect()
    }

    /// Makes a joint network one in which no action depends on any other. What the rows of D have
    /// in common is habit, and goes to o.
    pub fn forget_interaction(&mut self) {
        let [ego, other, interaction] = &mut self.heads[..] else {
            return;
        };
        let (rows, columns) = (ego.bias.len(), other.bias.len());

        for at in 0..rows * columns {
            let mut habit = other.weight.row_mut(at % columns);
            habit.scaled_add(1.0 / rows as f32, &interaction.weight.row(at));
            other.bias[at % columns] += interaction.bias[at] / rows as f32;
        }
        interaction.weight.fill(0.0);
        interaction.bias.fill(0.0);
    }

    /// Returns mutual information of states in nats, as a joint network has it:
    /// [`Joint::mutual_information`] of each, in fewer steps.
    ///
    /// With logits l_ij and s_i = sum_j e^l_ij, I = H(q) + sum_i p_i [sum_j l_ij e^l_ij / s_i - ln
    /// s_i]: one exponential a cell.
    pub fn information(&self, inputs: &Array2<f32>) -> Vec<f64> {
        let [ego, other, interaction] = &self.outputs(inputs)[..] else {
            return Vec::new();
        };

        let mut marginal = vec![0.0; other.ncols()];
        let rows = ego
            .rows()
            .into_iter()
            .zip(other.rows())
            .zip(interaction.rows());
        rows.map(|((ego, other), interaction)| information(ego, other, interaction, &mut marginal))
            .collect()
    }

    /// Returns ln odds of MI > threshold of states, as a direct network has them.
    pub fn ln_odds(&self, inputs: &Array2<f32>) -> Vec<f64> {
        self.outputs(inputs).first().map_or_else(Vec::new, |odds| {
            odds.iter().map(|z| f64::from(*z)).collect()
        })
    }
}

/// What both agents do in a state, as a joint network has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Probability of each of the ego's actions.
    pub ego: Vec<f64>,
    /// Probability of each of the other's actions, after each of the ego's: `[ego, other]`.
    pub response: Array2<f64>,
    /// Probability of each of the other's actions.
    pub other: Vec<f64>,
}

impl Joint {
    fn new(
        ego: ArrayView1<'_, f32>,
        other: ArrayView1<'_, f32>,
        interaction: ArrayView1<'_, f32>,
    ) -> Self {
        let columns = other.len();
        let ego = softmax(ego.iter().map(|x| f64::from(*x)));
        let row = |i: usize| {
            softmax(
                (0..columns).map(|j| f64::from(other[j]) + f64::from(interaction[i * columns + j])),
            )
        };

        let rows: Vec<f64> = (0..ego.len()).flat_map(row).collect();
        let response =
            Array2::from_shape_vec((ego.len(), columns), rows).expect("a row an action of the ego");
        Self::from_policy(ego, response)
    }

    /// Joins the ego's policy with the responses to it.
    pub fn from_policy(ego: Vec<f64>, response: Array2<f64>) -> Self {
        let other = response
            .columns()
            .into_iter()
            .map(|column| column.iter().zip(&ego).map(|(r, p)| r * p).sum());
        Self {
            other: other.collect(),
            ego,
            response,
        }
    }

    /// Returns the mean of this and another, in which the other has this share.
    pub fn mixed_with(&self, other: &Self, share: f64) -> Self {
        let mixed = |a: &f64, b: &f64| (1.0 - share) * a + share * b;
        let ego = self
            .ego
            .iter()
            .zip(&other.ego)
            .map(|(a, b)| mixed(a, b))
            .collect();
        Self::from_policy(
            ego,
            &self.response * (1.0 - share) + &other.response * share,
        )
    }

    /// Returns sum n_ij ln p(j | i) of counts: how well it tells what the other does.
    pub fn log_likelihood(&self, table: &Table) -> f64 {
        cells(table)
            .map(|(i, j, n)| n * self.response[[i, j]].ln())
            .sum()
    }

    /// Returns sum n_ij [ln p(j | i) - ln p(j)] of counts: what dependence is worth to them.
    pub fn gain(&self, table: &Table) -> f64 {
        cells(table).map(|(i, j, n)| n * self.ln_ratio(i, j)).sum()
    }

    /// Returns ln p(j | i) - ln p(j).
    pub fn ln_ratio(&self, i: usize, j: usize) -> f64 {
        self.response[[i, j]].ln() - self.other[j].ln()
    }

    /// Returns KL(p(other | the ego's action) from p(other)), in nats, at least 0.
    pub fn divergence(&self, action: usize) -> f64 {
        let row = self.response.index_axis(Axis(0), action);
        let terms = row
            .iter()
            .zip(&self.other)
            .filter(|(p, q)| **p > 0.0 && **q > 0.0)
            .map(|(p, q)| p * (p / q).ln());
        terms.sum::<f64>().max(0.0)
    }

    /// Returns mutual information in nats, at least 0: the mean of the divergences.
    pub fn mutual_information(&self) -> f64 {
        self.ego
            .iter()
            .enumerate()
            .map(|(action, p)| p * self.divergence(action))
            .sum()
    }
}

/// Mutual information below this is a matter of rounding.
const ROUNDING: f64 = 1e-12;

fn information(
    ego: ArrayView1<'_, f32>,
    other: ArrayView1<'_, f32>,
    interaction: ArrayView1<'_, f32>,
    marginal: &mut [f64],
) -> f64 {
    let columns = other.len();
    let policy = softmax(ego.iter().map(|x| f64::from(*x)));
    marginal.fill(0.0);

    let mut row = vec![0.0; columns];
    let mut negative_entropy = 0.0;
    for (i, p) in policy.into_iter().enumerate() {
        let logit = |j: usize| f64::from(other[j]) + f64::from(interaction[i * columns + j]);
        let largest = (0..columns).map(logit).fold(f64::NEG_INFINITY, f64::max);
        let (mut sum, mut weighted) = (0.0, 0.0);
        for (j, cell) in row.iter_mut().enumerate() {
            let shifted = logit(j) - largest;
            *cell = shifted.exp();
            sum += *cell;
            weighted += shifted * *cell;
        }
        negative_entropy += p * (weighted / sum - sum.ln());
        marginal
            .iter_mut()
            .zip(&row)
            .for_each(|(q, cell)| *q += p * cell / sum);
    }

    let entropy: f64 = marginal
        .iter()
        .filter(|q| **q > 0.0)
        .map(|q| -q * q.ln())
        .sum();

    let information = entropy + negative_entropy;
    // Of independent actions nothing is left but what rounding makes of it.
    if information < ROUNDING {
        0.0
    } else {
        information
    }
}

fn softmax(logits: impl Iterator<Item = f64> + Clone) -> Vec<f64> {
    let largest = logits.clone().fold(f64::NEG_INFINITY, f64::max);
    let exponentials: Vec<f64> = logits.map(|logit| (logit - largest).exp()).collect();
    let sum: f64 = exponentials.iter().sum();
    exponentials.into_iter().map(|x| x / sum).collect()
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn mutual_information_is_that_of_the_joint_distribution() {
        // A coin that is copied: ln 2. One that is not: 0.
        let copied = Joint::from_policy(vec![0.5, 0.5], array![[1.0, 0.0], [0.0, 1.0]]);
        assert!((copied.mutual_information() - 2_f64.ln()).abs() < 1e-15);
        let ignored = Joint::from_policy(vec![0.3, 0.7], array![[0.2, 0.8], [0.2, 0.8]]);
        assert!(ignored.mutual_information() < 1e-15);
    }

    #[test]
    fn without_interaction_nothing_depends() {
        let layer = |out: usize, value: f32| Layer {
            weight: Array2::from_elem((out, 2), value),
            bias: Array1::zeros(out),
        };
        let heads = vec![layer(2, 0.3), layer(3, -0.4), layer(6, 0.0)];
        let member = Member {
            trunk: layer(2, 1.0),
            heads,
        };
        let joint = &member.joint(&array![[1.0, 0.5]])[0];
        assert!(joint.mutual_information() < 1e-15, "{joint:?}");
        assert!((joint.other.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn fewer_steps_give_the_same_information() {
        let layer = |out: usize, scale: f32| Layer {
            weight: Array2::from_shape_fn((out, 2), |(o, i)| {
                scale * ((3 * o + 5 * i) as f32).sin()
            }),
            bias: Array1::from_shape_fn(out, |o| (o as f32).cos()),
        };
        let member = Member {
            trunk: layer(2, 1.0),
            heads: vec![layer(2, 1.0), layer(3, 2.0), layer(6, 40.0)],
        };
        let inputs = array![[1.0, 0.5], [-2.0, 3.0], [0.0, 0.0], [30.0, -7.0]];
        for (joint, quick) in member
            .joint(&inputs)
            .iter()
            .zip(member.information(&inputs))
        {
            assert!(
                (joint.mutual_information() - quick).abs() < 1e-12,
                "{joint:?} {quick}"
            );
        }
    }

    #[test]
    fn habits_are_not_forgotten_with_the_interaction() {
        let layer = |out: usize, value: f32| Layer {
            weight: Array2::from_elem((out, 2), value),
            bias: Array1::zeros(out),
        };
        // D says the same after each of the ego's actions: 1, 2, 3.
        let same = Array1::from_vec(vec![1.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
        let interaction = Layer {
            weight: Array2::zeros((6, 2)),
            bias: same,
        };
        let mut member = Member {
            trunk: layer(2, 1.0),
            heads: vec![layer(2, 0.3), layer(3, 0.1), interaction],
        };
        let inputs = array![[1.0, 0.5]];
        let before = member.joint(&inputs);
        member.forget_interaction();
        let after = member.joint(&inputs);
        let close = before[0]
            .response
            .iter()
            .zip(&after[0].response)
            .all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(
            close && after[0].mutual_information() < 1e-12,
            "{before:?} {after:?}"
        );
    }

    #[test]
    fn large_logits_stay_finite() {
        assert_eq!(softmax([1e30, -1e30].into_iter()), [1.0, 0.0]);
    }
}
