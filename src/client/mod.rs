//! Speaking to a service as a game server does. Nothing here knows what the transitions mean, and
//! nothing else in this crate opens a connection.
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
//! # Example
//!
//! ```no_run
//! use nudge::client::{Connection, Track};
//!
//! # async fn play() -> Result<(), nudge::client::ClientError> {
//! let connection = Connection::open("127.0.0.1:8080").await?;
//! let mut producer = connection.producer("hallway", "game-7").open().await?;
//! producer.segment(Some("trial-3")).await?;
//! let mut track = Track::new(producer.schema());
//! for distance in [3.0, 2.4, 1.9] {
//!     producer.send(track.record(vec![distance], vec![0.1, 1.0])).await?;
//! }
//! let totals = producer.close().await?;
//! assert_eq!(totals.sent, totals.accepted + totals.rejected + totals.resumed + totals.unverified);
//! # Ok(())
//! # }
//! ```

mod connection;
mod error;
mod link;
mod options;
mod outbox;
mod producer;
mod retry;
mod task;
mod tls;
mod totals;
mod trouble;

pub use connection::{Connection, Readiness, readiness, schema_of};
pub use error::{ClientError, Refusal};
pub use options::{Bearer, Options, Wire};
pub use producer::{Producer, ProducerBuilder};
pub use retry::{patiently, patiently_telling};
pub use tls::{ClientTls, Trust};
pub use totals::{Rejected, Totals};

pub use crate::access::Secret;
pub use crate::domain::Track;
