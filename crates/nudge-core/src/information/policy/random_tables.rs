//! Random tables with the margins of a given one, cell by cell.

use rand::Rng;
use rand::seq::SliceRandom;

use crate::information::significance::draw_marked;
use crate::information::table::Table;

/// Above this many visits for each cell, drawing cells is quicker than shuffling visits.
const VISITS_PER_CELL: u64 = 40;

/// Draws tables as independence would make them at these margins.
pub(super) struct RandomTables {
    rows: Vec<u64>,
    columns: Vec<u64>,
    /// The column of each visit, where visits are shuffled.
    visits: Option<Vec<u32>>,
    /// The counts, row by row.
    grid: Vec<u64>,
    rows_left: Vec<u64>,
}

impl RandomTables {
    pub fn new(table: &Table) -> Self {
        let (rows, columns) = (table.rows().to_vec(), table.columns().to_vec());
        let cells = rows.len() * columns.len();
        let shuffles = table.total() / cells as u64 <= VISITS_PER_CELL;
        let labels = || {
            let of_column = |(column, &sum)| std::iter::repeat_n(column, sum as usize);
            (0..).zip(&columns).flat_map(of_column).collect()
        };

        Self {
            visits: shuffles.then(labels),
            grid: vec![0; cells],
            rows_left: rows.clone(),
            rows,
            columns,
        }
    }

    /// Draws a table, and returns its occupied cells: positions of row and column, and the count.
    pub fn draw(
        &mut self,
        random: &mut impl Rng,
    ) -> impl Iterator<Item = (usize, usize, u64)> + Clone {
        match &mut self.visits {
            Some(visits) => {
                visits.shuffle(random);
                count(&self.rows, visits, self.columns.len(), &mut self.grid);
            }
            None => self.draw_cells(random),
        }

        let width = self.columns.len();
        let occupied = self.grid.iter().enumerate().filter(|(_, n)| **n > 0);
        occupied.map(move |(at, &n)| (at / width, at % width, n))
    }

    /// Draws cell after cell from what those before leave (Patefield 1981, algorithm AS 159).
    fn draw_cells(&mut self, random: &mut impl Rng) {
        self.rows_left.copy_from_slice(&self.rows);
        let width = self.columns.len();
        let mut total_left: u64 = self.rows.iter().sum();

        for (column, &sum) in self.columns.iter().enumerate() {
            let (mut drawn, mut others) = (sum, total_left);
            for (row, left) in self.rows_left.iter_mut().enumerate() {
                let n = draw_marked(random, *left, drawn, others);
                self.grid[row * width + column] = n;
                others -= *left;
                drawn -= n;
                *left -= n;
            }
            total_left -= sum;
        }
    }
}

/// Counts visits, of which the first belong to the first row, and so on.
fn count(rows: &[u64], visits: &[u32], width: usize, grid: &mut [u64]) {
    grid.fill(0);
    let mut visits = visits.iter();
    for (line, &sum) in grid.chunks_mut(width).zip(rows) {
        for &column in visits.by_ref().take(sum as usize) {
            line[column as usize] += 1;
        }
    }
}
