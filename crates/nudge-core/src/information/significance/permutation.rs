//! Permutation tests: random tables with given margins, as chance would make them, the same visits
//! with their columns shuffled.

use rand::{Rng, RngExt};

use super::enumeration::of_margins;
use super::hypergeometric::draw;
use crate::information::deviance::cell_deviance;
use crate::information::table::Table;
use crate::information::x_ln_x;

/// Above this many visits for each free cell, drawing cells is quicker than shuffling visits.
const VISITS_PER_DRAW: f64 = 40.0;

/// Draws random tables with the margins of one table, and tells N times the plug-in mutual
/// information of each.
pub(in crate::information) enum Sampler {
    Visits(Visits),
    Cells(Cells),
}

impl Sampler {
    pub fn new(table: &Table, freedoms: f64) -> Self {
        if table.total() as f64 <= VISITS_PER_DRAW * freedoms {
            Self::Visits(Visits::new(table))
        } else {
            Self::Cells(Cells::new(table))
        }
    }

    pub fn draw(&mut self, random: &mut impl Rng) -> f64 {
        match self {
            Self::Visits(visits) => visits.draw(random),
            Self::Cells(cells) => cells.draw(random),
        }
    }
}

/// Shuffles visits: quick for few of them, however many cells there are.
pub(in crate::information) struct Visits {
    of_margins: f64,
    /// All rows but the largest, which comes last and has what the others leave.
    rows: Vec<u64>,
    columns: Vec<u64>,
    /// The column of each visit.
    labels: Vec<u32>,
    /// The counts of one row, all 0 between rows.
    counts: Vec<u64>,
    columns_left: Vec<u64>,
}

impl Visits {
    pub fn new(table: &Table) -> Self {
        let (mut rows, mut columns) = (table.rows().to_vec(), table.columns().to_vec());
        // The larger the row that comes last, the fewer visits there are to shuffle.
        if rows.iter().max() < columns.iter().max() {
            std::mem::swap(&mut rows, &mut columns);
        }

        rows.sort_unstable();
        rows.pop();

        let labels = columns
            .iter()
            .zip(0..)
            .flat_map(|(&sum, label)| std::iter::repeat_n(label, sum as usize));
        let (labels, counts, columns_left) =
            (labels.collect(), vec![0; columns.len()], columns.clone());

        Self {
            of_margins: of_margins(table),
            rows,
            columns,
            labels,
            counts,
            columns_left,
        }
    }

    fn draw(&mut self, random: &mut impl Rng) -> f64 {
        self.columns_left.copy_from_slice(&self.columns);
        let mut statistic = self.of_margins;
        let mut end = 0;

        for &row in &self.rows {
            let start = end;
            end += row as usize;
            for at in start..end {
                let drawn = random.random_range(at..self.labels.len());
                self.labels.swap(at, drawn);
                self.counts[self.labels[at] as usize] += 1;
            }

            for &label in &self.labels[start..end] {
                // A column's count is taken at its first visit, and is 0 at the others.
                let n = std::mem::take(&mut self.counts[label as usize]);
                self.columns_left[label as usize] -= n;
                statistic += x_ln_x::at(n);
            }
        }

        self.columns_left
            .iter()
            .fold(statistic, |sum, &n| sum + x_ln_x::at(n))
    }
}

/// Draws cell after cell from what those before leave (Patefield 1981, algorithm AS 159): as quick
/// for many visits as for few.
pub(in crate::information) struct Cells {
    rows: Vec<u64>,
    columns: Vec<u64>,
    total: u64,
    rows_left: Vec<u64>,
}

impl Cells {
    pub fn new(table: &Table) -> Self {
        let (rows, columns) = (table.rows().to_vec(), table.columns().to_vec());
        Self {
            rows_left: rows.clone(),
            rows,
            columns,
            total: table.total(),
        }
    }

    fn draw(&mut self, random: &mut impl Rng) -> f64 {
        self.rows_left.copy_from_slice(&self.rows);
        let mut total_left = self.total;
        let mut statistic = 0.0;

        for &column in &self.columns {
            let mut drawn = column;
            let mut others = total_left;
            for (left, &row) in self.rows_left.iter_mut().zip(&self.rows) {
                let n = draw(random, *left, drawn, others);
                statistic += cell_deviance(n, row, column, self.total);
                others -= *left;
                drawn -= n;
                *left -= n;
            }
            total_left -= column;
        }
        statistic
    }
}
