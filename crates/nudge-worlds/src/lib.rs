//! Worlds that produce transitions for Nudge, and play that was recorded elsewhere.
//!
//! # The map, in reading order
//!
//! * [`simulation`]: worlds that are drawn by a seeded generator of random numbers.
//!   * [`simulation::Crowd`], [`simulation::SocialForce`], [`simulation::Wall`]: the social force
//!     model of pedestrians (Helbing & Molnar 1995), as a solver of its own.
//!   * [`simulation::hallway`], [`simulation::observation`], [`simulation::drawing`]: trials in a
//!     hallway, what its pedestrians see of each other as transitions, and pictures in SVG.
//!   * [`simulation::follower`]: two walkers, one of whom follows the other.
//!   * [`simulation::planted`]: synthetic data with known ground truth: contingency tables in which
//!     influence is planted or is not, stratified ones
//!     ([`segments`](simulation::planted::segments)), and states of several agents with a known
//!     causal graph ([`graphs`](simulation::planted::graphs)).
//! * [`recordings`]: games of people, read as transitions.
//!
//! # Deliberately absent
//!
//! I/O: bytes in, values out. Whoever has a file opens it, and whoever has a service sends to it.
//! Nor is there a clock: the same seed and parameters give the same bytes.
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
//!
//! # A stratified state: independent within each segment, whatever the pooled table shows
//!
//! ```
//! use nudge_worlds::simulation::planted::segments::{Options, WORLDS, states};
//!
//! let opposite = WORLDS.iter().find(|world| world.name == "opposite").unwrap();
//! for state in states(opposite, &Options::default()) {
//!     assert_eq!(state.information, 0.0);
//!     assert_eq!(state.pooled().total(), 30);
//! }
//! ```

pub mod recordings;
pub mod simulation;
