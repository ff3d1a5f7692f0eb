//! Fitting a prior: empirical Bayes, by one pass over all states of an environment.

use std::sync::Arc;
use std::time::Instant;

use tokio::sync::MutexGuard;

use super::fitted::{Fitted, alphabet};
use super::registry::PriorRegistry;
use super::sample::Sample;
use super::scan::Pages;
use super::stored_forms;
use super::tables::{Observations, Tables};
use crate::domain::{Environment, FitId, Pair, Schema, StateKey, Within};
use crate::error::Problem;
use crate::evidence::{Fitter, Uses};
use crate::information::{Alphabet, Table};
use crate::store::{FitRecord, Scanned, StoreError};
use crate::work::{Progress, Stopped};

impl PriorRegistry {
    /// Fits a pair to the counts as they are now; `None` where the alphabets are too large for
    /// evidence. Whoever asks has it kept up for an hour.
    pub async fn fit(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Fitted>>, Problem> {
        self.fit_telling(&Progress::default(), environment, pair)
            .await
    }

    /// Fits a pair and tells how far it is.
    pub async fn fit_telling(
        &self,
        progress: &Progress,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Fitted>>, Problem> {
        self.asked
            .note((environment.id, pair.undirected()), Instant::now());
        let turn = self.making.lock().await;
        self.make(&turn, progress, environment, pair).await
    }

    /// Fits a pair. The caller has the turn to: fits are made one at a time, and versions are
    /// numbered in their order.
    pub(super) async fn make(
        &self,
        _turn: &MutexGuard<'_, ()>,
        progress: &Progress,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Fitted>>, Problem> {
        let pair = pair.undirected();
        let Some(alphabet) = alphabet(&environment.schema, &pair) else {
            return Ok(None);
        };
        let last = self
            .get(environment, &pair)
            .await
            .map_err(logged)?
            .map_or(0, |fitted| fitted.last_version);
        if last >= i64::MAX.unsigned_abs() {
            return Err(logged(StoreError::VersionsUsedUp("fit")));
        }
        let (version, totals) = (
            last + 1,
            self.store.totals(environment.id).await.map_err(logged)?,
        );
        progress.begin("states read", totals.states);
        let (uses, states) = self.states(progress, environment, &pair, alphabet).await?;

        progress.begin("states looked at, and then fitted", states.len() as u64);
        let telling = progress.clone();
        let fitting = self.gate.run(move |stop| {
            let mut fitter = Fitter::new(alphabet, &uses);
            for (_, observations) in &states {
                stop.check()?;
                fitter.add(observations.counted());
                telling.add(1);
            }
            fitter.fit_while(&|| stop.goes_on()).ok_or(Stopped)
        });
        let fit = fitting.await?;
        let id = FitId {
            version,
            revision: totals.transitions,
        };

        let record = FitRecord {
            pair: stored_forms::write_pair(&pair),
            id,
            body: stored_forms::write_fit(&fit),
            is_sound: true,
        };
        self.store
            .keep_fit(environment.id, &record)
            .await
            .map_err(logged)?;

        tracing::debug!(environment = %environment.name, pair = record.pair, version, states = fit.states, "fitted");
        Ok(Some(self.keep(
            (environment.id, pair),
            id,
            version,
            Some(Instant::now()),
            fit,
        )))
    }

    /// Returns how all states use the actions of both agents, and the observations of the states
    /// that can tell dependence from independence, in order of key.
    async fn states(
        &self,
        progress: &Progress,
        environment: &Environment,
        pair: &Pair,
        alphabet: Alphabet,
    ) -> Result<(Uses, Vec<(StateKey, Observations<'static>)>), Problem> {
        let mut read = Read {
            schema: environment.schema.clone(),
            pair: pair.clone(),
            uses: Uses::new(alphabet),
            sample: Sample::default(),
        };

        let mut pages = Pages::new(&*self.store, environment.id);
        while let Some(page) = pages.next().await.map_err(logged)? {
            let states = page.len() as u64;
            read = self
                .gate
                .run(move |stop| {
                    for scanned in page {
                        stop.check()?;
                        read.add(scanned);
                    }
                    Ok(read)
                })
                .await?;
            progress.add(states);
        }

        Ok((read.uses, read.sample.sorted()))
    }
}

/// What a fit is made from, as far as it is read.
struct Read {
    schema: Schema,
    pair: Pair,
    uses: Uses,
    sample: Sample<Observations<'static>>,
}

impl Read {
    fn add(&mut self, scanned: Scanned) {
        let cells = scanned.counts.of_pair(&self.schema, &self.pair, None);
        let tables = Tables::new(&self.schema, &self.pair, cells.clone());
        let observations = tables.observations(&self.schema, &self.pair, Within::Auto, cells);
        self.uses.add(observations.counted());
        if !observations.strata.iter().all(Table::is_line) {
            let tables = observations.tables();
            self.sample
                .add(scanned.key, observations.into_owned(), tables);
        }
    }
}

fn logged(error: StoreError) -> Problem {
    tracing::error!(%error, "a prior could not be fitted");
    error.into()
}
