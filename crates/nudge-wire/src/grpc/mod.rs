//! Conversions between proto messages and the domain.

mod answer;
mod environment;
mod graph;
mod ingest;
mod model;
mod overview;
mod profile;
mod question;
mod region;
mod region_answer;
mod region_search;

pub use ingest::{acknowledgements, batch, producer, receipt, sequence};
#[cfg(feature = "rest")]
pub(crate) use ingest::{segment, within_limit};
pub use model::training;
pub use profile::profile;
pub use question::{
    batch_question, exploration, fit, graph, list_states, question, scope, summary,
};
pub use region_search::region_search;
