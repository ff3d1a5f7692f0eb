//! Statistics of contingency tables: mutual information, its estimators, and tests of independence.
//! What the counts of two agents' joint actions say about their dependence.
//!
//! A [`Table`] holds finished counts n_ij: visits in which the row variable (the ego's action) took
//! value i and the column variable (the other's action) value j. r_i and c_j are its row and column
//! sums, N its total. Everything else here is a function from tables to numbers:
//!
//! | function | figure |
//! |---|---|
//! | [`plug_in`] | mutual information of the observed frequencies; [`plug_in_dense`] of a grid of counts |
//! | [`divergence`] | what one row contributes: the share of `plug_in` that belongs to one ego action |
//! | [`expected_if_independent`] | mean of `plug_in` were the variables independent at these margins |
//! | [`excess`], [`miller_madow`] | `plug_in` less its bias, reckoned in two ways; may be negative |
//! | [`chao_shen`], [`james_stein`], [`grassberger_2003`], [`nsb`], [`dirichlet`] | other estimates of the information behind the counts |
//! | [`adjusted`] | `plug_in` as a share of what is possible beyond chance |
//! | [`uniform_policy`] | `plug_in` without the ego's habits |
//! | [`conditional`] | any of these, given other agents' actions |
//! | [`p_value`], [`smallest_p`] | could chance alone have made these counts, and could it be told? |
//! | [`policy`] | information under other habits of the ego |
//! | [`pooled`] | many tables asked about as one: tests, size, intervals |
//! | [`search`] | in which states dependence lives |
//! | [`benjamini_hochberg`], [`bayesian_fdr`], [`q_values`] | which of many states to call influenced |
//!
//! # Conventions
//!
//! - **Units** are nats throughout. Bits are made at the edge of the service, never here.
//! - **0 ln 0 = 0**, and the table of no counts has 0 of everything.
//! - **No NaN, no infinity**, whatever the table. What cannot be negative on paper is not negative
//!   here.
//! - **The bytes repeat**: sums run in the order of the labels, so equal tables give equal bits
//!   however they were built.
//! - **Only what was seen takes part**, but where a function asks for an [`Alphabet`]. Nothing is
//!   ever allocated for letters without a visit.
//! - Counts are exact `u64` to a total of [`LARGEST_TOTAL`]; figures are `f64`.
//!
//! # Absent on purpose
//!
//! No I/O, no clock, no randomness but from a seed that is given. No verdicts: whether a figure is
//! large, or earned by the counts, is not asked here.

mod alphabet;
mod alphabet_sizes;
mod conditional;
mod counts_of_counts;
mod dense;
mod deviance;
mod estimators;
mod mutual_information;
mod null;
pub mod policy;
pub mod pooled;
#[cfg(test)]
pub(crate) mod samples;
pub mod search;
mod significance;
mod table;
mod urn;
mod x_ln_x;

pub use alphabet::Alphabet;
pub use conditional::conditional;
pub use dense::plug_in_dense;
pub use deviance::divergence;
pub use estimators::{
    adjusted, chao_shen, dirichlet, grassberger_2003, james_stein, nsb, uniform_policy,
};
pub use mutual_information::{excess, miller_madow, plug_in};
pub use null::moments::Moments;
pub use null::{ExpectedMethod, expected_if_independent};
pub use significance::{
    Method, Significance, bayesian_fdr, benjamini_hochberg, p_value, p_value_while, q_values,
    smallest_p,
};
pub use table::{LARGEST_TOTAL, Occupied, Table};
