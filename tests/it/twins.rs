//! Surrogate data: what is found in play is not found in its twins, in which nobody answers anybody;
//! and a follower that was planted is found where it was, and in its twin not at all.

use std::path::Path;

use nudge::client::{Connection, Step, Track, twins};
use nudge::domain::Schema;
use nudge::domain::draft::DescriptionDraft;
use nudge::recordings::overcooked;
use nudge::simulation::follower;
use serde_json::Value;

use crate::lags::run;
use crate::support::TestApp;

/// Half a null band in standard deviations.
const BAND: f64 = 1.96;

const BOTH: [[&str; 2]; 2] = [["player_0", "player_1"], ["player_1", "player_0"]];

async fn profile(app: &TestApp, environment: &str, [ego, other]: [&str; 2], more: &str) -> Value {
    let path = format!("/v1/environments/{environment}/profile?ego={ego}&other={other}{more}");
    app.get(&path).await
}

/// Returns the excess of each lag in standard deviations.
fn deviations(profile: &Value) -> Vec<f64> {
    let points = profile["profile"].as_array().expect("points").iter();
    let z = |point: &Value| {
        let [excess, band] = [&point["excess"], &point["null"][1]];
        BAND * excess.as_f64().expect("a number") / band.as_f64().expect("a number")
    };
    points.map(z).collect()
}

/// Writes the games of the layout in which one player must wait for the other.
fn written(directory: &Path) -> String {
    let mut games = String::new();
    for (_, bytes) in overcooked::embedded() {
        let text = overcooked::decompressed(bytes).expect("gzip");
        let text = std::str::from_utf8(&text).expect("text");
        let is_wanted = |line: &&str| line.starts_with("forced_coordination,");
        let head = text.lines().take(usize::from(games.is_empty()));
        for line in head.chain(text.lines().filter(is_wanted)) {
            games += line;
            games.push('\n');
        }
    }
    let file = directory.join("games.csv");
    std::fs::write(&file, games).expect("written");
    file.to_str().expect("UTF-8").to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_found_in_play_is_not_found_in_its_twins() {
    let app = TestApp::start().await;
    let directory = tempfile::tempdir().expect("a directory");
    let file = written(directory.path());
    let ingest = async |more: &[&str]| {
        let sent = ["ingest", "--format", "overcooked", &file];
        let (code, told, stderr) = run(&app, &[&sent[..], more].concat()).await;
        assert_eq!(code, 0, "{stderr}");
        assert!(told.contains("14,375"), "{told}");
    };

    ingest(&[]).await;
    let found = profile(&app, "forced_coordination", BOTH[1], "").await;
    assert_eq!(found["peak"], 6);

    ingest(&["--twin", "shuffled"]).await;
    for pair in BOTH {
        let twin = profile(&app, "forced_coordination.shuffled", pair, "").await;
        assert_eq!(twin["peak"], Value::Null, "{twin}");
        let z = deviations(&twin);
        assert!(z.len() == 13 && z.iter().all(|z| z.abs() < 3.0), "{z:?}");
    }

    // Over 80 shifts of either player z was -.2 to .5 on average at each of these lags, sd .9 to 1.1.
    let mut all = Vec::new();
    for seed in 1..=6 {
        ingest(&["--twin", "shifted", "--seed", &seed.to_string()]).await;
        let name = format!("forced_coordination.shifted-{seed}");
        for pair in BOTH {
            all.extend(deviations(&profile(&app, &name, pair, "&lags=4,5,6").await));
        }
    }
    let count = all.len() as f64;
    let mean = all.iter().sum::<f64>() / count;
    let variance = all.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / count;
    assert!(all.iter().all(|z| z.abs() < 3.3), "{all:?}");
    assert!(mean.abs() < 0.6, "{mean}: {all:?}");
    assert!((0.6..1.5).contains(&variance.sqrt()), "{variance}: {all:?}");
}

/// Sends the games of the planted follower, changed in some way.
async fn send(app: &TestApp, environment: &str, change: impl Fn(&Schema, Vec<Step>) -> Vec<Step>) {
    let connection = Connection::open(&app.address.to_string())
        .await
        .expect("connected");
    let lags: Vec<u32> = (1..=4).collect();
    let description = DescriptionDraft::from(follower::description(&lags));
    connection
        .apply(environment, description)
        .await
        .expect("made");

    let producer = connection.producer(environment, "games");
    let mut producer = producer.open().await.expect("opened");
    for (number, game) in follower::games(1).into_iter().enumerate() {
        let segment = format!("game-{number}");
        producer.segment(Some(&segment)).await.expect("named");
        let mut track = Track::new(producer.schema());
        let schema = producer.schema().clone();
        for step in change(&schema, game) {
            if let Some(transition) = track.step(step) {
                producer.send(transition).await.expect("sent");
            }
        }
        for transition in track.end() {
            producer.send(transition).await.expect("sent");
        }
    }
    producer.close().await.expect("counted");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_planted_follower_is_found_where_it_is_and_not_in_its_twin() {
    let app = TestApp::start().await;
    send(&app, "follower", |_, game| game).await;
    send(&app, "twin", |schema, game| {
        twins::shuffled(schema, &game, 7)
    })
    .await;

    let there = ["leader", "follower"];
    let back = ["follower", "leader"];
    let peak = async |environment: &str, pair, more: &str| {
        profile(&app, environment, pair, more).await["peak"].clone()
    };
    assert_eq!(peak("follower", there, "").await, follower::LAG);
    assert_eq!(peak("follower", back, "").await, Value::Null);
    for pair in [there, back] {
        assert_eq!(peak("twin", pair, "").await, Value::Null);
    }

    let [near, far] = [
        format!("&region.distance=..{}", follower::NEAR),
        format!("&region.distance={}..", follower::NEAR + 1),
    ];
    assert_eq!(peak("follower", there, &near).await, follower::LAG);
    assert_eq!(peak("follower", there, &far).await, Value::Null);
}
