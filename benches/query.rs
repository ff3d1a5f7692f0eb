//! Questions beside constants: REST beside a bare axum handler, gRPC beside the same call answered
//! with a constant, busy beside idle.
//!
//! `cargo bench --bench query`, or `cargo bench --bench query -- grpc` for one of them.

#![allow(missing_docs)]

mod support;

use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nudge::api::proto::influence_service_client::InfluenceServiceClient;
use nudge::api::proto::influence_service_server::{InfluenceService, InfluenceServiceServer};
use nudge::api::proto::{
    BatchGetInfluenceRequest, BatchGetInfluenceResponse, ExploreRequest, ExploreResponse,
    FindRegionsRequest, FindRegionsResponse, FitPriorRequest, FitPriorResponse, GetGraphRequest,
    GetGraphResponse, GetInfluenceRequest, GetInfluenceResponse, GetProfileRequest,
    GetProfileResponse, GetStateRequest, GetStateResponse, ListStatesRequest, ListStatesResponse,
    Rule, Scope, StateValues, SummarizeRequest, SummarizeResponse, View,
};
use support::http::{get, latencies, report_tail};
use support::{
    ACTIONS, Service, batches, channel, listen, make_lagged_world, make_world, median, observed,
    process, pump, report, runtime, start_binary, start_binary_with, state, wanted,
};
use tokio::net::TcpStream;
use tonic::{Request, Response, Status};

const ROUNDS: usize = 5;
const STATES: u32 = 10_000;
const LAGGED_STATES: u32 = 1_000;
const PATH: &str = "/v1/environments/world/influence?key=1.1.1.1.1.1&view=figures";

fn main() {
    runtime().block_on(async {
        let service = Service::start().await;
        make_world(service.address, "world", ACTIONS).await;
        pump(service.address, "world", "p", &batches(STATES, 500, 1), 500).await;
        if wanted("rest") {
            rest(&service).await;
        }
        if wanted("grpc") {
            grpc(&service).await;
        }
        if wanted("evidence") {
            evidence(&service).await;
        }
        if wanted("lag") {
            lag(&service).await;
        }
        if wanted("busy") {
            busy(&service).await;
        }
        service.stop().await;
    });
    if wanted("ranking") {
        runtime().block_on(ranking());
    }
    if wanted("start") {
        start();
    }
}

/// One state over REST in view `figures`, four connections: the same again and again, and one after
/// the other where nothing was found of any before.
async fn rest(service: &Service) {
    let path = known_path(1);
    let body = get(
        &mut TcpStream::connect(service.address)
            .await
            .expect("listening"),
        &path,
    )
    .await;
    let constant = constant(body).await;
    let same = vec![path; STATES as usize];
    let each: Vec<String> = (0..STATES).map(known_path).collect();
    let fit = fit_prior();
    let mut client = InfluenceServiceClient::new(channel(service.address).await);
    let (mut again, mut first, mut constants) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        constants.push(requests_per_second(constant, &same).await);
        again.push(requests_per_second(service.address, &same).await);
        // What was found with another fit is found anew.
        client.fit_prior(fit.clone()).await.expect("fitted");
        first.push(requests_per_second(service.address, &each).await);
    }
    let constants = median(constants);
    for (what, answers, target) in [
        ("remembered", again, "(target >= 0.6)"),
        ("not remembered", first, "(target >= 0.5)"),
    ] {
        report(
            &format!("one known state over REST, {what}"),
            median(answers),
            "bare axum, constant JSON of that size",
            constants,
            "requests/s",
            target,
        );
    }
}

fn known_path(number: u32) -> String {
    let key = state(number).map(|bin| bin.to_string()).join(".");
    PATH.replace("1.1.1.1.1.1", &key)
}

fn fit_prior() -> FitPriorRequest {
    FitPriorRequest {
        environment: "world".into(),
        ..Default::default()
    }
}

