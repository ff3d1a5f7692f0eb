//! Logs, and the one list of metrics: `nudge_<noun>_<unit>[_total]` in base units. Labels are bounded: never a state, an agent or a producer.

use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use metrics::{Unit, counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram};

use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use tracing_subscriber::EnvFilter;

const ACCEPTED: &str = "nudge_transitions_accepted_total";
const REJECTED: &str = "nudge_transitions_rejected_total";
const DUPLICATES: &str = "nudge_batches_duplicate_total";
const UNVERIFIED: &str = "nudge_batches_unverified_total";
const REFUSED: &str = "nudge_batches_refused_total";
const COMMIT_SECONDS: &str = "nudge_commit_duration_seconds";
const COMMIT_TRANSITIONS: &str = "nudge_commit_transitions";
const WORKING: &str = "nudge_work_turns";
const QUEUED: &str = "nudge_queue_transitions";
const CONNECTIONS: &str = "nudge_connections";
const CONNECTIONS_ENDED: &str = "nudge_connections_ended_total";
const STREAMS: &str = "nudge_streams";
const STATES: &str = "nudge_states";
const CELLS: &str = "nudge_cells";
const DATABASE: &str = "nudge_database_bytes";
const QUERY_SECONDS: &str = "nudge_query_duration_seconds";
const INFERENCE_SECONDS: &str = "nudge_inference_duration_seconds";
const INFERENCES: &str = "nudge_inferences_total";
const INFERRED_STATES: &str = "nudge_inference_states_total";
const VERDICTS: &str = "nudge_verdicts_total";
const REQUESTS: &str = "nudge_requests_total";
const REQUEST_SECONDS: &str = "nudge_request_duration_seconds";
const TRAINING_SECONDS: &str = "nudge_training_duration_seconds";
const READY: &str = "nudge_ready";
const READ_ONLY: &str = "nudge_environments_read_only";
const BUILD: &str = "nudge_build_info";

/// The upper bounds of the buckets of every histogram of seconds.
const SECONDS: [f64; 12] = [0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.5, 2.5];

/// The upper bounds of the buckets of the histogram of commit sizes.
const SIZES: [f64; 7] = [1.0, 10.0, 100.0, 1_000.0, 10_000.0, 100_000.0, 256_000.0];

/// Gives every metric its help text and unit.
fn describe() {
    describe_counter!(ACCEPTED, "Transitions (records) counted, by environment");
    describe_counter!(REJECTED, "Transitions (records) rejected one by one, by environment and reason");
    describe_counter!(DUPLICATES, "Batches acknowledged again without being counted again, by environment");
    describe_counter!(
        UNVERIFIED,
        "Batches under numbers used so long ago that nobody can tell whether they were counted, by environment"
    );
    describe_counter!(REFUSED, "Batches refused as a whole, by reason");
    describe_histogram!(COMMIT_SECONDS, Unit::Seconds, "Time from the begin of a commit to its acknowledgement");
    describe_histogram!(COMMIT_TRANSITIONS, "Transitions per commit");
    describe_gauge!(QUEUED, "Transitions that wait for their commit");
    describe_gauge!(WORKING, "What computes or waits for its turn, by lane: questions, passes over all states, fits");
    describe_gauge!(CONNECTIONS, "Open connections");
    describe_counter!(CONNECTIONS_ENDED, "Connections ended by the service before it stops, by reason");
    describe_gauge!(STREAMS, "Open ingest streams");
    describe_gauge!(STATES, "Distinct states, by environment");
    describe_gauge!(CELLS, "Cells (state, segment, joint action), by environment");
    describe_gauge!(DATABASE, Unit::Bytes, "Size of the database on disk, journal included");
    describe_histogram!(
        QUERY_SECONDS,
        Unit::Seconds,
        "Time to answer a question about influence, without its transport"
    );
    describe_histogram!(INFERENCE_SECONDS, Unit::Seconds, "Time to predict for a request, without its transport");
    describe_counter!(INFERENCES, "Requests for predictions, by code: OK, or the reason of the refusal");
    describe_counter!(INFERRED_STATES, "States that networks predicted for on request");
    describe_counter!(VERDICTS, "Verdicts given, by basis");
    describe_counter!(REQUESTS, "Requests, by face, route or method, and code");
    describe_histogram!(REQUEST_SECONDS, Unit::Seconds, "Time to answer a request, by face and route or method");
    describe_histogram!(TRAINING_SECONDS, Unit::Seconds, "Time from the begin of a training to its end, by outcome");
    describe_gauge!(READY, "1 where the service is ready by this check of /readyz, else 0");
    describe_gauge!(READ_ONLY, "Environments that take no batches because they are damaged");
    describe_gauge!(BUILD, "1, with the version and the source revision as labels");
    gauge!(BUILD, "version" => env!("CARGO_PKG_VERSION"), "revision" => option_env!("NUDGE_REVISION").unwrap_or("unknown")).set(1.0);
}

