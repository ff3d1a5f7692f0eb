//! Ingest: numbered batches of transitions, and the receipts that acknowledge them.

use nudge_core::domain::{
    Acknowledged, Batch, Entry, Label, ProducerId, Record, Records, Rejection, Schema, Sequence,
    Widths,
};
use nudge_core::error::{ErrorKind, Fault, Problem};

use crate::{MOST_BATCH_TRANSITIONS, proto};

/// Decodes a batch. Its own faults fail it as a whole; those of single records keep their place in
/// it.
pub fn batch(schema: &Schema, batch: proto::Batch) -> Result<Batch, Problem> {
    use proto::batch::Transitions;
    let sequence = sequence(batch.sequence)?;
    let segment = segment(&batch.segment)?;
    let widths = Widths::of_schema(schema);
    let records = match batch.transitions {
        None => Records::default(),
        Some(Transitions::Rows(rows)) => {
            within_limit(rows.transitions.len())?;
            Records::collect(widths, rows.transitions.into_iter().map(record))
        }
        Some(Transitions::Columns(columns)) => {
            within_limit(columns.count as usize)?;
            records(widths, columns).map_err(|faults| Problem::invalid("batch", faults))?
        }
    };

    Ok(Batch {
        sequence,
        segment,
        records,
    })
}

/// Decodes a producer's id.
pub fn producer(text: &str) -> Result<ProducerId, Problem> {
    text.parse().map_err(|detail: String| {
        Problem::invalid("producer", vec![Fault::new("/producer", detail)])
    })
}

/// Decodes the number of a batch.
pub fn sequence(number: u64) -> Result<Sequence, Problem> {
    Sequence::new(number)
        .map_err(|detail| Problem::invalid("batch", vec![Fault::new("/sequence", detail)]))
}

pub(crate) fn segment(text: &str) -> Result<Option<Label>, Problem> {
    if text.is_empty() {
        return Ok(None);
    }
    text.parse()
        .map(Some)
        .map_err(|detail: String| Problem::invalid("batch", vec![Fault::new("/segment", detail)]))
}

pub(crate) fn within_limit(transitions: usize) -> Result<(), Problem> {
    if transitions <= MOST_BATCH_TRANSITIONS {
        return Ok(());
    }
    let message = format!(
        "got {transitions} transitions in a batch, expected at most {MOST_BATCH_TRANSITIONS}"
    );
    Err(Problem::new(
        ErrorKind::TooLarge,
        "BATCH_TOO_LARGE",
        message,
    ))
}

fn record(transition: proto::Transition) -> Result<Record, (String, String)> {
    let entry = entry(transition.entry).map_err(|reason| ("/entry".to_owned(), reason))?;
    let count = transition.count.unwrap_or(1);
    Ok(Record {
        state: transition.state,
        actions: transition.actions,
        entry,
        count,
    })
}

fn entry(number: i32) -> Result<Entry, String> {
    match proto::Entry::try_from(number) {
        Ok(proto::Entry::Unspecified) => Ok(Entry::Unknown),
        Ok(proto::Entry::Stayed) => Ok(Entry::Stayed),
        Ok(proto::Entry::Entered) => Ok(Entry::Entered),
        Err(_) => Err(format!("got {number}, expected 0, 1 or 2")),
    }
}

fn records(widths: Widths, columns: proto::Columns) -> Result<Records, Vec<Fault>> {
    let len = columns.count as usize;
    let mut faults = Vec::new();
    let mut check = |pointer: &str, got: usize, expected: usize| {
        if got != expected {
            let detail = format!("got {got} values, expected {expected} for {len} transitions");
            faults.push(Fault::new(pointer, detail));
        }
    };

    check("/columns/states", columns.states.len(), len * widths.state);
    check(
        "/columns/actions",
        columns.actions.len(),
        len * widths.actions,
    );
    for (pointer, got) in [
        ("/columns/entries", columns.entries.len()),
        ("/columns/counts", columns.counts.len()),
    ] {
        check(pointer, got, if got == 0 { 0 } else { len });
    }

    if !faults.is_empty() {
        return Err(faults);
    }

    let mut undecodable = Vec::new();
    let decode = |(index, number): (usize, &i32)| {
        entry(*number).unwrap_or_else(|reason| {
            undecodable.push(Rejection {
                index: index as u32,
                field: "/entry".into(),
                reason,
            });
            Entry::Unknown
        })
    };

    let entries = columns.entries.iter().enumerate().map(decode).collect();
    let proto::Columns {
        states,
        actions,
        counts,
        ..
    } = columns;

    Ok(Records {
        len,
        states,
        actions,
        entries,
        counts,
        undecodable,
    }
    .normalised())
}

