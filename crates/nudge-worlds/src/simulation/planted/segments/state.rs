//! One state that is seen in segments: what was seen, and the truth of it.

use nudge_core::information::{Occupied, Table};

/// One state, and the truth of it.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// What was seen in each segment by its number, ascending; rows are the ego's actions. Segments
    /// without visits are left out.
    pub tables: Vec<(usize, Table)>,
    /// The numbers of the segments in which the other depends on the ego, ascending; visited or
    /// not.
    pub dependent: Vec<usize>,
    /// sum_g w_g I(p_g, rho_g) in nats, w_g the expected share of the visits.
    pub information: f64,
}

impl State {
    /// Returns whether there is dependence within any segment.
    pub fn is_dependent(&self) -> bool {
        !self.dependent.is_empty()
    }

    /// Returns what was seen over all segments together.
    pub fn pooled(&self) -> Table {
        pooled(self.tables.iter().map(|(_, table)| table))
    }

    /// Returns what was seen, cut by segment.
    pub fn cut(&self) -> Vec<Table> {
        self.tables.iter().map(|(_, table)| table.clone()).collect()
    }
}

/// Adds tables up.
pub fn pooled<'a>(tables: impl IntoIterator<Item = &'a Table>) -> Table {
    let counts = |table: &'a Table| {
        let count = |cell: &Occupied| {
            (
                table.row_labels()[cell.row as usize],
                table.column_labels()[cell.column as usize],
                cell.n,
            )
        };
        table.cells().iter().map(count).collect::<Vec<_>>()
    };
    Table::from_counts(tables.into_iter().flat_map(counts))
}
