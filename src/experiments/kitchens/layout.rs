//! The layouts whose states are taken, and how much of each is seen.

use std::str::FromStr;

use crate::recordings::overcooked::Abstraction;

/// A layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// Two rooms with two pots between them: the players pass each other rarely. Seen with the
    /// pots.
    AsymmetricAdvantages,
    /// A ring around a counter: the players meet all the time.
    CounterCircuit,
}

impl Layout {
    /// Every layout, in the order in which they are told.
    pub const ALL: [Self; 2] = [Self::AsymmetricAdvantages, Self::CounterCircuit];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::AsymmetricAdvantages => "asymmetric_advantages",
            Self::CounterCircuit => "counter_circuit",
        }
    }

    /// Returns how much of its state is seen.
    pub fn abstraction(self) -> Abstraction {
        match self {
            Self::AsymmetricAdvantages => Abstraction::PosOriHeldPot,
            Self::CounterCircuit => Abstraction::PosOriHeld,
        }
    }
}

impl FromStr for Layout {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names = Self::ALL.map(Self::as_str);
        let wrong = || format!("got {text:?}, expected one of {}", names.join(", "));
        Self::ALL
            .into_iter()
            .find(|layout| layout.as_str() == text)
            .ok_or_else(wrong)
    }
}
