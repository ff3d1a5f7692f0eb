//! What more data would bring: how many visits until there is a verdict, and which action tells most.

use rand::RngExt;
use rand_distr::{Binomial, Distribution};
use rand_pcg::Pcg64;

use super::by_action::Ego;
use super::decision::{Belief, decide};
use super::draws::Draws;
use super::prior::Prior;
use crate::domain::{Rule, RuleKind, Verdict};
use crate::information::{Table, conditional, plug_in};

/// Numbers of further visits that are tried.
const VISITS: [u64; 13] = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000];
/// Futures drawn, and how many of them may stay undecided.
const FUTURES: usize = 200;
const UNDECIDED: usize = FUTURES / 5;

/// One way things may go on.
struct Future {
    rng: Pcg64,
    /// The probability of every cell of every slice, one after another.
    cells: Vec<f64>,
    /// Visits to each of them.
    counts: Vec<u64>,
    /// How many visits were added so far.
    visits: u64,
}

impl Prior {
    /// Returns after how many more visits at least 80 % of 200 futures have a verdict: 0 where there is one now, else the smallest of 1, 2, 5, 10 ...
    /// 10,000 that suffices, and `None` where none does.
    ///
    /// Futures are drawn from what is believed now, with the row variable's policy as it is; each goes on from the counts, and larger numbers of
    /// visits from its own smaller ones. The draws depend on the counts alone.
    ///
    /// Not for alphabets with more than [`MOST_CELLS`](super::MOST_CELLS) pairs of actions.
    pub fn visits_to_decide(&self, slices: &[Table], rule: &Rule) -> Option<u64> {
        let unseen = self.unseen().above(rule.threshold_nats());
        if self.decides(slices, rule, unseen) {
            return Some(0);
        }
        let draws = Draws::new(self, slices);
        let mut futures = self.futures(&draws);
        VISITS.into_iter().find(|visits| {
            let mut undecided = 0;
            // Once too many are undecided, the others need not be asked.
            futures.iter_mut().all(|future| {
                future.go_on(*visits);
                undecided += usize::from(!self.decides(&future.slices(self), rule, unseen));
                undecided <= UNDECIDED
            })
        })
    }

    fn futures(&self, draws: &Draws) -> Vec<Future> {
        let mut rng = draws.generator();
        let columns = self.likelihood.alphabet.columns as usize;
        let cells = self.likelihood.alphabet.rows as usize * columns;
        let mut counts = vec![0; cells * draws.slices.len()];
        for (slice, counts) in draws.slices.iter().zip(counts.chunks_mut(cells)) {
            let table = slice.table;
            for cell in table.cells() {
                let [row, column] =
                    [table.row_labels()[cell.row as usize], table.column_labels()[cell.column as usize]];
                counts[row as usize * columns + column as usize] = cell.n;
            }
        }
        let policies: Vec<Vec<f64>> = draws.slices.iter().map(|slice| self.policy(slice.table)).collect();
        let future = |number: usize| {
            let joints = draws.draw((number as f64 + 0.5) / FUTURES as f64, &mut rng);
            let mut probabilities = Vec::with_capacity(counts.len());
            for ((joint, slice), policy) in joints.iter().zip(&draws.slices).zip(&policies) {
                let rows = joint.responses.chunks(columns).zip(policy);
                probabilities.extend(rows.flat_map(|(row, p)| row.iter().map(move |rho| slice.share * p * rho)));
            }
            let rng = <Pcg64 as rand::SeedableRng>::seed_from_u64(rng.random());
            Future { rng, cells: probabilities, counts: counts.clone(), visits: 0 }
        };
        let mut futures: Vec<Future> = (0..FUTURES).map(future).collect();
        // Those that are decided alike are neighbours: mixed, the first ones tell sooner how it will end.
        (1..FUTURES).rev().for_each(|last| futures.swap(last, rng.random_range(0..=last)));
        futures
    }

    /// Returns the posterior mean of the row variable's distribution in a slice.
    fn policy(&self, table: &Table) -> Vec<f64> {
        let rows = self.likelihood.alphabet.rows;
        (0..rows)
            .map(|label| (table.row_sum(label) as f64 + 0.5) / (table.total() as f64 + 0.5 * rows as f64))
            .collect()
    }

