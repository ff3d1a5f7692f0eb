//! Walking over everything that an environment has counted, state by state in order of number: its
//! rows by one statement, and the journal beside them.

use std::iter::Peekable;
use std::ops::ControlFlow;

use futures::TryStreamExt;
use futures::stream::BoxStream;
use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::columns::mark;
use super::error::{spoiled, unreadable};
use super::pending::View;
use crate::domain::{EnvironmentId, Tally};
use crate::store::StoreError;
use crate::store::packed::cells::{Place, Spoiled};
use crate::store::packed::merge::Merge;
use crate::store::packed::row::{RowName, first_state, row_of};
use crate::store::packed::unfolded::Outdated;

/// A cell with its place.
pub(super) type Placed = (Place, Tally);

/// What is shown of a row: what is stored in it, and what the journal has for it.
#[derive(Debug, Default)]
pub(super) struct RowCells {
    /// In order of place.
    pub(super) stored: Vec<Placed>,
    /// In order of place.
    pub(super) unfolded: Vec<Placed>,
}

/// How a walk goes on, or why it does not.
pub(super) type Step = Result<ControlFlow<()>, StoreError>;

/// Which rows are read.
#[derive(Debug, Clone, Copy)]
pub(super) enum Wanted<'a> {
    /// Those of states from one on, as many at most. Of the journal too, what comes after the last
    /// of them is not shown.
    From(u64, u32),
    /// All.
    All,
    /// Those of these ids, in order, as a list in JSON; all of the journal.
    These(&'a str),
}

impl Wanted<'_> {
    /// Returns the first state that is wanted.
    fn from(self) -> u64 {
        match self {
            Self::From(state, _) => state,
            Self::All | Self::These(_) => 0,
        }
    }

    /// Returns how many rows are read at most; all of them if negative.
    fn most(self) -> i64 {
        match self {
            Self::From(_, most) => i64::from(most),
            Self::All | Self::These(_) => -1,
        }
    }
}

/// Shows every state at or after one with its cells, in order, until told to stop.
pub(super) async fn states(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    view: &View,
    wanted: Wanted<'_>,
    mut show: impl FnMut(u64, &[Placed]) -> Step,
) -> Result<Result<(), Outdated>, StoreError> {
    rows(connection, id, view, wanted, |row| {
        let cells = row.into_sum();
        let states = cells.chunk_by(|(a, _), (b, _)| a.state == b.state);
        for state in states.skip_while(|state| state[0].0.state < wanted.from()) {
            if show(state[0].0.state, state)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        Ok(ControlFlow::Continue(()))
    })
    .await
}

/// Shows rows in order, until told to stop. `Outdated` where a fold was begun since the view was
/// taken; nothing was shown then.
pub(super) async fn rows(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    view: &View,
    wanted: Wanted<'_>,
    mut show: impl FnMut(RowCells) -> Step,
) -> Result<Result<(), Outdated>, StoreError> {
    let mut found = select(connection, id, view, wanted);
    let mut next = found.try_next().await.map_err(unreadable)?;
    let first = next.as_ref().ok_or(StoreError::UnknownEnvironment)?;
    let mark = mark(first, 0).map_err(unreadable)?;
    let start = first_state(row_of(wanted.from()));
    let Ok(unfolded) = view.unfolded.from(start, mark) else {
        return Ok(Err(Outdated));
    };

    let mut unfolded = unfolded.peekable();
    let mut shown = 0;
    while let Some(row) = next {
        let Some((name, stored)) = stored(&row, view)? else {
            break;
        };
        if show_before(&mut unfolded, first_state(name.row), &mut show)?.is_break() {
            return Ok(Ok(()));
        }
        let unfolded = take_row(&mut unfolded, name.row)?;
        if show(RowCells { stored, unfolded })?.is_break() {
            return Ok(Ok(()));
        }

        shown += 1;
        // Rows that have arrived do not wait, and others shall have their turn.
        tokio::task::consume_budget().await;
        next = found.try_next().await.map_err(unreadable)?;
    }

    if shown != wanted.most() {
        let _ended_or_stopped = show_before(&mut unfolded, u64::MAX, &mut show)?;
    }
    Ok(Ok(()))
}

/// Asks for the rows that are wanted, in order, each with the mark of the fold; where there is none,
/// for the mark alone.
fn select<'c>(
    connection: &'c mut SqliteConnection,
    id: EnvironmentId,
    view: &View,
    wanted: Wanted<'_>,
) -> BoxStream<'c, Result<SqliteRow, sqlx::Error>> {
    let (text, these) = match wanted {
        Wanted::These(ids) => (
            "select totals.folded, totals.fold_row, packed.id, packed.cells
             from totals left join packed on packed.id in (select value from json_each(?5))
                 and packed.id between ?2 and ?3
             where totals.environment = ?1 order by packed.id limit ?4",
            Some(ids.to_owned()),
        ),
        Wanted::From(..) | Wanted::All => (
            "select totals.folded, totals.fold_row, packed.id, packed.cells
             from totals left join packed on packed.id between ?2 and ?3
             where totals.environment = ?1 order by packed.id limit ?4",
            None,
        ),
    };

    // Without a block there are no rows.
    let [first, last] = view.layout.map_or([1, 0], |layout| {
        [layout.id_of_state(wanted.from()), layout.last()]
    });
    let query = sqlx::query(text).bind(id.0).bind(first).bind(last);
    query.bind(wanted.most()).bind(these).fetch(connection)
}

