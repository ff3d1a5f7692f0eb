//! Nudge tells when one agent's action influences another's.

pub mod information;
