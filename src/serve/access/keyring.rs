//! The API keys that are in force, which a reload replaces while requests are under way, and who
//! asks with one of them.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use arc_swap::ArcSwap;
use tokio::sync::watch;

use super::denials::{unauthenticated, word};
use super::wanted::Wanted;
use crate::access::{Key, KeyDigest, Keys};
use crate::domain::{Asker, Principal};
use crate::error::{ErrorKind, Problem};
use crate::telemetry;

/// How long a stream waits for the rate of its key before it is ended.
const PATIENCE: Duration = Duration::from_secs(5);

/// The API keys in force now. Cloning is cheap and shares them.
#[derive(Clone)]
pub struct Keyring(Arc<Ring>);

struct Ring {
    keys: ArcSwap<Keys>,
    changed: watch::Sender<()>,
}

impl Keyring {
    /// Makes a keyring of these.
    pub fn new(keys: Keys) -> Self {
        Self(Arc::new(Ring {
            keys: ArcSwap::from_pointee(keys),
            changed: watch::Sender::new(()),
        }))
    }

    /// Lets in these instead: at once, and whoever is in by a key that is none of them any more is
    /// out.
    pub fn replace(&self, keys: Keys) {
        let keys = keys.going_on_from(&self.0.keys.load());
        self.0.keys.store(Arc::new(keys));
        self.0.changed.send_replace(());
    }

    /// Returns who asks with that key for something that wants so much.
    pub fn caller(&self, key: &[u8], wanted: Wanted) -> Option<Caller> {
        let digest = KeyDigest::of_key(key);
        let first = self.find(digest)?.principal().clone();
        let (ring, name) = (self.clone(), first.name().cloned());
        let nobody = Arc::new(Principal::nobody());
        let asker = Asker::changing(first, move || {
            let key = ring.find(digest).filter(|key| key.name() == name.as_ref());
            key.map_or_else(|| nobody.clone(), |key| key.principal().clone())
        });

        Some(Caller {
            asker,
            key: Some((self.clone(), digest)),
            wanted,
        })
    }

    fn find(&self, digest: KeyDigest) -> Option<Key> {
        self.0.keys.load().find(digest).cloned()
    }
}

impl fmt::Debug for Keyring {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Keyring({} keys)", self.0.keys.load().len())
    }
}

/// Who sent a request: what handlers know of them, and what goes on asking whether they are still
/// let in.
#[derive(Debug, Clone)]
pub struct Caller {
    asker: Asker,
    /// `None` where nobody needs one.
    key: Option<(Keyring, KeyDigest)>,
    wanted: Wanted,
}

/// Whoever was not let in by the layer may do nothing.
impl Default for Caller {
    fn default() -> Self {
        Self {
            asker: Asker::always(Principal::nobody()),
            key: None,
            wanted: Wanted::Unlisted,
        }
    }
}

impl Caller {
    /// Makes the one who asks where nobody needs a key.
    pub fn anonymous() -> Self {
        Self {
            asker: Asker::always(Principal::anonymous()),
            key: None,
            wanted: Wanted::Unlisted,
        }
    }

    /// Returns who was let in.
    pub fn principal(&self) -> &Arc<Principal> {
        self.asker.first()
    }

    /// Returns who asks, at each moment.
    pub fn asker(&self) -> &Asker {
        &self.asker
    }

    /// Returns whether there is a key that may be withdrawn.
    pub fn has_key(&self) -> bool {
        self.key.is_some()
    }

    /// Takes one of the key's rate, or refuses.
    pub fn take(&self) -> Result<(), Problem> {
        self.taken().map_err(|wait| self.too_often(wait))
    }

    /// Takes one of the key's rate for a part of a stream, waiting for it where it comes soon: the
    /// stream is then not read on, which slows its sender.
    pub async fn turn(&self) -> Result<(), Problem> {
        loop {
            match self.taken() {
                Ok(()) => return Ok(()),
                Err(wait) if wait <= PATIENCE => tokio::time::sleep(wait).await,
                Err(wait) => {
                    telemetry::denied("rate");
                    return Err(self.too_often(wait));
                }
            }
        }
    }

    /// Waits until the key is withdrawn, or is not for what was asked any more, and returns which.
    /// For ever where there is none.
    pub async fn withdrawn(&self) -> Problem {
        let Some((ring, digest)) = &self.key else {
            return std::future::pending().await;
        };
        let mut changed = ring.0.changed.subscribe();
        loop {
            // A change after this is seen by the wait.
            changed.borrow_and_update();
            if let Err(problem) = self.stands(ring.find(*digest)) {
                telemetry::denied(word(problem.reason));
                return problem;
            }
            if changed.changed().await.is_err() {
                std::future::pending::<()>().await;
            }
        }
    }

    /// Refuses where the key now says something else than when the request was let in.
    fn stands(&self, key: Option<Key>) -> Result<(), Problem> {
        let key = key.filter(|key| key.name() == self.principal().name());
        let key =
            key.ok_or_else(|| unauthenticated("the key was withdrawn before this was over"))?;
        self.wanted.authorize(key.principal())?;
        self.asker
            .environment()
            .map_or(Ok(()), |environment| key.principal().admit_to(environment))
    }

    fn taken(&self) -> Result<(), Duration> {
        let key = self
            .key
            .as_ref()
            .and_then(|(ring, digest)| ring.find(*digest));
        key.map_or(Ok(()), |key| key.take())
    }

    fn too_often(&self, wait: Duration) -> Problem {
        let who = self
            .principal()
            .name()
            .map(|name| format!(" `{name}`"))
            .unwrap_or_default();

        // Told in whole seconds, and never too early.
        let wait = Duration::from_secs(wait.as_secs() + 1);
        let message = format!(
            "key{who} asks more often than its rate; ask again in {} s",
            wait.as_secs()
        );
        Problem::new(ErrorKind::Quota, "RATE_EXCEEDED", message).retry_after(wait)
    }
}
