//! All cells of a state in the old layout, a row a cell, as one text: what is read of them until they
//! are moved. A row a cell would cost the driver 2 to 5 us and a hundred bytes; in a text it is 0.3
//! us and fifteen.

use crate::domain::{Cell, SegmentId, Tally};

/// The SQL of the cells of a state: four lists, of segments, joint actions, visits and
/// entries; null where there are no cells.
macro_rules! old_cells {
    ($state:literal) => {
        concat!(
            "(select group_concat(segment, ' ') || ';' || group_concat(joint, ' ') || ';' || group_concat(n, ' ')
                  || ';' || group_concat(ifnull(entries, '-'), ' ')
              from cells where cells.state = ",
            $state,
            ")"
        )
    };
}

pub(super) use old_cells;

/// Reads cells as they come; `None` where the text is not what the SQL writes, or a cell is of a
/// joint action that is not there.
pub(super) fn cells(text: &str, joint_actions: u64) -> Option<Vec<Cell>> {
    let mut lists = text.split(';').map(|list| list.split(' '));
    let (segments, joints) = (lists.next()?, lists.next()?);
    let (visits, entries) = (lists.next()?, lists.next()?);
    let cells = segments.zip(joints).zip(visits.zip(entries));
    cells
        .map(|((segment, joint), (n, entries))| cell(segment, joint, n, entries))
        .map(|cell| cell.filter(|cell| cell.joint < joint_actions))
        .collect()
}

fn cell(segment: &str, joint: &str, n: &str, entries: &str) -> Option<Cell> {
    let entries = match entries {
        "-" => None,
        known => Some(known.parse().ok()?),
    };
    let tally = Tally {
        n: n.parse().ok()?,
        entries,
    };
    Some(Cell {
        segment: SegmentId(segment.parse().ok()?),
        joint: joint.parse().ok()?,
        tally,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_become_cells() {
        let read =
            cells("7 7 8;3 900 3;1 2 9223372036854775807;1 - 0", 901).expect("what the SQL writes");
        let told: Vec<_> = read
            .iter()
            .map(|c| (c.joint, c.segment.0, c.tally.n, c.tally.entries))
            .collect();
        assert_eq!(
            told,
            [
                (3, 7, 1, Some(1)),
                (900, 7, 2, None),
                (3, 8, i64::MAX as u64, Some(0))
            ]
        );
        for spoiled in ["", "7;3;1", "7;3;-1;1", "7;x;1;1", "7;3;1;", "7;901;1;1"] {
            assert_eq!(cells(spoiled, 901), None, "{spoiled:?}");
        }
    }
}
