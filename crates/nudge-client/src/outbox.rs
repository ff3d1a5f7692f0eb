//! The outbox, a sliding window: transitions become numbered batches, which are kept until the
//! service has committed them. The numbers make it safe to send them again (idempotency).
//! Arithmetic only, no I/O and no clock.
//!
//! Batches that wait are in order of their numbers; the first `in_flight` of them were sent on the
//! present stream.

use std::collections::VecDeque;

use nudge_core::domain::{Collecting, Record, Records, Widths};
use nudge_wire::proto;

use crate::{ClientError, Totals};

/// What fixes where batches end and how many are kept.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Transitions that fill a batch.
    pub batch_size: usize,
    /// Batches without an acknowledgement from which nothing more is taken.
    pub capacity: usize,
    /// Whether the source makes the same batches again: then numbering starts at 1, and committed
    /// numbers are passed over.
    pub replay: bool,
}

pub(crate) struct Outbox {
    limits: Limits,
    widths: Widths,
    segment: String,
    building: Collecting,
    /// Whether the transitions of the batch that is being built have tracks.
    has_tracks: bool,
    waiting: VecDeque<Waiting>,
    in_flight: usize,
    committed: u64,
    resumed_once: bool,
    totals: Totals,
}

struct Waiting {
    /// Its columns are bytes that every sending shares.
    batch: proto::Batch,
    /// The position of its first transition among everything sent.
    position: u64,
    len: u64,
}

impl Outbox {
    pub(crate) fn new(limits: Limits, widths: Widths) -> Self {
        Self {
            limits,
            segment: String::new(),
            building: Collecting::new(widths.clone(), 0),
            has_tracks: false,
            widths,
            waiting: VecDeque::new(),
            in_flight: 0,
            committed: 0,
            resumed_once: false,
            totals: Totals::default(),
        }
    }

    pub(crate) fn totals(&self) -> &Totals {
        &self.totals
    }

    /// Returns whether more transitions may come. A batch is only ever begun when there is room for
    /// it.
    pub(crate) fn has_room(&self) -> bool {
        self.waiting.len() < self.limits.capacity
    }

    pub(crate) fn is_building(&self) -> bool {
        !self.building.is_empty()
    }

    /// Returns whether there is nothing to lose.
    pub(crate) fn is_empty(&self) -> bool {
        self.waiting.is_empty() && !self.is_building()
    }

    /// Returns the last sequence up to which nothing waits.
    pub(crate) fn settled(&self) -> u64 {
        self.waiting
            .front()
            .map_or(self.totals.last_sequence, |first| first.batch.sequence - 1)
    }

    /// Lowers the size of batches to what the service takes.
    pub(crate) fn shrink_batches(&mut self, most: usize) {
        self.limits.batch_size = self.limits.batch_size.min(most);
        if self.building.len() >= self.limits.batch_size {
            self.cut();
        }
    }

    /// Takes a transition, and closes the batch when it is full. One with a track and one without
    /// are never of one batch, for the columns of a batch have a track for each or for none.
    pub(crate) fn push(&mut self, transition: Record) {
        if transition.track.is_some() != self.has_tracks {
            self.cut();
            self.has_tracks = transition.track.is_some();
        }
        self.building.push(&transition);
        if self.building.len() >= self.limits.batch_size {
            self.cut();
        }
    }

    /// Closes the batch if the segment is another from here on.
    pub(crate) fn set_segment(&mut self, segment: String) {
        if segment != self.segment {
            self.cut();
            self.segment = segment;
        }
    }

    /// Closes the batch that is being built, if there is one. A replay passes over what is
    /// committed already.
    pub(crate) fn cut(&mut self) {
        if !self.is_building() {
            return;
        }

        // The next one has room for as much.
        let next = Collecting::new(self.widths.clone(), self.building.len());
        let records = std::mem::replace(&mut self.building, next).finish();
        let (position, len) = (self.totals.sent, records.len as u64);
        self.totals.sent += len;
        self.totals.last_sequence += 1;
        let sequence = self.totals.last_sequence;
        if sequence <= self.committed {
            self.totals.resumed += len;
            return;
        }

        let transitions = Some(proto::batch::Transitions::Columns(columns(records)));
        let batch = proto::Batch {
            sequence,
            segment: self.segment.clone(),
            transitions,
        };

        self.waiting.push_back(Waiting {
            batch,
            position,
            len,
        });
    }

