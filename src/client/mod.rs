//! Speaking to a service as a game server does. Nothing here knows what the transitions mean, and nothing else in this crate opens a connection.
//!
//! # The protocol, for those who write their own
//!
//! 1. Choose a producer id that is the same after a restart, and number your batches 1, 2, 3, ... per environment. Keep each until it is committed.
//! 2. Open `nudge.v1.IngestService.Ingest`. Send `Hello` with the environment's name, its uid and schema hash if you know them, and your id.
//! 3. The answer is `Welcome`. Drop every batch up to `committed_sequence`, then send the rest in order, oldest first.
//! 4. Keep at most `window` batches unacknowledged, each of at most `max_batch_transitions` transitions and `max_message_bytes` bytes.
//! 5. `Acknowledgement` comes after the commit: drop everything up to its `committed_sequence`, and read a receipt for each batch.
//! 6. A receipt that says `DUPLICATE` is a success: the batch was counted before. Rejected transitions are listed in it; the rest was counted. One that
//!    says `REJECTED` lists them too: nothing of the batch was counted, and its number is used. One that says `UNVERIFIED` means that the number was used
//!    so long ago that nobody can tell: a producer that lost its outbox must take a new id, for under its old one it may lose what it sends.
//! 7. `UNAVAILABLE`, or a stream that breaks or ends: wait (100 ms, doubling up to 5 s, spread at random), and go on at 2 with the uid and hash
//!    that the welcome gave.
//! 8. Any other error is for good: `NOT_FOUND` (no such environment, or it was deleted), `FAILED_PRECONDITION` (another stream uses your id, a
//!    number was reused or left out, or the environment was deleted and made again), `INVALID_ARGUMENT`, `OUT_OF_RANGE` (too large), `RESOURCE_EXHAUSTED` (a quota without a retry time).
//! 9. Send batches as `Columns`. The value of a label is its index, and values stand in the environment's order.
//! 10. Set the entry flag where you know it: `ENTERED` when the discretised state differs from the step before, else `STAYED`.
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
mod outbox;
mod producer;
mod task;
mod totals;
mod trouble;

pub use connection::{Connection, patiently, patiently_telling, schema_of};
pub use error::{ClientError, Refusal};
pub use producer::{Producer, ProducerBuilder};
pub use totals::{Rejected, Totals};

pub use crate::domain::Track;
