//! The gRPC face: decode by `api`, ask the same rooms as REST, encode by `api`.

use std::any::Any;
use std::future::Future;
use std::time::Duration;

use axum::body::Body;
use axum::middleware::Next;
use http::{Request, Version, header};
use tonic::codec::CompressionEncoding::{Deflate, Gzip};
use tonic::service::Routes;
use tonic::{Response, Status};
use tracing::Instrument;

use super::access::Caller;
use super::rest::problems::log_panic;
use super::status::Failure;
use super::{operations, requests, status};
use crate::api::inference_proto::grpc_inference_service_server::GrpcInferenceServiceServer;
use crate::api::proto::environment_service_server::EnvironmentServiceServer;
use crate::api::proto::influence_service_server::InfluenceServiceServer;
use crate::api::proto::ingest_service_server::IngestServiceServer;
use crate::api::proto::model_service_server::ModelServiceServer;
use crate::api::{MOST_MESSAGE_BYTES, proto};
use crate::app::App;
use crate::error::{ErrorKind, Fault, Problem};

mod environment;
mod inference;
mod influence;
mod ingest;
mod model;
mod reasons;
mod timely;

pub use reasons::give as give_reasons;
pub use timely::in_time;

/// The largest message with a network that is read at all: one above the limit is refused with the
/// way to send it.
const MOST_REFUSED_BYTES: usize = 16 << 20;

/// One face of the service; every gRPC service is implemented on it.
#[derive(Clone)]
struct Face {
    app: App,
    caller: Caller,
}

impl Face {
    /// Returns the face as it is for whoever sent a request.
    fn asked<T>(&self, request: &tonic::Request<T>) -> Self {
        let caller = request
            .extensions()
            .get::<Caller>()
            .cloned()
            .unwrap_or_default();
        Self {
            app: self.app.asked_by(caller.asker()),
            caller,
        }
    }
}

/// Returns the routes of every gRPC service, with health and reflection.
pub async fn routes(app: App) -> Result<Routes, tonic_reflection::server::Error> {
    macro_rules! limited {
        ($server:ident) => {
            limited!($server, MOST_MESSAGE_BYTES)
        };
        ($server:ident, $most_decoded:expr) => {
            $server::new(Face {
                app: app.clone(),
                caller: Caller::default(),
            })
            .max_decoding_message_size($most_decoded)
            .max_encoding_message_size(MOST_MESSAGE_BYTES)
            // Unpacked within the same limit. Answers are small, and sooner sent than packed.
            .accept_compressed(Gzip)
            .accept_compressed(Deflate)
        };
    }
    let (health, checked) = tonic_health::server::health_reporter();
    health.set_serving::<EnvironmentServiceServer<Face>>().await;
    health.set_serving::<IngestServiceServer<Face>>().await;
    health.set_serving::<InfluenceServiceServer<Face>>().await;
    health.set_serving::<ModelServiceServer<Face>>().await;
    health
        .set_serving::<GrpcInferenceServiceServer<Face>>()
        .await;
    tokio::spawn(follow(app.clone(), health));
    let descriptors = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(proto::DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };

    let mut routes = Routes::builder();
    routes
        .add_service(limited!(EnvironmentServiceServer))
        .add_service(limited!(IngestServiceServer))
        .add_service(limited!(InfluenceServiceServer))
        .add_service(limited!(ModelServiceServer, MOST_REFUSED_BYTES))
        .add_service(limited!(GrpcInferenceServiceServer))
        .add_service(checked.accept_compressed(Gzip).accept_compressed(Deflate))
        .add_service(
            descriptors()
                .build_v1()?
                .accept_compressed(Gzip)
                .accept_compressed(Deflate),
        )
        .add_service(
            descriptors()
                .build_v1alpha()?
                .accept_compressed(Gzip)
                .accept_compressed(Deflate),
        );
    Ok(routes.routes())
}

/// Lets health follow readiness: while nothing can be counted, the service as a whole and what
/// takes batches do not serve. Ends with the service.
async fn follow(app: App, health: tonic_health::server::HealthReporter) {
    const OFTEN: Duration = Duration::from_secs(1);
    const WRITING: [&str; 2] = ["", "nudge.v1.IngestService"];
    const ASKING: [&str; 4] = [
        "nudge.v1.EnvironmentService",
        "nudge.v1.InfluenceService",
        "nudge.v1.ModelService",
        "inference.GRPCInferenceService",
    ];

    while app
        .draining
        .run_until_cancelled(tokio::time::sleep(OFTEN))
        .await
        .is_some()
    {
        let status = match operations::ready(&app).await {
            Ok(()) => tonic_health::ServingStatus::Serving,
            Err(_) => tonic_health::ServingStatus::NotServing,
        };
        for name in WRITING {
            health.set_service_status(name, status).await;
        }
    }

    for name in WRITING.into_iter().chain(ASKING) {
        health
            .set_service_status(name, tonic_health::ServingStatus::NotServing)
            .await;
    }
}

/// Refuses gRPC over HTTP/1.1 in words, which has no trailers that its clients read; gRPC-Web needs
/// none.
pub async fn over_http_2(request: Request<Body>, next: Next) -> axum::response::Response {
    let media = request
        .headers()
        .get(header::CONTENT_TYPE)
        .map_or(&b""[..], |media| media.as_bytes());
    let is_grpc =
        requests::is_grpc(request.headers()) && !media.starts_with(b"application/grpc-web");
    if !is_grpc || request.version() >= Version::HTTP_2 {
        return next.run(request).await;
    }

    let detail = "got HTTP/1.1, expected HTTP/2 for application/grpc; over HTTP/1.1 there is application/grpc-web";
    Failure::from(Problem::invalid("call", vec![Fault::new("", detail)])).tell(request.uri().path())
}

/// Runs a call: its problem becomes a status.
async fn call<T>(
    method: &'static str,
    answer: impl Future<Output = Result<T, Problem>>,
) -> Result<Response<T>, Status> {
    let answer = answer.instrument(tracing::debug_span!("call", method));
    answer.await.map(Response::new).map_err(status::grpc)
}

/// Answers for a method that panicked, and writes the cause to the log.
pub fn of_panic(cause: Box<dyn Any + Send>) -> axum::response::Response {
    log_panic(&*cause);
    status::grpc(Problem::new(
        ErrorKind::Internal,
        "INTERNAL",
        "the service failed; the cause is in its log",
    ))
    .into_http()
}
