//! What the benchmarks share: a world of six features and two agents, its load, and the arithmetic
//! of a ratio.
//!
//! Every figure is printed beside its yardstick from the same run: machines differ and are noisy,
//! ratios less so.

#![allow(dead_code, missing_docs)]

pub mod http;
pub mod process;
pub mod sink;

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use nudge::api::proto::environment_service_client::EnvironmentServiceClient;
use nudge::api::proto::ingest_service_client::IngestServiceClient;
use nudge::api::proto::{self, IngestRequest, ingest_request, ingest_response};
use nudge::app::{App, Upkeep};
use nudge::client::{Connection, Wire};
use nudge::domain::Values;
use nudge::serve::access::Keyring;
use nudge::serve::tls::Tls;
use nudge::serve::{Running, Settings, Starting};
use nudge::store::{Options, SqliteStore};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::body::Body;
use tonic::client::GrpcService;
use tonic::codegen::StdError;
use tonic::transport::Channel;

pub const BATCH: usize = 1_000;
pub const STATE_BINS: [u32; 6] = [10, 10, 10, 10, 10, 20];
pub const ACTIONS: u32 = 6;

/// The service in this process, on a database of its own.
pub struct Service {
    pub address: SocketAddr,
    pub app: App,
    pub directory: Arc<TempDir>,
    running: Running,
}

impl Service {
    pub async fn start() -> Self {
        Self::secured(None, None).await
    }

    /// Starts it with a certificate or without, and with keys or without.
    pub async fn secured(tls: Option<Tls>, keys: Option<Keyring>) -> Self {
        let directory = Arc::new(TempDir::new().expect("a temporary directory"));
        let path = directory.path().join("nudge.db");
        let store = SqliteStore::open(&path, Options::default())
            .await
            .expect("a database");

        let mut starting = Starting::new(Settings {
            keys,
            ..Settings::default()
        });
        let free_port = SocketAddr::from(([127, 0, 0, 1], 0));
        let address = starting.listen(free_port, tls).await.expect("a free port");
        let running = starting.open(Arc::new(store), Upkeep::default());
        let running = running.await.expect("the service runs");
        Self {
            address,
            app: running.app.clone(),
            directory,
            running,
        }
    }

    pub async fn stop(self) {
        self.running.shutdown().await.expect("the service ends");
    }
}

/// Starts the real binary on a directory and returns once it says where it listens.
pub fn start_binary(data: &Path) -> (Child, SocketAddr) {
    start_binary_with(data, &[])
}

/// Starts it with more flags.
pub fn start_binary_with(data: &Path, flags: &[&str]) -> (Child, SocketAddr) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_nudge"))
        .args(["serve", "--listen", "127.0.0.1:0", "--data"])
        .arg(data)
        .args(flags)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary starts");
    let mut line = String::new();
    BufReader::new(child.stdout.take().expect("piped"))
        .read_line(&mut line)
        .expect("a line");
    let address = line
        .trim()
        .rsplit("http://")
        .next()
        .and_then(|address| address.parse().ok());
    (child, address.expect("an address"))
}

/// Serves a yardstick's routes as the service serves its own: the same accept loop and the same
/// sockets.
pub async fn listen(router: axum::Router) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    tokio::spawn(nudge::serve::listen::accept(
        listener,
        router,
        Default::default(),
        Default::default(),
    ));
    address
}

pub async fn channel(address: SocketAddr) -> Channel {
    Channel::from_shared(format!("http://{address}"))
        .expect("an address")
        .connect()
        .await
        .expect("somebody listens")
}

async fn connection(address: SocketAddr) -> Connection {
    Connection::open(&address.to_string())
        .await
        .expect("a service listens")
}

/// Makes a world whose agents have that many actions each; the load uses [`ACTIONS`] of them.
pub async fn make_world(address: SocketAddr, name: &str, actions: u32) {
    make_world_by(connection(address).await.environments(), name, actions).await;
}

/// Makes a world as [`make_world`] does, by a client of the caller's.
pub async fn make_world_by(client: EnvironmentServiceClient<Wire>, name: &str, actions: u32) {
    apply(client, name, world(actions)).await;
}

/// Makes a world whose agents are observed at each of these lags too.
pub async fn make_lagged_world(address: SocketAddr, name: &str, lags: &[u32]) {
    let schema = proto::Schema {
        lags: lags.to_vec(),
        ..world(ACTIONS)
    };
    apply(connection(address).await.environments(), name, schema).await;
}

