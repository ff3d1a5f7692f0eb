//! How likely a table is under each component: the Dirichlet-multinomial evidence that fitting and answering share.
//!
//! For counts n_j seen in some order, with their distribution drawn from a Dirichlet of concentration a and base m,
//! ln DM(n; a m) = ln Gamma(a) - ln Gamma(a + n.) + sum_j [ln Gamma(n_j + a m_j) - ln Gamma(a m_j)]
//! (the Polya distribution of a sequence; Minka 2000, "Estimating a Dirichlet distribution").

use super::base::Base;
use super::gamma::ln_rising;
use super::increments::{Increments, add};
use super::parameters::{FIXED, NULL_CONCENTRATIONS, NULL_GRID, NULLS, SLAB_CONCENTRATIONS, SLAB_GRID};
use crate::information::{Alphabet, Table};

/// Visits outside the most visited row below which a slice is anchored at that row.
const ANCHORED_BELOW: u64 = 3;

/// What one slice of a state says for each component, all in logarithms.
///
/// A slice of one occupied row or column says nothing about dependence, and has none of these.
pub(super) struct Evidence {
    /// ln DM(c; b m): all rows share one response.
    pub nulls: [f64; NULLS],
    /// Where nearly every visit is in one row, the same of that row alone, which then stands in both hypotheses alike: the rest of it is not
    /// evidence for dependence. Added to `fixed`.
    pub anchor: Option<[f64; NULLS]>,
    /// sum_i ln DM(n_i.; k m) over the rows that are not anchored: each row has its own response.
    pub fixed: [f64; FIXED],
    /// sum_i ln DM(n_i.; k mhat) - sum_j n_ij ln mhat_j over the same rows, with mhat the state's own marginal: relative to the null.
    pub own: [f64; SLAB_GRID],
}

/// The tables that evidence is looked up in.
pub(super) struct Likelihood {
    pub alphabet: Alphabet,
    pub base: Base,
    cells: [Increments<SLAB_GRID>; 2],
    rows: Increments<SLAB_GRID>,
    columns: [Increments<NULL_GRID>; 2],
    totals: Increments<NULL_GRID>,
}

impl Likelihood {
    pub fn new(alphabet: Alphabet, base: Base) -> Self {
        let uniform = [1.0 / alphabet.columns.max(1) as f64];
        let shares = base.shares();
        Self {
            cells: [shares, &uniform].map(|shares| Increments::new(SLAB_CONCENTRATIONS, shares)),
            rows: Increments::new(SLAB_CONCENTRATIONS, &[1.0]),
            columns: [shares, &uniform].map(|shares| Increments::new(NULL_CONCENTRATIONS, shares)),
            totals: Increments::new(NULL_CONCENTRATIONS, &[1.0]),
            alphabet,
            base,
        }
    }

    /// Returns what a slice says, if it says anything.
    pub fn evidence(&self, table: &Table) -> Option<Evidence> {
        if table.is_line() {
            return None;
        }
        let anchor = anchor(table);
        let columns = table.column_labels().iter().zip(table.columns());
        let nulls = self.shared(columns.map(|(label, n)| (*label, *n)), table.total());
        let anchored = anchor.map(|row| {
            let cells = table.row(row).iter();
            self.shared(cells.map(|cell| (table.column_labels()[cell.column as usize], cell.n)), table.rows()[row])
        });
        let rows = self.rows(table, anchor);
        Some(Evidence {
            nulls,
            anchor: anchored,
            fixed: self.fixed(table, anchor, &rows),
            own: self.own(table, anchor, &rows),
        })
    }

    /// Returns ln DM of counts of the other's actions under each component of the null.
    pub fn shared(&self, counts: impl Iterator<Item = (u64, u64)>, total: u64) -> [f64; NULLS] {
        let mut sums = [0.0; NULLS];
        for (label, n) in counts {
            add(&mut sums[..NULL_GRID], self.columns[0].of(label as usize, n));
            add(&mut sums[NULL_GRID..], self.columns[1].of(0, n));
        }
        let total = self.totals.of(0, total);
        std::array::from_fn(|b| sums[b] - total[b % NULL_GRID])
    }

