//! Recorded trajectories: the states that people were in, in which order, and what they did where
//! they stood.

use std::collections::HashMap;

use super::Layout;
use super::policy::Habits;
use crate::domain::SchemaDraft;
use crate::recordings::overcooked::{Game, Kitchen, Player, Step, World, embedded, read_games};

/// A state in which people were.
#[derive(Debug, Clone, PartialEq)]
pub struct Situation {
    /// As an environment takes it.
    pub values: Vec<f32>,
    /// Where the players are and what they hold.
    pub players: [Player; 2],
}

/// The visits of a layout.
pub struct Visits {
    /// How its states and actions are described.
    pub schema: SchemaDraft,
    /// Each state once, in the order of the first visit.
    pub situations: Vec<Situation>,
    /// The states of the training games, step after step.
    pub train: Vec<usize>,
    /// The states of the test games, step after step.
    pub test: Vec<usize>,
    /// What each player does where they stand, in all games.
    pub habits: [Habits; 2],
}

impl Visits {
    /// Reads the games of a layout that come with the program.
    pub fn of_layout(layout: Layout) -> Self {
        let kitchen = Kitchen::named(layout.as_str()).expect("a layout of the recordings");
        let world = World::new(kitchen, layout.abstraction());
        let [train, test] = embedded().map(|(_, games)| steps(games, layout));
        let habits = [0, 1].map(|player| {
            Habits::of_steps(
                train
                    .iter()
                    .chain(&test)
                    .map(|step| (step.players[player], step.actions[player])),
            )
        });

        let mut seen = Seen {
            world: &world,
            places: HashMap::new(),
            situations: Vec::new(),
        };

        let [train, test] =
            [train, test].map(|steps| steps.iter().map(|step| seen.place(step)).collect());

        Self {
            schema: world.description(),
            situations: seen.situations,
            train,
            test,
            habits,
        }
    }
}

fn steps(games: &[u8], layout: Layout) -> Vec<Step> {
    let games: Vec<Game> =
        read_games(games).expect("it comes with the program, and a test reads it");
    games
        .into_iter()
        .filter(|game| game.layout == layout.as_str())
        .flat_map(|game| game.steps)
        .collect()
}

/// The states seen so far, each with its place among them.
struct Seen<'a> {
    world: &'a World,
    places: HashMap<Vec<u32>, usize>,
    situations: Vec<Situation>,
}

impl Seen<'_> {
    fn place(&mut self, step: &Step) -> usize {
        let (values, _) = self.world.values(step);
        let labels = values.iter().map(|value| *value as u32).collect();
        *self.places.entry(labels).or_insert_with(|| {
            self.situations.push(Situation {
                values,
                players: step.players,
            });
            self.situations.len() - 1
        })
    }
}
