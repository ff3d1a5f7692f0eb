//! The posterior of mean mutual information over the states of a region: a hierarchical model whose
//! region has a share of dependent states of its own.
//!
//! The fit of an environment says which share pi of its states is dependent. A region is asked about
//! because it may be another kind of place, so its share phi is unknown, Beta(A pi, A (1 - pi)). Given
//! phi, states are independent: the probability of dependence of one is phi B / (1 - phi + phi B), with
//! B = odds(P) / odds(pi) from its own posterior.
//!
//! phi is learnt from the pooled size of the dependence, which is unbiased under independence however
//! few visits each state has: a share is likely as far as the mean mutual information that follows from
//! it agrees with the size. Not from the product of the B: of a state seen three times B is a little
//! off, as its null is not quite the state's, and a thousand states would multiply that to certainty.

use statrs::function::erf::erfc;
use statrs::function::gamma::gamma_lr;

use super::decision::Beliefs;
use super::posterior::Posterior;
use crate::information::pooled::Pooled;

/// What one state adds to a region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegionState {
    /// Its visits, which weigh it.
    pub visits: u64,
    /// P(MI > 0) by its own counts.
    pub dependent: f64,
    /// The mean of MI if there is dependence, in nats.
    pub mean: f64,
    /// Its standard deviation if there is dependence, in nats.
    pub deviation: f64,
}

impl RegionState {
    /// Takes what is believed of a state with so many visits.
    pub fn new(visits: u64, posterior: &Posterior) -> Self {
        let [believed, deviation] = posterior.moments_if_dependent();
        // What the table says by itself may have moved the mean.
        let mean = match posterior.dependent() {
            dependent if dependent > NEAREST => posterior.mean() / dependent,
            _ => believed,
        };
        Self {
            visits,
            dependent: posterior.dependent(),
            mean,
            deviation,
        }
    }
}

/// The states of a region so far.
#[derive(Debug, Clone)]
pub struct RegionStates {
    /// ln odds of the share of dependent states in the environment.
    prior: f64,
    states: u64,
    visits: f64,
    shares: Vec<AtShare>,
}

/// Sums over the states, were this the region's share of dependent states.
#[derive(Debug, Clone, Copy)]
struct AtShare {
    ln_odds: f64,
    /// sum ln(1 - phi + phi B): the log-likelihood of phi.
    ln_likelihood: f64,
    /// sum ln(1 - P): the log of the probability that no state is dependent.
    ln_none: f64,
    /// sum n P.
    dependent: f64,
    /// sum n E MI.
    mean: f64,
    /// sum n^2 Var MI.
    variance: f64,
    /// sum n P times the standard deviation of MI if there is dependence.
    spread: f64,
}

/// What is believed of mean mutual information over a region, weighted by visits: a mixture over the
/// shares of dependent states, each a point mass at 0 (no state is dependent) and a gamma
/// distribution.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionPosterior {
    dependent_share: f64,
    components: Vec<Component>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Component {
    weight: f64,
    /// The probability that no state is dependent.
    none: f64,
    /// Of the rest, in nats; a variance of 0 is a point.
    mean: f64,
    variance: f64,
}

/// How far what is believed of dependent states is off together, in their standard deviations: they
/// are of one family, which may not be the right one.
const TOGETHER: f64 = 0.5;
/// Half the standard normal quantiles of a 95 % interval apart.
const NORMAL: f64 = 1.959_963_984_540_054;
/// The concentration of a region's share of dependent states around the environment's: so many
/// states' worth.
const CONCENTRATION: f64 = 2.0;
/// The grid of ln odds of the share: from one in 60,000 to all but as many.
const LARGEST_LN_ODDS: f64 = 11.0;
const STEP: f64 = 0.5;
/// Nearer to 0 or 1 no probability of dependence is believed.
const NEAREST: f64 = 1e-12;
/// Lighter components are left out.
const LIGHTEST: f64 = 1e-9;
/// The probability outside an interval, at each end.
const TAIL: f64 = 0.05;

