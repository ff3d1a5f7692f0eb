//! Orders of states.

use super::survey::Row;

/// What rows are ordered by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OrderBy {
    /// How often a state was seen.
    Visits,
    /// Plug-in mutual information.
    PlugIn,
    /// The posterior mean of mutual information.
    PosteriorMean,
    /// The probability that there is any dependence.
    Dependent,
}

/// An order of rows; equal rows are in order of key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// What counts.
    pub by: OrderBy,
    /// Largest first.
    pub descending: bool,
}

impl Order {
    /// Returns a number that orders rows as this order does. Figures are not negative, so their bits are in their order.
    pub fn rank(self, row: &Row) -> u64 {
        let value = match self.by {
            OrderBy::Visits => row.visits,
            OrderBy::PlugIn => row.plug_in.to_bits(),
            OrderBy::PosteriorMean => row.evidence.map_or(0.0, |evidence| evidence.posterior_mean).to_bits(),
            OrderBy::Dependent => row.evidence.map_or(0.0, |evidence| evidence.probability.dependent).to_bits(),
        };
        if self.descending { !value } else { value }
    }
}
