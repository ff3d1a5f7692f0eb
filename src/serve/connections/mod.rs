//! Connections: bounded in number, in time and in memory.
//!
//! ```text
//! accept --crowd--> place --task--> (TLS) --> hyper --service--> routes
//!                             |        |        |
//!                             +---- vitals -----+      received, sent: the bodies
//! ```
//!
//! hyper waits for ever for a first byte, for the rest of a preface, for a body and for a reader.
//! Here the service and the bodies note what happens in the `vitals` of their connection, and its
//! task looks at them now and then. There is nothing about any path here but which ones stream.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::time::{Instant, sleep_until};
use tokio_util::io::InspectReader;
use tokio_util::sync::CancellationToken;

use self::crowd::{Crowd, Place};
use self::limits::Limits;
use self::memory::Budget;
use self::service::Watched;
use self::vitals::{Cause, Fate, Vitals};
use crate::serve::tls::{Tls, too_late};
use crate::telemetry;

pub mod crowd;
pub mod files;
pub mod limits;
pub mod memory;

mod ended;
mod framing;
mod leaving;
mod received;
mod sent;
mod service;
mod vitals;

pub use leaving::Leaving;

/// How often a silent HTTP/2 connection is asked for a sign of life, and how long it may take to
/// give it.
const KEEP_ALIVE: (Duration, Duration) = (Duration::from_secs(20), Duration::from_secs(10));

/// Requests at a time on one HTTP/2 connection.
const MOST_STREAMS: u32 = 200;

/// The headers of a request, all together.
const MOST_HEADER_BYTES: u32 = 16 << 10;

/// What a client may send ahead of being read, on one HTTP/2 stream and on all of a connection:
/// more than a network holds in flight, and what a connection that is not read may cost.
const WINDOWS: (u32, u32) = (256 << 10, 512 << 10);

/// What HTTP/1 reads and writes ahead.
const MOST_BUFFERED_BYTES: usize = 64 << 10;

/// Everybody who is connected, and what they share.
pub struct Host {
    router: Router,
    limits: Arc<Limits>,
    tls: Option<Tls>,
    crowd: Arc<Crowd>,
    budget: Arc<Budget>,
    builder: Builder<TokioExecutor>,
    draining: CancellationToken,
    over: CancellationToken,
}

impl Host {
    /// Makes the host of nobody yet. `draining` asks everybody to leave, `over` ends what is left.
    pub fn new(
        router: Router,
        limits: Limits,
        tls: Option<Tls>,
        draining: CancellationToken,
        over: CancellationToken,
    ) -> Arc<Self> {
        let (crowd, budget) = (Crowd::new(&limits), Budget::new(limits.unfinished_bytes));
        Arc::new(Self {
            router,
            limits: Arc::new(limits),
            tls,
            crowd,
            budget,
            builder: builder(),
            draining,
            over,
        })
    }

    /// Returns who is here.
    pub fn crowd(&self) -> &Arc<Crowd> {
        &self.crowd
    }

    /// Serves a connection until it ends.
    pub async fn serve(self: Arc<Self>, stream: TcpStream, place: Place) {
        let age = age(self.limits.age, place.number());
        let vitals = Vitals::new(
            self.limits.clone(),
            age,
            self.draining.child_token(),
            self.over.child_token(),
        );
        place.take(vitals.clone());

        let (standing, budget) = (place.standing(), self.budget.clone());
        let peer = stream.peer_addr().ok().map(|address| address.ip());
        let service = Watched {
            router: self.router.clone(),
            vitals: vitals.clone(),
            standing,
            budget,
            peer,
        };

        let Some(tls) = &self.tls else {
            return self
                .attend(stream, service, &vitals, CancellationToken::new())
                .await;
        };
        let secured = tokio::select! {
            biased;
            secured = tls.secure(stream) => secured,
            is_late = given_up(&vitals) => {
                if is_late {
                    too_late(peer);
                }
                return;
            }
        };
        if let Some((stream, outdated)) = secured {
            self.attend(stream, service, &vitals, outdated).await;
        }
    }

