//! A service in a few lines that keeps the ingest protocol and misbehaves in every way that it
//! allows.
//!
//! It counts nothing: it remembers the first state value of every transition it committed, in
//! order, so that a test sees what was lost or doubled.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard};

use nudge::api::proto;
use nudge::api::proto::environment_service_server::{EnvironmentService, EnvironmentServiceServer};
use nudge::api::proto::influence_service_server::{InfluenceService, InfluenceServiceServer};
use nudge::api::proto::ingest_request::Message as In;
use nudge::api::proto::ingest_response::Message as Out;
use nudge::api::proto::ingest_service_server::{IngestService, IngestServiceServer};
use nudge::domain::{Schema, SchemaDraft, Values, WrittenRule};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_stream::wrappers::{ReceiverStream, TcpListenerStream};
use tonic::{Request, Response, Status, Streaming};

type Answer = Result<proto::IngestResponse, Status>;

/// How often it misbehaves, as probabilities per batch.
#[derive(Debug, Clone, Copy)]
pub struct Mood {
    pub window: u32,
    pub max_batch_transitions: u32,
    /// Breaks the stream before the batch is committed.
    pub lose_batch: f64,
    /// Breaks the stream when the batch is committed and not acknowledged.
    pub lose_receipt: f64,
    /// Acknowledges only with a later batch, or when none came for a moment.
    pub late: f64,
    /// Says an acknowledgement twice.
    pub repeat: f64,
    /// Never acknowledges.
    pub silent: bool,
}

pub const CALM: Mood = Mood {
    window: 8,
    max_batch_transitions: 10_000,
    lose_batch: 0.0,
    lose_receipt: 0.0,
    late: 0.0,
    repeat: 0.0,
    silent: false,
};

pub const WILD: Mood = Mood {
    lose_batch: 0.03,
    lose_receipt: 0.03,
    late: 0.3,
    repeat: 0.2,
    ..CALM
};

/// What it remembers.
#[derive(Default)]
pub struct Memory {
    pub environments: HashMap<String, proto::Environment>,
    pub watermarks: HashMap<(String, String), u64>,
    /// The content of committed batches: environment, sequence, segment and how many transitions.
    pub batches: Vec<(String, u64, String, usize)>,
    /// The first state value of every committed transition.
    pub values: Vec<f32>,
    /// The outcome values of every committed transition.
    pub outcomes: Vec<f32>,
    pub hellos: Vec<proto::Hello>,
    /// Answers the batch of that number with that error.
    pub refuse: Option<(u64, Status)>,
    /// What is said of the next questions instead of an answer, the last first.
    pub not_yet: Vec<Status>,
    /// What is said of every batch instead of what became of it.
    pub instead: Option<proto::BatchStatus>,
    streams: u64,
}

/// The running fake; it ends with the test's runtime.
#[derive(Clone)]
pub struct Fake {
    pub address: SocketAddr,
    memory: Arc<Mutex<Memory>>,
    mood: Mood,
    seed: u64,
}

impl Fake {
    pub async fn start(mood: Mood, seed: u64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("bound");
        let fake = Self {
            address,
            memory: Arc::default(),
            mood,
            seed,
        };
        let serve = tonic::transport::Server::builder()
            .add_service(IngestServiceServer::new(fake.clone()))
            .add_service(EnvironmentServiceServer::new(fake.clone()))
            .add_service(InfluenceServiceServer::new(fake.clone()))
            .serve_with_incoming(TcpListenerStream::new(listener));
        tokio::spawn(serve);
        fake
    }

    /// Adds an environment.
    pub fn describe(&self, name: &str, draft: SchemaDraft) -> proto::Environment {
        let schema = Schema::try_from(&draft).expect("a valid description");
        let mut memory = self.memory();
        let environment = proto::Environment {
            name: name.into(),
            uid: format!("uid-{name}"),
            schema_hash: schema.hash().0.to_vec(),
            schema: Some(draft.into()),
            rule: Some(WrittenRule::default().into()),
            derived: Vec::new(),
        };
        memory.environments.insert(name.into(), environment.clone());
        environment
    }

