//! Human-human games of Overcooked-AI (2019): two people cook together in a small kitchen, a joint
//! step every 150 ms.
//!
//! ```text
//! bytes -> read -> games of steps        World (a layout, an abstraction) -> description of an environment
//!                                        World, step -> state values, action values
//! ```
//!
//! `data/overcooked/SOURCE.md` says where the games come from and what their columns are; the same
//! folder holds their licence.
//!
//! Two things are left to who sends them. Entry flags: [`nudge_core::tracks::Track`] sets them, one
//! track a game. And rows in which both stay, a quarter to a half of all: they are kept, because
//! leaving them out makes the players' actions depend on each other where they do not.

mod abstraction;
mod game;
mod kitchen;
mod read;
mod state;
#[cfg(test)]
mod tests;

pub use abstraction::{Abstraction, World};
pub use game::{Game, Held, Move, Object, Orientation, Player, Step, Thing};
pub use kitchen::{Cell, Kitchen};
pub use read::{decompressed, read_games};

/// Returns the games that come with the program: the name and the bytes of each file.
pub fn embedded() -> [(&'static str, &'static [u8]); 2] {
    [
        (
            "train.csv.gz",
            include_bytes!("../../../../../data/overcooked/train.csv.gz"),
        ),
        (
            "test.csv.gz",
            include_bytes!("../../../../../data/overcooked/test.csv.gz"),
        ),
    ]
}
