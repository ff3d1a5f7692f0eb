//! Mean and variance of mutual information where each row has its own response.
//!
//! Under one slab, row i of a state is Dirichlet with parameters a_ij = n_ij + k m_j, A_i = r_i + k, and the ego's policy is p_i = (r_i + 1/2) / (N +
//! R/2). With rho_ij = a_ij / A_i, q = sum_i p_i rho_i and L_ij = ln(rho_ij / q_j), L_i = sum_j rho_ij L_ij, in nats:
//!
//! * mean = E H(q) - sum_i p_i E H(row i), with E H(row i) = psi(A_i + 1) - sum_j a_ij psi(a_ij + 1) / A_i exact (Wolpert & Wolf 1995), and
//!   E H(q) = H(q) - 1/2 sum_ij p_i^2 rho_ij (1 - rho_ij) / ((A_i + 1) q_j) to second order;
//! * variance = sum_i p_i^2 (sum_j rho_ij L_ij^2 - L_i^2) / (A_i + 1) + (sum_i p_i L_i^2 - (sum_i p_i L_i)^2) / (N + R/2 + 1), to first order: the
//!   rows' and the policy's.
//!
//! Rows that were not visited are all alike, and columns that were not are alike up to their share m_j, for which every L_ij is the same: neither
//! is looked at one by one. A row is what it would be without visits, corrected in its occupied cells.

use crate::information::{Alphabet, Occupied, Table};

/// One slab as a slice sees it.
pub(super) struct Slab<'a> {
    /// The concentration k.
    pub concentration: f64,
    /// The occupied columns, by position.
    pub columns: &'a [Letter],
    /// What the columns that were not visited have together.
    pub rest: Rest,
}

/// One letter of the base of a slab.
#[derive(Clone, Copy)]
pub(super) struct Letter {
    /// m_j.
    pub share: f64,
    /// The term of k m_j.
    pub empty: Term,
}

/// Letters of the base of a slab, together.
#[derive(Clone, Copy, Default)]
pub(super) struct Rest {
    /// How many.
    pub letters: f64,
    /// sum m_j.
    pub share: f64,
    /// sum m_j ln m_j.
    pub x_ln_x: f64,
    /// sum k m_j psi(k m_j + 1).
    pub psi: f64,
}

/// What moments need to know of a number a > 0.
#[derive(Clone, Copy)]
pub(super) struct Term {
    /// a psi(a + 1).
    pub psi: f64,
    /// ln a.
    pub ln: f64,
}

impl Term {
    pub fn of(a: f64) -> Self {
        Self { psi: a * super::gamma::digamma(a + 1.0), ln: a.ln() }
    }
}

/// A mean and a variance, in nats and nats^2.
#[derive(Clone, Copy, Default)]
pub(super) struct Moments {
    pub mean: f64,
    pub variance: f64,
}

/// What a column contributes to every row before its cells are looked at.
#[derive(Clone, Copy, Default)]
struct Column {
    share: f64,
    /// ln(m_j / q_j).
    ln_ratio: f64,
    inverse_q: f64,
}

/// What columns contribute to a row that has no visits there: sums of m, m e, m e^2, m / q, m^2 / q with e = ln(m / q).
#[derive(Clone, Copy, Default)]
struct Empty([f64; 5]);

impl Empty {
    fn of(column: &Column) -> Self {
        let Column { share, ln_ratio, inverse_q } = *column;
        let tilted = share * ln_ratio;
        Self([share, tilted, tilted * ln_ratio, share * inverse_q, share * share * inverse_q])
    }

    fn plus(mut self, other: Self, sign: f64) -> Self {
        self.0.iter_mut().zip(other.0).for_each(|(sum, by)| *sum += sign * by);
        self
    }
}

/// Returns the moments of a slice under a slab; `psi_a1` gives psi(r + k + 1) of a row with r visits, `term` the term of n + k m_j at a column's
/// position.
pub(super) fn moments(
    table: &Table,
    alphabet: Alphabet,
    slab: &Slab,
    psi_a1: impl Fn(u64) -> f64,
    term: impl Fn(usize, u64) -> Term,
) -> Moments {
    let view = View::new(table, alphabet, slab);
    let mut sums = Sums::default();
    for (cells, &r) in table.cells().chunk_by(|a, b| a.row == b.row).zip(table.rows()) {
        sums.add(1.0, view.policy(r), r as f64 + slab.concentration, psi_a1(r), view.row(r, cells, &term));
    }
    if view.unvisited > 0.0 {
        sums.add(view.unvisited, view.policy(0), slab.concentration, psi_a1(0), view.row(0, &[], &term));
    }
    Moments {
        mean: view.entropy() - 0.5 * sums.curvature - sums.entropy,
        variance: sums.spread + (sums.square - sums.divergence * sums.divergence) / (view.weight + 1.0),
    }
}

/// What all rows of a slice have in common under a slab.
struct View<'a> {
    slab: &'a Slab<'a>,
    /// N + R/2.
    weight: f64,
    /// Rows that were not visited.
    unvisited: f64,
    /// sum_i p_i k / A_i: the part of q that is drawn from the base.
    drawn: f64,
    /// q_j of the occupied columns, by position.
    q: Vec<f64>,
    columns: Vec<Column>,
    /// What a row without visits has.
    empty: Empty,
    /// sum_j k m_j psi(k m_j + 1).
    empty_psi: f64,
}

