//! Nudge tells when one agent's action influences another's: in this state, how strongly, how sure,
//! and which actions do it.
//!
//! # The map, in reading order
//!
//! Rooms that others can use alone are crates, which this one shows under their names: `nudge_core`
//! has [`information`], [`error`], [`domain`], [`tracks`] and [`evidence`], `nudge_worlds`
//! [`simulation`] and [`recordings`], `nudge_wire` is [`api`], and `nudge_client` is [`client`],
//! with [`tls`] in it.
//!
//! Each room may use the ones above it, never the ones below, and within a room no files import
//! each other in a circle: what two of them need has a file of its own (`tests/it/architecture`).
//!
//! * [`information`]: the mathematics of contingency tables. Slices in, numbers out.
//! * [`error`], [`telemetry`]: kinds of error, logs and the one list of metrics.
//! * [`domain`]: environments, features, states, transitions, counts, questions, answers. Types
//!   that cannot be wrong.
//! * [`tracks`]: consecutive steps, and what only their order tells.
//! * [`work`]: whatever computes for long: admitted, cancelled, and made once for all who ask.
//! * [`evidence`]: what counts can support: the prior fitted to all states, the posterior of one,
//!   the verdict.
//! * [`store`]: what was counted, durably: a promise, and SQLite behind it.
//! * [`simulation`]: worlds that produce transitions.
//! * [`recordings`]: play that was recorded elsewhere, read as transitions.
//! * [`access`]: keys, and what proves that somebody has one.
//! * [`api`]: the wire: generated proto types, JSON, and their conversions.
//! * [`ingest`]: how transitions become counts.
//! * [`client`]: speaking to a service as a game server does.
//! * [`tls`]: certificates and private keys in PEM files, for either side of a connection.
//! * [`priors`]: from cells to tables, and the priors that evidence stands on, fitted to all
//!   states.
//! * [`model`]: what to expect where little or nothing was counted: networks, trained, judged, kept
//!   and served.
//! * [`environments`]: which worlds there are: their beginning, their rule and their end.
//! * [`influence`]: the question itself.
//! * [`app`]: one handle of each room.
//! * [`serve`]: everything on a listening socket.
//! * [`experiments`]: claims about the whole, measured on a service of their own.
//! * [`cli`]: the commands.
//!
//! # A write, a read, and what is learned
//!
//! ```text
//! write   bytes -> serve (decode by api) -> ingest (validate, merge) -> committer -> store.commit -> receipt
//! read    bytes -> serve (decode by api) -> influence -> store.counts -> information -> evidence -> answer
//! learn   priors -> store.scan -> evidence (fit over all states) -> store.keep_fit
//! ```
//!
//! # Deliberately absent
//!
//! Nothing in `information`, `domain` or `evidence` does I/O. Raw values are not kept anywhere:
//! only bins are counted. There is no wall clock in the protocol. The committer talks to nothing
//! but the store. Nothing flows upwards but return values.

pub use nudge_client as client;
pub use nudge_client::tls;
pub use nudge_core::{domain, error, evidence, information, tracks};
pub use nudge_wire as api;
pub use nudge_worlds::{recordings, simulation};

pub mod access;
pub mod app;
pub mod cli;
pub mod environments;
pub mod experiments;
pub mod influence;
pub mod ingest;
pub mod model;
pub mod priors;
pub mod serve;
pub mod store;
pub mod telemetry;
pub mod work;
