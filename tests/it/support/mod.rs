//! What tests share: a service on port 0 with a temporary database, and a producer that speaks the
//! protocol by hand.

pub mod batches;
pub mod certificates;
pub mod databases;
pub mod disks;
pub mod exchange;
pub mod faulty;
pub mod fixtures;
pub mod load;
pub mod raw;
pub mod x509;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;

use nudge::api::proto::environment_service_client::EnvironmentServiceClient;
use nudge::api::proto::influence_service_client::InfluenceServiceClient;
use nudge::api::proto::ingest_service_client::IngestServiceClient;
use nudge::api::proto::model_service_client::ModelServiceClient;
use nudge::api::proto::{self, IngestRequest, IngestResponse, ingest_request, ingest_response};
use nudge::app::{App, Upkeep};
use nudge::serve::tls::Tls;
use nudge::serve::{Running, Settings, Starting};
use nudge::store::{Options, SqliteStore, Store};
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Channel;
use tonic::{Status, Streaming};

/// What takes a free port of this machine.
pub const FREE_PORT: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// A running service.
pub struct TestApp {
    pub address: SocketAddr,
    pub app: App,
    pub directory: Arc<TempDir>,
    running: Running,
}

impl TestApp {
    /// Starts a service on a new database.
    pub async fn start() -> Self {
        Self::on(Arc::new(TempDir::new().expect("a temporary directory"))).await
    }

    /// Starts a service on a directory's database.
    pub async fn on(directory: Arc<TempDir>) -> Self {
        let store = open(directory.path(), Options::default()).await;
        Self::with(directory, store).await
    }

    /// Starts a service on a store of the test's own.
    pub async fn with(directory: Arc<TempDir>, store: Arc<dyn Store>) -> Self {
        Self::set(directory, store, Settings::default()).await
    }

    /// Starts a service on a store, with settings of the test's own.
    pub async fn set(directory: Arc<TempDir>, store: Arc<dyn Store>, settings: Settings) -> Self {
        Self::behind(None, directory, store, settings).await
    }

    /// Starts a service that speaks TLS where it has a certificate.
    pub async fn behind(
        tls: Option<Tls>,
        directory: Arc<TempDir>,
        store: Arc<dyn Store>,
        settings: Settings,
    ) -> Self {
        let mut starting = Starting::new(settings);
        let address = starting.listen(FREE_PORT, tls).await.expect("a free port");
        let running = starting.open(store, Upkeep::default());
        let running = running.await.expect("the service runs");
        Self {
            address,
            app: running.app.clone(),
            directory,
            running,
        }
    }

    /// Stops the service as a signal would, and starts it again on the same database.
    pub async fn restart(self) -> Self {
        let directory = self.directory.clone();
        self.stop().await;
        Self::on(directory).await
    }