    pub fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().expect("no test panics while it looks")
    }

    fn welcome(&self, hello: proto::Hello) -> Result<(proto::Welcome, u64), Status> {
        let mut memory = self.memory();
        let Some(environment) = memory.environments.get(&hello.environment).cloned() else {
            return Err(Status::not_found(format!(
                "unknown environment `{}`",
                hello.environment
            )));
        };
        let key = (hello.environment.clone(), hello.producer.clone());
        let committed_sequence = memory.watermarks.get(&key).copied().unwrap_or_default();
        memory.hellos.push(hello);
        memory.streams += 1;
        let welcome = proto::Welcome {
            committed_sequence,
            environment_uid: environment.uid,
            schema_hash: environment.schema_hash,
            window: self.mood.window,
            max_batch_transitions: self.mood.max_batch_transitions,
            max_message_bytes: 4 << 20,
        };
        Ok((welcome, memory.streams))
    }

    /// Commits one batch of a stream that is still the newest.
    fn commit(
        &self,
        stream: u64,
        hello: &proto::Hello,
        batch: proto::Batch,
    ) -> Result<proto::Receipt, Status> {
        let mut memory = self.memory();
        if stream != memory.streams {
            return Err(Status::failed_precondition(
                "a later stream of this producer took over",
            ));
        }
        if let Some((sequence, status)) = &memory.refuse
            && *sequence == batch.sequence
        {
            return Err(status.clone());
        }
        let Some(proto::batch::Transitions::Columns(columns)) = batch.transitions else {
            return Err(Status::invalid_argument("expected columns"));
        };
        let watermark = memory
            .watermarks
            .entry((hello.environment.clone(), hello.producer.clone()))
            .or_default();
        let next = *watermark + 1;
        if batch.sequence > next {
            return Err(Status::failed_precondition(format!(
                "got {}, expected {next}",
                batch.sequence
            )));
        }
        let is_new = batch.sequence == next;
        let states = Values::from_le(columns.states_le.clone()).expect("whole floats");
        let width = states.len() / columns.count as usize;
        let firsts: Vec<f32> = states.iter().step_by(width).collect();
        if is_new {
            *watermark = next;
            memory
                .batches
                .push((hello.environment.clone(), next, batch.segment, firsts.len()));
            memory
                .values
                .extend(firsts.iter().filter(|value| **value >= 0.0));
            let outcomes = Values::from_le(columns.outcomes_le.clone()).expect("whole floats");
            memory.outcomes.extend(outcomes.iter());
        }
        let receipt = receipt(batch.sequence, is_new, &firsts);
        Ok(memory
            .instead
            .map_or(receipt.clone(), |status| instead(receipt, status)))
    }
}

/// Says that every transition was rejected, or that nobody can tell.
fn instead(receipt: proto::Receipt, status: proto::BatchStatus) -> proto::Receipt {
    let unverified = status == proto::BatchStatus::Unverified;
    let rejected_count = if unverified { 0 } else { receipt.accepted };
    let rejection = |index| proto::Rejection {
        index,
        field: "/state/x".into(),
        reason: "got 9".into(),
    };
    let rejected = (0..rejected_count as u32)
        .take(100)
        .map(rejection)
        .collect();
    proto::Receipt {
        status: status.into(),
        accepted: 0,
        rejected_count,
        rejected,
        unverified,
        ..receipt
    }
}

/// Rejects what is negative.
fn receipt(sequence: u64, is_new: bool, firsts: &[f32]) -> proto::Receipt {
    let status = if is_new {
        proto::BatchStatus::Applied
    } else {
        proto::BatchStatus::Duplicate
    };
    let bad = firsts.iter().enumerate().filter(|(_, value)| **value < 0.0);
    let rejected: Vec<_> = bad
        .map(|(index, value)| proto::Rejection {
            index: index as u32,
            field: "/state/x".into(),
            reason: format!("got {value}, expected at least 0"),
        })
        .collect();
    let rejected_count = rejected.len() as u64;
    let accepted = firsts.len() as u64 - rejected_count;
    proto::Receipt {
        sequence,
        status: status.into(),
        accepted,
        rejected_count,
        rejected,
        unverified: false,
    }
}

