//! Which part of a kitchen's state an environment sees, and how a step becomes values.

use std::fmt;
use std::str::FromStr;

use super::{Cell, Held, Kitchen, Move, Object, Orientation, Player, Step, Thing};
use nudge_core::domain::SchemaDraft;
use nudge_core::domain::draft::{
    AgentDraft, DerivedDraft, DerivedKindDraft, FeatureDraft, KindDraft, OutcomeDraft,
};

/// How much of a kitchen's state is kept. Each is finer than the one before.
///
/// What lies on the counters is never kept: with it almost no state is seen twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Abstraction {
    /// Where both players are.
    Pos,
    /// And where they look.
    PosOri,
    /// And what they hold.
    #[default]
    PosOriHeld,
    /// And how far each pot is: `empty`, `one`, `two` onions, `cooking`, `ready`.
    PosOriHeldPot,
}

impl Abstraction {
    /// Every abstraction, coarsest first.
    pub const ALL: [Self; 4] = [
        Self::Pos,
        Self::PosOri,
        Self::PosOriHeld,
        Self::PosOriHeldPot,
    ];

    /// Returns the word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Pos => "pos",
            Self::PosOri => "pos_ori",
            Self::PosOriHeld => "pos_ori_held",
            Self::PosOriHeldPot => "pos_ori_held_pot",
        }
    }

    /// Returns the name of the environment of a layout seen this way: `counter_circuit` for the
    /// usual one, `counter_circuit.pos` for another.
    pub fn environment_name(self, layout: &str) -> String {
        if self == Self::default() {
            layout.to_owned()
        } else {
            format!("{layout}.{self}")
        }
    }

    fn has_orientation(self) -> bool {
        self != Self::Pos
    }

    fn has_held(self) -> bool {
        matches!(self, Self::PosOriHeld | Self::PosOriHeldPot)
    }

    fn has_pots(self) -> bool {
        self == Self::PosOriHeldPot
    }
}

impl fmt::Display for Abstraction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Abstraction {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names = Self::ALL.map(Self::as_str);
        let wrong = || format!("got {text:?}, expected one of {}", names.join(", "));
        Self::ALL
            .into_iter()
            .find(|one| one.as_str() == text)
            .ok_or_else(wrong)
    }
}

/// A layout seen through an abstraction: an environment, and the way into it.
///
/// Its agents are `player_0` and `player_1`, whose action is one of six moves. Its state begins
/// with player 0's `position`, `orientation` and `held`, as far as they are kept, then player 1's,
/// then the pots row by row.
///
/// Seen [`at_lags`](Self::at_lags), a player's place is `x` and `y` in the place of `position`, so
/// that how far apart the players are can be told of their bins: `dx` and `dy` from player 0 to
/// player 1, and `distance`, the sum of both without signs. And a step has outcomes: what both do
/// so many steps later, and what each holds after one.
#[derive(Debug, Clone)]
pub struct World {
    kitchen: Kitchen,
    abstraction: Abstraction,
    /// The lags of both players' actions; empty for what is seen in one tick.
    lags: Vec<u32>,
}

impl World {
    /// Sees a layout through an abstraction.
    pub fn new(kitchen: Kitchen, abstraction: Abstraction) -> Self {
        Self {
            kitchen,
            abstraction,
            lags: Vec::new(),
        }
    }

    /// Sees it at these lags too; without any it is what it was.
    pub fn at_lags(self, lags: Vec<u32>) -> Self {
        Self { lags, ..self }
    }

    /// Returns the environment's name.
    pub fn environment_name(&self) -> String {
        self.abstraction.environment_name(&self.kitchen.name)
    }

    /// Returns the environment's description.
    pub fn description(&self) -> SchemaDraft {
        let mut state = Vec::new();
        for player in PLAYERS {
            state.extend(self.player_features(player));
        }
        if self.abstraction.has_pots() {
            let pot = |pot: &Cell| {
                categorical(
                    format!("pot_{}_{}", pot.x, pot.y),
                    POT.map(str::to_owned).to_vec(),
                )
            };
            state.extend(self.kitchen.pots.iter().map(pot));
        }

        let moves = || categorical("move".into(), labels(Move::ALL, Move::label));
        let agents = PLAYERS.map(|name| AgentDraft {
            name: name.into(),
            action: vec![moves()],
            ..AgentDraft::default()
        });

        SchemaDraft {
            state,
            agents: agents.to_vec(),
            outcomes: self.held_next(),
            lags: self.lags.iter().copied().map(i64::from).collect(),
        }
    }

    /// Returns where the players are to each other; nothing where their places are labels.
    pub fn derived(&self) -> Vec<DerivedDraft> {
        if self.lags.is_empty() {
            return Vec::new();
        }
        let [zero, one] = PLAYERS;
        let [x, y] = ["x", "y"].map(|axis| {
            [one, zero]
                .map(|player| format!("{player}.{axis}"))
                .to_vec()
        });
        [
            ("dx", DerivedKindDraft::Difference(x.clone())),
            ("dy", DerivedKindDraft::Difference(y.clone())),
            ("distance", DerivedKindDraft::Manhattan(vec![x, y])),
        ]
        .map(|(name, kind)| DerivedDraft {
            name: name.into(),
            kinds: vec![kind],
        })
        .to_vec()
    }

