//! Trajectories: the consecutive steps of one game, and what only their order tells. Which steps
//! are independent draws of their state (thinning), and what the agents did some steps later
//! (lagged outcomes). The service never joins steps; whoever has them in order does it here.
//!
//! * [`EntryRule`]: which steps entered their state and count as draws. The service uses it too, for
//!   senders that tell only which track a step is of.
//! * [`Track`]: [`Step`]s in, transitions out.
//! * [`twins`]: the same steps without influence, to hold what was found against.
//!
//! # Absent on purpose
//!
//! No I/O and no clock: a track holds values back, and gives them out.

mod entry_rule;
mod track;
pub mod twins;
#[cfg(test)]
mod worked_examples;

pub use entry_rule::EntryRule;
pub use track::{Step, Track};
