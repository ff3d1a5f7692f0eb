//! TLS: every face speaks it, plain text is told, clients are asked for certificates, files are
//! read again, and what is wrong is said.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http::{Request, Response};
use http_body_util::{BodyExt, Full};
use hyper::body::Incoming;
use nudge::client::{self, ClientError, ClientTls, Connection, Trust};
use nudge::domain::{Entry, Record};
use nudge::serve::connections::limits::Limits;
use nudge::serve::tls::{Tls, TlsFiles};
use nudge::serve::{Settings, Starting};
use nudge::store::Options;
use rustls::ClientConfig;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::io::AsyncWriteExt;
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use crate::cli::{exit_and_texts, nudge, output};
use crate::server::Server;
use crate::support::certificates::{Authority, Certificate, client, config, connect, write};
use crate::support::exchange::exchange;
use crate::support::raw::{LONG, PREFACE, Raw, call};
use crate::support::{FREE_PORT, RawStream, TestApp, hello, lane_json, open, row, rows};

const ALIVE: &[u8] = b"GET /livez HTTP/1.1\r\nhost: localhost\r\n\r\n";

/// A service with a certificate of an authority.
struct Secured {
    app: TestApp,
    authority: Authority,
    files: TlsFiles,
}

impl Secured {
    async fn start(clients: Option<&Authority>, limits: Limits) -> Self {
        let (directory, authority) = (
            Arc::new(TempDir::new().expect("a directory")),
            Authority::new("services"),
        );
        let files = write(directory.path(), &authority.certify("localhost"), clients);
        let tls = Tls::open(files.clone()).expect("a pair");
        let store = open(directory.path(), Options::default()).await;
        let app = TestApp::behind(
            Some(tls),
            directory,
            store,
            Settings {
                limits,
                ..Settings::default()
            },
        )
        .await;
        Self {
            app,
            authority,
            files,
        }
    }

    fn directory(&self) -> &Path {
        self.app.directory.path()
    }

    fn url(&self) -> String {
        format!("https://localhost:{}", self.app.address.port())
    }

    fn config(&self, protocol: &str) -> Arc<ClientConfig> {
        config(&self.authority, None, protocol)
    }

    /// Connects as a client that trusts the authority.
    async fn client(&self) -> Connection {
        let tls = client(self.directory(), &self.authority, None);
        Connection::open_with(&self.url(), &client::Options::default().tls(tls.clone()))
            .await
            .expect("it listens")
    }

    /// Asks over one protocol of ALPN.
    async fn ask(&self, protocol: &str, request: Request<Full<Bytes>>) -> Response<Incoming> {
        let stream = connect(self.app.address, &self.config(protocol))
            .await
            .expect("TLS");
        assert_eq!(
            stream.get_ref().1.alpn_protocol(),
            Some(protocol.as_bytes())
        );
        exchange(stream, request, protocol == "h2").await
    }

    /// Returns the certificate that the service shows.
    async fn shown(&self, authority: &Authority) -> std::io::Result<Vec<u8>> {
        let stream = connect(self.app.address, &config(authority, None, "h2")).await?;
        Ok(stream.get_ref().1.peer_certificates().expect("shown")[0].to_vec())
    }

    async fn metrics(&self) -> String {
        let answer = self
            .ask("http/1.1", request("GET", "/metrics", "", Bytes::new()))
            .await;
        String::from_utf8(
            answer
                .into_body()
                .collect()
                .await
                .expect("whole")
                .to_bytes()
                .into(),
        )
        .expect("text")
    }

    /// Waits until a counter has that value or more; it is the process's, so other tests add to it.
    async fn counts(&self, series: &str, least: f64) {
        let counted = async {
            while value(&self.metrics().await, series) < least {
                sleep(Duration::from_millis(20)).await;
            }
        };
        timeout(LONG, counted)
            .await
            .unwrap_or_else(|_| panic!("{series} stays below {least}"));
    }
}

fn value(metrics: &str, series: &str) -> f64 {
    let line = metrics
        .lines()
        .find_map(|line| line.strip_prefix(series)?.strip_prefix(' '));
    line.unwrap_or_else(|| panic!("there is no {series}"))
        .parse()
        .expect("a number")
}

