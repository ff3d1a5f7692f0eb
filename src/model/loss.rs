//! Cross-entropies (log loss) of what a network puts out, in nats, with their gradients by its
//! outputs, in forms that overflow nowhere.
//!
//! Gradients take the place of the outputs: nobody needs those any more.

use ndarray::{ArrayView2, ArrayViewMut2};

use super::letters::Letters;

/// Returns the cross-entropy of a joint network, -sum n_ij [ln p(i) + ln p(j | i)] / N, where p(i)
/// = softmax(e) and p(j | i) = softmax(o + D_i).
///
/// `outputs` is `[states, e then o then D]`, `draws` `[states, ego x other]`. With l = o + D_i and
/// n_i = sum_j n_ij, the derivative by D_ij is [n_i p(j | i) - n_ij] / N, that by o_j its sum over
/// i, and that by e_i is [n p(i) - n_i] / N.
///
/// At a lag it is the sum over strata h of the same, each with outputs of its own, and of
/// -n_h ln p(h) / N, p(h) = softmax(w): `outputs` is `[states, w then all e then all o then all D]`,
/// `draws` `[states, strata x ego x other]`, and the derivative by w_h is [n p(h) - n_h] / N. Where
/// strata share one D, its derivatives are the sums over strata.
pub fn joint_cross_entropy(
    letters: Letters,
    mut outputs: ArrayViewMut2<'_, f32>,
    draws: ArrayView2<'_, f32>,
) -> f32 {
    let [rows, columns, strata] = [
        letters.actions.rows,
        letters.actions.columns,
        letters.strata,
    ]
    .map(|letters| letters as usize);
    let own = if strata > 1 { strata } else { 0 };
    let mut loss = StratumLoss::new(rows, columns, 1.0 / draws.sum());
    let mut shared = vec![0.0; 2 * rows * columns];

    for (mut outputs, draws) in outputs.rows_mut().into_iter().zip(draws.rows()) {
        let outputs = outputs
            .as_slice_mut()
            .expect("a row of the standard layout");
        let draws = draws.as_slice().expect("a row of the standard layout");
        let (own, outputs) = outputs.split_at_mut(own);
        let (ego, outputs) = outputs.split_at_mut(strata * rows);
        let (other, interaction) = outputs.split_at_mut(strata * columns);

        let of_strata = ego
            .chunks_exact_mut(rows)
            .zip(other.chunks_exact_mut(columns))
            .zip(draws.chunks_exact(rows * columns));
        if interaction.len() == strata * rows * columns {
            let of_strata = of_strata.zip(interaction.chunks_exact_mut(rows * columns));
            for (((ego, other), draws), interaction) in of_strata {
                loss.add(ego, other, interaction, draws);
            }
        } else {
            let (of_stratum, sum) = shared.split_at_mut(rows * columns);
            sum.fill(0.0);
            for ((ego, other), draws) in of_strata {
                of_stratum.copy_from_slice(interaction);
                loss.add(ego, other, of_stratum, draws);
                sum.iter_mut()
                    .zip(&*of_stratum)
                    .for_each(|(sum, d)| *sum += d);
            }
            interaction.copy_from_slice(sum);
        }
        loss.add_own(own, draws);
    }
    loss.sum * loss.scale
}

/// Adds up the losses of strata, and leaves their derivatives in place of the outputs.
struct StratumLoss {
    /// What derivatives are multiplied by: 1 / N.
    scale: f32,
    sum: f32,
    /// How often the ego took each action.
    actions: Vec<f32>,
    habit: Vec<f32>,
    logits: Vec<f32>,
}

impl StratumLoss {
    fn new(rows: usize, columns: usize, scale: f32) -> Self {
        let [habit, logits] = [(); 2].map(|()| vec![0.0; columns]);
        Self {
            scale,
            sum: 0.0,
            actions: vec![0.0; rows],
            habit,
            logits,
        }
    }

    /// Adds what both do in a stratum: e, o and D.
    fn add(&mut self, ego: &mut [f32], other: &mut [f32], interaction: &mut [f32], draws: &[f32]) {
        let columns = other.len();
        // The habit is needed for each of the ego's actions, before its gradient takes its place.
        self.habit.copy_from_slice(other);
        other.fill(0.0);
        let responses = interaction
            .chunks_exact_mut(columns)
            .zip(draws.chunks_exact(columns));
        for ((response, draws), n) in responses.zip(&mut self.actions) {
            *n = draws.iter().sum();
            // After an action that was not drawn, whatever is said costs nothing.
            if *n == 0.0 {
                response.fill(0.0);
                continue;
            }

            let sums = self.habit.iter().zip(&*response).map(|(o, d)| o + d);
            self.logits
                .iter_mut()
                .zip(sums)
                .for_each(|(logit, sum)| *logit = sum);
            self.sum += categorical(&mut self.logits, draws, *n, self.scale);
            response.copy_from_slice(&self.logits);
            other
                .iter_mut()
                .zip(&self.logits)
                .for_each(|(sum, d)| *sum += d);
        }
        let n = self.actions.iter().sum();
        self.sum += categorical(ego, &self.actions, n, self.scale);
    }

