//! Posterior mean and variance of mutual information where each row has its own response.
//!
//! Under one slab, row i of a state is Dirichlet with parameters a_ij = n_ij + k m_j,
//! A_i = r_i + k. The driver's policy is Dirichlet with mean p_i = (r_i + kappa h_i) / S and
//! concentration S = N + kappa, h being its mean policy in the environment. With
//!
//! * P_i = E p_i^2 = p_i^2 + p_i (1 - p_i) / (S + 1),
//! * rho_ij = a_ij / A_i and q = sum_i p_i rho_i,
//! * L_ij = ln(rho_ij / q_j) and L_i = sum_j rho_ij L_ij,
//!
//! in nats:
//!
//! * mean = E H(q) - sum_i p_i E H(row i). The rows' entropies are exact (Wolpert & Wolf 1995),
//!
//!   E H(row i) = psi(A_i + 1) - sum_j a_ij psi(a_ij + 1) / A_i.
//!
//!   E H(q) is that of Beta distributions matched to each q_j by its variance v_j, and unlike a
//!   Taylor term never negative:
//!
//!   v_j = sum_i P_i rho_ij (1 - rho_ij) / (A_i + 1) + (sum_i p_i rho_ij^2 - q_j^2) / (S + 1),
//!
//!   s_j = q_j (1 - q_j) / v_j - 1,
//!
//!   E H(q) = -sum_j q_j [psi(q_j s_j + 1) - psi(s_j + 1)];
//!
//! * variance, to first order the rows' and the policy's,
//!
//!   sum_i P_i (sum_j rho_ij L_ij^2 - L_i^2) / (A_i + 1)
//!   + (sum_i p_i L_i^2 - (sum_i p_i L_i)^2) / (S + 1),
//!
//!   and of second order that of [`Freedom`] with d = mean - sum_i p_i L_i, which is all there is
//!   where rows are alike.
//!
//! Rows that were not visited have the same response, and columns that were not are alike but for
//! their share m_j: neither is looked at one by one. A row is what it would be without visits,
//! corrected in its occupied cells.

use super::base::Alike;
use super::deviants::Deviants;
use super::freedom::Freedom;
use super::habits::Usage;
use crate::information::{Occupied, Table};
use crate::special_functions::{digamma, digamma_difference};

/// A slice as a side reads it, with what all slabs have in common there.
pub(super) struct Slice<'a> {
    pub table: &'a Table,
    pub deviants: &'a Deviants,
    pub policy: Policy<'a>,
    /// The columns that were not visited: how many have which share of the environment's base.
    pub rest: Vec<Alike>,
    drivers: Vec<Driver>,
    pub unvisited: Unvisited,
    /// How many slices it stands for, which are as good as equal.
    pub times: f64,
}

impl<'a> Slice<'a> {
    /// Looks at a table, given the driver's policy in it and the columns that were not visited.
    pub fn new(
        table: &'a Table,
        deviants: &'a Deviants,
        policy: Policy<'a>,
        rest: Vec<Alike>,
    ) -> Self {
        let driver = |(label, r): (&u64, &u64)| {
            let p = policy.probability(*label, *r);
            Driver {
                r: *r,
                p,
                square: policy.square(p),
            }
        };

        let drivers = table
            .row_labels()
            .iter()
            .zip(table.rows())
            .map(driver)
            .collect();

        Self {
            drivers,
            unvisited: policy.unvisited(table),
            table,
            deviants,
            policy,
            rest,
            times: 1.0,
        }
    }

    /// Returns the same for so many slices that are as good as equal.
    pub fn for_all(self, slices: usize) -> Self {
        Self {
            times: slices as f64,
            ..self
        }
    }
}

/// One slab as a slice sees it.
pub(super) struct Slab<'a> {
    /// The concentration k.
    pub concentration: f64,
    /// The occupied columns, by position.
    pub columns: &'a [Letter],
    /// sum_j k m_j psi(k m_j + 1) over all columns.
    pub psi: f64,
    /// The columns that were not visited: how many have which share.
    pub rest: &'a [Alike],
}

/// One letter of the base of a slab.
#[derive(Clone, Copy)]
pub(super) struct Letter {
    /// m_j.
    pub share: f64,
    /// The term of k m_j.
    pub empty: Term,
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
    pub fn new(a: f64) -> Self {
        Self {
            psi: a * digamma(a + 1.0),
            ln: a.ln(),
        }
    }
}

