//! The observations that a network is trained and evaluated on: for each state its contingency
//! table of independent draws, and the posterior probability that the evidence gives it.

use std::sync::Arc;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::idle_priority::at_idle_priority;
use super::letters::Letters;
use super::store_errors::logged;
use crate::domain::{Environment, FitId, Pair, StateKey, Within};
use crate::error::Problem;
use crate::evidence::{Base, Counted, Ego};
use crate::information::Table;
use crate::priors::{self, Fitted, Observations, Pages, PriorRegistry, Sample, Tables};
use crate::store::Store;
use crate::work::beside;

/// The states of an environment for one pair of agents.
#[derive(Clone)]
pub struct Dataset {
    /// The schema of the environment, in hexadecimal digits.
    pub schema_hash: String,
    /// How many steps after the ego the other is observed.
    pub lag: u32,
    /// How many actions the two have, and at a lag the strata.
    pub letters: Letters,
    /// Every state, in order of key.
    pub examples: Vec<Example>,
    /// The threshold that the evidence is about, in nats.
    pub threshold: f64,
    /// How many transitions the environment had when they were read.
    pub revision: u64,
    /// The fit of the prior.
    pub fitted: Arc<Fitted>,
    /// Whether the ego's actions are the rows of the tables that the prior is fitted to.
    ego: Ego,
}

/// One state.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// The state.
    pub key: StateKey,
    /// What counts as independent draws; rows are the ego's actions, at a lag those of one stratum
    /// after the other.
    pub table: Table,
    /// P(MI > threshold) given its counts.
    pub above: f64,
}

