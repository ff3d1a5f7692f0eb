//! Exact tests by enumeration: every table with given margins, and its probability under
//! independence. Only for tables whose x ln x are all tabulated: larger ones have too many others
//! beside them.

use crate::information::table::Table;
use crate::information::x_ln_x;

/// Returns the part of the statistic that the margins decide: N ln N - sum r ln r - sum c ln c.
pub(super) fn of_margins(table: &Table) -> f64 {
    let sum = |sums: &[u64]| sums.iter().map(|&n| x_ln_x::at(n)).sum::<f64>();
    x_ln_x::at(table.total()) - sum(table.rows()) - sum(table.columns())
}

/// Tells the statistic and the probability of every combination of tables with the margins of the
/// slices.
pub(super) fn enumerate(slices: &[&Table], tell: impl FnMut(f64, f64)) {
    let slices = slices.iter().map(|slice| Slice::new(slice)).collect();
    Walk { slices, tell }.slice(
        0,
        Reached {
            statistic: 0.0,
            probability: 1.0,
        },
    );
}

/// The margins of a slice, ascending: the largest row and column come last, where the others leave
/// no choice.
struct Slice {
    of_margins: f64,
    /// What the cells so far leave of the row sums.
    rows_left: Vec<u64>,
    columns: Vec<u64>,
}

impl Slice {
    fn new(table: &Table) -> Self {
        let (mut rows_left, mut columns) = (table.rows().to_vec(), table.columns().to_vec());
        rows_left.sort_unstable();
        columns.sort_unstable();
        Self {
            of_margins: of_margins(table),
            rows_left,
            columns,
        }
    }
}

/// What the cells so far amount to.
#[derive(Clone, Copy)]
struct Reached {
    statistic: f64,
    probability: f64,
}

/// A walk through all tables: cell by cell down each column, column by column, slice by slice.
struct Walk<F> {
    slices: Vec<Slice>,
    tell: F,
}

impl<F: FnMut(f64, f64)> Walk<F> {
    fn slice(&mut self, slice: usize, reached: Reached) {
        match self.slices.get(slice) {
            None => (self.tell)(reached.statistic, reached.probability),
            Some(margins) => {
                let statistic = reached.statistic + margins.of_margins;
                self.column(
                    slice,
                    0,
                    Reached {
                        statistic,
                        ..reached
                    },
                );
            }
        }
    }

    fn column(&mut self, slice: usize, column: usize, reached: Reached) {
        let margins = &self.slices[slice];
        match margins.columns.get(column) {
            None => self.slice(slice + 1, reached),
            Some(&sum) => {
                let others = margins.rows_left.iter().sum();
                self.cells(
                    slice,
                    (0, column),
                    Urn {
                        drawn: sum,
                        marked: 0,
                        unmarked: others,
                    },
                    reached,
                );
            }
        }
    }

    /// Gives the cell at (row, column), and those below it, every value they can have. A column is
    /// drawn from what is left of the rows: this row's visits are the marked ones, those of the
    /// rows below the unmarked.
    fn cells(&mut self, slice: usize, (row, column): (usize, usize), above: Urn, reached: Reached) {
        let Some(&marked) = self.slices[slice].rows_left.get(row) else {
            return self.column(slice, column + 1, reached);
        };

        let urn = Urn {
            drawn: above.drawn,
            marked,
            unmarked: above.unmarked - marked,
        };

        let whole: f64 = urn.weights().map(|(_, weight)| weight).sum();
        for (n, weight) in urn.weights() {
            let statistic = reached.statistic + x_ln_x::at(n);
            let probability = reached.probability * (weight / whole);
            self.slices[slice].rows_left[row] = marked - n;

            let below = Urn {
                drawn: urn.drawn - n,
                ..urn
            };
            self.cells(
                slice,
                (row + 1, column),
                below,
                Reached {
                    statistic,
                    probability,
                },
            );
        }

        self.slices[slice].rows_left[row] = marked;
    }
}

/// An urn with marked and unmarked balls, from which some are drawn.
#[derive(Clone, Copy)]
struct Urn {
    drawn: u64,
    marked: u64,
    unmarked: u64,
}

impl Urn {
    /// Returns every possible number of marked balls among the drawn ones, and in proportion how
    /// likely it is: from the smallest up by the ratios of their probabilities,
    /// (m - n)(d - n) / ((n + 1)(u - d + n + 1)). With at most 1,000 balls the weights stay below
    /// C(1000, 500) < 1e300.
    fn weights(self) -> impl Iterator<Item = (u64, f64)> {
        let Self {
            drawn,
            marked,
            unmarked,
        } = self;

        let smallest = drawn.saturating_sub(unmarked);
        let mut weight = 1.0;
        (smallest..=drawn.min(marked)).map(move |n| {
            let here = weight;
            weight *=
                ((marked - n) * (drawn - n)) as f64 / ((n + 1) * (unmarked + n + 1 - drawn)) as f64;
            (n, here)
        })
    }
}
