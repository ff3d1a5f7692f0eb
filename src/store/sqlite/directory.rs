//! The catalogue of environments, in memory. It is changed after the database has been, and read by
//! everything.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::Instant;

use crate::domain::{Environment, EnvironmentId, Name, UnreadableEnvironment};

/// Every environment as it was read, or why it was not.
pub(super) type Loaded = Result<Environment, UnreadableEnvironment>;

/// The longest time from one look at a damaged environment to the next: each may read all of it.
const LONGEST: Duration = Duration::from_secs(300);

/// Every environment by its name, those that cannot be read, and which take no more batches.
pub(super) struct Directory {
    environments: RwLock<BTreeMap<Name, Arc<Environment>>>,
    unreadable: RwLock<BTreeMap<String, Arc<UnreadableEnvironment>>>,
    read_only: RwLock<HashMap<EnvironmentId, Seal>>,
    /// How soon a damaged one is looked at again.
    soon: Duration,
    /// Told when one is found to be damaged.
    found: Notify,
}

/// What keeps an environment from taking batches.
struct Seal {
    /// What is wrong with it.
    why: String,
    since: Instant,
    /// When it is looked at again, and how long that was put off.
    due: Instant,
    put_off: Duration,
}

impl Directory {
    /// Makes an empty one, whose damaged environments are looked at again so soon.
    pub(super) fn new(soon: Duration) -> Self {
        Self {
            environments: RwLock::default(),
            unreadable: RwLock::default(),
            read_only: RwLock::default(),
            soon,
            found: Notify::new(),
        }
    }

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
    /// cannot be read. One that was read before is kept as it was then: it is damaged.
    pub(super) fn replace(&self, all: Vec<Loaded>) {
        let (mut read, mut unread) = (BTreeMap::new(), BTreeMap::new());
        let mut damaged = Vec::new();
        for loaded in all {
            match loaded {
                Ok(environment) => {
                    drop(read.insert(environment.name.clone(), Arc::new(environment)))
                }
                Err(environment) => match self.of_id(environment.id) {
                    Some(known) => {
                        read.insert(known.name.clone(), known);
                        damaged.push(environment);
                    }
                    None => drop(unread.insert(environment.name.clone(), Arc::new(environment))),
                },
            }
        }
        self.change(|environments| *environments = read);
        for environment in damaged {
            self.make_read_only(environment.id, &environment.why);
        }

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

    /// Lets an environment that is damaged take no more batches, until it is found to be sound, and
    /// says so in the log. Returns whether it took some before.
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
            let since = Instant::now();
            let seal = Seal {
                why: why.to_owned(),
                since,
                due: since + self.soon,
                put_off: self.soon,
            };
            read_only.insert(id, seal);
            self.found.notify_one();
            let environment = environment.name.as_str();
            tracing::error!(
                environment,
                why,
                "an environment is damaged: it takes no more batches; run `nudge check`, and restore a backup"
            );
        }
        is_new
    }

    /// Lets an environment take batches again that was found to be sound, and says so in the log.
    pub(super) fn lift(&self, id: EnvironmentId) {
        let lifted = self
            .read_only
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .remove(&id);
        if let (Some(seal), Some(environment)) = (lifted, self.of_id(id)) {
            let environment = environment.name.as_str();
            let sealed_seconds = seal.since.elapsed().as_secs_f64();
            let why = seal.why;
            tracing::warn!(
                environment,
                sealed_seconds,
                why,
                "an environment that seemed damaged is sound: it takes batches again; the disk failed to read it, or was mended: look at the system's log"
            );
        }
    }

    /// Lets an environment that was found to be damaged again wait twice as long for the next look.
    pub(super) fn put_off(&self, id: EnvironmentId) {
        let mut read_only = self
            .read_only
            .write()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(seal) = read_only.get_mut(&id) {
            seal.put_off = (2 * seal.put_off).min(LONGEST);
            seal.due = Instant::now() + seal.put_off;
        }
    }

    /// Waits until a damaged environment is to be looked at again, and returns it.
    pub(super) async fn due(&self) -> EnvironmentId {
        loop {
            let next = self.next_due();
            let Some((due, id)) = next else {
                self.found.notified().await;
                continue;
            };
            tokio::select! {
                () = tokio::time::sleep_until(due) => return id,
                // It may be due sooner.
                () = self.found.notified() => {}
            }
        }
    }

    fn next_due(&self) -> Option<(Instant, EnvironmentId)> {
        let read_only = self
            .read_only
            .read()
            .unwrap_or_else(PoisonError::into_inner);
        let due = read_only.iter().map(|(id, seal)| (seal.due, *id));
        due.min_by_key(|(due, _)| *due)
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
            if let Some(seal) = read_only.get(&environment.id) {
                told.push((environment.name.clone(), seal.why.clone()));
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
