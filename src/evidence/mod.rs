//! What counts can support: from figures to a verdict, by a rule. Pure; nothing here counts, reads or asks a network.

mod base;
mod beta;
mod by_action;
mod decision;
mod draws;
mod fit;
mod futures;
mod gamma;
mod increments;
mod likelihood;
mod moments;
mod parameters;
mod posterior;
mod prior;

pub use base::Base;
pub use by_action::{ActionPosterior, Ego};
pub use decision::{Belief, basis, decide, dependence};
pub use fit::{Fit, Fitter};
pub use parameters::Parameters;
pub use posterior::Posterior;
pub use prior::Prior;

/// The largest alphabet of either variable that posteriors are for: their tables hold every letter of the columns.
pub const MOST_LETTERS: u64 = 4_096;

/// The most pairs of actions that figures by action and of futures are for: they look at every one of them many times.
pub const MOST_CELLS: u64 = 4_096;

#[cfg(test)]
mod tests;
