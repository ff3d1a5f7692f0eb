//! Mutual information under another policy (off-policy evaluation): what is believed of it had the ego
//! other habits, the other's responses being what they are. By sampling, since moments have a closed
//! form for the policy that was seen alone.

use rand_pcg::Pcg64;

use super::counted::{Counted, Ego};
use super::decision::Beliefs;
use super::draws::{Draws, Joint, dirichlet};
use super::habits::Habits;
use super::prior::Prior;
use super::region::RegionState;
use crate::information::Table;

/// Draws if there is dependence: a probability is known to .035.
const DRAWS: usize = 200;
/// Cells drawn beyond which there are fewer draws, and the fewest.
const CELLS: usize = 2_000_000;
const FEWEST_DRAWS: usize = 50;

/// The probability outside an interval, at each end.
const TAIL: f64 = 0.05;

/// The most segments that figures are means over.
const MOST_PARTS: usize = 30;

/// What is believed of mutual information under a policy.
#[derive(Debug, Clone, PartialEq)]
pub struct PolicyPosterior {
    dependent: f64,
    /// If there is dependence, in nats, rising.
    draws: Vec<f64>,
}

/// What is believed of a policy over the ego's actions.
#[derive(Debug, Clone, PartialEq)]
pub enum PolicyBelief {
    /// It is known: probabilities that sum to 1.
    Known(Vec<f64>),
    /// It was seen at work: the parameters of a Dirichlet distribution.
    Seen(Vec<f64>),
}

impl PolicyBelief {
    fn draw(&self, rng: &mut Pcg64) -> Vec<f64> {
        match self {
            Self::Known(policy) => policy.clone(),
            Self::Seen(parameters) => dirichlet(parameters, rng),
        }
    }
}

impl Prior {
    /// Returns what is believed of the policy of an ego by a table of what it did, its actions as rows,
    /// and by the habits of the environment.
    pub fn policy_seen(&self, habits: &Habits, ego: Ego, table: &Table) -> PolicyBelief {
        let side = &self.sides[ego.side()];
        let policy = side.policy(table, habits.driver(ego.side()));
        PolicyBelief::Seen(policy.parameters(table))
    }

    /// Returns the policy that takes each action in use alike.
    pub fn uniform_policy(&self, habits: &Habits, ego: Ego) -> PolicyBelief {
        let usage = habits.driver(ego.side());
        let share = |h: &f64| f64::from(*h > 0.0) / usage.used as f64;
        PolicyBelief::Known(usage.shares.iter().map(share).collect())
    }

    /// Returns what is believed of I = sum_i p_i KL(rho_i || sum p rho) in a state, with p a policy
    /// over the ego's actions and rho their responses by all counts; with several slices its mean
    /// over them. The probability of any dependence is that under the observed policy.
    ///
    /// Not for alphabets with more than [`MOST_CELLS`](super::MOST_CELLS) pairs of actions.
    pub fn under_policy<'a>(
        &self,
        habits: &'a Habits,
        counted: impl Into<Counted<'a>>,
        ego: Ego,
        policy: &PolicyBelief,
    ) -> PolicyPosterior {
        let draws = Draws::new(self, habits, counted.into(), ego, MOST_PARTS);
        let mut rng = draws.generator();
        let [egos, others] = draws.sizes();
        let times = (CELLS / (egos * others * draws.slices.len())).clamp(FEWEST_DRAWS, DRAWS);
        let dependent = draws.weights.dependent;

        let drawn = (0..times).map(|time| {
            let among_dependent = (time as f64 + 0.5) / times as f64;
            let joints = draws.draw(1.0 - dependent + dependent * among_dependent, &mut rng);
            let policy = policy.draw(&mut rng);
            let weighed = joints.into_iter().enumerate();
            weighed
                .map(|(slice, joint)| draws.share(slice) * under(joint, &policy).information())
                .sum::<f64>()
                .max(0.0)
        });
        let mut drawn: Vec<f64> = drawn.collect();
        drawn.sort_by(f64::total_cmp);
        PolicyPosterior {
            dependent,
            draws: drawn,
        }
    }
}