impl RegionStates {
    /// Begins a region of an environment with this share of dependent states, in (0, 1).
    pub fn new(dependent_share: f64) -> Self {
        let steps = (LARGEST_LN_ODDS / STEP) as i32;
        let shares = (-steps..=steps).map(|step| AtShare::new(f64::from(step) * STEP));
        Self {
            prior: ln_odds(dependent_share),
            states: 0,
            visits: 0.0,
            shares: shares.collect(),
        }
    }

    /// Adds a state; one without visits changes nothing.
    pub fn add(&mut self, state: RegionState) {
        if state.visits == 0 {
            return;
        }
        let visits = state.visits as f64;
        let ln_bayes_factor = ln_odds(state.dependent) - self.prior;

        self.states += 1;
        self.visits += visits;
        for share in &mut self.shares {
            share.add(visits, ln_bayes_factor, state);
        }
    }

    /// Returns what is believed of all states together, which show this; `None` of no states.
    pub fn posterior(&self, pooled: &Pooled) -> Option<RegionPosterior> {
        if self.states == 0 {
            return None;
        }
        // One state has said by itself what it has to say, the size of its own table included.
        let own = 1.0 / self.states as f64;
        let weight = |share: &AtShare| {
            let agreement = ln_agreement(pooled, share.mean / self.visits);
            share.ln_prior(self.prior) + own * share.ln_likelihood + (1.0 - own) * agreement
        };
        let heaviest = self.shares.iter().map(weight).fold(f64::MIN, f64::max);
        let weights = self
            .shares
            .iter()
            .map(|share| (weight(share) - heaviest).exp());
        let total: f64 = weights.clone().sum();

        let weighed = self.shares.iter().zip(weights.map(|weight| weight / total));
        let heavy = weighed.clone().filter(|(_, weight)| *weight > LIGHTEST);
        let components = heavy.map(|(share, weight)| share.component(weight, self.visits));
        let dependent = |(share, weight): (&AtShare, f64)| weight * share.dependent;
        Some(RegionPosterior {
            components: components.collect(),
            dependent_share: weighed.map(dependent).sum::<f64>() / self.visits,
        })
    }
}

/// Returns the log-likelihood of mean mutual information by the size, but for a constant; 0 where the
/// strata tell no size.
fn ln_agreement(pooled: &Pooled, mean: f64) -> f64 {
    let Some([low, high]) = pooled.size_interval else {
        return 0.0;
    };
    let deviation = (0.5 * (high - low) / NORMAL).max(f64::MIN_POSITIVE);
    -0.5 * ((pooled.size - mean) / deviation).powi(2)
}

impl AtShare {
    fn new(ln_odds: f64) -> Self {
        Self {
            ln_odds,
            ln_likelihood: 0.0,
            ln_none: 0.0,
            dependent: 0.0,
            mean: 0.0,
            variance: 0.0,
            spread: 0.0,
        }
    }

    fn add(&mut self, visits: f64, ln_bayes_factor: f64, state: RegionState) {
        let ln_odds = self.ln_odds + ln_bayes_factor;
        let ln_normalised = softplus(ln_odds);
        let dependent = (ln_odds - ln_normalised).exp();
        let square = state.mean * state.mean + state.deviation * state.deviation;

        self.ln_likelihood += ln_normalised - softplus(self.ln_odds);
        self.ln_none -= ln_normalised;
        self.dependent += visits * dependent;
        self.mean += visits * dependent * state.mean;
        self.variance +=
            visits * visits * dependent * (square - dependent * state.mean * state.mean);
        self.spread += visits * dependent * state.deviation;
    }

    /// Returns the log-density of Beta(A pi, A (1 - pi)) over ln odds, but for a constant.
    fn ln_prior(&self, prior: f64) -> f64 {
        let pi = (prior - softplus(prior)).exp();
        CONCENTRATION * (pi * self.ln_odds - softplus(self.ln_odds))
    }

    fn component(&self, weight: f64, visits: f64) -> Component {
        let mean = self.mean / visits;
        let together = TOGETHER * self.spread / visits;
        let variance = self.variance / (visits * visits) + together * together;
        let none = self.ln_none.exp();
        let any = (1.0 - none).max(f64::MIN_POSITIVE);
        let mean_of_any = mean / any;
        Component {
            weight,
            none,
            mean: mean_of_any,
            // E x^2 = Var + mean^2 is that of the rest times its probability.
            variance: ((variance + mean * mean) / any - mean_of_any * mean_of_any).max(0.0),
        }
    }
}

