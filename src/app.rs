//! The state of the application, without its socket: one handle of each room, opened and closed in
//! one place.

mod chores;

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use self::chores::{Chore, Chores};
use crate::domain::{Asker, Environment};
use crate::environments::Environments;
use crate::influence::Influence;
use crate::ingest::Ingest;
use crate::model::Networks;
use crate::priors::PriorRegistry;
use crate::store::{Audit, Store, StoreError};
use crate::work::Work;

/// How often it is looked whether counts have grown enough: for priors to be fitted and for
/// networks to be trained again. Never where it is zero.
#[derive(Debug, Clone, Copy, Default)]
pub struct Upkeep {
    /// For priors.
    pub fit_every: Duration,
    /// For networks.
    pub train_every: Duration,
}

/// How old a write may be that proves to an idle service that the next would succeed. Each proof
/// writes one page.
const PROOF: Duration = Duration::from_secs(3);

/// The same where somebody asks whether the service is ready, and how long such a caller waits for
/// a disk that does not answer.
const PROOF_ASKED_FOR: Duration = Duration::from_millis(500);
const PROOF_TAKES: Duration = Duration::from_secs(1);

/// How long a training may take to notice that it is to end.
const TRAINING: Duration = Duration::from_millis(500);

/// One handle of each room. Cloning is cheap: every layer around every request does.
#[derive(Clone)]
pub struct App(Arc<Handles>);

/// The rooms as they are for whoever asks.
pub struct Handles {
    /// Which worlds there are.
    pub environments: Environments,
    /// How transitions become counts.
    pub ingest: Ingest,
    rooms: Arc<Rooms>,
}

/// The rooms that are the same for all who ask.
pub struct Rooms {
    /// What was counted.
    pub store: Arc<dyn Store>,
    /// The priors that answers stand on.
    pub fits: PriorRegistry,
    /// What to expect where little was counted.
    pub networks: Networks,
    /// The question itself.
    pub influence: Influence,
    /// Where everything that computes for long has its place.
    pub work: Work,
    /// Cancelled when the service begins to stop: not ready, streams end, nothing new begins.
    pub draining: CancellationToken,
    background: TaskTracker,
    chores: Chores,
}

impl std::ops::Deref for App {
    type Target = Handles;

    fn deref(&self) -> &Handles {
        &self.0
    }
}

impl std::ops::Deref for Handles {
    type Target = Rooms;

    fn deref(&self) -> &Rooms {
        &self.rooms
    }
}

impl App {
    /// Opens the rooms on a store, and begins what goes on behind them: to remove what deleted
    /// environments have left, to compare totals with cells and to look at what is kept beside
    /// them. All of it stops by the caller's token.
    pub fn open(draining: CancellationToken, store: Arc<dyn Store>, upkeep: Upkeep) -> Self {
        let work = Work::new(draining.clone());
        let ingest = Ingest::start(store.clone());
        let fits = PriorRegistry::made_in(work.fits.clone(), store.clone());
        let networks = Networks::new(store.clone(), fits.clone());

        let environments = Environments::new(store.clone(), ingest.clone(), networks.clone());
        let rooms = Rooms {
            influence: Influence::new(store.clone(), fits.clone(), networks.clone(), work.clone()),
            fits: fits.clone(),
            networks,
            store,
            work,
            draining,
            background: TaskTracker::new(),
            chores: Chores::default(),
        };
        let app = Self(Arc::new(Handles {
            environments,
            ingest,
            rooms: Arc::new(rooms),
        }));

        app.in_background(app.environments.clone().sweep());
        app.in_background(app.environments.clone().compact());
        app.in_background(prove(app.store.clone()));
        app.in_background(look_again(app.store.clone()));
        app.in_background(look_at_cells(app.store.clone(), app.chores.clone()));
        // Begun here, not in its task: whoever asks at once is told of it.
        let looking = app.chores.begin("looking at fits and networks");
        app.in_background(tell_unreadable(fits.clone(), app.networks.clone(), looking));

        if !upkeep.fit_every.is_zero() {
            app.in_background(fits.keep_up(upkeep.fit_every));
        }
        if !upkeep.train_every.is_zero() {
            app.in_background(app.networks.clone().keep_up(upkeep.train_every));
        }
        app
    }

    /// Returns the rooms as they are for whoever asks. Every request comes through here to an
    /// environment, and is looked at again where it finds one: who sends a body slowly may have had
    /// a key when it began.
    pub fn asked_by(&self, asker: &Asker) -> Self {
        Self(Arc::new(Handles {
            environments: self.environments.asked_by(asker.clone()),
            ingest: self.ingest.asked_by(asker.first().clone()),
            rooms: self.rooms.clone(),
        }))
    }

