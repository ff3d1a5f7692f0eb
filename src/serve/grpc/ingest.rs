//! `IngestService`: one producer's stream, from its hello to its last receipt.
//!
//! Reading and acknowledging run side by side. Whatever ends the reading (the client is done, the
//! service drains, a fault), every batch that was taken is acknowledged before the stream's own end
//! is told.

use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Response, Status, Streaming};
use tonic_types::StatusExt;
use tracing::Instrument;

use super::{Face, call};
use crate::api::proto::ingest_request::Message;
use crate::api::proto::ingest_service_server::IngestService;
use crate::api::proto::{
    GetProducerRequest, GetProducerResponse, Hello, IngestRequest, IngestResponse, Welcome,
    WriteRequest, WriteResponse, ingest_response,
};
use crate::api::{MOST_BATCH_TRANSITIONS, MOST_MESSAGE_BYTES, grpc};
use crate::domain::{Batch, Environment, ProducerId, Sequence};
use crate::error::{ErrorKind, Problem};
use crate::ingest::{Session, Ticket, WINDOW};
use crate::serve::connections::Leaving;
use crate::serve::status;
use crate::telemetry;

/// How long a stream may take to say hello.
const HELLO: Duration = Duration::from_secs(10);

/// Acknowledgements that wait for the socket.
const OUTBOUND: usize = 16;

type Outbound = mpsc::Sender<Result<IngestResponse, Status>>;

#[tonic::async_trait]
impl IngestService for Face {
    type IngestStream = ReceiverStream<Result<IngestResponse, Status>>;

    async fn ingest(
        &self,
        request: Request<Streaming<IngestRequest>>,
    ) -> Result<Response<Self::IngestStream>, Status> {
        let face = self.asked(&request);
        let (out, responses) = mpsc::channel(OUTBOUND);
        let leaving = request.extensions().get().cloned();
        let leaving = leaving.unwrap_or_else(|| Leaving(face.app.draining.clone()));
        tokio::spawn(
            face.stream(request.into_inner(), leaving, out)
                .in_current_span(),
        );
        Ok(Response::new(ReceiverStream::new(responses)))
    }

    async fn write(
        &self,
        request: Request<WriteRequest>,
    ) -> Result<Response<WriteResponse>, Status> {
        let face = self.asked(&request);
        call("Write", async {
            let (environment, producer, batch) =
                face.decode(request.into_inner()).inspect_err(refused)?;
            let sequence = batch.sequence;
            let told = face.app.ingest.write(&environment, producer, batch).await?;
            Ok(WriteResponse {
                receipt: Some(grpc::receipt(sequence, told)),
            })
        })
        .await
    }

    async fn get_producer(
        &self,
        request: Request<GetProducerRequest>,
    ) -> Result<Response<GetProducerResponse>, Status> {
        let face = self.asked(&request);
        call("GetProducer", async {
            let GetProducerRequest {
                environment,
                producer,
            } = request.into_inner();
            let environment = face.app.environments.find(&environment)?;
            let committed = face
                .app
                .ingest
                .committed(&environment, &grpc::producer(&producer)?)
                .await?;
            Ok(GetProducerResponse {
                committed_sequence: committed.get(),
                environment_uid: environment.uid.to_string(),
            })
        })
        .await
    }
}

impl Face {
    fn decode(
        &self,
        request: WriteRequest,
    ) -> Result<(Arc<Environment>, ProducerId, Batch), Problem> {
        let WriteRequest {
            environment,
            environment_uid,
            producer,
            batch,
        } = request;

        let environment = self
            .app
            .environments
            .find_known(&environment, &environment_uid)?;
        let producer = grpc::producer(&producer)?;
        let batch = grpc::batch(&environment.schema, batch.unwrap_or_default())?;
        Ok((environment, producer, batch))
    }

