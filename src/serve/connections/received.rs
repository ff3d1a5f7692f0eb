//! The body of a request on its way in: it arrives in time, takes its bytes from the budget, and is
//! read to its end even where nobody wants the rest.
//!
//! The deadlines run only while a body is waited for, so a sender is not blamed for our own
//! slowness (back-pressure).

use std::error::Error;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::BoxError;
use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use http_body_util::BodyExt;
use hyper::body::Incoming;
use tokio::time::{Instant, Sleep, sleep_until};

use super::framing::Framing;
use super::memory::Charge;
use super::vitals::InProgress;
use crate::error::{ErrorKind, Problem};
use crate::serve::requests::Noted;
use crate::serve::status;

/// The framing of a body.
pub enum Form {
    /// It is one message, whose bytes are charged by whoever unpacks them.
    Document,
    /// It is one message.
    Message,
    /// It is message after message, for as long as its sender likes.
    Messages(Framing),
}

/// The properties of a body that the head of its request tells.
pub struct BodyProperties {
    /// How it is made up.
    pub form: Form,
    /// Whether refusals are told as statuses of gRPC, whose clients know that an answer may
    /// overtake what they send. Many clients of HTTP, of either version, lose such an answer: for
    /// them what nobody wants is read, too.
    pub is_grpc: bool,
    /// Whether its sender waits for a sign before it sends anything.
    pub is_announced: bool,
}

/// A body that is being received.
pub struct Received {
    body: Option<Incoming>,
    properties: BodyProperties,
    charge: Arc<Charge>,
    request: Arc<InProgress>,
    /// Told when its sender leaves before its end.
    noted: Arc<Noted>,
    /// When the message at hand began.
    began: Instant,
    /// Since when the next byte is waited for.
    waits_since: Option<Instant>,
    timer: Option<Pin<Box<Sleep>>>,
    was_asked_for: bool,
    has_ended: bool,
}

impl Received {
    /// Makes the body of a request that has just begun.
    pub fn new(
        body: Incoming,
        properties: BodyProperties,
        charge: Arc<Charge>,
        request: Arc<InProgress>,
        noted: Arc<Noted>,
    ) -> Self {
        Self {
            has_ended: body.is_end_stream(),
            body: Some(body),
            properties,
            charge,
            request,
            noted,
            began: Instant::now(),
            waits_since: None,
            timer: None,
            was_asked_for: false,
        }
    }

    fn arrived(&mut self, bytes: &[u8]) -> Result<(), Problem> {
        self.waits_since = None;
        match &mut self.properties.form {
            Form::Document => Ok(()),
            Form::Message => self.charge.grow(bytes.len()),
            Form::Messages(framing) => {
                let before = framing.unfinished();
                framing.feed(bytes);
                let unfinished = framing.unfinished();
                // Another message than before is at hand, unless it only grew.
                if unfinished != before + bytes.len() || before == 0 {
                    self.began = Instant::now();
                }
                self.charge.hold(unfinished)
            }
        }
    }

    /// Returns when the next byte is overdue; between messages it never is.
    fn due(&mut self) -> Option<Instant> {
        if matches!(&self.properties.form, Form::Messages(framing) if framing.unfinished() == 0) {
            self.waits_since = None;
            return None;
        }
        let limits = self.request.vitals().limits();
        let since = *self.waits_since.get_or_insert_with(Instant::now);
        Some((since + limits.stalled).min(self.began + limits.message))
    }

    /// Waits until the next byte is overdue.
    fn poll_overdue(&mut self, context: &mut Context<'_>) -> Poll<()> {
        let Some(due) = self.due() else {
            return Poll::Pending;
        };
        let timer = self.timer.get_or_insert_with(|| Box::pin(sleep_until(due)));
        loop {
            std::task::ready!(timer.as_mut().poll(context));
            // It was set for an earlier byte.
            if due <= Instant::now() {
                return Poll::Ready(());
            }
            timer.as_mut().reset(due);
        }
    }

    /// Ends the body with a problem. Who stalls or is one too many is not listened to any longer.
    fn refuse(&mut self, problem: Problem) -> BoxError {
        self.has_ended = true;
        self.charge.release();
        if self.properties.is_grpc {
            status::grpc(problem).into()
        } else {
            problem.into()
        }
    }
}

impl Body for Received {
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let me = &mut *self;
        me.was_asked_for = true;
        let Some(body) = me.body.as_mut().filter(|_| !me.has_ended) else {
            return Poll::Ready(None);
        };

        match Pin::new(body).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => {
                let arrived = frame.data_ref().map_or(Ok(()), |data| me.arrived(data));
                Poll::Ready(Some(
                    arrived
                        .map(|()| frame)
                        .map_err(|problem| me.refuse(problem)),
                ))
            }
            Poll::Ready(end) => {
                me.has_ended = true;
                let failed = |error: hyper::Error| {
                    if has_left(&error) {
                        me.noted.left();
                    }
                    error.into()
                };
                Poll::Ready(end.map(|end| end.map_err(failed)))
            }
            Poll::Pending => me
                .poll_overdue(context)
                .map(|()| Some(Err(me.refuse(stalled())))),
        }
    }

    fn is_end_stream(&self) -> bool {
        self.has_ended || self.body.as_ref().is_none_or(Body::is_end_stream)
    }

    fn size_hint(&self) -> SizeHint {
        self.body
            .as_ref()
            .map_or_else(|| SizeHint::with_exact(0), Body::size_hint)
    }
}

impl Drop for Received {
    fn drop(&mut self) {
        let is_wanted_no_more = !self.is_end_stream() && !self.properties.is_grpc;
        // Who asked for a sign first has sent nothing, and is told all by the answer.
        let may_be_on_its_way = self.was_asked_for || !self.properties.is_announced;
        if is_wanted_no_more
            && may_be_on_its_way
            && let Some(body) = self.body.take()
            && let Ok(runtime) = tokio::runtime::Handle::try_current()
        {
            runtime.spawn(drain(body, self.request.clone()));
        }
    }
}

/// Reads and drops what is left of a body, up to a bound. The request lasts as long, so that its
/// connection is not taken to be idle.
async fn drain(mut body: Incoming, request: Arc<InProgress>) {
    let rest = async { while let Some(Ok(_)) = body.frame().await {} };
    let most: Duration = request.vitals().limits().unwanted;
    let _ = tokio::time::timeout(most, rest).await;
}

/// Tells whether a body ended early because nobody sends it any more, and not because of what was
/// sent.
fn has_left(error: &hyper::Error) -> bool {
    let mut cause = error.source();
    while let Some(found) = cause {
        if let Some(io) = found.downcast_ref::<io::Error>() {
            return !matches!(
                io.kind(),
                io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData
            );
        }
        cause = found.source();
    }
    true
}

fn stalled() -> Problem {
    Problem::new(
        ErrorKind::Unavailable,
        "BODY_STALLED",
        "the body did not arrive in time; send it again",
    )
}