/// A mean and a variance, in nats and nats^2.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Moments {
    pub mean: f64,
    pub variance: f64,
    /// A larger variance, for what has to be on the safe side.
    pub wide: f64,
}

impl Moments {
    /// Returns the same with this part of the mean added to the standard deviation, in squares.
    pub fn doubted(self, part: f64) -> Self {
        let more = (part * self.mean).powi(2);
        Self {
            variance: self.variance + more,
            wide: self.wide + more,
            ..self
        }
    }

    /// Returns the moments of so many times as much.
    pub fn scaled(self, by: f64) -> Self {
        Self {
            mean: by * self.mean,
            variance: by * by * self.variance,
            wide: by * by * self.wide,
        }
    }

    /// Returns the moments of a mixture, given weights and the moments of its parts.
    pub fn mixed(parts: &[(f64, Self)]) -> Self {
        let total: f64 = parts.iter().map(|(weight, _)| weight).sum();
        let over = |figure: &dyn Fn(&Self) -> f64| {
            parts
                .iter()
                .map(|(weight, part)| weight * figure(part))
                .sum::<f64>()
                / total
        };

        let mean = over(&|part| part.mean);
        let off = |part: &Self| (part.mean - mean).powi(2);

        Self {
            mean,
            variance: over(&|part| part.variance + off(part)),
            wide: over(&|part| part.wide + off(part)),
        }
    }
}

/// The driver's policy in a slice.
pub(super) struct Policy<'a> {
    usage: &'a Usage,
    /// kappa.
    concentration: f64,
    /// S = N + kappa.
    pub weight: f64,
}

impl<'a> Policy<'a> {
    /// Returns the policy behind so many visits; `habit` is the fitted concentration. Without one
    /// it is half a visit for each action in use.
    pub fn new(visits: u64, usage: &'a Usage, habit: Option<f64>) -> Self {
        let concentration = habit.unwrap_or(0.5 * usage.used as f64);
        Self {
            usage,
            concentration,
            weight: visits as f64 + concentration,
        }
    }

    /// Returns p of the row of a label with r visits.
    pub fn probability(&self, label: u64, r: u64) -> f64 {
        (r as f64 + self.concentration * self.usage.shares[label as usize]) / self.weight
    }

    /// Returns the share kappa / S of the mean policy in it.
    pub fn habitual(&self) -> f64 {
        self.concentration / self.weight
    }

    /// Returns the parameters kappa h_i + r_i of the Dirichlet distribution of the policy in a
    /// table, by label.
    pub fn parameters(&self, table: &Table) -> Vec<f64> {
        let parameter =
            |(label, h): (u64, &f64)| self.concentration * h + table.row_sum(label) as f64;
        (0..).zip(&self.usage.shares).map(parameter).collect()
    }

    /// Returns E p^2.
    pub fn square(&self, p: f64) -> f64 {
        p * p + p * (1.0 - p) / (self.weight + 1.0)
    }

    /// Returns the rows in use that were not visited.
    pub fn unvisited(&self, table: &Table) -> Unvisited {
        let shares = table
            .row_labels()
            .iter()
            .map(|label| self.usage.shares[*label as usize]);

        // A row may have been visited first after its use was counted.
        let all = [self.usage.used as f64, 1.0, self.usage.squares];
        let [rows, sum, squares] = shares.fold(all, |[rows, sum, squares], h| {
            [rows - f64::from(h > 0.0), sum - h, squares - h * h]
        });
        if rows == 0.0 {
            return Unvisited::default();
        }

        let scale = self.concentration / self.weight;
        let [p, squared] = [scale * sum.max(0.0), scale * scale * squares.max(0.0)];

        Unvisited {
            rows,
            p,
            squared,
            square: squared + (p - squared) / (self.weight + 1.0),
        }
    }
}

/// Rows that are in use and were not visited, together.
#[derive(Clone, Copy, Default)]
pub(super) struct Unvisited {
    /// How many.
    pub rows: f64,
    /// sum p.
    pub p: f64,
    /// sum p^2.
    squared: f64,
    /// sum E p^2.
    pub square: f64,
}

