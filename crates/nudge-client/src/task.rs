//! The task behind a producer: it alone owns the outbox and the stream.

use std::time::Duration;

use nudge_core::domain::{Record, Widths};
use nudge_wire::proto;
use nudge_wire::proto::ingest_service_client::IngestServiceClient;
use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, sleep_until};
use tonic::Status;

use crate::backoff::Backoff;
use crate::error::{is_transient, words_of};
use crate::link::{Event, Link, Opened};
use crate::options::Wire;
use crate::outbox::Outbox;
use crate::retry::advised;
use crate::{ClientError, Totals};

/// What a producer asks of its task.
pub(crate) enum Command {
    /// One more transition.
    Send(Record),
    /// Another segment from here on; empty for none.
    Segment(String),
    /// Closes the batch.
    Cut,
    /// Closes the batch, and answers when everything up to here is acknowledged.
    Flush(oneshot::Sender<Totals>),
}

/// What the task works by.
pub(crate) struct Terms {
    pub hello: proto::Hello,
    pub client: IngestServiceClient<Wire>,
    pub widths: Widths,
    /// Transitions of a batch of a replay, which must not depend on what the service allows.
    pub fixed_batch_size: Option<usize>,
    /// How long a batch may stay open; `None` closes batches by size alone.
    pub max_delay: Option<Duration>,
    /// How long the service may be away while something waits; `None` for ever.
    pub retry_for: Option<Duration>,
}

/// The state of a producer: what it has to send, and the stream that it sends on.
pub(crate) struct Task {
    terms: Terms,
    outbox: Outbox,
    commands: mpsc::Receiver<Command>,
    link: Link,
    window: usize,
    cut_at: Instant,
    flushes: Vec<(u64, oneshot::Sender<Totals>)>,
    backoff: Option<Backoff>,
    /// Told the resume point of the first stream.
    opened: Option<oneshot::Sender<u64>>,
}

impl Task {
    pub(crate) fn new(
        terms: Terms,
        outbox: Outbox,
        commands: mpsc::Receiver<Command>,
        opened: oneshot::Sender<u64>,
    ) -> Self {
        let now = Instant::now();
        Self {
            terms,
            outbox,
            commands,
            link: Link::Down(now),
            window: 0,
            cut_at: now,
            flushes: Vec::new(),
            backoff: None,
            opened: Some(opened),
        }
    }

    /// Works until the producer is closed or something cannot be repaired.
    pub(crate) async fn run(mut self) -> Result<(), ClientError> {
        loop {
            let has_room = self.outbox.has_room();
            let (may_cut, cut_at) = (self.may_cut(), self.cut_at);
            tokio::select! {
                event = self.link.event() => self.on_event(event)?,
                command = self.commands.recv(), if has_room => match command {
                    Some(command) => self.on_commands(command),
                    None => return Ok(()),
                },
                () = sleep_until(cut_at), if may_cut => self.outbox.cut(),
            }
            self.send_waiting();
            self.answer_flushes();
        }
    }

    /// A batch is closed by time only if it would be sent at once: where it would wait, it may as
    /// well grow.
    fn may_cut(&self) -> bool {
        let is_up = matches!(self.link, Link::Up(_));
        self.terms.max_delay.is_some()
            && is_up
            && self.outbox.is_building()
            && self.outbox.would_send(self.window)
    }

    /// Takes a command, and those that are there already: a select for each would cost more than
    /// the work.
    fn on_commands(&mut self, first: Command) {
        self.on_command(first);
        while self.outbox.has_room()
            && let Ok(command) = self.commands.try_recv()
        {
            self.on_command(command);
        }
    }

    fn on_command(&mut self, command: Command) {
        match command {
            Command::Send(transition) => self.on_transition(transition),
            Command::Segment(segment) => self.outbox.set_segment(segment),
            Command::Cut => self.outbox.cut(),
            Command::Flush(reply) => {
                self.outbox.cut();
                self.flushes
                    .push((self.outbox.totals().last_sequence, reply));
            }
        }
    }

    fn on_transition(&mut self, transition: Record) {
        if !self.outbox.is_building()
            && let Some(delay) = self.terms.max_delay
        {
            self.cut_at = Instant::now() + delay;
        }
        if self.outbox.is_empty()
            && let Some(backoff) = &mut self.backoff
        {
            backoff.restart_clock(Instant::now());
        }
        self.outbox.push(transition);
    }

    fn on_event(&mut self, event: Event) -> Result<(), ClientError> {
        match event {
            Event::Due => {
                self.link = Link::open(self.terms.client.clone(), self.terms.hello.clone())
            }
            Event::Opened(Ok(opened)) => self.on_welcome(opened)?,
            Event::Heard(Ok(Some(response))) => self.on_response(response)?,
            Event::Heard(Ok(None)) => {
                self.on_loss(Status::unavailable("the service ended the stream"))?
            }
            Event::Opened(Err(status)) | Event::Heard(Err(status)) => self.on_loss(status)?,
        }
        Ok(())
    }

