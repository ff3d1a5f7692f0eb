//! How likely a table is under each component: the Dirichlet-multinomial evidence that fitting and answering share.
//!
//! For counts n_j seen in some order, with their distribution drawn from a Dirichlet of concentration a and base m,
//! ln DM(n; a m) = ln Gamma(a) - ln Gamma(a + n.) + sum_j [ln Gamma(n_j + a m_j) - ln Gamma(a m_j)]
//! (the Polya distribution of a sequence; Minka 2000, "Estimating a Dirichlet distribution").

use super::base::Base;
use super::gamma::ln_rising;
use super::increments::{Increments, add};
use super::parameters::{
    DEVIANT_CONCENTRATIONS, DEVIANT_GRID, DEVIANTS, FIXED, NULL_CONCENTRATIONS, NULL_GRID, NULLS, SLAB_CONCENTRATIONS,
    SLAB_GRID,
};
use crate::information::Table;

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

/// The components of the null that have any weight, and ln v of each.
pub(super) struct NullMixture(Vec<(usize, f64)>);

impl NullMixture {
    /// Returns the mixture with these weights.
    pub fn new(weights: &[f64]) -> Self {
        /// A component below this is as if it were not there: others are never much less likely.
        const NEGLIGIBLE: f64 = 1e-6;
        Self(
            (0..)
                .zip(weights)
                .filter(|(_, weight)| **weight > NEGLIGIBLE)
                .map(|(b, weight)| (b, weight.ln()))
                .collect(),
        )
    }

    /// Returns the probabilities of the components, given their evidence.
    pub fn posterior(&self, evidence: &[f64; NULLS]) -> [f64; NULLS] {
        let mut logarithms = [f64::NEG_INFINITY; NULLS];
        self.0.iter().for_each(|(b, ln_weight)| logarithms[*b] = evidence[*b] + ln_weight);
        super::fit::normalised(logarithms)
    }

    /// Returns ln sum_b v_b e^l_b.
    pub fn ln_mixed(&self, ln: impl Fn(usize) -> f64) -> f64 {
        let mut logarithms = [f64::NEG_INFINITY; NULLS];
        self.0.iter().zip(&mut logarithms).for_each(|((b, ln_weight), sum)| *sum = ln(*b) + ln_weight);
        super::prior::ln_sum(&logarithms[..self.0.len()])
    }
}

/// The tables that evidence is looked up in.
pub(super) struct Likelihood {
    /// Letters of the row variable.
    pub drivers: u64,
    /// What the column variable does on the whole.
    pub base: Base,
    cells: [Increments<SLAB_GRID>; 2],
    rows: Increments<SLAB_GRID>,
    deviant_cells: [Increments<DEVIANT_GRID>; 2],
    deviant_rows: Increments<DEVIANT_GRID>,
    columns: [Increments<NULL_GRID>; 2],
    totals: Increments<NULL_GRID>,
}

impl Likelihood {
    pub fn new(drivers: u64, base: Base) -> Self {
        let uniform = [1.0 / base.shares().len().max(1) as f64];
        let shares = base.shares();
        Self {
            cells: [shares, &uniform].map(|shares| Increments::new(SLAB_CONCENTRATIONS, shares)),
            rows: Increments::new(SLAB_CONCENTRATIONS, &[1.0]),
            deviant_cells: [shares, &uniform].map(|shares| Increments::new(DEVIANT_CONCENTRATIONS, shares)),
            deviant_rows: Increments::new(DEVIANT_CONCENTRATIONS, &[1.0]),
            columns: [shares, &uniform].map(|shares| Increments::new(NULL_CONCENTRATIONS, shares)),
            totals: Increments::new(NULL_CONCENTRATIONS, &[1.0]),
            drivers,
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
        let sums = self.shared_sums(counts);
        let total = self.totals.of(0, total);
        std::array::from_fn(|b| sums[b] - total[b % NULL_GRID])
    }

    /// Returns sum_j ln Gamma(c_j + b m_j) - ln Gamma(b m_j) for each component of the null.
    fn shared_sums(&self, counts: impl Iterator<Item = (u64, u64)>) -> [f64; NULLS] {
        let mut sums = [0.0; NULLS];
        for (label, n) in counts {
            add(&mut sums[..NULL_GRID], self.columns[0].of(label as usize, n));
            add(&mut sums[NULL_GRID..], self.columns[1].of(0, n));
        }
        sums
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

    /// The rising factorials are over (k mhat_j)^n: their factors are then 1 + t / (k mhat_j), at most 1 + (N + 1) / k, and a product of many of them needs
    /// one logarithm.
    fn own(&self, table: &Table, anchor: Option<usize>, rows: &[f64; SLAB_GRID]) -> [f64; SLAB_GRID] {
        /// 1,000^100 is not too large for an `f64`.
        const FACTORS: u64 = 100;
        /// Cells up to this are multiplied out, in tables up to FACTORS - 10 visits.
        const MULTIPLIED: u64 = 16;
        const INVERSE: [f64; SLAB_GRID] = {
            let mut inverse = SLAB_CONCENTRATIONS;
            let mut at = 0;
            while at < SLAB_GRID {
                inverse[at] = 1.0 / SLAB_CONCENTRATIONS[at];
                at += 1;
            }
            inverse
        };
        let ln_concentrations = SLAB_CONCENTRATIONS.map(f64::ln);
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
                for (product, inverse) in products.iter_mut().zip(INVERSE) {
                    *product *= 1.0 + step * inverse;
                }
            }
            factors += cell.n;
        }
        debug_assert!(factors <= FACTORS);
        add(
            &mut sums,
            std::array::from_fn::<_, SLAB_GRID, _>(|k| products[k].ln() + factors as f64 * ln_concentrations[k]),
        );
        sums
    }

