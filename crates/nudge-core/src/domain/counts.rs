//! Counts: what a batch adds, and what a state holds.

use super::{Agent, Family, Label, Schema, StateKey};

/// The store's number of a segment; never used twice. Transitions without a segment have one too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SegmentId(pub i64);

/// How often something was seen, and how often its state was entered with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Tally {
    /// Visits, at least 1 in a cell.
    pub n: u64,
    /// Entries, at most `n`; `None` once a transition came without the flag.
    pub entries: Option<u64>,
}

impl Tally {
    /// Nothing seen: the sum of no tallies.
    pub const EMPTY: Self = Self {
        n: 0,
        entries: Some(0),
    };

    /// Returns the sum of cells.
    pub fn sum<'a>(cells: impl Iterator<Item = &'a Cell>) -> Self {
        cells.fold(Self::EMPTY, |mut sum, cell| {
            sum.add(cell.tally);
            sum
        })
    }

    /// Adds another tally. The store bounds all sums by an environment's total, which fits.
    #[inline]
    pub fn add(&mut self, other: Self) {
        self.n += other.n;
        self.entries = self.entries.zip(other.entries).map(|(a, b)| a + b);
    }
}

/// What a validated batch adds to one environment under one segment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Increment {
    /// Where its transitions come from.
    pub segment: Option<Label>,
    /// How the cells name their states.
    pub states: States,
    /// By the state's number and the joint action, in any order; the same cell may stand here more
    /// than once.
    pub cells: Vec<(u64, u64, Tally)>,
    /// A column for each outcome, of what was observed with each of `cells`: the cell of the
    /// outcome's family, of the same state and tally, or [`Increment::MISSING`], as where a column
    /// is shorter.
    pub outcomes: Vec<Vec<u64>>,
    /// The sum of all `n` of joint actions.
    pub transitions: u64,
}

impl Increment {
    /// No cell: an outcome was not observed.
    pub const MISSING: u64 = u64::MAX;

    /// Returns the families, in order.
    pub fn families(&self) -> impl ExactSizeIterator<Item = Family> + use<> {
        (0..self.outcomes.len() as u32 + 1).map(Family::from_number)
    }

    /// Returns the cells of a family, by the state's number and the family's cell.
    pub fn of_family(&self, family: Family) -> impl Iterator<Item = (u64, u64, Tally)> {
        let cells = self.cells.iter().zip(self.column(family));
        let observed = cells.filter(|(_, cell)| *cell != Self::MISSING);
        observed.map(|((state, _, tally), cell)| (*state, cell, *tally))
    }

    /// Returns the cell of a family that each of `cells` is in, or [`Increment::MISSING`]; it may
    /// end before they do.
    #[inline]
    pub fn column(&self, family: Family) -> impl Iterator<Item = u64> {
        let (joints, column) = match family.outcome() {
            None => (&*self.cells, None),
            Some(at) => (&[][..], self.outcomes.get(at)),
        };
        let joints = joints.iter().map(|(_, joint, _)| *joint);
        joints.chain(column.into_iter().flatten().copied())
    }

    /// Returns a bound of how many cells stand here, of all families: as many as if no outcome were
    /// missing.
    pub fn most_cells(&self) -> usize {
        self.cells.len() * self.families().len()
    }

    /// Returns whether nothing is added.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }
}

/// How the cells of an [`Increment`] name their states.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum States {
    /// By their ranks: [`Schema::rank`].
    #[default]
    Ranked,
    /// By their positions here, where each stands once: an environment with more states than
    /// ranks.
    Listed(Vec<StateKey>),
}

impl States {
    /// Returns the states that are listed.
    pub fn listed(&self) -> &[StateKey] {
        match self {
            Self::Ranked => &[],
            Self::Listed(keys) => keys,
        }
    }
}

