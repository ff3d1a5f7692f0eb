//! Policies by the numbers that the store gives to their segments.

use crate::domain::SegmentId;

/// A policy by the numbers of its segments.
#[derive(Debug, Clone, PartialEq)]
pub enum PolicySegments {
    /// The habits that were seen.
    Observed,
    /// Every action in use alike.
    Uniform,
    /// The habits seen in these segments.
    Within(Vec<SegmentId>),
    /// Those seen outside of these.
    Outside(Vec<SegmentId>),
}