/// What a column contributes to every row before its cells are looked at.
#[derive(Clone, Copy, Default)]
struct Column {
    share: f64,
    /// ln q_j.
    ln_q: f64,
    /// ln(m_j / q_j).
    ln_ratio: f64,
}

/// What columns contribute to a row that has no visits there: sums of m, m e, m e^2 with
/// e = ln(m / q).
#[derive(Clone, Copy, Default)]
struct Empty([f64; 3]);

impl Empty {
    fn of_column(column: &Column) -> Self {
        let Column {
            share, ln_ratio, ..
        } = *column;
        let tilted = share * ln_ratio;
        Self([share, tilted, tilted * ln_ratio])
    }

    fn plus(mut self, other: Self, sign: f64) -> Self {
        self.0
            .iter_mut()
            .zip(other.0)
            .for_each(|(sum, by)| *sum += sign * by);
        self
    }
}

/// What moments need to know of a row's concentration A = r + k.
#[derive(Clone, Copy)]
pub(super) struct Concentration {
    /// ln A.
    pub ln: f64,
    /// psi(A + 1).
    pub psi: f64,
}

impl Concentration {
    pub fn new(a: f64) -> Self {
        Self {
            ln: a.ln(),
            psi: digamma(a + 1.0),
        }
    }
}

/// Returns the moments of a slice under a slab; `concentration` gives that of a row with r visits,
/// `term` the term of n + k m_j at a column's position.
pub(super) fn moments(
    slice: &Slice<'_>,
    slab: &Slab<'_>,
    concentration: impl Fn(u64) -> Concentration,
    term: impl Fn(usize, u64) -> Term,
) -> Moments {
    let view = View::new(slice, slab);
    let mut sums = Sums::default();
    for (row, cells) in slice
        .table
        .cells()
        .chunk_by(|a, b| a.row == b.row)
        .enumerate()
    {
        let (driver, concentration) = (&view.drivers[row], concentration(slice.drivers[row].r));
        sums.add(
            driver,
            concentration.psi,
            view.row(driver, concentration.ln, cells, &term),
        );
    }

    if view.unvisited.p > 0.0 {
        let concentration = concentration(0);
        sums.add(
            &view.unvisited,
            concentration.psi,
            view.row(&view.unvisited, concentration.ln, &[], &term),
        );
    }

    sums.moments(view.marginal_entropy, slice.policy.weight, &view.freedom)
}

/// A visited row: r, p and E p^2.
#[derive(Clone, Copy)]
struct Driver {
    r: u64,
    p: f64,
    square: f64,
}

/// One column under two rows: their Dirichlet parameters there, and how many columns are like it.
pub(super) struct Pair {
    pub a: [f64; 2],
    /// Those of the parameters.
    pub terms: [Term; 2],
    pub letters: f64,
}

/// Returns the moments where the row that deviates has the probability p, all others share a
/// response, and the columns have these parameters.
pub(super) fn two_rows(p: f64, policy: &Policy<'_>, columns: &[Pair]) -> Moments {
    let p = [1.0 - p, p];
    let square = p.map(|p| policy.square(p));
    let concentrations = [0, 1].map(|row| {
        columns
            .iter()
            .map(|column| column.letters * column.a[row])
            .sum::<f64>()
    });

    let mut freedom = Freedom::default();
    // One deviation makes up both rows.
    freedom.add_row(p[1], concentrations[1]);
    let mut entropy = 0.0;
    let mut rows = [Row::default(), Row::default()];

    let ln_concentrations = concentrations.map(f64::ln);
    for Pair { a, terms, letters } in columns {
        let rho = [a[0] / concentrations[0], a[1] / concentrations[1]];
        let mean = p[0] * rho[0] + p[1] * rho[1];
        let own = [0, 1]
            .map(|row| square[row] * rho[row] * (1.0 - rho[row]) / (concentrations[row] + 1.0));
        let squares = p[0] * rho[0] * rho[0] + p[1] * rho[1] * rho[1] - mean * mean;
        entropy += letters
            * Share {
                mean,
                variance: own[0] + own[1] + squares.max(0.0) / (policy.weight + 1.0),
            }
            .entropy();

        freedom.add_letters(mean, *letters);
        let ln_mean = mean.ln();
        for (row, sums) in rows.iter_mut().enumerate() {
            let ln_ratio = terms[row].ln - ln_concentrations[row] - ln_mean;
            sums.psi += letters * terms[row].psi;
            sums.first += letters * rho[row] * ln_ratio;
            sums.second += letters * rho[row] * ln_ratio * ln_ratio;
        }
    }

    let mut total = Sums::default();
    for (at, row) in rows.into_iter().enumerate() {
        total.add(
            &Drawn::new(p[at], square[at], concentrations[at]),
            digamma(concentrations[at] + 1.0),
            row,
        );
    }

    total.moments(entropy, policy.weight, &freedom)
}

