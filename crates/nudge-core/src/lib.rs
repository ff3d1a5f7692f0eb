//! Information theory and Bayesian statistics of contingency tables, for the influence of one agent
//! on another: what counts of two agents' joint actions say about it, and the words it is told in.
//! No I/O, no clock, no threads of its own.
//!
//! # The map, in reading order
//!
//! * [`information`]: statistics of contingency tables: mutual information, its estimators, and
//!   tests of independence.
//! * [`error`]: kinds of error, and the faults of an input.
//! * [`domain`]: environments, features, states, transitions, counts, questions, answers. Types
//!   that cannot be wrong.
//! * [`tracks`]: consecutive steps, and what only their order tells: which of them are independent
//!   draws (thinning).
//! * [`evidence`]: Bayesian inference: the prior fitted to all states (empirical Bayes), Bayes
//!   factors and the posterior of one, the verdict.
//! * `special_functions`: ln Gamma and its relatives, which both mathematics stand on.
//!
//! `examples/table.rs` asks all of it of a few tables.
//!
//! # A table, and what it says
//!
//! ```
//! use nudge_core::information::{Table, expected_if_independent, p_value, plug_in};
//!
//! // Whoever sees the other turn (1) mostly turns as well: (ego, other, visits).
//! let table = Table::from_counts([(0, 0, 30), (0, 1, 10), (1, 0, 5), (1, 1, 25)]);
//!
//! let nats = plug_in(&table);
//! assert!(nats > 0.1 && nats > expected_if_independent(&table).0);
//! assert!(p_value(&[table], 10_000, 1).p_value < 0.001);
//! ```
//!
//! # A state among others
//!
//! ```
//! use nudge_core::evidence::{Fitter, Prior, Uses};
//! use nudge_core::information::{Alphabet, Table};
//!
//! let alphabet = Alphabet { rows: 2, columns: 2 };
//! let states = [
//!     Table::from_counts([(0, 0, 30), (0, 1, 2), (1, 0, 3), (1, 1, 25)]),
//!     Table::from_counts([(0, 0, 9), (0, 1, 11), (1, 0, 10), (1, 1, 10)]),
//! ];
//! let mut uses = Uses::new(alphabet);
//! states.iter().for_each(|state| uses.add(std::slice::from_ref(state)));
//! let mut fitter = Fitter::new(alphabet, &uses);
//! states.iter().for_each(|state| fitter.add(std::slice::from_ref(state)));
//!
//! let prior = Prior::new(&fitter.fit());
//! let [copies, ignores] = states
//!     .each_ref()
//!     .map(|state| prior.posterior(prior.habits(), std::slice::from_ref(state)));
//! assert!(copies.dependent() > 0.99 && ignores.dependent() < 0.5);
//! ```

pub mod domain;
pub mod error;
pub mod evidence;
pub mod information;
mod special_functions;
pub mod tracks;