async fn constant(body: Vec<u8>) -> SocketAddr {
    let body = bytes::Bytes::from(body);
    let answer = move || {
        let body = body.clone();
        async move { ([("content-type", "application/json")], body) }
    };
    let router = axum::Router::new().fallback(answer);
    listen(router).await
}

async fn requests_per_second(address: SocketAddr, paths: &[String]) -> f64 {
    const CONNECTIONS: usize = 4;
    let started = Instant::now();
    let ask = |paths: Vec<String>| async move {
        let mut stream = TcpStream::connect(address).await.expect("listening");
        stream.set_nodelay(true).expect("a socket");
        for path in &paths {
            get(&mut stream, path).await;
        }
    };
    let shares = paths.chunks(paths.len() / CONNECTIONS);
    futures::future::join_all(shares.map(|share| ask(share.to_vec()))).await;
    paths.len() as f64 / started.elapsed().as_secs_f64()
}

fn question(world: &str, rule: &str, view: View) -> BatchGetInfluenceRequest {
    let rule = Rule {
        kind: Some(rule.into()),
        ..Default::default()
    };
    BatchGetInfluenceRequest {
        scope: Some(Scope {
            environment: world.into(),
            rule: Some(rule),
            ..Default::default()
        }),
        states: (0..STATES)
            .map(|number| StateValues {
                values: state(number).into(),
            })
            .collect(),
        view: view.into(),
        ..Default::default()
    }
}

/// 10,000 known states in one call, view `figures`: with all evidence, and without. Without it are
/// the same counts in a world whose agents could do so much more that evidence is not computed.
async fn evidence(service: &Service) {
    const TOO_MANY: u32 = 4_097;
    make_world(service.address, "plain", TOO_MANY).await;
    pump(service.address, "plain", "p", &batches(STATES, 500, 1), 500).await;
    let fit = fit_prior();
    let mut client = InfluenceServiceClient::new(channel(service.address).await);
    let [with, without] =
        ["world", "plain"].map(|world| question(world, "evidence", View::Figures));
    let (mut first, mut answers, mut plain) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        plain.push(calls_per_second(&mut client, &without).await);
        // What was found with another fit is found anew.
        client.fit_prior(fit.clone()).await.expect("fitted");
        let started = Instant::now();
        client
            .batch_get_influence(with.clone())
            .await
            .expect("answered");
        first.push(1.0 / started.elapsed().as_secs_f64());
        answers.push(calls_per_second(&mut client, &with).await);
    }
    let (first, answers, plain) = (median(first), median(answers), median(plain));
    let name = "10,000 states with full evidence";
    report(
        &format!("{name}, at first"),
        first,
        "plug-in only",
        plain,
        "calls/s",
        "(target >= 15 calls/s)",
    );
    report(
        name,
        answers,
        "plug-in only",
        plain,
        "calls/s",
        "(target >= 40 calls/s)",
    );
}

/// 1,000 known states in one call, view `figures`: what the other does three steps later beside what
/// it does now, of the same transitions; remembered, and where nothing was found before.
async fn lag(service: &Service) {
    let mut random = <rand::rngs::StdRng as rand::SeedableRng>::seed_from_u64(7);
    let load: Vec<_> = batches(LAGGED_STATES, 50, 1)
        .iter()
        .map(|batch| observed(batch, 4, &mut random))
        .collect();
    make_lagged_world(service.address, "lagged", &[2, 3]).await;
    pump(service.address, "lagged", "p", &load, 50).await;

    let mut client = InfluenceServiceClient::new(channel(service.address).await);
    let at_lag = |lag| {
        let mut question = question("lagged", "evidence", View::Figures);
        question.scope.as_mut().expect("a scope").lag = lag;
        question.states.truncate(LAGGED_STATES as usize);
        question
    };
    let [now, later] = [0, 3].map(at_lag);
    let [mut first, mut again] = [[Vec::new(), Vec::new()], [Vec::new(), Vec::new()]];
    for _ in 0..ROUNDS {
        for (at, question) in [&now, &later].into_iter().enumerate() {
            // What was found with another fit is found anew.
            let fit = FitPriorRequest {
                environment: "lagged".into(),
                lag: question.scope.as_ref().expect("a scope").lag,
                ..Default::default()
            };
            client.fit_prior(fit).await.expect("fitted");
            let started = Instant::now();
            let answered = client.batch_get_influence(question.clone()).await;
            answered.expect("answered");
            first[at].push(1.0 / started.elapsed().as_secs_f64());
            again[at].push(calls_per_second(&mut client, question).await);
        }
    }
    for (what, [now, later]) in [("at first", first), ("again", again)] {
        report(
            &format!("1,000 states at lag 3, {what}"),
            median(later),
            "at lag 0",
            median(now),
            "calls/s",
            "(target >= 0.5)",
        );
    }
}