/// A row as a slab sees it.
struct Drawn {
    p: f64,
    /// E p^2 / (A + 1).
    spread: f64,
    /// 1 / A.
    inverse: f64,
}

impl Drawn {
    fn new(p: f64, square: f64, a: f64) -> Self {
        Self {
            p,
            spread: square / (a + 1.0),
            inverse: 1.0 / a,
        }
    }
}

/// What all rows of a slice have in common under a slab.
struct View<'a> {
    slab: &'a Slab<'a>,
    /// ln k.
    ln_k: f64,
    /// The visited rows, by position; and all others together.
    drivers: Vec<Drawn>,
    unvisited: Drawn,
    columns: Vec<Column>,
    /// What a row without visits has.
    empty: Empty,
    /// E H(q).
    marginal_entropy: f64,
    freedom: Freedom,
}

/// One row: sum_j a_ij psi(a_ij + 1), sum_j rho L, sum_j rho L^2.
#[derive(Default)]
struct Row {
    psi: f64,
    first: f64,
    second: f64,
}

/// Sums over rows: sum p E H(row), sum P (sum rho L^2 - L_i^2) / (A + 1), sum p L_i, sum p L_i^2.
#[derive(Default)]
struct Sums {
    entropy: f64,
    spread: f64,
    divergence: f64,
    square: f64,
}

impl Sums {
    fn add(&mut self, Drawn { p, spread, inverse }: &Drawn, psi_a1: f64, row: Row) {
        self.entropy += p * (psi_a1 - row.psi * inverse);
        self.spread += spread * (row.second - row.first * row.first).max(0.0);
        self.divergence += p * row.first;
        self.square += p * row.first * row.first;
    }

    /// Returns the moments, from E H(q), S and the degrees of freedom.
    fn moments(&self, marginal_entropy: f64, weight: f64, freedom: &Freedom) -> Moments {
        let mean = (marginal_entropy - self.entropy).max(0.0);
        let spread = self.spread
            + (self.square - self.divergence * self.divergence).max(0.0) / (weight + 1.0);
        let [narrow, wide] = freedom.variances(mean - self.divergence);
        Moments {
            mean,
            variance: spread + narrow,
            wide: spread + wide,
        }
    }
}

/// The distribution of a letter q_j: its mean and its variance.
#[derive(Clone, Copy)]
struct Share {
    mean: f64,
    variance: f64,
}

impl Share {
    /// Returns -E q ln q of the Beta distribution with these moments.
    fn entropy(self) -> f64 {
        let Self { mean, variance } = self;
        let sharpness =
            (mean * (1.0 - mean) / variance.max(f64::MIN_POSITIVE) - 1.0).clamp(1e-6, 1e12);
        -mean * digamma_difference(mean * sharpness + 1.0, sharpness + 1.0)
    }
}

impl<'a> View<'a> {
    fn new(slice: &Slice<'_>, slab: &'a Slab<'a>) -> Self {
        let k = slab.concentration;
        let Unvisited {
            p, squared, square, ..
        } = slice.unvisited;
        let driver = |driver: &Driver| Drawn::new(driver.p, driver.square, driver.r as f64 + k);

        let mut view = Self {
            slab,
            ln_k: k.ln(),
            drivers: slice.drivers.iter().map(driver).collect(),
            unvisited: Drawn::new(p, square, k),
            columns: Vec::with_capacity(slab.columns.len()),
            empty: Empty::default(),
            marginal_entropy: 0.0,
            freedom: Freedom::default(),
        };

        slice
            .drivers
            .iter()
            .for_each(|Driver { r, p, .. }| view.freedom.add_row(*p, *r as f64 + k));
        view.freedom.add_alike(p, squared, k);

        view.look_at_columns(slice);
        view
    }

