//! Ingest: numbered batches of transitions, and the receipts that acknowledge them.

use bytes::Bytes;
use nudge_core::domain::{
    Acknowledged, Batch, Entry, Label, Presence, ProducerId, Record, Records, Rejection, Schema,
    Sequence, Undecodable, Values, Widths,
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
            let decode = |transition: proto::Transition| {
                let track = transition.track;
                record(&widths, transition)
                    .map_err(|fault| Undecodable::from(fault).of_track(track))
            };
            Records::collect(widths.clone(), rows.transitions.into_iter().map(decode))
        }
        Some(Transitions::Columns(columns)) => {
            within_limit(columns.count as usize)?;
            records(&widths, columns).map_err(|faults| Problem::invalid("batch", faults))?
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

fn record(widths: &Widths, transition: proto::Transition) -> Result<Record, (String, String)> {
    let entry = entry(transition.entry).map_err(|reason| ("/entry".to_owned(), reason))?;
    let count = transition.count.unwrap_or(1);
    let (agents, outcomes) = (widths.agents.len(), widths.outcomes.len());
    Ok(Record {
        state: transition.state,
        actions: transition.actions,
        actions_present: flags("/actions_present", transition.actions_present, agents)?,
        outcomes: transition.outcomes,
        outcomes_present: flags("/outcomes_present", transition.outcomes_present, outcomes)?,
        entry,
        count,
        track: transition.track,
    })
}

/// Unpacks the flags of a record; none where all are set.
fn flags(field: &str, bits: Bytes, slots: usize) -> Result<Vec<bool>, (String, String)> {
    let got = bits.len();
    let present = Presence::from_bits(bits, slots).ok_or_else(|| {
        let expected = Presence::bytes_of(slots);
        let reason = format!("got {got} bytes, expected {expected} for a bit each, or none");
        (field.to_owned(), reason)
    })?;
    Ok(match present.is_all() {
        true => Vec::new(),
        false => (0..slots).map(|slot| present.has(slot)).collect(),
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

fn records(widths: &Widths, columns: proto::Columns) -> Result<Records, Vec<Fault>> {
    let proto::Columns {
        count,
        states,
        actions,
        entries,
        counts,
        states_le,
        actions_le,
        outcomes_le,
        actions_present,
        outcomes_present,
        tracks,
    } = columns;
    let len = count as usize;
    let mut faults = Vec::new();

    let of = |name, width| Column { name, len, width };
    let states = of("states", widths.state).values(states, states_le, &mut faults);
    let actions = of("actions", widths.actions).values(actions, actions_le, &mut faults);
    let optional = [
        ("entries", entries.len()),
        ("counts", counts.len()),
        ("tracks", tracks.len()),
    ];
    for (name, got) in optional {
        if got != 0 && got != len {
            faults.push(of(name, 1).fault("", format!("got {got} values")));
        }
    }

    let acted = of("actions_present", widths.agents.len());
    let actions_present = acted.presence(actions_present, &mut faults);
    let (outcomes, outcomes_present) = if widths.outcomes.is_empty() {
        none_expected("outcomes_le", &outcomes_le, &mut faults);
        none_expected("outcomes_present", &outcomes_present, &mut faults);
        Default::default()
    } else {
        let observed = of("outcomes_present", widths.outcomes.len());
        let present = observed.presence(outcomes_present, &mut faults);
        let column = of("outcomes", widths.outcome_values());
        (column.perhaps(outcomes_le, &mut faults), present)
    };

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

    let entries = entries.iter().enumerate().map(decode).collect();
    Ok(Records {
        len,
        states,
        actions,
        actions_present,
        outcomes,
        outcomes_present,
        entries,
        counts,
        tracks: tracks.into_iter().map(Some).collect(),
        undecodable,
    }
    .normalised(widths))
}

fn none_expected(field: &str, bytes: &Bytes, faults: &mut Vec<Fault>) {
    if !bytes.is_empty() {
        let got = bytes.len();
        let detail = format!("got {got} bytes, expected none: this environment has no outcomes");
        faults.push(Fault::new(format!("/columns/{field}"), detail));
    }
}

/// A column of a batch, and how many values it is to have.
struct Column {
    name: &'static str,
    len: usize,
    width: usize,
}

impl Column {
    /// Takes the values in the form that they came in, which is one of two: packed floats, or
    /// bytes, which stay where they are.
    fn values(self, packed: Vec<f32>, bytes: Bytes, faults: &mut Vec<Fault>) -> Values {
        let expected = self.len * self.width;
        let (floats, size) = (packed.len(), bytes.len());
        if bytes.is_empty() {
            if floats != expected {
                faults.push(self.fault("", format!("got {floats} values")));
            }
            return packed.into();
        }

        if !packed.is_empty() {
            let name = self.name;
            let detail = format!(
                "got {size} bytes beside {floats} values in `{name}`, expected one of the two"
            );
            faults.push(Fault::new(self.pointer("_le"), detail));
        }
        if size != expected * size_of::<f32>() {
            faults.push(self.fault("_le", format!("got {size} bytes")));
        }
        Values::from_le(bytes).unwrap_or_default()
    }

    /// Takes the values as bytes, unless all of them are left out.
    fn perhaps(self, bytes: Bytes, faults: &mut Vec<Fault>) -> Values {
        match bytes.is_empty() {
            true => Values::default(),
            false => self.values(Vec::new(), bytes, faults),
        }
    }

    /// Takes a bit a slot.
    fn presence(self, bits: Bytes, faults: &mut Vec<Fault>) -> Presence {
        let (got, slots) = (bits.len(), self.len * self.width);
        Presence::from_bits(bits, slots).unwrap_or_else(|| {
            let (len, width) = (self.len, self.width);
            let expected = Presence::bytes_of(slots);
            let detail = format!(
                "got {got} bytes, expected {expected} for {len} transitions of {width} bits each, or none"
            );
            faults.push(Fault::new(self.pointer(""), detail));
            Presence::default()
        })
    }

    fn fault(&self, form: &str, got: String) -> Fault {
        let Self { len, width, .. } = self;
        let expected = match form {
            "" => format!("{} for {len} transitions", len * width),
            _ => {
                let (all, row) = (len * width * size_of::<f32>(), width * size_of::<f32>());
                format!("{all} for {len} transitions of {row} each")
            }
        };
        Fault::new(self.pointer(form), format!("{got}, expected {expected}"))
    }

    fn pointer(&self, form: &str) -> String {
        format!("/columns/{}{form}", self.name)
    }
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