    /// Returns the outcomes that are no actions: what each player holds one step later.
    fn held_next(&self) -> Vec<OutcomeDraft> {
        if self.lags.is_empty() {
            return Vec::new();
        }
        let outcome = |player: &str| OutcomeDraft {
            name: format!("{player}.held_next"),
            lag: Some(1),
            value: vec![categorical("held".into(), labels(Held::ALL, Held::label))],
            ..OutcomeDraft::default()
        };
        PLAYERS.map(outcome).to_vec()
    }

    fn player_features(&self, player: &str) -> Vec<FeatureDraft> {
        let mut features = self.place_features(player);
        if self.abstraction.has_orientation() {
            features.push(categorical(
                format!("{player}.orientation"),
                labels(Orientation::ALL, Orientation::label),
            ));
        }
        if self.abstraction.has_held() {
            features.push(categorical(
                format!("{player}.held"),
                labels(Held::ALL, Held::label),
            ));
        }
        features
    }

    fn place_features(&self, player: &str) -> Vec<FeatureDraft> {
        let walkable = &self.kitchen.walkable;
        if self.lags.is_empty() {
            let positions = labels(walkable, |cell| format!("{},{}", cell.x, cell.y));
            return vec![categorical(format!("{player}.position"), positions)];
        }

        let within = |name: &str, of: fn(&Cell) -> u8| {
            let values = || walkable.iter().map(of).map(i64::from);
            let [least, most] = [values().min(), values().max()].map(Option::unwrap_or_default);
            FeatureDraft {
                name: format!("{player}.{name}"),
                unit: None,
                kinds: vec![KindDraft::Integer(least, most)],
            }
        };
        vec![within("x", |cell| cell.x), within("y", |cell| cell.y)]
    }

    /// Returns what is observed at a step of the outcomes that are no actions.
    pub fn observed(&self, step: &Step) -> Vec<f32> {
        if self.lags.is_empty() {
            return Vec::new();
        }
        let held = |player: &Player| index(Held::ALL, &player.held);
        step.players.iter().map(held).collect()
    }

    /// Returns a step as one value a state feature and one value an agent, in the environment's
    /// order.
    pub fn values(&self, step: &Step) -> (Vec<f32>, Vec<f32>) {
        let mut state = Vec::new();
        for player in &step.players {
            self.push_player(player, &mut state);
        }
        if self.abstraction.has_pots() {
            state.extend(
                self.kitchen
                    .pots
                    .iter()
                    .map(|pot| pot_bucket(*pot, &step.objects)),
            );
        }
        (
            state,
            step.actions
                .iter()
                .map(|action| index(Move::ALL, action))
                .collect(),
        )
    }

    fn push_player(&self, player: &Player, state: &mut Vec<f32>) {
        let Player { x, y, .. } = *player;
        if self.lags.is_empty() {
            state.push(index(&self.kitchen.walkable, &Cell { x, y }));
        } else {
            state.extend([x, y].map(f32::from));
        }
        if self.abstraction.has_orientation() {
            state.push(index(Orientation::ALL, &player.orientation));
        }
        if self.abstraction.has_held() {
            state.push(index(Held::ALL, &player.held));
        }
    }
}

const PLAYERS: [&str; 2] = ["player_0", "player_1"];
const POT: [&str; 5] = ["empty", "one", "two", "cooking", "ready"];

/// Steps from the third onion until a soup is done.
const COOKED: u32 = 20;

fn pot_bucket(pot: Cell, objects: &[Object]) -> f32 {
    let soup = objects
        .iter()
        .find(|object| (object.x, object.y) == (pot.x, pot.y))
        .map(|object| object.thing);
    match soup {
        Some(Thing::Soup { items: 3, timer }) => {
            if timer < COOKED {
                3.0
            } else {
                4.0
            }
        }
        Some(Thing::Soup { items, .. }) => f32::from(items),
        _ => 0.0,
    }
}

/// Returns the index of `one` as the value it has on the wire. What is not there gets an index that
/// no feature takes, and is rejected by name.
fn index<T: PartialEq>(all: &[T], one: &T) -> f32 {
    all.iter()
        .position(|known| known == one)
        .map_or(-1.0, |index| index as f32)
}

fn categorical(name: String, labels: Vec<String>) -> FeatureDraft {
    FeatureDraft {
        name,
        unit: None,
        kinds: vec![KindDraft::Categorical(labels)],
    }
}

fn labels<T: Copy, L: Into<String>>(all: &[T], label: impl Fn(T) -> L) -> Vec<String> {
    all.iter().map(|one| label(*one).into()).collect()
}
