//! What a recording holds: games of steps.

/// One game of one pair on one layout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Game {
    /// The layout's name.
    pub layout: String,
    /// The trial's name: pair, run and game.
    pub trial: String,
    /// Its steps in order of time, without gaps.
    pub steps: Vec<Step>,
}

/// One joint time step: the state, and what both players did in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// The players.
    pub players: [Player; 2],
    /// What lies about and what is in the pots.
    pub objects: Vec<Object>,
    /// What the players did.
    pub actions: [Move; 2],
}

/// Where a player is and what they hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Player {
    /// The column, from 0 at the left.
    pub x: u8,
    /// The row, from 0 at the top.
    pub y: u8,
    /// Where they look.
    pub orientation: Orientation,
    /// What they hold.
    pub held: Held,
}

/// Something that nobody holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Object {
    /// The column.
    pub x: u8,
    /// The row.
    pub y: u8,
    /// What it is.
    pub thing: Thing,
}

/// What lies about or cooks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Thing {
    /// An onion.
    Onion,
    /// A dish.
    Dish,
    /// A soup, in a pot or on a counter.
    Soup {
        /// Onions in it, 1 to 3.
        items: u8,
        /// Steps since the third onion; it never stops.
        timer: u32,
    },
}

/// Declares a closed set of words: as the recording writes them, and as environments label them.
macro_rules! words {
    ($(#[$doc:meta])* $name:ident { $($(#[$variant_doc:meta])* $variant:ident = $written:literal, $label:literal;)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name { $($(#[$variant_doc])* $variant,)* }

        impl $name {
            /// Every one, in the order of its label's index.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Returns the word of the recording.
            pub fn written(self) -> &'static str {
                match self { $(Self::$variant => $written,)* }
            }

            /// Returns the label in environments.
            pub fn label(self) -> &'static str {
                match self { $(Self::$variant => $label,)* }
            }

            /// Returns what the recording's word stands for, or what was expected.
            pub fn parse(word: &str) -> Result<Self, String> {
                let found = Self::ALL.iter().copied().find(|one| one.written() == word);
                found.ok_or_else(|| format!("got {word:?}, expected one of {:?}", [$($written),*]))
            }
        }
    };
}

words! {
    /// Where a player looks; y grows downwards, so north is up.
    Orientation {
        /// Up.
        North = "N", "N";
        /// Down.
        South = "S", "S";
        /// Right.
        East = "E", "E";
        /// Left.
        West = "W", "W";
    }
}

words! {
    /// What a player holds.
    Held {
        /// Empty hands.
        Nothing = "", "nothing";
        /// An onion.
        Onion = "onion", "onion";
        /// An empty dish.
        Dish = "dish", "dish";
        /// A dish of soup.
        Soup = "soup", "soup";
    }
}

words! {
    /// What a player did in a step.
    Move {
        /// Up, or to look up.
        North = "N", "north";
        /// Down, or to look down.
        South = "S", "south";
        /// Right, or to look right.
        East = "E", "east";
        /// Left, or to look left.
        West = "W", "west";
        /// Nothing.
        Stay = "stay", "stay";
        /// Take, put, serve.
        Interact = "interact", "interact";
    }
}
