//! The simulated hallway as a game server: what the service counts is what the library computes,
//! whatever breaks in between.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use nudge::api::json::description_of_text;
use nudge::api::proto;
use nudge::api::proto::influence_service_client::InfluenceServiceClient;
use nudge::domain::{Entry, Schema};
use nudge::simulation::hallway::{Hallway, Protocol};
use nudge::simulation::observation::{DESCRIPTION, Observation, Observations};
use serde_json::Value;
use tempfile::TempDir;

use crate::cli::{exit_and_texts, nudge, output};
use crate::fake::{CALM, Fake};
use crate::server::Server;
use crate::support::{TestApp, channel};

/// Begins a simulation that is asked about in one tick alone.
const WITHOUT_LAGS: [&str; 4] = ["simulate", "hallway", "--lags", "none"];

/// Visits and entries by state, segment and actions.
type Cells = BTreeMap<(String, String, Vec<u64>), (u64, u64)>;

async fn simulate(address: &str, options: &[&str]) -> (i32, String, String) {
    exit_and_texts(&output(nudge(address, &[&WITHOUT_LAGS[..], options].concat())).await)
}

fn start(address: &str, options: &[&str]) -> Child {
    let mut command = nudge(address, &[&WITHOUT_LAGS[..], options].concat());
    command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts")
}

fn schema() -> Schema {
    let description = description_of_text(DESCRIPTION).expect("JSON");
    let (draft, rule) = (description.schema, description.rule);
    assert_eq!(rule, None, "the service's default");
    Schema::try_from(&draft).expect("sound")
}

fn observations(protocol: &Protocol, trial: u32) -> Vec<Observation> {
    let hallway = Hallway::try_from(protocol.clone()).expect("sound");
    Observations::of_trial(hallway.trial(trial).expect("there is room"), &schema())
        .flatten()
        .collect()
}

/// What the service should count.
fn expected(protocol: &Protocol) -> Cells {
    let schema = schema();
    let mut cells = Cells::new();
    for trial in 1..=protocol.trials {
        for observation in observations(protocol, trial) {
            let transition = observation.transition;
            let key = schema
                .key_of_values(&transition.state)
                .expect("finite")
                .to_string();
            let actions =
                schema.actions_of(schema.joint_action(&transition.actions).expect("finite"));
            let (n, entries) = cells
                .entry((
                    key,
                    format!("seed-{}.trial-{trial}", protocol.seed),
                    actions,
                ))
                .or_default();
            *n += 1;
            *entries += u64::from(transition.entry == Entry::Entered);
        }
    }
    cells
}

fn visits(cells: &Cells) -> u64 {
    cells.values().map(|(n, _)| n).sum()
}

async fn influence(address: SocketAddr) -> InfluenceServiceClient<tonic::transport::Channel> {
    InfluenceServiceClient::new(channel(address).await.expect("the service listens"))
}

/// How many transitions the service holds; none before there is an environment.
async fn transitions(address: SocketAddr) -> u64 {
    // The revision of any state, which costs the service less than a summary would.
    let request = proto::GetStateRequest {
        environment: "hallway".into(),
        key: "0.0.0.0.0.0".into(),
    };
    influence(address)
        .await
        .get_state(request)
        .await
        .map_or(0, |state| state.into_inner().revision)
}