    /// Returns ln 1/R sum_i DM(c - n_i.; b m) DM(n_i.; k m) / DM(c; b m): one row has a response of its own, tried or not, and all others share one.
    /// `rows` are the terms of the visited ones.
    pub fn deviants(&self, rows: &[[f64; DEVIANTS]]) -> [f64; DEVIANTS] {
        let untried = self.drivers.saturating_sub(rows.len() as u64) as f64;
        // Where every row was tried, all terms may be too small for an exponential.
        let least = if untried > 0.0 { 0.0 } else { f64::NEG_INFINITY };
        let mean = |k: usize| {
            let largest = rows.iter().fold(least, |largest: f64, row| largest.max(row[k]));
            let tried: f64 = rows.iter().map(|row| (row[k] - largest).exp()).sum();
            let rest = if untried > 0.0 { untried * (-largest).exp() } else { 0.0 };
            largest + ((tried + rest) / self.drivers as f64).ln()
        };
        std::array::from_fn(mean)
    }

    /// Returns ln DM(c - n_i.; b m) DM(n_i.; k m) / DM(c; b m) for each visited row i; for another one it would be 0.
    ///
    /// The shared response is that of the null, mixed, so that who fits the marginal better wins nothing. Where a slice is anchored, it is what is outside
    /// the anchor that may deviate from it.
    pub fn deviant_rows(&self, table: &Table, nulls: &NullMixture) -> Vec<[f64; DEVIANTS]> {
        let columns = table.column_labels().iter().copied().zip(table.columns().iter().copied());
        let shared = self.shared_sums(columns);
        let null = self.mixed(&shared, table.total(), nulls);
        let anchor = anchor(table);
        let relative = |row: usize| {
            let (r, cells) = (table.rows()[row], table.row(row));
            let counts = || cells.iter().map(|cell| (table.column_labels()[cell.column as usize], cell.n));
            let (own, others) = if anchor == Some(row) {
                (self.outside(table, row), self.mixed(&self.shared_sums(counts()), r, nulls))
            } else {
                let rest = self.without(shared, table, row);
                (self.deviant(counts(), r), self.mixed(&rest, table.total() - r, nulls))
            };
            own.map(|own| own + others - null)
        };
        (0..table.rows().len()).map(relative).collect()
    }

    /// Takes a row out of the sums of the shared response.
    fn without(&self, mut sums: [f64; NULLS], table: &Table, row: usize) -> [f64; NULLS] {
        for cell in table.row(row) {
            let (label, all) = (table.column_labels()[cell.column as usize], table.columns()[cell.column as usize]);
            for (base, letter) in [label as usize, 0].into_iter().enumerate() {
                let [all, left] = [all, all - cell.n].map(|n| self.columns[base].of(letter, n));
                add(&mut sums[base * NULL_GRID..], std::array::from_fn::<_, NULL_GRID, _>(|b| left[b] - all[b]));
            }
        }
        sums
    }

    /// Returns ln DM of what is outside an anchor, as the response of its own that deviates.
    fn outside(&self, table: &Table, anchor: usize) -> [f64; DEVIANTS] {
        let mut left: Vec<u64> = table.columns().to_vec();
        table.row(anchor).iter().for_each(|cell| left[cell.column as usize] -= cell.n);
        let outside = table.column_labels().iter().copied().zip(left);
        self.deviant(outside, table.total() - table.rows()[anchor])
    }

    /// Returns ln DM(n; k m) of counts of the other's actions for each deviant.
    fn deviant(&self, counts: impl Iterator<Item = (u64, u64)>, total: u64) -> [f64; DEVIANTS] {
        let mut sums = [0.0; DEVIANTS];
        for (label, n) in counts {
            add(&mut sums[..DEVIANT_GRID], self.deviant_cells[0].of(label as usize, n));
            add(&mut sums[DEVIANT_GRID..], self.deviant_cells[1].of(0, n));
        }
        let total = self.deviant_rows.of(0, total);
        std::array::from_fn(|k| sums[k] - total[k % DEVIANT_GRID])
    }

    /// Returns ln sum_b v_b DM(c; b m).
    fn mixed(&self, sums: &[f64; NULLS], total: u64, nulls: &NullMixture) -> f64 {
        let total = self.totals.of(0, total);
        nulls.ln_mixed(|b| sums[b] - total[b % NULL_GRID])
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
