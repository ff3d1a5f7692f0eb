//! What the process takes of its machine, under the names that every dashboard knows. Where the
//! system does not tell, a figure is absent.

use std::sync::LazyLock;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use rustix::process::{Resource, getrlimit};
use rustix::time::{ClockId, clock_gettime};

use super::list::{
    PROCESS_CPU, PROCESS_FILES, PROCESS_MOST_FILES, PROCESS_RESIDENT, PROCESS_START,
    PROCESS_THREADS, PROCESS_VIRTUAL, UPTIME,
};
use super::metric::Page;

/// When the service began.
static BEGAN: LazyLock<(SystemTime, Instant)> =
    LazyLock::new(|| (SystemTime::now(), Instant::now()));

/// Starts the clock.
pub(super) fn begin() {
    LazyLock::force(&BEGAN);
}

/// Tells what the process takes.
pub(super) fn tell(page: &mut Page) {
    let (at, since) = *BEGAN;
    page.tell(&UPTIME, &[], since.elapsed().as_secs_f64());
    page.tell(&PROCESS_START, &[], seconds(at));
    let used = clock_gettime(ClockId::ProcessCPUTime);
    page.tell(
        &PROCESS_CPU,
        &[],
        used.tv_sec as f64 + used.tv_nsec as f64 / 1e9,
    );
    if let Some(most) = getrlimit(Resource::Nofile).current {
        page.tell(&PROCESS_MOST_FILES, &[], most as f64);
    }
    if let Ok(files) = std::fs::read_dir("/proc/self/fd") {
        // One of them reads this list.
        page.tell(&PROCESS_FILES, &[], files.count().saturating_sub(1) as f64);
    }

    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let told = |name: &str| {
        status.lines().find_map(|line| {
            line.strip_prefix(name)?
                .split_whitespace()
                .next()?
                .parse()
                .ok()
        })
    };
    let kibibytes = |name| told(name).map(|number: f64| number * 1_024.0);
    let figures = [
        (&PROCESS_RESIDENT, kibibytes("VmRSS:")),
        (&PROCESS_VIRTUAL, kibibytes("VmSize:")),
        (&PROCESS_THREADS, told("Threads:")),
    ];
    for (metric, number) in figures {
        if let Some(number) = number {
            page.tell(metric, &[], number);
        }
    }
}

/// Returns a moment in seconds since 1970, as Prometheus wants it.
pub(super) fn seconds(at: SystemTime) -> f64 {
    at.duration_since(UNIX_EPOCH)
        .map_or(0.0, |since| since.as_secs_f64())
}
