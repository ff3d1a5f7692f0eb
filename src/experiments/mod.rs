//! Reproducible experiments, claims about the whole measured: a seed goes in, a table and a plot
//! come out, and the same seed gives the same bytes.
//!
//! An experiment goes the way that everybody goes: what it draws is sent to a service of its own,
//! which counts it, fits it and answers. What is measured here is the answers. Nothing here prints,
//! and nothing here computes what the service should.

pub mod findings;
pub mod kitchens;
pub mod lag_profile;
pub mod measures;
pub mod planted;
pub mod seeds;

mod dots;
mod service;
