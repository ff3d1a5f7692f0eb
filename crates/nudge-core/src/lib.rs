//! The mathematics and the words of Nudge: what counts of two agents' joint actions say about the
//! influence of one on the other. No I/O, no clock, no threads of its own.
//!
//! # The map, in reading order
//!
//! * [`information`]: the mathematics of contingency tables: mutual information, its estimators,
//!   and what chance alone would show.
//! * [`error`]: kinds of error, and the faults of an input.
//! * [`domain`]: environments, features, states, transitions, counts, questions, answers. Types
//!   that cannot be wrong.
//! * [`evidence`]: what counts can support: the prior fitted to all states (empirical Bayes), the
//!   posterior of one, the verdict.
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
//! let posteriors = states.each_ref().map(|state| prior.posterior(prior.habits(), std::slice::from_ref(state)));
//! assert!(posteriors[0].dependent() > 0.99 && posteriors[1].dependent() < 0.5);
//! ```

pub mod domain;
pub mod error;
pub mod evidence;
pub mod information;
mod special_functions;
