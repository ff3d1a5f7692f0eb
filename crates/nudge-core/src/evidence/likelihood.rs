//! Marginal likelihoods of contingency tables: the Dirichlet-multinomial evidence for each
//! component that fitting and answering share.
//!
//! For counts n_j seen in some order, with their distribution drawn from a Dirichlet of
//! concentration a and base m,
//!
//! ln DM(n; a m) = ln Gamma(a) - ln Gamma(a + n.) + sum_j [ln Gamma(n_j + a m_j) - ln Gamma(a m_j)]
//!
//! (the Polya distribution of a sequence; Minka 2000, "Estimating a Dirichlet distribution").

use super::base::Base;
use super::increments::{Increments, add};
use super::log_space::ln_sum;
use super::parameters::{
    AROUND, DEVIANT_CONCENTRATIONS, DEVIANTS, FIXED, FIXED_CONCENTRATIONS, FIXED_GRID,
    NULL_CONCENTRATIONS, NULLS, OWN_CONCENTRATIONS, OWN_GRID,
};
use crate::information::Table;
use crate::special_functions::ln_rising;

/// Visits outside the most visited row below which a slice is anchored at that row.
const ANCHORED_BELOW: u64 = 3;

/// The log marginal likelihoods of one slice of a state, for each component.
///
/// A slice of one occupied row or column says nothing about dependence, whatever these are.
pub(super) struct Evidence {
    /// ln DM(c; b m): all rows share one response.
    pub nulls: [f64; NULLS],
    /// Where nearly every visit is in one row, the same of that row alone, which then stands in
    /// both hypotheses alike: the rest of it is not evidence for dependence. Added to `fixed`.
    pub anchor: Option<[f64; NULLS]>,
    /// sum_i ln DM(n_i.; k m) over the rows that are not anchored: each row has its own response.
    pub fixed: [f64; FIXED],
    /// sum_i ln DM(n_i.; k mhat) - sum_j n_ij ln mhat_j over the same rows, with mhat the state's
    /// own marginal: relative to the null.
    pub own: [f64; OWN_GRID],
}

/// ln v of each component of the null; those of next to no weight are left out.
pub(super) struct NullMixture([f64; NULLS]);

impl NullMixture {
    /// Returns the mixture with these weights.
    pub fn new(weights: &[f64]) -> Self {
        /// A component below this is as if it were not there: others are never much less likely.
        const NEGLIGIBLE: f64 = 1e-6;
        let ln = |b: usize| {
            if weights[b] > NEGLIGIBLE {
                weights[b].ln()
            } else {
                f64::NEG_INFINITY
            }
        };
        Self(std::array::from_fn(ln))
    }

    /// Returns what the components say of a table together.
    pub fn given(&self, evidence: &[f64; NULLS]) -> Null {
        let mut ln_joint = self.0;
        add(&mut ln_joint, evidence);

        let largest = ln_joint.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut components = ln_joint;
        components
            .iter_mut()
            .for_each(|ln| *ln = (*ln - largest).exp());

        let sum: f64 = components.iter().sum();
        components
            .iter_mut()
            .for_each(|component| *component /= sum);

        Null {
            ln: largest + sum.ln(),
            ln_joint,
            components,
        }
    }

    /// Returns ln sum_b v_b e^l_b.
    pub fn ln_mixed(&self, evidence: &[f64; NULLS]) -> f64 {
        let mut ln_joint = self.0;
        add(&mut ln_joint, evidence);
        ln_sum(&ln_joint)
    }
}

/// A table as the null sees it.
pub(super) struct Null {
    /// ln sum_b v_b DM(c; b m).
    pub ln: f64,
    /// ln v_b DM(c; b m).
    pub ln_joint: [f64; NULLS],
    /// The probability of each component, given the table.
    pub components: [f64; NULLS],
}