/// One stream of one producer.
struct Conversation {
    fake: Fake,
    stream: u64,
    hello: proto::Hello,
    requests: Streaming<proto::IngestRequest>,
    answers: mpsc::Sender<Answer>,
    held: Vec<proto::Receipt>,
    rng: StdRng,
}

impl Conversation {
    async fn run(mut self) {
        loop {
            let patience = tokio::time::Duration::from_millis(5);
            let request = match tokio::time::timeout(patience, self.requests.message()).await {
                Err(_) => {
                    self.acknowledge().await;
                    continue;
                }
                Ok(Ok(Some(request))) => request,
                Ok(_) => return,
            };
            let Some(In::Batch(batch)) = request.message else {
                return;
            };
            if !self.take(batch).await {
                return;
            }
        }
    }

    /// Returns whether the stream goes on.
    async fn take(&mut self, batch: proto::Batch) -> bool {
        let mood = self.fake.mood;
        if self.rng.random_bool(mood.lose_batch) {
            return self.stumble().await;
        }
        match self.fake.commit(self.stream, &self.hello, batch) {
            Ok(receipt) => self.held.push(receipt),
            Err(status) => {
                self.acknowledge().await;
                let _ = self.answers.send(Err(status)).await;
                return false;
            }
        }
        if self.rng.random_bool(mood.lose_receipt) {
            return self.stumble().await;
        }
        if !self.rng.random_bool(mood.late) {
            self.acknowledge().await;
        }
        true
    }

    /// Breaks the stream, with an error or without one.
    async fn stumble(&mut self) -> bool {
        if self.rng.random_bool(0.5) {
            let _ = self
                .answers
                .send(Err(Status::unavailable("draining")))
                .await;
        }
        false
    }

    async fn acknowledge(&mut self) {
        let Some(last) = self.held.last().filter(|_| !self.fake.mood.silent) else {
            return;
        };
        let committed_sequence = last.sequence;
        let receipts = std::mem::take(&mut self.held);
        let message = Some(Out::Acknowledgement(proto::Acknowledgement {
            committed_sequence,
            receipts,
        }));
        let times = if self.rng.random_bool(self.fake.mood.repeat) {
            2
        } else {
            1
        };
        for _ in 0..times {
            let _ = self
                .answers
                .send(Ok(proto::IngestResponse {
                    message: message.clone(),
                }))
                .await;
        }
    }
}

#[tonic::async_trait]
impl IngestService for Fake {
    type IngestStream = ReceiverStream<Answer>;

    async fn ingest(
        &self,
        request: Request<Streaming<proto::IngestRequest>>,
    ) -> Result<Response<Self::IngestStream>, Status> {
        let mut requests = request.into_inner();
        let Some(In::Hello(hello)) = requests
            .message()
            .await?
            .and_then(|request| request.message)
        else {
            return Err(Status::invalid_argument("expected a hello"));
        };
        let (welcome, stream) = self.welcome(hello.clone())?;
        let (answers, receiver) = mpsc::channel(64);
        let message = Some(Out::Welcome(welcome));
        let _ = answers.send(Ok(proto::IngestResponse { message })).await;
        let rng = StdRng::seed_from_u64(self.seed.wrapping_mul(1_000) + stream);
        let conversation = Conversation {
            fake: self.clone(),
            stream,
            hello,
            requests,
            answers,
            held: Vec::new(),
            rng,
        };
        tokio::spawn(conversation.run());
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    async fn write(
        &self,
        _: Request<proto::WriteRequest>,
    ) -> Result<Response<proto::WriteResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn get_producer(
        &self,
        _: Request<proto::GetProducerRequest>,
    ) -> Result<Response<proto::GetProducerResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }
}

