//! Response models: how the other answers the ego, which is the influence that is planted.

use super::policy::{ACTIONS, Policy, index};
use crate::recordings::overcooked::{Held, Move, Player};

/// A response model: what the other does, given what the ego did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResponseModel {
    /// Where the players are near each other, the other steps aside.
    Yield,
    /// Where they are near each other, the other does the same.
    Copy,
    /// The other steps aside only where the ego holds something.
    YieldWhenHolding,
}

/// How far apart players are near each other, in steps.
const NEAR: u8 = 2;
/// How probable an answer is; otherwise the other does what it always does.
const ANSWERED: f64 = 0.8;

impl ResponseModel {
    /// Every response model, in the order in which they are told.
    pub const ALL: [Self; 3] = [Self::Yield, Self::Copy, Self::YieldWhenHolding];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Yield => "yield",
            Self::Copy => "copy",
            Self::YieldWhenHolding => "yield_when_holding",
        }
    }

    /// Returns whether the ego, who comes first, is answered.
    pub fn is_answered(self, [ego, other]: &[Player; 2]) -> bool {
        let near = ego.x.abs_diff(other.x) + ego.y.abs_diff(other.y) <= NEAR;
        near && (self != Self::YieldWhenHolding || ego.held != Held::Nothing)
    }

    /// Returns what the other does after each of the ego's actions, given what it does unasked.
    pub fn responses(self, players: &[Player; 2], unasked: &Policy) -> [Policy; ACTIONS] {
        if !self.is_answered(players) {
            return [*unasked; ACTIONS];
        }
        let mut responses = [unasked.map(|share| (1.0 - ANSWERED) * share); ACTIONS];
        for action in Move::ALL {
            responses[index(*action)][index(self.answer(*action))] += ANSWERED;
        }
        responses
    }

    fn answer(self, action: Move) -> Move {
        match (self, action) {
            (Self::Copy, _) => action,
            (_, Move::North) => Move::East,
            (_, Move::South) => Move::West,
            (_, Move::East) => Move::South,
            (_, Move::West) => Move::North,
            (_, Move::Stay | Move::Interact) => Move::Stay,
        }
    }
}
