//! A game server that tells a Nudge service what happens in its games.
//!
//! ```text
//! cargo run --release -- serve &
//! cargo run -p nudge-client --example game_server -- 127.0.0.1:8080
//! ```
//!
//! The game: a robot walks a lane towards a human, who gives way to it when it comes near. The
//! service finds out that one acts upon the other, and in which states.

use std::process::ExitCode;

use nudge_client::domain::SchemaDraft;
use nudge_client::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
use nudge_client::{ClientError, Connection, Producer, Step};

const ENVIRONMENT: &str = "lane";

const GAMES: u32 = 200;

#[tokio::main]
async fn main() -> ExitCode {
    let address = std::env::args().nth(1);
    let address = address.as_deref().unwrap_or("127.0.0.1:8080");

    match play_all(address).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// Plays all games, and tells what became of their transitions.
async fn play_all(address: &str) -> Result<(), ClientError> {
    let connection = Connection::open(address).await?;
    connection.apply(ENVIRONMENT, &schema()).await?;

    // The id is this server's own. After a restart, numbering goes on where it was.
    let mut producer = connection
        .producer(ENVIRONMENT, "game-server-1")
        .open()
        .await?;
    for game in 0..GAMES {
        play(&mut producer, game).await?;
    }

    // Waits until everything is acknowledged, which is on stable storage then.
    let totals = producer.close().await?;
    println!("{} of {} transitions count", totals.accepted, totals.sent);
    for rejected in &totals.rejections {
        println!("{}: {}", rejected.field, rejected.reason);
    }
    Ok(())
}

/// Plays one game, a transition a tick.
async fn play(producer: &mut Producer, game: u32) -> Result<(), ClientError> {
    let mut dice = Dice(game);
    // Each game is an episode of its own: its first transition is an entry. The track fills in what
    // the human did one and two steps later, and holds back as many steps for it.
    let mut track = producer.track();
    for distance in (0..10).rev() {
        let robot = dice.roll(2);
        let human = if distance < 3 { robot } else { dice.roll(2) };
        // By position: the state's features, then each agent's; a label is its index.
        let step = Step::new(vec![distance as f32], vec![robot as f32, human as f32]);
        // A tick never waits for long: what finds no room is dropped, and counted.
        producer.step(&mut track, step).await?;
    }
    producer.end(track).await
}

/// Describes the game: what is seen of its state, and what each agent may do.
fn schema() -> SchemaDraft {
    let distance = FeatureDraft {
        name: "distance".into(),
        unit: Some("metres".into()),
        kinds: vec![KindDraft::Integer(0, 9)],
    };
    SchemaDraft {
        state: vec![distance],
        agents: vec![agent("robot"), agent("human")],
        lags: vec![1, 2],
        ..SchemaDraft::default()
    }
}

fn agent(name: &str) -> AgentDraft {
    let side = FeatureDraft {
        name: "side".into(),
        unit: None,
        kinds: vec![KindDraft::Categorical(vec!["left".into(), "right".into()])],
    };
    AgentDraft {
        name: name.into(),
        action: vec![side],
        ..AgentDraft::default()
    }
}

/// A linear congruential generator: the same games each time.
struct Dice(u32);

impl Dice {
    fn roll(&mut self, sides: u32) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 16) % sides
    }
}
