//! The worlds that decisions are measured in, by name.

use super::{Hold, World};

/// Every world: those in which the leader has influence, then those in which nobody has any.
pub const WORLDS: [World; 13] = [
    copying("copy1", 1, Hold::Free),
    copying("copy3", 3, Hold::Free),
    copying("copy1-hold3", 1, Hold::Steps(3)),
    copying("copy3-hold3", 3, Hold::Steps(3)),
    copying("copy1-hold6", 1, Hold::Steps(6)),
    copying("copy3-hold6", 3, Hold::Steps(6)),
    independent("none", Hold::Free),
    independent("none-hold3", Hold::Steps(3)),
    independent("none-hold6", Hold::Steps(6)),
    independent("none-kept90", Hold::Kept(90)),
    World {
        roams: Some(3),
        ..independent("none-kept90-here", Hold::Kept(90))
    },
    World {
        shuffled: true,
        ..copying("copy3-shuffled", 3, Hold::Free)
    },
    World {
        shuffled: true,
        ..copying("copy3-hold3-shuffled", 3, Hold::Steps(3))
    },
];

const fn copying(name: &'static str, lag: usize, hold: Hold) -> World {
    World {
        lag: Some(lag),
        ..independent(name, hold)
    }
}

const fn independent(name: &'static str, hold: Hold) -> World {
    World {
        name,
        lag: None,
        hold,
        roams: None,
        shuffled: false,
    }
}
