//! Counts: what a batch adds, and what a state holds.

use super::{Family, Label, Schema, StateKey};

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
    /// The same of each outcome's family, by the state's number and the family's cell; empty where
    /// nothing was observed.
    pub outcomes: Vec<Vec<(u64, u64, Tally)>>,
    /// The sum of all `n` of joint actions.
    pub transitions: u64,
}

impl Increment {
    /// Returns the cells of each family, in order.
    pub fn families(&self) -> impl Iterator<Item = (Family, &[(u64, u64, Tally)])> {
        let outcomes = self.outcomes.iter().enumerate();
        let outcomes = outcomes.map(|(at, cells)| (Family::of_outcome(at), &**cells));
        std::iter::once((Family::JOINT, &*self.cells)).chain(outcomes)
    }

    /// Returns how many cells stand here, of all families.
    pub fn len(&self) -> usize {
        self.cells.len() + self.outcomes.iter().map(Vec::len).sum::<usize>()
    }

    /// Returns whether nothing is added.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
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

/// Marginal counts: how often each agent took each of its actions, over all states and segments of
/// an environment.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionTotals {
    /// Transitions counted so far.
    pub revision: u64,
    schema: Schema,
    /// A tally for each action of each agent; none for an agent that has more than
    /// [`MOST_ACTIONS`].
    agents: Vec<Vec<Tally>>,
}

impl ActionTotals {
    /// Begins with nothing counted.
    pub fn new(schema: &Schema) -> Self {
        let sizes = schema
            .agents()
            .iter()
            .map(|agent| Some(agent.actions()).filter(|actions| *actions <= MOST_ACTIONS));
        let agents = sizes
            .map(|size| vec![Tally::EMPTY; size.unwrap_or(0) as usize])
            .collect();

        Self {
            revision: 0,
            schema: schema.clone(),
            agents,
        }
    }

    /// Returns how often an agent drew each of its actions: entries where every transition of the
    /// environment carried the flag, else visits. Empty for an agent that has more than
    /// [`MOST_ACTIONS`].
    pub fn draws(&self, agent: usize) -> Vec<u64> {
        let tallies = &self.agents[agent];
        let entries: Option<Vec<u64>> = tallies.iter().map(|tally| tally.entries).collect();
        entries.unwrap_or_else(|| tallies.iter().map(|tally| tally.n).collect())
    }

    /// Counts a joint action.
    pub fn add(&mut self, joint: u64, tally: Tally) {
        self.revision += tally.n;
        self.add_actions(joint, tally);
    }

    /// Counts the joint actions of a commit, unless its revision says that they are counted
    /// already.
    pub fn apply(&mut self, revision: u64, cells: impl Iterator<Item = (u64, Tally)>) {
        if self.revision < revision {
            self.revision = revision;
            cells.for_each(|(joint, tally)| self.add_actions(joint, tally));
        }
    }

    /// Adds what was counted later, up to the revision of that.
    pub fn append(&mut self, later: &Self) {
        self.revision = later.revision;
        for (tallies, added) in self.agents.iter_mut().zip(&later.agents) {
            tallies
                .iter_mut()
                .zip(added)
                .for_each(|(tally, added)| tally.add(*added));
        }
    }

    fn add_actions(&mut self, joint: u64, tally: Tally) {
        for (agent, tallies) in self.agents.iter_mut().enumerate() {
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
    use super::super::draft::{AgentDraft, FeatureDraft, KindDraft};
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
            totals.apply(revision, [(0, tally(1, 1)), (5, tally(2, 1))].into_iter());
        }
        assert_eq!((totals.revision, totals.draws(0)), (3, vec![1, 1]));
        let mut later = ActionTotals {
            revision: 3,
            ..ActionTotals::new(&schema)
        };
        later.apply(7, [(5, tally(4, None))].into_iter());
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
