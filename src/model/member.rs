//! A multilayer perceptron as it is served: its weights, and its forward pass. A hidden layer of
//! rectified linear units, and one head, three or four.
//!
//! * joint: e, o and D are linear in the hidden layer; p(ego's action | s) = softmax(e), p(other's
//!   action | s, ego's action i) = softmax(o + D_i).
//! * joint at a lag: the same in each stratum h, with e_h and o_h one below the other, and p(other's
//!   own action | s) = softmax(w). D is the same in all strata (no interaction of three variables),
//!   or each has its own D_h, one below the other.
//! * direct: P(MI > threshold | s) = logistic(z), z linear in the hidden layer.

use ndarray::{Array1, Array2, ArrayView1, Axis, Slice};

use super::dataset::cells;
use super::letters::Letters;
use crate::domain::ModelKind;
use crate::information::Table;

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

/// How a joint network at a lag lets the ego's action act on the other's: in the same way whatever
/// the other did a step before, or in a way of its own in each stratum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interaction {
    /// One D: few weights, which all draws teach.
    Shared,
    /// D_h, in which an answer may turn on what the other did itself, as that of a player who stays
    /// after a win and shifts after a loss.
    ByStratum,
}

/// Returns the heads of a kind of network: what each is called, and how many outputs it has.
pub fn heads(
    kind: ModelKind,
    letters: Letters,
    interaction: Interaction,
) -> Vec<(&'static str, usize)> {
    let (strata, columns) = (letters.strata as usize, letters.actions.columns as usize);
    let interactions = match interaction {
        Interaction::Shared => letters.actions.rows as usize * columns,
        Interaction::ByStratum => letters.cells() as usize,
    };
    match kind {
        ModelKind::Joint => {
            let own = (strata > 1).then_some(("own", strata));
            let of_strata = [
                ("ego", letters.rows() as usize),
                ("other", strata * columns),
                ("interaction", interactions),
            ];
            own.into_iter().chain(of_strata).collect()
        }
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

    /// Returns how many strata a joint network predicts in: 1 where nothing is held fixed.
    pub fn strata(&self) -> usize {
        match &self.heads[..] {
            [own, _, _, _] => own.bias.len(),
            _ => 1,
        }
    }

    /// Returns what a joint network says of states.
    pub fn joint(&self, inputs: &Array2<f32>) -> Vec<Joint> {
        let outputs = self.outputs(inputs);
        let Some(heads) = JointHeads::new(&outputs) else {
            return Vec::new();
        };
        (0..inputs.nrows())
            .map(|state| heads.joint(state))
            .collect()
    }

    /// Makes a joint network one in which no action depends on any other. What the rows of D have
    /// in common is habit, and goes to o.
    pub fn forget_interaction(&mut self) {
        let strata = self.strata();
        let [.., ego, other, interaction] = &mut self.heads[..] else {
            return;
        };
        let (rows, columns) = (ego.bias.len() / strata, other.bias.len() / strata);

        for at in 0..strata * rows * columns {
            let to = at / (rows * columns) * columns + at % columns;
            // Where strata share their D, each takes the same.
            let from = at % interaction.bias.len();
            let mut habit = other.weight.row_mut(to);
            habit.scaled_add(1.0 / rows as f32, &interaction.weight.row(from));
            other.bias[to] += interaction.bias[from] / rows as f32;
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
        let outputs = self.outputs(inputs);
        let Some(heads) = JointHeads::new(&outputs) else {
            return Vec::new();
        };
        let mut marginal = vec![0.0; heads.columns()];
        (0..inputs.nrows())
            .map(|state| heads.information(state, &mut marginal))
            .collect()
    }

    /// Returns ln odds of MI > threshold of states, as a direct network has them.
    pub fn ln_odds(&self, inputs: &Array2<f32>) -> Vec<f64> {
        self.outputs(inputs).first().map_or_else(Vec::new, |odds| {
            odds.iter().map(|z| f64::from(*z)).collect()
        })
    }
}

/// What the heads of a joint network put out, `[states, out]` each.
struct JointHeads<'a> {
    /// Of what is held fixed; `None` where nothing is.
    own: Option<&'a Array2<f32>>,
    ego: &'a Array2<f32>,
    other: &'a Array2<f32>,
    interaction: &'a Array2<f32>,
}

impl<'a> JointHeads<'a> {
    /// Returns `None` of a network of another kind.
    fn new(outputs: &'a [Array2<f32>]) -> Option<Self> {
        let [own @ .., ego, other, interaction] = outputs else {
            return None;
        };
        Some(Self {
            own: own.first(),
            ego,
            other,
            interaction,
        })
    }

    fn strata(&self) -> usize {
        self.own.map_or(1, Array2::ncols)
    }

    /// Returns how many actions the other has.
    fn columns(&self) -> usize {
        self.other.ncols() / self.strata()
    }

    /// Returns the probability of each stratum in a state.
    fn own(&self, state: usize) -> Vec<f64> {
        self.own
            .map_or_else(|| vec![1.0], |own| softmax(wide(own.row(state))))
    }

    /// Returns the logits of each stratum in a state: e, o and D.
    fn strata_of(&self, state: usize) -> impl Iterator<Item = [ArrayView1<'a, f32>; 3]> {
        let strata = self.strata();
        let cells = self.ego.ncols() / strata * self.columns();
        let heads = [
            (self.ego, self.ego.ncols() / strata),
            (self.other, self.columns()),
            (self.interaction, cells),
        ];
        (0..strata).map(move |stratum| {
            heads.map(|(head, each)| {
                // There is one D for all, or one for each.
                let stratum = if head.ncols() == each { 0 } else { stratum };
                let row = head.index_axis(Axis(0), state);
                row.slice_axis_move(Axis(0), Slice::from(stratum * each..(stratum + 1) * each))
            })
        })
    }

    fn joint(&self, state: usize) -> Joint {
        let columns = self.columns();
        let [mut policy, mut responses] = [(); 2].map(|()| Vec::new());
        for [ego, other, interaction] in self.strata_of(state) {
            policy.extend(softmax(wide(ego)));
            let row = |i: usize| {
                let logit = move |j| f64::from(other[j]) + f64::from(interaction[i * columns + j]);
                softmax((0..columns).map(logit))
            };
            responses.extend((0..ego.len()).flat_map(row));
        }

        let response = Array2::from_shape_vec((policy.len(), columns), responses)
            .expect("a row an action of the ego in each stratum");
        Joint::from_policies(self.own(state), policy, response)
    }

    fn information(&self, state: usize, marginal: &mut [f64]) -> f64 {
        let strata = self.own(state).into_iter().zip(self.strata_of(state));
        strata
            .map(|(share, [ego, other, interaction])| {
                share * information(ego, other, interaction, marginal)
            })
            .sum()
    }
}

/// What both agents do in a state, as a joint network has it. At a lag in each stratum: rows are the
/// ego's actions of one stratum after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Probability of each stratum; 1 where nothing is held fixed.
    pub own: Vec<f64>,
    /// Probability of each of the ego's actions, in each stratum.
    pub ego: Vec<f64>,
    /// Probability of each of the other's actions, after each of the ego's in each stratum:
    /// `[strata x ego, other]`.
    pub response: Array2<f64>,
    /// Probability of each of the other's actions, in each stratum.
    pub other: Vec<f64>,
}