async fn apply(mut client: EnvironmentServiceClient<Wire>, name: &str, schema: proto::Schema) {
    let request = proto::ApplyEnvironmentRequest {
        name: name.into(),
        schema: Some(schema),
        rule: None,
        derived: None,
    };
    client.apply_environment(request).await.expect("valid");
}

fn world(actions: u32) -> proto::Schema {
    let integer = |name: String, bins: u32| proto::Feature {
        name,
        unit: String::new(),
        kind: Some(proto::feature::Kind::Integer(proto::Integer {
            min: 0,
            max: bins as i32 - 1,
        })),
    };
    let edges = |name: String, bins: u32| proto::Feature {
        kind: Some(proto::feature::Kind::Continuous(proto::Continuous {
            edges: (1..bins).map(|edge| f64::from(edge) - 0.5).collect(),
        })),
        ..integer(name, bins)
    };
    // Half of the features are cut at edges, half are whole numbers.
    let feature = |(i, bins): (usize, u32)| {
        if i % 2 == 0 {
            edges(format!("f{i}"), bins)
        } else {
            integer(format!("f{i}"), bins)
        }
    };
    let agent = |name: &str| proto::Agent {
        name: name.into(),
        action: vec![integer("move".into(), actions)],
        ..proto::Agent::default()
    };
    proto::Schema {
        state: STATE_BINS.into_iter().enumerate().map(feature).collect(),
        agents: vec![agent("ego"), agent("other")],
        ..proto::Schema::default()
    }
}

/// Batches whose transitions fall into `states` states, uniformly.
pub fn batches(states: u32, how_many: usize, seed: u64) -> Vec<proto::Columns> {
    let mut random = StdRng::seed_from_u64(seed);
    let mut batch = || {
        let (mut values, mut actions) = (Vec::new(), Vec::new());
        for _ in 0..BATCH {
            values.extend(state(random.random_range(0..states)));
            actions.extend([0, 0].map(|_| random.random_range(0..ACTIONS) as f32));
        }
        columns(values, actions)
    };
    (0..how_many).map(|_| batch()).collect()
}

/// A batch of [`BATCH`] transitions as bytes.
pub fn columns(states: Vec<f32>, actions: Vec<f32>) -> proto::Columns {
    proto::Columns {
        count: BATCH as u32,
        states_le: Values::from(states).into_le_bytes(),
        actions_le: Values::from(actions).into_le_bytes(),
        ..Default::default()
    }
}

/// The same batch with so many outcomes beside each transition, uniformly: what the agents do at so
/// many lags.
pub fn observed(columns: &proto::Columns, outcomes: usize, random: &mut StdRng) -> proto::Columns {
    let letters = (0..BATCH * outcomes).map(|_| random.random_range(0..ACTIONS) as f32);
    proto::Columns {
        outcomes_le: Values::from(letters.collect::<Vec<_>>()).into_le_bytes(),
        ..columns.clone()
    }
}

/// The same batch as packed floats: what clients send that know no bytes.
pub fn packed(columns: &proto::Columns) -> proto::Columns {
    let floats = |bytes: &bytes::Bytes| {
        let values = Values::from_le(bytes.clone()).expect("whole");
        values.iter().collect()
    };
    proto::Columns {
        states: floats(&columns.states_le),
        actions: floats(&columns.actions_le),
        states_le: Default::default(),
        actions_le: Default::default(),
        ..columns.clone()
    }
}

/// The values of a state by its number, spread over the alphabet.
pub fn state(number: u32) -> [f32; 6] {
    let mut rest = number.wrapping_mul(7_919) % 2_000_000;
    STATE_BINS.map(|bins| {
        let bin = rest % bins;
        rest /= bins;
        bin as f32
    })
}

/// Sends batches under the numbers after the resume point and returns how long it took until the
/// last was acknowledged.
pub async fn pump(
    address: SocketAddr,
    world: &str,
    producer: &str,
    batches: &[proto::Columns],
    how_many: u64,
) -> Duration {
    // Without asking who listens: a sink knows no environments.
    pump_by(
        IngestServiceClient::new(channel(address).await),
        world,
        producer,
        batches,
        how_many,
    )
    .await
}

/// Sends batches as [`pump`] does, by a client of the caller's.
pub async fn pump_by<T>(
    client: IngestServiceClient<T>,
    world: &str,
    producer: &str,
    batches: &[proto::Columns],
    how_many: u64,
) -> Duration
where
    T: GrpcService<Body, Error: Into<StdError>>,
    T::ResponseBody:
        http_body::Body<Data = bytes::Bytes, Error: Into<StdError> + Send> + Send + 'static,
{
    let started = Instant::now();
    pump_every(client, world, producer, batches, how_many, Duration::ZERO).await;
    started.elapsed()
}