    /// Returns the next batch to send while fewer than `window` are in flight, and counts it as
    /// sent.
    pub(crate) fn next_to_send(&mut self, window: usize) -> Option<proto::Batch> {
        if self.in_flight >= window {
            return None;
        }
        let next = self.waiting.get(self.in_flight)?;
        self.in_flight += 1;
        Some(next.batch.clone())
    }

    /// Returns whether a batch cut now would be sent now.
    pub(crate) fn would_send(&self, window: usize) -> bool {
        self.in_flight == self.waiting.len() && self.in_flight < window
    }

    /// Forgets that anything was sent: the stream is gone.
    pub(crate) fn unsend(&mut self) {
        self.in_flight = 0;
    }

    /// Begins a stream: drops what the service has committed, and returns whether that was
    /// anything. The rest is to be sent again.
    pub(crate) fn resume(&mut self, committed: u64) -> Result<bool, ClientError> {
        self.unsend();
        if !self.resumed_once && !self.limits.replay {
            // Whatever came before belongs to an earlier run, and numbering goes on behind it.
            self.totals.last_sequence = committed;
        }
        self.resumed_once = true;
        self.check_resume_point(committed)?;
        self.committed = committed;
        let before = self.waiting.len();
        self.drop_through(committed);
        Ok(self.waiting.len() < before)
    }

    fn check_resume_point(&self, committed: u64) -> Result<(), ClientError> {
        let last = self.totals.last_sequence;
        if committed < self.committed {
            let message = format!(
                "the service lost batches: it acknowledged {}, now it has {committed}",
                self.committed
            );
            return Err(ClientError::Disagreement(message));
        }

        if committed > last && !self.limits.replay {
            let message = format!(
                "the service has {committed} batches of this producer, which sent {last}: another one uses its id"
            );
            return Err(ClientError::Disagreement(message));
        }

        Ok(())
    }

    /// Takes an acknowledgement: receipts first, then everything else that it says is committed.
    pub(crate) fn acknowledge(
        &mut self,
        acknowledgement: proto::Acknowledgement,
    ) -> Result<(), ClientError> {
        let committed = acknowledgement.committed_sequence;
        let last_sent = self
            .in_flight
            .checked_sub(1)
            .map_or(0, |last| self.waiting[last].batch.sequence);
        if committed > last_sent.max(self.committed) {
            let message = format!("the service acknowledged batch {committed}, which was not sent");
            return Err(ClientError::Disagreement(message));
        }

        for receipt in acknowledgement.receipts {
            self.receive(receipt, committed);
        }

        self.drop_through(committed);
        self.committed = self.committed.max(committed);

        Ok(())
    }

    /// Settles one batch. A receipt that came before, or that claims more than is committed,
    /// changes nothing.
    fn receive(&mut self, receipt: proto::Receipt, committed: u64) {
        if receipt.sequence > committed {
            return;
        }

        self.drop_through(receipt.sequence.saturating_sub(1));
        if self
            .waiting
            .front()
            .is_some_and(|first| first.batch.sequence == receipt.sequence)
            && let Some(settled) = self.pop()
        {
            self.totals.receive(receipt, settled.position, settled.len);
        }
    }

    fn drop_through(&mut self, committed: u64) {
        while self
            .waiting
            .front()
            .is_some_and(|first| first.batch.sequence <= committed)
        {
            let dropped = self.pop().map_or(0, |dropped| dropped.len);
            self.totals.resumed += dropped;
        }
    }

    fn pop(&mut self) -> Option<Waiting> {
        self.in_flight = self.in_flight.saturating_sub(1);
        self.waiting.pop_front()
    }
}

/// Encodes transitions as columns of bytes; a column that only holds its default is left out.
fn columns(records: Records) -> proto::Columns {
    let Records {
        len,
        states,
        actions,
        actions_present,
        outcomes,
        outcomes_present,
        entries,
        counts,
        tracks,
        ..
    } = records;
    let entries = entries.into_iter().map(|entry| entry as i32).collect();
    proto::Columns {
        count: len as u32,
        states_le: states.into_le_bytes(),
        actions_le: actions.into_le_bytes(),
        outcomes_le: outcomes.into_le_bytes(),
        actions_present: actions_present.bits().clone(),
        outcomes_present: outcomes_present.bits().clone(),
        entries,
        counts,
        // All of a batch have one, or none has.
        tracks: tracks.into_iter().flatten().collect(),
        ..proto::Columns::default()
    }
}