impl Dataset {
    /// Reads the states of an environment as they are now, and asks the evidence about them; `None`
    /// where the alphabets are too large for it.
    pub async fn from_store(
        store: &dyn Store,
        fits: &PriorRegistry,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Self>, Problem> {
        let Some(fitted) = fits.fit(environment, pair).await? else {
            return Ok(None);
        };

        let revision = store
            .totals(environment.id)
            .await
            .map_err(logged)?
            .transitions;
        let dataset = Self {
            schema_hash: environment.schema.hash().to_string(),
            lag: pair.lag(&environment.schema),
            letters: Letters::of_pair(&environment.schema, pair),
            examples: Vec::new(),
            threshold: environment.rule_of(pair).threshold_nats(),
            revision,
            fitted,
            ego: priors::ego(pair),
        };

        let mut sample = Sample::default();
        let mut pages = Pages::new(store, environment.id);
        while let Some(page) = pages.next().await.map_err(logged)? {
            let wanted = page
                .into_iter()
                .filter(|scanned| sample.wants(&scanned.key));
            let drawn = wanted.map(|scanned| {
                let cells = scanned.counts.of_pair(&environment.schema, pair, None);
                let tables = Tables::new(&environment.schema, pair, cells.clone());
                let observations = tables
                    .observations(&environment.schema, pair, Within::Auto, cells.clone())
                    .into_owned();
                let strata =
                    Tables::strata_within(&environment.schema, pair, Within::Pooled, cells);
                let strata = strata.into_iter().map(|one| (one.held, one.table));
                (scanned.key, observations, dataset.letters.stacked(strata))
            });
            // Page by page, since a state may have hundreds of parts: what is kept of it is one
            // table.
            let (drawn, weighing) = (drawn.collect(), dataset.clone());
            let weighed = beside(move || at_idle_priority(|| weighing.weighed(drawn))).await?;
            weighed
                .into_iter()
                .for_each(|example| sample.add(example.key.clone(), example, 1));
        }

        let examples = sample
            .sorted()
            .into_iter()
            .map(|(_, example)| example)
            .collect();
        Ok(Some(Self {
            examples,
            ..dataset
        }))
    }

    /// Asks the evidence about states, whose observations have the prior's rows, and whose tables
    /// have the ego's.
    fn weighed(&self, states: Vec<(StateKey, Observations<'static>, Table)>) -> Vec<Example> {
        let example = |(key, observations, table): (StateKey, Observations<'static>, Table)| {
            (table.total() > 0).then(|| Example {
                above: self.given(observations.counted()),
                key,
                table,
            })
        };
        states.into_par_iter().filter_map(example).collect()
    }

    /// Returns the overall distribution of the other's actions in some states.
    pub fn base<'a>(&self, examples: impl IntoIterator<Item = &'a Example>) -> Base {
        let mut counts = vec![0; self.letters.actions.columns as usize];
        examples
            .into_iter()
            .flat_map(|example| example.table.triples())
            .for_each(|(_, j, n)| counts[j as usize] += n);
        Base::new(&counts)
    }

    /// Returns the same in each stratum.
    pub fn base_by_stratum(&self, examples: &[&Example]) -> Vec<Base> {
        let Letters { actions, strata } = self.letters;
        let columns = actions.columns as usize;
        let mut counts = vec![0; strata as usize * columns];
        examples
            .iter()
            .flat_map(|example| example.table.triples())
            .for_each(|(row, j, n)| {
                counts[self.letters.stratum(row as usize) * columns + j as usize] += n
            });
        counts.chunks(columns).map(Base::new).collect()
    }

    /// Returns P(MI > threshold) given a table whose rows are the ego's actions, at a lag those of
    /// one stratum after the other.
    pub fn above(&self, table: &Table) -> f64 {
        let strata = self.letters.strata_of(table).into_iter();
        let strata: Vec<Table> = match self.ego {
            Ego::Rows => strata.map(|(_, table)| table.into_owned()).collect(),
            Ego::Columns => strata.map(|(_, table)| table.transposed()).collect(),
        };
        self.given((&strata).into())
    }

    /// Returns the same of a state's draws, whose rows are the prior's.
    fn given(&self, counted: Counted<'_>) -> f64 {
        let prior = &self.fitted.prior;
        prior
            .posterior(prior.habits(), counted)
            .above(self.threshold)
    }

    /// Returns the same with the other's actions shuffled within each state, at a lag within each
    /// stratum of it: every habit stays, and nothing depends on anything else.
    pub fn shuffled(&self, seed: u64) -> Self {
        let shuffle = |Example { key, table, .. }: &Example| {
            let mut random = random(key, seed);
            let strata = self.letters.strata_of(table).into_iter();
            let shuffled = strata.map(|(stratum, table)| (stratum, shuffled(&table, &mut random)));
            let table = self.letters.stacked(shuffled);
            Example {
                above: self.above(&table),
                key: key.clone(),
                table,
            }
        };
        Self {
            examples: self.examples.par_iter().map(shuffle).collect(),
            schema_hash: self.schema_hash.clone(),
            fitted: self.fitted.clone(),
            ..*self
        }
    }

    /// Returns which of the parts a state belongs to: by its key and the seed alone, so that all
    /// visits of a state are in one.
    pub fn fold(key: &StateKey, folds: usize, seed: u64) -> usize {
        random(key, !seed).random_range(0..folds)
    }

    /// Returns how often the states were drawn.
    pub fn draws(&self) -> u64 {
        self.examples
            .iter()
            .map(|example| example.table.total())
            .sum()
    }

    /// Returns which fit of the prior it is.
    pub fn fit(&self) -> FitId {
        self.fitted.id
    }
}

fn random(key: &StateKey, seed: u64) -> Pcg64 {
    Pcg64::seed_from_u64(key.seed() ^ seed)
}

/// Returns the cells of a table: the ego's action, the other's action, the count.
pub fn cells(table: &Table) -> impl Iterator<Item = (usize, usize, f64)> {
    table
        .triples()
        .map(|(row, column, n)| (row as usize, column as usize, n as f64))
}

/// Draws of a state that are shuffled one by one; more are scaled down first: a table of so many
/// draws tells nothing new.
const MOST_SHUFFLED: u64 = 1 << 16;

fn shuffled(table: &Table, random: &mut Pcg64) -> Table {
    let share = table.total().div_ceil(MOST_SHUFFLED).max(1);
    let each = |(row, column, n): (u64, u64, u64)| {
        std::iter::repeat_n((row, column), n.div_ceil(share) as usize)
    };
    let (rows, mut columns): (Vec<u64>, Vec<u64>) = table.triples().flat_map(each).unzip();
    columns.shuffle(random);
    Table::from_counts(
        rows.into_iter()
            .zip(columns)
            .map(|(row, column)| (row, column, share)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shuffling_keeps_every_habit() {
        let table = Table::from_counts([(0, 0, 30), (1, 1, 20), (2, 0, 10)]);
        let shuffled = shuffled(&table, &mut Pcg64::seed_from_u64(1));
        assert_eq!(
            (shuffled.rows(), shuffled.columns()),
            (table.rows(), table.columns())
        );
        assert_ne!(shuffled, table);
    }

    #[test]
    fn folds_are_of_about_the_same_size() {
        let mut sizes = [0; 5];
        (0..5_000).for_each(|bin| sizes[Dataset::fold(&StateKey::new(&[bin]), 5, 7)] += 1);
        assert!(
            sizes.iter().all(|size| (900..1_100).contains(size)),
            "{sizes:?}"
        );
    }
}
