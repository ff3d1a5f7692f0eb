//! The binary as people meet it: what it prints, where, and its exit code.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use nudge::api::proto::BatchStatus;
use serde_json::Value;

use crate::fake::{CALM, Fake};

const TEST_GAMES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/data/overcooked/test.csv.gz");

pub fn nudge(address: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nudge"));
    command
        .args(arguments)
        .env("NUDGE_SERVER", address)
        .stdin(Stdio::null());
    command
}

async fn run(fake: &Fake, arguments: &[&str]) -> (i32, String, String) {
    exit_and_texts(&output(nudge(&fake.address.to_string(), arguments)).await)
}

/// Waits beside the runtime, on which the service runs.
pub async fn output(mut command: Command) -> Output {
    tokio::task::spawn_blocking(move || command.output())
        .await
        .expect("no panic")
        .expect("it starts")
}

pub fn exit_and_texts(output: &Output) -> (i32, String, String) {
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("text");
    (
        output.status.code().expect("not killed"),
        text(&output.stdout),
        text(&output.stderr),
    )
}

async fn ingest(fake: &Fake, file: &str, more: &[&str]) -> (i32, String, String) {
    run(
        fake,
        &[
            &["ingest", "--format", "overcooked", file, "--lags", "none"],
            more,
        ]
        .concat(),
    )
    .await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn recorded_games_count_once_however_often_they_are_sent() {
    let fake = Fake::start(CALM, 0).await;
    let (code, stdout, stderr) = ingest(&fake, TEST_GAMES, &[]).await;
    assert_eq!(code, 0, "{stderr}");
    insta::assert_snapshot!("first_run", stdout);
    assert_eq!(
        stderr.lines().count(),
        5,
        "plain lines in a pipe, one an environment: {stderr}"
    );
    let (code, stdout, _) = ingest(&fake, TEST_GAMES, &["--json"]).await;
    assert_eq!(code, 0);
    let report: Value = serde_json::from_str(&stdout).expect("JSON");
    let room = &report["environments"][3];
    assert_eq!(
        (&room["environment"], &room["resumed"], &room["accepted"]),
        (&"cramped_room".into(), &9_626.into(), &0.into())
    );
    let memory = fake.memory();
    assert_eq!(memory.values.len(), 44_373);
    assert!(
        memory
            .batches
            .iter()
            .all(|(_, _, segment, _)| segment.starts_with('w')),
        "a segment is a trial"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_was_not_counted_makes_the_command_fail() {
    let lines = [
        (
            BatchStatus::Rejected,
            "transitions were rejected, and of 16 batches all; the first in `cramped_room` is number 0",
        ),
        (
            BatchStatus::Unverified,
            "9,626 transitions in `cramped_room` are unverified: their numbers were used so long ago",
        ),
    ];
    for (status, line) in lines {
        let fake = Fake::start(CALM, 0).await;
        fake.memory().instead = Some(status);
        let (code, stdout, stderr) = ingest(&fake, TEST_GAMES, &["--json"]).await;
        assert_eq!(code, 1, "{stderr}");
        let report: Value = serde_json::from_str(&stdout).expect("JSON");
        let told = |name: &str| report["environments"][3][name].as_u64().expect("a number");
        let room = told("transitions");
        let (rejected, batches, unverified) = (
            told("rejected_count"),
            told("rejected_batches"),
            told("unverified"),
        );
        match status {
            BatchStatus::Rejected => assert!(
                (rejected, unverified) == (room, 0) && batches > 1,
                "{report}"
            ),
            _ => assert_eq!((rejected, batches, unverified), (0, 0, room), "{report}"),
        }
        assert!(
            stderr.lines().any(|one| one.contains(line)),
            "{line}: {stderr}"
        );
    }
}

#[tokio::test]
async fn abstractions_have_environments_of_their_own() {
    let fake = Fake::start(CALM, 0).await;
    let (code, _, stderr) = ingest(&fake, TEST_GAMES, &["--abstraction", "pos"]).await;
    assert_eq!(code, 0, "{stderr}");
    let (_, stdout, _) = run(&fake, &["env", "list"]).await;
    let rows: Vec<Vec<&str>> = stdout
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    assert_eq!(
        rows[3][..5],
        [
            "counter_circuit.pos",
            "2",
            "features",
            "player_0,",
            "player_1"
        ]
    );
    assert!(
        stdout.contains("evidence, above 0.5 nats at 0.8"),
        "{stdout}"
    );
    let (_, stdout, _) = run(&fake, &["env", "show", "counter_circuit.pos"]).await;
    assert!(stdout.contains("player_1.position"), "{stdout}");
}

#[tokio::test]
async fn a_mistake_gets_one_line_and_code_two() {
    let fake = Fake::start(CALM, 0).await;
    let bad = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(bad.path(), "layout,trial,t\n").expect("written");
    let bad = bad.path().to_str().expect("text");
    fake.describe("hallway", crate::support::lane_schema().into());
    let cases: [(&[&str], &str); 6] = [
        (
            &["ingest", "--format", "overcooked", "/no/such.csv"],
            "error: cannot read /no/such.csv: No such file",
        ),
        (
            &["ingest", "--format", "overcooked", bad],
            "line 1: column `state` is missing",
        ),
        (
            &["env", "delete", "hallway"],
            "for ever: add --yes to do it",
        ),
        (
            &["env", "apply", "/no/such.json"],
            "error: cannot read /no/such.json: No such file",
        ),
        (&["query", "hallway"], "error: no state: add --state"),
        (
            &["model", "import", "hallway", "/no/such.file"],
            "error: cannot read /no/such.file: No such file",
        ),
    ];
    for (arguments, expected) in cases {
        let (code, stdout, stderr) = run(&fake, arguments).await;
        assert_eq!(
            (code, stdout.as_str(), stderr.lines().count()),
            (2, "", 1),
            "{stderr}"
        );
        assert!(stderr.contains(expected), "{stderr}");
    }
}

#[tokio::test]
async fn an_absent_service_is_told_with_what_to_do() {
    let (code, _, stderr) = exit_and_texts(&output(nudge("127.0.0.1:1", &["env", "list"])).await);
    assert_eq!(code, 2);
    assert!(
        stderr.starts_with("error: nobody listens at http://127.0.0.1:1"),
        "{stderr}"
    );
    assert!(
        stderr.contains("start a service with `nudge serve`"),
        "{stderr}"
    );
}

#[tokio::test]
async fn a_refusal_of_the_service_is_code_one() {
    let fake = Fake::start(CALM, 0).await;
    for arguments in [
        ["env", "show", "hallway", "--json"],
        ["env", "delete", "hallway", "--yes"],
    ] {
        let (code, _, stderr) = run(&fake, &arguments).await;
        assert_eq!(
            (code, stderr.as_str()),
            (1, "error: unknown environment `hallway`\n")
        );
    }
}

#[tokio::test]
async fn a_closed_pipe_is_no_panic() {
    let fake = Fake::start(CALM, 0).await;
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let mut command = nudge(&fake.address.to_string(), &["env", "list"]);
    command.stdout(writer);
    let output = output(command).await;
    assert_eq!(
        (output.status.code(), exit_and_texts(&output).2.as_str()),
        (Some(0), "")
    );
}

#[test]
fn the_games_are_where_the_tests_look() {
    assert!(Path::new(TEST_GAMES).is_file());
}