    /// Stops the service as a signal would.
    pub async fn stop(self) {
        self.running.shutdown().await.expect("the service ends");
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub async fn channel(&self) -> Channel {
        channel(self.address).await.expect("the service listens")
    }

    pub async fn environments(&self) -> EnvironmentServiceClient<Channel> {
        EnvironmentServiceClient::new(self.channel().await)
    }

    pub async fn influence(&self) -> InfluenceServiceClient<Channel> {
        InfluenceServiceClient::new(self.channel().await)
    }

    pub async fn models(&self) -> ModelServiceClient<Channel> {
        ModelServiceClient::new(self.channel().await)
    }

    pub async fn ingest(&self) -> IngestServiceClient<Channel> {
        IngestServiceClient::new(self.channel().await)
    }

    /// Makes the environment that most tests use: one continuous and one categorical feature, two
    /// agents.
    pub async fn lane(&self) -> proto::Environment {
        self.environments()
            .await
            .apply_environment(proto::ApplyEnvironmentRequest {
                name: "lane".into(),
                schema: Some(lane_schema()),
                rule: None,
                derived: None,
            })
            .await
            .expect("valid")
            .into_inner()
            .environment
            .expect("present")
    }

    /// Returns what a path of REST tells, where there is nothing to refuse.
    pub async fn get(&self, path: &str) -> Value {
        let (status, answer) = self.rest("GET", path, None).await;
        assert_eq!(status, 200, "{path}: {answer}");
        answer
    }

    /// Returns a REST answer: its status and its body, as JSON where it is.
    pub async fn rest(&self, method: &str, path: &str, body: Option<&Value>) -> (u16, Value) {
        let method = method.parse().expect("a method");
        let request = reqwest::Client::new().request(method, self.url(path));
        let request = match body {
            Some(body) => request.json(body),
            None => request,
        };
        let response = request.send().await.expect("answered");
        let status = response.status().as_u16();
        let text = response.text().await.expect("text");
        (
            status,
            serde_json::from_str(&text).unwrap_or(Value::String(text)),
        )
    }

    /// Returns the counts of a state: (joint action indices, segment, n, entries).
    pub async fn cells(&self, key: &str) -> Vec<(Vec<u64>, String, u64, Option<u64>)> {
        let request = proto::GetStateRequest {
            environment: "lane".into(),
            key: key.into(),
        };
        let state = self
            .influence()
            .await
            .get_state(request)
            .await
            .expect("a valid key")
            .into_inner();
        state
            .cells
            .into_iter()
            .map(|cell| (cell.actions, cell.segment, cell.n, cell.entries))
            .collect()
    }
}

pub async fn open(directory: &Path, options: Options) -> Arc<dyn Store> {
    Arc::new(
        SqliteStore::open(&directory.join("nudge.db"), options)
            .await
            .expect("a database"),
    )
}

pub async fn channel(address: SocketAddr) -> Result<Channel, tonic::transport::Error> {
    Channel::from_shared(format!("http://{address}"))
        .expect("an address")
        .connect()
        .await
}

fn feature(name: &str, kind: proto::feature::Kind) -> proto::Feature {
    proto::Feature {
        name: name.into(),
        unit: String::new(),
        kind: Some(kind),
    }
}

fn categorical(name: &str, labels: &[&str]) -> proto::Feature {
    let labels = labels.iter().map(ToString::to_string).collect();
    feature(
        name,
        proto::feature::Kind::Categorical(proto::Categorical { labels }),
    )
}

/// `distance` with edges 0.5, 0.7, 1; `held` nothing or dish; robot: go or stop; human: left, right
/// or stay.
pub fn lane_schema() -> proto::Schema {
    let edges = vec![0.5, 0.7, 1.0];
    let distance = feature(
        "distance",
        proto::feature::Kind::Continuous(proto::Continuous { edges }),
    );
    let agent = |name: &str, action| proto::Agent {
        name: name.into(),
        action: vec![action],
        ..proto::Agent::default()
    };
    proto::Schema {
        state: vec![distance, categorical("held", &["nothing", "dish"])],
        agents: vec![
            agent("robot", categorical("move", &["go", "stop"])),
            agent("human", categorical("move", &["left", "right", "stay"])),
        ],
        ..proto::Schema::default()
    }
}

/// The same as JSON.
pub fn lane_json() -> Value {
    json!({
        "state": [
            {"name": "distance", "continuous": {"edges": [0.5, 0.7, 1]}},
            {"name": "held", "categorical": {"labels": ["nothing", "dish"]}}
        ],
        "agents": [
            {"name": "robot", "action": [{"name": "move", "categorical": {"labels": ["go", "stop"]}}]},
            {"name": "human", "action": [{"name": "move", "categorical": {"labels": ["left", "right", "stay"]}}]}
        ]
    })
}

/// A transition: (distance, held), (robot, human).
pub fn row(state: [f32; 2], actions: [f32; 2]) -> proto::Transition {
    proto::Transition {
        state: state.into(),
        actions: actions.into(),
        entry: 0,
        count: None,
        ..proto::Transition::default()
    }
}

pub fn rows(sequence: u64, transitions: Vec<proto::Transition>) -> proto::Batch {
    let transitions = proto::batch::Transitions::Rows(proto::Rows { transitions });
    proto::Batch {
        sequence,
        segment: String::new(),
        transitions: Some(transitions),
    }
}

/// A producer's stream, spoken by hand.
pub struct RawStream {
    requests: mpsc::Sender<IngestRequest>,
    responses: Streaming<IngestResponse>,
}

impl RawStream {
    /// Says hello and returns the welcome with the stream.
    pub async fn open<T>(
        mut client: IngestServiceClient<T>,
        hello: proto::Hello,
    ) -> Result<(proto::Welcome, Self), Status>
    where
        T: tonic::client::GrpcService<tonic::body::Body>,
        T::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
        T::ResponseBody: http_body::Body<Data = bytes::Bytes> + Send + 'static,
        <T::ResponseBody as http_body::Body>::Error:
            Into<Box<dyn std::error::Error + Send + Sync>> + Send,
    {
        let (requests, outbound) = mpsc::channel(64);
        let first = IngestRequest {
            message: Some(ingest_request::Message::Hello(hello)),
        };
        requests.send(first).await.expect("the channel is open");
        let responses = client
            .ingest(ReceiverStream::new(outbound))
            .await?
            .into_inner();
        let mut stream = Self {
            requests,
            responses,
        };
        match stream.next().await? {
            Some(ingest_response::Message::Welcome(welcome)) => Ok((welcome, stream)),
            other => panic!("expected a welcome, got {other:?}"),
        }
    }

    /// Sends a batch; an error means that the stream is over.
    pub async fn send(&self, batch: proto::Batch) -> Result<(), ()> {
        let request = IngestRequest {
            message: Some(ingest_request::Message::Batch(batch)),
        };
        self.requests.send(request).await.map_err(drop)
    }

    pub async fn next(&mut self) -> Result<Option<ingest_response::Message>, Status> {
        Ok(self
            .responses
            .message()
            .await?
            .and_then(|response| response.message))
    }

    /// Returns the next acknowledgement, or the stream's end.
    pub async fn acknowledged(&mut self) -> Result<proto::Acknowledgement, Status> {
        match self.next().await? {
            Some(ingest_response::Message::Acknowledgement(told)) => Ok(told),
            None => Err(Status::ok("the stream ended")),
            other => panic!("expected an acknowledgement, got {other:?}"),
        }
    }

    /// Ends the sending half and returns the rest of the receipts and how the stream ended.
    pub async fn finish(mut self) -> (Vec<proto::Receipt>, Status) {
        // Dropping the only sender ends the sending half.
        self.requests = mpsc::channel(1).0;
        let mut receipts = Vec::new();
        loop {
            match self.acknowledged().await {
                Ok(told) => receipts.extend(told.receipts),
                Err(status) => return (receipts, status),
            }
        }
    }

    /// Separates the halves.
    pub fn split(self) -> (mpsc::Sender<IngestRequest>, Streaming<IngestResponse>) {
        (self.requests, self.responses)
    }
}

pub fn hello(producer: &str) -> proto::Hello {
    proto::Hello {
        environment: "lane".into(),
        producer: producer.into(),
        ..Default::default()
    }
}

/// Returns the reason word of a gRPC error.
pub fn reason(status: &Status) -> String {
    use tonic_types::StatusExt;
    status
        .get_details_error_info()
        .map(|info| info.reason)
        .unwrap_or_default()
}