/// Reads a row; `None` where there is none.
fn stored(row: &SqliteRow, view: &View) -> Result<Option<(RowName, Vec<Placed>)>, StoreError> {
    let id: Option<i64> = row.try_get(2).map_err(unreadable)?;
    let Some((id, layout)) = id.zip(view.layout) else {
        return Ok(None);
    };
    let name = layout.name(id);
    let cells = cells_of(name, row.try_get(3).map_err(unreadable)?)?;
    Ok(Some((name, cells)))
}

/// Reads the cells of a row.
pub(super) fn cells_of(name: RowName, bytes: &[u8]) -> Result<Vec<Placed>, StoreError> {
    let cells = name.read(bytes).and_then(Iterator::collect);
    cells.map_err(|_| spoiled(&format!("row {} of the counts", name.row)))
}

/// Shows what rows that are not there have in the journal, up to a state.
fn show_before(
    unfolded: &mut Peekable<Merge<'_>>,
    end: u64,
    show: &mut impl FnMut(RowCells) -> Step,
) -> Step {
    while let Some(cell) = unfolded.peek() {
        let row = match cell {
            Ok((place, _)) if place.state >= end => break,
            Ok((place, _)) => row_of(place.state),
            Err(Spoiled) => return Err(spoiled_journal()),
        };
        let unfolded = take_row(unfolded, row)?;
        let stored = Vec::new();
        if show(RowCells { stored, unfolded })?.is_break() {
            return Ok(ControlFlow::Break(()));
        }
    }
    Ok(ControlFlow::Continue(()))
}

/// Takes what the journal has of a row.
fn take_row(unfolded: &mut Peekable<Merge<'_>>, row: u64) -> Result<Vec<Placed>, StoreError> {
    let mut cells = Vec::new();
    let is_in_row = |cell: &Result<Placed, Spoiled>| {
        cell.as_ref()
            .map_or(true, |(place, _)| row_of(place.state) == row)
    };
    while let Some(cell) = unfolded.next_if(is_in_row) {
        cells.push(cell.map_err(|_| spoiled_journal())?);
    }
    Ok(cells)
}

impl RowCells {
    /// Returns the cells of both, in order of place, each place once.
    pub(super) fn into_sum(self) -> Vec<Placed> {
        let Self {
            mut stored,
            unfolded,
        } = self;
        if stored.is_empty() {
            return unfolded;
        }
        if !unfolded.is_empty() {
            stored.extend(unfolded);
            add_equal(&mut stored);
        }
        stored
    }
}

/// Sorts cells, and adds those of one place together.
pub(super) fn add_equal(cells: &mut Vec<Placed>) {
    // Two sorted halves, which a stable sort merges.
    cells.sort_by_key(|(place, _)| *place);
    cells.dedup_by(|later, first| {
        let is_same = later.0 == first.0;
        if is_same {
            first.1.add(later.1);
        }
        is_same
    });
}

fn spoiled_journal() -> StoreError {
    spoiled("the journal of counts")
}
