//! Idle scheduling priority, for work that nobody who asks or sends meanwhile must notice.

/// Does work at idle priority on one thread, whatever libraries would share among more, and only
/// while nobody else wants the core: those who ask and send meanwhile must not notice.
pub fn at_idle_priority<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .start_handler(|_| step_back())
        .build()
    {
        Ok(pool) => pool.install(work),
        // No thread more can be had: this one will do.
        Err(_) => work(),
    }
}

/// Lets every other thread go first. Where the system does not know how, the work goes on as it is.
fn step_back() {
    #[cfg(target_os = "linux")]
    {
        use thread_priority::{
            NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, unix,
        };
        let idle = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
        let _ = unix::set_thread_priority_and_policy(
            unix::thread_native_id(),
            ThreadPriority::Min,
            idle,
        );
    }
}
