//! The exact mean and variance of a table's N times plug-in mutual information under independence,
//! over all tables with its margins: what the pooled test adds up. Not its distribution.

use super::margins::Margins;
use crate::information::counts_of_counts::CountOfCounts;
use crate::information::urn::Urn;
use crate::information::x_ln_x;

/// The mean and the variance of a statistic under independence.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Moments {
    /// In nats.
    pub mean: f64,
    /// In nats squared.
    pub variance: f64,
}

impl Moments {
    /// Returns the moments of a sample of two values at least, the variance without bias.
    pub(in crate::information) fn of_sample(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        Self {
            mean,
            variance: squares / (n - 1.0),
        }
    }

    /// Adds those of an independent statistic.
    pub(in crate::information) fn add(&mut self, other: Self) {
        self.mean += other.mean;
        self.variance += other.variance;
    }
}

/// Returns the moments of T = sum_ij n_ij ln(n_ij N / (r_i c_j)) over all ways to pair up the same
/// visits at random, in time O(cells x values of a cell x orders).
///
/// T is a sum of f_ij(n_ij) over cells, and each f_ij is expanded in the polynomials Q_p that are
/// orthonormal under the hypergeometric distribution of its cell (Hahn's). They make cells
/// independent but for equal orders:
///
/// E Q_p(n_ij) Q_q(n_kl) = \[p = q\] tau_p(r_i, r_k) tau_p(c_j, c_l),
///
/// where tau_p of a line with itself is 1, and of two lines of a and b visits
/// (-1)^p sqrt((a)_p (b)_p / ((N - a)_p (N - b)_p)), with falling factorials (a)_p. For what is
/// left of a row's visits or a column's is a uniformly random set, and its functions split into
/// the irreducible representations of the symmetric group, each of which occurs once (Delsarte
/// 1973, the Johnson scheme; for p = 1 this is the correlation of two cells of a row,
/// -sqrt(c_j c_l / ((N - c_j)(N - c_l))) ). With a_p(i, j) = E f_ij Q_p,
///
/// Var T = sum_p sum_ijkl a_p(i, j) a_p(k, l) tau_p(r_i, r_k) tau_p(c_j, c_l).
pub(in crate::information) fn moments(rows: &[u64], columns: &[u64]) -> Moments {
    if rows.len() <= 1 || columns.len() <= 1 {
        return Moments::default();
    }
    let margins = Margins::new(rows, columns);
    let coefficients = Coefficients::new(&margins);

    let orders = 1..coefficients.orders;
    Moments {
        mean: coefficients.sum(&margins).max(0.0),
        variance: orders
            .map(|order| coefficients.variance(&margins, order))
            .sum::<f64>()
            .max(0.0),
    }
}

/// The a_p(i, j) of every pair of different rows and columns: for each order, row by row.
struct Coefficients {
    values: Vec<f64>,
    cells: usize,
    orders: usize,
}

impl Coefficients {
    fn new(margins: &Margins) -> Self {
        let cells = margins.rows.len() * margins.columns.len();
        let mut values = vec![0.0; cells * MOST_ORDERS];
        let (mut basis, mut orders) = (Basis::default(), 1);
        let mut cell = 0;

        for row in &margins.rows {
            for column in &margins.columns {
                let mut order = 0;
                basis.expand(margins.urn(row, column), |value| {
                    values[order * cells + cell] = value;
                    order += 1;
                });
                orders = orders.max(order);
                cell += 1;
            }
        }

        Self {
            values,
            cells,
            orders,
        }
    }

    fn order(&self, order: usize) -> &[f64] {
        &self.values[order * self.cells..(order + 1) * self.cells]
    }

    /// Returns the sum of the means of all cells.
    fn sum(&self, margins: &Margins) -> f64 {
        let rows = self.order(0).chunks(margins.columns.len());
        rows.zip(&margins.rows)
            .map(|(means, row)| row.times * dot(&margins.columns, means))
            .sum()
    }

