//! Between proto messages and the domain.

mod answer;
mod environment;
mod ingest;
mod question;

pub use ingest::{acknowledgement, batch, producer, receipt, sequence};
pub(in crate::api) use ingest::{segment, within_limit};
pub use question::{batch_question, list_states, question, scope};
