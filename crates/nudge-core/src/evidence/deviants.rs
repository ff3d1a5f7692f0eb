//! Slabs of one outlying row: it deviates, tried or not, by a response of its own, and all other
//! rows share one.

use super::likelihood::{Likelihood, Null, NullMixture, anchor, row_counts};
use super::log_space::ln_sum;
use super::parameters::{DEVIANTS, NULLS};
use crate::information::Table;
use crate::special_functions::ln_rising;

/// The Bayes factors of the rows of a slice, each for being the one that deviates.
pub(super) struct Deviants {
    /// ln DM(c - n_i.; b m) DM(n_i.; k m) / DM(c; b m) of each visited row i, by position; of
    /// another one it would be 0.
    rows: Vec<[f64; DEVIANTS]>,
    /// How many rows were not visited.
    untried: f64,
}

/// The posterior probability that a row is the one that deviates: of each visited row by position,
/// and of any other.
pub(super) struct Deviating {
    pub rows: Vec<f64>,
    pub untried: f64,
}

impl Deviating {
    /// Returns the probability of the row of a label.
    pub fn probability(&self, table: &Table, label: usize) -> f64 {
        table
            .row_labels()
            .binary_search(&(label as u64))
            .map_or(self.untried, |row| self.rows[row])
    }
}

impl Deviants {
    /// Returns what is said where nobody asks.
    pub const fn none() -> Self {
        Self {
            rows: Vec::new(),
            untried: 0.0,
        }
    }

    /// Returns ln 1/R sum_i DM(c - n_i.; b m) DM(n_i.; k m) / DM(c; b m) for each slab, R counting
    /// all rows.
    pub fn evidence(&self) -> [f64; DEVIANTS] {
        let ln_rows = (self.rows.len() as f64 + self.untried).ln();
        std::array::from_fn(|slab| {
            let (largest, sum) = self.sum(slab);
            largest + sum.ln() - ln_rows
        })
    }

    /// Returns how probable it is of each row that it is the one that deviates under a slab.
    pub fn probable(&self, slab: usize) -> Deviating {
        let (largest, sum) = self.sum(slab);
        let p = |ln: f64| (ln - largest).exp() / sum;
        Deviating {
            rows: self.rows.iter().map(|row| p(row[slab])).collect(),
            untried: if self.untried > 0.0 { p(0.0) } else { 0.0 },
        }
    }

    /// Returns the largest logarithm of a row under a slab, and the sum over all rows as a multiple
    /// of its exponential.
    fn sum(&self, slab: usize) -> (f64, f64) {
        // Where every row was tried, all terms may be too small for an exponential.
        let least = if self.untried > 0.0 {
            0.0
        } else {
            f64::NEG_INFINITY
        };

        let largest = self
            .rows
            .iter()
            .fold(least, |largest: f64, row| largest.max(row[slab]));

        let tried: f64 = self
            .rows
            .iter()
            .map(|row| (row[slab] - largest).exp())
            .sum();
        let untried = if self.untried > 0.0 {
            self.untried * (-largest).exp()
        } else {
            0.0
        };

        (largest, tried + untried)
    }
}

/// Visits of a row up to which its part of the null's evidence is multiplied out, in tables of at
/// most so many: no product of theirs is too large for an `f64`.
const MULTIPLIED: u64 = 20;
const MOST_VISITS: u64 = 1_000_000_000;

impl Likelihood {
    /// Returns what each visited row says for deviating, beside the null.
    ///
    /// The shared response is that of the null, mixed, so that who fits the marginal better wins
    /// nothing. Where a slice is anchored, it is what is outside the anchor that may deviate from
    /// it.
    pub fn deviants(&self, table: &Table, nulls: &NullMixture, null: &Null) -> Deviants {
        let anchor = anchor(table);
        let falling = self.falling(table, null);

        let row = |row: usize| {
            let r = table.rows()[row];
            let (mut own, others) = if anchor == Some(row) {
                let anchored = nulls.ln_mixed(&self.shared(row_counts(table, row), r));
                (self.outside(table, row), anchored - null.ln)
            } else if r <= MULTIPLIED && table.total() <= MOST_VISITS {
                (
                    self.deviant(row_counts(table, row), r),
                    self.multiplied_without(table, row, &falling[r as usize - 1]),
                )
            } else {
                (
                    self.deviant(row_counts(table, row), r),
                    self.without(table, row, null) - null.ln,
                )
            };
            own.iter_mut().for_each(|own| *own += others);
            own
        };

        let rows: Vec<[f64; DEVIANTS]> = (0..table.rows().len()).map(row).collect();
        Deviants {
            untried: self.drivers.saturating_sub(rows.len() as u64) as f64,
            rows,
        }
    }