/// One row: sum_j a_ij psi(a_ij + 1), sum_j rho (1 - rho) / q, sum_j rho L, sum_j rho L^2.
struct Row {
    psi: f64,
    curvature: f64,
    first: f64,
    second: f64,
}

/// Sums over rows: sum p E H(row), sum p^2 curvature / (A + 1), sum p^2 (sum rho L^2 - L_i^2) / (A + 1), sum p L_i, sum p L_i^2.
#[derive(Default)]
struct Sums {
    entropy: f64,
    curvature: f64,
    spread: f64,
    divergence: f64,
    square: f64,
}

impl Sums {
    fn add(&mut self, rows: f64, p: f64, a: f64, psi_a1: f64, row: Row) {
        self.entropy += rows * p * (psi_a1 - row.psi / a);
        self.curvature += rows * p * p * row.curvature / (a + 1.0);
        self.spread += rows * p * p * (row.second - row.first * row.first) / (a + 1.0);
        self.divergence += rows * p * row.first;
        self.square += rows * p * row.first * row.first;
    }
}

impl<'a> View<'a> {
    fn new(table: &Table, alphabet: Alphabet, slab: &'a Slab<'a>) -> Self {
        let mut view = Self {
            slab,
            weight: table.total() as f64 + 0.5 * alphabet.rows as f64,
            unvisited: alphabet.rows as f64 - table.rows().len() as f64,
            drawn: 0.0,
            q: Vec::new(),
            columns: Vec::new(),
            empty: Empty::default(),
            empty_psi: slab.rest.psi,
        };
        let share = |r: u64| view.policy(r) / (r as f64 + slab.concentration);
        let drawn = table.rows().iter().fold(view.unvisited * share(0), |sum, &r| sum + share(r)) * slab.concentration;
        // q_j = m_j drawn + sum_i p_i n_ij / A_i.
        let mut q: Vec<f64> = slab.columns.iter().map(|letter| letter.share * drawn).collect();
        for cell in table.cells() {
            q[cell.column as usize] += share(table.rows()[cell.row as usize]) * cell.n as f64;
        }
        view.drawn = drawn;
        view.q = q;
        view.look_at_columns();
        view
    }

    fn look_at_columns(&mut self) {
        let column = |(letter, q): (&Letter, &f64)| Column {
            share: letter.share,
            ln_ratio: (letter.share / q).ln(),
            inverse_q: 1.0 / q,
        };
        self.columns = self.slab.columns.iter().zip(&self.q).map(column).collect();
        // Of the columns that were not visited, m / q is 1 / drawn.
        let Rest { letters, share, .. } = self.slab.rest;
        let ln = -self.drawn.ln();
        self.empty = Empty([share, share * ln, share * ln * ln, letters / self.drawn, share / self.drawn]);
        for (column, letter) in self.columns.iter().zip(self.slab.columns) {
            self.empty = self.empty.plus(Empty::of(column), 1.0);
            self.empty_psi += letter.empty.psi;
        }
    }

    /// Returns p of a row with r visits.
    fn policy(&self, r: u64) -> f64 {
        (r as f64 + 0.5) / self.weight
    }

    /// Returns H(q).
    fn entropy(&self) -> f64 {
        let Rest { x_ln_x, share, .. } = self.slab.rest;
        -self.q.iter().fold(self.drawn * (x_ln_x + share * self.drawn.ln()), |sum, q| sum + q * q.ln())
    }

    /// Returns the sums of a row with r visits in these cells.
    fn row(&self, r: u64, cells: &[Occupied], term: impl Fn(usize, u64) -> Term) -> Row {
        let k = self.slab.concentration;
        let a = r as f64 + k;
        let (ln_k, ln_a) = (k.ln(), a.ln());
        let mut row = Row { psi: self.empty_psi, curvature: 0.0, first: 0.0, second: 0.0 };
        let mut empty = self.empty;
        for cell in cells {
            let at = cell.column as usize;
            let (letter, column, term) = (&self.slab.columns[at], &self.columns[at], term(at, cell.n));
            empty = empty.plus(Empty::of(column), -1.0);
            let rho = (cell.n as f64 + k * letter.share) / a;
            // ln(rho / q), by ln q = ln m - ln(m / q).
            let ln_ratio = term.ln - ln_a - (letter.empty.ln - ln_k) + column.ln_ratio;
            row.psi += term.psi - letter.empty.psi;
            row.curvature += rho * (1.0 - rho) * column.inverse_q;
            row.first += rho * ln_ratio;
            row.second += rho * ln_ratio * ln_ratio;
        }
        let (scale, shift) = (k / a, ln_k - ln_a);
        let Empty([m, e, e2, m_q, m2_q]) = empty;
        row.curvature += scale * m_q - scale * scale * m2_q;
        row.first += scale * (e + shift * m);
        row.second += scale * (e2 + 2.0 * shift * e + shift * shift * m);
        row
    }
}