    /// Returns sum_i ln Gamma(k + r_i) - ln Gamma(k) over the rows that are not anchored.
    fn rows(&self, table: &Table, anchor: Option<usize>) -> [f64; SLAB_GRID] {
        let mut sums = [0.0; SLAB_GRID];
        for (row, n) in table.rows().iter().enumerate() {
            if Some(row) != anchor {
                add(&mut sums, self.rows.of(0, *n));
            }
        }
        sums
    }

    fn fixed(&self, table: &Table, anchor: Option<usize>, rows: &[f64; SLAB_GRID]) -> [f64; FIXED] {
        let mut sums = [0.0; FIXED];
        for cell in table.cells().iter().filter(|cell| Some(cell.row as usize) != anchor) {
            add(&mut sums[..SLAB_GRID], self.cells[0].of(table.column_labels()[cell.column as usize] as usize, cell.n));
            add(&mut sums[SLAB_GRID..], self.cells[1].of(0, cell.n));
        }
        std::array::from_fn(|slab| sums[slab] - rows[slab % SLAB_GRID])
    }

    /// The rising factorials are over mhat_j^n: their factors are then k + t / mhat_j, at least k and at most k + N + 1, and a product of many of
    /// them needs one logarithm.
    fn own(&self, table: &Table, anchor: Option<usize>, rows: &[f64; SLAB_GRID]) -> [f64; SLAB_GRID] {
        /// 90^100 and 0.1^100 are far from the ends of an `f64`.
        const FACTORS: u64 = 100;
        /// Cells up to this are multiplied out, in tables up to FACTORS - 10 visits.
        const MULTIPLIED: u64 = 16;
        let mut sums = rows.map(|row| -row);
        let (mut products, mut factors) = ([1.0; SLAB_GRID], 0);
        for cell in table.cells().iter().filter(|cell| Some(cell.row as usize) != anchor) {
            let share = self.own_share(table, cell.column as usize);
            if cell.n > MULTIPLIED || table.total() > FACTORS {
                let ln_share = cell.n as f64 * share.ln();
                add(&mut sums, SLAB_CONCENTRATIONS.map(|k| ln_rising(k * share, cell.n) - ln_share));
                continue;
            }
            for t in 0..cell.n {
                let step = t as f64 / share;
                for (product, k) in products.iter_mut().zip(SLAB_CONCENTRATIONS) {
                    *product *= k + step;
                }
            }
            factors += cell.n;
        }
        debug_assert!(factors <= FACTORS);
        add(&mut sums, products.map(f64::ln));
        sums
    }

    /// Returns mhat_j = (c_j + g_j) / (N + 1) of the occupied column at a position.
    pub fn own_share(&self, table: &Table, column: usize) -> f64 {
        let label = table.column_labels()[column] as usize;
        (table.columns()[column] as f64 + self.base.shares()[label]) / (table.total() as f64 + 1.0)
    }
}

/// Returns sum_i ln DM(n_i.; k z_i): how likely a table is where row i has its own response around z_i, whose shares are above 0.
pub fn rows_evidence(table: &Table, k: f64, share: impl Fn(usize, usize) -> f64) -> f64 {
    let label = |labels: &[u64], at: u32| labels[at as usize] as usize;
    let cells = table.cells().iter().map(|cell| {
        let (i, j) = (label(table.row_labels(), cell.row), label(table.column_labels(), cell.column));
        ln_rising(k * share(i, j), cell.n)
    });
    cells.sum::<f64>() - table.rows().iter().map(|n| ln_rising(k, *n)).sum::<f64>()
}

/// Returns the most visited row, the first of equals, where fewer than three visits are in the others.
fn anchor(table: &Table) -> Option<usize> {
    let most = table.rows().iter().copied().max()?;
    (table.total() - most < ANCHORED_BELOW).then(|| table.rows().iter().position(|n| *n == most))?
}