/// Sends a batch whenever so much time has passed, and returns how long each waited for its
/// acknowledgement, from when it was due.
pub async fn pump_every<T>(
    mut client: IngestServiceClient<T>,
    world: &str,
    producer: &str,
    batches: &[proto::Columns],
    how_many: u64,
    interval: Duration,
) -> Vec<Duration>
where
    T: GrpcService<Body, Error: Into<StdError>>,
    T::ResponseBody:
        http_body::Body<Data = bytes::Bytes, Error: Into<StdError> + Send> + Send + 'static,
{
    let (requests, outbound) = mpsc::channel(64);
    let hello = proto::Hello {
        environment: world.into(),
        producer: producer.into(),
        ..Default::default()
    };
    let send = |message| IngestRequest {
        message: Some(message),
    };
    requests
        .send(send(ingest_request::Message::Hello(hello)))
        .await
        .expect("open");
    let mut responses = client
        .ingest(ReceiverStream::new(outbound))
        .await
        .expect("a stream")
        .into_inner();
    let welcome = responses
        .message()
        .await
        .expect("a welcome")
        .expect("a welcome")
        .message;
    let Some(ingest_response::Message::Welcome(welcome)) = welcome else {
        panic!("{welcome:?}")
    };
    let first = welcome.committed_sequence;
    let window = tokio::sync::Semaphore::new(welcome.window as usize);
    let started = Instant::now();
    let due = |sequence: u64| started + interval * (sequence - first - 1) as u32;
    let sending = async {
        for sequence in first + 1..=first + how_many {
            if !interval.is_zero() {
                tokio::time::sleep_until(due(sequence).into()).await;
            }
            window.acquire().await.expect("open").forget();
            let columns = batches[sequence as usize % batches.len()].clone();
            let transitions = Some(proto::batch::Transitions::Columns(columns));
            let batch = proto::Batch {
                sequence,
                segment: String::new(),
                transitions,
            };
            requests
                .send(send(ingest_request::Message::Batch(batch)))
                .await
                .expect("open");
        }
    };
    let receiving = async {
        let mut committed = first;
        let mut waited = Vec::with_capacity(how_many as usize);
        while committed < first + how_many {
            let message = responses
                .message()
                .await
                .expect("acknowledged")
                .expect("open")
                .message;
            let Some(ingest_response::Message::Acknowledgement(told)) = message else {
                panic!("{message:?}")
            };
            let acknowledged = committed + 1..=told.committed_sequence;
            waited.extend(acknowledged.map(|sequence| due(sequence).elapsed()));
            committed = told.committed_sequence;
            window.add_permits(told.receipts.len());
        }
        waited
    };
    tokio::join!(sending, receiving).1
}

pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

pub fn quantile(values: &mut [Duration], q: f64) -> Duration {
    values.sort();
    values[((values.len() - 1) as f64 * q) as usize]
}

/// Prints a figure beside its yardstick.
pub fn report(what: &str, figure: f64, yardstick: &str, beside: f64, unit: &str, target: &str) {
    println!(
        "{what}: {figure:.0} {unit} beside {beside:.0} {unit} ({yardstick}): ratio {:.3} {target}",
        figure / beside
    );
}

/// Whether a figure is wanted: all are, unless some are named.
pub fn wanted(name: &str) -> bool {
    let mut named = std::env::args()
        .skip(1)
        .filter(|argument| argument != "--bench")
        .peekable();
    named.peek().is_none() || named.any(|argument| argument == name)
}

pub fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .expect("a runtime")
}

/// Runs a script of this directory with the Python that `NUDGE_PYTHON` names, and returns the
/// fields of each line that it printed, with tabs between.
pub fn python(script: &str, argument: Option<&Path>) -> Option<Vec<Vec<String>>> {
    let python = std::env::var_os("NUDGE_PYTHON")?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("benches")
        .join(script);
    let output = Command::new(python)
        .arg(script)
        .args(argument)
        .output()
        .expect("NUDGE_PYTHON runs");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let lines = String::from_utf8(output.stdout).expect("text");
    Some(
        lines
            .lines()
            .map(|line| line.split('\t').map(Into::into).collect())
            .collect(),
    )
}