    /// Runs a stream to its end and tells the end.
    async fn stream(self, mut inbound: Streaming<IngestRequest>, leaving: Leaving, out: Outbound) {
        let _open = telemetry::stream_opened();
        let welcomed = tokio::select! {
            biased;
            problem = self.caller.withdrawn() => Err(problem.into()),
            welcomed = self.welcome(&mut inbound, &leaving, &out) => welcomed,
        };

        let ended = match welcomed {
            Ok(mut session) => {
                self.converse(&mut session, &mut inbound, &leaving, &out)
                    .await
            }
            Err(end) => Err(end),
        };
        let told = match ended {
            Err(End::Problem(problem)) => status::grpc(problem),
            Err(End::Told(status)) => status,
            Ok(()) | Err(End::Gone) => return,
        };

        // The client may be gone; it will find out when it resumes.
        let _ = out.send(Err(told)).await;
    }

    async fn welcome(
        &self,
        inbound: &mut Streaming<IngestRequest>,
        leaving: &Leaving,
        out: &Outbound,
    ) -> Result<Session, End> {
        let first = tokio::select! {
            biased;
            () = leaving.0.cancelled() => return Err(self.parting().into()),
            first = tokio::time::timeout(HELLO, inbound.message()) => first,
        };

        let first = first
            .map_err(|_| protocol("no hello within 10 seconds"))?
            .map_err(End::from_read)?;
        let Some(IngestRequest {
            message: Some(Message::Hello(hello)),
        }) = first
        else {
            return Err(protocol("a stream begins with a hello").into());
        };

        let (environment, producer) = self.introduce(hello)?;
        let session = self.app.ingest.open(environment, producer).await?;
        let welcome = ingest_response::Message::Welcome(welcome(&session));
        out.send(Ok(IngestResponse {
            message: Some(welcome),
        }))
        .await
        .map_err(|_| End::Gone)?;
        Ok(session)
    }

    /// Checks who says hello, to which environment, with which description of it in mind.
    fn introduce(&self, hello: Hello) -> Result<(Arc<Environment>, ProducerId), Problem> {
        let environment = self
            .app
            .environments
            .find_known(&hello.environment, &hello.environment_uid)?;
        let producer = grpc::producer(&hello.producer)?;
        let hash = environment.schema.hash();
        if !hello.schema_hash.is_empty() && hello.schema_hash != hash.0 {
            let message = format!(
                "environment `{}` has another schema than the stream was made for",
                environment.name
            );
            return Err(
                Problem::new(ErrorKind::Conflict, "SCHEMA_CONFLICT", message)
                    .with("schema_hash", hash),
            );
        }

        Ok((environment, producer))
    }

    async fn converse(
        &self,
        session: &mut Session,
        inbound: &mut Streaming<IngestRequest>,
        leaving: &Leaving,
        out: &Outbound,
    ) -> Result<(), End> {
        let resumed = session.committed();
        // Rendezvous only: tickets wait in the acknowledging half, which bounds them by the window.
        let (tickets, taken) = mpsc::channel(1);
        let reading = self.read_batches(session, inbound, leaving, tickets);

        // Wherever the reading waits, for a batch, for room or for the rate, a key that is
        // withdrawn ends it at once.
        let mut reading = std::pin::pin!(async {
            tokio::select! {
                biased;
                problem = self.caller.withdrawn() => Err(problem.into()),
                end = reading => end,
            }
        });
        let mut acknowledging = std::pin::pin!(acknowledge(resumed, taken, out));

        tokio::select! {
            end = &mut reading => acknowledging.await.and(end),
            failed = &mut acknowledging => failed,
        }
    }

    /// Tells why streams of a connection that is to end are ended.
    fn parting(&self) -> Problem {
        match self.app.draining.is_cancelled() {
            true => draining(),
            false => {
                let message = "the connection was open for long enough; reconnect and resume";
                Problem::new(ErrorKind::Unavailable, "RECONNECT", message)
            }
        }
    }