/// One cell of a state: a joint action under a segment, or a cell of an outcome's family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Cell {
    /// The joint action; in an outcome's family the family's cell, which [`Schema::split`] takes
    /// apart.
    pub joint: u64,
    /// The segment.
    pub segment: SegmentId,
    /// What was counted.
    pub tally: Tally,
}

/// Every cell of one state, in order of family, joint action and segment.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Counts {
    cells: Vec<Cell>,
    /// Families of outcomes that have cells, in order.
    outcomes: Vec<(Family, Vec<Cell>)>,
}

impl Counts {
    /// Makes counts of joint actions, of cells in any order, each given once.
    pub fn new(mut cells: Vec<Cell>) -> Self {
        cells.sort_unstable_by_key(key);
        Self {
            cells,
            outcomes: Vec::new(),
        }
    }

    /// Adds those of the next family of an outcome, of cells in any order, each given once.
    pub fn push(&mut self, family: Family, mut cells: Vec<Cell>) {
        debug_assert!(
            self.outcomes.last().map_or(Family::JOINT, |last| last.0) < family,
            "families are in order"
        );
        cells.sort_unstable_by_key(key);
        self.outcomes.push((family, cells));
    }

    /// Returns the cells of joint actions in order.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Returns the cells of a family in order.
    pub fn of_family(&self, family: Family) -> &[Cell] {
        if family == Family::JOINT {
            return &self.cells;
        }
        let found = self
            .outcomes
            .binary_search_by_key(&family, |(family, _)| *family);
        found.map_or(&[], |at| &self.outcomes[at].1)
    }

    /// Returns how many cells there are, of all families.
    pub fn len(&self) -> usize {
        self.cells.len()
            + self
                .outcomes
                .iter()
                .map(|(_, cells)| cells.len())
                .sum::<usize>()
    }

    /// Returns whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the cells of joint actions of the segments named, or of all.
    pub fn of_segments<'a>(
        &'a self,
        segments: Option<&'a [SegmentId]>,
    ) -> impl Iterator<Item = &'a Cell> + Clone {
        of_segments(&self.cells, segments)
    }

    /// Returns the cells of a family of the segments named, or of all.
    pub fn of_family_and_segments<'a>(
        &'a self,
        family: Family,
        segments: Option<&'a [SegmentId]>,
    ) -> impl Iterator<Item = &'a Cell> + Clone {
        of_segments(self.of_family(family), segments)
    }

    /// Adds a tally to a cell of a family.
    pub fn add(&mut self, family: Family, cell: Cell) {
        let cells = self.family_mut(family);
        match cells.binary_search_by_key(&key(&cell), key) {
            Ok(at) => cells[at].tally.add(cell.tally),
            Err(at) => cells.insert(at, cell),
        }
    }

    fn family_mut(&mut self, family: Family) -> &mut Vec<Cell> {
        if family == Family::JOINT {
            return &mut self.cells;
        }
        let found = self
            .outcomes
            .binary_search_by_key(&family, |(family, _)| *family);
        let at = found.unwrap_or_else(|at| {
            self.outcomes.insert(at, (family, Vec::new()));
            at
        });
        &mut self.outcomes[at].1
    }
}

fn key(cell: &Cell) -> (u64, SegmentId) {
    (cell.joint, cell.segment)
}

fn of_segments<'a>(
    cells: &'a [Cell],
    segments: Option<&'a [SegmentId]>,
) -> impl Iterator<Item = &'a Cell> + Clone {
    cells
        .iter()
        .filter(move |cell| segments.is_none_or(|named| named.contains(&cell.segment)))
}

/// The most actions of an agent whose marginal counts are kept; no evidence is computed for an
/// agent with more.
pub const MOST_ACTIONS: u64 = 4_096;

/// Marginal counts: how often each agent took each of its actions, and each outcome with values had
/// each of them, over all states and segments of an environment.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionTotals {
    /// Transitions counted so far.
    pub revision: u64,
    schema: Schema,
    /// A tally for each action of each agent, then for each value of each outcome; none for an
    /// agent's later action, and none where there are more than [`MOST_ACTIONS`].
    variables: Vec<Vec<Tally>>,
}

