//! Bounded work: everything that computes for long has a place here, can be cancelled, and lets
//! those go first who send and ask for little.
//!
//! | room | for |
//! |---|---|
//! | `stop` | the cancellation token that loops look at |
//! | `gate` | admission control: a bounded number of workers and a bounded queue |
//! | `progress` | how far something is, in words |
//! | `jobs` | shared results: made once for all who ask, with progress, whoever leaves |
//! | `deadline` | until when a caller waits |
//! | `aside` | what is too long for a thread that serves connections, and too short to queue for |
//!
//! Absent on purpose: nothing here knows what is computed.

mod aside;
pub mod deadline;
mod gate;
mod jobs;
pub mod priority;
mod progress;
mod stop;

use tokio_util::sync::CancellationToken;

pub use aside::{aside, beside};
pub use gate::{Gate, STOPPING, Turn};
pub use jobs::Jobs;
pub use progress::Progress;
pub use stop::{Stop, Stopped};

/// Questions that may wait for a worker. What they hold meanwhile is no more than themselves.
const MOST_WAITING: usize = 128;

/// The lanes of everything that computes for long: none of them makes another wait. Cloning is
/// cheap.
#[derive(Clone)]
pub struct Work {
    /// Questions that somebody waits for.
    pub questions: Gate,
    /// Passes over all states, a piece at a time.
    pub passes: Gate,
    /// Fits, one at a time.
    pub fits: Gate,
    /// Cancelled when the service begins to stop.
    pub stopping: CancellationToken,
}

impl Work {
    /// Opens the lanes, until `stopping` is cancelled: that cancels what is in them.
    pub fn new(stopping: CancellationToken) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZeroUsize::get);
        Self {
            questions: Gate::new("question", cores, MOST_WAITING, stopping.clone()),
            // Two at least, so that a long piece of one pass does not hold up a short pass.
            passes: Gate::new("pass", cores.max(2), Gate::ENDLESS, stopping.clone()),
            fits: Gate::new("fit", 1, Gate::ENDLESS, stopping.clone()),
            stopping,
        }
    }
}
