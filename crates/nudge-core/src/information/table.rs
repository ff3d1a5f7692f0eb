//! Contingency tables, of which every figure in this module is a function.
//!
//! Not for counts that still grow: a table is built once, from finished counts, and is valid from
//! then on.

/// The largest total of a [`Table`]: 2^63 - 1, the largest count the service can store.
/// Products of two sums then fit in 126 bits, so that n N and r c are compared exactly.
pub const LARGEST_TOTAL: u64 = i64::MAX as u64;

/// One occupied cell of a [`Table`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Occupied {
    /// The row's position in [`Table::rows`] and [`Table::row_labels`].
    pub row: u32,
    /// The column's position in [`Table::columns`] and [`Table::column_labels`].
    pub column: u32,
    /// The count, at least 1.
    pub n: u64,
}

/// A contingency table by its occupied cells, rows and columns.
///
/// Unoccupied rows and columns are left out, since they change no figure; labels may therefore come
/// from alphabets of any size. Cells are in the order of their row, then column labels, and every
/// cell, row and column listed has a count of at least 1. The default table is empty.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Table {
    cells: Vec<Occupied>,
    rows: Vec<u64>,
    columns: Vec<u64>,
    row_labels: Vec<u64>,
    column_labels: Vec<u64>,
    total: u64,
}

impl Table {
    /// Builds the table of `(row label, column label, count)` triples, in any order: counts of the
    /// same cell are added up, and zeros are skipped.
    ///
    /// # Panics
    ///
    /// If the counts sum to more than [`LARGEST_TOTAL`].
    pub fn from_counts(counts: impl IntoIterator<Item = (u64, u64, u64)>) -> Self {
        let given = counts.into_iter();
        let mut counts = Vec::with_capacity(given.size_hint().1.unwrap_or(0));
        counts.extend(given.filter(|&(_, _, n)| n > 0));
        let total: u128 = counts.iter().map(|&(_, _, n)| u128::from(n)).sum();
        assert!(
            total <= u128::from(LARGEST_TOTAL),
            "the counts of a table sum to {total}, more than 2^63 - 1"
        );
        merge_equal_cells(&mut counts);

        let column_labels = distinct(counts.iter().map(|&(_, column, _)| column));
        let mut columns = vec![0; column_labels.len()];
        let (mut row_labels, mut rows) = (Vec::new(), Vec::new());
        let mut cells = Vec::with_capacity(counts.len());
        // The counts are in order of row, so a row is new exactly when its label is.
        for (row_label, column_label, n) in counts {
            if row_labels.last() != Some(&row_label) {
                row_labels.push(row_label);
                rows.push(0);
            }
            let row = rows.len() - 1;
            let column = position(&column_labels, column_label);
            rows[row] += n;
            columns[column] += n;
            cells.push(Occupied {
                row: compressed(row),
                column: compressed(column),
                n,
            });
        }
        Self {
            cells,
            rows,
            columns,
            row_labels,
            column_labels,
            total: total as u64,
        }
    }

    /// Returns the occupied cells, by row and then by column.
    pub fn cells(&self) -> &[Occupied] {
        &self.cells
    }

    /// Returns the occupied cells as `(row label, column label, count)` triples, in the same order.
    pub fn triples(&self) -> impl Iterator<Item = (u64, u64, u64)> + Clone {
        self.cells.iter().map(|cell| {
            let row = self.row_labels[cell.row as usize];
            (row, self.column_labels[cell.column as usize], cell.n)
        })
    }

    /// Returns the sums r_i of the occupied rows.
    pub fn rows(&self) -> &[u64] {
        &self.rows
    }

    /// Returns the sums c_j of the occupied columns.
    pub fn columns(&self) -> &[u64] {
        &self.columns
    }

    /// Returns the labels of the occupied rows, ascending: a binary search for a label finds its
    /// row, or that it has no counts.
    pub fn row_labels(&self) -> &[u64] {
        &self.row_labels
    }

    /// Returns the labels of the occupied columns, ascending.
    pub fn column_labels(&self) -> &[u64] {
        &self.column_labels
    }

    /// Returns the sum N of all counts.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// Returns whether there is at most one occupied row or column, so that nothing can depend on
    /// anything.
    pub fn is_line(&self) -> bool {
        self.rows.len() <= 1 || self.columns.len() <= 1
    }

    /// Returns the sum of the row with a label: 0 where that has no counts.
    pub fn row_sum(&self, label: u64) -> u64 {
        self.row_labels
            .binary_search(&label)
            .map_or(0, |row| self.rows[row])
    }

    /// Returns the sum of tables.
    ///
    /// # Panics
    ///
    /// If the counts sum to more than [`LARGEST_TOTAL`].
    pub fn sum(tables: &[Self]) -> Self {
        Self::from_counts(tables.iter().flat_map(Self::triples))
    }

    /// Returns the table with rows and columns exchanged.
    pub fn transposed(&self) -> Self {
        // Where each column's cells begin: cells are in order of row already, so that each finds
        // its place by its column.
        let mut next = vec![0; self.columns.len() + 1];
        self.cells
            .iter()
            .for_each(|cell| next[cell.column as usize + 1] += 1);
        (1..next.len()).for_each(|column| next[column] += next[column - 1]);

        let mut cells = self.cells.clone();
        for cell in &self.cells {
            let place = &mut next[cell.column as usize];
            cells[*place] = Occupied {
                row: cell.column,
                column: cell.row,
                n: cell.n,
            };
            *place += 1;
        }

        Self {
            cells,
            rows: self.columns.clone(),
            columns: self.rows.clone(),
            row_labels: self.column_labels.clone(),
            column_labels: self.row_labels.clone(),
            total: self.total,
        }
    }

