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

use crate::information::{Alphabet, Table};

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

/// Sums over rows.
#[derive(Default)]
struct Sums {
    entropy: f64,
    curvature: f64,
    spread: f64,
    divergence: f64,
    square: f64,
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
    let k = slab.concentration;
    let weight = table.total() as f64 + 0.5 * alphabet.rows as f64;
    let unvisited = alphabet.rows as f64 - table.rows().len() as f64;
    let policy = |r: u64| (r as f64 + 0.5) / weight;

    // q_j = m_j drawn + sum_i p_i n_ij / A_i.
    let drawn = table.rows().iter().fold(unvisited * policy(0), |sum, &r| sum + policy(r) * k / (r as f64 + k));
    let mut q: Vec<f64> = slab.columns.iter().map(|letter| letter.share * drawn).collect();
    for cell in table.cells() {
        let r = table.rows()[cell.row as usize];
        q[cell.column as usize] += policy(r) * cell.n as f64 / (r as f64 + k);
    }
    let column = |(letter, q): (&Letter, &f64)| Column {
        share: letter.share,
        ln_ratio: (letter.share / q).ln(),
        inverse_q: 1.0 / q,
    };
    let columns: Vec<Column> = slab.columns.iter().zip(&q).map(column).collect();

    let ln_drawn = drawn.ln();
    let rest = &slab.rest;
    let mut empty = Empty([
        rest.share,
        -rest.share * ln_drawn,
        rest.share * ln_drawn * ln_drawn,
        rest.letters / drawn,
        rest.share / drawn,
    ]);
    let mut empty_psi = rest.psi;
    for (column, letter) in columns.iter().zip(slab.columns) {
        empty = empty.plus(Empty::of(column), 1.0);
        empty_psi += letter.empty.psi;
    }

    let mut sums = Sums::default();
    let mut add = |rows: f64, r: u64, cells: &[crate::information::Occupied]| {
        let (p, a) = (policy(r), r as f64 + k);
        let ln_a = a.ln();
        let (mut psi, mut left) = (empty_psi, empty);
        let [mut curvature, mut first, mut second] = [0.0; 3];
        for cell in cells {
            let at = cell.column as usize;
            let (letter, column) = (&slab.columns[at], &columns[at]);
            let term = term(at, cell.n);
            psi += term.psi - letter.empty.psi;
            left = left.plus(Empty::of(column), -1.0);
            let rho = (cell.n as f64 + k * letter.share) / a;
            // ln(rho / q), with ln q = ln m - ln(m / q).
            let ln_ratio = term.ln - ln_a - (letter.empty.ln - k.ln()) + column.ln_ratio;
            curvature += rho * (1.0 - rho) * column.inverse_q;
            first += rho * ln_ratio;
            second += rho * ln_ratio * ln_ratio;
        }
        let (scale, shift) = (k / a, k.ln() - ln_a);
        let Empty([m, e, e2, m_q, m2_q]) = left;
        curvature += scale * m_q - scale * scale * m2_q;
        first += scale * (e + shift * m);
        second += scale * (e2 + 2.0 * shift * e + shift * shift * m);
        sums.entropy += rows * p * (psi_a1(r) - psi / a);
        sums.curvature += rows * p * p * curvature / (a + 1.0);
        sums.spread += rows * p * p * (second - first * first) / (a + 1.0);
        sums.divergence += rows * p * first;
        sums.square += rows * p * first * first;
    };
    for (row, cells) in table.cells().chunk_by(|a, b| a.row == b.row).enumerate() {
        add(1.0, table.rows()[row], cells);
    }
    if unvisited > 0.0 {
        add(unvisited, 0, &[]);
    }

    let entropy = -q.iter().fold(drawn * (rest.x_ln_x + rest.share * ln_drawn), |sum, q| sum + q * q.ln());
    Moments {
        mean: entropy - 0.5 * sums.curvature - sums.entropy,
        variance: sums.spread + (sums.square - sums.divergence * sums.divergence) / (weight + 1.0),
    }
}
