//! From the first moment: the socket answers while the database is opened, signals work, and what
//! cannot be opened is said in one line.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use nudge::api::proto;
use nudge::api::proto::environment_service_client::EnvironmentServiceClient;
use nudge::app::Upkeep;
use nudge::serve::{Settings, Starting};
use nudge::store::Options;
use serde_json::{Value, json};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use tempfile::TempDir;
use tonic_types::StatusExt;

use crate::server::Server;
use crate::support::fixtures::Fixture;
use crate::support::{FREE_PORT, channel, open, reason};

async fn asked(method: &str, url: &str) -> (u16, Option<String>, String) {
    let request = reqwest::Client::new().request(method.parse().expect("a method"), url);
    let response = request.send().await.expect("answered");
    let retry = response
        .headers()
        .get("retry-after")
        .map(|value| value.to_str().expect("text").to_owned());
    (
        response.status().as_u16(),
        retry,
        response.text().await.expect("text"),
    )
}

#[tokio::test]
async fn every_face_says_what_it_waits_for_until_the_database_is_open() {
    let mut starting = Starting::new(Settings::default());
    let address = starting.listen(FREE_PORT, None).await.expect("a free port");
    let url = |path: &str| format!("http://{address}{path}");
    let mut grpc = EnvironmentServiceClient::new(channel(address).await.expect("it listens"));
    let list = proto::ListEnvironmentsRequest::default;

    for words in [
        "opening the database",
        "migrating the database, step 2 of 3",
    ] {
        starting.stage().begin_step(words);
        assert_eq!(
            asked("GET", &url("/livez")).await,
            (200, None, "ok\n".into())
        );
        assert_eq!(asked("GET", &url("/v2/health/live")).await.0, 200);
        assert_eq!(
            asked("GET", &url("/readyz")).await,
            (503, None, format!("not ready: {words}\n"))
        );
        let (status, _, checks) = asked("GET", &url("/readyz?verbose")).await;
        let checks: Value = serde_json::from_str(&checks).expect("JSON");
        assert_eq!(
            (status, &checks["ready"], &checks["checks"]["database"]),
            (503, &json!(false), &json!(words))
        );

        for (method, path) in [
            ("GET", "/v1/environments"),
            ("PUT", "/v1/environments/x"),
            ("GET", "/"),
            ("GET", "/metrics"),
        ] {
            let (status, retry, body) = asked(method, &url(path)).await;
            let problem: Value = serde_json::from_str(&body).expect("a problem");
            assert_eq!((status, retry.as_deref()), (503, Some("1")), "{path}");
            assert_eq!(problem["reason"], "NOT_READY", "{problem}");
            assert!(
                problem["detail"]
                    .as_str()
                    .is_some_and(|detail| detail.ends_with(words)),
                "{problem}"
            );
        }
        let (status, retry, body) = asked("GET", &url("/v2/models/hallway")).await;
        assert_eq!((status, retry.as_deref()), (503, Some("1")));
        assert_eq!(
            body,
            json!({"error": format!("not ready: database: {words}")}).to_string()
        );

        let refused = grpc
            .list_environments(list())
            .await
            .expect_err("it is closed");
        assert_eq!(
            (refused.code(), reason(&refused)),
            (tonic::Code::Unavailable, "NOT_READY".into())
        );
        assert!(
            refused.message().ends_with(words) && refused.get_details_retry_info().is_some(),
            "{refused:?}"
        );
    }

    let directory = TempDir::new().expect("a temporary directory");
    let store = open(directory.path(), Options::default()).await;
    let running = starting.open(store, Upkeep::default());
    let running = running.await.expect("opened");
    // On the connection that was refused before, too.
    assert!(grpc.list_environments(list()).await.is_ok());
    let told = asked("GET", &url("/metrics")).await.2;
    for (face, route, code) in [
        ("rest", "GET /livez", "200"),
        ("rest", "GET /v2/health/live", "200"),
        ("rest", "GET /readyz", "503"),
        ("rest", "GET /metrics", "503"),
        ("grpc", "ListEnvironments", "UNAVAILABLE"),
    ] {
        let series =
            format!("nudge_requests_total{{face=\"{face}\",route=\"{route}\",code=\"{code}\"}} ");
        // The metrics are the process's, which other tests may use.
        let times = told
            .lines()
            .find_map(|line| line.strip_prefix(&series))
            .map(|times| times.parse::<u64>());
        assert!(
            times.is_some_and(|times| times.is_ok_and(|times| times >= 2)),
            "{series}"
        );
    }
    assert_eq!(
        asked("GET", &url("/readyz")).await,
        (200, None, "ready\n".into())
    );
    assert_eq!(asked("GET", &url("/v1/environments")).await.0, 200);
    drop(grpc);
    running.shutdown().await.expect("it ends");
}

async fn execute(path: &Path, sql: &'static str) {
    let mut connection = SqliteConnectOptions::new()
        .filename(path)
        .connect()
        .await
        .expect("a connection");
    sqlx::raw_sql(sql)
        .execute(&mut connection)
        .await
        .expect("a statement that works");
    connection.close().await.expect("closed");
}