    /// Takes batches until the client is done or something ends the stream. Giving up the tickets'
    /// sender is what lets the acknowledging half end.
    async fn read_batches(
        &self,
        session: &mut Session,
        inbound: &mut Streaming<IngestRequest>,
        leaving: &Leaving,
        tickets: mpsc::Sender<Ticket>,
    ) -> Result<(), End> {
        loop {
            let message = tokio::select! {
                biased;
                () = leaving.0.cancelled() => return Err(self.parting().into()),
                problem = session.ended() => return Err(problem.into()),
                message = inbound.message() => message.map_err(End::from_read).inspect_err(End::count)?,
            };
            let batch = match message {
                None => return Ok(()),
                Some(IngestRequest {
                    message: Some(Message::Batch(batch)),
                }) => batch,
                Some(_) => return Err(protocol("expected a batch").into()),
            };
            let batch = grpc::batch(&session.environment().schema, batch).inspect_err(refused)?;
            self.caller.turn().await?;
            // A batch that still waits for room when the stream is to end was not taken: its client
            // sends it again.
            let ticket = tokio::select! {
                biased;
                () = leaving.0.cancelled() => return Err(self.parting().into()),
                ticket = session.submit(batch) => ticket?,
            };
            tickets.send(ticket).await.map_err(|_| End::Gone)?;
        }
    }
}

/// Tells receipts in order, as many together as one commit made ready.
async fn acknowledge(
    resumed: Sequence,
    taken: mpsc::Receiver<Ticket>,
    out: &Outbound,
) -> Result<(), End> {
    let answers = ReceiverStream::new(taken)
        .map(Ticket::acknowledged)
        .buffered(WINDOW);
    let mut ready = std::pin::pin!(answers.ready_chunks(WINDOW));
    let mut committed = resumed;
    while let Some(answers) = ready.next().await {
        let mut told = Vec::with_capacity(answers.len());
        let mut refused = None;
        for answer in answers {
            match answer {
                Ok(acknowledged) => told.push(acknowledged),
                Err(problem) => {
                    refused = Some(problem);
                    break;
                }
            }
        }
        let last = told.last().map(|(last, _)| *last);
        for message in grpc::acknowledgements(told, committed) {
            out.send(Ok(message)).await.map_err(|_| End::Gone)?;
        }
        committed = last.map_or(committed, |last| committed.max(last));
        if let Some(problem) = refused {
            return Err(problem.into());
        }
    }

    Ok(())
}

/// Why a stream ends before its client is done.
enum End {
    /// The client is told.
    Problem(Problem),
    /// The client is told what was found out while reading.
    Told(Status),
    /// There is nobody to tell.
    Gone,
}

impl From<Problem> for End {
    fn from(problem: Problem) -> Self {
        Self::Problem(problem)
    }
}

impl End {
    /// Counts a batch that could not be read.
    fn count(&self) {
        if let Self::Problem(problem) = self {
            refused(problem);
        }
    }

    /// A message that is too large or cannot be decoded is the client's to mend; any other failure
    /// to read is a lost connection.
    fn from_read(status: Status) -> Self {
        match status.code() {
            // Signed by us: the message did not arrive in time, or was one too many.
            _ if status.get_details_error_info().is_some() => Self::Told(status),
            // As it was sent, or unpacked.
            Code::OutOfRange | Code::ResourceExhausted => {
                let message =
                    format!("a message is larger than the limit of {MOST_MESSAGE_BYTES} bytes");
                Problem::new(ErrorKind::TooLarge, "MESSAGE_TOO_LARGE", message)
                    .with("limit_bytes", MOST_MESSAGE_BYTES)
                    .into()
            }
            Code::Internal | Code::Unimplemented => Problem::new(
                ErrorKind::Invalid,
                "UNDECODABLE",
                format!("a message cannot be decoded: {}", status.message()),
            )
            .into(),
            _ => Self::Gone,
        }
    }
}

fn welcome(session: &Session) -> Welcome {
    let environment = session.environment();
    Welcome {
        committed_sequence: session.committed().get(),
        environment_uid: environment.uid.to_string(),
        schema_hash: environment.schema.hash().0.to_vec(),
        window: WINDOW as u32,
        max_batch_transitions: MOST_BATCH_TRANSITIONS as u32,
        max_message_bytes: MOST_MESSAGE_BYTES as u32,
    }
}

/// Counts a batch that is refused before ingestion sees it; ingestion counts the others.
fn refused(problem: &Problem) {
    telemetry::refused(problem.reason);
}

fn protocol(message: &str) -> Problem {
    Problem::new(ErrorKind::Invalid, "PROTOCOL", message)
}

fn draining() -> Problem {
    Problem::new(
        ErrorKind::Unavailable,
        "STOPPING",
        "the service is stopping; reconnect and resume",
    )
}
