//! Bayesian sample size and expected information gain: how many visits until there is a verdict,
//! and which action tells most.

use rand::RngExt;
use rand_distr::{Binomial, Distribution};
use rand_pcg::Pcg64;

use super::counted::{Counted, Ego};
use super::decision::{Believed, decide};
use super::draws::Draws;
use super::habits::Habits;
use super::posterior::Posterior;
use super::prior::Prior;
use crate::domain::{Rule, RuleKind, Verdict};
use crate::information::{Table, conditional, plug_in};

/// Numbers of further visits that are tried.
const VISITS: [u64; 13] = [
    1, 2, 5, 10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000,
];
/// Futures drawn, and how many of them may stay undecided.
const FUTURES: usize = 200;
const UNDECIDED: usize = FUTURES / 5;

/// The most segments that a state is looked at by, where their habits differ: those that were
/// visited most. Every one of them is asked about many times.
const MOST_PARTS: usize = 2;

/// One future: a sample path from the posterior predictive distribution.
struct Future {
    rng: Pcg64,
    /// The probability of every cell of every slice, one after another; the ego's actions first.
    cells: Vec<f64>,
    /// Visits to each of them.
    counts: Vec<u64>,
    /// How many visits were added so far.
    visits: u64,
}

impl Prior {
    /// Returns the sample size that is still missing: after how many more visits at least 80 % of
    /// 200 futures have a verdict: 0 where
    /// there is one now, else the smallest of 1, 2, 5, 10 ... 10,000 that suffices, and `None`
    /// where none does.
    ///
    /// Futures are drawn from what is believed now, with the ego's policy as it is; each goes on
    /// from the counts, and larger numbers of visits from its own smaller ones. The draws depend on
    /// the counts alone.
    ///
    /// Not for alphabets with more than [`MOST_CELLS`](super::MOST_CELLS) pairs of actions.
    pub fn visits_to_decide<'a>(
        &self,
        habits: &'a Habits,
        counted: impl Into<Counted<'a>>,
        ego: Ego,
        rule: &Rule,
    ) -> Option<u64> {
        let counted = counted.into();
        if decides(self.posterior(habits, counted), self, counted.slices, rule) {
            return Some(0);
        }

        let draws = Draws::new(self, habits, counted, ego, MOST_PARTS);
        let mut futures = draws.futures();

        VISITS.into_iter().find(|visits| {
            let mut undecided = 0;
            // Once too many are undecided, the others need not be asked.
            futures.iter_mut().all(|future| {
                future.go_on(*visits);
                undecided += usize::from(!draws.decide(&draws.slices_of(&future.counts), rule));
                undecided <= UNDECIDED
            })
        })
    }

    /// Returns the expected information gain of every ego action: by how much one more visit with
    /// it is expected to lower the entropy of "MI > t", in nats (Lindley 1956): at least 0, at most
    /// ln 2. What to try next, to learn one's influence. 0 for an action that is not in use: nobody
    /// knows how to take it.
    ///
    /// H(E P') - E H(P'), P' = P(MI > t) after the visit and the other's answer, which comes as
    /// predicted. Not for alphabets with more than [`MOST_CELLS`](super::MOST_CELLS) pairs of
    /// actions: it takes a posterior for each.
    pub fn information_gain<'a>(
        &self,
        habits: &'a Habits,
        counted: impl Into<Counted<'a>>,
        ego: Ego,
        threshold_nats: f64,
    ) -> Vec<f64> {
        let draws = Draws::new(self, habits, counted.into(), ego, MOST_PARTS);
        let [egos, others] = draws.sizes();

        // For each ego action: total probability, E P', E H(P').
        let mut sums = vec![[0.0; 3]; egos];

        for slice in 0..draws.slices.len() {
            let predicted = draws.predicted(slice);
            let after = draws.above_after(slice, threshold_nats);
            for (sums, cells) in sums.iter_mut().zip(
                predicted
                    .iter()
                    .zip(after)
                    .collect::<Vec<_>>()
                    .chunks(others),
            ) {
                for (predicted, after) in cells {
                    let p = draws.share(slice) * *predicted;
                    let terms = [p, p * after, p * binary_entropy(*after)];
                    sums.iter_mut()
                        .zip(terms)
                        .for_each(|(sum, term)| *sum += term);
                }
            }
        }

        // Rounding could take a gain of nothing below it.
        let gain = |[p, mean, entropy]: [f64; 3]| {
            if p > 0.0 {
                (binary_entropy(mean / p) - entropy / p).max(0.0)
            } else {
                0.0
            }
        };

        sums.into_iter().map(gain).collect()
    }
}

/// Returns whether slices of which this is believed decide.
fn decides(posterior: Posterior, prior: &Prior, slices: &[Table], rule: &Rule) -> bool {
    let visits = slices.iter().map(Table::total).sum();
    let threshold = rule.threshold_nats();

    let believed = match rule.kind {
        RuleKind::Paper => None,
        RuleKind::Evidence => Some(Believed::new(
            posterior.beliefs(threshold),
            prior.unseen().beliefs(threshold),
            slices,
        )),
    };

    let plug_in = if rule.kind == RuleKind::Paper {
        conditional(slices, plug_in)
    } else {
        0.0
    };

    decide(rule, visits, plug_in, believed.as_ref()) != Verdict::Undecided
}

