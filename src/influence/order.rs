//! Sort orders of states, each sorted at its first use.

use std::sync::OnceLock;

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

/// Rows that have a place in orders, by their positions, which are in order of key.
pub trait Ranked {
    /// Returns how many there are.
    fn len(&self) -> usize;

    /// Returns the bins of a state.
    fn bins(&self, at: usize) -> &[u32];

    /// Returns how often it was seen.
    fn visits(&self, at: usize) -> u64;

    /// Returns its plug-in mutual information.
    fn plug_in(&self, at: usize) -> f64;

    /// Returns the posterior mean of its mutual information; 0 where that is not known.
    fn posterior_mean(&self, at: usize) -> f64;

    /// Returns the probability that there is any; 0 where that is not known.
    fn dependent(&self, at: usize) -> f64;
}

impl SortOrder {
    /// Returns a number that orders rows as this order does. Figures are not negative, so their
    /// bits are in their order.
    pub fn rank(self, rows: &impl Ranked, at: usize) -> u64 {
        self.directed(match self.by {
            OrderBy::Visits => rows.visits(at),
            OrderBy::PlugIn => rows.plug_in(at).to_bits(),
            OrderBy::PosteriorMean => rows.posterior_mean(at).to_bits(),
            OrderBy::Dependent => rows.dependent(at).to_bits(),
        })
    }

    /// Returns the rank of a state with these visits in an order of visits, or the visits of one
    /// with this rank.
    pub fn directed(self, value: u64) -> u64 {
        if self.descending { !value } else { value }
    }
}

/// The permutations that sort some rows, each made at its first use.
#[derive(Default)]
pub struct Orders([OnceLock<Vec<u32>>; 8]);

impl Orders {
    /// Returns the positions of all rows, which are always the same, in an order.
    pub fn positions(&self, rows: &impl Ranked, order: SortOrder) -> &[u32] {
        let slot = order.by as usize * 2 + usize::from(order.descending);
        self.0[slot].get_or_init(|| {
            let ranked = |at: u32| (order.rank(rows, at as usize), at);
            let mut ranked: Vec<(u64, u32)> = (0..rows.len() as u32).map(ranked).collect();
            // Positions are in order of key, and so are equal ranks.
            ranked.sort_unstable();
            ranked.into_iter().map(|(_, at)| at).collect()
        })
    }
}