#[tonic::async_trait]
impl EnvironmentService for Fake {
    async fn apply_environment(
        &self,
        request: Request<proto::ApplyEnvironmentRequest>,
    ) -> Result<Response<proto::ApplyEnvironmentResponse>, Status> {
        let request = request.into_inner();
        let created = !self.memory().environments.contains_key(&request.name);
        let environment =
            Some(self.describe(&request.name, request.schema.unwrap_or_default().into()));
        Ok(Response::new(proto::ApplyEnvironmentResponse {
            environment,
            created,
        }))
    }

    async fn get_environment(
        &self,
        request: Request<proto::GetEnvironmentRequest>,
    ) -> Result<Response<proto::GetEnvironmentResponse>, Status> {
        let name = request.into_inner().name;
        let environment = self.memory().environments.get(&name).cloned();
        let unknown = || Status::not_found(format!("unknown environment `{name}`"));
        let environment = Some(environment.ok_or_else(unknown)?);
        Ok(Response::new(proto::GetEnvironmentResponse { environment }))
    }

    async fn list_environments(
        &self,
        _: Request<proto::ListEnvironmentsRequest>,
    ) -> Result<Response<proto::ListEnvironmentsResponse>, Status> {
        let mut environments: Vec<_> = self.memory().environments.values().cloned().collect();
        environments.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(Response::new(proto::ListEnvironmentsResponse {
            environments,
            ..Default::default()
        }))
    }

    async fn update_environment(
        &self,
        _: Request<proto::UpdateEnvironmentRequest>,
    ) -> Result<Response<proto::UpdateEnvironmentResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn update_rule(
        &self,
        _: Request<proto::UpdateRuleRequest>,
    ) -> Result<Response<proto::UpdateRuleResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn delete_environment(
        &self,
        request: Request<proto::DeleteEnvironmentRequest>,
    ) -> Result<Response<proto::DeleteEnvironmentResponse>, Status> {
        let name = request.into_inner().name;
        let mut memory = self.memory();
        memory
            .watermarks
            .retain(|(environment, _), _| *environment != name);
        match memory.environments.remove(&name) {
            Some(_) => Ok(Response::new(proto::DeleteEnvironmentResponse {})),
            None => Err(Status::not_found(format!("unknown environment `{name}`"))),
        }
    }
}

impl Fake {
    /// Answers a question with nothing, unless it is not yet to be answered.
    fn answered<T: Default>(&self) -> Result<Response<T>, Status> {
        self.memory()
            .not_yet
            .pop()
            .map_or_else(|| Ok(Response::new(T::default())), Err)
    }
}

#[tonic::async_trait]
impl InfluenceService for Fake {
    async fn batch_get_influence(
        &self,
        _: Request<proto::BatchGetInfluenceRequest>,
    ) -> Result<Response<proto::BatchGetInfluenceResponse>, Status> {
        self.answered()
    }

    async fn get_graph(
        &self,
        _: Request<proto::GetGraphRequest>,
    ) -> Result<Response<proto::GetGraphResponse>, Status> {
        self.answered()
    }

    async fn get_influence(
        &self,
        _: Request<proto::GetInfluenceRequest>,
    ) -> Result<Response<proto::GetInfluenceResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn get_state(
        &self,
        _: Request<proto::GetStateRequest>,
    ) -> Result<Response<proto::GetStateResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn list_states(
        &self,
        _: Request<proto::ListStatesRequest>,
    ) -> Result<Response<proto::ListStatesResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn summarize(
        &self,
        _: Request<proto::SummarizeRequest>,
    ) -> Result<Response<proto::SummarizeResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn get_profile(
        &self,
        _: Request<proto::GetProfileRequest>,
    ) -> Result<Response<proto::GetProfileResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn find_regions(
        &self,
        _: Request<proto::FindRegionsRequest>,
    ) -> Result<Response<proto::FindRegionsResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn explore(
        &self,
        _: Request<proto::ExploreRequest>,
    ) -> Result<Response<proto::ExploreResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }

    async fn fit_prior(
        &self,
        _: Request<proto::FitPriorRequest>,
    ) -> Result<Response<proto::FitPriorResponse>, Status> {
        Err(Status::unimplemented("not here"))
    }
}
