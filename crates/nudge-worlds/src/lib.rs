//! Worlds that produce transitions for Nudge, and play that was recorded elsewhere.
//!
//! # The map, in reading order
//!
//! * [`simulation`]: a hallway whose pedestrians walk by the social force model, and tables in
//!   which influence is planted.
//! * [`recordings`]: games of people, read as transitions.
//!
//! # States whose truth is known
//!
//! ```
//! use nudge_worlds::simulation::planted::{Arm, Generator, Options, planted};
//!
//! let options = Options { states: 100, dependent: 0.3, arm: Arm::Plain, seed: 1 };
//! let states = planted(Generator::Responses, &options);
//! assert_eq!(states.len(), 100);
//! assert!(states.iter().any(|state| state.dependent && state.information > 0.0));
//! ```

pub mod recordings;
pub mod simulation;