impl Joint {
    /// Joins the ego's policy with the responses to it, where nothing is held fixed.
    pub fn from_policy(ego: Vec<f64>, response: Array2<f64>) -> Self {
        Self::from_policies(vec![1.0], ego, response)
    }

    /// Joins the ego's policies in strata with the responses to them.
    fn from_policies(own: Vec<f64>, ego: Vec<f64>, response: Array2<f64>) -> Self {
        let rows = ego.len() / own.len();
        let strata = ego
            .chunks(rows)
            .zip(response.axis_chunks_iter(Axis(0), rows));
        let other = strata.flat_map(|(ego, response)| {
            let column = |column: ArrayView1<'_, f64>| -> f64 {
                column.iter().zip(ego).map(|(r, p)| r * p).sum()
            };
            response
                .columns()
                .into_iter()
                .map(column)
                .collect::<Vec<_>>()
        });
        Self {
            other: other.collect(),
            own,
            ego,
            response,
        }
    }

    /// Returns the mean of this and another, in which the other has this share.
    pub fn mixed_with(&self, other: &Self, share: f64) -> Self {
        let mixed = |a: &[f64], b: &[f64]| -> Vec<f64> {
            let pairs = a.iter().zip(b);
            pairs.map(|(a, b)| (1.0 - share) * a + share * b).collect()
        };
        let own = match self.own[..] {
            // Rounding would make it another number.
            [_] => self.own.clone(),
            _ => mixed(&self.own, &other.own),
        };
        Self::from_policies(
            own,
            mixed(&self.ego, &other.ego),
            &self.response * (1.0 - share) + &other.response * share,
        )
    }

    /// Returns how many actions the ego has.
    pub fn actions(&self) -> usize {
        self.ego.len() / self.own.len()
    }

    /// Returns the stratum of a row.
    fn stratum(&self, row: usize) -> usize {
        row / self.actions()
    }

    /// Returns the probability of each of the other's actions in a stratum.
    fn marginal(&self, stratum: usize) -> &[f64] {
        let columns = self.response.ncols();
        &self.other[stratum * columns..][..columns]
    }

    /// Returns how probable one of the ego's actions is.
    pub fn policy(&self, action: usize) -> f64 {
        self.over_strata(action, |_| 1.0)
    }

    /// Returns the mean of a figure of rows over the strata, each by how probable it is with an
    /// action of the ego: its sum over strata of p(h) p(i | h), over their sum.
    pub fn given_action(&self, action: usize, figure: impl Fn(usize) -> f64) -> f64 {
        if self.own.len() == 1 {
            return figure(action);
        }
        // However improbable an action is, its share among strata is defined.
        self.over_strata(action, figure) / self.policy(action).max(f64::MIN_POSITIVE)
    }

    /// Returns sum_h p(h) p(i | h) x(h R + i).
    fn over_strata(&self, action: usize, figure: impl Fn(usize) -> f64) -> f64 {
        let actions = self.actions();
        let strata = self.own.iter().enumerate();
        strata
            .map(|(stratum, share)| {
                let row = stratum * actions + action;
                share * self.ego[row] * figure(row)
            })
            .sum()
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

    /// Returns ln p(j | i) - ln p(j), in the stratum of a row.
    pub fn ln_ratio(&self, row: usize, j: usize) -> f64 {
        self.response[[row, j]].ln() - self.marginal(self.stratum(row))[j].ln()
    }

    /// Returns KL(p(other | the ego's action) from p(other)) in the stratum of a row, in nats, at
    /// least 0.
    pub fn divergence(&self, row: usize) -> f64 {
        let marginal = self.marginal(self.stratum(row));
        let response = self.response.index_axis(Axis(0), row);
        let terms = response
            .iter()
            .zip(marginal)
            .filter(|(p, q)| **p > 0.0 && **q > 0.0)
            .map(|(p, q)| p * (p / q).ln());
        terms.sum::<f64>().max(0.0)
    }

    /// Returns mutual information in nats, at least 0, given what is held fixed: the mean of the
    /// divergences.
    pub fn mutual_information(&self) -> f64 {
        self.ego
            .iter()
            .enumerate()
            .map(|(row, p)| self.own[self.stratum(row)] * p * self.divergence(row))
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
    let policy = softmax(wide(ego));
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

fn wide(logits: ArrayView1<'_, f32>) -> impl Iterator<Item = f64> + Clone {
    logits.into_iter().map(|x| f64::from(*x))
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

    /// A network of three strata, two of the ego's actions and two of the other's, with so many
    /// outputs of its interaction.
    fn stratified(interactions: usize) -> Member {
        let layer = |out: usize, scale: f32| Layer {
            weight: Array2::from_shape_fn((out, 2), |(o, i)| {
                scale * ((2 * o + 5 * i) as f32).sin()
            }),
            bias: Array1::from_shape_fn(out, |o| (o as f32).cos()),
        };
        Member {
            trunk: layer(2, 1.0),
            heads: vec![
                layer(3, 0.7),
                layer(6, 1.0),
                layer(6, 2.0),
                layer(interactions, 3.0),
            ],
        }
    }

    #[test]
    fn strata_are_networks_of_one_tick_side_by_side() {
        let inputs = array![[1.0, 0.5], [-2.0, 3.0], [0.0, 0.0]];
        for interactions in [4, 12] {
            let member = stratified(interactions);
            let part = |head: usize, stratum: usize| {
                let Layer { weight, bias } = &member.heads[head];
                let each = [1, 2, 2, 4][head];
                let from = if bias.len() == each {
                    0
                } else {
                    stratum * each
                };
                let outputs = Slice::from(from..from + each);
                Layer {
                    weight: weight.slice_axis(Axis(0), outputs).to_owned(),
                    bias: bias.slice_axis(Axis(0), outputs).to_owned(),
                }
            };
            let alone = |stratum: usize| Member {
                trunk: member.trunk.clone(),
                heads: [1, 2, 3].map(|head| part(head, stratum)).into(),
            };
            let alone = [0, 1, 2].map(|stratum| alone(stratum).joint(&inputs));

            let joints = member.joint(&inputs);
            assert!(joints.iter().any(|joint| joint.mutual_information() > 0.01));
            for (state, (joint, quick)) in
                joints.iter().zip(member.information(&inputs)).enumerate()
            {
                assert!((joint.own.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                let of_strata = alone.iter().zip(&joint.own);
                let mean: f64 = of_strata
                    .map(|(alone, share)| share * alone[state].mutual_information())
                    .sum();
                let information = joint.mutual_information();
                assert!((information - mean).abs() < 1e-12, "{information} {mean}");
                assert!((information - quick).abs() < 1e-12, "{joint:?} {quick}");
                for (stratum, alone) in alone.iter().enumerate() {
                    let ratio = alone[state].ln_ratio(1, 0);
                    assert!((joint.ln_ratio(2 * stratum + 1, 0) - ratio).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn figures_of_an_action_are_means_over_strata() {
        for joint in stratified(12).joint(&array![[1.0, 0.5], [-2.0, 3.0]]) {
            let policy: f64 = [0, 1].map(|action| joint.policy(action)).iter().sum();
            let divergence = |action| {
                joint.given_action(action, |row| joint.divergence(row)) * joint.policy(action)
            };
            let response = |action: usize, other: usize| {
                joint.given_action(action, |row| joint.response[[row, other]])
            };
            assert!((policy - 1.0).abs() < 1e-12);
            let mean = divergence(0) + divergence(1);
            assert!((mean - joint.mutual_information()).abs() < 1e-12);
            assert!((response(0, 0) + response(0, 1) - 1.0).abs() < 1e-12);
        }
        // Whoever never does a thing has figures of it all the same.
        let never = Joint::from_policies(
            vec![0.5, 0.5],
            vec![1.0, 0.0, 1.0, 0.0],
            array![[0.5, 0.5], [1.0, 0.0], [0.5, 0.5], [1.0, 0.0]],
        );
        let divergence = never.given_action(1, |row| never.divergence(row));
        assert!(divergence.is_finite() && never.mutual_information() == 0.0);
    }

    #[test]
    fn strata_forget_the_interaction_and_keep_their_habits() {
        let inputs = array![[1.0, 0.5], [-2.0, 3.0]];
        for interactions in [4, 12] {
            let mut member = stratified(interactions);
            // What all rows of D have in common is habit.
            let common = member.joint(&inputs);
            member.forget_interaction();
            let after = member.joint(&inputs);
            for (before, after) in common.iter().zip(&after) {
                assert!(after.mutual_information() < 1e-12, "{after:?}");
                assert_eq!((&before.own, &before.ego), (&after.own, &after.ego));
                let is_habit = |stratum: usize| {
                    let [a, b] = [0, 1].map(|i| {
                        let row = before.response.row(2 * stratum + i);
                        (row[0] / row[1]).ln()
                    });
                    let row = after.response.row(2 * stratum);
                    (0.5 * (a + b) - (row[0] / row[1]).ln()).abs() < 1e-5
                };
                assert!((0..3).all(is_habit), "{before:?} {after:?}");
            }
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
