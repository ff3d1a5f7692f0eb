//! Leases and fencing: which stream speaks for a producer. A later stream fences the earlier one,
//! and an environment that goes takes its streams with it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use tokio_util::sync::CancellationToken;

use crate::domain::{EnvironmentId, Name, ProducerId};
use crate::error::{ErrorKind, Problem};
use crate::store::ENVIRONMENT_NOT_FOUND;

type Key = (EnvironmentId, ProducerId);

/// A registry of the live streams, a lease for each producer. Cloning is cheap.
#[derive(Clone, Default)]
pub struct Streams(Arc<Mutex<HashMap<Key, Arc<Lease>>>>);

/// The right of one stream to speak for its producer, until it ends.
#[derive(Default)]
pub struct Lease {
    owner: Option<Name>,
    over: CancellationToken,
    why: OnceLock<End>,
}

#[derive(Clone, Copy)]
enum End {
    Fenced,
    Deleted,
}

/// Gives a lease back when its stream ends.
pub struct Registration {
    streams: Streams,
    key: Key,
    lease: Arc<Lease>,
}

impl Streams {
    /// Gives a new stream its lease; the lease of the producer's earlier stream is over before this
    /// returns. `None` where that one is of another key's name, which goes on: nothing of either
    /// may be stored yet.
    pub fn open(
        &self,
        environment: EnvironmentId,
        producer: ProducerId,
        owner: Option<Name>,
    ) -> Option<Registration> {
        let key = (environment, producer);
        let mut live = self.lock();
        let is_anothers =
            |live: &Arc<Lease>| owner.is_some() && live.owner.is_some() && live.owner != owner;
        if live.get(&key).is_some_and(is_anothers) {
            return None;
        }

        let lease = Arc::new(Lease {
            owner,
            ..Lease::default()
        });
        if let Some(earlier) = live.insert(key.clone(), lease.clone()) {
            earlier.end(End::Fenced);
        }

        drop(live);
        Some(Registration {
            streams: self.clone(),
            key,
            lease,
        })
    }

    /// Ends every stream into an environment that was deleted.
    pub fn end_all(&self, environment: EnvironmentId) {
        self.lock()
            .iter()
            .filter(|(key, _)| key.0 == environment)
            .for_each(|(_, lease)| lease.end(End::Deleted));
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Key, Arc<Lease>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Lease {
    /// Returns why the lease is over, if it is.
    pub fn check(&self) -> Result<(), Problem> {
        if self.over.is_cancelled() {
            Err(self.problem())
        } else {
            Ok(())
        }
    }

    /// Waits until the lease is over and returns why.
    pub async fn ended(&self) -> Problem {
        self.over.cancelled().await;
        self.problem()
    }

    fn end(&self, why: End) {
        // The first reason stays.
        let _ = self.why.set(why);
        self.over.cancel();
    }

    fn problem(&self) -> Problem {
        match self.why.get() {
            Some(End::Deleted) => Problem::new(
                ErrorKind::NotFound,
                ENVIRONMENT_NOT_FOUND,
                "the environment was deleted while this stream was open",
            ),
            _ => Problem::new(
                ErrorKind::Conflict,
                "FENCED",
                "a later stream of the same producer has taken over",
            ),
        }
    }
}

impl Registration {
    /// Returns the lease.
    pub fn lease(&self) -> &Arc<Lease> {
        &self.lease
    }
}

impl Drop for Registration {
    fn drop(&mut self) {
        let mut live = self.streams.lock();
        if live
            .get(&self.key)
            .is_some_and(|lease| Arc::ptr_eq(lease, &self.lease))
        {
            live.remove(&self.key);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn producer(name: &str) -> ProducerId {
        name.parse().expect("valid")
    }

    #[test]
    fn a_later_stream_fences_only_its_own_producer() {
        let streams = Streams::default();
        let open = |environment| {
            streams
                .open(EnvironmentId(environment), producer("p"), None)
                .expect("nobody's")
        };
        let [first, elsewhere, second] = [1, 2, 1].map(open);
        assert_eq!(first.lease().check().expect_err("fenced").reason, "FENCED");
        assert!(second.lease().check().is_ok() && elsewhere.lease().check().is_ok());
        drop(first);
        let third = open(1);
        assert!(
            second.lease().check().is_err(),
            "the fenced stream's end must not unregister the second"
        );
        assert!(third.lease().check().is_ok());
    }

    #[test]
    fn a_key_does_not_fence_the_stream_of_another_name() {
        let streams = Streams::default();
        let open = |owner: &str| {
            streams.open(
                EnvironmentId(1),
                producer("p"),
                Some(owner.parse().expect("a name")),
            )
        };
        let first = open("a").expect("nobody's");
        assert!(open("b").is_none() && first.lease().check().is_ok());
        let second = open("a").expect("its own");
        assert!(first.lease().check().is_err());
        drop((first, second));
        assert!(open("b").is_some(), "nothing of it is stored");
    }

    #[test]
    fn an_environment_takes_its_streams_with_it() {
        let streams = Streams::default();
        let open = |environment| {
            streams
                .open(EnvironmentId(environment), producer("p"), None)
                .expect("nobody's")
        };
        let [gone, stays] = [1, 2].map(open);
        streams.end_all(EnvironmentId(1));
        assert_eq!(
            gone.lease().check().expect_err("deleted").kind,
            ErrorKind::NotFound
        );
        assert!(stays.lease().check().is_ok());
    }
}
