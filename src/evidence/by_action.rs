//! Which of the ego's actions does it: how far each moves the other, and what the other then does.

use super::draws::{Draws, Joint};
use super::prior::Prior;
use crate::information::Table;

/// Where the ego stands in a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ego {
    /// Its actions are the rows: it is the earlier variable.
    Rows,
    /// Its actions are the columns.
    Columns,
}

/// What is believed of one ego action in a state.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionPosterior {
    /// Posterior mean of KL(p(other | this action) from p(other)) in nats. Independence counts, with a divergence of 0.
    pub divergence_mean: f64,
    /// Its 90 % credible interval.
    pub divergence_interval: [f64; 2],
    /// The probability of each of the other's actions after this one at the next visit; sums to 1.
    pub response: Vec<f64>,
    /// The 90 % credible interval of each of them.
    pub response_intervals: Vec<[f64; 2]>,
}

/// Draws for one state, and cells drawn below which there are as many.
const DRAWS: usize = 500;
const CELLS: usize = 200_000;
const FEWEST_DRAWS: usize = 100;

/// The probability outside an interval, at each end.
const TAIL: f64 = 0.05;

impl Prior {
    /// Returns what is believed of every ego action in a state, in index order, visited or not.
    ///
    /// Means of the divergence and all intervals are of 500 draws from the posterior (fewer where tables are large), which depend on the counts alone.
    /// Actions that were never taken get what the environment lets one expect. With several slices, an action's figures are their means over the
    /// slices, each by how probable it is with that action.
    ///
    /// The largest plug-in divergence is mostly that of the rarest action, and large. Means may be ranked: they stay near 0 where nothing is known. Where
    /// all of them are, their order says little, and the rarest action still comes first half of the time.
    ///
    /// Not for alphabets with more than [`MOST_CELLS`](super::MOST_CELLS) pairs of actions.
    pub fn by_action(&self, slices: &[Table], ego: Ego) -> Vec<ActionPosterior> {
        let draws = Draws::new(self, slices);
        let mut rng = draws.generator();
        let [egos, others] = self.sizes(ego);
        let times = (CELLS / (egos * others * draws.slices.len())).clamp(FEWEST_DRAWS, DRAWS);
        let mut divergences = vec![Vec::with_capacity(times); egos];
        let mut responses = vec![Vec::with_capacity(times); egos * others];
        for time in 0..times {
            let joints = draws.draw((time as f64 + 0.5) / times as f64, &mut rng);
            let shares = draws.slices.iter().map(|slice| slice.share);
            let drawn =
                joints.iter().zip(shares).map(|(joint, share)| (conditional(joint, ego), share)).collect::<Vec<_>>();
            for action in 0..egos {
                let (divergence, response) = over_slices(&drawn, action);
                divergences[action].push(divergence);
                responses[action * others..].iter_mut().zip(response).for_each(|(draws, p)| draws.push(p));
            }
        }
        let predicted = self.predicted_responses(&draws, ego);
        let figures = |(action, divergences): (usize, &mut Vec<f64>)| ActionPosterior {
            divergence_mean: divergences.iter().sum::<f64>() / times as f64,
            divergence_interval: interval(divergences),
            response: predicted[action].clone(),
            response_intervals: responses[action * others..][..others]
                .iter_mut()
                .map(|draws| interval(draws))
                .collect(),
        };
        divergences.iter_mut().enumerate().map(figures).collect()
    }

    /// Returns the probability of each of the other's actions after each of the ego's at the next visit.
    fn predicted_responses(&self, draws: &Draws, ego: Ego) -> Vec<Vec<f64>> {
        let [egos, others] = self.sizes(ego);
        let mut responses = vec![vec![0.0; others]; egos];
        for slice in &draws.slices {
            let predicted = draws.predicted(slice);
            for (action, response) in responses.iter_mut().enumerate() {
                for (other, sum) in response.iter_mut().enumerate() {
                    *sum += slice.share * predicted[self.cell(ego, action, other)];
                }
            }
        }
        for response in &mut responses {
            let total: f64 = response.iter().sum();
            response.iter_mut().for_each(|p| *p /= total);
        }
        responses
    }

    /// Returns how many actions the ego and the other have.
    pub(super) fn sizes(&self, ego: Ego) -> [usize; 2] {
        let [rows, columns] = [self.likelihood.alphabet.rows as usize, self.likelihood.alphabet.columns as usize];
        if ego == Ego::Rows { [rows, columns] } else { [columns, rows] }
    }

    /// Returns the position of a pair of actions in a table, rows first.
    pub(super) fn cell(&self, ego: Ego, action: usize, other: usize) -> usize {
        let columns = self.likelihood.alphabet.columns as usize;
        if ego == Ego::Rows { action * columns + other } else { other * columns + action }
    }
}

/// A joint distribution as the ego sees it.
struct Conditional {
    /// The probability of each ego action.
    policy: Vec<f64>,
    /// What the other does after each of them, one after another.
    responses: Vec<f64>,
    /// What the other does on the whole.
    marginal: Vec<f64>,
}

fn conditional(joint: &Joint, ego: Ego) -> Conditional {
    let Joint { policy, responses } = joint;
    let columns = responses.len() / policy.len();
    let mut marginal = vec![0.0; columns];
    for (p, row) in policy.iter().zip(responses.chunks(columns)) {
        marginal.iter_mut().zip(row).for_each(|(sum, rho)| *sum += p * rho);
    }
    if ego == Ego::Rows {
        return Conditional { policy: policy.clone(), responses: responses.clone(), marginal };
    }
    let reversed = |column: usize| {
        let seen = marginal[column];
        // A column whose probability underflowed tells nothing of the row.
        let p =
            move |(row, p): (usize, &f64)| if seen > 0.0 { p * responses[row * columns + column] / seen } else { *p };
        policy.iter().enumerate().map(p)
    };
    let responses = (0..columns).flat_map(reversed).collect();
    Conditional { policy: marginal.clone(), responses, marginal: policy.clone() }
}

/// Returns the divergence and the response of an ego action, averaged over the slices by their shares among visits with that action.
fn over_slices(slices: &[(Conditional, f64)], action: usize) -> (f64, Vec<f64>) {
    let others = slices[0].0.marginal.len();
    let (mut divergence, mut response, mut weights) = (0.0, vec![0.0; others], 0.0);
    for (slice, share) in slices {
        // However improbable an action became, its share among slices is defined.
        let weight = share * slice.policy[action].max(f64::MIN_POSITIVE);
        let row = &slice.responses[action * others..][..others];
        weights += weight;
        divergence += weight * divergence_of(row, &slice.marginal);
        response.iter_mut().zip(row).for_each(|(sum, p)| *sum += weight * p);
    }
    response.iter_mut().for_each(|p| *p /= weights);
    (divergence / weights, response)
}

/// Returns KL(p from q) = sum p ln(p / q), in nats, at least 0. Where q underflowed, so did what p could add.
fn divergence_of(p: &[f64], q: &[f64]) -> f64 {
    let terms = p.iter().zip(q).filter(|(p, q)| **p > 0.0 && **q > 0.0).map(|(p, q)| p * (p / q).ln());
    terms.sum::<f64>().max(0.0)
}

/// Returns the 5 % and 95 % quantiles of draws.
fn interval(draws: &mut [f64]) -> [f64; 2] {
    let last = draws.len() - 1;
    [TAIL, 1.0 - TAIL].map(|p| *draws.select_nth_unstable_by((p * last as f64).round() as usize, f64::total_cmp).1)
}
