//! The real binary: what it refuses to begin, keys that it reads again, and that nothing secret is
//! told.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use crate::server::Server;

fn nudge(arguments: &[&str]) -> std::process::Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nudge"));
    command
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .expect("the binary runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn a_service_that_others_reach_begins_with_keys_or_with_insecure() {
    let directory = TempDir::new().expect("a temporary directory");
    let data = directory.path().join("data");
    for (command, listen) in [
        ("serve", "0.0.0.0:0"),
        ("serve", "[::]:0"),
        ("serve", "192.0.2.1:0"),
        ("demo", "0.0.0.0:0"),
    ] {
        let refused = nudge(&[
            command,
            "--listen",
            listen,
            "--data",
            data.to_str().expect("text"),
        ]);
        let told = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{command} {listen}: {told}");
        assert!(
            ["--keys", "--insecure", "127.0.0.1"]
                .iter()
                .all(|flag| told.contains(flag)),
            "{told}"
        );
        assert!(!data.exists(), "it touched the data");
    }
    for listen in ["127.0.0.1:0", "127.3.2.1:0"] {
        Server::start(&data, listen).terminate();
    }
    let keys = directory.path().join("keys");
    std::fs::write(&keys, "").expect("written");
    let mut command = Server::command(&data, "0.0.0.0:0");
    Server::run(command.arg("--keys").arg(&keys))
        .expect("it has keys")
        .terminate();
    let mut command = Server::command(&data, "0.0.0.0:0");
    Server::run(command.arg("--insecure"))
        .expect("it is wanted")
        .terminate();
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
    assert!(
        made.status.success() && key.starts_with("nudge_") && key.trim_end().len() == 70,
        "{}",
        text(&made.stderr)
    );
    assert_eq!(
        file.metadata().expect("there").permissions().mode() & 0o777,
        0o600
    );
    let lines = std::fs::read_to_string(&file).expect("there");
    let digest = blake3::hash(key.trim_end().as_bytes()).to_hex();
    assert_eq!(
        lines,
        format!("game {digest} read,ingest environments=hall* rate=5/s\n")
    );

    // Without a file the line goes where a pipe does not take it.
    let shown = nudge(&["key", "new", "board", "--scope", "read"]);
    assert_eq!(text(&shown.stdout).lines().count(), 1);
    assert!(
        text(&shown.stderr).contains("\nboard ")
            && !text(&shown.stderr).contains(text(&shown.stdout).trim())
    );

    std::fs::write(&file, "game nonsense").expect("written");
    let refused = nudge(&["key", "new", "game", "--scope", "read", "--append", path]);
    assert!(
        !refused.status.success() && text(&refused.stderr).contains("line 1: digest"),
        "{}",
        text(&refused.stderr)
    );
    assert!(refused.stdout.is_empty(), "no key that nobody lets in");
    for wrong in [
        &["key", "new", "Game", "--scope", "read"][..],
        &["key", "new", "g"],
        &["key", "new", "g", "--scope", "all"],
    ] {
        assert_eq!(nudge(wrong).status.code(), Some(2), "{wrong:?}");
    }
}