fn serve(data: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_nudge"))
        .args([
            "serve",
            "--listen",
            "127.0.0.1:0",
            "--log",
            "json",
            "--data",
        ])
        .arg(data)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary starts")
}

fn terminate(child: &Child) {
    let killed = Command::new("kill")
        .args(["-TERM", &child.id().to_string()])
        .status();
    assert!(killed.expect("kill is there").success());
}

/// Returns the first line that says this, as JSON; those before are passed over.
async fn line(child: &mut Child, message: &'static str) -> Value {
    let stderr = child.stderr.take().expect("piped");
    let (found, line) = tokio::sync::oneshot::channel();
    // Reads on, for a service that cannot log is another matter.
    std::thread::spawn(move || {
        let mut lines = BufReader::new(stderr).lines().map_while(Result::ok);
        let line = lines.find(|line| line.contains(message));
        let _ = found.send(line);
        lines.for_each(drop);
    });
    let line = line
        .await
        .expect("read")
        .unwrap_or_else(|| panic!("it never says {message:?}"));
    serde_json::from_str(&line).expect("JSON")
}

/// Returns how many migrations there are.
fn migrations() -> usize {
    let folder = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("migrations"))
        .expect("a folder");
    folder
        .filter(|entry| {
            entry
                .as_ref()
                .is_ok_and(|entry| entry.path().extension().is_some_and(|e| e == "sql"))
        })
        .count()
}

/// A migration that never ends: what waits for it is told so, and the signal to stop is heard.
const ENDLESS: &str =
    "create view forever as with recursive n (x) as (select 1 union all select x + 1 from n) select x from n;
    create trigger endless after insert on _sqlx_migrations begin select count(*) from forever; end;";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_service_that_migrates_answers_and_hears_signals() {
    let fixture = Fixture::named("schema-1-af3f5d0");
    execute(&fixture.path(), ENDLESS).await;
    let mut child = serve(fixture.directory.path());
    let told = line(&mut child, "listening, and not ready yet").await;
    let doing = format!("migrating the database, step 1 of {}", migrations() - 1);
    assert_eq!(told["doing"], doing, "{told}");
    let url = |path: &str| {
        format!(
            "http://{}{path}",
            told["address"].as_str().expect("an address")
        )
    };
    assert_eq!(asked("GET", &url("/livez")).await.0, 200);
    let (status, _, words) = asked("GET", &url("/readyz")).await;
    assert_eq!((status, words), (503, format!("not ready: {doing}\n")));
    assert_eq!(asked("GET", &url("/v1/environments")).await.0, 503);

    terminate(&child);
    let ended = tokio::task::spawn_blocking(move || child.wait().expect("it ends"));
    assert_eq!(ended.await.expect("no panic").code(), Some(0));

    // Nothing of the interrupted migration is left: the next start does it.
    execute(&fixture.path(), "drop trigger endless; drop view forever;").await;
    let server = Server::start(fixture.directory.path(), "127.0.0.1:0");
    let (status, _, list) =
        asked("GET", &format!("http://{}/v1/environments", server.address)).await;
    let list: Value = serde_json::from_str(&list).expect("JSON");
    assert_eq!(
        (status, list["environments"].as_array().map(Vec::len)),
        (200, Some(3)),
        "{list}"
    );
    server.kill();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_database_that_cannot_be_opened_is_one_line_and_code_two() {
    let directory = TempDir::new().expect("a temporary directory");
    std::fs::write(
        directory.path().join("nudge.db"),
        "no database ".repeat(500),
    )
    .expect("written");
    let mut child = serve(directory.path());
    let ended = tokio::task::spawn_blocking(move || {
        let (mut told, mut said) = (String::new(), String::new());
        child
            .stderr
            .take()
            .expect("piped")
            .read_to_string(&mut told)
            .expect("text");
        child
            .stdout
            .take()
            .expect("piped")
            .read_to_string(&mut said)
            .expect("text");
        (child.wait().expect("it ends").code(), told, said)
    });
    let (code, told, said) = ended.await.expect("no panic");
    assert_eq!(
        (code, told.lines().count(), said.as_str()),
        (Some(2), 1, ""),
        "{told}"
    );
    assert!(
        told.starts_with("error: cannot open ") && told.contains("it is not a database"),
        "{told}"
    );
}

/// A read of every cell may take minutes, and closing must not wait for it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn closing_ends_a_read_that_goes_on() {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    store
        .create(
            &"lane".parse().expect("a name"),
            &crate::support::batches::schema(),
            &Default::default(),
        )
        .await
        .expect("made");
    let endless = "drop table cells; insert into states (environment, key) values (1, '1');
        create view cells as with recursive n (x) as (select 1 union all select x + 1 from n)
            select 1 as state, 1 as segment, 1 as joint, 1 as n, 1 as entries from n;";
    execute(&directory.path().join("nudge.db"), endless).await;
    let mut audit = tokio::spawn({
        let store = store.clone();
        async move { store.audit().await }
    });
    assert!(
        tokio::time::timeout(Duration::from_millis(200), &mut audit)
            .await
            .is_err(),
        "it never ends by itself"
    );
    store.close().await;
    assert!(audit.await.expect("no panic").is_err());
}
