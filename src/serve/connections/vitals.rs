//! Timeouts of one connection, by its vital signs: what it does, since when, and from that when and
//! how it is to end.
//!
//! Looked at now and then by the task of the connection, so nothing is timed for each request.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use http::Version;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::limits::Limits;

/// How a connection of HTTP/2 begins.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// How long a connection that has nothing left to do may take to say goodbye.
const GOODBYE: Duration = Duration::from_secs(2);

/// One connection, as those see it who work for it.
pub struct Vitals {
    limits: Arc<Limits>,
    state: Mutex<State>,
    /// Cancelled when the connection is to finish what it began and end.
    pub leaving: CancellationToken,
    /// Cancelled when the connection is to end at once.
    pub over: CancellationToken,
}

struct State {
    /// When it was accepted, or when its last request ended.
    since: Instant,
    expires: Option<Instant>,
    /// Whether it began as HTTP/2 does, so that it can be told that it is to end.
    is_greeted: bool,
    /// The version of its requests; none before the first.
    version: Option<Version>,
    requests: usize,
    /// When the first byte of the next request arrived.
    head_since: Option<Instant>,
    leaving_since: Option<Instant>,
    /// Requests of whose answer a part was sent, and since when no more was asked for.
    unread_since: HashMap<u64, Instant>,
    numbered: u64,
}

/// What becomes of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It lives, and is to be looked at again then.
    Lives(Instant),
    /// It is to finish what it began, and end.
    Leaves(Cause),
    /// It ends at once.
    Ends(Cause),
}

/// The timeout or limit by which a connection is ended from this side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// The headers of a request did not arrive in time.
    Head,
    /// There was no request for a while.
    Idle,
    /// An answer was not read for a while.
    Unread,
    /// It was open for long enough.
    Age,
    /// It was asked to leave, and took too long.
    Grace,
}

impl Cause {
    /// Returns the word for logs and metrics.
    pub fn word(self) -> &'static str {
        match self {
            Self::Head => "head",
            Self::Idle => "idle",
            Self::Unread => "unread",
            Self::Age => "age",
            Self::Grace => "grace",
        }
    }
}

impl Vitals {
    /// Makes those of a connection that was accepted just now, and leaves at that age if there is
    /// one.
    pub fn new(
        limits: Arc<Limits>,
        age: Option<Duration>,
        leaving: CancellationToken,
        over: CancellationToken,
    ) -> Arc<Self> {
        let now = Instant::now();
        let state = State {
            since: now,
            expires: age.and_then(|age| now.checked_add(age)),
            is_greeted: false,
            version: None,
            requests: 0,
            head_since: None,
            leaving_since: None,
            unread_since: HashMap::new(),
            numbered: 0,
        };
        Arc::new(Self {
            limits,
            state: Mutex::new(state),
            leaving,
            over,
        })
    }

    /// Returns the limits that the connection lives by.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Notes that bytes arrived.
    pub fn heard(&self, bytes: &[u8]) {
        let mut state = self.lock();
        if state.version.is_none() && state.head_since.is_none() {
            state.is_greeted = bytes.starts_with(PREFACE);
        }
        if state.requests == 0 && state.head_since.is_none() {
            state.head_since = Some(Instant::now());
        }
    }

    /// Notes that a request begins; it ends when what is returned is dropped.
    pub fn begin(self: &Arc<Self>, version: Version) -> InProgress {
        let mut state = self.lock();
        state.version = Some(version);
        state.head_since = None;
        state.requests += 1;
        state.numbered += 1;
        InProgress {
            vitals: self.clone(),
            number: state.numbered,
        }
    }

    /// Notes that the connection was asked to leave.
    pub fn leaves(&self) {
        self.lock().leaving_since.get_or_insert_with(Instant::now);
    }

    /// Returns since when the connection waits for a request, if it does.
    pub fn waits_since(&self) -> Option<Instant> {
        let state = self.lock();
        (state.requests == 0 && !self.over.is_cancelled()).then_some(state.since)
    }

    /// Ends the connection at once, unless it has a request by now.
    pub fn evict(&self) -> bool {
        let state = self.lock();
        let evicted = state.requests == 0 && !self.over.is_cancelled();
        if evicted {
            self.over.cancel();
        }
        evicted
    }