/// Encodes what a producer is told about a batch.
pub fn receipt(sequence: Sequence, told: Acknowledged) -> proto::Receipt {
    use proto::BatchStatus::{Applied, Duplicate, Rejected, Unverified};
    let (status, receipt) = match told {
        Acknowledged::Applied(receipt) => (Applied, Some(receipt)),
        Acknowledged::Rejected(receipt) => (Rejected, Some(receipt)),
        Acknowledged::Duplicate(receipt) => (Duplicate, Some(receipt)),
        Acknowledged::Untold => (Duplicate, None),
        Acknowledged::Unverified => (Unverified, None),
    };

    let unverified = receipt.is_none();
    let receipt = receipt.unwrap_or_default();

    proto::Receipt {
        sequence: sequence.get(),
        status: status.into(),
        accepted: receipt.accepted,
        rejected_count: receipt.rejected_count,
        rejected: receipt.rejected.into_iter().map(Into::into).collect(),
        unverified,
    }
}

/// Encodes acknowledgements, which are in order, after everything up to a number was acknowledged:
/// as many together as fit into a message, for the receipt of a batch of rejections has dozens of
/// kilobytes. The number of each message covers all receipts before it.
pub fn acknowledgements(
    told: Vec<(Sequence, Acknowledged)>,
    committed: Sequence,
) -> Vec<proto::IngestResponse> {
    let receipts = told
        .into_iter()
        .map(|(sequence, told)| receipt(sequence, told));
    let acknowledged = |committed: &mut u64, receipts: Vec<proto::Receipt>| {
        *committed = receipts
            .last()
            .map_or(*committed, |last| last.sequence.max(*committed));
        Some(proto::Acknowledgement {
            committed_sequence: *committed,
            receipts,
        })
    };

    let messages = crate::parts(receipts)
        .into_iter()
        .scan(committed.get(), acknowledged);

    messages
        .map(|one| proto::ingest_response::Message::Acknowledgement(one).into())
        .collect()
}

impl From<proto::ingest_response::Message> for proto::IngestResponse {
    fn from(message: proto::ingest_response::Message) -> Self {
        Self {
            message: Some(message),
        }
    }
}

impl From<Rejection> for proto::Rejection {
    fn from(rejection: Rejection) -> Self {
        Self {
            index: rejection.index,
            field: rejection.field,
            reason: rejection.reason,
        }
    }
}

#[cfg(test)]
mod tests {
    use nudge_core::domain::Receipt;

    use super::*;
    use crate::MOST_MESSAGE_BYTES;

    #[test]
    fn acknowledgements_of_many_rejections_fit_into_messages() {
        let number = |n: u64| Sequence::new(n).expect("a number");
        let rejection = |index| Rejection {
            index,
            field: "/state/0".into(),
            reason: "x".repeat(300),
        };
        let receipt = Receipt {
            accepted: 0,
            rejected_count: 100,
            rejected: (0..100).map(rejection).collect(),
        };
        let told = (6..=325)
            .map(|n| (number(n), Acknowledged::Rejected(receipt.clone())))
            .collect();

        let messages = acknowledgements(told, number(5));

        let of = |message: &proto::IngestResponse| match message.message.clone() {
            Some(proto::ingest_response::Message::Acknowledgement(told)) => told,
            other => panic!("{other:?}"),
        };
        let told: Vec<proto::Acknowledgement> = messages.iter().map(of).collect();
        assert!(
            messages.len() > 1
                && messages
                    .iter()
                    .all(|message| crate::bytes(message) <= MOST_MESSAGE_BYTES)
        );
        assert!(told.iter().all(
            |one| one.receipts.last().map(|last| last.sequence) == Some(one.committed_sequence)
        ));
        let sequences = told
            .iter()
            .flat_map(|one| one.receipts.iter().map(|receipt| receipt.sequence));
        assert!(sequences.eq(6..=325), "each once, in order");
        assert!(acknowledgements(Vec::new(), number(5)).is_empty());
    }
}
