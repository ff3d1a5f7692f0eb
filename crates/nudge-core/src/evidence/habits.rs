//! Mean policies of an environment and how far its states scatter around them (overdispersion):
//! which actions agents use at all, and how often. A state's own visits are weighed against them.

use std::collections::BTreeMap;

use super::base::Base;
use super::counted::Counted;
use crate::information::{Alphabet, Table};
use crate::special_functions::ln_rising;

/// The mean policies of an environment, of both variables of a table, as of some revision.
#[derive(Debug, Clone, PartialEq)]
pub struct Habits([Usage; 2]);

/// The mean policy of one variable in an environment.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Usage {
    /// h: the share of each letter, 0 for one that was never used; equal shares where nothing was
    /// counted.
    pub shares: Vec<f64>,
    /// How many letters are in use: all, where nothing was counted.
    pub used: u64,
    /// sum h^2.
    pub squares: f64,
}

impl Habits {
    /// Returns the habits behind these counts over all states, one a letter: of the row variable
    /// and of the column variable.
    pub fn new(rows: &[u64], columns: &[u64]) -> Self {
        Self([Usage::new(rows), Usage::new(columns)])
    }

    /// Returns the habits of a row variable and a column variable with these bases.
    pub fn from_bases([rows, columns]: [&Base; 2]) -> Self {
        Self::new(rows.counts(), columns.counts())
    }

    /// Returns the usage of the variable that drives on a side: the rows', then the columns'.
    pub(super) fn driver(&self, side: usize) -> &Usage {
        &self.0[side]
    }

    /// Returns ln min(R, K) over the letters in use: no mutual information is larger.
    pub fn largest_information(&self) -> f64 {
        let [rows, columns] = [&self.0[0], &self.0[1]].map(|usage| usage.used);
        (rows.min(columns).max(1) as f64).ln()
    }
}

impl Usage {
    fn new(counts: &[u64]) -> Self {
        let total: u64 = counts.iter().sum();
        let share = |count: &u64| {
            if total == 0 {
                1.0 / counts.len() as f64
            } else {
                *count as f64 / total as f64
            }
        };
        Self::of_shares(counts.iter().map(share).collect())
    }

    /// Returns the usage with these shares, which sum to 1.
    pub fn of_shares(shares: Vec<f64>) -> Self {
        let used = shares.iter().filter(|share| **share > 0.0).count() as u64;
        let squares = shares.iter().map(|share| share * share).sum();
        Self {
            shares,
            used,
            squares,
        }
    }
}

/// The sufficient statistics of policies over all states of an environment: what base
/// distributions, habits and their concentrations are made of.
#[derive(Debug, Clone)]
pub struct Uses {
    counts: [Vec<u64>; 2],
    policies: [Policies; 2],
}

impl Uses {
    /// Begins without states.
    pub fn new(alphabet: Alphabet) -> Self {
        let none = |letters: u64| vec![0; letters as usize];
        let counts = [none(alphabet.rows), none(alphabet.columns)];
        Self {
            counts,
            policies: Default::default(),
        }
    }

    /// Adds a state by its tables; those that cannot tell dependence from independence tell habits,
    /// too.
    pub fn add<'a>(&mut self, counted: impl Into<Counted<'a>>) {
        for slice in counted.into().slices {
            for (variable, (labels, sums)) in margins(slice).into_iter().enumerate() {
                let counts = &mut self.counts[variable];
                labels
                    .iter()
                    .zip(sums)
                    .for_each(|(label, n)| counts[*label as usize] += n);
                self.policies[variable].add(labels, sums);
            }
        }
    }

    /// Returns what the row variable does on the whole, and what the column variable does.
    pub fn bases(&self) -> [Base; 2] {
        [0, 1].map(|variable| Base::new(&self.counts[variable]))
    }

    /// Returns the habits behind these counts.
    pub(super) fn habits(&self) -> Habits {
        Habits::new(&self.counts[0], &self.counts[1])
    }

    /// Returns the maximum-likelihood concentration kappa of the policies of each variable around
    /// its mean policy.
    pub(super) fn concentrations(&self) -> [Option<f64>; 2] {
        let habits = self.habits();
        [0, 1]
            .map(|variable| self.policies[variable].concentration(&habits.driver(variable).shares))
    }
}

/// The labels and the sums of the rows and of the columns of a table.
pub(super) fn margins(table: &Table) -> [(&[u64], &[u64]); 2] {
    [
        (table.row_labels(), table.rows()),
        (table.column_labels(), table.columns()),
    ]
}

/// Policies in segments that are kept for kappa'.
const MOST_PARTS: usize = 20_000;

/// How a variable's policies differ from segment to segment within a state.
#[derive(Debug, Clone, Default)]
pub(super) struct Segments(Vec<Part>);