    /// Speaks HTTP until the connection ends. Where what it was let in by is outdated, it is asked
    /// to leave.
    async fn attend<S>(
        &self,
        stream: S,
        service: Watched,
        vitals: &Arc<Vitals>,
        outdated: CancellationToken,
    ) where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        let heard = vitals.clone();
        let stream = InspectReader::new(stream, move |bytes: &[u8]| heard.heard(bytes));
        let mut connection =
            std::pin::pin!(self.builder.serve_connection(TokioIo::new(stream), service));
        let mut look = std::pin::pin!(sleep_until(Instant::now()));
        let mut is_leaving = false;

        loop {
            tokio::select! {
                biased;
                ended = connection.as_mut() => return ended::record(ended),
                () = vitals.over.cancelled() => return,
                () = outdated.cancelled(), if !vitals.leaving.is_cancelled() => vitals.leaving.cancel(),
                () = vitals.leaving.cancelled(), if !is_leaving => {
                    is_leaving = true;
                    vitals.leaves();
                    connection.as_mut().graceful_shutdown();
                }
                () = &mut look => match vitals.fate(Instant::now()) {
                    Fate::Lives(until) => look.as_mut().reset(until),
                    Fate::Leaves(cause) => {
                        ended_by(cause);
                        vitals.leaving.cancel();
                    }
                    Fate::Ends(cause) => return ended_by(cause),
                },
            }
        }
    }
}

/// Waits until a connection has to end that has not come to its first request, and tells whether it
/// took too long: else it makes room, or the service stops.
async fn given_up(vitals: &Vitals) -> bool {
    loop {
        match vitals.fate(Instant::now()) {
            Fate::Lives(until) => tokio::select! {
                () = sleep_until(until) => {}
                () = vitals.over.cancelled() => return false,
                () = vitals.leaving.cancelled() => return false,
            },
            Fate::Leaves(cause) | Fate::Ends(cause) => {
                ended_by(cause);
                return true;
            }
        }
    }
}

fn builder() -> Builder<TokioExecutor> {
    let mut builder = Builder::new(TokioExecutor::new());
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(None)
        .max_buf_size(MOST_BUFFERED_BYTES);

    let (interval, timeout) = KEEP_ALIVE;
    let (stream, connection) = WINDOWS;
    builder
        .http2()
        .timer(TokioTimer::new())
        .keep_alive_interval(interval)
        .keep_alive_timeout(timeout)
        .max_concurrent_streams(MOST_STREAMS)
        .max_header_list_size(MOST_HEADER_BYTES)
        .initial_stream_window_size(stream)
        .initial_connection_window_size(connection)
        .max_send_buf_size(MOST_BUFFERED_BYTES);
    builder
}

/// Returns the age at which a connection is to leave, spread over a fifth so that those which came
/// together do not leave together.
fn age(age: Duration, number: u64) -> Option<Duration> {
    /// Successive multiples of it fill the unit interval evenly.
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    /// No connection becomes as old, and clocks go no further than the longest duration.
    const OLDEST: Duration = Duration::from_secs(10 * 365 * 24 * 3_600);
    let spread = (number as f64 * GOLDEN).fract();
    (!age.is_zero()).then(|| age.min(OLDEST).mul_f64(0.9 + 0.2 * spread))
}

fn ended_by(cause: Cause) {
    tracing::debug!(cause = cause.word(), "a connection is ended");
    telemetry::connection_ended(cause.word());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_do_not_leave_together() {
        let hour = Duration::from_secs(3_600);
        let mut ages: Vec<u64> = (0..100)
            .filter_map(|number| age(hour, number))
            .map(|age| age.as_secs())
            .collect();
        ages.sort_unstable();
        assert!(ages[0] >= 3_240 && ages[99] <= 3_960);
        assert!(
            ages.windows(2).all(|pair| pair[1] - pair[0] < 20),
            "{ages:?}"
        );
        assert_eq!(age(Duration::ZERO, 1), None);
        for number in 0..100 {
            let age = age(Duration::MAX, number).expect("some");
            assert!(Instant::now().checked_add(age).is_some());
        }
    }
}
