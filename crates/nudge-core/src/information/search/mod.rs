//! Subgroup discovery (Klösgen 1996): in which states does dependence live? An exhaustive search for
//! the rules over numbered coordinates whose states together exceed independence most, to be tested
//! on counts that the search did not see.
//!
//! Each state comes with its bins and with what its search half says, a [`Sum`]: how far its
//! statistic lies beyond its mean under independence, and the variance of that. A rule of one to
//! three conditions on as many coordinates has the sums of its states, and the score D^2 / 2V -
//! k ln C, with D and V the sums, k its conditions and C all conditions there are: a likelihood
//! ratio less a price for having looked.
//!
//! Not the test: z on the half that was searched is large because it was looked for. Who asks deals
//! the counts into two halves, and tests what is found here by a [`Pool`](super::pooled::Pool) of
//! the other one. Whatever is chosen by the first half, tests on the second stay honest.

mod boxes;
mod column;
mod rule;
mod simplified;
mod states;
mod sum;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use boxes::{Best, Tuple};
use column::Column;

pub use rule::{Condition, FoundRule};
pub use states::{Axis, States};
pub use sum::{FEWEST_VISITS, Sum};

/// The most rules that a search returns.
pub const MOST_RULES: usize = 10;
/// The most conditions of a rule.
pub const MOST_CONDITIONS: usize = 3;

/// Sums of one round, of states and of rules, for each number of conditions: half a second.
const MOST_WORK: u64 = 200_000_000;

/// What was found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Searched {
    /// The best rule, then the best of the states that it leaves, and so on.
    pub rules: Vec<FoundRule>,
    /// How many rules the first was chosen from.
    pub looked_at: u64,
    /// Coordinates that rules of three conditions, or of two, were not looked for with, since those
    /// would have been too many: of the others at least one has a better rule by itself.
    pub left_out: Vec<usize>,
}

/// Returns the best rules, at most so many, each of the states that those before it leave; `None`
/// where `goes_on`, asked now and then, said no. The same states in the same order give the same
/// bits.
///
/// Of equal scores, the one of fewer conditions comes first, then that of earlier coordinates and
/// bins. The best rule loses its conditions one by one, always the one whose states outside differ
/// least, while z of the difference of the rates D / V is below 3; one that loses all of them
/// means every state. No rule is returned whose score is not above 0.
pub fn search(states: States, most: usize, goes_on: &dyn Fn() -> bool) -> Option<Searched> {
    let mut search = Search::new(states);
    let mut searched = Searched::default();
    while searched.rules.len() < most {
        let round = search.round(goes_on)?;
        if searched.rules.is_empty() {
            (searched.looked_at, searched.left_out) = (round.looked_at, round.left_out);
        }
        let Some(best) = round.best else { break };

        let rule = search.states.simplified(best);
        search.states.leave(&rule.conditions);
        searched.rules.push(rule);
    }
    Some(searched)
}

/// A search that is under way.
struct Search {
    states: States,
    columns: Vec<Column>,
    /// ln C.
    price: f64,
}

/// What one pass over all rules found.
struct Round {
    best: Option<Vec<Condition>>,
    looked_at: u64,
    left_out: Vec<usize>,
}

impl Search {
    fn new(states: States) -> Self {
        let columns = Column::all(&states);
        let conditions: u64 = columns.iter().map(Column::conditions).sum();
        Self {
            states,
            columns,
            price: (conditions.max(1) as f64).ln(),
        }
    }

