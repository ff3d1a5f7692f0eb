//! Posteriors by action: the Kullback-Leibler divergence of each of the ego's actions and the
//! response to it. Which of them does it, and what the other then does.

use super::counted::{Counted, Ego};
use super::draws::{Draws, Joint};
use super::habits::Habits;
use super::prior::Prior;

/// The posterior of one ego action in a state: its divergence and the response to it.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionPosterior {
    /// Posterior mean of KL(p(other | this action) from p(other)) in nats. Independence counts,
    /// with a divergence of 0.
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
/// The most cells drawn, where that leaves as many draws: of hundreds of thousands of cells, a
/// figure of an action is a mean over dozens of slices, which needs fewer.
const MOST_CELLS: usize = 10_000_000;
const FEWEST_OF_MANY: usize = 20;

/// The most segments that figures are means over: those that were visited most.
const MOST_PARTS: usize = 30;

/// The probability outside an interval, at each end.
const TAIL: f64 = 0.05;

impl Prior {
    /// Returns the posterior of every ego action in a state, in index order, visited or not.
    ///
    /// Means of the divergence and all intervals are of 500 draws from the posterior (fewer where
    /// tables are large), which depend on the counts alone. Actions that were never taken get what
    /// the environment lets one expect. With several slices, an action's figures are their means
    /// over the slices, each by how probable it is with that action; with segments whose habits
    /// rather differ, their means over the segments.
    ///
    /// The largest plug-in divergence is mostly that of the rarest action, and large. Means may be
    /// ranked: they stay near 0 where nothing is known. Where all of them are, their order says
    /// little, and the rarest action still comes first half of the time.
    ///
    /// Not for alphabets with more than [`MOST_CELLS`](super::MOST_CELLS) pairs of actions.
    pub fn by_action<'a>(
        &self,
        habits: &'a Habits,
        counted: impl Into<Counted<'a>>,
        ego: Ego,
    ) -> Vec<ActionPosterior> {
        let draws = Draws::new(self, habits, counted.into(), ego, MOST_PARTS);
        let mut rng = draws.generator();
        let [egos, others] = draws.sizes();
        let cells = egos * others * draws.slices.len();
        let times = (CELLS / cells)
            .clamp(FEWEST_DRAWS, DRAWS)
            .min((MOST_CELLS / cells).max(FEWEST_OF_MANY));

        let mut divergences = vec![Vec::with_capacity(times); egos];
        let mut responses = vec![Vec::with_capacity(times); egos * others];

        for time in 0..times {
            let joints = draws.draw((time as f64 + 0.5) / times as f64, &mut rng);
            let drawn: Vec<Seen> = joints
                .into_iter()
                .enumerate()
                .map(|(at, joint)| Seen::new(joint, draws.share(at)))
                .collect();

            for action in 0..egos {
                let (divergence, response) = over_slices(&drawn, action);
                divergences[action].push(divergence);
                responses[action * others..]
                    .iter_mut()
                    .zip(response)
                    .for_each(|(draws, p)| draws.push(p));
            }
        }

        let predicted = draws.predicted_responses();
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
}

impl Draws<'_> {
    /// Returns how many actions the ego and the other have.
    pub fn sizes(&self) -> [usize; 2] {
        [1 - self.ego, self.ego].map(|side| self.prior.sides[side].letters())
    }

    /// Returns the probability of each joint action at the next visit of a slice, the ego's first.
    /// An action that is not in use has none, but its responses are in proportion to what they
    /// would be.
    pub fn predicted(&self, slice: usize) -> Vec<f64> {
        self.prior.predicted(
            self.ego,
            self.habits,
            &self.weights,
            &self.slices[slice],
            &self.weights.deviants[slice],
        )
    }

    /// Returns the probability of each of the other's actions after each of the ego's at the next
    /// visit.
    fn predicted_responses(&self) -> Vec<Vec<f64>> {
        let [egos, others] = self.sizes();
        let mut responses = vec![vec![0.0; others]; egos];

        for slice in 0..self.slices.len() {
            let predicted = self.predicted(slice);
            for (response, cells) in responses.iter_mut().zip(predicted.chunks(others)) {
                response
                    .iter_mut()
                    .zip(cells)
                    .for_each(|(sum, p)| *sum += self.share(slice) * p);
            }
        }

        for response in &mut responses {
            let total: f64 = response.iter().sum();
            response.iter_mut().for_each(|p| *p /= total);
        }

        responses
    }
}

/// A joint distribution of a slice as the ego sees it.
struct Seen {
    joint: Joint,
    /// What the other does on the whole.
    marginal: Vec<f64>,
    /// The slice's share of the visits.
    share: f64,
}

impl Seen {
    fn new(joint: Joint, share: f64) -> Self {
        Self {
            marginal: joint.marginal(),
            joint,
            share,
        }
    }
}

/// Returns the divergence and the response of an ego action, averaged over the slices by their
/// shares among visits with that action.
fn over_slices(slices: &[Seen], action: usize) -> (f64, Vec<f64>) {
    let others = slices[0].marginal.len();
    let (mut divergence, mut response, mut weights) = (0.0, vec![0.0; others], 0.0);

    for Seen {
        joint,
        marginal,
        share,
    } in slices
    {
        // However improbable an action became, its share among slices is defined.
        let weight = share * joint.policy[action].max(f64::MIN_POSITIVE);
        let row = &joint.responses[action * others..][..others];

        weights += weight;
        divergence += weight * divergence_of(row, marginal);
        response
            .iter_mut()
            .zip(row)
            .for_each(|(sum, p)| *sum += weight * p);
    }

    response.iter_mut().for_each(|p| *p /= weights);
    (divergence / weights, response)
}

/// Returns KL(p from q) = sum p ln(p / q), in nats, at least 0. Where q underflowed, so did what p
/// could add.
fn divergence_of(p: &[f64], q: &[f64]) -> f64 {
    let terms = p
        .iter()
        .zip(q)
        .filter(|(p, q)| **p > 0.0 && **q > 0.0)
        .map(|(p, q)| p * (p / q).ln());
    terms.sum::<f64>().max(0.0)
}

/// Returns the 5 % and 95 % quantiles of draws.
fn interval(draws: &mut [f64]) -> [f64; 2] {
    let last = draws.len() - 1;
    [TAIL, 1.0 - TAIL].map(|p| {
        *draws
            .select_nth_unstable_by((p * last as f64).round() as usize, f64::total_cmp)
            .1
    })
}