/// The visits of one segment in a state: of each letter, here and in all other segments, and their
/// totals.
#[derive(Debug, Clone)]
struct Part {
    letters: Vec<(u64, u64, u64)>,
    here: u64,
    elsewhere: u64,
}

impl Segments {
    /// Adds the parts of a state, by the labels and the sums of the variable.
    pub fn add<'a>(&mut self, parts: impl Iterator<Item = (&'a [u64], &'a [u64])> + Clone) {
        let mut sums: BTreeMap<u64, u64> = BTreeMap::new();

        parts
            .clone()
            .flat_map(letters)
            .for_each(|(label, n)| *sums.entry(label).or_default() += n);

        let total: u64 = sums.values().sum();
        for part in parts.take(MOST_PARTS.saturating_sub(self.0.len())) {
            let here = part.1.iter().sum();
            let letters = letters(part)
                .map(|(label, n)| (label, n, sums[&label] - n))
                .collect();
            self.0.push(Part {
                letters,
                here,
                elsewhere: total - here,
            });
        }
    }

    /// Returns kappa' under which sum ln DM(r_sg; kappa' p) is largest, p the policy in the state's
    /// other segments, with one visit more spread as the environment's mean policy is.
    pub fn concentration(&self, usage: &Usage) -> Option<f64> {
        let mean = &usage.shares;
        if self.0.iter().all(|part| part.here < 2)
            || mean.iter().filter(|share| **share > 0.0).count() < 2
        {
            return None;
        }

        let part = |part: &Part, kappa: f64| {
            let p = |label: u64, elsewhere: u64| {
                (elsewhere as f64 + mean[label as usize]) / (part.elsewhere as f64 + 1.0)
            };
            let letter = |(label, n, elsewhere): &(u64, u64, u64)| {
                ln_rising(kappa * p(*label, *elsewhere), *n)
            };
            part.letters.iter().map(letter).sum::<f64>() - ln_rising(kappa, part.here)
        };

        Some(likeliest(|kappa| {
            self.0.iter().map(|one| part(one, kappa)).sum()
        }))
    }
}

/// Returns each label with its count.
fn letters<'a>(
    (labels, sums): (&'a [u64], &'a [u64]),
) -> impl Iterator<Item = (u64, u64)> + use<'a> {
    labels.iter().copied().zip(sums.iter().copied())
}

/// Returns the concentration where a likelihood is largest: by golden-section search in its
/// logarithm.
fn likeliest(likelihood: impl Fn(f64) -> f64) -> f64 {
    let likelihood = |ln_kappa: f64| likelihood(ln_kappa.exp());
    let [mut low, mut high] = CONCENTRATIONS.map(f64::ln);

    for _ in 0..STEPS {
        let step = GOLDEN * (high - low);
        let [left, right] = [high - step, low + step];
        if likelihood(left) < likelihood(right) {
            low = left
        } else {
            high = right
        }
    }

    (0.5 * (low + high)).exp()
}

/// How a variable's policies differ from state to state, as far as a fit must know: how often each
/// letter had each count in a state.
#[derive(Debug, Clone, Default)]
struct Policies {
    letters: BTreeMap<(u64, u64), u64>,
    totals: BTreeMap<u64, u64>,
}

/// Concentrations between which kappa is sought.
const CONCENTRATIONS: [f64; 2] = [0.05, 1e5];
/// Steps of the search.
const STEPS: u32 = 40;
/// How much one step narrows it.
const GOLDEN: f64 = 0.618_033_988_749_894_8;

impl Policies {
    fn add(&mut self, labels: &[u64], sums: &[u64]) {
        for (label, n) in labels.iter().zip(sums) {
            *self.letters.entry((*label, *n)).or_default() += 1;
        }
        *self.totals.entry(sums.iter().sum()).or_default() += 1;
    }

    /// Returns the concentration kappa under which sum_s ln DM(r_s; kappa h) is largest (Minka
    /// 2000), h the mean policy; `None` where states say nothing of it.
    fn concentration(&self, mean: &[f64]) -> Option<f64> {
        if self.totals.keys().all(|total| *total < 2)
            || mean.iter().filter(|share| **share > 0.0).count() < 2
        {
            return None;
        }
        Some(likeliest(|kappa| self.likelihood(kappa, mean)))
    }

    fn likelihood(&self, kappa: f64, mean: &[f64]) -> f64 {
        let letter = |((label, n), times): (&(u64, u64), &u64)| {
            *times as f64 * ln_rising(kappa * mean[*label as usize], *n)
        };
        let total = |(n, times): (&u64, &u64)| *times as f64 * ln_rising(kappa, *n);
        self.letters.iter().map(letter).sum::<f64>() - self.totals.iter().map(total).sum::<f64>()
    }
}
