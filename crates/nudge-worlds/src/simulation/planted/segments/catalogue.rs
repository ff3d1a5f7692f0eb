//! The worlds that decisions are measured in, by name.

use super::world::{Dependence, Differ, Sizes, World};
use nudge_core::information::Alphabet;

/// Every world: first those in which nothing depends on anything, then those in which some states
/// do.
pub const WORLDS: [World; 29] = [
    independent("alike", 8, Differ::Neither),
    independent("ego", 8, Differ::Ego),
    independent("other", 8, Differ::Other),
    independent("both", 8, Differ::Both),
    independent("both2", 2, Differ::Both),
    independent("both20", 20, Differ::Both),
    independent("both50", 50, Differ::Both),
    independent("both300", 300, Differ::Both),
    independent("opposite", 2, Differ::Opposite),
    independent("drift", 50, Differ::Drift),
    World {
        sizes: Sizes::Falling,
        ..independent("unequal", 8, Differ::Both)
    },
    World {
        sizes: Sizes::Dominated,
        ..independent("dominated", 8, Differ::Both)
    },
    World {
        alphabet: TWO_BY_TWO,
        ..independent("both-2x2", 8, Differ::Both)
    },
    World {
        alphabet: THREE_BY_TWENTY_FIVE,
        ..independent("both-3x25", 8, Differ::Both)
    },
    dependent("alike-some", 8, Differ::Neither, Dependence::Shared),
    dependent("ego-some", 8, Differ::Ego, Dependence::Shared),
    dependent("other-some", 8, Differ::Other, Dependence::Shared),
    dependent("both-some", 8, Differ::Both, Dependence::Shared),
    dependent("both2-some", 2, Differ::Both, Dependence::Shared),
    dependent("both20-some", 20, Differ::Both, Dependence::Shared),
    dependent("both50-some", 50, Differ::Both, Dependence::Shared),
    dependent("both300-some", 300, Differ::Both, Dependence::Shared),
    dependent("drift-some", 50, Differ::Drift, Dependence::Shared),
    World {
        sizes: Sizes::Falling,
        ..dependent("unequal-some", 8, Differ::Both, Dependence::Shared)
    },
    World {
        sizes: Sizes::Dominated,
        ..dependent("dominated-some", 8, Differ::Both, Dependence::Shared)
    },
    dependent("alike-in-one", 6, Differ::Neither, Dependence::InOne),
    dependent("both-in-one", 6, Differ::Both, Dependence::InOne),
    dependent("alike-differing", 6, Differ::Neither, Dependence::Differing),
    dependent("both-differing", 6, Differ::Both, Dependence::Differing),
];

const SIX_BY_SIX: Alphabet = Alphabet {
    rows: 6,
    columns: 6,
};
const TWO_BY_TWO: Alphabet = Alphabet {
    rows: 2,
    columns: 2,
};
const THREE_BY_TWENTY_FIVE: Alphabet = Alphabet {
    rows: 3,
    columns: 25,
};

const fn independent(name: &'static str, segments: usize, differ: Differ) -> World {
    dependent(name, segments, differ, Dependence::Nowhere)
}

const fn dependent(
    name: &'static str,
    segments: usize,
    differ: Differ,
    dependence: Dependence,
) -> World {
    World {
        name,
        alphabet: SIX_BY_SIX,
        segments,
        sizes: Sizes::Equal,
        differ,
        dependence,
    }
}