    /// Tells what is to become of the connection.
    pub fn fate(&self, now: Instant) -> Fate {
        let state = self.lock();
        let ends = state.ends(&self.limits);
        if let Some((due, cause)) = ends
            && due <= now
        {
            return Fate::Ends(cause);
        }
        let leaves = state.leaves(&self.limits);
        if let Some((due, cause)) = leaves
            && due <= now
        {
            return Fate::Leaves(cause);
        }

        // What begins before the next look may be due before what is known now.
        let soon = now
            + self
                .limits
                .head
                .min(self.limits.idle)
                .min(self.limits.stalled)
                / 2;

        let due = [ends, leaves].into_iter().flatten().map(|(due, _)| due);
        let expires = state.expires.filter(|expires| *expires > now);
        Fate::Lives(due.chain(expires).fold(soon, Instant::min))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn ends(&self, limits: &Limits) -> Option<(Instant, Cause)> {
        let unread = self
            .unread_since
            .values()
            .min()
            .map(|since| (*since + limits.stalled, Cause::Unread));

        let head = match (self.requests, self.version) {
            (0, None) if !self.is_greeted => Some((self.since + limits.head, Cause::Head)),
            // Frames of HTTP/2 that belong to no request (pings, settings) are no beginning of one.
            (0, Some(version)) if version < Version::HTTP_2 => self
                .head_since
                .map(|since| (since + limits.head, Cause::Head)),
            _ => None,
        };

        let grace = self.leaving_since.map(|since| match self.requests {
            0 => (since.max(self.since) + GOODBYE, Cause::Grace),
            _ => (since + limits.grace, Cause::Grace),
        });

        [unread, head, grace]
            .into_iter()
            .flatten()
            .min_by_key(|(due, _)| *due)
    }

    fn leaves(&self, limits: &Limits) -> Option<(Instant, Cause)> {
        if self.leaving_since.is_some() {
            return None;
        }

        if self.version.is_none() {
            // A client that connects ahead of its first request hears of it and connects again.
            return self
                .is_greeted
                .then_some((self.since + limits.head, Cause::Head));
        }

        let idle = (self.requests == 0).then(|| (self.since + limits.idle, Cause::Idle));
        let age = self.expires.map(|expires| (expires, Cause::Age));

        [idle, age]
            .into_iter()
            .flatten()
            .min_by_key(|(due, _)| *due)
    }
}

/// A request, from its headers until its body was read or given up and its answer was handed over.
pub struct InProgress {
    vitals: Arc<Vitals>,
    number: u64,
}

impl InProgress {
    /// Returns the connection.
    pub fn vitals(&self) -> &Vitals {
        &self.vitals
    }

    /// Notes that a part of the answer was handed over, and more waits to be asked for.
    pub fn handed_over(&self) {
        self.vitals
            .lock()
            .unread_since
            .insert(self.number, Instant::now());
    }