/// Asks until a status comes, and returns how long that took.
async fn until(server: &Server, key: &str, status: u16) -> Duration {
    let began = Instant::now();
    loop {
        let url = format!("http://{}/v1/environments", server.address);
        let answer = reqwest::Client::new()
            .get(url)
            .header("authorization", format!("Bearer {key}"))
            .send()
            .await;
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
        let made = nudge(&[
            "key",
            "new",
            name,
            "--scope",
            "read,admin,ingest",
            "--append",
            &path,
        ]);
        text(&made.stdout).trim_end().to_owned()
    };
    let first = new("game");
    let log = directory.path().join("log");
    let data = directory.path().join("data");
    let mut command = Server::command(&data, "127.0.0.1:0");
    command
        .args(["--keys", &path, "--log", "json"])
        .env("RUST_LOG", "trace");
    let server =
        Server::run(command.stderr(std::fs::File::create(&log).expect("made"))).expect("it begins");
    let hang_up = || {
        let sent = Command::new("kill")
            .args(["-HUP", &server.pid().to_string()])
            .status();
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
        command
            .args(["env", "list", "--server", &address])
            .env("NUDGE_KEY", key)
            .output()
            .expect("it runs")
    };
    assert!(list(&second).status.success());
    let refused = list(&first);
    assert!(
        !refused.status.success() && text(&refused.stderr).contains("NUDGE_KEY"),
        "{}",
        text(&refused.stderr)
    );
    let wrong = list(&format!("{second} x"));
    assert_eq!(wrong.status.code(), Some(2));
    let held = directory.path().join("key");
    std::fs::write(&held, format!("{second}\n")).expect("written");
    let by_file = nudge(&[
        "env",
        "list",
        "--server",
        &address,
        "--api-key-file",
        held.to_str().expect("text"),
    ]);
    assert!(by_file.status.success(), "{}", text(&by_file.stderr));

    let client = reqwest::Client::new();
    let ask = |path: &str| {
        client
            .get(format!("{address}{path}"))
            .header("authorization", format!("Bearer {second}"))
    };
    let body = serde_json::json!({"schema": {}});
    let made = client
        .put(format!("{address}/v1/environments/lane"))
        .header("authorization", format!("Bearer {second}"));
    let made = made
        .json(&crate::support::lane_json())
        .send()
        .await
        .expect("answered");
    assert_eq!(made.status(), 201, "{body}");
    let metrics = ask("/metrics")
        .send()
        .await
        .expect("answered")
        .text()
        .await
        .expect("text");
    assert!(metrics.contains("nudge_requests_denied_total{reason=\"unauthenticated\"}"));
    // A key in the wrong place of a request, with a key to be let in by and without.
    for key in [&second, &first] {
        let url = format!("{address}/v1/environments/{second}?state.x={second}");
        for method in [http::Method::GET, http::Method::DELETE] {
            let request = client
                .request(method, &url)
                .header("authorization", format!("Bearer {key}"));
            let request = request
                .header("user-agent", &second)
                .header("x-request-id", format!("a-{second}"));
            let answer = request.send().await.expect("answered");
            assert!(answer.status().is_client_error());
            assert!(
                !answer.headers()["x-request-id"]
                    .to_str()
                    .expect("text")
                    .contains(&second)
            );
        }
    }
    let mut print = Command::new(env!("CARGO_BIN_EXE_nudge"));
    let print = print
        .args(["serve", "--print-config", "--keys", &path])
        .env("NUDGE_KEY", &second)
        .output()
        .expect("runs");
    let mut help = Command::new(env!("CARGO_BIN_EXE_nudge"));
    let help = help
        .args(["env", "list", "--help"])
        .env("NUDGE_KEY", &second)
        .output()
        .expect("it runs");
    server.terminate();

    let logged = std::fs::read_to_string(&log).expect("there");
    let made = logged
        .lines()
        .find(|line| line.contains("an environment was made"))
        .expect("a line");
    assert!(made.contains("\"principal\":\"game\""), "{made}");
    let kept = logged
        .lines()
        .find(|line| line.contains("keys were not read again"))
        .expect("a line");
    assert!(
        kept.contains("line 3: digest: got a key itself")
            && kept.contains("line 4: digest: missing"),
        "{kept}"
    );
    for told in [
        logged,
        metrics,
        text(&print.stdout),
        text(&help.stdout),
        text(&refused.stderr),
        text(&wrong.stderr),
    ] {
        for secret in [&first, &second] {
            assert!(!told.contains(&secret[6..30]), "a key is told in\n{told}");
        }
    }
}

/// Runs a command that is to fail or to print something, and returns everything that it tells; one
/// that goes on is ended.
fn telling(arguments: &[&str], variables: &[(&str, &str)]) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nudge"));
    command
        .args(arguments)
        .envs(variables.iter().copied())
        .stdin(Stdio::null());
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it runs");
    let late = Instant::now() + Duration::from_secs(20);
    while child.try_wait().expect("a child of ours").is_none() && Instant::now() < late {
        std::thread::sleep(Duration::from_millis(10));
    }
    let _ = child.kill();
    let output = child.wait_with_output().expect("it ended");
    (
        output.status.code(),
        text(&output.stdout) + &text(&output.stderr),
    )
}

