//! A back-off model: what was seen in states that share the most telling features, the baseline
//! that needs no network.
//!
//! Features are left out one by one (backward elimination), each time the one without which the
//! rest tells most: by the log marginal likelihood sum ln DM(n_i.; k g) of the tables of all states
//! that agree in the rest, each row with its own response. A state is then told by the first of
//! these coarser tables with enough draws.

use foldhash::{HashMap, HashMapExt};

use super::dataset::{Dataset, Example, cells};
use super::letters::Letters;
use crate::domain::StateKey;
use crate::evidence::rows_evidence;
use crate::information::Table;

/// Draws from which a coarser table is believed.
const ENOUGH: u64 = 8;

/// Concentration of the rows around what the other does in the environment on the whole.
const CONCENTRATION: f64 = 2.0;

/// Features that are considered: of more, those that tell most one by one.
const MOST_FEATURES: usize = 24;

/// How many states may be looked at to choose what is left out; of more a part is taken.
const WORK: usize = 2_000_000;

/// Coarser and coarser tables of the states that were learned from.
pub struct BackOff {
    levels: Vec<Level>,
    /// The share of each of the other's actions, in each stratum.
    base: Vec<Vec<f64>>,
    letters: Letters,
}

/// The tables of states that agree in some features.
struct Level {
    features: Vec<usize>,
    tables: HashMap<Vec<u32>, Table>,
}

impl BackOff {
    /// Learns from the states at these positions.
    pub fn new(dataset: &Dataset, learned: &[usize]) -> Self {
        let examples: Vec<&Example> = learned.iter().map(|at| &dataset.examples[*at]).collect();
        let letters = dataset.letters;
        let base: Vec<Vec<f64>> = dataset
            .base_by_stratum(&examples)
            .iter()
            .map(|base| base.shares().to_vec())
            .collect();
        let gain = |examples: &[&Example], features: &[usize]| {
            log_evidence(&pooled(examples, features), |row, j| {
                base[letters.stratum(row)][j]
            })
        };
        let mut features = considered(&examples, |feature| gain(few(&examples, 1), &[feature]));

        let few = few(&examples, features.len());
        let mut levels = Vec::new();
        while !features.is_empty() {
            let gains: Vec<f64> = features
                .iter()
                .map(|left| gain(few, &without(&features, *left)))
                .collect();
            let least = (0..gains.len())
                .max_by(|a, b| gains[*a].total_cmp(&gains[*b]))
                .expect("there is a feature");
            features.remove(least);

            let mut tables = pooled(&examples, &features);
            // The last level is for those who find no better one.
            tables.retain(|_, table| table.total() >= ENOUGH || features.is_empty());
            levels.push(Level {
                tables,
                features: features.clone(),
            });
        }

        Self {
            levels,
            base,
            letters,
        }
    }

    /// Returns the finest table with enough draws that a state belongs to; the one of all states if
    /// none has.
    pub fn table(&self, key: &StateKey) -> Option<&Table> {
        let tables = || {
            self.levels
                .iter()
                .filter_map(|level| level.tables.get(&part(key, &level.features)))
        };
        tables()
            .find(|table| table.total() >= ENOUGH)
            .or_else(|| tables().next_back())
    }

    /// Returns the mean log-likelihood that a table gives to the other's actions in a state, summed
    /// over its draws: its rows, drawn to what the other does on the whole.
    pub fn log_likelihood(&self, table: Option<&Table>, example: &Example) -> f64 {
        let columns = self.letters.actions.columns as usize;
        let base = |i: usize, j: usize| self.base[self.letters.stratum(i)][j];
        let mut rows: HashMap<usize, (f64, Vec<f64>)> = HashMap::new();
        for (i, j, n) in table.into_iter().flat_map(cells) {
            let row = rows.entry(i).or_insert_with(|| (0.0, vec![0.0; columns]));
            row.0 += n;
            row.1[j] += n;
        }

        let share = |i: usize, j: usize| match rows.get(&i) {
            Some((sum, row)) => (row[j] + CONCENTRATION * base(i, j)) / (sum + CONCENTRATION),
            None => base(i, j),
        };

        cells(&example.table)
            .map(|(i, j, n)| n * share(i, j).ln())
            .sum()
    }
}

/// Returns the log marginal likelihood of tables, each row with its own response.
fn log_evidence(
    tables: &HashMap<Vec<u32>, Table>,
    base: impl Fn(usize, usize) -> f64 + Copy,
) -> f64 {
    // In order of key, so that the same states give the same sum.
    let mut each: Vec<_> = tables.iter().collect();
    each.sort_unstable_by(|a, b| a.0.cmp(b.0));

    each.into_iter()
        .map(|(_, table)| rows_evidence(table, CONCENTRATION, base))
        .sum()
}

fn without(features: &[usize], left: usize) -> Vec<usize> {
    let rest = features.iter().copied();
    rest.filter(|feature| *feature != left).collect()
}

/// Returns the features that differ between states, in order; of very many, those of the largest
/// worth.
fn considered(examples: &[&Example], worth: impl Fn(usize) -> f64) -> Vec<usize> {
    let Some(first) = examples.first() else {
        return Vec::new();
    };
    let differs = |feature: &usize| {
        examples
            .iter()
            .any(|one| one.key.bins()[*feature] != first.key.bins()[*feature])
    };
    let mut features: Vec<usize> = (0..first.key.bins().len()).filter(differs).collect();
    if features.len() > MOST_FEATURES {
        let mut ranked: Vec<(f64, usize)> = features
            .iter()
            .map(|feature| (worth(*feature), *feature))
            .collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        features = ranked
            .into_iter()
            .take(MOST_FEATURES)
            .map(|(_, feature)| feature)
            .collect();
        features.sort_unstable();
    }
    features
}

fn few<'a, 'e>(examples: &'a [&'e Example], features: usize) -> &'a [&'e Example] {
    const FEWEST: usize = 200;
    let most = (WORK / (features * features).max(1)).max(FEWEST);
    &examples[..examples.len().min(most)]
}

fn pooled(examples: &[&Example], features: &[usize]) -> HashMap<Vec<u32>, Table> {
    let mut counts: HashMap<Vec<u32>, Vec<(u64, u64, u64)>> = HashMap::new();
    for example in examples {
        counts
            .entry(part(&example.key, features))
            .or_default()
            .extend(example.table.triples());
    }
    counts
        .into_iter()
        .map(|(key, counts)| (key, Table::from_counts(counts)))
        .collect()
}

fn part(key: &StateKey, features: &[usize]) -> Vec<u32> {
    features
        .iter()
        .map(|feature| key.bins()[*feature])
        .collect()
}
