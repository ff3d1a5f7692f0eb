//! Worlds that produce transitions: pedestrians who avoid each other in a hallway, and tables with
//! planted influence. Seeded, and without I/O: the same seed gives the same bytes.

mod crowd;
pub mod drawing;
pub mod follower;
pub mod hallway;
mod neighbours;
pub mod observation;
pub mod planted;
mod social_force;
mod walls;

pub use crowd::{Crowd, Pedestrian};
pub use social_force::{NEGLIGIBLE, SocialForce, semi_minor_axis};
pub use walls::{Segment, Wall};