    fn on_welcome(&mut self, opened: Opened) -> Result<(), ClientError> {
        let Opened { stream, welcome } = opened;
        self.heed_limits(&welcome)?;

        let has_progressed = self.outbox.resume(welcome.committed_sequence)?;
        // A service that welcomes and breaks again without counting anything is still away.
        if has_progressed || self.outbox.is_empty() {
            self.backoff = None;
        }

        self.window = welcome.window.max(1) as usize;
        self.link = Link::Up(stream);
        if let Some(opened) = self.opened.take() {
            let _ = opened.send(welcome.committed_sequence);
        }
        Ok(())
    }

    fn heed_limits(&mut self, welcome: &proto::Welcome) -> Result<(), ClientError> {
        let most = most_transitions(welcome, &self.terms.widths);
        match self.terms.fixed_batch_size {
            Some(size) if size > most => {
                let message = format!(
                    "batches of {size} transitions are too large for the service: it takes {most}"
                );
                Err(ClientError::Invalid(message))
            }
            Some(_) => Ok(()),
            None => {
                self.outbox.shrink_batches(most);
                Ok(())
            }
        }
    }

    fn on_response(&mut self, response: proto::IngestResponse) -> Result<(), ClientError> {
        use proto::ingest_response::Message;
        match response.message {
            Some(Message::Acknowledgement(acknowledgement)) => {
                self.outbox.acknowledge(acknowledgement)?;
                self.backoff = None;
                Ok(())
            }
            Some(Message::Welcome(_)) => Err(ClientError::Disagreement(
                "the service welcomed twice".into(),
            )),
            // A message of a later version: nothing in it can be owed an answer.
            None => Ok(()),
        }
    }

    /// Prepares another attempt, or says that this cannot be repaired.
    fn on_loss(&mut self, status: Status) -> Result<(), ClientError> {
        if !is_transient(&status) {
            return Err(status.into());
        }
        self.outbox.unsend();

        let now = Instant::now();
        let is_awaited = self.opened.is_some() || !self.outbox.is_empty();
        let backoff = self.backoff.get_or_insert_with(|| Backoff::since(now));
        // A rate says after how long there is some of it again.
        let delay = backoff
            .next_delay(words_of(&status))
            .max(advised(&status).unwrap_or_default());

        if let Some(limit) = self.terms.retry_for
            && is_awaited
            && backoff.elapsed(now) >= limit
        {
            return Err(ClientError::GaveUp {
                seconds: limit.as_secs(),
                last: backoff.last_error().into(),
            });
        }

        self.link = Link::Down(now + delay);
        Ok(())
    }

    fn send_waiting(&mut self) {
        if let Link::Up(stream) = &self.link {
            while let Some(batch) = self.outbox.next_to_send(self.window) {
                stream.send(batch);
            }
        }
    }

    fn answer_flushes(&mut self) {
        let settled = self.outbox.settled();
        for (_, reply) in self
            .flushes
            .extract_if(.., |(target, _)| *target <= settled)
        {
            // Whoever asked may have stopped waiting.
            let _ = reply.send(self.outbox.totals().clone());
        }
    }
}

/// Returns how many transitions surely fit into a batch of the service.
fn most_transitions(welcome: &proto::Welcome, widths: &Widths) -> usize {
    /// Tags and lengths of a batch, its number, and a segment of 64 characters of four bytes.
    const ENVELOPE: usize = 512;
    /// The longest encodings of an entry flag and a count.
    const FLAG_AND_COUNT: usize = 1 + 10;

    let bytes = (welcome.max_message_bytes as usize).saturating_sub(ENVELOPE);
    let values = widths.state + widths.actions + widths.outcome_values();
    let flags = (widths.agents.len() + widths.outcomes.len()).div_ceil(8) + 1;
    let by_bytes = bytes / (values * size_of::<f32>() + flags + FLAG_AND_COUNT);
    by_bytes.min(welcome.max_batch_transitions as usize).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_batch_fits_the_message_and_the_limit() {
        let welcome = |max_message_bytes, max_batch_transitions| proto::Welcome {
            max_message_bytes,
            max_batch_transitions,
            ..proto::Welcome::default()
        };
        let narrow = Widths {
            state: 2,
            actions: 2,
            agents: [1, 1].into(),
            ..Widths::default()
        };
        let narrow = &narrow;
        assert_eq!(most_transitions(&welcome(4 << 20, 10_000), narrow), 10_000);
        assert_eq!(
            most_transitions(&welcome(512 + 29 * 10, 10_000), narrow),
            10
        );
        assert_eq!(most_transitions(&welcome(0, 0), narrow), 1);
    }
}
