//! Pearson's X^2 of small tables, and its exact mean and variance at fixed margins (Haldane 1940,
//! "The mean and variance of chi^2, when used as a test of homogeneity, when expectations are
//! small"). Only ever for a size: its tail is wrong by a factor of 5 at .001.

use crate::information::table::Table;

/// Pearson's X^2 of a table, and what it would be under independence.
pub(super) struct PearsonSquare {
    pub value: f64,
    pub mean: f64,
    pub variance: f64,
    /// (R - 1)(K - 1) on the occupied rows and columns.
    pub freedoms: f64,
}

impl PearsonSquare {
    /// Finds all of it for a table of two rows and two columns at least.
    pub fn new(table: &Table) -> Self {
        let n = table.total() as f64;
        let [rows, columns] = [table.rows(), table.columns()].map(|sums| sums.len() as f64);
        let freedoms = (rows - 1.0) * (columns - 1.0);

        Self {
            value: value(table),
            mean: n * freedoms / (n - 1.0),
            variance: variance(table).max(0.0),
            freedoms,
        }
    }
}

/// Visits for each pair of occupied lines from which a table tells its sampling variance.
const OFTEN: u64 = 5;

/// Returns the variance of X^2 = N phi^2 were the same visits drawn again, by the delta method:
///
/// N [sum_ij p_ij g_ij^2 - (sum_ij p_ij g_ij)^2], g_ij = 2 a_ij - sum_k p_k|i a_ik - sum_k p_k|j a_kj
///
/// with a_ij = p_ij / (p_i p_j) (Bishop, Fienberg & Holland 1975, section 11.3). Next to independence
/// it is 0, and the exact variance under independence is what there is; of tables that were seldom
/// seen it knows nothing, and is 0 too.
pub(super) fn sampling_variance(table: &Table) -> f64 {
    let [rows, columns] = [table.rows(), table.columns()];
    if table.total() < OFTEN * (rows.len() * columns.len()) as u64 {
        return 0.0;
    }

    let n = table.total() as f64;
    let ratio = |row: usize, column: usize, count: u64| {
        count as f64 / rows[row] as f64 * (n / columns[column] as f64)
    };
    let cells = table.cells().iter().map(|cell| {
        let (row, column) = (cell.row as usize, cell.column as usize);
        (row, column, cell.n as f64, ratio(row, column, cell.n))
    });

    let (mut by_row, mut by_column) = (vec![0.0; rows.len()], vec![0.0; columns.len()]);
    for (row, column, count, a) in cells.clone() {
        by_row[row] += count / rows[row] as f64 * a;
        by_column[column] += count / columns[column] as f64 * a;
    }
    let (mut first, mut second) = (0.0, 0.0);
    for (row, column, count, a) in cells {
        let gradient = 2.0 * a - by_row[row] - by_column[column];
        first += count / n * gradient;
        second += count / n * gradient * gradient;
    }
    n * (second - first * first).max(0.0)
}

/// X^2 = N (sum_ij n_ij^2 / (r_i c_j) - 1), as a sum of (n - e)^2 / e over all cells: those without
/// a visit have e each, N less the e of the others together.
fn value(table: &Table) -> f64 {
    let n = table.total() as f64;
    let (mut occupied, mut expected) = (0.0, 0.0);
    for cell in table.cells() {
        let row = table.rows()[cell.row as usize] as f64;
        let e = row * (table.columns()[cell.column as usize] as f64 / n);
        occupied += (cell.n as f64 - e) * (cell.n as f64 - e) / e;
        expected += e;
    }
    occupied + (n - expected).max(0.0)
}

/// Var X^2 = 2 N / (N - 3) (v_1 - w_1)(v_2 - w_2) + N^2 / (N - 1) w_1 w_2, with v_1 = (R - 1)(N - R) /
/// (N - 1) and w_1 = (N sum 1 / r_i - R^2) / (N - 2) of the rows, v_2 and w_2 of the columns.
///
/// N = 2 leaves a single value. N = 3 leaves two where both margins are (2, 1), 3/4 with
/// probability 2/3 and 3 with 1/3: variance 9/8; and one otherwise.
fn variance(table: &Table) -> f64 {
    let n = table.total() as f64;
    let [(v_1, w_1), (v_2, w_2)] = [table.rows(), table.columns()].map(|sums| {
        let lines = sums.len() as f64;
        let reciprocals: f64 = sums.iter().map(|&sum| 1.0 / sum as f64).sum();
        let v = (lines - 1.0) * (n - lines) / (n - 1.0);
        (v, (n * reciprocals - lines * lines) / (n - 2.0))
    });

    match table.total() {
        ..=2 => 0.0,
        3 if table.rows().len() == 2 && table.columns().len() == 2 => 9.0 / 8.0,
        3 => 0.0,
        _ => 2.0 * n / (n - 3.0) * (v_1 - w_1) * (v_2 - w_2) + n * n / (n - 1.0) * w_1 * w_2,
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    /// Draws a table in which the other copies three times in ten.
    fn drawn(visits: u32, random: &mut Pcg64) -> Table {
        Table::from_counts((0..visits).map(|_| {
            let (row, column) = (random.random_range(0..3), random.random_range(0..3));
            let copies = random.random::<f64>() < 0.3;
            (row, if copies { row } else { column }, 1)
        }))
    }

    #[test]
    fn the_sampling_variance_is_that_of_tables_drawn_again() {
        const TABLES: usize = 2_000;
        let mut random = Pcg64::seed_from_u64(3);
        let tables: Vec<Table> = (0..TABLES).map(|_| drawn(600, &mut random)).collect();
        let squares: Vec<f64> = tables.iter().map(value).collect();
        let mean = squares.iter().sum::<f64>() / TABLES as f64;
        let among = squares.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / TABLES as f64;

        let told = |table: &Table| sampling_variance(table) + variance(table);
        let told = tables.iter().map(told).sum::<f64>() / TABLES as f64;
        assert!((told / among - 1.0).abs() < 0.1, "{told} beside {among}");
    }

    #[test]
    fn a_table_that_was_seldom_seen_has_none() {
        let seldom = Table::from_counts([(0, 0, 9), (1, 1, 9)]);
        assert_eq!(sampling_variance(&seldom), 0.0);
        let often = Table::from_counts([(0, 0, 10), (1, 1, 9), (0, 1, 1)]);
        assert!(sampling_variance(&often) > 0.0);
    }
}
