//! Scheduling priorities of threads, for work that must not delay those who serve and commit. Where
//! the system does not know how, a thread stays as it is.

/// Nice 9: about an eighth of what the others get where all are busy.
const LOWER: i32 = 9;
/// Nice 19: next to nothing.
const LOWEST: i32 = 19;

/// Lowers the priority of this thread below that of those which serve connections and commit.
pub(super) fn lower() {
    renice(LOWER);
}

/// Lets every other thread go before this one.
pub fn lower_to_least() {
    renice(LOWEST);
}

/// On Linux priorities are those of threads, and no process means the calling one.
fn renice(nice: i32) {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::setpriority_process(None, nice);
    #[cfg(not(target_os = "linux"))]
    let _ = nice;
}
