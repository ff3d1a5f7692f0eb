//! Responses on the whole (cross-tabulation over strata): how often the other does what after each of
//! the ego's actions, beside how often it would if the two were independent within each stratum.

use crate::information::alphabet::Alphabet;
use crate::information::table::Table;

/// The counts of all strata added up by their labels, beside their expectation under independence.
/// Where actions depend on the state and nothing else, the two agree, though the sums alone look
/// dependent (Simpson's paradox).
#[derive(Debug, Clone)]
pub struct Responses {
    columns: usize,
    cells: Vec<Sum>,
}

/// The count of a pair of labels, its mean under independence and its variance then: those of a
/// hypergeometric variable a stratum, r c / N and r (N - r) c (N - c) / (N^2 (N - 1)).
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    n: u64,
    mean: f64,
    variance: f64,
}

/// What follows one label of the rows.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    /// How often the label was seen.
    pub visits: u64,
    /// The relative frequency of each label of the columns; empty without visits.
    pub frequencies: Vec<f64>,
    /// Its mean were the two independent within each stratum; empty without visits.
    pub if_independent: Vec<f64>,
    /// Where each probability lies with 90 % confidence: Wilson's score interval (1927).
    pub intervals: Vec<[f64; 2]>,
    /// KL(frequencies from if_independent), in nats, at least 0: of one pattern shared by the strata,
    /// since what differs from one to the other cancels out.
    pub divergence: f64,
    /// Its mean under independence, to the second order, in nats.
    pub divergence_if_independent: f64,
}

/// The normal quantile of a 90 % interval.
const NORMAL: f64 = 1.644_853_626_951_472_2;

impl Responses {
    /// Begins with no strata, whose tables will have labels of this alphabet.
    pub fn new(alphabet: Alphabet) -> Self {
        let [rows, columns] = [alphabet.rows, alphabet.columns].map(|labels| labels as usize);
        Self {
            columns,
            cells: vec![Sum::default(); rows * columns],
        }
    }

    /// Adds a stratum.
    ///
    /// # Panics
    ///
    /// If a label of its table is not in the alphabet.
    pub fn add(&mut self, table: &Table) {
        for cell in table.cells() {
            let [row, column] = [
                table.row_labels()[cell.row as usize],
                table.column_labels()[cell.column as usize],
            ];
            self.cells[row as usize * self.columns + column as usize].n += cell.n;
        }

        let total = table.total() as f64;
        for (row, r) in table.row_labels().iter().zip(table.rows()) {
            for (column, c) in table.column_labels().iter().zip(table.columns()) {
                let [r, c] = [*r as f64, *c as f64];
                let sum = &mut self.cells[*row as usize * self.columns + *column as usize];
                sum.mean += r * c / total;
                if total > 1.0 {
                    let left = (total - r) * (total - c) / (total - 1.0);
                    sum.variance += r * c * left / (total * total);
                }
            }
        }
    }

    /// Returns what follows each label of the rows, in their order.
    pub fn by_row(&self) -> impl Iterator<Item = Response> {
        self.cells.chunks(self.columns).map(response)
    }
}

fn response(cells: &[Sum]) -> Response {
    let visits: u64 = cells.iter().map(|cell| cell.n).sum();
    if visits == 0 {
        return Response {
            visits,
            frequencies: Vec::new(),
            if_independent: Vec::new(),
            intervals: Vec::new(),
            divergence: 0.0,
            divergence_if_independent: 0.0,
        };
    }

    let total = visits as f64;
    let frequency = |cell: &Sum| cell.n as f64 / total;
    let expected = |cell: &Sum| cell.mean / total;
    let divergence = |cell: &Sum| match cell.n {
        0 => 0.0,
        n => frequency(cell) * (n as f64 / cell.mean).ln(),
    };
    // KL of p from q is 1/2 sum (p - q)^2 / q next to q.
    let chance = |cell: &Sum| match cell.mean > 0.0 {
        true => 0.5 * cell.variance / (total * cell.mean),
        false => 0.0,
    };
    Response {
        visits,
        frequencies: cells.iter().map(frequency).collect(),
        if_independent: cells.iter().map(expected).collect(),
        intervals: cells
            .iter()
            .map(|cell| wilson(frequency(cell), total))
            .collect(),
        divergence: cells.iter().map(divergence).sum::<f64>().max(0.0),
        divergence_if_independent: cells.iter().map(chance).sum(),
    }
}

fn wilson(p: f64, n: f64) -> [f64; 2] {
    let square = NORMAL * NORMAL / n;
    let middle = (p + 0.5 * square) / (1.0 + square);
    let reach = NORMAL * (p * (1.0 - p) / n + 0.25 * square / n).sqrt() / (1.0 + square);
    [(middle - reach).max(0.0), (middle + reach).min(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn responses(tables: &[[[u64; 2]; 2]]) -> Vec<Response> {
        let mut responses = Responses::new(Alphabet {
            rows: 2,
            columns: 2,
        });
        for [[a, b], [c, d]] in tables {
            let cells = [(0, 0, *a), (0, 1, *b), (1, 0, *c), (1, 1, *d)];
            responses.add(&Table::from_counts(cells));
        }
        responses.by_row().collect()
    }

    #[test]
    fn habits_that_differ_by_stratum_are_no_response() {
        let [first, second] = &responses(&[[[81, 9], [9, 1]], [[1, 9], [9, 81]]])[..] else {
            panic!("two rows");
        };
        assert_eq!(first.visits, 100);
        assert!((first.frequencies[0] - 0.82).abs() < 1e-12, "{first:?}");
        assert!((first.if_independent[0] - 0.82).abs() < 1e-12, "{first:?}");
        assert!(first.divergence < 1e-12 && second.divergence < 1e-12);
    }

    #[test]
    fn copying_diverges_from_independence_by_more_than_chance() {
        let [first, _] = &responses(&[[[9, 1], [1, 9]]; 4])[..] else {
            panic!("two rows");
        };
        assert_eq!(first.frequencies, [0.9, 0.1]);
        assert_eq!(first.if_independent, [0.5, 0.5]);
        assert!((first.divergence - (0.9 * 1.8_f64.ln() + 0.1 * 0.2_f64.ln())).abs() < 1e-12);
        // Of four strata, each of variance 10 * 10 * 10 * 10 / (400 * 19), in 40 visits.
        let variance = 4.0 * 10_000.0 / (400.0 * 19.0);
        let expected = 2.0 * 0.5 * variance / (40.0 * 20.0);
        assert!(
            (first.divergence_if_independent - expected).abs() < 1e-12,
            "{first:?}"
        );
        let [low, high] = first.intervals[0];
        assert!(
            (low - 0.795_01).abs() < 1e-4 && (high - 0.954_31).abs() < 1e-4,
            "{first:?}"
        );
    }

    #[test]
    fn what_was_never_done_has_no_response() {
        let [_, second] = &responses(&[[[3, 2], [0, 0]], [[1, 0], [0, 0]]])[..] else {
            panic!("two rows");
        };
        assert_eq!((second.visits, second.frequencies.len()), (0, 0));
    }
}