impl Draws<'_> {
    /// Returns whether tables that take the place of the slices decide.
    fn decide(&self, tables: &[Table], rule: &Rule) -> bool {
        let (posterior, counted) = self.posterior_of(tables);
        decides(posterior, self.prior, &counted, rule)
    }

    fn futures(&self) -> Vec<Future> {
        let mut rng = self.generator();
        let [_, others] = self.sizes();
        let counts = self.counts();

        let policies: Vec<Vec<f64>> = self
            .slices
            .iter()
            .map(|slice| {
                self.prior
                    .mean_policy(self.ego, self.habits, &slice[self.ego])
            })
            .collect();

        let future =
            |number: usize| {
                let joints = self.draw((number as f64 + 0.5) / FUTURES as f64, &mut rng);
                let mut cells = Vec::with_capacity(counts.len());
                for (slice, (joint, policy)) in joints.iter().zip(&policies).enumerate() {
                    let rows = joint.responses.chunks(others).zip(policy);
                    cells.extend(rows.flat_map(|(row, p)| {
                        row.iter().map(move |rho| self.share(slice) * p * rho)
                    }));
                }
                let rng = <Pcg64 as rand::SeedableRng>::seed_from_u64(rng.random());
                Future {
                    rng,
                    cells,
                    counts: counts.clone(),
                    visits: 0,
                }
            };

        let mut futures: Vec<Future> = (0..FUTURES).map(future).collect();
        // Those that are decided alike are neighbours: mixed, the first ones tell sooner how it
        // will end.
        (1..FUTURES)
            .rev()
            .for_each(|last| futures.swap(last, rng.random_range(0..=last)));

        futures
    }

    /// Returns the counts of every cell of every slice, one after another; the ego's actions first.
    fn counts(&self) -> Vec<u64> {
        let [egos, others] = self.sizes();
        let mut counts = vec![0; egos * others * self.slices.len()];
        for (reading, counts) in self.slices.iter().zip(counts.chunks_mut(egos * others)) {
            let place = |(ego, other, n): (u64, u64, u64)| {
                counts[ego as usize * others + other as usize] = n
            };
            reading[self.ego].triples().for_each(place);
        }
        counts
    }

    /// Returns the tables of such counts, rows for the row variable.
    fn slices_of(&self, counts: &[u64]) -> Vec<Table> {
        let [egos, others] = self.sizes();
        let table = |counts: &[u64]| {
            let cells = counts
                .iter()
                .enumerate()
                .map(|(at, n)| ((at / others) as u64, (at % others) as u64, *n));
            self.in_order(Table::from_counts(cells))
        };
        counts.chunks(egos * others).map(table).collect()
    }

    /// Returns a table whose rows are the ego's actions as the prior takes it: rows for the row
    /// variable.
    fn in_order(&self, table: Table) -> Table {
        if self.ego == 0 {
            table
        } else {
            table.transposed()
        }
    }

    /// Returns P(MI > t) after one more visit to each cell of one slice, the ego's actions first.
    /// Actions that were not visited are all alike.
    fn above_after(&self, at: usize, threshold_nats: f64) -> Vec<f64> {
        let [egos, others] = self.sizes();
        let table = &self.slices[at][self.ego];

        let mut slices: Vec<Table> = self
            .slices
            .iter()
            .map(|[slice, _]| slice.as_ref().clone())
            .collect();

        let mut row = |ego: u64| -> Vec<f64> {
            let after = |other: u64| {
                slices[at] =
                    self.in_order(Table::from_counts(table.triples().chain([(ego, other, 1)])));
                self.posterior_of(&slices).0.above(threshold_nats)
            };
            (0..others as u64).map(after).collect()
        };

        (0..egos as u64).flat_map(&mut row).collect()
    }
}

impl Future {
    /// Adds visits until there are this many more than at first.
    fn go_on(&mut self, visits: u64) {
        let mut left = visits - std::mem::replace(&mut self.visits, visits);
        if left < self.cells.len() as u64 {
            (0..left).for_each(|_| self.visit());
            return;
        }

        let mut unspent = 1.0;
        for (count, p) in self.counts.iter_mut().zip(&self.cells) {
            let share = if unspent > 0.0 {
                (p / unspent).clamp(0.0, 1.0)
            } else {
                1.0
            };

            let n = Binomial::new(left, share)
                .expect("a share within 0 to 1")
                .sample(&mut self.rng);
            *count += n;
            left -= n;
            unspent -= p;
        }

        // What rounding left over goes to the likeliest cell.
        self.counts[likeliest(&self.cells)] += left;
    }

    fn visit(&mut self) {
        let mut left: f64 = self.rng.random();
        let cell = self.cells.iter().position(|p| {
            left -= p;
            left < 0.0
        });
        self.counts[cell.unwrap_or_else(|| likeliest(&self.cells))] += 1;
    }
}

fn likeliest(cells: &[f64]) -> usize {
    cells
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(b.1))
        .map_or(0, |(cell, _)| cell)
}

/// Returns the entropy of an event of this probability, in nats.
fn binary_entropy(p: f64) -> f64 {
    [p, 1.0 - p]
        .into_iter()
        .filter(|p| *p > 0.0)
        .map(|p| -p * p.ln())
        .sum()
}
