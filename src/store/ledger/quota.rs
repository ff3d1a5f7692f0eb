//! Quotas and overflow: what an environment has no room for. Exact, and free of look-ups until a
//! quota is near.

use super::batch::{Numbered, Refusal};
use super::book::Ledger;
use super::books::{Books, CellAt};
use super::merge::{CellName, stored_label};
use crate::domain::Increment;

/// The largest number that a database holds.
const MOST: u64 = i64::MAX as u64;

/// Returns why a batch, which comes next in order, cannot be counted.
pub(super) async fn refusal<B: Books>(
    books: &mut B,
    ledger: &mut Ledger<'_>,
    batch: &Numbered,
) -> Result<Option<Refusal>, B::Error> {
    if overflows(ledger, batch) {
        return Ok(Some(Refusal::Overflow));
    }

    let quotas = ledger.quotas;
    if !has_room_for_producer(books, ledger, batch).await? {
        return Ok(Some(over_quota("producers", quotas.producers)));
    }
    if !has_room_for_segment(books, ledger, batch).await? {
        return Ok(Some(over_quota("segments", quotas.segments)));
    }
    // Last, because what it adds to the ledger's count of cells is counted from here on.
    if !has_room_for_cells(books, ledger, batch).await? {
        return Ok(Some(over_quota("cells", quotas.cells)));
    }
    Ok(None)
}

fn over_quota(what: &'static str, limit: u64) -> Refusal {
    Refusal::Quota { what, limit }
}

/// The sum of all visits bounds every visit and every entry, so it is the only sum to check.
fn overflows(ledger: &Ledger<'_>, batch: &Numbered) -> bool {
    let sum = ledger.revision().checked_add(batch.increment.transitions);
    let outcomes = batch.increment.outcomes.iter().flatten();
    let mut outcomes = outcomes.filter(|cell| **cell != Increment::MISSING);
    let mut joints = batch.increment.cells.iter().map(|(_, joint, _)| joint);
    sum.is_none_or(|sum| sum > MOST)
        || joints.any(|joint| *joint > MOST)
        || outcomes.any(|cell| *cell > MOST)
}

async fn has_room_for_producer<B: Books>(
    books: &mut B,
    ledger: &Ledger<'_>,
    batch: &Numbered,
) -> Result<bool, B::Error> {
    if ledger.account(batch).is_known() {
        return Ok(true);
    }

    let stored = books.count_producers(ledger.environment).await?;
    let new = ledger.accounts().filter(|account| account.is_new()).count() as u64;
    Ok(stored + new < ledger.quotas.producers)
}

/// A segment begins with the first cell that is counted in it.
async fn has_room_for_segment<B: Books>(
    books: &mut B,
    ledger: &Ledger<'_>,
    batch: &Numbered,
) -> Result<bool, B::Error> {
    let label = stored_label(batch.increment.segment.as_ref());
    let is_known = ledger.segment(label).is_some() || ledger.merged.segments().contains(&label);
    if batch.increment.is_empty() || is_known {
        return Ok(true);
    }

    let stored = books.count_segments(ledger.environment).await?;
    let mut new = 0;
    for label in ledger.merged.segments() {
        new += u64::from(ledger.segment(label).is_none());
    }
    Ok(stored + new < ledger.quotas.segments)
}

/// First as if every cell were new. Only where that does not fit are cells looked up, and from then
/// on this commit keeps an exact count.
async fn has_room_for_cells<B: Books>(
    books: &mut B,
    ledger: &mut Ledger<'_>,
    batch: &Numbered,
) -> Result<bool, B::Error> {
    let room = ledger.quotas.cells.saturating_sub(ledger.cells);
    let fits = |cells: usize| (cells + batch.increment.most_cells()) as u64 <= room;
    let is_counted = ledger.fresh_cells.is_some();
    if !is_counted && (fits(ledger.merged.most_cells()) || fits(ledger.merged.count_cells())) {
        return Ok(true);
    }

    let accepted = match ledger.fresh_cells {
        Some(accepted) => accepted,
        None => {
            let cells = ledger.merged.cells().collect();
            count_fresh(books, ledger, cells).await?
        }
    };
    let absent = ledger.merged.absent(&batch.increment);
    let added = count_fresh(books, ledger, absent).await?;

    // A quota that was lowered below what is stored keeps nobody from counting in known cells.
    let fits = accepted + added <= room || added == 0;
    ledger.fresh_cells = Some(if fits { accepted + added } else { accepted });
    Ok(fits)
}

/// Returns how many of these cells the database does not have.
async fn count_fresh<B: Books>(
    books: &mut B,
    ledger: &Ledger<'_>,
    cells: Vec<CellName<'_>>,
) -> Result<u64, B::Error> {
    let candidates: Vec<CellAt<'_>> = cells
        .iter()
        .filter_map(|cell| in_stored_segment(ledger, cell))
        .collect();
    let present = books.count_cells(ledger.environment, &candidates).await?;
    Ok(cells.len() as u64 - present)
}

/// A segment that is new has no cells yet.
fn in_stored_segment<'k>(ledger: &Ledger<'_>, cell: &CellName<'k>) -> Option<CellAt<'k>> {
    Some(CellAt {
        state: cell.state,
        segment: ledger.segment(cell.segment)?,
        family: cell.family,
        joint: cell.joint,
    })
}