impl RegionPosterior {
    /// Returns the expected share of visits in dependent states, sum n_s P_s / sum n_s.
    pub fn dependent_share(&self) -> f64 {
        self.dependent_share
    }

    /// Returns the probability that any state is dependent.
    pub fn any_dependent(&self) -> f64 {
        1.0 - self.mixed(|one| one.none)
    }

    /// Returns the posterior mean of mean mutual information, in nats.
    pub fn mean(&self) -> f64 {
        self.mixed(|one| (1.0 - one.none) * one.mean)
    }

    /// Returns P(mean MI > t), for t >= 0 in nats.
    pub fn above(&self, nats: f64) -> f64 {
        let above = self.mixed(|one| (1.0 - one.none) * one.above(nats));
        above.clamp(0.0, 1.0)
    }

    /// Returns a 90 % credible interval of mean mutual information, in nats.
    pub fn interval(&self) -> [f64; 2] {
        [1.0 - TAIL, TAIL].map(|above| self.quantile(above))
    }

    /// Returns what is believed at a threshold, t >= 0 in nats.
    pub fn beliefs(&self, nats: f64) -> Beliefs {
        let (above, dependent) = (self.above(nats), self.any_dependent());
        Beliefs {
            dependent,
            above,
            above_if_dependent: (above / dependent.max(f64::MIN_POSITIVE)).min(1.0),
        }
    }

    /// Returns above what mean mutual information is with this probability, by bisection.
    fn quantile(&self, above: f64) -> f64 {
        const STEPS: u32 = 60;
        if self.above(0.0) <= above {
            return 0.0;
        }
        let reach = |one: &Component| one.mean + 20.0 * one.variance.sqrt() + f64::MIN_POSITIVE;
        let furthest = self.components.iter().map(reach).fold(0.0, f64::max);
        let (mut low, mut high) = (0.0, furthest);
        for _ in 0..STEPS {
            let middle = 0.5 * (low + high);
            match self.above(middle) > above {
                true => low = middle,
                false => high = middle,
            }
        }
        0.5 * (low + high)
    }

    fn mixed(&self, figure: impl Fn(&Component) -> f64) -> f64 {
        let weighed = self.components.iter().map(|one| one.weight * figure(one));
        weighed.sum()
    }
}

impl Component {
    /// Returns the probability that a gamma variable of these moments is above a value.
    fn above(&self, nats: f64) -> f64 {
        if self.mean <= 0.0 || nats <= 0.0 {
            return f64::from(self.mean > nats);
        }
        let shape = self.mean * self.mean / self.variance;
        if shape < NEARLY_NORMAL {
            return 1.0 - gamma_lr(shape, nats * self.mean / self.variance);
        }
        let deviations = (nats - self.mean) / self.variance.sqrt().max(f64::MIN_POSITIVE);
        0.5 * erfc(deviations / std::f64::consts::SQRT_2)
    }
}

/// Of a larger shape, a gamma distribution is a normal one.
const NEARLY_NORMAL: f64 = 1e4;

/// Returns ln(1 + e^x).
fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