/// Records a commit of so many transitions.
pub fn committed(took: Duration, transitions: usize) {
    histogram!(COMMIT_SECONDS).record(took.as_secs_f64());
    histogram!(COMMIT_TRANSITIONS).record(transitions as f64);
}

/// Records records that were counted.
pub fn accepted(environment: &str, records: u64) {
    counter!(ACCEPTED, "environment" => environment.to_owned()).increment(records);
}

/// Records records that were rejected for the same reason, one of few words.
pub fn rejected(environment: &str, reason: &'static str, records: u64) {
    counter!(REJECTED, "environment" => environment.to_owned(), "reason" => reason).increment(records);
}

/// Records a batch that had been counted before.
pub fn duplicate(environment: &str) {
    counter!(DUPLICATES, "environment" => environment.to_owned()).increment(1);
}

/// Records a batch under a number that was used so long ago that nobody can tell whether it was counted.
pub fn unverified(environment: &str) {
    counter!(UNVERIFIED, "environment" => environment.to_owned()).increment(1);
}

/// Records a batch that was refused as a whole.
pub fn refused(reason: &'static str) {
    counter!(REFUSED, "reason" => reason).increment(1);
}

/// Records how many transitions wait.
pub fn queued(transitions: usize) {
    gauge!(QUEUED).set(transitions as f64);
}

/// Records how many turns of a lane are taken or waited for.
pub fn working(lane: &'static str, turns: usize) {
    gauge!(WORKING, "lane" => lane).set(turns as f64);
}

/// Records how many connections are open.
pub fn connections(open: usize) {
    gauge!(CONNECTIONS).set(open as f64);
}

/// Records that the service ended a connection, or did not let it in, by reason.
pub fn connection_ended(reason: &'static str) {
    counter!(CONNECTIONS_ENDED, "reason" => reason).increment(1);
}

/// Records that a stream opened; the guard records that it ended.
pub fn stream_opened() -> impl Drop {
    struct Open;
    impl Drop for Open {
        fn drop(&mut self) {
            gauge!(STREAMS).decrement(1.0);
        }
    }
    gauge!(STREAMS).increment(1.0);
    Open
}

/// Records how much an environment holds.
pub fn holds(environment: &str, states: u64, cells: u64) {
    gauge!(STATES, "environment" => environment.to_owned()).set(states as f64);
    gauge!(CELLS, "environment" => environment.to_owned()).set(cells as f64);
}

/// Records the size of the database.
pub fn database(bytes: u64) {
    gauge!(DATABASE).set(bytes as f64);
}

/// Records a question that was answered, with how many of its verdicts rest on counts, on a network and on the prior.
pub fn answered(took: Duration, verdicts: [u64; 3]) {
    histogram!(QUERY_SECONDS).record(took.as_secs_f64());
    for (basis, verdicts) in ["counts", "model", "prior"].into_iter().zip(verdicts) {
        if verdicts > 0 {
            counter!(VERDICTS, "basis" => basis).increment(verdicts);
        }
    }
}