    /// Returns the part of the variance that is of one order.
    ///
    /// With tau = (-1)^p s s' between lines, and so (1 - (-1)^p s s) + (-1)^p s s' within groups of
    /// them that are alike, the fourfold sum falls into four: within cells, columns, rows, and over
    /// all.
    fn variance(&self, margins: &Margins, order: usize) -> f64 {
        let sign = if order.is_multiple_of(2) { 1.0 } else { -1.0 };
        let own = |share: f64| 1.0 - sign * share * share;
        let rows = shares(&margins.rows, margins.total, order);
        let columns = shares(&margins.columns, margins.total, order);

        let mut of_columns = vec![0.0; columns.len()];
        let (mut cells, mut across, mut all) = (0.0, 0.0, 0.0);
        let lines = self.order(order).chunks(columns.len());

        for ((values, row), &row_share) in lines.zip(&margins.rows).zip(&rows) {
            let (mut squares, mut weighed) = (0.0, 0.0);
            for (j, &value) in values.iter().enumerate() {
                let times = margins.columns[j].times;
                squares += times * own(columns[j]) * value * value;
                weighed += times * columns[j] * value;
                of_columns[j] += row.times * row_share * value;
            }
            cells += row.times * own(row_share) * squares;
            across += row.times * own(row_share) * weighed * weighed;
            all += row.times * row_share * weighed;
        }

        let along: f64 = (0..columns.len())
            .map(|j| margins.columns[j].times * own(columns[j]) * of_columns[j] * of_columns[j])
            .sum();
        cells + sign * (across + along) + all * all
    }
}

fn dot(columns: &[CountOfCounts], values: &[f64]) -> f64 {
    let terms = columns.iter().zip(values);
    terms.map(|(column, value)| column.times * value).sum()
}

/// Returns s = sqrt((a)_p / (N - a)_p) of each line; 0 where either has too few visits for such an
/// order, and so every coefficient is 0.
fn shares(lines: &[CountOfCounts], total: u64, order: usize) -> Vec<f64> {
    let share = |line: &CountOfCounts| {
        let (own, others) = (line.n, total - line.n);
        if own.min(others) < order as u64 {
            return 0.0;
        }
        (0..order as u64)
            .map(|k| (own - k) as f64 / (others - k) as f64)
            .product::<f64>()
            .sqrt()
    };
    lines.iter().map(share).collect()
}

/// Orders above this add nothing to a variance that rounding has not taken already.
const MOST_ORDERS: usize = 24;
/// Two coefficients in a row as small as this end an expansion.
const NEGLIGIBLE: f64 = 1e-10;
/// The share of a variance that rounding may be.
const ROUNDING: f64 = 1e-13;
/// From this many visits expected in a cell on, the first two orders are taken at their limits.
const LIMIT_FROM: f64 = 2_000.0;

/// The values of a cell with their probabilities, and the polynomials of two orders there.
#[derive(Default)]
struct Basis {
    values: Vec<f64>,
    probabilities: Vec<f64>,
    /// Probability times f.
    weighed: Vec<f64>,
    before: Vec<f64>,
    current: Vec<f64>,
    /// Var f.
    variance: f64,
}

impl Basis {
    /// Tells the coefficients of f(n) = n ln(n / e) - n + e, order by order from 0, which is the
    /// mean.
    ///
    /// The recurrence is that of the Hahn polynomials (Koekoek, Lesky & Swarttouw 2010, 9.5), with
    /// x Q_p = b_p+1 Q_p+1 + (A_p + C_p) Q_p + b_p Q_p-1 and b_p+1^2 = A_p C_p+1.
    fn expand(&mut self, urn: Urn, mut tell: impl FnMut(f64)) {
        if urn.mean() >= LIMIT_FROM {
            tell(urn.mean_deviance());
            return limits(urn).into_iter().for_each(tell);
        }
        self.lay_out(urn);
        tell(self.weighed.iter().sum());

        let most = urn.most_order().min(MOST_ORDERS as u64 - 1);
        let (mut link, mut last, mut left) = (0.0, f64::INFINITY, self.variance);
        for order in 0..most {
            let centre = urn.rising(order) + urn.falling(order);
            let next_link = (urn.rising(order) * urn.falling(order + 1)).sqrt();
            let value = self.step(centre, link, next_link);
            // Squares of all orders add up to the variance (Parseval): one that is above what is
            // left of it is rounding, which grows without bounds from here on.
            left -= value * value;
            if left < -ROUNDING * self.variance {
                return;
            }
            tell(value);

            if value.abs().max(last) < NEGLIGIBLE || left <= ROUNDING * self.variance {
                return;
            }
            (link, last) = (next_link, value.abs());
        }
    }