    fn in_background(&self, work: impl Future<Output = ()> + Send + 'static) {
        self.background
            .spawn(unless_stopped(self.draining.clone(), work));
    }

    /// Tells what goes on behind the answers: "removing 1 environment, 120,000 states left", or
    /// "idle".
    pub fn in_the_background(&self) -> String {
        self.chores.describe(self.environments.leftovers())
    }

    /// Lets readiness rest on a write of this moment, so that nobody is told what was so some
    /// seconds ago.
    pub async fn prove(&self) {
        if self.draining.is_cancelled() {
            return;
        }

        // In a task of its own, as in the background: the caller may leave.
        let store = self.store.clone();
        let proving = self
            .background
            .spawn(async move { store.prove(PROOF_ASKED_FOR).await });
        let _ = tokio::time::timeout(PROOF_TAKES, proving).await;
    }

    /// Stops the rooms: commits and answers what is queued, then closes the store.
    pub async fn close(&self) {
        self.draining.cancel();
        self.networks.end();
        self.background.close();
        self.background.wait().await;
        self.ingest.close().await;

        // Last, for a training looks only now and then whether it is to end, and what was sent must
        // not wait for it.
        if tokio::time::timeout(TRAINING, self.networks.close())
            .await
            .is_err()
        {
            tracing::warn!(
                "a training is left behind: it did not end in time, and what it learned is not kept"
            );
        }

        self.store.close().await;
    }
}

/// Does work until the service stops. The token's own method would look at the work first, which
/// fails of the same stop and would say so in the log.
async fn unless_stopped(draining: CancellationToken, work: impl Future<Output = ()>) {
    tokio::select! {
        biased;
        () = draining.cancelled() => {}
        () = work => {}
    }
}

/// Says at the start which fits and networks this build cannot read. The store has told of
/// environments when it was opened.
async fn tell_unreadable(fits: PriorRegistry, networks: Networks, _looking: Chore) {
    fits.tell_unreadable().await;
    networks.tell_unreadable().await;
}

/// Lets readiness rest on a write that reached the disk within a few seconds. What becomes of each,
/// the store tells.
async fn prove(store: Arc<dyn Store>) {
    loop {
        // In a task of its own: dropped half-way at the end of the service, it would take the
        // writing connection along, and with it the last checkpoint.
        let proving = store.clone();
        let _ = tokio::spawn(async move { proving.prove(PROOF).await }).await;
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}

/// Looks again at what seemed damaged, for ever: a disk that fails to read for a moment seals nothing
/// for good. What becomes of each, the store tells.
async fn look_again(store: Arc<dyn Store>) {
    loop {
        store.look_again().await;
    }
}

/// Reads all cells once: whether they are sound, and then what every answer needs of all of them,
/// so that nobody waits for it.
async fn look_at_cells(store: Arc<dyn Store>, chores: Chores) {
    let comparing = chores.begin("comparing totals with cells");
    audit(&*store).await;
    drop(comparing);

    let _adding = chores.begin("adding up how often actions were taken");
    let damaged = store.read_only();
    let is_sound =
        |environment: &Arc<Environment>| damaged.iter().all(|(name, _)| *name != environment.name);
    for environment in store.environments().into_iter().filter(is_sound) {
        // Whoever asks about it is told of what is wrong with it.
        let _ = store.actions(&environment).await;
    }
}

async fn audit(store: &dyn Store) {
    let started = Instant::now();
    tracing::info!("comparing totals with cells, in the background");
    match store.audit().await {
        Ok(audits) if audits.iter().all(Audit::is_sound) => {
            let duration_ms = started.elapsed().as_millis() as u64;
            tracing::info!(
                environments = audits.len(),
                duration_ms,
                "totals match the cells"
            )
        }
        // The store has told which environments are read-only now.
        Ok(_) => {}
        Err(error @ StoreError::Unreadable(_)) => {
            tracing::error!(%error, "totals could not be compared with the cells")
        }
        Err(error) => tracing::warn!(%error, "totals were not compared with the cells"),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    #[tokio::test]
    async fn what_a_stop_ends_is_not_asked_what_it_says() {
        let (draining, goes_on) = (CancellationToken::new(), AtomicBool::new(false));
        let work = async {
            draining.cancelled().await;
            goes_on.store(true, Ordering::Relaxed);
        };
        let stopping = async {
            tokio::task::yield_now().await;
            draining.cancel();
        };
        tokio::join!(unless_stopped(draining.clone(), work), stopping);
        assert!(!goes_on.load(Ordering::Relaxed));
    }
}
