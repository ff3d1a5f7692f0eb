//! Leaders and followers (transfer entropy, Schreiber 2000): tracks of two agents, one of which may
//! copy the other some steps later, and counts of their steps at any lag.
//!
//! In the states that are *near* the follower copies; in the others it acts by its habits, as the
//! leader does everywhere. Agents may hold their actions. States come and go by themselves: they
//! are no common cause.
//!
//! The truth of a lag k is I(ego now; other k later | state, other's own action at k - 1), which
//! [`Counted`] has tables of. Where neither agent holds its actions it is 0 but for the leader's
//! influence at the planted lag. Where the leader holds them, what it did a step earlier or later
//! is mostly the same, and neighbouring lags truly depend, less than the planted one. The follower
//! never influences the leader.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::joint::dirichlet;

mod catalogue;
mod counted;
#[cfg(test)]
mod tests;

pub use catalogue::WORLDS;
pub use counted::{Asked, Counted, Draws};

/// How long agents go on with an action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// Each step is a choice.
    Free,
    /// An action is kept for so many steps, by a clock of the agent's own.
    Steps(u32),
    /// An action is kept from one step to the next so many times in a hundred.
    Kept(u32),
}

/// A kind of world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct World {
    /// Its name.
    pub name: &'static str,
    /// After how many steps the follower copies; `None` where it never does.
    pub lag: Option<usize>,
    /// How long both hold their actions.
    pub hold: Hold,
    /// How many states a track comes by, over and over, leaving each at once; all of them, by
    /// [`Options::left`], where it is not told.
    pub roams: Option<usize>,
    /// Whether the follower's actions are those of another track, so that nothing is left to find.
    pub shuffled: bool,
}

impl World {
    /// Returns whether the leader has any influence, at any lag.
    pub fn is_dependent(&self) -> bool {
        self.lag.is_some() && !self.shuffled
    }
}

/// What to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Actions of each agent.
    pub letters: usize,
    /// How many states.
    pub states: usize,
    /// How many of them are near: those before the others.
    pub near: usize,
    /// How often a choice of the follower copies in a near state.
    pub copied: f64,
    /// How often a state is left from one step to the next.
    pub left: f64,
    /// Steps of a track.
    pub steps: usize,
    /// The same seed gives the same tracks.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            letters: 4,
            states: 40,
            near: 20,
            copied: 1.0,
            left: 0.5,
            steps: 100,
            seed: 1,
        }
    }
}

/// One step of a track.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// The state, of which those below [`Options::near`] are near.
    pub state: usize,
    /// What the leader and the follower do.
    pub actions: [u64; 2],
}

/// Draws tracks without end.
pub struct Tracks {
    world: World,
    options: Options,
    habits: [Vec<f64>; 2],
    rng: Pcg64,
    /// The follower's actions in the track before.
    before: Vec<u64>,
}

impl Tracks {
    /// Begins a world, whose agents have habits of their own.
    pub fn new(world: World, options: Options) -> Self {
        let mut rng = Pcg64::seed_from_u64(options.seed);
        let habits = [(); 2].map(|()| dirichlet(3.0, options.letters, &mut rng));
        let mut tracks = Self {
            world,
            options,
            habits,
            rng,
            before: Vec::new(),
        };
        if world.shuffled {
            tracks.next();
        }
        tracks
    }
}

impl Iterator for Tracks {
    type Item = Vec<Step>;

    fn next(&mut self) -> Option<Vec<Step>> {
        let Options { near, copied, .. } = self.options;
        let states = self.states();
        let leader = self.choices(0, |_, _| None);
        let follower = match self.world.lag {
            None => self.choices(1, |_, _| None),
            Some(lag) => self.choices(1, |at, rng| {
                let seen = at.checked_sub(lag)?;
                let copies = states[seen] < near && rng.random_bool(copied);
                copies.then(|| leader[seen])
            }),
        };

        let follower = if self.world.shuffled {
            std::mem::replace(&mut self.before, follower)
        } else {
            follower
        };
        let step = |((state, leader), follower)| Step {
            state,
            actions: [leader, follower],
        };
        Some(
            states
                .into_iter()
                .zip(leader)
                .zip(follower)
                .map(step)
                .collect(),
        )
    }
}

impl Tracks {
    fn states(&mut self) -> Vec<usize> {
        let Options {
            states,
            left,
            steps,
            ..
        } = self.options;
        let roams = self.world.roams.unwrap_or(states);
        let first = self.rng.random_range(0..states.div_ceil(roams)) * roams;
        let places = roams.min(states - first);
        let leaves_at_once = self.world.roams.is_some() && places > 1;

        let mut place = self.rng.random_range(0..places);
        let mut next = || {
            let now = first + place;
            if leaves_at_once {
                place = (place + self.rng.random_range(1..places)) % places;
            } else if self.rng.random_bool(left) {
                place = self.rng.random_range(0..places);
            }
            now
        };
        (0..steps).map(|_| next()).collect()
    }

    /// Draws what an agent does: each choice is a copy, where `copy` has one, or of its habits.
    fn choices(
        &mut self,
        agent: usize,
        copy: impl Fn(usize, &mut Pcg64) -> Option<u64>,
    ) -> Vec<u64> {
        let (hold, rng) = (self.world.hold, &mut self.rng);
        let clock = match hold {
            Hold::Steps(steps) => rng.random_range(0..steps) as usize,
            _ => 0,
        };

        let mut actions = Vec::with_capacity(self.options.steps);
        for at in 0..self.options.steps {
            let held = match hold {
                Hold::Free => false,
                Hold::Steps(steps) => !(at + clock).is_multiple_of(steps as usize),
                Hold::Kept(percent) => rng.random_bool(f64::from(percent) / 100.0),
            };
            let action = match actions.last() {
                Some(last) if held => *last,
                _ => copy(at, rng).unwrap_or_else(|| letter(&self.habits[agent], rng)),
            };
            actions.push(action);
        }
        actions
    }
}

fn letter(habit: &[f64], rng: &mut Pcg64) -> u64 {
    let mut point = rng.random::<f64>();
    let drawn = habit.iter().position(|share| {
        point -= share;
        point < 0.0
    });
    // What rounding left.
    drawn.unwrap_or(habit.len() - 1) as u64
}