#[cfg(test)]
mod tests {
    use nudge_core::domain::Entry;

    use super::*;

    fn outbox_of(limits: Limits) -> Outbox {
        let widths = Widths {
            state: 1,
            actions: 2,
            agents: [1, 1].into(),
            ..Widths::default()
        };
        Outbox::new(limits, widths)
    }

    fn outbox(batch_size: usize, replay: bool) -> Outbox {
        let mut outbox = outbox_of(Limits {
            batch_size,
            capacity: 4,
            replay,
        });
        outbox.resume(0).expect("the first stream");
        outbox
    }

    fn push(outbox: &mut Outbox, transitions: usize) {
        for i in 0..transitions {
            outbox.push(Record {
                entry: Entry::Entered,
                ..Record::new(vec![i as f32], vec![0.0, 1.0])
            });
        }
    }

    fn send_all(outbox: &mut Outbox, window: usize) -> Vec<u64> {
        std::iter::from_fn(|| outbox.next_to_send(window))
            .map(|batch| batch.sequence)
            .collect()
    }

    fn receipt(sequence: u64, accepted: u64) -> proto::Receipt {
        let status = proto::BatchStatus::Applied.into();
        proto::Receipt {
            sequence,
            status,
            accepted,
            ..proto::Receipt::default()
        }
    }

    fn acknowledgement(receipts: Vec<proto::Receipt>) -> proto::Acknowledgement {
        let committed_sequence = receipts.last().map_or(0, |last| last.sequence);
        proto::Acknowledgement {
            committed_sequence,
            receipts,
        }
    }

    #[test]
    fn a_batch_closes_by_size_and_at_a_new_segment() {
        let mut outbox = outbox(3, false);
        push(&mut outbox, 4);
        outbox.set_segment("trial-1".into());
        push(&mut outbox, 1);
        outbox.set_segment("trial-1".into());
        push(&mut outbox, 1);
        outbox.cut();
        outbox.cut();
        let batches: Vec<_> = std::iter::from_fn(|| outbox.next_to_send(9)).collect();
        let told: Vec<_> = batches
            .iter()
            .map(|batch| (batch.sequence, batch.segment.as_str()))
            .collect();
        assert_eq!(told, [(1, ""), (2, ""), (3, "trial-1")]);
        let Some(proto::batch::Transitions::Columns(columns)) = &batches[2].transitions else {
            panic!("columns")
        };
        assert_eq!(
            (
                columns.count,
                columns.states_le.len(),
                columns.actions_le.len()
            ),
            (2, 8, 16)
        );
        assert!(columns.counts.is_empty(), "once each is the default");
    }

    #[test]
    fn a_batch_has_a_track_for_each_or_for_none() {
        let mut outbox = outbox(3, false);
        for track in [None, Some(0), Some(7), None, None, None, Some(1)] {
            outbox.push(Record {
                track,
                ..Record::new(vec![0.0], vec![0.0, 1.0])
            });
        }
        outbox.cut();
        let batches = std::iter::from_fn(|| outbox.next_to_send(9));
        let told: Vec<(u32, Vec<u64>)> = batches
            .map(|batch| match batch.transitions {
                Some(proto::batch::Transitions::Columns(columns)) => {
                    (columns.count, columns.tracks)
                }
                other => panic!("columns, not {other:?}"),
            })
            .collect();
        let expected = [(1, vec![]), (2, vec![0, 7]), (3, vec![]), (1, vec![1])];
        assert_eq!(told, expected);
    }

    #[test]
    fn the_window_and_the_capacity_hold_back() {
        let mut outbox = outbox(1, false);
        push(&mut outbox, 4);
        assert!(!outbox.has_room());
        assert_eq!(send_all(&mut outbox, 2), [1, 2]);
        outbox
            .acknowledge(acknowledgement(vec![receipt(1, 1)]))
            .expect("sent");
        assert!(outbox.has_room());
        assert_eq!(send_all(&mut outbox, 2), [3]);
    }

