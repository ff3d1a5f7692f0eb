//! The service without its socket: one handle of each room, opened and closed in one place.

use std::sync::Arc;
use std::time::Duration;

use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::environments::Environments;
use crate::influence::Influence;
use crate::ingest::Ingest;
use crate::model::Networks;
use crate::priors::Fits;
use crate::store::{Audit, Store, StoreError};

/// How often it is looked whether counts have grown enough: for priors to be fitted and for networks to be trained again. Never where it is zero.
#[derive(Debug, Clone, Copy, Default)]
pub struct Upkeep {
    /// For priors.
    pub fit_every: Duration,
    /// For networks.
    pub train_every: Duration,
}

/// One handle of each room. Cloning is cheap.
#[derive(Clone)]
pub struct App {
    /// What was counted.
    pub store: Arc<dyn Store>,
    /// Which worlds there are.
    pub environments: Environments,
    /// How transitions become counts.
    pub ingest: Ingest,
    /// What to expect where little was counted.
    pub networks: Networks,
    /// The question itself.
    pub influence: Influence,
    /// Cancelled when the service begins to stop: not ready, streams end, nothing new begins.
    pub draining: CancellationToken,
    background: TaskTracker,
}

impl App {
    /// Opens the rooms on a store, and begins to compare its totals with its cells and to look at what is kept beside them.
    pub fn open(store: Arc<dyn Store>, upkeep: Upkeep) -> Self {
        let ingest = Ingest::start(store.clone());
        let fits = Fits::new(store.clone());
        let networks = Networks::new(store.clone(), fits.clone());
        let app = Self {
            environments: Environments::new(store.clone(), ingest.clone()),
            influence: Influence::new(store.clone(), fits.clone(), networks.clone()),
            networks,
            ingest,
            store,
            draining: CancellationToken::new(),
            background: TaskTracker::new(),
        };
        app.in_background(prove(app.store.clone()));
        app.in_background(audit(app.store.clone()));
        app.in_background(tell_unreadable(fits.clone(), app.networks.clone()));
        if !upkeep.fit_every.is_zero() {
            app.in_background(fits.keep_up(upkeep.fit_every));
        }
        if !upkeep.train_every.is_zero() {
            app.in_background(app.networks.clone().keep_up(upkeep.train_every));
        }
        app
    }

    fn in_background(&self, work: impl Future<Output = ()> + Send + 'static) {
        self.background.spawn(self.draining.clone().run_until_cancelled_owned(work));
    }

    /// Stops the rooms: commits and answers what is queued, then closes the store.
    pub async fn close(&self) {
        self.draining.cancel();
        self.networks.end();
        self.background.close();
        self.background.wait().await;
        self.ingest.close().await;
        // Last, for a training looks only now and then whether it is to end, and what was sent must not wait for it.
        self.networks.close().await;
        self.store.close().await;
    }
}

/// Says at the start which fits and networks this build cannot read. The store has told of environments when it was opened.
async fn tell_unreadable(fits: Fits, networks: Networks) {
    fits.tell_unreadable().await;
    networks.tell_unreadable().await;
}

/// Lets readiness rest on a write that reached the disk within a few seconds. What becomes of each, the store tells.
async fn prove(store: Arc<dyn Store>) {
    loop {
        // In a task of its own: dropped half-way at the end of the service, it would take the writing connection along, and with it the last checkpoint.
        let proving = store.clone();
        let _ = tokio::spawn(async move { proving.prove().await }).await;
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}

async fn audit(store: Arc<dyn Store>) {
    match store.audit().await {
        Ok(audits) if audits.iter().all(Audit::is_sound) => tracing::debug!("totals match the cells"),
        // The store has told which environments are read-only now.
        Ok(_) => {}
        Err(error @ StoreError::Unreadable(_)) => {
            tracing::error!(%error, "totals could not be compared with the cells")
        }
        Err(error) => tracing::warn!(%error, "totals were not compared with the cells"),
    }
}
