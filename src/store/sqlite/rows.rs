//! Multi-row statements: one prepared text for each of a few chunk sizes.
//!
//! The driver's cost is per statement, so rows go by the hundred. A few sizes are enough for any
//! number of rows, and each text stays prepared.

/// Rows a chunk, largest first; each is tried until fewer are left.
const SIZES: [usize; 4] = [100, 25, 5, 1];

/// A statement with a list of rows in its middle.
pub(super) struct ManyRows([String; SIZES.len()]);

impl ManyRows {
    /// Makes the texts `head row, row, ... tail`.
    pub(super) fn new(head: &str, row: &str, tail: &str) -> Self {
        Self(SIZES.map(|size| format!("{head} {} {tail}", vec![row; size].join(", "))))
    }

    /// Returns the rows in chunks, each with the text that takes that many.
    pub(super) fn chunks<'a, R>(
        &'static self,
        mut rows: &'a [R],
    ) -> impl Iterator<Item = (&'static str, &'a [R])> {
        std::iter::from_fn(move || {
            let at = SIZES.iter().position(|size| *size <= rows.len())?;
            let (chunk, rest) = rows.split_at(SIZES[at]);
            rows = rest;
            Some((self.0[at].as_str(), chunk))
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use super::*;

    static INSERT: LazyLock<ManyRows> =
        LazyLock::new(|| ManyRows::new("insert into t values", "(?)", "returning 1"));

    #[test]
    fn every_row_is_in_one_chunk_of_its_size() {
        let rows: Vec<u32> = (0..237).collect();
        let chunks: Vec<_> = INSERT.chunks(&rows).collect();
        assert_eq!(
            chunks
                .iter()
                .map(|(_, chunk)| chunk.len())
                .collect::<Vec<_>>(),
            [100, 100, 25, 5, 5, 1, 1]
        );
        assert_eq!(
            chunks
                .iter()
                .flat_map(|(_, chunk)| chunk.iter().copied())
                .collect::<Vec<_>>(),
            rows
        );
        assert!(
            chunks
                .iter()
                .all(|(text, chunk)| text.matches('?').count() == chunk.len())
        );
        assert_eq!(chunks[6].0, "insert into t values (?) returning 1");
    }
}
