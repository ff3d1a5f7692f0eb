//! Between proto messages and the domain.

mod answer;
mod environment;
mod graph;
mod ingest;
mod overview;
mod question;

pub use ingest::{acknowledgement, batch, producer, receipt, sequence};
pub(in crate::api) use ingest::{segment, within_limit};
pub use question::{batch_question, discovery, exploration, fit, graph, list_states, question, scope};
