//! Policies: what a player does where they stand, fitted to what people did, then made varied
//! enough for its influence to show.

use std::collections::HashMap;

use crate::recordings::overcooked::{Move, Player};

/// How many actions a player has.
pub const ACTIONS: usize = 6;

/// A policy: a probability for each action.
pub type Policy = [f64; ACTIONS];

/// How many draws from the habits of the whole layout each position is given.
const PRIOR: f64 = 6.0;
/// The share of actions that are taken at random.
const UNIFORM: f64 = 0.05;
/// The most that is left of staying, which is half of what people do and tells nothing.
const MOST_STAY: f64 = 0.3;

/// Empirical policies: how often a player took each action, by position.
pub struct Habits {
    by_position: HashMap<(u8, u8), Policy>,
    overall: Policy,
}

impl Habits {
    /// Counts actions.
    pub fn of_steps(steps: impl Iterator<Item = (Player, Move)>) -> Self {
        let mut by_position: HashMap<(u8, u8), Policy> = HashMap::new();
        let mut overall = Policy::default();
        for (player, action) in steps {
            by_position.entry((player.x, player.y)).or_default()[index(action)] += 1.0;
            overall[index(action)] += 1.0;
        }

        let total: f64 = overall.iter().sum();
        Self {
            by_position,
            overall: overall.map(|count| count / total),
        }
    }

    /// Returns what the player does: (count + 6 g) / (n + 6) with the whole layout's shares g,
    /// mixed with 5 % uniform, stay cut to .3.
    pub fn policy(&self, player: &Player) -> Policy {
        let counts = self
            .by_position
            .get(&(player.x, player.y))
            .copied()
            .unwrap_or_default();
        let total = counts.iter().sum::<f64>() + PRIOR;
        let fitted = |action: usize| (counts[action] + PRIOR * self.overall[action]) / total;
        let mixed = |action: usize| (1.0 - UNIFORM) * fitted(action) + UNIFORM / ACTIONS as f64;
        less_still(std::array::from_fn(mixed))
    }
}

fn less_still(policy: Policy) -> Policy {
    let stay = index(Move::Stay);
    if policy[stay] <= MOST_STAY {
        return policy;
    }
    let mut cut = policy.map(|share| share * (1.0 - MOST_STAY) / (1.0 - policy[stay]));
    cut[stay] = MOST_STAY;
    cut
}

/// Returns the index of an action, as environments have it.
pub fn index(action: Move) -> usize {
    action as usize
}