/// The marginal likelihoods of one side, tabulated.
pub(super) struct Likelihood {
    /// Letters of the row variable.
    pub drivers: u64,
    /// What the column variable does on the whole.
    pub base: Base,
    cells: Increments<FIXED>,
    rows: Increments<OWN_GRID>,
    pub deviant_cells: Increments<DEVIANTS>,
    pub deviant_rows: Increments<DEVIANTS>,
    pub columns: Increments<NULLS>,
    pub totals: Increments<NULLS>,
    ln_concentrations: [f64; OWN_GRID],
}

/// Returns k m_j for each concentration: on a base, then on the uniform one.
fn on_both_bases<const GRID: usize, const L: usize>(
    concentrations: [f64; GRID],
    base: &Base,
) -> Vec<[f64; L]> {
    let uniform = 1.0 / base.shares().len() as f64;
    let letter = |share: &f64| {
        std::array::from_fn(|at| {
            concentrations[at % GRID] * if at < GRID { *share } else { uniform }
        })
    };
    base.shares().iter().map(letter).collect()
}

/// Returns the concentrations twice.
fn twice<const GRID: usize, const L: usize>(concentrations: [f64; GRID]) -> [f64; L] {
    std::array::from_fn(|at| concentrations[at % GRID])
}

impl Likelihood {
    pub fn new(drivers: u64, base: Base) -> Self {
        Self {
            cells: Increments::new(on_both_bases(FIXED_CONCENTRATIONS, &base)),
            rows: Increments::new(vec![OWN_CONCENTRATIONS]),
            deviant_cells: Increments::new(on_both_bases(DEVIANT_CONCENTRATIONS, &base)),
            deviant_rows: Increments::new(vec![twice(DEVIANT_CONCENTRATIONS)]),
            columns: Increments::new(on_both_bases(NULL_CONCENTRATIONS, &base)),
            totals: Increments::new(vec![twice(NULL_CONCENTRATIONS)]),
            ln_concentrations: OWN_CONCENTRATIONS.map(f64::ln),
            drivers,
            base,
        }
    }

    /// Returns what a slice says.
    pub fn evidence(&self, table: &Table) -> Evidence {
        let anchor = anchor(table);
        let rows = self.rows(table, anchor);
        Evidence {
            nulls: self.shared(columns(table), table.total()),
            anchor: anchor.map(|row| self.shared(row_counts(table, row), table.rows()[row])),
            fixed: self.fixed(table, anchor, &rows),
            own: self.own(table, anchor, &rows),
        }
    }

    /// Returns the evidence of the slabs on a part's own marginal, relative to the null.
    pub fn on_own_marginal(&self, part: &Table) -> [f64; OWN_GRID] {
        let anchor = anchor(part);
        self.own(part, anchor, &self.rows(part, anchor))
    }

    /// Returns sum_i ln DM(n_i.; k m) over all rows: how likely a part is whose rows have their own
    /// responses.
    pub fn rows_apart(&self, part: &Table) -> [f64; FIXED] {
        self.fixed(part, None, &self.rows(part, None))
    }

    /// Returns how much likelier parts are, each with habits of its own around those of all
    /// together, than with the same: the evidence of slabs on the marginal of the table of parts
    /// and letters, by its cells.
    pub fn around(&self, cells: impl Iterator<Item = (u64, u64, u64)>) -> [f64; AROUND] {
        let table = Table::from_counts(cells);
        if table.is_line() {
            return [0.0; AROUND];
        }
        let own = self.on_own_marginal(&table);
        std::array::from_fn(|at| own[at])
    }

    /// Returns ln DM of counts of the responder's letters under each component of the null.
    pub fn shared(&self, counts: impl Iterator<Item = (u64, u64)>, total: u64) -> [f64; NULLS] {
        let mut sums = [0.0; NULLS];
        counts.for_each(|(label, n)| self.columns.add_to(&mut sums, label as usize, n));
        self.totals.take_from(&mut sums, 0, total);
        sums
    }

    /// Returns sum_i ln Gamma(k + r_i) - ln Gamma(k) over the rows that are not anchored.
    fn rows(&self, table: &Table, anchor: Option<usize>) -> [f64; OWN_GRID] {
        let mut sums = [0.0; OWN_GRID];
        let rows = table
            .rows()
            .iter()
            .enumerate()
            .filter(|(row, _)| Some(*row) != anchor);
        rows.for_each(|(_, n)| self.rows.add_to(&mut sums, 0, *n));
        sums
    }

