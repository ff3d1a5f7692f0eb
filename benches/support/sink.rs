//! A service that decodes every batch and drops it: what carrying a load costs by itself.

use std::net::SocketAddr;
use std::pin::Pin;

use futures::StreamExt;
use nudge::api::proto::ingest_service_server::{IngestService, IngestServiceServer};
use nudge::api::proto::{
    self, GetProducerRequest, GetProducerResponse, IngestRequest, IngestResponse, WriteRequest,
    WriteResponse, ingest_request, ingest_response,
};
use tonic::{Request, Response, Status, Streaming};

use super::listen;

/// Decodes every batch, drops it and acknowledges it, as many together as were ready.
struct Sink;

/// Starts one.
pub async fn sink() -> SocketAddr {
    let service =
        IngestServiceServer::new(Sink).max_decoding_message_size(nudge::api::MOST_MESSAGE_BYTES);
    listen(tonic::service::Routes::new(service).into_axum_router()).await
}

#[tonic::async_trait]
impl IngestService for Sink {
    type IngestStream = Pin<Box<dyn futures::Stream<Item = Result<IngestResponse, Status>> + Send>>;

    async fn ingest(
        &self,
        request: Request<Streaming<IngestRequest>>,
    ) -> Result<Response<Self::IngestStream>, Status> {
        let answers = request.into_inner().ready_chunks(64).map(|messages| {
            let mut told = proto::Acknowledgement::default();
            for message in messages {
                match message?.message {
                    Some(ingest_request::Message::Batch(batch)) => {
                        told.committed_sequence = batch.sequence;
                        told.receipts.push(proto::Receipt {
                            sequence: batch.sequence,
                            ..Default::default()
                        });
                    }
                    _ => {
                        let welcome = proto::Welcome {
                            window: 256,
                            ..Default::default()
                        };
                        let message = Some(ingest_response::Message::Welcome(welcome));
                        return Ok(IngestResponse { message });
                    }
                }
            }
            Ok(IngestResponse {
                message: Some(ingest_response::Message::Acknowledgement(told)),
            })
        });
        Ok(Response::new(Box::pin(answers)))
    }

    async fn write(&self, _: Request<WriteRequest>) -> Result<Response<WriteResponse>, Status> {
        Err(Status::unimplemented("a sink"))
    }

    async fn get_producer(
        &self,
        _: Request<GetProducerRequest>,
    ) -> Result<Response<GetProducerResponse>, Status> {
        Err(Status::unimplemented("a sink"))
    }
}
