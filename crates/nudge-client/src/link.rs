//! The bidirectional stream to the service: down, being opened, or up.

use std::time::Duration;

use futures::future::BoxFuture;
use nudge_wire::proto;
use nudge_wire::proto::ingest_request::Message;
use nudge_wire::proto::ingest_service_client::IngestServiceClient;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use tokio::time::{Instant, sleep_until, timeout};
use tokio_stream::wrappers::UnboundedReceiverStream;
use tonic::{Status, Streaming};

use crate::options::Wire;

/// How long a hello may wait for its welcome: it stands in line behind the producer's queued work.
const WELCOME_TIMEOUT: Duration = Duration::from_secs(30);

/// The stream, as it is now.
pub(crate) enum Link {
    /// Broken; to be opened again at that time.
    Down(Instant),
    /// The hello is on its way.
    Opening(BoxFuture<'static, Result<Opened, Status>>),
    /// Welcomed.
    Up(Box<Stream>),
}

/// A stream that was welcomed.
pub(crate) struct Opened {
    pub stream: Box<Stream>,
    pub welcome: proto::Welcome,
}

/// Both directions of a bidirectional stream.
pub(crate) struct Stream {
    /// Not bounded by itself: it never holds more batches than the window, and they are in the
    /// outbox anyway.
    outgoing: UnboundedSender<proto::IngestRequest>,
    incoming: Streaming<proto::IngestResponse>,
}

/// What happened on a link.
pub(crate) enum Event {
    /// It is time to open it again.
    Due,
    /// The attempt to open it ended.
    Opened(Result<Opened, Status>),
    /// The service said something, or fell silent for ever.
    Heard(Result<Option<proto::IngestResponse>, Status>),
}

impl Link {
    /// Begins to open a stream.
    pub(crate) fn open(client: IngestServiceClient<Wire>, hello: proto::Hello) -> Self {
        Self::Opening(Box::pin(async move {
            match timeout(WELCOME_TIMEOUT, open_stream(client, hello)).await {
                Ok(opened) => opened,
                Err(_) => Err(not_welcomed()),
            }
        }))
    }

    /// Waits for what happens next. Nothing is lost if the wait is given up.
    pub(crate) async fn event(&mut self) -> Event {
        match self {
            Self::Down(until) => {
                sleep_until(*until).await;
                Event::Due
            }
            Self::Opening(attempt) => Event::Opened(attempt.await),
            Self::Up(stream) => Event::Heard(stream.incoming.message().await),
        }
    }
}

impl Stream {
    /// Sends a batch. If the stream is broken this is not noticed here: its other direction says
    /// so.
    pub(crate) fn send(&self, batch: proto::Batch) {
        let _ = self.outgoing.send(proto::IngestRequest {
            message: Some(Message::Batch(batch)),
        });
    }
}

async fn open_stream(
    mut client: IngestServiceClient<Wire>,
    hello: proto::Hello,
) -> Result<Opened, Status> {
    let (outgoing, requests) = unbounded_channel();
    // The hello waits in the stream before the call: a service may read it before it answers the
    // call at all.
    let _ = outgoing.send(proto::IngestRequest {
        message: Some(Message::Hello(hello)),
    });

    let mut incoming = client
        .ingest(UnboundedReceiverStream::new(requests))
        .await?
        .into_inner();
    let welcome = welcome(incoming.message().await?)?;

    Ok(Opened {
        stream: Box::new(Stream { outgoing, incoming }),
        welcome,
    })
}

fn not_welcomed() -> Status {
    let seconds = WELCOME_TIMEOUT.as_secs();
    Status::unavailable(format!("no welcome within {seconds} s"))
}

fn welcome(first: Option<proto::IngestResponse>) -> Result<proto::Welcome, Status> {
    use proto::ingest_response::Message;
    match first.and_then(|response| response.message) {
        Some(Message::Welcome(welcome)) => Ok(welcome),
        Some(Message::Acknowledgement(_)) => Err(Status::failed_precondition(
            "the service acknowledged before it welcomed",
        )),
        None => Err(Status::unavailable(
            "the service ended the stream without a welcome",
        )),
    }
}