    /// Notes that more of the answer was asked for, or that there is no more.
    pub fn asked(&self) {
        self.vitals.lock().unread_since.remove(&self.number);
    }
}

impl Drop for InProgress {
    fn drop(&mut self) {
        let mut state = self.vitals.lock();
        state.unread_since.remove(&self.number);
        state.requests -= 1;
        if state.requests == 0 {
            state.since = Instant::now();
            state.head_since = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio::time::advance;

    use super::*;

    fn seconds(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    fn vitals(age: Option<u64>) -> Arc<Vitals> {
        let token = CancellationToken::new;
        Vitals::new(
            Arc::new(Limits::default()),
            age.map(seconds),
            token(),
            token(),
        )
    }

    /// Looks at a connection as often as its task does, for so long at most, and returns what
    /// becomes of it and after how many seconds.
    async fn watch(vitals: &Vitals, most: u64) -> Option<(Fate, u64)> {
        let began = Instant::now();
        while began.elapsed() <= seconds(most) {
            match vitals.fate(Instant::now()) {
                Fate::Lives(until) => advance(until.duration_since(Instant::now())).await,
                fate => return Some((fate, began.elapsed().as_secs())),
            }
        }
        None
    }

    #[tokio::test(start_paused = true)]
    async fn headers_arrive_in_time_from_the_accept_on() {
        assert_eq!(
            watch(&vitals(None), 60).await,
            Some((Fate::Ends(Cause::Head), 10))
        );
        let dripping = vitals(None);
        dripping.heard(b"G");
        advance(seconds(9)).await;
        dripping.heard(b"G");
        assert_eq!(
            watch(&dripping, 60).await,
            Some((Fate::Ends(Cause::Head), 1))
        );
    }

    #[tokio::test(start_paused = true)]
    async fn who_connects_ahead_of_its_first_request_is_told() {
        let vitals = vitals(None);
        vitals.heard(PREFACE);
        vitals.heard(b"settings");
        assert_eq!(
            watch(&vitals, 60).await,
            Some((Fate::Leaves(Cause::Head), 10))
        );
        vitals.leaves();
        assert_eq!(
            watch(&vitals, 60).await,
            Some((Fate::Ends(Cause::Grace), 2))
        );
    }

    #[tokio::test(start_paused = true)]
    async fn a_connection_may_wait_for_its_next_request() {
        for version in [Version::HTTP_11, Version::HTTP_2] {
            let vitals = vitals(None);
            drop(vitals.begin(version));
            assert_eq!(
                watch(&vitals, 60).await,
                Some((Fate::Leaves(Cause::Idle), 30)),
                "{version:?}"
            );
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_later_request_has_no_more_time_for_its_headers() {
        let vitals = vitals(None);
        drop(vitals.begin(Version::HTTP_11));
        advance(seconds(5)).await;
        vitals.heard(b"G");
        advance(seconds(9)).await;
        vitals.heard(b"G");
        assert_eq!(watch(&vitals, 60).await, Some((Fate::Ends(Cause::Head), 1)));
    }

    #[tokio::test(start_paused = true)]
    async fn pings_are_no_requests() {
        let vitals = vitals(None);
        drop(vitals.begin(Version::HTTP_2));
        advance(seconds(20)).await;
        vitals.heard(b"G");
        assert_eq!(
            watch(&vitals, 60).await,
            Some((Fate::Leaves(Cause::Idle), 10))
        );
    }

    #[tokio::test(start_paused = true)]
    async fn a_request_in_progress_is_never_idle() {
        let vitals = vitals(None);
        let (first, second) = (vitals.begin(Version::HTTP_2), vitals.begin(Version::HTTP_2));
        drop(first);
        assert_eq!(watch(&vitals, 7_200).await, None);
        drop(second);
        assert_eq!(
            watch(&vitals, 60).await,
            Some((Fate::Leaves(Cause::Idle), 30))
        );
    }

    #[tokio::test(start_paused = true)]
    async fn an_answer_is_read_in_time() {
        let vitals = vitals(None);
        let (read, unread) = (vitals.begin(Version::HTTP_2), vitals.begin(Version::HTTP_2));
        unread.handed_over();
        advance(seconds(15)).await;
        read.handed_over();
        read.asked();
        unread.asked();
        unread.handed_over();
        assert_eq!(
            watch(&vitals, 60).await,
            Some((Fate::Ends(Cause::Unread), 20))
        );
        unread.asked();
        assert_eq!(watch(&vitals, 60).await, None);
    }

    #[tokio::test(start_paused = true)]
    async fn age_asks_connections_to_leave_and_grace_ends_them() {
        let young = vitals(Some(1));
        let in_a_second = Instant::now() + seconds(1);
        assert_eq!(
            young.fate(Instant::now()),
            Fate::Lives(in_a_second),
            "before its version is known, too"
        );
        let old = vitals(Some(100));
        let request = old.begin(Version::HTTP_2);
        assert_eq!(
            watch(&old, 600).await,
            Some((Fate::Leaves(Cause::Age), 100))
        );
        old.leaves();
        assert_eq!(watch(&old, 600).await, Some((Fate::Ends(Cause::Grace), 30)));
        drop(request);
        assert_eq!(watch(&old, 600).await, Some((Fate::Ends(Cause::Grace), 2)));
        let plain = vitals(Some(100));
        let _request = plain.begin(Version::HTTP_11);
        assert_eq!(
            watch(&plain, 600).await,
            Some((Fate::Leaves(Cause::Age), 100))
        );
    }

    #[tokio::test(start_paused = true)]
    async fn only_who_waits_makes_room() {
        let vitals = vitals(None);
        let request = vitals.begin(Version::HTTP_11);
        assert!(vitals.waits_since().is_none() && !vitals.evict());
        drop(request);
        assert!(vitals.waits_since().is_some() && vitals.evict());
        assert!(!vitals.evict() && vitals.over.is_cancelled(), "once");
    }
}