/// Compares every count: each expected cell is there, and together they are all there is.
async fn assert_counted(address: SocketAddr, expected: &Cells) {
    let mut client = influence(address).await;
    let mut counted = Cells::new();
    let keys: BTreeSet<&String> = expected.keys().map(|(key, ..)| key).collect();
    for key in keys {
        let request = proto::GetStateRequest {
            environment: "hallway".into(),
            key: key.clone(),
        };
        for cell in client
            .get_state(request)
            .await
            .expect("a valid key")
            .into_inner()
            .cells
        {
            counted.insert(
                (key.clone(), cell.segment, cell.actions),
                (cell.n, cell.entries.expect("all were flagged")),
            );
        }
    }
    assert!(
        counted == *expected,
        "{} counted, {} expected",
        visits(&counted),
        visits(expected)
    );
    assert_eq!(transitions(address).await, visits(expected));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_second_run_changes_nothing_and_more_trials_go_on_behind_it() {
    let app = TestApp::start().await;
    let address = app.address.to_string();
    let cells = expected(&Protocol {
        trials: 4,
        ..Protocol::default()
    });
    let (code, stdout, stderr) = simulate(&address, &["--trials", "4"]).await;
    assert_eq!((code, stderr.lines().count()), (0, 1), "{stderr}");
    assert!(
        stdout.contains("environment  transitions  accepted  resumed  rejected"),
        "{stdout}"
    );
    assert_counted(app.address, &cells).await;
    let all = visits(&cells);
    for (trials, resumed) in [
        ("4", all),
        (
            "2",
            visits(&expected(&Protocol {
                trials: 2,
                ..Protocol::default()
            })),
        ),
    ] {
        let (code, stdout, _) = simulate(&address, &["--trials", trials, "--json"]).await;
        let report: Value = serde_json::from_str(&stdout).expect("JSON");
        let hallway = &report["environments"][0];
        assert_eq!(
            (code, &hallway["resumed"], &hallway["accepted"]),
            (0, &resumed.into(), &0.into())
        );
    }
    simulate(&address, &["--trials", "5"]).await;
    assert_counted(
        app.address,
        &expected(&Protocol {
            trials: 5,
            ..Protocol::default()
        }),
    )
    .await;
    simulate(&address, &["--trials", "1", "--seed", "1"]).await;
    assert!(
        transitions(app.address).await > all,
        "another seed is another producer"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn kills_of_the_service_lose_and_double_nothing() {
    const KILLS: u32 = 5;
    let protocol = Protocol {
        trials: 80,
        ..Protocol::default()
    };
    let directory = TempDir::new().expect("a temporary directory");
    let mut server = Server::start(directory.path(), "127.0.0.1:0");
    let address = server.address;
    let mut run = start(&address.to_string(), &["--trials", "80"]);
    for _ in 0..KILLS {
        let before = transitions(address).await;
        while transitions(address).await == before {
            assert!(
                run.try_wait().expect("started").is_none(),
                "a kill counts only under load"
            );
        }
        server.kill();
        server = Server::start(directory.path(), &address.to_string());
    }
    let (code, _, stderr) = finish(run).await;
    assert_eq!(code, 0, "{stderr}");
    assert_counted(address, &expected(&protocol)).await;
    server.kill();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_interrupted_run_goes_on_where_it_stopped() {
    let protocol = Protocol {
        trials: 40,
        ..Protocol::default()
    };
    let app = TestApp::start().await;
    let address = app.address.to_string();
    let mut run = start(&address, &["--trials", "40"]);
    while transitions(app.address).await == 0 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    run.kill().expect("it runs");
    run.wait().expect("killed");
    let before = transitions(app.address).await;
    let cells = expected(&protocol);
    let (code, stdout, _) = simulate(&address, &["--trials", "40", "--json"]).await;
    let report: Value = serde_json::from_str(&stdout).expect("JSON");
    let resumed = report["environments"][0]["resumed"]
        .as_u64()
        .expect("a number");
    // What was on its way when the run was killed may have been counted after it.
    assert!(
        code == 0 && resumed >= before && resumed < visits(&cells),
        "{before} counted, {resumed} resumed"
    );
    assert_counted(app.address, &cells).await;
    app.stop().await;
}

async fn finish(run: Child) -> (i32, String, String) {
    let output = tokio::task::spawn_blocking(|| run.wait_with_output())
        .await
        .expect("no panic")
        .expect("it ends");
    exit_and_texts(&output)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rest_takes_the_lines_and_counts_what_the_stream_counts() {
    const MOST_LINES: usize = 10_000;
    let directory = TempDir::new().expect("a temporary directory");
    let file = directory.path().join("hallway.ndjson");
    let options = [
        "--trials",
        "3",
        "--scenario",
        "crossing",
        "--out",
        file.to_str().expect("text"),
    ];
    assert_eq!(
        simulate("127.0.0.1:1", &options).await,
        (0, String::new(), String::new()),
        "no service is needed"
    );
    let text = std::fs::read_to_string(file).expect("written");
    let app = TestApp::start().await;
    let description: Value = serde_json::from_str(DESCRIPTION).expect("JSON");
    assert_eq!(
        app.rest("PUT", "/v1/environments/hallway", Some(&description))
            .await
            .0,
        201
    );
    for (sequence, lines) in (1..).zip(text.lines().collect::<Vec<_>>().chunks(MOST_LINES)) {
        let path =
            format!("/v1/environments/hallway/transitions?producer=curl&sequence={sequence}");
        let request = reqwest::Client::new()
            .post(app.url(&path))
            .header("content-type", "application/x-ndjson");
        let answer = request
            .body(lines.join("\n"))
            .send()
            .await
            .expect("answered")
            .text()
            .await
            .expect("text");
        let receipt: Value = serde_json::from_str(&answer).expect("JSON");
        assert_eq!(
            (&receipt["accepted"], &receipt["rejected_count"]),
            (&lines.len().into(), &0.into()),
            "{receipt}"
        );
    }
    let protocol = Protocol {
        trials: 3,
        scenario: "crossing".parse().expect("a scenario"),
        ..Protocol::default()
    };
    let mut cells = Cells::new();
    for ((key, _, actions), (n, entries)) in expected(&protocol) {
        let cell = cells.entry((key, String::new(), actions)).or_default();
        *cell = (cell.0 + n, cell.1 + entries);
    }
    assert_counted(app.address, &cells).await;
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_threads_of_a_large_crowd_do_not_change_a_byte() {
    let lines = async |threads: &str, seed: &str| {
        let crowd = [
            "--pedestrians",
            "200",
            "--length",
            "100",
            "--start-zone",
            "40",
            "--longest-trial",
            "4",
        ];
        let options = ["--trials", "2", "--seed", seed, "--out", "-"];
        let mut command = nudge(
            "127.0.0.1:1",
            &[&WITHOUT_LAGS[..], &crowd[..], &options[..]].concat(),
        );
        command.env("RAYON_NUM_THREADS", threads);
        output(command).await.stdout
    };
    let one = lines("1", "7").await;
    assert!(!one.is_empty() && one == lines("4", "7").await);
    assert!(one != lines("1", "8").await);
}

/// The batches that a service committed: sequence, segment and length.
fn batches(fake: &Fake) -> Vec<(u64, String, usize)> {
    fake.memory()
        .batches
        .iter()
        .map(|(_, sequence, segment, len)| (*sequence, segment.clone(), *len))
        .collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn real_time_follows_the_clock_and_cuts_as_fast_does() {
    let options = ["--trials", "2", "--longest-trial", "1.4"];
    let (slow, fast) = (Fake::start(CALM, 0).await, Fake::start(CALM, 0).await);
    let (slowly, quickly) = (slow.address.to_string(), fast.address.to_string());
    let real_time = [&options[..], &["--pace", "real-time"]].concat();
    let began = Instant::now();
    simulate(&slowly, &real_time).await;
    assert!(
        began.elapsed() >= Duration::from_millis(2_800),
        "two trials of 1.4 s"
    );
    simulate(&quickly, &options).await;
    let lengths: Vec<(u64, String, usize)> = [
        (1, "seed-0.trial-1", 100),
        (2, "seed-0.trial-1", 40),
        (3, "seed-0.trial-2", 100),
        (4, "seed-0.trial-2", 40),
    ]
    .map(|(sequence, segment, len)| (sequence, segment.to_owned(), len))
    .to_vec();
    assert_eq!(
        (batches(&slow), batches(&fast)),
        (lengths.clone(), lengths),
        "a batch a second and a trial"
    );
    let began = Instant::now();
    simulate(&quickly, &real_time).await;
    assert!(
        began.elapsed() < Duration::from_millis(2_800),
        "what was committed is passed over without waiting"
    );
    assert_eq!(batches(&fast).len(), 4);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn wrong_values_are_told_by_flag_one_a_line() {
    let cases: [(&[&str], &[&str]); 4] = [
        (
            &["--dt", "-1", "--noise", "NaN", "--width", "inf"],
            &[
                "--width: got inf, expected",
                "--dt: got -1, expected a number from",
                "--noise: got NaN, expected",
            ],
        ),
        (
            &["--pedestrians", "500"],
            &["--pedestrians: got 500, expected at most about "],
        ),
        (
            &["--record-interval", "0.12"],
            &["--record-interval: got 0.12, expected a whole multiple of dt"],
        ),
        (
            &["--svg", "/tmp/never.svg", "--at", "99"],
            &["--at: got 99, expected a time within the trial"],
        ),
    ];
    for (options, expected) in cases {
        let (code, stdout, stderr) = simulate("127.0.0.1:1", options).await;
        let lines: Vec<&str> = stderr.lines().skip(1).map(str::trim).collect();
        assert_eq!(
            (code, stdout.as_str(), lines.len()),
            (2, "", expected.len()),
            "{stderr}"
        );
        assert!(
            lines
                .iter()
                .zip(expected)
                .all(|(line, expected)| line.starts_with(expected)),
            "{stderr}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_environment_of_another_kind_is_left_alone() {
    let app = TestApp::start().await;
    app.lane().await;
    let (code, _, stderr) = simulate(&app.address.to_string(), &["--environment", "lane"]).await;
    assert_eq!(code, 1, "{stderr}");
    assert!(
        stderr.starts_with("error: environment `lane`") && stderr.lines().count() == 1,
        "{stderr}"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_trial_is_drawn_to_a_file() {
    let directory = TempDir::new().expect("a temporary directory");
    let file = directory.path().join("trial.svg");
    let options = [
        "--svg",
        file.to_str().expect("text"),
        "--trial",
        "3",
        "--at",
        "5",
    ];
    assert_eq!(simulate("127.0.0.1:1", &options).await.0, 0);
    let svg = std::fs::read_to_string(file).expect("written");
    assert!(svg.contains("seed 0, trial 3 at 5.0 s"), "{svg}");
}
