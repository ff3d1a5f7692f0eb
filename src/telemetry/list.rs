//! The one list of metrics. `docs/metrics.md` is made of it.

use super::metric::Metric;

/// What an answer takes, in seconds: from a look at the cache to the longest that a call is
/// allowed.
const ANSWERS: &[f64] = &[
    0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5,
    5.0, 10.0, 30.0, 120.0,
];

/// What a training takes, in seconds: from a toy to a night.
const NIGHT: &[f64] = &[
    1.0, 5.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1_800.0, 3_600.0, 14_400.0,
];

/// The transitions of a commit.
const SIZES: &[f64] = &[1.0, 10.0, 100.0, 1_000.0, 10_000.0, 100_000.0, 128_000.0];

macro_rules! metrics {
    ($($(#[doc = $help:literal])+ $name:ident: $kind:ident($($argument:expr),+);)+) => {
        $($(#[doc = $help])+
        pub static $name: Metric = Metric::$kind($($argument),+, concat!($($help),+).trim_ascii());)+

        /// Every metric, in the order in which they are told.
        pub static ALL: &[&Metric] = &[$(&$name),+];
    };
}

metrics! {
    /// 1, with the version and the source revision as labels
    BUILD: gauge("nudge_build_info", &["version", "revision"]);
    /// Seconds since the service began
    UPTIME: gauge("nudge_uptime_seconds", &[]);
    /// 1 where the service is ready by this check of /readyz, else 0
    READY: gauge("nudge_ready", &["check"]);

    /// Requests that ended, by face, route or method, and the code that the caller saw: an HTTP
    /// status, or a gRPC code; 499 or CANCELLED where it left first. What is on no list is `other`
    REQUESTS: counter("nudge_requests_total", &["face", "route", "code"]);
    /// Time from a request to the end of its answer, by face and route or method; streams, which
    /// end when their client likes, are not in it
    REQUEST_SECONDS: histogram("nudge_request_duration_seconds", ANSWERS, &["face", "route"]);
    /// Requests refused before anybody looked at them, by reason: connections or the memory of
    /// unfinished messages were used up
    SHED: counter("nudge_requests_shed_total", &["reason"]);
    /// Requests refused because of who asks, by reason: `unauthenticated` (no key, or none that is
    /// let in), `scope`, `environment` or `producer` (not of this key), `host`, `origin` or `media`
    /// (what a browser could be made to send), `rate`
    DENIED: counter("nudge_requests_denied_total", &["reason"]);
    /// Open connections
    CONNECTIONS: gauge("nudge_connections", &[]);
    /// Connections ended by the service before it stops, by reason; `malformed`, `head_too_large`
    /// and `http2` for what is no request
    CONNECTIONS_ENDED: counter("nudge_connections_ended_total", &["reason"]);
    /// TLS handshakes that failed, by reason: `plain_text` where the client spoke none, `closed`
    /// where it left first
    HANDSHAKES_FAILED: counter("nudge_tls_handshakes_failed_total", &["reason"]);
    /// Until when the certificate is valid, in seconds since 1970; absent without TLS
    CERTIFICATE_EXPIRES: gauge("nudge_tls_certificate_expires_timestamp_seconds", &[]);
    /// Times that the files of TLS changed, by outcome: `failed` where they could not be used and
    /// those before stay
    CERTIFICATE_RELOADS: counter("nudge_tls_reloads_total", &["outcome"]);
    /// Open ingest streams
    STREAMS: gauge("nudge_streams", &[]);

    /// Transitions (records) counted, by environment
    ACCEPTED: counter("nudge_transitions_accepted_total", &["environment"]);
    /// Transitions (records) rejected one by one, by environment and the part at fault
    REJECTED: counter("nudge_transitions_rejected_total", &["environment", "reason"]);
    /// Batches acknowledged again without being counted again, by environment
    DUPLICATES: counter("nudge_batches_duplicate_total", &["environment"]);
    /// Batches under numbers used so long ago that nobody can tell whether they were counted, by
    /// environment
    UNVERIFIED: counter("nudge_batches_unverified_total", &["environment"]);
    /// When a batch of the environment was last acknowledged, in seconds since 1970; absent before
    /// the first since the start
    LAST_BATCH: gauge("nudge_last_batch_timestamp_seconds", &["environment"]);
    /// Batches refused as a whole, by reason
    REFUSED: counter("nudge_batches_refused_total", &["reason"]);
    /// Commits, by outcome: `committed` or `failed`
    COMMITS: counter("nudge_commits_total", &["outcome"]);
    /// Time from the begin of a commit to its end, failed ones included
    COMMIT_SECONDS: histogram("nudge_commit_duration_seconds", ANSWERS, &[]);
    /// Transitions per commit
    COMMIT_TRANSITIONS: histogram("nudge_commit_transitions", SIZES, &[]);
    /// Transitions that wait for their commit
    QUEUED: gauge("nudge_queue_transitions", &[]);

    /// Transitions that are kept, counts of records included, by environment
    KEPT: gauge("nudge_transitions", &["environment"]);
    /// Distinct states, by environment; a little behind while very much is counted
    STATES: gauge("nudge_states", &["environment"]);
    /// Cells (state, segment, joint action; and value, of each outcome), by environment; a little
    /// behind while very much is counted
    CELLS: gauge("nudge_cells", &["environment"]);
    /// What is used of a quota, from 0 to 1, by environment; that of `environments` is of the whole
    /// service
    QUOTA: gauge("nudge_quota_used_ratio", &["environment", "quota"]);
    /// Environments
    ENVIRONMENTS: gauge("nudge_environments", &[]);
    /// Environments that take no batches because they are damaged
    READ_ONLY: gauge("nudge_environments_read_only", &[]);
    /// Size of the database on disk, journal included
    DATABASE: gauge("nudge_database_bytes", &[]);
    /// What is free on the disk of the database
    DISK_FREE: gauge("nudge_disk_free_bytes", &[]);
    /// The size of the disk of the database
    DISK: gauge("nudge_disk_bytes", &[]);
    /// States whose counts were asked for, by outcome: `hit` where they were in memory, else `miss`
    CACHE: counter("nudge_cache_states_total", &["outcome"]);

    /// Time to answer a question about influence, without its transport
    QUERY_SECONDS: histogram("nudge_query_duration_seconds", ANSWERS, &[]);
    /// Verdicts given, by verdict and basis
    VERDICTS: counter("nudge_verdicts_total", &["verdict", "basis"]);
    /// What computes or waits for its turn, by lane: questions, passes over all states, fits
    WORKING: gauge("nudge_work_turns", &["lane"]);
    /// What waits for its turn, by lane
    WAITING: gauge("nudge_work_waiting_turns", &["lane"]);
    /// Transitions counted since the oldest fit of the priors asked for within the last hour, by
    /// environment
    FIT_BEHIND: gauge("nudge_fit_behind_transitions", &["environment"]);
    /// Seconds since the oldest fit of the priors asked for within the last hour, by environment;
    /// absent where it was made before the start
    FIT_AGE: gauge("nudge_fit_age_seconds", &["environment"]);

    /// Versions of networks, by environment
    MODELS: gauge("nudge_models", &["environment"]);
    /// Pairs of agents with an active network, by environment
    MODELS_ACTIVE: gauge("nudge_models_active", &["environment"]);
    /// Trainings that are queued or running
    JOBS: gauge("nudge_training_jobs", &["state"]);
    /// Trainings that are over, by outcome
    TRAININGS: counter("nudge_trainings_total", &["outcome"]);
    /// Time from the begin of a training to its end, by outcome
    TRAINING_SECONDS: histogram("nudge_training_duration_seconds", NIGHT, &["outcome"]);
    /// Requests for predictions, by code: OK, or the reason of the refusal
    INFERENCES: counter("nudge_inferences_total", &["code"]);
    /// States that networks predicted for on request
    INFERRED_STATES: counter("nudge_inference_states_total", &[]);
    /// Time to predict for a request, without its transport
    INFERENCE_SECONDS: histogram("nudge_inference_duration_seconds", ANSWERS, &[]);

    /// Processor time of the process, in seconds
    PROCESS_CPU: counter("process_cpu_seconds_total", &[]);
    /// Memory of the process that is in RAM
    PROCESS_RESIDENT: gauge("process_resident_memory_bytes", &[]);
    /// Address space of the process
    PROCESS_VIRTUAL: gauge("process_virtual_memory_bytes", &[]);
    /// Threads of the process
    PROCESS_THREADS: gauge("process_threads", &[]);
    /// Open files of the process, sockets included
    PROCESS_FILES: gauge("process_open_fds", &[]);
    /// The most files that the process may open
    PROCESS_MOST_FILES: gauge("process_max_fds", &[]);
    /// When the process began, in seconds since 1970
    PROCESS_START: gauge("process_start_time_seconds", &[]);
}
