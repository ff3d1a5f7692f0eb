//! Nudge tells when one agent's action influences another's.

pub mod api;
pub mod app;
pub mod cli;
pub mod client;
pub mod domain;
pub mod environments;
pub mod error;
pub mod influence;
pub mod information;
pub mod ingest;
pub mod recordings;
pub mod serve;
pub mod store;