    fn round(&self, goes_on: &dyn Fn() -> bool) -> Option<Round> {
        let codes: Vec<Vec<u8>> = self
            .columns
            .iter()
            .map(|one| one.codes(&self.states))
            .collect();
        let mut best: Option<(Best, Vec<usize>)> = None;
        let (mut looked_at, mut left_out) = (0, Vec::new());
        // The best score of the rules with a coordinate, by which some are chosen for larger rules.
        let mut promise: BTreeMap<usize, f64> = (0..self.columns.len())
            .map(|at| (at, f64::NEG_INFINITY))
            .collect();

        for size in 1..=MOST_CONDITIONS {
            let chosen = self.affordable(size, &promise);
            left_out = (0..self.columns.len())
                .filter(|at| !chosen.contains(at))
                .collect();
            for at in tuples(&chosen, size) {
                if !goes_on() {
                    return None;
                }
                let columns: Vec<&Column> = at.iter().map(|at| &self.columns[*at]).collect();
                let codes: Vec<&[u8]> = at.iter().map(|at| codes[*at].as_slice()).collect();
                looked_at += rules(&columns);
                let price = size as f64 * self.price;
                let found = Tuple::new(&columns, &codes, self.states.sums()).best(price);
                let Some(found) = found else { continue };

                for at in &at {
                    let promise = promise.entry(*at).or_insert(found.score);
                    *promise = promise.max(found.score);
                }
                if best
                    .as_ref()
                    .is_none_or(|(best, _)| found.beats(best.score))
                {
                    best = Some((found, at));
                }
            }
        }

        let best = best.filter(|(best, _)| best.score > 0.0);
        let conditions = |(best, at): (Best, Vec<usize>)| {
            let pairs = at.iter().zip(best.ranges);
            pairs
                .map(|(at, range)| self.columns[*at].condition(range))
                .collect()
        };
        Some(Round {
            best: best.map(conditions),
            looked_at,
            left_out: left_out
                .into_iter()
                .map(|at| self.columns[at].axis())
                .collect(),
        })
    }

    /// Returns the columns that rules of so many conditions are looked for with, in order: all of
    /// them, or as many as can be afforded of those with the best rules so far.
    fn affordable(&self, size: usize, promise: &BTreeMap<usize, f64>) -> Vec<usize> {
        let mut ranked: Vec<(usize, f64)> = promise.iter().map(|(at, best)| (*at, *best)).collect();
        ranked.sort_by(|(a, a_best), (b, b_best)| b_best.total_cmp(a_best).then(a.cmp(b)));
        let mut work = Work::new(size, self.states.len() as u64);
        let affordable = ranked.into_iter().take_while(|(at, _)| {
            work.add(&self.columns[*at]);
            work.total() <= MOST_WORK
        });
        let mut chosen: Vec<usize> = affordable.map(|(at, _)| at).collect();
        chosen.sort_unstable();
        chosen
    }
}

/// The work of looking at all rules of a size with some columns: sums of the states of each tuple,
/// of its cells and of its rules, by elementary symmetric polynomials.
struct Work {
    size: usize,
    states: u64,
    /// Of each number of columns to `size`: tuples, their cells, and their ranges.
    of: Vec<[u64; 3]>,
}

impl Work {
    fn new(size: usize, states: u64) -> Self {
        let mut of = vec![[0; 3]; size + 1];
        of[0] = [1; 3];
        Self { size, states, of }
    }

    fn add(&mut self, column: &Column) {
        let factors = [1, column.width() as u64, column.conditions()];
        for size in (1..=self.size).rev() {
            let below = self.of[size - 1];
            for ((sum, below), factor) in self.of[size].iter_mut().zip(below).zip(factors) {
                *sum = sum.saturating_add(below.saturating_mul(factor));
            }
        }
    }

    fn total(&self) -> u64 {
        let [tuples, cells, ranges] = self.of[self.size];
        let states = tuples.saturating_mul(self.states);
        states.saturating_add(cells).saturating_add(ranges)
    }
}

/// Returns all ways to choose so many, in lexicographic order.
fn tuples(from: &[usize], size: usize) -> Vec<Vec<usize>> {
    if size == 0 {
        return vec![Vec::new()];
    }
    let mut all = Vec::new();
    for (at, first) in from.iter().enumerate() {
        for mut rest in tuples(&from[at + 1..], size - 1) {
            rest.insert(0, *first);
            all.push(rest);
        }
    }
    all
}

/// Returns how many rules have a condition on each of these.
fn rules(columns: &[&Column]) -> u64 {
    let conditions = columns.iter().map(|column| column.conditions());
    conditions.fold(1, u64::saturating_mul)
}