impl ActionTotals {
    /// Begins with nothing counted.
    pub fn new(schema: &Schema) -> Self {
        let actions = schema.agents().iter().map(Agent::actions);
        let values = schema.outcomes().iter().map(|outcome| match outcome.agent {
            Some(_) => 0,
            None => outcome.values(),
        });
        let kept = |size: u64| if size <= MOST_ACTIONS { size } else { 0 };
        let variables = actions
            .chain(values)
            .map(|size| vec![Tally::EMPTY; kept(size) as usize])
            .collect();

        Self {
            revision: 0,
            schema: schema.clone(),
            variables,
        }
    }

    /// Returns how often a [variable](super::Pair::other) drew each of its actions or values:
    /// entries where every transition that tells of it carried the flag, else visits. Empty for one
    /// that has more than [`MOST_ACTIONS`], and for an agent's later action.
    pub fn draws(&self, variable: usize) -> Vec<u64> {
        let tallies = &self.variables[variable];
        let entries: Option<Vec<u64>> = tallies.iter().map(|tally| tally.entries).collect();
        entries.unwrap_or_else(|| tallies.iter().map(|tally| tally.n).collect())
    }

    /// Counts a joint action.
    pub fn add(&mut self, joint: u64, tally: Tally) {
        self.revision += tally.n;
        self.add_actions(joint, tally);
    }

    /// Counts the value of a cell of an outcome's family.
    pub fn add_value(&mut self, family: Family, cell: u64, tally: Tally) {
        let Some(outcome) = family.outcome() else {
            return;
        };
        // A damaged cell may be of an outcome that there is not.
        let variable = self.schema.agents().len() + outcome;
        let Some(tallies) = self.variables.get_mut(variable) else {
            return;
        };
        if tallies.is_empty() {
            return;
        }
        let (_, value) = self.schema.split(family, cell);
        if let Some(sum) = tallies.get_mut(value as usize) {
            sum.add(tally);
        }
    }

    /// Counts the cells of a commit, unless its revision says that they are counted already.
    pub fn apply(&mut self, revision: u64, cells: impl Iterator<Item = (Family, u64, Tally)>) {
        if self.revision < revision {
            self.revision = revision;
            cells.for_each(|(family, cell, tally)| match family {
                Family::JOINT => self.add_actions(cell, tally),
                family => self.add_value(family, cell, tally),
            });
        }
    }

    /// Adds what was counted later, up to the revision of that.
    pub fn append(&mut self, later: &Self) {
        self.revision = later.revision;
        for (tallies, added) in self.variables.iter_mut().zip(&later.variables) {
            tallies
                .iter_mut()
                .zip(added)
                .for_each(|(tally, added)| tally.add(*added));
        }
    }