    /// Finds the distribution of every q_j: as if no row had visits there, corrected in the
    /// occupied cells.
    fn look_at_columns(&mut self, Slice { table, policy, .. }: &Slice<'_>) {
        let k = self.slab.concentration;
        // sum p k/A, sum P (k/A)/(A + 1), sum P (k/A)^2/(A + 1), sum p (k/A)^2.
        let mut common = [0.0; 4];
        for Drawn { p, spread, inverse } in self.drivers.iter().chain([&self.unvisited]) {
            let drawn = k * inverse;
            let terms = [
                p * drawn,
                spread * drawn,
                spread * drawn * drawn,
                p * drawn * drawn,
            ];
            common
                .iter_mut()
                .zip(terms)
                .for_each(|(sum, term)| *sum += term);
        }

        let [drawn, rising, falling, squares] = common;
        // E q, the rows' part of its variance, and sum p rho^2.
        let untouched = |m: f64| [m * drawn, m * rising - m * m * falling, m * m * squares];

        let mut sums: Vec<[f64; 3]> = self
            .slab
            .columns
            .iter()
            .map(|letter| untouched(letter.share))
            .collect();

        for cell in table.cells() {
            let Drawn { p, spread, inverse } = self.drivers[cell.row as usize];
            // By how much the visits raise rho, and the sum of what it was and is.
            let more = cell.n as f64 * inverse;
            let both = 2.0 * k * self.slab.columns[cell.column as usize].share * inverse + more;
            let terms = [p * more, spread * more * (1.0 - both), p * more * both];
            sums[cell.column as usize]
                .iter_mut()
                .zip(terms)
                .for_each(|(sum, term)| *sum += term);
        }

        let share = |[mean, rows, squares]: [f64; 3]| Share {
            mean,
            variance: rows + (squares - mean * mean).max(0.0) / (policy.weight + 1.0),
        };

        for (letter, sums) in self.slab.columns.iter().zip(&sums) {
            let q = share(*sums);
            self.marginal_entropy += q.entropy();
            self.freedom.add_letters(q.mean, 1.0);
            let ln_q = q.mean.ln();
            let column = Column {
                share: letter.share,
                ln_q,
                ln_ratio: letter.empty.ln - self.ln_k - ln_q,
            };
            self.empty = self.empty.plus(Empty::of_column(&column), 1.0);
            self.columns.push(column);
        }

        for Alike { share: m, letters } in self.slab.rest {
            let q = share(untouched(*m));
            self.marginal_entropy += letters * q.entropy();
            self.freedom.add_letters(q.mean, *letters);
            let column = Column {
                share: letters * m,
                ln_q: q.mean.ln(),
                ln_ratio: -drawn.ln(),
            };
            self.empty = self.empty.plus(Empty::of_column(&column), 1.0);
        }
    }

    /// Returns the sums of a row in these cells, given ln A.
    fn row(
        &self,
        drawn: &Drawn,
        ln_a: f64,
        cells: &[Occupied],
        term: impl Fn(usize, u64) -> Term,
    ) -> Row {
        let k = self.slab.concentration;
        let mut row = Row {
            psi: self.slab.psi,
            first: 0.0,
            second: 0.0,
        };
        let mut empty = self.empty;

        for cell in cells {
            let at = cell.column as usize;
            let (letter, column, term) =
                (&self.slab.columns[at], &self.columns[at], term(at, cell.n));
            empty = empty.plus(Empty::of_column(column), -1.0);
            let rho = (cell.n as f64 + k * letter.share) * drawn.inverse;
            let ln_ratio = term.ln - ln_a - column.ln_q;
            row.psi += term.psi - letter.empty.psi;
            row.first += rho * ln_ratio;
            row.second += rho * ln_ratio * ln_ratio;
        }

        let (scale, shift) = (k * drawn.inverse, self.ln_k - ln_a);
        let Empty([m, e, e2]) = empty;
        row.first += scale * (e + shift * m);
        row.second += scale * (e2 + 2.0 * shift * e + shift * shift * m);
        row
    }
}

#[cfg(test)]
pub(super) mod tests;