    fn fixed(&self, table: &Table, anchor: Option<usize>, rows: &[f64; OWN_GRID]) -> [f64; FIXED] {
        let mut sums = [0.0; FIXED];
        for cell in table
            .cells()
            .iter()
            .filter(|cell| Some(cell.row as usize) != anchor)
        {
            self.cells.add_to(
                &mut sums,
                table.column_labels()[cell.column as usize] as usize,
                cell.n,
            );
        }

        for sums in sums.chunks_mut(FIXED_GRID) {
            sums.iter_mut().zip(rows).for_each(|(sum, row)| *sum -= row);
        }
        sums
    }

    fn own(&self, table: &Table, anchor: Option<usize>, rows: &[f64; OWN_GRID]) -> [f64; OWN_GRID] {
        /// Cells up to this are multiplied out.
        const MULTIPLIED: u64 = 16;

        let mut sums = rows.map(|row| -row);
        let mut rising = Rising::new(table.total());
        for cell in table
            .cells()
            .iter()
            .filter(|cell| Some(cell.row as usize) != anchor)
        {
            let share = self.own_share(table, cell.column as usize);
            if cell.n <= MULTIPLIED {
                rising.multiply(share, cell.n);
            } else {
                let ln_share = cell.n as f64 * share.ln();
                add(
                    &mut sums,
                    &OWN_CONCENTRATIONS.map(|k| ln_rising(k * share, cell.n) - ln_share),
                );
            }
        }

        let visits = rising.visits as f64;
        sums.iter_mut()
            .zip(&self.ln_concentrations)
            .for_each(|(sum, ln_k)| *sum += visits * ln_k);
        add(&mut sums, &rising.ln());
        add(&mut sums, &marginal_volume(table, anchor));
        sums
    }

    /// Returns mhat_j = (c_j + g_j) / (N + 1) of the occupied column at a position.
    pub fn own_share(&self, table: &Table, column: usize) -> f64 {
        let label = table.column_labels()[column] as usize;
        (table.columns()[column] as f64 + self.base.shares()[label]) / (table.total() as f64 + 1.0)
    }
}

/// Rising factorials of k m_j, over (k m_j)^n, for each concentration of the slabs and many cells:
/// their factors are 1 + t / (k m_j), so that a product of dozens needs one logarithm.
struct Rising {
    products: [f64; OWN_GRID],
    /// ln of the products before.
    ln: [f64; OWN_GRID],
    /// Factors that a product can have, and those that this one has room for.
    most: u64,
    room: u64,
    /// Visits of all cells.
    visits: u64,
}

impl Rising {
    /// Begins for the cells of a table with this total, whose m_j are at least n_ij / (N + 1): no
    /// factor is above 1 + (N + 1) / k.
    fn new(total: u64) -> Self {
        /// ln of a number that is nearly too large for an `f64`.
        const LARGEST: f64 = 700.0;
        let most = (LARGEST / ((total as f64 + 1.0) / OWN_CONCENTRATIONS[0]).ln_1p()) as u64;

        Self {
            products: [1.0; OWN_GRID],
            ln: [0.0; OWN_GRID],
            most,
            room: most,
            visits: 0,
        }
    }

    /// Multiplies by those of a cell with n visits, n from 1 to 16, and the share m_j.
    fn multiply(&mut self, share: f64, n: u64) {
        const INVERSE: [f64; OWN_GRID] = {
            let mut inverse = OWN_CONCENTRATIONS;
            let mut at = 0;
            while at < OWN_GRID {
                inverse[at] = 1.0 / OWN_CONCENTRATIONS[at];
                at += 1;
            }
            inverse
        };

        if self.room < n - 1 {
            self.ln = self.ln();
            (self.products, self.room) = ([1.0; OWN_GRID], self.most);
        }

        let inverse_share = 1.0 / share;
        for t in 1..n {
            let step = t as f64 * inverse_share;
            self.products
                .iter_mut()
                .zip(INVERSE)
                .for_each(|(product, inverse)| *product *= 1.0 + step * inverse);
        }

        self.room -= n - 1;
        self.visits += n;
    }

