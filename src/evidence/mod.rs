//! What counts can support: from figures to a verdict, by a rule. Pure; nothing here counts, reads or asks a network.

mod base;
mod beta;
mod decision;
mod fit;
mod gamma;
mod increments;
mod likelihood;
mod moments;
mod parameters;
mod posterior;
mod prior;

pub use base::Base;
pub use decision::{Belief, basis, decide, dependence};
pub use fit::{Fit, Fitter};
pub use parameters::Parameters;
pub use posterior::Posterior;
pub use prior::Prior;
