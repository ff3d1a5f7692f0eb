//! Sort orders of states, each sorted at its first use.

use std::sync::OnceLock;

use crate::domain::{Evidence, StateKey};

/// The sort key of rows.
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

impl OrderBy {
    /// Returns whether evidence has to be made for it.
    pub fn needs_evidence(self) -> bool {
        matches!(self, Self::PosteriorMean | Self::Dependent)
    }
}

/// A sort order of rows; equal rows are in order of key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SortOrder {
    /// What counts.
    pub by: OrderBy,
    /// Largest first.
    pub descending: bool,
}

/// What has a place in orders.
pub trait Ranked {
    /// Returns the state.
    fn key(&self) -> &StateKey;

    /// Returns how often it was seen.
    fn visits(&self) -> u64;

    /// Returns its plug-in mutual information.
    fn plug_in(&self) -> f64;

    /// Returns what the counts say of it, where that is known.
    fn evidence(&self) -> Option<&Evidence>;
}

impl SortOrder {
    /// Returns a number that orders rows as this order does. Figures are not negative, so their
    /// bits are in their order.
    pub fn rank(self, row: &impl Ranked) -> u64 {
        let value = match self.by {
            OrderBy::Visits => row.visits(),
            OrderBy::PlugIn => row.plug_in().to_bits(),
            OrderBy::PosteriorMean => row
                .evidence()
                .map_or(0.0, |evidence| evidence.posterior_mean)
                .to_bits(),
            OrderBy::Dependent => row
                .evidence()
                .map_or(0.0, |evidence| evidence.probability.dependent)
                .to_bits(),
        };
        self.directed(value)
    }

    /// Returns the visits of a state that has this rank in an order of visits.
    pub fn visits(self, rank: u64) -> u64 {
        self.directed(rank)
    }

    fn directed(self, value: u64) -> u64 {
        if self.descending { !value } else { value }
    }
}

/// The permutations that sort some rows, each made at its first use.
#[derive(Default)]
pub struct Orders([OnceLock<Vec<u32>>; 8]);

impl Orders {
    /// Returns the positions of all rows, which are always the same and in order of key, in an
    /// order.
    pub fn positions(&self, rows: &[impl Ranked], order: SortOrder) -> &[u32] {
        let slot = order.by as usize * 2 + usize::from(order.descending);
        self.0[slot].get_or_init(|| {
            let mut positions: Vec<u32> = (0..rows.len() as u32).collect();
            // The sort is stable, so equal ranks stay in order of key.
            positions.sort_by_key(|position| order.rank(&rows[*position as usize]));
            positions
        })
    }
}