/// Returns about where sorted draws reach p.
fn quantile(draws: &[f64], p: f64) -> f64 {
    draws[(p * (draws.len() - 1) as f64).round() as usize]
}

fn under(joint: Joint, policy: &[f64]) -> Joint {
    Joint {
        policy: policy.to_vec(),
        ..joint
    }
}

impl PolicyPosterior {
    /// Returns what is believed at a threshold, t >= 0 in nats.
    pub fn beliefs(&self, nats: f64) -> Beliefs {
        let below = self.draws.partition_point(|draw| *draw <= nats);
        let above = 1.0 - below as f64 / self.draws.len() as f64;
        let above_if_dependent = if nats > 0.0 { above } else { 1.0 };
        Beliefs {
            dependent: self.dependent,
            above: self.dependent * above_if_dependent,
            above_if_dependent,
        }
    }

    /// Returns the posterior mean, in nats.
    pub fn mean(&self) -> f64 {
        self.dependent * self.mean_if_dependent()
    }

    /// Returns a 90 % credible interval, in nats.
    pub fn interval(&self) -> [f64; 2] {
        let independent = 1.0 - self.dependent;
        let at = |p: f64| match p > independent {
            true => quantile(&self.draws, (p - independent) / self.dependent),
            false => 0.0,
        };
        [TAIL, 1.0 - TAIL].map(at)
    }

    /// Returns what a state with so many visits adds to a region.
    pub fn region_state(&self, visits: u64) -> RegionState {
        let mean = self.mean_if_dependent();
        let squares = self.draws.iter().map(|draw| (draw - mean).powi(2));
        RegionState {
            visits,
            dependent: self.dependent,
            mean,
            deviation: (squares.sum::<f64>() / self.draws.len() as f64).sqrt(),
        }
    }

    fn mean_if_dependent(&self) -> f64 {
        self.draws.iter().sum::<f64>() / self.draws.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Fit;
    use crate::information::Alphabet;

    const LETTERS: Alphabet = Alphabet {
        rows: 3,
        columns: 3,
    };

    fn prior() -> Prior {
        Prior::new(&Fit::cold(LETTERS))
    }

    /// Actions 0 and 1 are copied, and 2, which is nearly all that is done, is answered by 0.
    fn copied() -> Table {
        Table::from_counts([(0, 0, 40), (1, 1, 40), (2, 0, 800), (0, 1, 2), (1, 0, 2)])
    }

    #[test]
    fn the_observed_policy_gives_what_the_closed_form_gives() {
        let (prior, table) = (prior(), copied());
        let habits = Habits::new(&[42, 42, 800], &[842, 42, 0]);
        let slices = std::slice::from_ref(&table);
        let expected = prior.posterior(&habits, slices).mean();
        let policy = prior.policy_seen(&habits, Ego::Rows, &table);
        let told = prior.under_policy(&habits, slices, Ego::Rows, &policy);
        assert!(
            (told.mean() - expected).abs() < 0.15 * expected,
            "{} beside {expected}",
            told.mean()
        );
    }

    #[test]
    fn actions_that_are_rare_weigh_what_the_policy_says() {
        let (prior, table) = (prior(), copied());
        let habits = Habits::new(&[42, 42, 800], &[842, 42, 0]);
        let slices = std::slice::from_ref(&table);
        let uniform = prior.uniform_policy(&habits, Ego::Rows);
        assert_eq!(uniform, PolicyBelief::Known(vec![1.0 / 3.0; 3]));

        let told = prior.under_policy(&habits, slices, Ego::Rows, &uniform);
        let [low, high] = told.interval();
        // Two in three are answered by 0, one by 1; each of the copied ones fails twice in 42.
        let entropy = |p: f64| -p * p.ln() - (1.0 - p) * (1.0 - p).ln();
        let expected = entropy(1.0 / 3.0) - 2.0 / 3.0 * entropy(2.0 / 42.0);
        let mean = told.mean();
        assert!((mean - expected).abs() < 0.05, "{mean} beside {expected}");
        assert!(low < expected && expected < high, "{low} to {high}");
        assert!(told.beliefs(0.3).above > 0.95 && told.beliefs(1.0).above < 0.05);
    }
}
