//! Bayesian sample size and expected information gain: how many visits until there is a verdict,
//! and which action tells most.

use std::collections::BTreeMap;

use rand::RngExt;
use rand_distr::{Binomial, Distribution};
use rand_pcg::Pcg64;

use super::counted::{Counted, Ego};
use super::decision::{Believed, decide};
use super::draws::Draws;
use super::habits::Habits;
use super::posterior::Posterior;
use super::prior::Prior;
use super::readings::Reading;
use crate::domain::{Rule, RuleKind, Verdict};
use crate::information::{Table, conditional, plug_in};

/// Numbers of further visits that are tried.
const VISITS: [u64; 13] = [
    1, 2, 5, 10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000,
];
/// Futures drawn: as many as have so many cells together, within these bounds. One future of two
/// agents with 64 actions each, given a third such action, has a quarter of a million.
const FUTURE_CELLS: usize = 400_000;
const FEWEST_FUTURES: usize = 40;
const MOST_FUTURES: usize = 200;
/// One future in so many may stay undecided.
const UNDECIDED: usize = 5;

/// The most cells of all slices whose next visits are tried one by one.
const MOST_TRIED: usize = 1_024;

/// The most segments that a state is looked at by, where their habits differ: those that were
/// visited most. Every one of them is asked about many times.
const MOST_PARTS: usize = 2;

/// One future: a sample path from the posterior predictive distribution.
struct Future {
    rng: Pcg64,
    /// The probability of every cell of every slice, one after another; the ego's actions first.
    cells: Vec<f64>,
    /// Visits added to each of them, by position: to few of very many.
    added: BTreeMap<usize, u64>,
    /// How many visits were added so far.
    visits: u64,
}

impl Prior {
    /// Returns the sample size that is still missing: after how many more visits at least 80 % of
    /// 200 futures have a verdict (of 40 at least, where tables have very many cells): 0 where
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
        let most_undecided = futures.len() / UNDECIDED;

