//! What a network costs on the wire: the inference protocol beside the same server with a constant,
//! and a question while a training runs beside one without.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nudge::api::inference_proto::grpc_inference_service_client::GrpcInferenceServiceClient;
use nudge::api::inference_proto::grpc_inference_service_server::{
    GrpcInferenceService, GrpcInferenceServiceServer,
};
use nudge::api::inference_proto::model_infer_request::InferInputTensor;
use nudge::api::inference_proto::{
    ModelInferRequest, ModelInferResponse, ModelMetadataRequest, ModelMetadataResponse,
    ModelReadyRequest, ModelReadyResponse, ServerLiveRequest, ServerLiveResponse,
    ServerMetadataRequest, ServerMetadataResponse, ServerReadyRequest, ServerReadyResponse,
};
use nudge::domain::JobState;
use tokio::runtime::Handle;
use tonic::transport::Channel;
use tonic::{Request, Response, Status};

use super::ROUNDS;
use super::play::{BINS, ENVIRONMENT, Play, State};
use super::support::http::{latencies, report_tail};
use super::support::{channel, listen, median, report};

const ROWS: usize = 1_024;

/// 1,024 rows in one `ModelInfer`: beside a constant, which nothing that computes can come near.
pub async fn infer(play: &Play) {
    let states: Vec<State> = play.learned.iter().cycle().take(ROWS).copied().collect();
    let question = question(&states);
    let mut client = GrpcInferenceServiceClient::new(channel(play.service.address).await);
    let answer = client
        .model_infer(question.clone())
        .await
        .expect("answered")
        .into_inner();
    let mut constant = beside(Constant { answer }).await;
    let [mut answers, mut constants] = [(); 2].map(|()| Vec::new());
    for _ in 0..ROUNDS {
        constants.push(calls_per_second(&mut constant, &question).await);
        answers.push(calls_per_second(&mut client, &question).await);
    }
    let (what, answers) = (format!("ModelInfer with {ROWS} rows"), median(answers));
    report(
        &what,
        answers,
        "the same call, constant answer",
        median(constants),
        "calls/s",
        "(target >= 0.5)",
    );
}

async fn beside(constant: Constant) -> GrpcInferenceServiceClient<Channel> {
    let routes = tonic::service::Routes::new(GrpcInferenceServiceServer::new(constant));
    GrpcInferenceServiceClient::new(channel(listen(routes.into_axum_router()).await).await)
}

fn question(states: &[State]) -> ModelInferRequest {
    let input = InferInputTensor {
        name: "state".into(),
        datatype: "FP32".into(),
        shape: vec![ROWS as i64, BINS.len() as i64],
        ..Default::default()
    };
    ModelInferRequest {
        model_name: ENVIRONMENT.into(),
        inputs: vec![input],
        raw_input_contents: vec![
            states
                .as_flattened()
                .iter()
                .flat_map(|bin| (*bin as f32).to_le_bytes())
                .collect(),
        ],
        ..Default::default()
    }
}

async fn calls_per_second(
    client: &mut GrpcInferenceServiceClient<Channel>,
    question: &ModelInferRequest,
) -> f64 {
    const CALLS: usize = 400;
    let started = Instant::now();
    for _ in 0..CALLS {
        client
            .model_infer(question.clone())
            .await
            .expect("answered");
    }
    CALLS as f64 / started.elapsed().as_secs_f64()
}

/// The slowest hundredth of single questions while networks are trained, one after the other,
/// beside the same when idle, and beside the same while a thread of this process only spins: where
/// others use the machine too, a process that is busy has to wait for its turn, whatever it is busy
/// with.
pub async fn busy(play: &Play) {
    let over = AtomicBool::new(false);
    let idle = ask(play).await;
    let spinning = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                std::hint::spin_loop()
            }
        });
        let asked = tokio::task::block_in_place(|| Handle::current().block_on(ask(play)));
        over.store(true, Ordering::Relaxed);
        asked
    });
    over.store(false, Ordering::Relaxed);
    let training = async {
        while !over.load(Ordering::Relaxed) {
            play.train(None).await;
        }
    };
    let asking = async {
        running(play).await;
        let asked = ask(play).await;
        over.store(true, Ordering::Relaxed);
        asked
    };
    let ((), busy) = tokio::join!(training, asking);
    report_tail("while training", busy.clone(), "idle", idle, "(target < 3)");
    report_tail("while training", busy, "while a thread spins", spinning, "");
}

/// Asks from a task of its own, which nothing else wakes.
async fn ask(play: &Play) -> Vec<Duration> {
    let key = play.learned[0].map(|bin| bin.to_string()).join(".");
    let path = format!("/v1/environments/{ENVIRONMENT}/influence?key={key}&view=figures");
    let address = play.service.address;
    let asking = async move {
        let mut all = Vec::new();
        for _ in 0..ROUNDS {
            all.extend(latencies(address, &path).await);
        }
        all
    };
    tokio::spawn(asking).await.expect("asked")
}

/// Returns once a training has been running for a moment.
async fn running(play: &Play) {
    let environment = &play.environment;
    let is_running = async || {
        let jobs = play
            .service
            .app
            .networks
            .list(environment)
            .await
            .expect("listed")
            .jobs;
        jobs.iter().any(|job| job.state == JobState::Running)
    };
    while !is_running().await {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    tokio::time::sleep(Duration::from_millis(500)).await;
}

/// Answers every request with the same tensors.
struct Constant {
    answer: ModelInferResponse,
}

#[tonic::async_trait]
impl GrpcInferenceService for Constant {
    async fn model_infer(
        &self,
        _: Request<ModelInferRequest>,
    ) -> Result<Response<ModelInferResponse>, Status> {
        Ok(Response::new(self.answer.clone()))
    }
    async fn server_live(
        &self,
        _: Request<ServerLiveRequest>,
    ) -> Result<Response<ServerLiveResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn server_ready(
        &self,
        _: Request<ServerReadyRequest>,
    ) -> Result<Response<ServerReadyResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn model_ready(
        &self,
        _: Request<ModelReadyRequest>,
    ) -> Result<Response<ModelReadyResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn server_metadata(
        &self,
        _: Request<ServerMetadataRequest>,
    ) -> Result<Response<ServerMetadataResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn model_metadata(
        &self,
        _: Request<ModelMetadataRequest>,
    ) -> Result<Response<ModelMetadataResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
}