/// Arguments, and variables by their names.
type Given<'a> = (Vec<&'a str>, Vec<(&'a str, &'a str)>);

#[test]
fn a_secret_in_the_wrong_place_is_not_shown() {
    let directory = TempDir::new().expect("a temporary directory");
    let data = directory
        .path()
        .join("data")
        .to_str()
        .expect("text")
        .to_owned();
    let key = nudge::access::generate()
        .expect("randomness")
        .reveal()
        .to_owned();
    let pem = crate::support::certificates::Authority::new("a")
        .certify("localhost")
        .key;
    let inside: Vec<&str> = pem
        .lines()
        .filter(|line| line.len() > 20 && !line.contains("---"))
        .collect();
    let serve = ["serve", "--listen", "127.0.0.1:0", "--data", &data];
    let print = ["serve", "--print-config"];

    let mut cases: Vec<Given> = Vec::new();
    for secret in [key.as_str(), pem.as_str()] {
        for variable in [
            "NUDGE_KEYS",
            "NUDGE_TLS_CERT",
            "NUDGE_TLS_KEY",
            "NUDGE_TLS_CLIENT_CA",
            "NUDGE_DATA",
            "NUDGE_LISTEN",
            "NUDGE_HOSTS",
            "NUDGE_CORS_ORIGINS",
            "NUDGE_MAX_CELLS",
            "NUDGE_LOG",
            "NUDGE_INSECURE",
            "NUDGE_FIT_EVERY",
        ] {
            cases.push((print.to_vec(), vec![(variable, secret)]));
        }
        cases.push((serve.to_vec(), vec![("NUDGE_KEYS", secret)]));
        cases.push((
            serve.to_vec(),
            vec![("NUDGE_TLS_KEY", secret), ("NUDGE_TLS_CERT", "tls.crt")],
        ));
        cases.push((
            serve.to_vec(),
            vec![("NUDGE_TLS_KEY", secret), ("NUDGE_TLS_CERT", secret)],
        ));
        for flag in [
            "--keys",
            "--tls-key",
            "--listen",
            "--hosts",
            "--max-cells",
            "--log",
        ] {
            cases.push(([&print[..], &[flag, secret]].concat(), vec![]));
        }
        let scope = ["key", "new", "game", "--scope", "read"];
        cases.push((vec!["key", "new", secret, "--scope", "read"], vec![]));
        cases.push((vec!["key", "new", "game", "--scope", secret], vec![]));
        for flag in ["--rate", "--environments"] {
            cases.push(([&scope[..], &[flag, secret]].concat(), vec![]));
        }
        cases.push((vec!["serve", secret], vec![]));
        cases.push((vec![secret], vec![]));
        for flag in ["--api-key-file", "--server", "--ca"] {
            cases.push((vec!["env", "list", flag, secret], vec![]));
        }
    }
    for (arguments, variables) in cases {
        let (code, told) = telling(&arguments, &variables);
        let shown: Vec<_> = arguments
            .iter()
            .map(|argument| &argument[..argument.len().min(16)])
            .collect();
        let case = format!(
            "{shown:?} {:?}",
            variables.iter().map(|(name, _)| name).collect::<Vec<_>>()
        );
        assert!(
            code == Some(2) || code == Some(0),
            "{case}: {code:?} {told}"
        );
        assert!(!told.contains(&key[6..22]), "{case}: {told}");
        assert!(
            inside.iter().all(|line| !told.contains(&line[..16])),
            "{case}: {told}"
        );
    }
}

