//! Play recorded elsewhere, read as transitions. Nothing here speaks to a service or opens a file:
//! bytes in, games out.

pub mod overcooked;

mod error;

pub use error::RecordingError;