/// 10,000 known states in one call, view `verdict` by the paper's rule.
async fn grpc(service: &Service) {
    let question = question("world", "paper", View::Verdict);
    let mut client = InfluenceServiceClient::new(channel(service.address).await);
    let answer = client
        .batch_get_influence(question.clone())
        .await
        .expect("answered")
        .into_inner();
    let constant = tonic::service::Routes::new(InfluenceServiceServer::new(Constant(answer)));
    let address = listen(constant.into_axum_router()).await;
    let mut constant = InfluenceServiceClient::new(channel(address).await);
    let (mut answers, mut constants) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        constants.push(calls_per_second(&mut constant, &question).await);
        answers.push(calls_per_second(&mut client, &question).await);
    }
    let (answers, constants) = (median(answers), median(constants));
    report(
        "10,000 known states over gRPC",
        answers,
        "the same call, constant answer",
        constants,
        "calls/s",
        "(target >= 0.3)",
    );
}

async fn calls_per_second(
    client: &mut InfluenceServiceClient<tonic::transport::Channel>,
    question: &BatchGetInfluenceRequest,
) -> f64 {
    const CALLS: usize = 40;
    let started = Instant::now();
    for _ in 0..CALLS {
        client
            .batch_get_influence(question.clone())
            .await
            .expect("answered");
    }
    CALLS as f64 / started.elapsed().as_secs_f64()
}

/// The slowest hundredth of single questions while transitions come in at full speed, beside the
/// same when idle.
async fn busy(service: &Service) {
    let path = known_path(1);
    let idle = latencies(service.address, &path).await;
    let over = Arc::new(AtomicBool::new(false));
    let (address, done) = (service.address, over.clone());
    let ingesting = tokio::spawn(async move {
        let load = batches(STATES, 64, 1);
        while !done.load(Ordering::Relaxed) {
            pump(address, "world", "q", &load, 200).await;
        }
    });
    tokio::time::sleep(Duration::from_millis(500)).await;
    let busy = latencies(service.address, &path).await;
    over.store(true, Ordering::Relaxed);
    ingesting.await.expect("ends");
    report_tail("while ingesting", busy, "idle", idle, "(target <= 5)");
}

/// A ranking of 1.8 million states by their evidence: its processor time, beside that of the same by
/// plug-in, which needs none; and the most memory that the process has, which begins anew for it.
async fn ranking() {
    let directory = tempfile::TempDir::new().expect("a temporary directory");
    let start = || start_binary_with(directory.path(), &["--max-cells", "1000000000"]);
    let end = |mut child: Child| {
        child.kill().expect("running");
        child.wait().expect("killed");
    };
    let (child, address) = start();
    make_world(address, "world", ACTIONS).await;
    let load = batches(2_000_000, 4_600, 1);
    pump(address, "world", "p", &load, 4_600).await;
    drop(load);
    end(child);

    let (child, address) = start();
    let plug_in = ranked(&child, address, "plug_in").await;
    end(child);

    let (child, address) = start();
    let evidence = ranked(&child, address, "p_dependent").await;
    let resident = process::field(&child, "status", "VmHWM:") as f64 / 1024.0;
    end(child);
    report(
        &format!("a ranking of 1.8 M states, at most {resident:.0} MiB resident"),
        evidence,
        "by plug-in",
        plug_in,
        "CPU-s",
        "(target <= 20 CPU-s, 300 MiB)",
    );
}