    /// Adds what is held fixed in a state: w, or nothing.
    fn add_own(&mut self, own: &mut [f32], draws: &[f32]) {
        if own.is_empty() {
            return;
        }
        let of_stratum = draws.chunks_exact(draws.len() / own.len());
        let n: Vec<f32> = of_stratum.map(|draws| draws.iter().sum()).collect();
        self.sum += categorical(own, &n, n.iter().sum(), self.scale);
    }
}

/// Returns -sum n_j ln p_j, p = softmax(logits), and leaves its derivatives by the logits in their
/// place, scaled: n p_j - n_j.
fn categorical(logits: &mut [f32], draws: &[f32], n: f32, scale: f32) -> f32 {
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (mut sum, mut chosen) = (0.0, 0.0);
    for (logit, draws) in logits.iter_mut().zip(draws) {
        let shifted = *logit - largest;
        chosen += draws * shifted;
        *logit = shifted.exp();
        sum += *logit;
    }

    let share = n * scale / sum;
    for (logit, draws) in logits.iter_mut().zip(draws) {
        *logit = share * *logit - scale * draws;
    }
    n * sum.ln() - chosen
}

/// Returns the cross-entropy of a direct network: that of q = logistic(z) against p, the weighted
/// mean of max(z, 0) - p z + ln(1 + e^-|z|). The derivative by z is w (q - p) / W.
///
/// `outputs` and `targets` are `[states, 1]`.
pub fn binary_cross_entropy(
    mut outputs: ArrayViewMut2<'_, f32>,
    targets: ArrayView2<'_, f32>,
    weights: &[f32],
) -> f32 {
    let scale = 1.0 / weights.iter().sum::<f32>();
    let mut loss = 0.0;

    for ((output, p), weight) in outputs.iter_mut().zip(targets).zip(weights) {
        let z = *output;
        loss += weight * (z.max(0.0) - p * z + (-z.abs()).exp().ln_1p());
        *output = scale * weight * (1.0 / (1.0 + (-z).exp()) - p);
    }
    loss * scale
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, array};

    use super::*;
    use crate::information::Alphabet;

    /// Between 32-bit derivatives and 64-bit differences.
    const PRECISION: f64 = 2e-6;
    const LETTERS: Letters = letters(2, 3, 1);

    const fn letters(rows: u64, columns: u64, strata: u64) -> Letters {
        Letters {
            actions: Alphabet { rows, columns },
            strata,
        }
    }

    /// -sum n_ij [ln p(i) + ln p(j | i)] / N as it is written, in 64 bits.
    fn reference(outputs: &Array2<f64>, draws: &Array2<f32>) -> f64 {
        let ln_softmax = |logits: &[f64], at: usize| {
            logits[at] - logits.iter().map(|logit| logit.exp()).sum::<f64>().ln()
        };
        let mut sum = 0.0;
        for ((state, cell), n) in draws.indexed_iter() {
            let (i, j) = (cell / 3, cell % 3);
            let outputs = outputs.row(state).to_vec();
            let response: Vec<f64> = (0..3)
                .map(|j| outputs[2 + j] + outputs[5 + 3 * i + j])
                .collect();
            sum -= f64::from(*n) * (ln_softmax(&outputs[..2], i) + ln_softmax(&response, j));
        }
        sum / f64::from(draws.sum())
    }

    #[test]
    fn derivatives_of_the_joint_loss_are_its_differences() {
        let outputs = Array2::from_shape_fn((2, 11), |(s, k)| ((7 * s + 3 * k) as f64).sin());
        // In the second state the ego never took its first action.
        let draws = array![
            [3.0, 0.0, 1.0, 2.0, 5.0, 0.0],
            [0.0, 0.0, 0.0, 1.0, 0.0, 4.0]
        ];
        let mut derivatives = outputs.mapv(|output| output as f32);
        let loss = joint_cross_entropy(LETTERS, derivatives.view_mut(), draws.view());

        assert!((f64::from(loss) - reference(&outputs, &draws)).abs() < PRECISION);
        for (at, derivative) in derivatives.indexed_iter() {
            let moved = |by: f64| {
                let mut outputs = outputs.clone();
                outputs[at] += by;
                reference(&outputs, &draws)
            };
            let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            assert!(
                (f64::from(*derivative) - difference).abs() < PRECISION,
                "{at:?}: {derivative} {difference}"
            );
        }
    }

    /// The sum over strata as it is written, in 64 bits: of three strata of two and two actions, which
    /// share their D or have each its own.
    fn stratified_reference(outputs: &Array2<f64>, draws: &Array2<f32>) -> f64 {
        let is_shared = outputs.ncols() == 19;
        let ln_softmax = |logits: &[f64], at: usize| {
            logits[at] - logits.iter().map(|logit| logit.exp()).sum::<f64>().ln()
        };
        let mut sum = 0.0;
        for ((state, cell), n) in draws.indexed_iter() {
            let (h, i, j) = (cell / 4, cell / 2 % 2, cell % 2);
            let outputs = outputs.row(state).to_vec();
            let response: Vec<f64> = (0..2)
                .map(|j| {
                    let first = if is_shared { 15 } else { 15 + 4 * h };
                    outputs[9 + 2 * h + j] + outputs[first + 2 * i + j]
                })
                .collect();
            let ego = &outputs[3 + 2 * h..][..2];
            let likelihood =
                ln_softmax(&outputs[..3], h) + ln_softmax(ego, i) + ln_softmax(&response, j);
            sum -= f64::from(*n) * likelihood;
        }
        sum / f64::from(draws.sum())
    }

    #[test]
    fn derivatives_of_the_loss_of_strata_are_its_differences() {
        // In the first state the second stratum was never drawn, in the second it is alone.
        let draws = Array2::from_shape_fn((2, 12), |(s, cell)| {
            if (cell / 4 == 1) == (s == 1) {
                ((5 * cell + s) % 4) as f32
            } else {
                0.0
            }
        });
        for width in [19, 27] {
            let outputs =
                Array2::from_shape_fn((2, width), |(s, k)| ((7 * s + 3 * k) as f64).sin());
            let mut derivatives = outputs.mapv(|output| output as f32);
            let loss = joint_cross_entropy(letters(2, 2, 3), derivatives.view_mut(), draws.view());

            assert!((f64::from(loss) - stratified_reference(&outputs, &draws)).abs() < PRECISION);
            for (at, derivative) in derivatives.indexed_iter() {
                let moved = |by: f64| {
                    let mut outputs = outputs.clone();
                    outputs[at] += by;
                    stratified_reference(&outputs, &draws)
                };
                let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                assert!(
                    (f64::from(*derivative) - difference).abs() < PRECISION,
                    "{at:?} of {width}: {derivative} {difference}"
                );
            }
        }
    }

    #[test]
    fn derivatives_of_the_direct_loss_are_its_differences() {
        let z = array![[-3.0_f64], [0.25], [8.0]];
        let (p, weights) = (array![[0.1_f32], [1.0], [0.3]], [1.0_f32, 2.5, 7.0]);
        let mut derivatives = z.mapv(|z| z as f32);
        binary_cross_entropy(derivatives.view_mut(), p.view(), &weights);

        let reference = |at: usize, z: f64| {
            let (q, p) = (1.0 / (1.0 + (-z).exp()), f64::from(p[[at, 0]]));
            -f64::from(weights[at]) * (p * q.ln() + (1.0 - p) * (1.0 - q).ln()) / 10.5
        };
        for (at, derivative) in derivatives.iter().enumerate() {
            let z = z[[at, 0]];
            let difference = (reference(at, z + 1e-5) - reference(at, z - 1e-5)) / 2e-5;
            assert!(
                (f64::from(*derivative) - difference).abs() < PRECISION,
                "{at}: {derivative} {difference}"
            );
        }
    }

    #[test]
    fn extreme_odds_have_a_finite_loss() {
        let mut z = array![[-1e30_f32], [1e30], [0.0]];
        let p = array![[0.0_f32], [1.0], [0.5]];
        let loss = binary_cross_entropy(z.view_mut(), p.view(), &[1.0; 3]);
        assert!((loss - 2_f32.ln() / 3.0).abs() < 1e-6, "{loss}");
        assert_eq!(z, array![[0.0_f32], [0.0], [0.0]]);
    }

    #[test]
    fn extreme_logits_have_a_finite_loss() {
        let mut outputs = array![[
            1e30_f32, -1e30, 1e30, 0.0, -1e30, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        ]];
        let draws = array![[4.0_f32, 0.0, 0.0, 0.0, 0.0, 0.0]];
        let loss = joint_cross_entropy(LETTERS, outputs.view_mut(), draws.view());
        assert_eq!(loss, 0.0);
        assert!(
            outputs.iter().all(|derivative| *derivative == 0.0),
            "{outputs}"
        );
    }

    #[test]
    fn an_alphabet_of_one_letter_costs_nothing() {
        let mut outputs = array![[0.3_f32, -2.0, 5.0]];
        let loss = joint_cross_entropy(letters(1, 1, 1), outputs.view_mut(), array![[9.0]].view());
        assert_eq!((loss, outputs), (0.0, array![[0.0, 0.0, 0.0]]));
    }

    #[test]
    fn what_is_no_number_is_told() {
        let mut outputs = Array2::from_elem((1, 11), f32::NAN);
        let draws = array![[1.0_f32, 0.0, 0.0, 0.0, 0.0, 0.0]];
        assert!(joint_cross_entropy(LETTERS, outputs.view_mut(), draws.view()).is_nan());
        let p = array![[0.5_f32]];
        let mut z = array![[f32::NAN]];
        assert!(binary_cross_entropy(z.view_mut(), p.view(), &[1.0]).is_nan());
    }
}