        VISITS.into_iter().find(|visits| {
            let mut undecided = 0;
            // Once too many are undecided, the others need not be asked.
            futures.iter_mut().all(|future| {
                future.go_on(*visits);
                undecided += usize::from(!draws.decide(&draws.slices_with(&future.added), rule));
                undecided <= most_undecided
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
    /// actions: it takes a posterior for each, up to 1,024 of all slices; of more, one for all of
    /// them that were seen about as often, whose actions were too.
    pub fn information_gain<'a>(
        &self,
        habits: &'a Habits,
        counted: impl Into<Counted<'a>>,
        ego: Ego,
        threshold_nats: f64,
    ) -> Vec<f64> {
        let draws = Draws::new(self, habits, counted.into(), ego, MOST_PARTS);
        let predicted = draws.predicted_everywhere();
        let after = if predicted.len() <= MOST_TRIED {
            draws.above_after_each(threshold_nats)
        } else {
            draws.above_after_kinds(&predicted, threshold_nats)
        };
        gains(&predicted, &after, draws.sizes())
    }
}

/// Returns the gain of each ego action, given how probable each cell is at the next visit, and
/// P(MI > t) after it.
fn gains(predicted: &[f64], after: &[f64], [egos, others]: [usize; 2]) -> Vec<f64> {
    // For each ego action: total probability, E P', E H(P').
    let mut sums = vec![[0.0; 3]; egos];
    for (at, (p, after)) in predicted.iter().zip(after).enumerate() {
        let terms = [*p, p * after, p * binary_entropy(*after)];
        sums[at / others % egos]
            .iter_mut()
            .zip(terms)
            .for_each(|(sum, term)| *sum += term);
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
        let [egos, others] = self.sizes();
        let cells = egos * others * self.slices.len();
        let number = (FUTURE_CELLS / cells).clamp(FEWEST_FUTURES, MOST_FUTURES);

        let policies: Vec<Vec<f64>> = self
            .slices
            .iter()
            .map(|slice| {
                self.prior
                    .mean_policy(self.ego, self.habits, &slice[self.ego])
            })
            .collect();

        let future =
            |at: usize| {
                let joints = self.draw((at as f64 + 0.5) / number as f64, &mut rng);
                let mut cells = Vec::with_capacity(cells);
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
                    added: BTreeMap::new(),
                    visits: 0,
                }
            };

        let mut futures: Vec<Future> = (0..number).map(future).collect();
        // Those that are decided alike are neighbours: mixed, the first ones tell sooner how it
        // will end.
        (1..number)
            .rev()
            .for_each(|last| futures.swap(last, rng.random_range(0..=last)));

        futures
    }

    /// Returns the tables of the slices with visits added to their cells, rows for the row
    /// variable.
    fn slices_with(&self, added: &BTreeMap<usize, u64>) -> Vec<Table> {
        let [egos, others] = self.sizes();
        let cells = egos * others;
        let table = |(slice, reading): (usize, &Reading<'_>)| {
            let first = slice * cells;
            let more = added.range(first..first + cells).map(|(at, n)| {
                let at = at - first;
                ((at / others) as u64, (at % others) as u64, *n)
            });
            self.in_order(Table::from_counts(reading[self.ego].triples().chain(more)))
        };
        self.slices.iter().enumerate().map(table).collect()
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

    /// Returns the probability of each cell of every slice at the next visit, one slice after
    /// another; the ego's actions first.
    fn predicted_everywhere(&self) -> Vec<f64> {
        let of_slice = |slice: usize| {
            let share = self.share(slice);
            self.predicted(slice).into_iter().map(move |p| share * p)
        };
        (0..self.slices.len()).flat_map(of_slice).collect()
    }

    /// Returns P(MI > t) after one more visit to each cell of every slice.
    fn above_after_each(&self, threshold_nats: f64) -> Vec<f64> {
        let [egos, others] = self.sizes();
        (0..egos * others * self.slices.len())
            .map(|at| self.above_after(at, threshold_nats))
            .collect()
    }

    /// Returns about the same, given how probable each cell is: the likeliest of a kind stands for
    /// all of it.
    fn above_after_kinds(&self, predicted: &[f64], threshold_nats: f64) -> Vec<f64> {
        let kinds = self.kinds();
        let mut likeliest: BTreeMap<Kind, usize> = BTreeMap::new();
        for (at, kind) in kinds.iter().enumerate() {
            let stands = likeliest.entry(*kind).or_insert(at);
            if predicted[at] > predicted[*stands] {
                *stands = at;
            }
        }

        let found: BTreeMap<Kind, f64> = likeliest
            .into_iter()
            .map(|(kind, at)| (kind, self.above_after(at, threshold_nats)))
            .collect();
        kinds.iter().map(|kind| found[kind]).collect()
    }

    fn above_after(&self, at: usize, threshold_nats: f64) -> f64 {
        let tables = self.slices_with(&BTreeMap::from([(at, 1)]));
        self.posterior_of(&tables).0.above(threshold_nats)
    }

    /// Returns of which kind each cell of every slice is.
    fn kinds(&self) -> Vec<Kind> {
        let [egos, others] = self.sizes();
        let used = &self.habits.driver(self.ego).shares;
        let of_slice = |reading: &Reading<'_>| {
            let table = &reading[self.ego];
            let [rows, columns] = [
                sums_by_label(table, egos),
                sums_by_label(&table.transposed(), others),
            ];
            let mut cells = vec![0; egos * others];
            table
                .triples()
                .for_each(|(ego, other, n)| cells[ego as usize * others + other as usize] = n);

            let kind = |(at, n): (usize, u64)| Kind {
                is_used: used[at / others] > 0.0,
                seen: [table.total(), rows[at / others], columns[at % others], n].map(magnitude),
            };
            cells.into_iter().enumerate().map(kind).collect::<Vec<_>>()
        };
        self.slices.iter().flat_map(of_slice).collect()
    }
}

/// Cells of slices after whose next visit about the same is believed: those of one kind.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Kind {
    /// Whether the ego's action is in use.
    is_used: bool,
    /// How often about the slice was seen, the ego's action in it, the other's, and both.
    seen: [u32; 4],
}

/// Returns the visits of each row of a table, by label.
fn sums_by_label(table: &Table, labels: usize) -> Vec<u64> {
    (0..labels as u64)
        .map(|label| table.row_sum(label))
        .collect()
}

/// Returns the order of magnitude of a count: itself up to 3, then twice an octave. Those of one
/// are within a factor of one and a half.
fn magnitude(n: u64) -> u32 {
    if n < 4 {
        return n as u32;
    }
    let octave = n.ilog2();
    2 * octave + ((n >> (octave - 1)) & 1) as u32
}

impl Future {
    /// Adds visits until there are this many more than at first.
    fn go_on(&mut self, visits: u64) {
        let left = visits - std::mem::replace(&mut self.visits, visits);
        if left < self.cells.len() as u64 {
            self.visit(left as usize);
        } else {
            self.visit_often(left);
        }
    }

