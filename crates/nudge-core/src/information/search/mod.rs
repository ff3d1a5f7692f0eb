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
const MOST_WORK: u64 = 100_000_000;

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
    Search::new(states, MOST_WORK).rules(most, goes_on)
}

/// A search that is under way.
struct Search {
    states: States,
    columns: Vec<Column>,
    /// ln C.
    price: f64,
    most_work: u64,
}

impl Search {
    fn new(states: States, most_work: u64) -> Self {
        let columns = Column::all(&states);
        let conditions: u64 = columns.iter().map(Column::conditions).sum();
        Self {
            states,
            columns,
            price: (conditions.max(1) as f64).ln(),
            most_work,
        }
    }

    fn rules(mut self, most: usize, goes_on: &dyn Fn() -> bool) -> Option<Searched> {
        let mut searched = Searched::default();
        while searched.rules.len() < most {
            let round = Round::new(&self).run(goes_on)?;
            if searched.rules.is_empty() {
                (searched.looked_at, searched.left_out) = (round.looked_at, round.left_out());
            }
            let Some(best) = round.best() else { break };

            let rule = self.states.simplified(best);
            self.states.leave(&rule.conditions);
            searched.rules.push(rule);
        }
        Some(searched)
    }
}

/// One pass over all rules.
struct Round<'a> {
    search: &'a Search,
    /// Of each column, the code of each state.
    codes: Vec<Vec<u8>>,
    /// The best rule so far, and its columns.
    best: Option<(Best, Vec<usize>)>,
    /// The best score so far of the rules with each column, by which some are chosen for larger ones.
    promise: Vec<f64>,
    looked_at: u64,
    /// The columns of the rules that were looked at last.
    chosen: Vec<usize>,
}

impl<'a> Round<'a> {
    fn new(search: &'a Search) -> Self {
        let columns = search.columns.iter();
        Self {
            codes: columns.map(|one| one.codes(&search.states)).collect(),
            best: None,
            promise: vec![f64::NEG_INFINITY; search.columns.len()],
            looked_at: 0,
            chosen: Vec::new(),
            search,
        }
    }

    fn run(mut self, goes_on: &dyn Fn() -> bool) -> Option<Self> {
        for size in 1..=MOST_CONDITIONS {
            self.chosen = self.affordable(size);
            for at in tuples(&self.chosen, size) {
                if !goes_on() {
                    return None;
                }
                self.look(at);
            }
        }
        Some(self)
    }

    /// Looks at all rules with a condition on each of these columns.
    fn look(&mut self, at: Vec<usize>) {
        let columns: Vec<&Column> = at.iter().map(|at| &self.search.columns[*at]).collect();
        let codes: Vec<&[u8]> = at.iter().map(|at| self.codes[*at].as_slice()).collect();
        self.looked_at += rules(&columns);

        let price = at.len() as f64 * self.search.price;
        let tuple = Tuple::new(&columns, &codes, self.search.states.sums());
        let Some(found) = tuple.best(price) else {
            return;
        };

        for at in &at {
            self.promise[*at] = self.promise[*at].max(found.score);
        }
        let best = self.best.as_ref();
        if best.is_none_or(|(best, _)| found.beats(best.score)) {
            self.best = Some((found, at));
        }
    }

    /// Returns the columns that rules of so many conditions are looked for with, in order: all of
    /// them, or as many as can be afforded of those with the best rules so far.
    fn affordable(&self, size: usize) -> Vec<usize> {
        let mut ranked: Vec<usize> = (0..self.promise.len()).collect();
        // Of equals the first, as the sort is stable.
        ranked.sort_by(|a, b| self.promise[*b].total_cmp(&self.promise[*a]));

        let mut work = Work::new(size, self.search.states.len() as u64);
        let affordable = ranked.into_iter().take_while(|at| {
            work.add(&self.search.columns[*at]);
            work.total() <= self.search.most_work
        });
        let mut chosen: Vec<usize> = affordable.collect();
        chosen.sort_unstable();
        chosen
    }

    /// Returns the conditions of the best rule; `None` where no score is above 0.
    fn best(&self) -> Option<Vec<Condition>> {
        let (best, at) = self.best.as_ref().filter(|(best, _)| best.score > 0.0)?;
        let both = at.iter().zip(&best.ranges);
        let condition = |(at, range): (&usize, &_)| self.search.columns[*at].condition(*range);
        Some(both.map(condition).collect())
    }

    /// Returns the coordinates that the largest rules were not looked for with.
    fn left_out(&self) -> Vec<usize> {
        let columns = self.search.columns.iter().enumerate();
        let others = columns.filter(|(at, _)| !self.chosen.contains(at));
        others.map(|(_, column)| column.axis()).collect()
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