    fn add_actions(&mut self, joint: u64, tally: Tally) {
        let agents = self.schema.agents().len();
        for (agent, tallies) in self.variables[..agents].iter_mut().enumerate() {
            // One with too many actions has no tallies, and a damaged joint action may name an
            // action that nobody has.
            if tallies.is_empty() {
                continue;
            }
            if let Some(sum) = tallies.get_mut(self.schema.action_of(joint, agent) as usize) {
                sum.add(tally);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::draft::{AgentDraft, FeatureDraft, KindDraft, OutcomeDraft};
    use super::*;
    use crate::domain::SchemaDraft;

    /// Returns a schema of agents with so many actions each.
    fn schema(actions: &[i64]) -> Schema {
        let feature = |max| FeatureDraft {
            name: "move".into(),
            unit: None,
            kinds: vec![KindDraft::Integer(0, max)],
        };
        let agent = |(at, actions): (usize, &i64)| AgentDraft {
            name: format!("agent{at}"),
            action: vec![feature(actions - 1)],
            ..AgentDraft::default()
        };
        let state = vec![FeatureDraft {
            name: "place".into(),
            ..feature(9)
        }];
        let draft = SchemaDraft {
            state,
            agents: actions.iter().enumerate().map(agent).collect(),
            ..SchemaDraft::default()
        };
        Schema::try_from(&draft).expect("valid")
    }

    fn tally(n: u64, entries: impl Into<Option<u64>>) -> Tally {
        Tally {
            n,
            entries: entries.into(),
        }
    }

    fn joint<const N: usize>(
        cells: [(u64, Tally); N],
    ) -> impl Iterator<Item = (Family, u64, Tally)> {
        let told = |(joint, tally)| (Family::JOINT, joint, tally);
        cells.into_iter().map(told)
    }

    #[test]
    fn every_value_that_is_no_action_is_drawn_too() {
        let integer = |max| FeatureDraft {
            name: "holds".into(),
            unit: None,
            kinds: vec![KindDraft::Integer(0, max)],
        };
        let pot = |name: &str, max| OutcomeDraft {
            name: name.into(),
            lag: Some(1),
            value: vec![integer(max)],
            ..OutcomeDraft::default()
        };
        let draft = SchemaDraft {
            outcomes: vec![pot("pot", 2), pot("huge", MOST_ACTIONS as i64)],
            lags: vec![1],
            ..schema(&[2, 3]).draft()
        };
        let schema = Schema::try_from(&draft).expect("valid");
        let [own, pot, huge] = ["agent1@1", "pot", "huge"].map(|name| {
            let at = schema.outcome(name).expect("declared");
            (Family::of_outcome(at), schema.agents().len() + at)
        });

        let mut totals = ActionTotals::new(&schema);
        totals.add(5, tally(2, 1));
        totals.add_value(pot.0, 5 * 3 + 2, tally(2, 1));
        totals.add_value(own.0, 5 * 3 + 2, tally(2, 1));
        totals.add_value(huge.0, 5, tally(2, 1));
        let later = [
            (Family::JOINT, 0, tally(1, 1)),
            (pot.0, 1, tally(1, 1)),
            (Family::from_number(99), 1, tally(1, 1)),
        ];
        totals.apply(2, later.into_iter());
        assert_eq!(totals.draws(pot.1), [0, 0, 1], "counted already");
        totals.apply(3, later.into_iter());
        assert_eq!(totals.draws(pot.1), [0, 1, 1]);
        assert_eq!([own.1, huge.1].map(|at| totals.draws(at)), [vec![], vec![]]);
        assert_eq!((totals.revision, totals.draws(1)), (3, vec![1, 0, 1]));

        totals.add_value(pot.0, 1, tally(4, None));
        assert_eq!(
            totals.draws(pot.1),
            [0, 5, 2],
            "of visits, where one had no flag"
        );
        assert_eq!(totals.draws(0), [1, 1], "which is no matter of actions");
    }

    #[test]
    fn every_agent_draws_its_part_of_a_joint_action() {
        let mut totals = ActionTotals::new(&schema(&[2, 3, 4]));
        assert_eq!((totals.revision, totals.draws(1)), (0, vec![0; 3]));
        // 1, 2, 3 and 0, 2, 1.
        totals.add(12 + 2 * 4 + 3, tally(5, 2));
        totals.add(2 * 4 + 1, tally(4, 4));
        assert_eq!(totals.revision, 9);
        assert_eq!(
            [0, 1, 2].map(|agent| totals.draws(agent)),
            [vec![4, 2], vec![0, 0, 6], vec![0, 4, 0, 2]]
        );
    }

    #[test]
    fn visits_are_drawn_once_any_transition_came_without_the_flag() {
        let mut totals = ActionTotals::new(&schema(&[2, 3]));
        totals.add(0, tally(5, 2));
        totals.add(5, tally(3, None));
        assert_eq!(
            [0, 1].map(|agent| totals.draws(agent)),
            [vec![5, 3], vec![5, 0, 3]]
        );
        totals.add(0, tally(1, 1));
        assert_eq!(totals.draws(0), [6, 3]);
    }

    #[test]
    fn an_agent_with_too_many_actions_has_none() {
        let most = MOST_ACTIONS as i64;
        let mut totals = ActionTotals::new(&schema(&[most + 1, most, 1]));
        totals.add(4_096 * 4_096 + 4_095, tally(2, 2));
        assert_eq!((totals.draws(0), totals.draws(2)), (vec![], vec![2]));
        let draws = totals.draws(1);
        assert_eq!(
            (draws.len(), draws[4_095], draws.iter().sum::<u64>()),
            (4_096, 2, 2)
        );
    }

    #[test]
    fn a_joint_action_that_no_schema_has_is_nobodys() {
        let mut totals = ActionTotals::new(&schema(&[2, 3]));
        totals.add(u64::MAX, tally(1, 1));
        assert_eq!((totals.revision, totals.draws(0)), (1, vec![0, 0]));
    }

    #[test]
    fn a_commit_is_counted_once() {
        let schema = schema(&[2, 3]);
        let mut totals = ActionTotals::new(&schema);
        for revision in [3, 3, 2] {
            totals.apply(revision, joint([(0, tally(1, 1)), (5, tally(2, 1))]));
        }
        assert_eq!((totals.revision, totals.draws(0)), (3, vec![1, 1]));
        let mut later = ActionTotals {
            revision: 3,
            ..ActionTotals::new(&schema)
        };
        later.apply(7, joint([(5, tally(4, None))]));
        totals.append(&later);
        assert_eq!(
            (totals.revision, totals.draws(0), totals.draws(1)),
            (7, vec![1, 6], vec![1, 0, 6])
        );
    }

    #[test]
    fn entries_are_unknown_once_one_was() {
        let mut sum = Tally::EMPTY;
        sum.add(Tally {
            n: 2,
            entries: Some(1),
        });
        assert_eq!(
            sum,
            Tally {
                n: 2,
                entries: Some(1)
            }
        );
        sum.add(Tally {
            n: 1,
            entries: None,
        });
        sum.add(Tally {
            n: 1,
            entries: Some(1),
        });
        assert_eq!(
            sum,
            Tally {
                n: 4,
                entries: None
            }
        );
    }

    #[test]
    fn order_of_adding_does_not_matter() {
        let one = Tally {
            n: 1,
            entries: Some(1),
        };
        let steps = [(3, 1), (1, 2), (3, 0), (1, 2), (0, 9)];
        let add = |order: &mut dyn Iterator<Item = &(u64, i64)>| {
            let mut counts = Counts::default();
            let cell = |&(joint, segment): &(u64, i64)| Cell {
                joint,
                segment: SegmentId(segment),
                tally: one,
            };
            let families = [Family::JOINT, Family::of_outcome(2), Family::of_outcome(0)];
            for step in order {
                families
                    .iter()
                    .for_each(|family| counts.add(*family, cell(step)));
            }
            counts
        };
        let forward = add(&mut steps.iter());
        assert_eq!(forward, add(&mut steps.iter().rev()));
        assert_eq!(
            forward
                .cells()
                .iter()
                .map(|c| (c.joint, c.segment.0, c.tally.n))
                .collect::<Vec<_>>(),
            [(0, 9, 1), (1, 2, 2), (3, 0, 1), (3, 1, 1)]
        );
        let outcome = |at| forward.of_family(Family::of_outcome(at));
        assert_eq!(outcome(0), forward.cells());
        assert_eq!(outcome(2), forward.cells());
        assert!(outcome(1).is_empty());
        assert_eq!(forward.len(), 12);
    }
}
