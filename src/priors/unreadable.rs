//! Stored fits that this build cannot read: which, and why. Each is made again from the same
//! counts.

use super::fitted::alphabet;
use super::registry::PriorRegistry;
use super::stored_forms;
use crate::domain::{Environment, Schema};
use crate::store::form::Unreadable;
use crate::store::{FitRecord, StoreError};

impl PriorRegistry {
    /// Says in the log which fits cannot be read, and why. [`PriorRegistry::keep_up`] and
    /// [`PriorRegistry::fit`] make others.
    pub async fn tell_unreadable(&self) {
        for environment in self.store.environments() {
            match self.store.fits(environment.id).await {
                Ok(records) => records.iter().for_each(|record| tell(&environment, record)),
                // Somebody may have removed it meanwhile.
                Err(StoreError::UnknownEnvironment) => {}
                Err(error) => {
                    tracing::warn!(%error, environment = %environment.name, "the fits could not be read")
                }
            }
        }
    }

    /// Returns every fit that this build cannot read. What the store cannot read is left out.
    pub async fn unreadable(&self) -> Vec<UnreadableFit> {
        let mut found = Vec::new();
        for environment in self.store.environments() {
            let records = self.store.fits(environment.id).await.unwrap_or_default();
            let unread = |record: FitRecord| {
                let why = unreadable(&environment.schema, &record)?;
                Some(UnreadableFit {
                    environment: environment.name.to_string(),
                    pair: record.pair,
                    why,
                })
            };
            found.extend(records.into_iter().filter_map(unread));
        }
        found
    }
}

/// A stored fit that this build cannot read.
pub struct UnreadableFit {
    /// The environment's name.
    pub environment: String,
    /// The pair, as it is stored.
    pub pair: String,
    /// Why.
    pub why: Unreadable,
}

impl UnreadableFit {
    /// Returns whether nothing is wrong with it but its age: another is made from the same counts.
    pub fn is_older(&self) -> bool {
        matches!(self.why, Unreadable::Older(_))
    }
}

/// Says in the log why a fit cannot be read, if it cannot.
fn tell(environment: &Environment, record: &FitRecord) {
    let Some(why) = unreadable(&environment.schema, record) else {
        return;
    };
    let (environment, pair, version) = (&environment.name, &record.pair, record.id.version);
    match why {
        // Nothing is wrong: another can be made from the same counts.
        Unreadable::Older(_) => {
            tracing::info!(%environment, pair, version, %why, "a fit is not used: version 0 answers until another is made, by --fit-every or POST .../fit")
        }
        _ => {
            tracing::warn!(%environment, pair, version, %why, "a fit cannot be read: version 0 answers until another is made, by --fit-every or POST .../fit")
        }
    }
}

/// Returns why a fit cannot be read, if it cannot.
fn unreadable(schema: &Schema, record: &FitRecord) -> Option<Unreadable> {
    match stored_forms::read_pair(&record.pair)
        .filter(|pair| pair.is_of(schema))
        .and_then(|pair| alphabet(schema, &pair))
    {
        Some(alphabet) => stored_forms::read_record(record, alphabet).err(),
        None => Some(Unreadable::spoiled("nothing is fitted to this pair")),
    }
}
