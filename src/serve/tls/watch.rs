//! Certificates that are renewed while the service runs: the files are read every second, and at
//! SIGHUP.
//!
//! Contents are compared, not times of change: Kubernetes swaps a symbolic link, and others write
//! in place. A pair that does not fit, as it is between two writes, is told and changes nothing;
//! the next change is tried again.

use std::sync::Arc;
use std::time::Duration;

use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::time::{MissedTickBehavior, interval};

use super::files::{Certified, Contents};
use super::{Current, Tls};
use crate::telemetry;
use crate::tls::TlsError;

/// How often the files are looked at.
const EVERY: Duration = Duration::from_secs(1);

impl Tls {
    /// Takes over what the files hold whenever it changes, for as long as it is polled.
    pub async fn keep_up(&self) {
        let mut ticks = interval(EVERY);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut hangups = signal(SignalKind::hangup()).ok();
        // The contents that were seen last, or why there were none.
        let mut seen = Ok(self.first);
        loop {
            let is_asked = tokio::select! {
                _ = ticks.tick() => false,
                () = hung_up(&mut hangups) => true,
            };
            let files = self.files.clone();
            let reading = tokio::task::spawn_blocking(move || Contents::read_files(&files));
            // It does not panic, and nothing cancels it.
            let Ok(contents) = reading.await else {
                continue;
            };
            let now = contents
                .as_ref()
                .map(Contents::digest)
                .map_err(Clone::clone);
            if is_asked || now != seen {
                self.reload(contents.and_then(|contents| contents.certified()));
                seen = now;
            }
        }
    }

    fn reload(&self, certified: Result<Certified, TlsError>) {
        match certified {
            Ok(certified) => {
                certified.tell();
                self.use_from_now_on(Current::of_certified(certified));
                telemetry::certificate_reloaded(true);
                tracing::info!(
                    "the certificate was read again, and is used from the next connection on"
                );
            }
            Err(error) => {
                telemetry::certificate_reloaded(false);
                tracing::warn!(%error, "the certificate was not read again: the one before stays in use");
            }
        }
    }
}

impl Tls {
    /// Uses this for the next handshake. Who was let in by other authorities is asked to leave; by
    /// the same, stays.
    fn use_from_now_on(&self, mut next: Current) {
        let before = self.current.load_full();
        if before.authorities == next.authorities {
            next.outdated = before.outdated.clone();
            self.current.store(Arc::new(next));
            return;
        }

        // First the new ones: whoever leaves comes again at once.
        self.current.store(Arc::new(next));
        before.outdated.cancel();
        tracing::info!(
            "the authorities of clients have changed: connections that are open are asked to leave"
        );
    }
}

async fn hung_up(hangups: &mut Option<Signal>) {
    match hangups {
        Some(signal) => drop(signal.recv().await),
        None => std::future::pending().await,
    }
}
