//! The body of an answer on its way out, in pieces: that the next one is asked for is the sign that
//! somebody reads.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::body::Body;
use bytes::Bytes;
use http_body::{Body as _, Frame, SizeHint};

use super::vitals::InProgress;
use crate::serve::requests::Call;

/// The largest piece: small enough that a slow reader asks for the next in time, large enough to
/// cost nothing.
const PIECE: usize = 64 << 10;

/// An answer that is being sent.
pub struct Sent {
    body: Body,
    /// What the body gave and was not handed over yet.
    rest: Bytes,
    request: Arc<InProgress>,
    call: Call,
}

impl Sent {
    /// Makes the answer to a request of that body.
    pub fn new(body: Body, request: Arc<InProgress>, call: Call) -> Self {
        Self {
            body,
            rest: Bytes::new(),
            request,
            call,
        }
    }

    fn piece(&mut self) -> Frame<Bytes> {
        let piece = self.rest.split_to(self.rest.len().min(PIECE));
        if !self.is_end_stream() {
            self.request.handed_over();
        }
        Frame::data(piece)
    }
}

impl http_body::Body for Sent {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        self.request.asked();
        if !self.rest.is_empty() {
            return Poll::Ready(Some(Ok(self.piece())));
        }

        let frame = std::task::ready!(Pin::new(&mut self.body).poll_frame(context));
        if frame.is_none() {
            self.call.completed();
        }

        Poll::Ready(frame.map(|frame| match frame?.into_data() {
            Ok(data) => {
                self.rest = data;
                Ok(self.piece())
            }
            Err(trailers) => Ok(trailers),
        }))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (rest, body) = (self.rest.len() as u64, self.body.size_hint());
        let mut hint = SizeHint::new();
        hint.set_lower(body.lower() + rest);
        if let Some(upper) = body.upper() {
            hint.set_upper(upper + rest);
        }
        hint
    }
}

impl Drop for Sent {
    fn drop(&mut self) {
        self.request.asked();
        // Whoever knows the length of a body does not ask for its end.
        if self.is_end_stream() {
            self.call.completed();
        }
    }
}