fn request(method: &str, path: &str, media: &str, body: impl Into<Bytes>) -> Request<Full<Bytes>> {
    let builder = Request::builder()
        .method(method)
        .uri(format!("https://localhost{path}"))
        .header("host", "localhost");
    builder
        .header("content-type", media)
        .body(Full::new(body.into()))
        .expect("a request")
}

fn record() -> Record {
    Record {
        entry: Entry::Entered,
        ..Record::new(vec![0.1, 0.0], vec![0.0, 2.0])
    }
}

fn second() -> Duration {
    Duration::from_secs(1)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_face_speaks_tls() {
    let secured = Secured::start(None, Limits::default()).await;
    let made = secured.ask(
        "http/1.1",
        request(
            "PUT",
            "/v1/environments/lane",
            "application/json",
            lane_json().to_string(),
        ),
    );
    assert_eq!(made.await.status(), 201, "REST over HTTP/1.1");
    for protocol in ["http/1.1", "h2"] {
        for path in [
            "/v1/environments/lane",
            "/",
            "/docs",
            "/livez",
            "/readyz",
            "/metrics",
            "/v2/health/live",
        ] {
            let status = secured
                .ask(protocol, request("GET", path, "", Bytes::new()))
                .await
                .status();
            assert!(
                status.is_success() || status.is_redirection(),
                "{protocol} {path}: {status}"
            );
        }
        // A message of gRPC-Web: no flag, no bytes.
        let list = "/nudge.v1.EnvironmentService/ListEnvironments";
        let asked = request(
            "POST",
            list,
            "application/grpc-web+proto",
            Bytes::from_static(&[0; 5]),
        );
        let answer = secured.ask(protocol, asked).await;
        let body = answer
            .into_body()
            .collect()
            .await
            .expect("whole")
            .to_bytes();
        assert!(
            body.windows(4).any(|name| name == b"lane"),
            "gRPC-Web over {protocol}: {body:?}"
        );
    }

    let connection = secured.client().await;
    let mut producer = connection.producer("lane", "p").open().await.expect("gRPC");
    for _ in 0..1_000 {
        producer.send(record()).await.expect("taken");
    }
    assert_eq!(
        producer.close().await.expect("acknowledged").accepted,
        1_000
    );
    let (url, ca) = (
        secured.url(),
        client(secured.directory(), &secured.authority, None),
    );
    let Trust::Authorities(ca) = ca.trust else {
        panic!("a file")
    };
    let arguments = [
        "query",
        "lane",
        "--key",
        "0.0",
        "--json",
        "--ca",
        ca.to_str().expect("text"),
    ];
    let (code, stdout, stderr) = exit_and_texts(&output(nudge(&url, &arguments)).await);
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("1000"), "{stdout}");
    let expires = value(
        &secured.metrics().await,
        "nudge_tls_certificate_expires_timestamp_seconds",
    );
    assert!(expires > 1e9, "{expires}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn plain_text_is_told_in_its_own_protocol() {
    let secured = Secured::start(None, Limits::default()).await;
    let series = "nudge_tls_handshakes_failed_total{reason=\"plain_text\"}";
    let before = value(&secured.metrics().await, series);
    let url = format!("http://{}/v1/environments", secured.app.address);
    for path in ["/v1/environments", "/livez", "/metrics", "/nothing"] {
        let answer = reqwest::get(format!("http://{}{path}", secured.app.address))
            .await
            .expect("answered");
        let (status, problem) = (
            answer.status().as_u16(),
            answer.json::<Value>().await.expect("JSON"),
        );
        assert_eq!(
            (status, &problem["reason"]),
            (400, &json!("TLS_REQUIRED")),
            "{path}"
        );
    }
    let large = reqwest::Client::new()
        .post(&url)
        .body(vec![b' '; 60 << 10])
        .send()
        .await
        .expect("answered");
    assert_eq!(large.status(), 400);
    let refused = Connection::open(&secured.app.address.to_string())
        .await
        .expect_err("plain");
    assert!(
        refused
            .to_string()
            .ends_with("it speaks TLS: say https:// instead of http://"),
        "{refused}"
    );
    for first in [&b"\n"[..], b"SSH-2.0-x\r\n", b"P", &[0; 100]] {
        Raw::open(secured.app.address, first).await.end().await;
    }
    secured.counts(series, before + 10.0).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn handshakes_have_their_time_and_no_more() {
    let secured = Secured::start(
        None,
        Limits {
            head: second(),
            ..Limits::default()
        },
    )
    .await;
    let (address, mut ended) = (secured.app.address, JoinSet::new());
    let half = half_a_hello();
    for first in [vec![], vec![0x16], half[..20].to_vec(), half] {
        ended.spawn(async move { drop(Raw::open(address, &first).await.end().await) });
    }
    ended.spawn(async move {
        Raw::open(address, b"\x16\x03\x01\x02\x00")
            .await
            .drip(1)
            .await
    });
    // Those that are silent after their handshake have no more time either.
    for first in [
        b"".to_vec(),
        b"GET /liv".to_vec(),
        PREFACE[..12].to_vec(),
        PREFACE.to_vec(),
    ] {
        let config = secured.config("h2");
        ended.spawn(async move {
            let stream = connect(address, &config).await.expect("TLS");
            Raw::over(stream, &first).await.end().await;
        });
    }
    let config = secured.config("http/1.1");
    ended.spawn(async move {
        let stream = connect(address, &config).await.expect("TLS");
        Raw::over(stream, b"GET /livez HTTP/1.1\r\nx: ")
            .await
            .drip(b'a')
            .await;
    });
    while let Some(ended) = ended.join_next().await {
        ended.expect("it is ended");
    }
    secured
        .counts("nudge_tls_handshakes_failed_total{reason=\"timeout\"}", 5.0)
        .await;
}

/// Returns a ClientHello that says it is longer than it is.
fn half_a_hello() -> Vec<u8> {
    let mut hello = vec![0x16, 3, 1, 2, 0, 1, 0, 1, 0xfc, 3, 3];
    hello.resize(100, 7);
    hello
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn handshakes_make_room_and_stalled_requests_end() {
    let limits = Limits {
        connections: 2,
        guests: 0,
        stalled: second(),
        ..Limits::default()
    };
    let secured = Secured::start(None, limits).await;
    let mut silent = Raw::open(secured.app.address, &half_a_hello()).await;
    let mut idle = Raw::over(
        connect(secured.app.address, &secured.config("http/1.1"))
            .await
            .expect("TLS"),
        ALIVE,
    )
    .await;
    idle.until("ok\n").await;
    for _ in 0..3 {
        assert_eq!(
            secured
                .ask("http/1.1", request("GET", "/livez", "", ""))
                .await
                .status(),
            200
        );
    }
    silent.end().await;
    idle.end().await;

    // A body that stops, and an answer that nobody reads.
    let post =
        b"POST /v1/environments/lane/transitions HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n\
        content-length: 100\r\n\r\n{";
    let stream = connect(secured.app.address, &secured.config("http/1.1"))
        .await
        .expect("TLS");
    assert!(
        Raw::over(stream, post)
            .await
            .until("}")
            .await
            .contains("BODY_STALLED")
    );
    let many = b"GET /docs/swagger-ui-bundle.js HTTP/1.1\r\nhost: localhost\r\n\r\n".repeat(30);
    let mut unread = Raw::over(
        connect(secured.app.address, &secured.config("http/1.1"))
            .await
            .expect("TLS"),
        &many,
    )
    .await;
    let writing = async {
        while unread.0.write_all(ALIVE).await.is_ok() && unread.0.flush().await.is_ok() {}
    };
    timeout(LONG, writing).await.expect("it is ended");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_waits_for_no_handshake() {
    let secured = Secured::start(None, Limits::default()).await;
    let address = secured.app.address;
    let mut others = vec![
        Raw::open(address, b"").await,
        Raw::open(address, &half_a_hello()).await,
    ];
    let open = [PREFACE, &call("/nudge.v1.IngestService/Ingest")].concat();
    let stream = Raw::over(
        connect(address, &secured.config("h2")).await.expect("TLS"),
        &open,
    )
    .await;
    let began = std::time::Instant::now();
    timeout(LONG, secured.app.stop()).await.expect("it stops");
    assert!(
        began.elapsed() < Limits::default().head,
        "nobody waits for who says nothing"
    );
    for other in &mut others {
        other.end().await;
    }
    drop(stream);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_need_a_certificate_where_it_is_asked_for() {
    let (clients, strangers) = (Authority::new("clients"), Authority::new("strangers"));
    let secured = Secured::start(Some(&clients), Limits::default()).await;
    let (right, wrong) = (clients.certify("game-7"), strangers.certify("game-7"));
    let expired = clients.certify_until("game-7", 2_021);
    let open = async |identity: Option<&Certificate>| {
        let tls = client(secured.directory(), &secured.authority, identity);
        Connection::open_with(&secured.url(), &client::Options::default().tls(tls.clone())).await
    };
    open(Some(&right)).await.expect("a client of ours");

    for (identity, why) in [
        (
            None,
            "it wants a certificate of the client; name one with --cert and its key with --cert-key",
        ),
        (Some(&wrong), "it does not accept the certificate of --cert"),
        (
            Some(&expired),
            "it does not accept the certificate of --cert",
        ),
    ] {
        let refused = open(identity).await.expect_err("a stranger");
        assert!(
            matches!(refused, ClientError::Untrusted { .. }),
            "{refused:?}"
        );
        assert!(refused.to_string().contains(why), "{refused}");
    }
    // HTTP/1.1 too, and nothing of a face is seen.
    let mut stream = connect(secured.app.address, &secured.config("http/1.1"))
        .await
        .expect("TLS 1.3 asks later");
    let _ = stream.write_all(ALIVE).await;
    assert!(Raw(stream).end().await.is_empty());
    let config = config(&secured.authority, Some(&right), "http/1.1");
    let mut raw = Raw::over(
        connect(secured.app.address, &config).await.expect("TLS"),
        ALIVE,
    )
    .await;
    raw.until("ok\n").await;

    let mut raw = Raw::over(
        connect(secured.app.address, &config).await.expect("TLS"),
        b"GET /metrics HTTP/1.1\r\nhost: localhost\r\n\r\n",
    )
    .await;
    let metrics = raw
        .until("nudge_tls_reloads_total{outcome=\"failed\"}")
        .await;
    for reason in ["no_client_certificate", "bad_client_certificate"] {
        assert!(
            value(
                &metrics,
                &format!("nudge_tls_handshakes_failed_total{{reason=\"{reason}\"}}")
            ) >= 2.0,
            "{reason}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_was_let_in_by_another_authority_leaves() {
    let (before, after) = (Authority::new("before"), Authority::new("after"));
    let limits = Limits {
        grace: 2 * second(),
        ..Limits::default()
    };
    let secured = Secured::start(Some(&before), limits).await;
    let client = before.certify("game-7");
    let connected = async |protocol: &str| {
        let config = config(&secured.authority, Some(&client), protocol);
        connect(secured.app.address, &config).await.expect("TLS")
    };
    // One that is kept without a request, one with half a request, and a call that goes on.
    let mut kept = Raw::over(connected("http/1.1").await, ALIVE).await;
    kept.until("ok\n").await;
    let half = b"POST /v1/environments/lane/fit HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 2\r\n\r\n{";
    let mut busy = Raw::over(connected("http/1.1").await, half).await;
    let watch = [PREFACE, &call("/grpc.health.v1.Health/Watch")].concat();
    let mut watching = Raw::over(connected("h2").await, &watch).await;
    sleep(Duration::from_millis(300)).await;

    // A certificate that is renewed leaves everybody; authorities that are replaced do not.
    write(
        secured.directory(),
        &secured.authority.certify("localhost"),
        Some(&before),
    );
    sleep(Duration::from_millis(1_500)).await;
    kept.0.write_all(ALIVE).await.expect("open");
    kept.until("ok\n").await;
    write(
        secured.directory(),
        &secured.authority.certify("localhost"),
        Some(&after),
    );

    let ended = async {
        assert!(kept.end().await.is_empty(), "it is closed between requests");
        sleep(Duration::from_millis(200)).await;
        busy.0
            .write_all(b"}")
            .await
            .expect("it may finish what it began");
        let answer = String::from_utf8_lossy(&busy.end().await).into_owned();
        assert!(answer.contains("connection: close"), "{answer}");
        let frames = watching.end().await;
        // The header of a frame: its length, and its kind.
        assert!(
            frames.windows(5).any(|bytes| bytes == b"\0\0\x08\x07\0"),
            "GOAWAY"
        );
    };
    timeout(Duration::from_secs(10), ended)
        .await
        .expect("all of them have left");
    assert!(
        connect_and_ask(&secured, &client).await.is_empty(),
        "it does not come back"
    );
    assert!(
        !connect_and_ask(&secured, &after.certify("game-7"))
            .await
            .is_empty(),
        "others come"
    );
}

/// Asks whether the service is alive, with a certificate, and returns the answer.
async fn connect_and_ask(secured: &Secured, client: &Certificate) -> Vec<u8> {
    let config = config(&secured.authority, Some(client), "http/1.1");
    let Ok(mut stream) = connect(secured.app.address, &config).await else {
        return Vec::new();
    };
    let _ = stream
        .write_all(b"GET /livez HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n")
        .await;
    Raw(stream).end().await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn files_are_read_again_and_streams_go_on() {
    let secured = Secured::start(None, Limits::default()).await;
    let made = request(
        "PUT",
        "/v1/environments/lane",
        "application/json",
        lane_json().to_string(),
    );
    assert_eq!(secured.ask("h2", made).await.status(), 201);
    let connection = secured.client().await;
    let (_, mut stream) = RawStream::open(connection.ingest(), hello("p"))
        .await
        .expect("welcome");
    let mut sequence = 0;
    let mut goes_on = async || {
        sequence += 1;
        stream
            .send(rows(sequence, vec![row([0.1, 0.0], [0.0, 2.0])]))
            .await
            .expect("open");
        assert_eq!(
            stream
                .acknowledged()
                .await
                .expect("open")
                .committed_sequence,
            sequence
        );
    };
    goes_on().await;
    let first = secured.shown(&secured.authority).await.expect("TLS");

    // Another certificate without its key changes nothing, and then the pair is whole.
    let failed = "nudge_tls_reloads_total{outcome=\"failed\"}";
    let before = value(&secured.metrics().await, failed);
    let second = secured.authority.certify("localhost");
    std::fs::write(&secured.files.certificate, &second.certificate).expect("written");
    secured.counts(failed, before + 1.0).await;
    assert_eq!(secured.shown(&secured.authority).await.expect("TLS"), first);
    goes_on().await;
    std::fs::write(&secured.files.key, &second.key).expect("written");
    let renewed = async || {
        let changed = async {
            while secured
                .shown(&secured.authority)
                .await
                .is_ok_and(|shown| shown == first)
            {
                sleep(Duration::from_millis(20)).await;
            }
        };
        timeout(LONG, changed).await.expect("it is renewed");
    };
    renewed().await;
    goes_on().await;

    // Nothing that is no pair is used: half a file, none, an empty one, another authority's key.
    let second_shown = secured.shown(&secured.authority).await.expect("TLS");
    let stranger = Authority::new("strangers").certify("localhost");
    let half = second.key[..second.key.len() / 2].to_owned();
    for bad in [half, String::new(), "no PEM".into(), stranger.key] {
        let before = value(&secured.metrics().await, failed);
        std::fs::write(&secured.files.key, &bad).expect("written");
        secured.counts(failed, before + 1.0).await;
        assert_eq!(
            secured.shown(&secured.authority).await.expect("TLS"),
            second_shown
        );
    }
    let before = value(&secured.metrics().await, failed);
    std::fs::remove_file(&secured.files.key).expect("removed");
    secured.counts(failed, before + 1.0).await;
    assert_eq!(
        secured.shown(&secured.authority).await.expect("TLS"),
        second_shown
    );
    goes_on().await;
}

/// Kubernetes mounts a secret as links into `..data`, which is a link itself and is swapped.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_swapped_link_is_seen() {
    let (directory, authority) = (
        Arc::new(TempDir::new().expect("a directory")),
        Authority::new("services"),
    );
    let at = |name: &str| directory.path().join(name);
    for version in ["1", "2"] {
        std::fs::create_dir(at(version)).expect("made");
        write(&at(version), &authority.certify("localhost"), None);
    }
    let link = |to: &str, name: &str| std::os::unix::fs::symlink(to, at(name)).expect("linked");
    link("1", "..data");
    link("..data/tls.crt", "tls.crt");
    link("..data/tls.key", "tls.key");
    let files = TlsFiles {
        certificate: at("tls.crt"),
        key: at("tls.key"),
        client_authorities: None,
    };
    let tls = Tls::open(files.clone()).expect("a pair");
    let store = open(directory.path(), Options::default()).await;
    let app = TestApp::behind(Some(tls), directory.clone(), store, Settings::default()).await;
    let secured = Secured {
        app,
        authority,
        files,
    };
    let first = secured.shown(&secured.authority).await.expect("TLS");
    link("2", "..data_tmp");
    std::fs::rename(at("..data_tmp"), at("..data")).expect("swapped");
    let changed = async { while secured.shown(&secured.authority).await.expect("TLS") == first {} };
    timeout(LONG, changed).await.expect("it is renewed");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_are_told_what_is_wrong() {
    let secured = Secured::start(None, Limits::default()).await;
    let plain = TestApp::start().await;
    let (here, trusted) = (
        secured.directory(),
        client(secured.directory(), &secured.authority, None),
    );
    let stranger = client(here, &Authority::new("strangers"), None);
    let port = secured.app.address.port();
    let cases = [
        (
            secured.url(),
            ClientTls::default(),
            "of an authority that is not known here; name the authority's with --ca",
        ),
        (
            secured.url(),
            stranger,
            "of an authority that is not known here",
        ),
        (
            format!("https://127.0.0.1:{port}"),
            trusted.clone(),
            "its certificate is for another name",
        ),
        (
            format!("https://localhost:{}", plain.address.port()),
            trusted.clone(),
            "say http:// instead of https://",
        ),
        (
            format!("http://localhost:{port}"),
            trusted.clone(),
            "TLS is asked for (--ca, --cert), expected https://",
        ),
        (
            format!("http://localhost:{port}"),
            ClientTls::default(),
            "say https:// instead of http://",
        ),
        (
            "https://localhost:1".into(),
            trusted.clone(),
            "nobody listens at https://localhost:1",
        ),
        (
            secured.url(),
            ClientTls {
                trust: Trust::Exactly(secured.files.certificate.clone()),
                identity: None,
            },
            "",
        ),
        (
            secured.url(),
            ClientTls {
                trust: Trust::Anybody,
                identity: None,
            },
            "",
        ),
    ];
    for (address, tls, why) in cases {
        match Connection::open_with(&address, &client::Options::default().tls(tls.clone())).await {
            Ok(_) => assert_eq!(why, "", "{address}"),
            Err(error) => assert!(
                !why.is_empty() && error.to_string().contains(why),
                "{address}: {error}"
            ),
        }
    }
    let expired = secured.authority.certify_until("localhost", 2_021);
    let tls = Tls::open(write(here, &expired, None)).expect("a pair, though an old one");
    let (directory, store) = (plain.directory.clone(), plain.app.store.clone());
    let old = TestApp::behind(Some(tls), directory, store, Settings::default()).await;
    let refused = Connection::open_with(
        &format!("https://localhost:{}", old.address.port()),
        &client::Options::default().tls(trusted),
    )
    .await;
    assert!(
        refused
            .as_ref()
            .is_err_and(|error| error.to_string().contains("its certificate has expired"))
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn files_that_cannot_be_used_are_one_line_and_code_two() {
    let (directory, authority) = (
        TempDir::new().expect("a directory"),
        Authority::new("services"),
    );
    let files = write(directory.path(), &authority.certify("localhost"), None);
    let at = |name: &str| {
        directory
            .path()
            .join(name)
            .to_str()
            .expect("text")
            .to_owned()
    };
    let (cert, key) = (at("tls.crt"), at("tls.key"));
    let secret = std::fs::read_to_string(&files.key).expect("written");
    let secret = secret.lines().nth(1).expect("a line");
    let other = authority.certify("localhost");
    for (name, text) in [
        ("other.key", other.key.as_str()),
        ("empty", ""),
        ("encrypted", ENCRYPTED),
        ("words", "words"),
    ] {
        std::fs::write(at(name), text).expect("written");
    }
    let cases: [(&[&str], &str); 12] = [
        (
            &["--tls-cert", &cert],
            "--tls-cert (NUDGE_TLS_CERT) is given without --tls-key (NUDGE_TLS_KEY)",
        ),
        (
            &["--tls-key", &key],
            "--tls-key (NUDGE_TLS_KEY) is given without --tls-cert (NUDGE_TLS_CERT)",
        ),
        (
            &["--tls-client-ca", &cert],
            "--tls-client-ca (NUDGE_TLS_CLIENT_CA) is given without --tls-cert and --tls-key",
        ),
        (
            &["--tls-cert", "/no/such", "--tls-key", &key],
            "--tls-cert \"/no/such\": cannot be read (No such file",
        ),
        (
            &["--tls-cert", &cert, "--tls-key", "/no/such"],
            "--tls-key \"/no/such\": cannot be read (No such file",
        ),
        (
            &["--tls-cert", &key, "--tls-key", &key],
            "expected PEM certificates (BEGIN CERTIFICATE), found a private key",
        ),
        (
            &["--tls-cert", &cert, "--tls-key", &cert],
            "expected a PEM private key (BEGIN PRIVATE KEY), found a certificate",
        ),
        (
            &["--tls-cert", &at("words"), "--tls-key", &key],
            "found no PEM",
        ),
        (
            &["--tls-cert", &cert, "--tls-key", &at("empty")],
            "found an empty file",
        ),
        (
            &["--tls-cert", &cert, "--tls-key", &at("encrypted")],
            "the key is encrypted",
        ),
        (
            &["--tls-cert", &cert, "--tls-key", &at("other.key")],
            "does not fit the certificate of --tls-cert",
        ),
        (
            &[
                "--tls-cert",
                &cert,
                "--tls-key",
                &key,
                "--tls-client-ca",
                &at("empty"),
            ],
            "found an empty file",
        ),
    ];
    let data = at("data");
    for (arguments, why) in cases {
        let arguments = [
            &["serve", "--listen", "127.0.0.1:0", "--data", &data],
            arguments,
        ]
        .concat();
        let (code, stdout, stderr) = exit_and_texts(&output(nudge("", &arguments)).await);
        assert_eq!(
            (code, stdout.as_str(), stderr.lines().count()),
            (2, "", 1),
            "{stderr}"
        );
        assert!(stderr.contains(why), "{stderr}");
        assert!(!stderr.contains(secret), "{stderr}");
    }
    assert!(!Path::new(&data).exists(), "the data is not touched");

    let printed = [
        "serve",
        "--print-config",
        "--tls-cert",
        &cert,
        "--tls-key",
        &key,
    ];
    let (code, stdout, _) = exit_and_texts(&output(nudge("", &printed)).await);
    assert_eq!(code, 0);
    assert!(
        stdout.contains(&format!("tls_cert = {cert:?}\ntls_key = {key:?}\n"))
            && !stdout.contains(secret),
        "{stdout}"
    );

    let client = ["env", "list", "--cert", &cert];
    let (code, _, stderr) = exit_and_texts(&output(nudge("https://localhost:1", &client)).await);
    assert_eq!(code, 2);
    assert!(
        stderr.contains("--cert (NUDGE_CERT) is given without --cert-key (NUDGE_CERT_KEY)"),
        "{stderr}"
    );
    let client = [
        "env",
        "list",
        "--cert",
        &cert,
        "--cert-key",
        &at("other.key"),
    ];
    let (_, _, stderr) = exit_and_texts(&output(nudge("https://localhost:1", &client)).await);
    assert!(
        stderr.contains("--cert-key ")
            && stderr.contains("does not go with the certificate of --cert"),
        "{stderr}"
    );
}

const ENCRYPTED: &str =
    "-----BEGIN ENCRYPTED PRIVATE KEY-----\nMIIB\n-----END ENCRYPTED PRIVATE KEY-----\n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn health_tells_ready_from_not_ready_from_nobody() {
    let secured = Secured::start(None, Limits::default()).await;
    let plain = TestApp::start().await;
    let (cert, port) = (
        secured.files.certificate.to_str().expect("text"),
        secured.app.address.port(),
    );
    let beside = format!("0.0.0.0:{port}");
    let plainly = plain.address.to_string();
    let elsewhere = TempDir::new().expect("a directory");
    let other = write(
        elsewhere.path(),
        &Authority::new("strangers").certify("localhost"),
        None,
    );
    let other = other.certificate.to_str().expect("text");
    let cases: [(&[&str], i32, &str); 9] = [
        (&["--server", &plainly], 0, "ready"),
        (&["--listen", &plainly], 0, "ready"),
        (&["--listen", &beside, "--tls-cert", cert], 0, "ready"),
        (
            &["--listen", &beside, "--tls-cert", other],
            2,
            "its certificate is not the one of --tls-cert",
        ),
        (
            &["--listen", &beside],
            2,
            "it speaks TLS: say https:// instead of http://",
        ),
        (
            &["--server", &secured.url()],
            2,
            "of an authority that is not known here",
        ),
        (&["--server", &secured.url(), "--no-verify"], 0, "ready"),
        (
            &["--server", "127.0.0.1:1"],
            2,
            "nobody listens at http://127.0.0.1:1",
        ),
        (
            &["--server", &secured.url(), "--ca", "/no/such"],
            2,
            "--ca \"/no/such\": cannot be read",
        ),
    ];
    for (arguments, code, words) in cases {
        let mut command = nudge("", &[&["health"], arguments].concat());
        command.env_remove("NUDGE_SERVER");
        let (ended, stdout, stderr) = exit_and_texts(&output(command).await);
        assert_eq!(ended, code, "{arguments:?}: {stdout}{stderr}");
        assert!(
            format!("{stdout}{stderr}").contains(words),
            "{arguments:?}: {stdout}{stderr}"
        );
    }

    // Somebody who takes the connection and says nothing, and a service that is not open yet.
    let silent = tokio::net::TcpListener::bind("127.0.0.1:0")
        .await
        .expect("a free port");
    let silent_at = silent.local_addr().expect("bound").to_string();
    let (ended, _, stderr) =
        exit_and_texts(&output(nudge(&silent_at, &["health", "--timeout", "1s"])).await);
    assert_eq!(ended, 2, "{stderr}");
    assert!(stderr.contains("does not answer within 1s"), "{stderr}");
    let mut starting = Starting::new(Settings::default());
    let at = starting.listen(FREE_PORT, None).await.expect("a free port");
    let at = at.to_string();
    let (ended, _, stderr) = exit_and_texts(&output(nudge(&at, &["health"])).await);
    assert_eq!(ended, 1, "{stderr}");
    assert!(
        stderr.contains("not ready: opening the database"),
        "{stderr}"
    );
    starting.shutdown().await.expect("it ends");
}

/// The real binary: its line says https, SIGHUP reads the files at once and ends nothing, and one
/// that has expired is used with a warning.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_hangup_reads_the_files_again() {
    let (directory, authority) = (
        TempDir::new().expect("a directory"),
        Authority::new("services"),
    );
    let files = write(
        directory.path(),
        &authority.certify_until("localhost", 2_021),
        None,
    );
    let log = directory.path().join("log");
    let mut command = Server::command(&directory.path().join("data"), "127.0.0.1:0");
    command
        .arg("--tls-cert")
        .arg(&files.certificate)
        .arg("--tls-key")
        .arg(&files.key);
    command.stderr(std::fs::File::create(&log).expect("made"));
    let server = Server::run(&mut command).expect("it starts");
    let said = |words: &str| {
        std::fs::read_to_string(&log)
            .expect("text")
            .matches(words)
            .count()
    };
    assert_eq!(said("the certificate has expired: clients refuse it"), 1);

    write(directory.path(), &authority.certify("localhost"), None);
    let hangup = std::process::Command::new("kill")
        .args(["-HUP", &server.pid().to_string()])
        .status();
    assert!(hangup.expect("kill is there").success());
    let renewed = async {
        while connect(server.address, &config(&authority, None, "h2"))
            .await
            .is_err()
        {
            sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(LONG, renewed).await.expect("it is renewed");
    assert!(said("the certificate was read again") >= 1);
    assert_eq!(server.terminate(), Some(0), "a hangup ends nothing");
    let log = std::fs::read_to_string(&log).expect("text");
    assert!(!log.contains("PRIVATE KEY"), "{log}");
}
