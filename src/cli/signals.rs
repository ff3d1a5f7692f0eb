//! The signals that ask a process to end: SIGINT and SIGTERM.

use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::Mutex;

use super::Failure;

/// SIGINT and SIGTERM.
pub(super) struct Signals(Mutex<[Signal; 2]>);

impl Signals {
    /// Takes the signals over from the operating system's default.
    pub(super) fn install() -> Result<Self, Failure> {
        let interrupt = take(SignalKind::interrupt())?;
        let terminate = take(SignalKind::terminate())?;
        Ok(Self(Mutex::new([interrupt, terminate])))
    }

    /// Waits for the next of them.
    pub(super) async fn next(&self) {
        let [interrupt, terminate] = &mut *self.0.lock().await;
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    }
}

/// Takes a signal over from the operating system's default.
pub(super) fn take(kind: SignalKind) -> Result<Signal, Failure> {
    signal(kind).map_err(Failure::usage)
}