    /// Adds so many visits, one by one. All are placed in one pass over the cells.
    fn visit(&mut self, visits: usize) {
        let mut points: Vec<f64> = (0..visits).map(|_| self.rng.random()).collect();
        points.sort_unstable_by(f64::total_cmp);

        let mut points = points.into_iter().peekable();
        let mut sum = 0.0;
        for (cell, p) in self.cells.iter().enumerate() {
            sum += p;
            while points.next_if(|point| *point < sum).is_some() {
                *self.added.entry(cell).or_default() += 1;
            }
        }
        self.add_to_likeliest(points.count() as u64);
    }

    /// Adds so many visits, by cells.
    fn visit_often(&mut self, mut left: u64) {
        let mut unspent = 1.0;
        for (cell, p) in self.cells.iter().enumerate() {
            let share = if unspent > 0.0 {
                (p / unspent).clamp(0.0, 1.0)
            } else {
                1.0
            };

            let n = Binomial::new(left, share)
                .expect("a share within 0 to 1")
                .sample(&mut self.rng);
            if n > 0 {
                *self.added.entry(cell).or_default() += n;
            }
            left -= n;
            unspent -= p;
        }
        self.add_to_likeliest(left);
    }

    /// Adds what rounding left over.
    fn add_to_likeliest(&mut self, left: u64) {
        if left > 0 {
            *self.added.entry(likeliest(&self.cells)).or_default() += left;
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Fit;
    use crate::information::Alphabet;

    const LETTERS: u64 = 10;

    /// Slices of agents of whom the other does as the ego did, so often.
    fn copied(slices: usize, visits: u64, share: f64) -> Vec<Table> {
        let mut rng = <Pcg64 as rand::SeedableRng>::seed_from_u64(7);
        let mut visit = |_| {
            let ego = rng.random_range(0..LETTERS);
            let copies = rng.random::<f64>() < share;
            let other = if copies {
                ego
            } else {
                rng.random_range(0..LETTERS)
            };
            (ego, other, 1)
        };
        (0..slices)
            .map(|_| Table::from_counts((0..visits).map(&mut visit).collect::<Vec<_>>()))
            .collect()
    }

    #[test]
    fn one_of_a_kind_stands_for_all() {
        /// Of the largest gain. The most that was seen is .2, where every gain is below .001.
        const OFF: f64 = 0.25;
        let prior = Prior::new(&Fit::cold(Alphabet {
            rows: LETTERS,
            columns: LETTERS,
        }));

        for (slices, visits, share) in [(1, 60, 0.3), (1, 400, 0.2), (5, 25, 0.5)] {
            let tables = copied(slices, visits, share);
            let draws = Draws::new(&prior, prior.habits(), (&tables).into(), Ego::Rows, 1);
            let threshold = prior.posterior(prior.habits(), &tables).mean();
            let predicted = draws.predicted_everywhere();
            let told = |after: Vec<f64>| gains(&predicted, &after, draws.sizes());

            let exact = told(draws.above_after_each(threshold));
            let near = told(draws.above_after_kinds(&predicted, threshold));

            let most = exact.iter().copied().fold(0.0, f64::max);
            let off = exact.iter().zip(&near).map(|(a, b)| (a - b).abs());
            let off = off.fold(0.0, f64::max) / most;
            assert!(off < OFF, "{slices} {visits}: {off} {exact:?} {near:?}");
        }
    }

    #[test]
    fn counts_of_an_order_of_magnitude_are_within_half_of_the_least() {
        let orders = [0, 1, 2, 3, 4, 5, 6, 7, 8, 11, 12, 15, 16].map(magnitude);
        assert_eq!(orders, [0, 1, 2, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8]);
        assert_eq!(magnitude(u64::MAX), 127);
    }

    #[test]
    fn visits_that_are_added_are_neither_lost_nor_doubled() {
        let future = |cells: Vec<f64>| Future {
            rng: <Pcg64 as rand::SeedableRng>::seed_from_u64(3),
            cells,
            added: BTreeMap::new(),
            visits: 0,
        };

        // More cells than visits, and fewer; the last ones sum to less than 1, by a little.
        for cells in [vec![0.001; 1_000], vec![0.25; 4], vec![0.1 - 1e-9; 10]] {
            let mut future = future(cells);
            for visits in [1, 2, 5, 500] {
                future.go_on(visits);
                assert_eq!(future.added.values().sum::<u64>(), visits);
            }
        }
    }
}