    #[test]
    fn a_broken_stream_resends_in_order_what_is_not_committed() {
        let mut outbox = outbox(1, false);
        push(&mut outbox, 4);
        assert_eq!(send_all(&mut outbox, 9), [1, 2, 3, 4]);
        outbox
            .acknowledge(acknowledgement(vec![receipt(1, 1)]))
            .expect("sent");
        assert!(
            outbox.resume(2).expect("known"),
            "2 was committed, its receipt was lost"
        );
        assert_eq!(send_all(&mut outbox, 9), [3, 4]);
        outbox
            .acknowledge(acknowledgement(vec![receipt(3, 1), receipt(4, 1)]))
            .expect("sent");
        let totals = outbox.totals();
        assert_eq!((totals.sent, totals.accepted, totals.resumed), (4, 3, 1));
        assert!(outbox.is_empty());
        assert_eq!(outbox.settled(), 4);
    }

    #[test]
    fn late_and_repeated_acknowledgements_count_once() {
        let mut outbox = outbox(1, false);
        push(&mut outbox, 3);
        send_all(&mut outbox, 9);
        for _ in 0..2 {
            outbox
                .acknowledge(acknowledgement(vec![receipt(1, 1), receipt(2, 1)]))
                .expect("sent");
        }
        outbox
            .acknowledge(acknowledgement(vec![receipt(1, 1)]))
            .expect("late");
        assert_eq!((outbox.totals().accepted, outbox.settled()), (2, 2));
    }

    #[test]
    fn an_acknowledgement_without_a_receipt_settles_as_resumed() {
        let mut outbox = outbox(2, false);
        push(&mut outbox, 4);
        send_all(&mut outbox, 9);
        let acknowledgement = proto::Acknowledgement {
            committed_sequence: 2,
            receipts: vec![receipt(2, 2)],
        };
        outbox.acknowledge(acknowledgement).expect("sent");
        assert_eq!((outbox.totals().accepted, outbox.totals().resumed), (2, 2));
    }

    #[test]
    fn rejections_are_told_by_position() {
        let mut outbox = outbox(2, false);
        push(&mut outbox, 4);
        send_all(&mut outbox, 9);
        let rejected = vec![proto::Rejection {
            index: 1,
            field: "/state/x".into(),
            reason: "got 9".into(),
        }];
        let bad = proto::Receipt {
            accepted: 1,
            rejected_count: 1,
            rejected,
            ..receipt(2, 1)
        };
        outbox
            .acknowledge(acknowledgement(vec![receipt(1, 2), bad]))
            .expect("sent");
        let totals = outbox.totals();
        assert_eq!((totals.accepted, totals.rejected), (3, 1));
        assert_eq!(
            (totals.rejections[0].position, totals.rejections[0].sequence),
            (3, 2)
        );
    }

    #[test]
    fn a_live_producer_numbers_on_behind_its_earlier_run() {
        let mut outbox = outbox_of(Limits {
            batch_size: 1,
            capacity: 4,
            replay: false,
        });
        outbox.resume(57).expect("an earlier run");
        push(&mut outbox, 1);
        assert_eq!(send_all(&mut outbox, 9), [58]);
    }

    #[test]
    fn a_replay_passes_over_what_is_committed() {
        let mut outbox = outbox_of(Limits {
            batch_size: 2,
            capacity: 4,
            replay: true,
        });
        outbox.resume(2).expect("an earlier run");
        push(&mut outbox, 5);
        outbox.cut();
        assert_eq!(send_all(&mut outbox, 9), [3]);
        assert_eq!((outbox.totals().sent, outbox.totals().resumed), (5, 4));
    }

    #[test]
    fn what_cannot_be_is_an_error() {
        let mut outbox = outbox(1, false);
        push(&mut outbox, 2);
        send_all(&mut outbox, 1);
        assert!(
            outbox
                .acknowledge(acknowledgement(vec![receipt(2, 1)]))
                .is_err(),
            "2 was not sent"
        );
        outbox
            .acknowledge(acknowledgement(vec![receipt(1, 1)]))
            .expect("sent");
        assert!(outbox.resume(0).is_err(), "1 was acknowledged");
        assert!(outbox.resume(3).is_err(), "3 was never cut");
    }
}
