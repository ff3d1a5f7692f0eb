//! Idle scheduling priority, for work that nobody who asks or sends meanwhile must notice.

use crate::work::priority::lower_to_least;

/// Does work at idle priority on one thread, whatever libraries would share among more, and only
/// while nobody else wants the core: those who ask and send meanwhile must not notice.
pub fn at_idle_priority<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .start_handler(|_| lower_to_least())
        .build()
    {
        Ok(pool) => pool.install(work),
        // No thread more can be had: this one will do.
        Err(_) => work(),
    }
}