    fn ln(&self) -> [f64; OWN_GRID] {
        let mut ln = self.ln;
        ln.iter_mut()
            .zip(self.products)
            .for_each(|(ln, product)| *ln += product.ln());
        ln
    }
}

/// Returns the log marginal likelihood sum_i ln DM(n_i.; k z_i) of a table whose row i has its own
/// response around z_i, whose shares are above 0.
pub fn rows_evidence(table: &Table, k: f64, share: impl Fn(usize, usize) -> f64) -> f64 {
    let cells = table
        .triples()
        .map(|(i, j, n)| ln_rising(k * share(i as usize, j as usize), n));
    cells.sum::<f64>() - table.rows().iter().map(|n| ln_rising(k, *n)).sum::<f64>()
}

/// Returns, for each concentration, the logarithm of how much wider a slab leaves the marginal than
/// the null does: the slab's evidence integrates over it, where only its best value is put in.
///
/// Rows of concentration k tell of their common base as much as N_e = sum_i r_i (k + 1) / (k + r_i)
/// draws would (the design effect of clusters; Brier 1980, "Analysis of contingency tables under
/// cluster sampling"). By Laplace's method that is 1/2 D ln(N / N_e), D the letters that are free
/// to vary. A letter that was hardly seen has no normal posterior: it counts as c / (c + 4).
/// Without it, weak dependence in large alphabets had too little evidence by half a nat and more,
/// and exactly as much as independent tables lose by it on the average.
fn marginal_volume(table: &Table, anchor: Option<usize>) -> [f64; OWN_GRID] {
    const HALF_SEEN: f64 = 4.0;

    let seen = table
        .columns()
        .iter()
        .map(|c| *c as f64 / (*c as f64 + HALF_SEEN));
    let free = (seen.sum::<f64>() - 1.0).max(0.0);
    if free == 0.0 {
        return [0.0; OWN_GRID];
    }

    let mut effective = [anchor.map_or(0.0, |row| table.rows()[row] as f64); OWN_GRID];
    for (_, r) in table
        .rows()
        .iter()
        .enumerate()
        .filter(|(row, _)| Some(*row) != anchor)
    {
        let r = *r as f64;
        effective
            .iter_mut()
            .zip(OWN_CONCENTRATIONS)
            .for_each(|(sum, k)| *sum += r * (k + 1.0) / (k + r));
    }

    effective.map(|effective| 0.5 * free * (table.total() as f64 / effective).ln())
}

/// Returns the cells of the table of parts and letters.
pub(super) fn by_part<'a>(
    parts: impl Iterator<Item = &'a Table>,
) -> impl Iterator<Item = (u64, u64, u64)> {
    (0..)
        .zip(parts)
        .flat_map(|(at, part)| columns(part).map(move |(label, n)| (at, label, n)))
}

/// Returns the label and the count of each occupied column.
pub(super) fn columns(table: &Table) -> impl Iterator<Item = (u64, u64)> {
    table
        .column_labels()
        .iter()
        .copied()
        .zip(table.columns().iter().copied())
}

/// Returns the label of the column and the count of each occupied cell of a row.
pub(super) fn row_counts(table: &Table, row: usize) -> impl Iterator<Item = (u64, u64)> {
    table
        .row(row)
        .iter()
        .map(|cell| (table.column_labels()[cell.column as usize], cell.n))
}

/// Returns the most visited row, the first of equals, where fewer than three visits are in the
/// others.
pub(super) fn anchor(table: &Table) -> Option<usize> {
    let most = table.rows().iter().copied().max()?;
    (table.total() - most < ANCHORED_BELOW).then(|| table.rows().iter().position(|n| *n == most))?
}

#[cfg(test)]
mod tests;
