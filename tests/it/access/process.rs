//! The real binary: what it refuses to begin, keys that it reads again, and that nothing secret is told.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use crate::server::Server;

fn nudge(arguments: &[&str]) -> std::process::Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nudge"));
    command.args(arguments).stdin(Stdio::null()).output().expect("the binary runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn a_service_that_others_reach_begins_with_keys_or_with_insecure() {
    let directory = TempDir::new().expect("a temporary directory");
    let data = directory.path().join("data");
    for (command, listen) in
        [("serve", "0.0.0.0:0"), ("serve", "[::]:0"), ("serve", "192.0.2.1:0"), ("demo", "0.0.0.0:0")]
    {
        let refused = nudge(&[command, "--listen", listen, "--data", data.to_str().expect("text")]);
        let told = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{command} {listen}: {told}");
        assert!(["--keys", "--insecure", "127.0.0.1"].iter().all(|flag| told.contains(flag)), "{told}");
        assert!(!data.exists(), "it touched the data");
    }
    for listen in ["127.0.0.1:0", "127.3.2.1:0"] {
        Server::start(&data, listen).terminate();
    }
    let keys = directory.path().join("keys");
    std::fs::write(&keys, "").expect("written");
    let mut command = Server::command(&data, "0.0.0.0:0");
    Server::run(command.arg("--keys").arg(&keys)).expect("it has keys").terminate();
    let mut command = Server::command(&data, "0.0.0.0:0");
    Server::run(command.arg("--insecure")).expect("it is wanted").terminate();
}

#[test]
fn a_key_is_made_once_and_its_file_is_its_owners() {
    use std::os::unix::fs::PermissionsExt;

    let directory = TempDir::new().expect("a temporary directory");
    let file = directory.path().join("keys.txt");
    let path = file.to_str().expect("text");
    let made = nudge(&[
        "key",
        "new",
        "game",
        "--scope",
        "ingest,read",
        "--environments",
        "hall*",
        "--rate",
        "5/s",
        "--append",
        path,
    ]);
    let key = text(&made.stdout);
    assert!(made.status.success() && key.starts_with("nudge_") && key.trim_end().len() == 70, "{}", text(&made.stderr));
    assert_eq!(file.metadata().expect("there").permissions().mode() & 0o777, 0o600);
    let lines = std::fs::read_to_string(&file).expect("there");
    let digest = blake3::hash(key.trim_end().as_bytes()).to_hex();
    assert_eq!(lines, format!("game {digest} read,ingest environments=hall* rate=5/s\n"));

    // Without a file the line goes where a pipe does not take it.
    let shown = nudge(&["key", "new", "board", "--scope", "read"]);
    assert_eq!(text(&shown.stdout).lines().count(), 1);
    assert!(text(&shown.stderr).contains("\nboard ") && !text(&shown.stderr).contains(text(&shown.stdout).trim()));

    std::fs::write(&file, "game nonsense").expect("written");
    let refused = nudge(&["key", "new", "game", "--scope", "read", "--append", path]);
    assert!(!refused.status.success() && text(&refused.stderr).contains("line 1: digest"), "{}", text(&refused.stderr));
    assert!(refused.stdout.is_empty(), "no key that nobody lets in");
    for wrong in
        [&["key", "new", "Game", "--scope", "read"][..], &["key", "new", "g"], &["key", "new", "g", "--scope", "all"]]
    {
        assert_eq!(nudge(wrong).status.code(), Some(2), "{wrong:?}");
    }
}