    /// Returns the cells of the row at a position in [`rows`](Self::rows); none where there is no
    /// such row.
    pub fn row(&self, row: usize) -> &[Occupied] {
        let start = self.cells.partition_point(|cell| (cell.row as usize) < row);
        let length = self.cells[start..].partition_point(|cell| cell.row as usize == row);
        &self.cells[start..start + length]
    }
}

/// Sorts the triples by their labels and adds up those with the same labels.
fn merge_equal_cells(counts: &mut Vec<(u64, u64, u64)>) {
    counts.sort_unstable_by_key(|&(row, column, _)| (row, column));
    counts.dedup_by(|next, kept| {
        let same = (next.0, next.1) == (kept.0, kept.1);
        if same {
            kept.2 += next.2;
        }
        same
    });
}

/// Returns each label once, ascending. Small alphabets are the rule, and a set of bits sorts them
/// by itself.
fn distinct(labels: impl Iterator<Item = u64> + Clone) -> Vec<u64> {
    let small = labels.clone().try_fold(0_u64, |seen, label| {
        Some(seen | 1 << u32::try_from(label).ok().filter(|bit| *bit < 64)?)
    });

    if let Some(seen) = small {
        return bits(seen).collect();
    }

    let mut labels: Vec<u64> = labels.collect();
    labels.sort_unstable();
    labels.dedup();
    labels
}

/// Returns the positions of the bits that are set, ascending.
fn bits(mut set: u64) -> impl Iterator<Item = u64> {
    std::iter::from_fn(move || {
        let lowest = (set != 0).then(|| u64::from(set.trailing_zeros()))?;
        set &= set - 1;
        Some(lowest)
    })
}

fn position(labels: &[u64], label: u64) -> usize {
    labels.partition_point(|&other| other < label)
}

fn compressed(position: usize) -> u32 {
    u32::try_from(position).expect("2^32 occupied rows or columns would not have fitted in memory")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::samples::counts;
    use proptest::prelude::*;

    #[test]
    fn compresses_labels_of_a_huge_alphabet() {
        let table = Table::from_counts([
            (1 << 62, 7, 2),
            (3, u64::MAX, 5),
            (3, 7, 0),
            (1 << 62, 7, 1),
        ]);

        assert_eq!(table.row_labels(), [3, 1 << 62]);
        assert_eq!(table.column_labels(), [7, u64::MAX]);
        assert_eq!(
            table.cells(),
            [
                Occupied {
                    row: 0,
                    column: 1,
                    n: 5
                },
                Occupied {
                    row: 1,
                    column: 0,
                    n: 3
                }
            ]
        );
        assert_eq!(
            (table.rows(), table.columns(), table.total()),
            (&[5, 3][..], &[3, 5][..], 8)
        );
    }

    #[test]
    fn zeros_alone_leave_the_empty_table() {
        assert_eq!(Table::from_counts([(1, 2, 0), (3, 4, 0)]), Table::default());
    }

    #[test]
    fn holds_the_largest_total() {
        assert_eq!(
            Table::from_counts([(0, 0, LARGEST_TOTAL - 1), (0, 0, 1)]).total(),
            LARGEST_TOTAL
        );
    }

    #[test]
    #[should_panic(expected = "more than 2^63 - 1")]
    fn refuses_a_larger_total() {
        Table::from_counts([(0, 0, u64::MAX), (0, 0, u64::MAX)]);
    }

    proptest! {
        #[test]
        fn exchanging_rows_and_columns_is_building_it_so(counts in counts()) {
            let exchanged = counts.iter().map(|(row, column, n)| (*column, *row, *n));
            prop_assert_eq!(Table::from_counts(counts.clone()).transposed(), Table::from_counts(exchanged));
        }

        #[test]
        fn merging_order_does_not_matter(
            (ordered, shuffled) in counts().prop_flat_map(|c| (Just(c.clone()), Just(c).prop_shuffle())),
        ) {
            prop_assert_eq!(Table::from_counts(ordered), Table::from_counts(shuffled));
        }

        #[test]
        fn rows_partition_the_cells_and_sum_to_the_margins(counts in counts()) {
            let table = Table::from_counts(counts);
            let rows: Vec<_> = (0..table.rows().len()).map(|row| table.row(row)).collect();

            prop_assert_eq!(rows.concat(), table.cells());
            let sums: Vec<u64> = rows.iter().map(|row| row.iter().map(|cell| cell.n).sum()).collect();
            prop_assert_eq!(sums, table.rows());
            let by_label: Vec<u64> = table.row_labels().iter().map(|label| table.row_sum(*label)).collect();
            prop_assert_eq!(by_label, table.rows());
            prop_assert_eq!(table.row_sum(u64::MAX), 0);
            prop_assert_eq!(table.columns().iter().sum::<u64>(), table.total());
            prop_assert!(table.row(rows.len()).is_empty());
        }
    }
}