#[test]
fn a_pipe_is_no_file() {
    let directory = TempDir::new().expect("a temporary directory");
    let data = directory
        .path()
        .join("data")
        .to_str()
        .expect("text")
        .to_owned();
    let fifo = directory
        .path()
        .join("fifo")
        .to_str()
        .expect("text")
        .to_owned();
    assert!(
        Command::new("mkfifo")
            .arg(&fifo)
            .status()
            .expect("mkfifo is there")
            .success()
    );
    let serve = ["serve", "--listen", "127.0.0.1:0", "--data", &data];
    for arguments in [
        [&serve[..], &["--keys", &fifo]].concat(),
        [&serve[..], &["--tls-cert", &fifo, "--tls-key", &fifo]].concat(),
        vec!["key", "new", "game", "--scope", "read", "--append", &fifo],
        vec!["env", "list", "--api-key-file", &fifo],
        vec![
            "env",
            "list",
            "--server",
            "https://localhost:1",
            "--ca",
            &fifo,
        ],
        vec!["env", "list", "--api-key-file", "/dev/zero"],
        vec![
            "key",
            "new",
            "game",
            "--scope",
            "read",
            "--append",
            "/dev/null",
        ],
        [
            &serve[..],
            &["--keys", directory.path().to_str().expect("text")],
        ]
        .concat(),
    ] {
        let (code, told) = telling(&arguments, &[]);
        assert_eq!(code, Some(2), "{arguments:?}: {told}");
        assert!(told.contains("expected"), "{arguments:?}: {told}");
    }
}

#[test]
fn a_keys_file_that_ends_within_a_line_lets_nobody_in() {
    let directory = TempDir::new().expect("a temporary directory");
    let data = directory
        .path()
        .join("data")
        .to_str()
        .expect("text")
        .to_owned();
    let file = directory
        .path()
        .join("keys")
        .to_str()
        .expect("text")
        .to_owned();
    let digest = nudge::access::generate().expect("randomness").digest();
    std::fs::write(&file, format!("# keys\ngame {digest} read")).expect("written");
    let new = ["key", "new", "game", "--scope", "read", "--append", &file];
    for arguments in [
        &[
            "serve",
            "--listen",
            "127.0.0.1:0",
            "--data",
            &data,
            "--keys",
            &file,
        ][..],
        &new,
    ] {
        let (code, told) = telling(arguments, &[]);
        assert!(
            code == Some(2) && told.contains("line 2: got no end of the line"),
            "{arguments:?}: {told}"
        );
    }
    std::fs::write(&file, format!("# keys\ngame {digest} read\n")).expect("written");
    assert_eq!(telling(&new, &[]).0, Some(0));
    assert!(
        std::fs::read_to_string(&file)
            .expect("there")
            .ends_with('\n')
    );
}

#[test]
fn what_is_open_to_others_is_warned_of() {
    use std::os::unix::fs::PermissionsExt;

    let directory = TempDir::new().expect("a temporary directory");
    let (data, log) = (directory.path().join("data"), directory.path().join("log"));
    let logged = |listen: &str, keys: Option<u32>, insecure: Option<&str>| {
        let mut command = Server::command(&data, listen);
        if let Some(mode) = keys {
            let path = directory.path().join("keys");
            std::fs::write(&path, "").expect("written");
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode))
                .expect("its owner's");
            command.arg("--keys").arg(path);
        }
        command.envs(insecure.map(|value| ("NUDGE_INSECURE", value)));
        Server::run(command.stderr(std::fs::File::create(&log).expect("made")))
            .expect("it begins")
            .terminate();
        std::fs::read_to_string(&log).expect("there")
    };
    for yes in ["1", "true", "yes", "on"] {
        assert!(
            logged("0.0.0.0:0", None, Some(yes)).contains("--insecure"),
            "{yes}"
        );
    }
    assert!(
        !logged("127.0.0.1:0", None, Some("1")).contains("--insecure"),
        "nobody else reaches it"
    );
    for (mode, is_open) in [
        (0o600, false),
        (0o640, false),
        (0o644, true),
        (0o660, true),
        (0o602, true),
    ] {
        let log = logged("127.0.0.1:0", Some(mode), Some("0"));
        assert_eq!(
            log.contains("others may read or write the keys file"),
            is_open,
            "{mode:o}: {log}"
        );
    }
}