    fn decides(&self, slices: &[Table], rule: &Rule, unseen: f64) -> bool {
        let visits = slices.iter().map(Table::total).sum();
        let verdict = match rule.kind {
            RuleKind::Paper => decide(rule, visits, conditional(slices, plug_in), None),
            RuleKind::Evidence => {
                let now = self.posterior(slices).above(rule.threshold_nats());
                decide(rule, visits, 0.0, Some(Belief { now, unseen }))
            }
        };
        verdict != Verdict::Undecided
    }

    /// Returns, for every ego action, by how much one more visit with it is expected to lower the entropy of "MI > t", in nats: at least 0, at most
    /// ln 2. What to try next, to learn one's influence.
    ///
    /// H(E P') - E H(P'), P' = P(MI > t) after the visit and the other's answer, which comes as predicted. Not for alphabets with more than
    /// [`MOST_CELLS`](super::MOST_CELLS) pairs of actions: it takes a posterior for each.
    pub fn information_gain(&self, slices: &[Table], ego: Ego, threshold_nats: f64) -> Vec<f64> {
        let draws = Draws::new(self, slices);
        let tables: Vec<Table> = draws.slices.iter().map(|slice| slice.table.clone()).collect();
        let [egos, others] = self.sizes(ego);
        // For each ego action: total probability, E P', E H(P').
        let mut sums = vec![[0.0; 3]; egos];
        for (at, slice) in draws.slices.iter().enumerate() {
            let predicted = draws.predicted(slice);
            let after = self.above_after(&tables, at, threshold_nats);
            for (action, sums) in sums.iter_mut().enumerate() {
                for other in 0..others {
                    let cell = self.cell(ego, action, other);
                    let p = slice.share * predicted[cell];
                    let terms = [p, p * after[cell], p * binary_entropy(after[cell])];
                    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
                }
            }
        }
        // Rounding could take a gain of nothing below it.
        sums.into_iter().map(|[p, mean, entropy]| (binary_entropy(mean / p) - entropy / p).max(0.0)).collect()
    }

    /// Returns P(MI > t) after one more visit to each cell of one slice, rows first. Rows that were not visited are all alike.
    fn above_after(&self, slices: &[Table], at: usize, threshold_nats: f64) -> Vec<f64> {
        let alphabet = self.likelihood.alphabet;
        let mut slices = slices.to_vec();
        let table = slices[at].clone();
        let mut row = |row: u64| -> Vec<f64> {
            let after = |column: u64| {
                slices[at] = Table::from_counts(triples(&table).chain([(row, column, 1)]));
                self.posterior(&slices).above(threshold_nats)
            };
            (0..alphabet.columns).map(after).collect()
        };
        let mut unvisited: Option<Vec<f64>> = None;
        let mut all = Vec::with_capacity((alphabet.rows * alphabet.columns) as usize);
        for label in 0..alphabet.rows {
            if table.row_labels().binary_search(&label).is_ok() {
                all.extend(row(label));
            } else {
                all.extend_from_slice(unvisited.get_or_insert_with(|| row(label)));
            }
        }
        all
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
            let share = if unspent > 0.0 { (p / unspent).clamp(0.0, 1.0) } else { 1.0 };
            let n = Binomial::new(left, share).expect("a share within 0 to 1").sample(&mut self.rng);
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

    fn slices(&self, prior: &Prior) -> Vec<Table> {
        let columns = prior.likelihood.alphabet.columns;
        let cells = (prior.likelihood.alphabet.rows * columns) as usize;
        let triples = |counts: &[u64]| {
            Table::from_counts((0..).zip(counts).map(|(cell, n)| (cell / columns, cell % columns, *n)))
        };
        self.counts.chunks(cells).map(triples).collect()
    }
}

fn likeliest(cells: &[f64]) -> usize {
    cells.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(cell, _)| cell)
}

fn triples(table: &Table) -> impl Iterator<Item = (u64, u64, u64)> {
    let label = |cell: &crate::information::Occupied| {
        (table.row_labels()[cell.row as usize], table.column_labels()[cell.column as usize], cell.n)
    };
    table.cells().iter().map(label)
}

/// Returns the entropy of an event of this probability, in nats.
fn binary_entropy(p: f64) -> f64 {
    [p, 1.0 - p].into_iter().filter(|p| *p > 0.0).map(|p| -p * p.ln()).sum()
}
