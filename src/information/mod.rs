//! Mathematics of tables: what the counts of two agents' joint actions say about their dependence.
//!
//! A [`Table`] holds finished counts n_ij: visits in which the row variable (the ego's action) took value i and the
//! column variable (the other's action) value j. r_i and c_j are its row and column sums, N its total. Everything else
//! here is a function from tables to numbers:
//!
//! | function | figure |
//! |---|---|
//! | [`plug_in`] | mutual information of the observed frequencies |
//! | [`divergence`] | what one row contributes: the share of `plug_in` that belongs to one ego action |
//! | [`expected_if_independent`] | mean of `plug_in` were the variables independent at these margins |
//! | [`excess`], [`miller_madow`] | `plug_in` less its bias, reckoned in two ways; may be negative |
//! | [`conditional`] | any of these, given other agents' actions |
//!
//! # Conventions
//!
//! - **Units** are nats throughout. Bits are made at the edge of the service, never here.
//! - **0 ln 0 = 0**, and the table of no counts has 0 of everything.
//! - **No NaN, no infinity**, whatever the table. What cannot be negative on paper is not negative here.
//! - **The bytes repeat**: sums run in the order of the labels, so equal tables give equal bits however they were built.
//! - **Only what was seen takes part.** Letters of the alphabet without a visit change none of these figures, and
//!   nothing is allocated for them.
//! - Counts are exact `u64` to a total of [`LARGEST_TOTAL`]; figures are `f64`.
//!
//! # Absent on purpose
//!
//! No I/O, no clock, no randomness, no dependency but `std`. No verdicts: whether a figure is large, or earned by
//! the counts, is not asked here.

mod alphabet;
mod conditional;
mod deviance;
mod mutual_information;
mod null;
#[cfg(test)]
mod samples;
mod table;
mod x_ln_x;

pub use alphabet::Alphabet;
pub use conditional::conditional;
pub use deviance::divergence;
pub use mutual_information::{excess, miller_madow, plug_in};
pub use null::{ExpectedMethod, expected_if_independent};
pub use table::{LARGEST_TOTAL, Occupied, Table};