    /// Takes the next order, and returns the coefficient there.
    fn step(&mut self, centre: f64, link: f64, next_link: f64) -> f64 {
        let mut sum = 0.0;
        for at in 0..self.values.len() {
            let current = self.current[at];
            let next = ((self.values[at] - centre) * current - link * self.before[at]) / next_link;
            sum += self.weighed[at] * next;
            self.before[at] = current;
            self.current[at] = next;
        }
        sum
    }

    fn lay_out(&mut self, urn: Urn) {
        /// So small that even beside its root, where polynomials grow as that, nothing is missed.
        const NEGLIGIBLE: f64 = 1e-30;

        self.values.clear();
        self.probabilities.clear();
        urn.each(NEGLIGIBLE, |x, weight| {
            self.values.push(x as f64);
            self.probabilities.push(weight);
        });

        let whole: f64 = self.probabilities.iter().sum();
        let e = urn.mean();
        let ln_e = e.ln();
        let f = |x: f64| x_ln_x::at(x as u64) - x * ln_e - x + e;
        self.weighed.clear();
        self.weighed.extend(
            self.values
                .iter()
                .zip(&self.probabilities)
                .map(|(&x, p)| p / whole * f(x)),
        );
        let mean: f64 = self.weighed.iter().sum();
        let squares = self.values.iter().zip(&self.probabilities);
        self.variance = squares
            .map(|(&x, p)| p / whole * (f(x) - mean).powi(2))
            .sum();
        self.before.clear();
        self.before.resize(self.values.len(), 0.0);
        self.current.clear();
        self.current.resize(self.values.len(), 1.0);
    }
}

/// Returns the coefficients of the first and second order where f is as good as a parabola,
/// (x - e)^2 / 2e, but for its skew: (mu_3 / 2e - mu_4 / 6e^2) / sqrt(mu_2) and
/// sqrt(mu_4 - mu_2^2 - mu_3^2 / mu_2) / 2e.
fn limits(urn: Urn) -> [f64; 2] {
    let [second, third, fourth] = urn.central_moments();
    let e = urn.mean();
    let first = (third - fourth / (3.0 * e)) / (2.0 * e * second.sqrt());
    let parabola = fourth - second * second - third * third / second;
    [first, parabola.max(0.0).sqrt() / (2.0 * e)]
}

impl Urn {
    /// The highest order there is: one less than the values a cell can take.
    fn most_order(self) -> u64 {
        let [fewest, most] = self.range();
        most - fewest
    }

    /// A_p of the recurrence.
    fn rising(self, order: u64) -> f64 {
        let [r, c, n, p] = [self.marked, self.drawn, self.total, order].map(|n| n as f64);
        (n + 1.0 - p) * (r - p) * (c - p) / ((n + 1.0 - 2.0 * p) * (n - 2.0 * p))
    }

    /// C_p of the recurrence.
    fn falling(self, order: u64) -> f64 {
        let [r, c, n, p] = [self.marked, self.drawn, self.total, order].map(|n| n as f64);
        p * (n + 1.0 - c - p) * (n + 1.0 - r - p) / ((n + 2.0 - 2.0 * p) * (n + 1.0 - 2.0 * p))
    }
}

#[cfg(test)]
mod tests;
