//! Empirical Bayes: the priors that evidence stands on, fitted to all states of an environment, one
//! for each pair of agents, in the background and on request.
//!
//! A fit is made of the counts as they are when it begins, and answers name it. It is not made anew
//! with each commit: by then a tenth more must have been counted, and somebody must have asked for
//! it within the last hour.
//!
//! # The map
//!
//! | file | what |
//! |---|---|
//! | `tables` | contingency tables of a state's cells; the observations that evidence rests on |
//! | `scan`, `sample` | a pass over all states, and which of very many a fit is made from |
//! | `fitted`, `evidence_cache` | a fitted prior, with what was found of single states by it |
//! | `registry` | the last fit of each pair, from memory or from the store |
//! | `fitting` | one more fit |
//! | `upkeep`, `asked` | background refits, and which pairs somebody asked for lately |
//! | `stored_forms`, `unreadable` | what the database keeps, and what cannot be read of it |

mod asked;
mod evidence_cache;
mod fitted;
mod fitting;
mod registry;
mod sample;
mod scan;
mod stored_forms;
mod tables;
mod unreadable;
mod upkeep;

pub use evidence_cache::{EvidenceInputs, PassEvidence, StateEvidence};
pub use fitted::{Fitted, Informed};
pub use registry::PriorRegistry;
pub use sample::Sample;
pub use scan::Pages;
pub use tables::{Observations, Stratum, Tables, ego};
pub use unreadable::UnreadableFit;
