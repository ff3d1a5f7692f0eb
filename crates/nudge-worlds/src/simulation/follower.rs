//! A follower that is planted, with all that hides it: two walkers in a street, one of whom often
//! does what the other did two steps earlier, but only near it, while the weather and the hour
//! change what nobody does.
//!
//! What is to be found is known: [`LAG`], from `leader` to `follower`, where `distance` is at most
//! [`NEAR`]; nothing in the other direction, and nothing else.

use nudge_core::domain::SchemaDraft;
use nudge_core::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
use nudge_core::tracks::Step;

use super::planted::lagged::{Hold, Options, Tracks, World};

/// After how many steps the follower does what the leader did.
pub const LAG: u32 = 2;

/// The distance, in places, up to which it follows.
pub const NEAR: u32 = 1;

/// How often it does there.
const COPIED: f64 = 0.5;

const DISTANCES: usize = 6;
const WEATHER: [&str; 3] = ["sun", "rain", "snow"];
const HOURS: [&str; 4] = ["morning", "noon", "evening", "night"];
const MOVES: [&str; 4] = ["north", "south", "east", "west"];

/// Games, and steps of each: few and long, so that a state is met some times in each.
const GAMES: usize = 6;
const STEPS: usize = 2_000;

/// Returns the description of the environment, with what both do at these lags.
pub fn description(lags: &[u32]) -> SchemaDraft {
    let categorical = |name: &str, labels: &[&str]| FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![KindDraft::Categorical(
            labels.iter().map(|label| (*label).into()).collect(),
        )],
    };
    let distance = FeatureDraft {
        name: "distance".into(),
        unit: None,
        kinds: vec![KindDraft::Integer(0, DISTANCES as i64 - 1)],
    };
    let agent = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![categorical("move", &MOVES)],
        ..AgentDraft::default()
    };
    SchemaDraft {
        state: vec![
            distance,
            categorical("weather", &WEATHER),
            categorical("hour", &HOURS),
        ],
        agents: vec![agent("leader"), agent("follower")],
        lags: lags.iter().copied().map(i64::from).collect(),
        ..SchemaDraft::default()
    }
}

/// Returns all games, step by step, as that environment takes them. The same seed gives the same.
pub fn games(seed: u64) -> Vec<Vec<Step>> {
    let world = World {
        name: "follower",
        lag: Some(LAG as usize),
        hold: Hold::Free,
        roams: None,
        shuffled: false,
    };
    let others = WEATHER.len() * HOURS.len();
    let options = Options {
        letters: MOVES.len(),
        states: DISTANCES * others,
        near: (NEAR as usize + 1) * others,
        copied: COPIED,
        left: 0.5,
        steps: STEPS,
        seed,
    };
    let game = |game: Vec<_>| game.iter().map(step).collect();
    Tracks::new(world, options).take(GAMES).map(game).collect()
}

fn step(step: &super::planted::lagged::Step) -> Step {
    let hour = step.state % HOURS.len();
    let weather = step.state / HOURS.len() % WEATHER.len();
    let distance = step.state / HOURS.len() / WEATHER.len();
    let values = [distance, weather, hour].map(|value| value as f32);
    let actions = step.actions.map(|action| action as f32);
    Step::new(values.to_vec(), actions.to_vec())
}

#[cfg(test)]
mod tests {
    use nudge_core::domain::Schema;

    use super::*;

    #[test]
    fn the_follower_copies_near_the_leader_alone() {
        let schema = Schema::try_from(&description(&[1, LAG])).expect("valid");
        let (mut followed, mut steps) = ([0.0; 2], [0.0; 2]);
        for game in games(1) {
            assert!(
                game.iter()
                    .all(|step| schema.key_of_values(&step.state).is_ok())
            );
            for pair in game.windows(LAG as usize + 1) {
                let near = usize::from(pair[0].state[0] <= NEAR as f32);
                steps[near] += 1.0;
                followed[near] += f64::from(pair[0].actions[0] == pair[LAG as usize].actions[1]);
            }
        }
        let [far, near] = [0, 1].map(|near| followed[near] / steps[near]);
        assert!(near > far + 0.5 * COPIED, "{near} and {far}");
    }
}