/// Returns the processor time of the first page in an order, in seconds.
async fn ranked(child: &Child, address: SocketAddr, order_by: &str) -> f64 {
    let mut client = InfluenceServiceClient::new(channel(address).await);
    let request = ListStatesRequest {
        scope: Some(Scope {
            environment: "world".into(),
            ..Default::default()
        }),
        order_by: order_by.into(),
        ..Default::default()
    };
    let before = process::cpu_seconds(child);
    // A caller is told to ask again when its patience is over.
    while client.list_states(request.clone()).await.is_err() {}
    process::cpu_seconds(child) - before
}

/// From the start of the real binary on an empty database to its first ready answer, beside
/// `sqlite3` opening the same file.
fn start() {
    let directory = tempfile::TempDir::new().expect("a temporary directory");
    let ready = median(
        (0..ROUNDS)
            .map(|_| start_to_ready(directory.path()))
            .collect(),
    );
    let file = directory.path().join("nudge.db");
    let open = || {
        let started = Instant::now();
        let opened = Command::new("sqlite3")
            .arg(&file)
            .arg("select count(*) from environments")
            .stdout(Stdio::null())
            .status();
        opened.ok().map(|_| started.elapsed().as_secs_f64() * 1e3)
    };
    match (0..ROUNDS).map(|_| open()).collect::<Option<Vec<f64>>>() {
        Some(opened) => report(
            "start to ready",
            ready,
            "sqlite3 opening the file",
            median(opened),
            "ms",
            "",
        ),
        None => println!(
            "start to ready: {ready:.0} ms (no sqlite3 on this machine to stand beside it)"
        ),
    }
}

fn start_to_ready(data: &std::path::Path) -> f64 {
    let started = Instant::now();
    let (mut child, _) = start_binary(data);
    let took = started.elapsed().as_secs_f64() * 1e3;
    child.kill().expect("running");
    child.wait().expect("killed");
    took
}

/// Answers every batch of questions with the same bytes.
struct Constant(BatchGetInfluenceResponse);

#[tonic::async_trait]
impl InfluenceService for Constant {
    async fn batch_get_influence(
        &self,
        _: Request<BatchGetInfluenceRequest>,
    ) -> Result<Response<BatchGetInfluenceResponse>, Status> {
        Ok(Response::new(self.0.clone()))
    }
    async fn get_influence(
        &self,
        _: Request<GetInfluenceRequest>,
    ) -> Result<Response<GetInfluenceResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn get_state(
        &self,
        _: Request<GetStateRequest>,
    ) -> Result<Response<GetStateResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn list_states(
        &self,
        _: Request<ListStatesRequest>,
    ) -> Result<Response<ListStatesResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn summarize(
        &self,
        _: Request<SummarizeRequest>,
    ) -> Result<Response<SummarizeResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn get_graph(
        &self,
        _: Request<GetGraphRequest>,
    ) -> Result<Response<GetGraphResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn get_profile(
        &self,
        _: Request<GetProfileRequest>,
    ) -> Result<Response<GetProfileResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn find_regions(
        &self,
        _: Request<FindRegionsRequest>,
    ) -> Result<Response<FindRegionsResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn explore(
        &self,
        _: Request<ExploreRequest>,
    ) -> Result<Response<ExploreResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
    async fn fit_prior(
        &self,
        _: Request<FitPriorRequest>,
    ) -> Result<Response<FitPriorResponse>, Status> {
        Err(Status::unimplemented("a constant"))
    }
}