/// Records a training that is over, by its outcome.
pub fn trained(outcome: &'static str, took: Duration) {
    histogram!(TRAINING_SECONDS, "outcome" => outcome).record(took.as_secs_f64());
}

/// Records a request for predictions: `OK` or why it was refused, one of few words, and for how many states.
pub fn inferred(took: Duration, code: &'static str, states: u64) {
    histogram!(INFERENCE_SECONDS).record(took.as_secs_f64());
    counter!(INFERENCES, "code" => code).increment(1);
    counter!(INFERRED_STATES).increment(states);
}

/// Records a request.
pub fn request(face: &'static str, route: String, code: String, took: Duration) {
    histogram!(REQUEST_SECONDS, "face" => face, "route" => route.clone()).record(took.as_secs_f64());
    counter!(REQUESTS, "face" => face, "route" => route, "code" => code).increment(1);
}

/// Records whether the service is ready by a check.
pub fn ready(check: &'static str, is_ready: bool) {
    gauge!(READY, "check" => check).set(if is_ready { 1.0 } else { 0.0 });
}

/// Records how many environments take no batches because they are damaged.
pub fn read_only(environments: usize) {
    gauge!(READ_ONLY).set(environments as f64);
}

/// Returns every metric in Prometheus' text format. Installs the recorder of this process at its first use.
pub fn render() -> String {
    let recorder = recorder();
    recorder.run_upkeep();
    recorder.render()
}

/// Installs the recorder of this process, once: metrics recorded earlier are lost.
pub fn recorder() -> &'static PrometheusHandle {
    static RECORDER: OnceLock<PrometheusHandle> = OnceLock::new();
    RECORDER.get_or_init(|| {
        let builder = PrometheusBuilder::new()
            .set_buckets(&SECONDS)
            .and_then(|builder| builder.set_buckets_for_metric(Matcher::Full(COMMIT_TRANSITIONS.into()), &SIZES))
            .expect("the lists of buckets are not empty");
        let handle = builder.install_recorder().expect("nothing else in this process installs a recorder");
        describe();
        handle
    })
}

/// Lets the first of many lines that say the same into the log, and then one in a while.
pub struct Seldom {
    every: Duration,
    /// When one was last let in, and how many were left out since.
    state: Mutex<(Option<Instant>, u64)>,
}

impl Seldom {
    /// Lets one in at most that often.
    pub const fn every(every: Duration) -> Self {
        Self { every, state: Mutex::new((None, 0)) }
    }

    /// Returns how many were left out before this line, or `None` where it is to be left out itself.
    pub fn admits(&self, now: Instant) -> Option<u64> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let (last, left_out) = &mut *state;
        if last.is_some_and(|last| now.duration_since(last) < self.every) {
            *left_out += 1;
            return None;
        }
        *last = Some(now);
        Some(std::mem::take(left_out))
    }
}

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogFormat {
    /// For people on a terminal.
    Human,
    /// One JSON object a line.
    Json,
}

/// Sends logs to standard error; `RUST_LOG` says which, by default what an operator should know.
pub fn log(format: LogFormat) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false);
    // A second call finds the first one's subscriber, which stays.
    let _ = match format {
        LogFormat::Human => lines.with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr())).try_init(),
        LogFormat::Json => lines.json().flatten_event(true).try_init(),
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_is_let_in_and_then_one_in_a_while() {
        let (seldom, start) = (Seldom::every(Duration::from_secs(5)), Instant::now());
        let at = |millis| seldom.admits(start + Duration::from_millis(millis));
        assert_eq!([0, 1, 4_999, 5_000, 5_001, 60_000].map(at), [Some(0), None, None, Some(2), None, Some(1)]);
    }
}
