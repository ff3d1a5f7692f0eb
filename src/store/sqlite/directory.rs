//! The catalogue of environments, in memory. It is changed after the database has been, and read by
//! everything.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, PoisonError, RwLock};

use crate::domain::{Environment, EnvironmentId, Name, UnreadableEnvironment};

/// Every environment as it was read, or why it was not.
pub(super) type Loaded = Result<Environment, UnreadableEnvironment>;

/// Every environment by its name, those that cannot be read, and which take no more batches.
#[derive(Default)]
pub(super) struct Directory {
    environments: RwLock<BTreeMap<Name, Arc<Environment>>>,
    unreadable: RwLock<BTreeMap<String, Arc<UnreadableEnvironment>>>,
    /// With what is wrong with each.
    read_only: RwLock<HashMap<EnvironmentId, String>>,
}

impl Directory {
    /// Returns every environment, in order of name.
    pub(super) fn all(&self) -> Vec<Arc<Environment>> {
        self.look_up(|environments| environments.values().cloned().collect())
    }

    /// Returns the environment of that name.
    pub(super) fn named(&self, name: &str) -> Option<Arc<Environment>> {
        self.look_up(|environments| environments.get(name).cloned())
    }

    /// Returns the environment of that id.
    pub(super) fn of_id(&self, id: EnvironmentId) -> Option<Arc<Environment>> {
        self.look_up(|environments| {
            environments
                .values()
                .find(|environment| environment.id == id)
                .cloned()
        })
    }

    /// Returns whether there is an environment of that id, readable or not.
    pub(super) fn has(&self, id: EnvironmentId) -> bool {
        self.of_id(id).is_some()
            || self
                .unreadable()
                .iter()
                .any(|environment| environment.id == id)
    }

    /// Returns every environment that cannot be read, in order of name.
    pub(super) fn unreadable(&self) -> Vec<Arc<UnreadableEnvironment>> {
        self.unreadable
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .values()
            .cloned()
            .collect()
    }

    /// Adds an environment, or replaces it.
    pub(super) fn put(&self, environment: Arc<Environment>) {
        self.change(|environments| environments.insert(environment.name.clone(), environment));
    }

    /// Removes an environment.
    pub(super) fn remove(&self, id: EnvironmentId) {
        self.change(|environments| environments.retain(|_, environment| environment.id != id));
        self.unreadable
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .retain(|_, unread| unread.id != id);
        self.read_only
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .remove(&id);
    }

    /// Replaces all environments by what the database holds, and says in the log which of them
    /// cannot be read.
    pub(super) fn replace(&self, all: Vec<Loaded>) {
        let (mut read, mut unread) = (BTreeMap::new(), BTreeMap::new());
        for loaded in all {
            match loaded {
                Ok(environment) => {
                    drop(read.insert(environment.name.clone(), Arc::new(environment)))
                }
                Err(environment) => {
                    drop(unread.insert(environment.name.clone(), Arc::new(environment)))
                }
            }
        }
        self.change(|environments| *environments = read);

        let mut present = self
            .unreadable
            .write()
            .unwrap_or_else(PoisonError::into_inner);
        // The database is read again after a failed transaction: what was told stays told.
        for (environment, unread) in unread
            .iter()
            .filter(|(name, _)| !present.contains_key(*name))
        {
            tracing::warn!(environment, uid = %unread.uid, why = unread.why, "an environment cannot be read: it can only be deleted");
        }
        *present = unread;
    }

    /// Lets an environment that is damaged take no more batches, until the process ends, and says
    /// so in the log. Returns whether it took some before.
    pub(super) fn make_read_only(&self, id: EnvironmentId, why: &str) -> bool {
        let Some(environment) = self.of_id(id) else {
            return false;
        };

        let mut read_only = self
            .read_only
            .write()
            .unwrap_or_else(PoisonError::into_inner);

        // What was found first is told: what comes of it later says less.
        let is_new = !read_only.contains_key(&id);
        if is_new {
            read_only.insert(id, why.to_owned());
            let environment = environment.name.as_str();
            tracing::error!(
                environment,
                why,
                "an environment is damaged: it takes no more batches; run `nudge check`, and restore a backup"
            );
        }
        is_new
    }

    /// Returns whether an environment takes no more batches.
    pub(super) fn is_read_only(&self, id: EnvironmentId) -> bool {
        self.read_only
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .contains_key(&id)
    }

    /// Returns the environments that take no more batches, in order of name, with what is wrong
    /// with each.
    pub(super) fn read_only(&self) -> Vec<(Name, String)> {
        let read_only = self
            .read_only
            .read()
            .unwrap_or_else(PoisonError::into_inner);

        let mut told = Vec::with_capacity(read_only.len());
        for environment in self.all() {
            if let Some(why) = read_only.get(&environment.id) {
                told.push((environment.name.clone(), why.clone()));
            }
        }
        told
    }

    fn look_up<R>(&self, look: impl FnOnce(&BTreeMap<Name, Arc<Environment>>) -> R) -> R {
        look(
            &self
                .environments
                .read()
                .unwrap_or_else(PoisonError::into_inner),
        )
    }

    fn change<R>(&self, change: impl FnOnce(&mut BTreeMap<Name, Arc<Environment>>) -> R) -> R {
        change(
            &mut self
                .environments
                .write()
                .unwrap_or_else(PoisonError::into_inner),
        )
    }
}
