//! What a game server links to send its transitions to a Nudge service, and to ask it. No server, no
//! database and no networks are in here, and nothing here knows what the transitions mean.
//!
//! # The map, in reading order
//!
//! * [`Connection`], by [`Options`]: the channel of gRPC to one service, with a stub for each of its
//!   services; with a key and by [`ClientTls`], where the service wants them.
//! * [`Producer`]: sends transitions, each of which counts once (idempotency by numbered batches in
//!   an outbox); waits where the service asks for it (back-pressure), and comes back by itself where
//!   a connection breaks (exponential back-off).
//! * [`Track`]: the [`Step`]s of one episode in order, which become transitions: with their entry
//!   flags, and with what the agents did some steps later (lagged outcomes).
//! * [`patiently`]: any call, asked again while the service is away.
//! * [`tls`]: certificates and private keys in PEM files.
//! * [`domain`], of `nudge-core`: schemas, records, keys; [`proto`], of `nudge-wire`: the messages of
//!   each service's stub.
//!
//! # The protocol
//!
//! `docs/protocol.md` tells it, for those who write a client of their own in another language.
//!
//! # Keys
//!
//! A service that lets in keys only wants one: `Connection::open_with(address,
//! Options::default().key(key))`, which goes along with every call. Where the key's rate is used
//! up, calls and producers wait as long as the service says, and go on.
//!
//! # Sending
//!
//! `examples/game_server.rs` is the whole of it.
//!
//! ```no_run
//! use nudge_client::{Connection, Step};
//!
//! # async fn play() -> Result<(), nudge_client::ClientError> {
//! let connection = Connection::open("127.0.0.1:8080").await?;
//! let mut producer = connection.producer("hallway", "game-7").open().await?;
//! producer.segment(Some("trial-3")).await?;
//!
//! let mut track = producer.track();
//! for distance in [3.0, 2.4, 1.9] {
//!     producer.step(&mut track, Step::new(vec![distance], vec![0.1, 1.0])).await?;
//! }
//! producer.end(track).await?;
//!
//! let totals = producer.close().await?;
//! assert_eq!(totals.sent, totals.accepted + totals.rejected + totals.resumed + totals.unverified);
//! assert_eq!((totals.held_back, totals.dropped), (0, 0));
//! # Ok(())
//! # }
//! ```
//!
//! # What goes wrong is said in words
//!
//! ```
//! use nudge_client::{ClientError, Connection};
//!
//! # #[tokio::main(flavor = "current_thread")]
//! # async fn main() {
//! let nobody = Connection::open("127.0.0.1:1").await.expect_err("nobody listens there");
//! assert!(nobody.to_string().starts_with("nobody listens at http://127.0.0.1:1"));
//!
//! let address = Connection::open("ftp://example.org").await.expect_err("no address of a service");
//! assert!(matches!(address, ClientError::Address { .. }));
//! # }
//! ```

pub mod tls;

mod backoff;
mod connection;
mod error;
mod handshake;
mod link;
mod options;
mod outbox;
mod producer;
mod retry;
mod task;
mod totals;

pub use nudge_core::domain::Secret;
pub use nudge_core::tracks::{Step, Track, twins};
pub use {nudge_core::domain, nudge_wire::proto};

pub use connection::{Connection, Readiness, derived_of, readiness, schema_of};
pub use error::{ClientError, Refusal};
pub use handshake::{ClientTls, Trust};
pub use options::{Bearer, Options, Wire};
pub use producer::{Producer, ProducerBuilder};
pub use retry::{patiently, patiently_telling};
pub use totals::{Rejected, Totals};