    /// Returns the same of one of several slices, beside what chance gives at its margins: the
    /// probability of drawing the row's visits from those of all rows, without replacement.
    ///
    /// Whatever the habits are, the mean of such a Bayes factor over independent tables with these
    /// margins is 1 at most, so that hundreds of slices in which nothing depends tell of nothing.
    /// By the null, whose habits are those of one of its components, each slice of other habits had
    /// a little for a row nearer to the base.
    pub fn deviants_at_margins(&self, table: &Table) -> Deviants {
        let anchor = anchor(table);
        let row = |row: usize| {
            let mut left: Vec<u64> = table.columns().to_vec();
            let counts: Vec<(usize, u64)> = table
                .row(row)
                .iter()
                .map(|cell| (cell.column as usize, cell.n))
                .collect();
            let own = if anchor == Some(row) {
                counts.iter().for_each(|(column, n)| left[*column] -= n);
                left.iter().copied().enumerate().collect()
            } else {
                counts
            };
            self.beside_draws(table, &own)
        };

        let rows: Vec<[f64; DEVIANTS]> = (0..table.rows().len()).map(row).collect();
        Deviants {
            untried: self.drivers.saturating_sub(rows.len() as u64) as f64,
            rows,
        }
    }

    /// Returns ln DM(n; k m) of counts by column for each slab, less that of drawing them in turn.
    fn beside_draws(&self, table: &Table, counts: &[(usize, u64)]) -> [f64; DEVIANTS] {
        let drawn = |all: u64, n: u64| ln_rising((all - n) as f64 + 1.0, n);
        let total: u64 = counts.iter().map(|(_, n)| n).sum();
        let of_columns: f64 = counts
            .iter()
            .map(|(column, n)| drawn(table.columns()[*column], *n))
            .sum();
        let chance = of_columns - drawn(table.total(), total);

        let labels = table.column_labels();
        let labelled = counts.iter().map(|(column, n)| (labels[*column], *n));
        self.deviant(labelled, total).map(|own| own - chance)
    }

    /// Returns ln sum_b v_b DM(c - n_i.; b m).
    fn without(&self, table: &Table, row: usize, null: &Null) -> f64 {
        let mut sums = null.ln_joint;
        for cell in table.row(row) {
            let (label, all) = (
                table.column_labels()[cell.column as usize],
                table.columns()[cell.column as usize],
            );
            self.columns.take_from(&mut sums, label as usize, all);
            self.columns.add_to(&mut sums, label as usize, all - cell.n);
        }

        self.totals.add_to(&mut sums, 0, table.total());
        self.totals
            .take_from(&mut sums, 0, table.total() - table.rows()[row]);

        ln_sum(&sums)
    }

    /// Returns the same less that of c, by the factors of the ratio: of few visits there are few,
    /// where each component would need an exponential of its own. `falling` is that of the row's
    /// visits.
    fn multiplied_without(&self, table: &Table, row: usize, falling: &[f64; NULLS]) -> f64 {
        let mut over = [1.0; NULLS];
        for cell in table.row(row) {
            let (label, all) = (
                table.column_labels()[cell.column as usize],
                table.columns()[cell.column as usize],
            );
            let parameters = self.columns.parameters(label as usize);
            (all - cell.n..all).for_each(|t| multiply(&mut over, parameters, t));
        }

        falling
            .iter()
            .zip(over)
            .map(|(falling, over)| falling / over)
            .sum::<f64>()
            .ln()
    }

    /// Returns (b + N - 1) ... (b + N - r) times the probability of each component of the null, for
    /// r from 1 on.
    fn falling(&self, table: &Table, null: &Null) -> Vec<[f64; NULLS]> {
        let mut product = null.components;
        let most = table
            .rows()
            .iter()
            .copied()
            .filter(|r| *r <= MULTIPLIED)
            .max()
            .unwrap_or(0);

        let step = |r| {
            multiply(&mut product, self.totals.parameters(0), table.total() - r);
            product
        };

        (1..=most).map(step).collect()
    }

    /// Returns ln DM of what is outside an anchor, as the response of its own that deviates.
    fn outside(&self, table: &Table, anchor: usize) -> [f64; DEVIANTS] {
        let mut left: Vec<u64> = table.columns().to_vec();
        table
            .row(anchor)
            .iter()
            .for_each(|cell| left[cell.column as usize] -= cell.n);
        let outside = table.column_labels().iter().copied().zip(left);
        self.deviant(outside, table.total() - table.rows()[anchor])
    }

    /// Returns ln DM(n; k m) of counts of the responder's letters for each slab.
    fn deviant(&self, counts: impl Iterator<Item = (u64, u64)>, total: u64) -> [f64; DEVIANTS] {
        let mut sums = [0.0; DEVIANTS];
        counts.for_each(|(label, n)| self.deviant_cells.add_to(&mut sums, label as usize, n));
        self.deviant_rows.take_from(&mut sums, 0, total);
        sums
    }
}

/// Multiplies each product with a + t.
fn multiply(products: &mut [f64; NULLS], parameters: &[f64; NULLS], t: u64) {
    products
        .iter_mut()
        .zip(parameters)
        .for_each(|(product, a)| *product *= a + t as f64);
}