/// Asks until a status comes, and returns how long that took.
async fn until(server: &Server, key: &str, status: u16) -> Duration {
    let began = Instant::now();
    loop {
        let url = format!("http://{}/v1/environments", server.address);
        let answer = reqwest::Client::new().get(url).header("authorization", format!("Bearer {key}")).send().await;
        if answer.expect("answered").status() == status {
            return began.elapsed();
        }
        assert!(began.elapsed() < Duration::from_secs(10), "never {status}");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

#[tokio::test]
async fn keys_are_read_again_and_nothing_secret_is_told() {
    let directory = TempDir::new().expect("a temporary directory");
    let file = directory.path().join("keys.txt");
    let path = file.to_str().expect("text").to_owned();
    let new = |name: &str| {
        let made = nudge(&["key", "new", name, "--scope", "read,admin,ingest", "--append", &path]);
        text(&made.stdout).trim_end().to_owned()
    };
    let first = new("game");
    let log = directory.path().join("log");
    let data = directory.path().join("data");
    let mut command = Server::command(&data, "127.0.0.1:0");
    command.args(["--keys", &path, "--log", "json"]).env("RUST_LOG", "trace");
    let server = Server::run(command.stderr(std::fs::File::create(&log).expect("made"))).expect("it begins");
    let hang_up = || {
        let sent = Command::new("kill").args(["-HUP", &server.pid().to_string()]).status();
        assert!(sent.expect("kill is there").success());
    };
    until(&server, &first, 200).await;

    let second = new("game");
    hang_up();
    assert!(until(&server, &second, 200).await < Duration::from_secs(1));
    until(&server, &first, 200).await;

    // A file that is wrong leaves the keys as they are, and the log says why.
    let lines = std::fs::read_to_string(&file).expect("there");
    std::fs::write(&file, format!("{lines}game {second} read\nnobody\n")).expect("written");
    hang_up();
    tokio::time::sleep(Duration::from_millis(300)).await;
    until(&server, &first, 200).await;
    let last = lines.lines().last().expect("two lines").to_owned();
    // So does one that is half-written: half a line may let in more than the whole.
    std::fs::write(&file, &last).expect("written");
    hang_up();
    tokio::time::sleep(Duration::from_millis(300)).await;
    until(&server, &first, 200).await;
    std::fs::write(&file, format!("{last}\n")).expect("written");
    hang_up();
    assert!(until(&server, &first, 401).await < Duration::from_secs(1));
    until(&server, &second, 200).await;

    // A command asks with it by the variable, and is not shown it.
    let address = format!("http://{}", server.address);
    let list = |key: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_nudge"));
        command.args(["env", "list", "--server", &address]).env("NUDGE_KEY", key).output().expect("it runs")
    };
    assert!(list(&second).status.success());
    let refused = list(&first);
    assert!(!refused.status.success() && text(&refused.stderr).contains("NUDGE_KEY"), "{}", text(&refused.stderr));
    let wrong = list(&format!("{second} x"));
    assert_eq!(wrong.status.code(), Some(2));
    let held = directory.path().join("key");
    std::fs::write(&held, format!("{second}\n")).expect("written");
    let by_file = nudge(&["env", "list", "--server", &address, "--api-key-file", held.to_str().expect("text")]);
    assert!(by_file.status.success(), "{}", text(&by_file.stderr));

    let client = reqwest::Client::new();
    let ask = |path: &str| client.get(format!("{address}{path}")).header("authorization", format!("Bearer {second}"));
    let body = serde_json::json!({"schema": {}});
    let made =
        client.put(format!("{address}/v1/environments/lane")).header("authorization", format!("Bearer {second}"));
    let made = made.json(&crate::support::lane_json()).send().await.expect("answered");
    assert_eq!(made.status(), 201, "{body}");
    let metrics = ask("/metrics").send().await.expect("answered").text().await.expect("text");
    assert!(metrics.contains("nudge_requests_denied_total{reason=\"unauthenticated\"}"));
    let mut print = Command::new(env!("CARGO_BIN_EXE_nudge"));
    let print =
        print.args(["serve", "--print-config", "--keys", &path]).env("NUDGE_KEY", &second).output().expect("runs");
    let mut help = Command::new(env!("CARGO_BIN_EXE_nudge"));
    let help = help.args(["env", "list", "--help"]).env("NUDGE_KEY", &second).output().expect("it runs");
    server.terminate();

    let logged = std::fs::read_to_string(&log).expect("there");
    let made = logged.lines().find(|line| line.contains("an environment was made")).expect("a line");
    assert!(made.contains("\"principal\":\"game\""), "{made}");
    let kept = logged.lines().find(|line| line.contains("keys were not read again")).expect("a line");
    assert!(kept.contains("line 3: digest: got a key itself") && kept.contains("line 4: digest: missing"), "{kept}");
    for told in [logged, metrics, text(&print.stdout), text(&help.stdout), text(&refused.stderr), text(&wrong.stderr)] {
        for secret in [&first, &second] {
            assert!(!told.contains(&secret[6..30]), "a key is told in\n{told}");
        }
    }
}