fn ln_odds(p: f64) -> f64 {
    let p = p.clamp(NEAREST, 1.0 - NEAREST);
    (p / (1.0 - p)).ln()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::information::Alphabet;
    use crate::information::pooled::Pool;

    /// Returns what strata of a size show that is known to so much.
    fn shown(size: f64, deviation: f64) -> Pooled {
        let none = Pool::new(Alphabet {
            rows: 2,
            columns: 2,
        });
        Pooled {
            size,
            size_interval: Some([size - NORMAL * deviation, size + NORMAL * deviation]),
            ..none.pooled(1)
        }
    }

    fn region(
        prior: f64,
        states: impl IntoIterator<Item = RegionState>,
        shown: &Pooled,
    ) -> RegionPosterior {
        let mut region = RegionStates::new(prior);
        states.into_iter().for_each(|state| region.add(state));
        region.posterior(shown).expect("a state")
    }

    fn state(visits: u64, dependent: f64) -> RegionState {
        RegionState {
            visits,
            dependent,
            mean: 0.4,
            deviation: 0.1,
        }
    }

    #[test]
    fn a_region_of_one_state_says_what_the_state_says() {
        for (prior, dependent) in [(0.3, 0.3), (0.3, 0.9), (0.1, 0.02), (0.5, 0.999)] {
            let told = region(prior, [state(9, dependent)], &shown(0.0, 0.01));
            for (figure, expected) in [
                (told.dependent_share(), dependent),
                (told.any_dependent(), dependent),
                (told.mean(), 0.4 * dependent),
                (told.above(1e-9), dependent),
            ] {
                assert!((figure - expected).abs() < 0.01, "{told:?}: {expected}");
            }
        }
    }

    #[test]
    fn a_region_without_visits_has_none() {
        let mut region = RegionStates::new(0.4);
        region.add(state(0, 0.9));
        assert_eq!(region.posterior(&shown(0.0, 0.1)), None);
    }

    #[test]
    fn a_region_is_as_dependent_as_its_strata_show_whatever_each_state_hints_at() {
        let hints = |p: f64| (0..1_000).map(move |_| state(3, p));
        for hint in [0.3, 0.4] {
            let told = region(0.33, hints(hint), &shown(0.36, 0.01));
            assert!(told.dependent_share() > 0.85, "{told:?}");
            assert!((told.mean() - 0.36).abs() < 0.02, "{told:?}");

            let told = region(0.33, hints(hint), &shown(0.0, 0.01));
            assert!(
                told.dependent_share() < 0.05 && told.interval()[0] < 0.01,
                "{told:?}"
            );
        }

        // Strata that tell no size leave what was believed before.
        let nothing = Pooled {
            size_interval: None,
            ..shown(0.0, 1.0)
        };
        let told = region(0.33, hints(0.33), &nothing);
        assert!((told.dependent_share() - 0.33).abs() < 0.02, "{told:?}");
    }

    #[test]
    fn visits_weigh_states() {
        let told = region(0.5, [state(90, 1.0), state(10, 0.0)], &shown(0.3, 0.1));
        assert!((told.dependent_share() - 0.9).abs() < 1e-3, "{told:?}");
        assert!((told.mean() - 0.36).abs() < 1e-3, "{told:?}");
    }

    /// Each state shows a normal variable, of mean 1 where it is dependent and else 0; its MI is
    /// uniform in .2 to .6 and not seen. Regions differ in their share of dependent states, and their
    /// size is known to .05.
    #[test]
    fn intervals_hold_what_they_say_and_means_are_unbiased() {
        const REGIONS: u32 = 400;
        let mut random = Pcg64::seed_from_u64(7);
        let normal =
            |random: &mut Pcg64| (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let (mut held, mut error) = (0, 0.0);
        for _ in 0..REGIONS {
            let share: f64 = random.random();
            let mut region = RegionStates::new(0.5);
            let mut truth = 0.0;
            for _ in 0..40 {
                let is_dependent = random.random::<f64>() < share;
                let seen = normal(&mut random) + f64::from(is_dependent);
                let information = 0.2 + 0.4 * random.random::<f64>();
                truth += if is_dependent {
                    information / 40.0
                } else {
                    0.0
                };
                region.add(RegionState {
                    visits: 3,
                    dependent: 1.0 / (1.0 + (0.5 - seen).exp()),
                    mean: 0.4,
                    deviation: 0.4 / 12.0_f64.sqrt(),
                });
            }
            let size = truth + 0.05 * normal(&mut random);
            let told = region.posterior(&shown(size, 0.05)).expect("states");
            let [low, high] = told.interval();
            held += u32::from(low <= truth && truth <= high);
            error += (told.mean() - truth) / f64::from(REGIONS);
        }
        assert!((345..=395).contains(&held), "{held} of {REGIONS}");
        assert!(error.abs() < 0.01, "{error}");
    }
}
