//! Whose influence on whom.

use super::draft::PairDraft;
use super::{Cell, Counts, Family, Outcome, Schema, SegmentId};
use crate::error::Fault;
use crate::information::Alphabet;

/// Whose influence on whom, with whose actions held fixed: positions of variables, all different.
/// Variables are the agents in the environment's order, then its outcomes in theirs.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Pair {
    /// The agent whose influence is asked about.
    pub ego: usize,
    /// The variable that may be influenced: an agent, or an outcome with values (a factor of the next
    /// state), which is `later` then.
    pub other: usize,
    /// Agents whose actions are held fixed, in the environment's order.
    pub given: Vec<usize>,
    /// The outcome that is asked about: in the place of an agent's action now its action at a lag,
    /// or one with values. What an agent did one step before is then held fixed too, as far as that
    /// is an outcome; else what it does now. Other values have nothing of that kind.
    pub later: Option<usize>,
}

impl Pair {
    /// Makes that of the actions of one tick.
    pub fn new(ego: usize, other: usize, given: Vec<usize>) -> Self {
        Self {
            ego,
            other,
            given,
            later: None,
        }
    }

    /// Makes that of an agent and an outcome with values, at the position of that.
    fn of_value(schema: &Schema, ego: usize, outcome: usize, given: Vec<usize>) -> Self {
        Self {
            later: Some(outcome),
            ..Self::new(ego, schema.agents().len() + outcome, given)
        }
    }

    /// Returns the same with the other's action at a lag; 0 for its action now. `None` where that is
    /// no outcome.
    pub fn at_lag(&self, schema: &Schema, lag: u32) -> Option<Self> {
        let later = match lag {
            0 => None,
            lag => Some(schema.action_at(self.other, lag)?),
        };
        Some(Self {
            later,
            ..self.clone()
        })
    }

    /// Returns how many steps the other is observed after the ego: 0 in the same tick.
    pub fn lag(&self, schema: &Schema) -> u32 {
        self.later.map_or(0, |later| schema.outcomes()[later].lag)
    }

    /// Returns the family whose cells tell of it.
    pub fn family(&self) -> Family {
        self.later.map_or(Family::JOINT, Family::of_outcome)
    }

    /// Returns the agent that may be influenced; `None` where it is an outcome with values.
    pub fn other_agent(&self, schema: &Schema) -> Option<usize> {
        Some(self.other).filter(|other| *other < schema.agents().len())
    }

    /// Returns the agent whose own action before is held fixed: the other, at a lag.
    fn own(&self, schema: &Schema) -> Option<usize> {
        self.later.and(self.other_agent(schema))
    }

    /// Returns whether anything is held fixed.
    pub fn is_conditional(&self, schema: &Schema) -> bool {
        !self.given.is_empty() || self.own(schema).is_some()
    }

    /// Returns whether a schema has it: another's, or one that was written, may be of no variables.
    pub fn is_of(&self, schema: &Schema) -> bool {
        let agents = 0..schema.agents().len();
        let outcome = self.later.map(|later| schema.outcomes().get(later));
        let is_other = match outcome {
            None => agents.contains(&self.other),
            Some(None) => false,
            Some(Some(outcome)) => {
                let value = self.later.map(|later| agents.end + later);
                outcome.agent.or(value) == Some(self.other)
            }
        };
        is_other
            && [self.ego]
                .iter()
                .chain(&self.given)
                .all(|agent| agents.contains(agent))
    }

    /// Returns whether a cell of its family tells of it: whether both acted.
    #[inline]
    pub fn is_told_by(&self, schema: &Schema, cell: &Cell) -> bool {
        if !schema.may_lack_actions() {
            return true;
        }
        let (joint, _) = schema.split(self.family(), cell.joint);
        let acted = |agent| schema.taken_action(joint, agent).is_some();
        // A later action is in the family's cells only where it was taken.
        acted(self.ego) && (self.later.is_some() || acted(self.other))
    }

    /// Returns the actions of ego and other in a cell that tells of them.
    #[inline]
    pub fn actions(&self, schema: &Schema, cell: &Cell) -> (u64, u64) {
        let (joint, later) = schema.split(self.family(), cell.joint);
        let other = match self.later {
            Some(_) => later,
            None => schema.action_of(joint, self.other),
        };
        (schema.action_of(joint, self.ego), other)
    }

    /// Returns the number of the stratum that a cell is in: what is held fixed, in order.
    pub fn stratum(&self, schema: &Schema, cell: &Cell) -> u64 {
        let (joint, _) = schema.split(self.family(), cell.joint);
        let fixed = self.given.iter().copied().chain(self.own(schema));
        fixed.fold(0, |stratum, agent| {
            let letters = schema.agents()[agent].letters();
            stratum * letters + schema.action_of(joint, agent)
        })
    }

    /// Returns how many actions the two have, or values; rows for the ego.
    pub fn alphabet(&self, schema: &Schema) -> Alphabet {
        let actions = |agent: usize| schema.agents()[agent].actions();
        let values = |outcome: usize| schema.outcomes()[outcome].values();
        Alphabet {
            rows: actions(self.ego),
            columns: self.later.map_or_else(|| actions(self.other), values),
        }
    }

    /// Returns the name of the variable that may be influenced: an agent's own at a lag too.
    pub fn name_of_other<'a>(&self, schema: &'a Schema) -> &'a str {
        match (self.other_agent(schema), self.later) {
            (None, Some(later)) => schema.outcomes()[later].name.as_str(),
            _ => schema.agents()[self.other].name.as_str(),
        }
    }

    /// Finds the variables that are named, or lists every fault.
    pub fn named(schema: &Schema, draft: &PairDraft) -> Result<Self, Vec<Fault>> {
        pair(schema, draft)
    }

    /// Finds the agents whose actions a network is of, the first two where none is named, the other's
    /// so many steps later, or lists every fault.
    pub fn of_network(
        schema: &Schema,
        ego: Option<String>,
        other: Option<String>,
        lag: i64,
    ) -> Result<Self, Vec<Fault>> {
        let draft = PairDraft {
            ego,
            other,
            lag,
            ..PairDraft::default()
        };
        let pair = Self::named(schema, &draft)?;
        if pair.other_agent(schema).is_some() {
            return Ok(pair);
        }

        let agents: Vec<&str> = schema
            .agents()
            .iter()
            .map(|agent| agent.name.as_str())
            .collect();
        let detail = format!(
            "got {:?}, which is an outcome with values: networks are of actions, expected one of {}",
            pair.name_of_other(schema),
            agents.join(", ")
        );
        Err(vec![Fault::new("/other", detail)])
    }

    /// Returns every pair of agents, the earlier as the ego.
    pub fn every(schema: &Schema) -> Vec<Self> {
        let agents = schema.agents().len();
        let later = |ego| (ego + 1..agents).map(move |other| Self::new(ego, other, Vec::new()));
        (0..agents).flat_map(later).collect()
    }

    /// Returns every pair of agents with the other's action at a lag, in both directions, as far as
    /// that is an outcome; at lag 0 [`Pair::every`].
    pub fn every_at_lag(schema: &Schema, lag: u32) -> Vec<Self> {
        if lag == 0 {
            return Self::every(schema);
        }
        let agents = 0..schema.agents().len();
        let ordered = agents.clone().flat_map(|ego| {
            let others = agents.clone().filter(move |other| *other != ego);
            others.map(move |other| Self::new(ego, other, Vec::new()))
        });
        ordered
            .filter_map(|pair| pair.at_lag(schema, lag))
            .collect()
    }

    /// Returns the pair that can have the most mutual information, of equal ones the first.
    pub fn widest(schema: &Schema) -> Self {
        Self::widest_of(schema, &Self::every(schema))
    }

    /// Returns the same of some, at least one.
    pub fn widest_of(schema: &Schema, pairs: &[Self]) -> Self {
        let by_reach = |pair: &Self| {
            let Alphabet { rows, columns } = pair.alphabet(schema);
            std::cmp::Reverse(rows.min(columns))
        };
        let widest = pairs.iter().min_by_key(|pair| by_reach(pair));
        widest.cloned().expect("there are two agents at least")
    }

    /// Returns the same pair with the earlier agent as the ego: mutual information is symmetric,
    /// and so is what is fitted to it. One with a later action has its direction.
    pub fn undirected(&self) -> Self {
        if self.later.is_some() {
            return self.clone();
        }
        Self {
            ego: self.ego.min(self.other),
            other: self.ego.max(self.other),
            given: self.given.clone(),
            later: None,
        }
    }
}

impl Counts {
    /// Returns the cells that tell of a pair, of the segments named, or of all.
    pub fn of_pair<'a>(
        &'a self,
        schema: &'a Schema,
        pair: &'a Pair,
        segments: Option<&'a [SegmentId]>,
    ) -> impl Iterator<Item = &'a Cell> + Clone {
        let cells = self.of_family_and_segments(pair.family(), segments);
        cells.filter(move |cell| pair.is_told_by(schema, cell))
    }
}

/// Returns the position of the outcome with values of that name.
fn value_named(schema: &Schema, name: &str) -> Option<usize> {
    let at = schema.outcome(name)?;
    schema.outcomes()[at].agent.is_none().then_some(at)
}

fn pair(schema: &Schema, draft: &PairDraft) -> Result<Pair, Vec<Fault>> {
    let mut faults = Vec::new();
    let value = draft
        .other
        .as_deref()
        .and_then(|name| value_named(schema, name));
    let mut agent = |pointer: String, name: &str| {
        let found = schema.agent(name);
        if found.is_none() {
            let detail = no_agent(schema, &pointer, name);
            faults.push(Fault::new(pointer, detail));
        }
        found
    };

    // The first two agents by default; where one of them is named, the absent one is the other of
    // the two.
    let (first, second) = (
        schema.agents()[0].name.as_str(),
        schema.agents()[1].name.as_str(),
    );
    let opposite = |named: &Option<String>, usual, instead| {
        if named.as_deref() == Some(usual) {
            instead
        } else {
            usual
        }
    };

    let ego = agent(
        "/ego".into(),
        draft
            .ego
            .as_deref()
            .unwrap_or(opposite(&draft.other, first, second)),
    );
    let other = match value {
        Some(value) => Some(schema.agents().len() + value),
        None => agent(
            "/other".into(),
            draft
                .other
                .as_deref()
                .unwrap_or(opposite(&draft.ego, second, first)),
        ),
    };

    let named = draft.given.iter().enumerate();
    let mut given: Vec<usize> = named
        .filter_map(|(i, name)| agent(format!("/given/{i}"), name))
        .collect();

    if let (Some(ego), Some(other)) = (ego, other) {
        if ego == other {
            let name = &schema.agents()[ego].name;
            faults.push(Fault::new(
                "/other",
                format!("got {name}, which is the ego too; expected another agent"),
            ));
        }

        for (i, agent) in given.iter().enumerate() {
            if *agent == ego || *agent == other || given[..i].contains(agent) {
                let name = &schema.agents()[*agent].name;
                faults.push(Fault::new(
                    format!("/given/{i}"),
                    format!("got {name}, expected neither ego nor other nor twice"),
                ));
            }
        }

        given.sort_unstable();
        let pair = match value {
            Some(value) => of_value_at_written_lag(schema, ego, value, given, draft.lag),
            None => at_written_lag(schema, &Pair::new(ego, other, given), draft.lag),
        };
        match pair.map_err(|fault| faults.push(fault)) {
            Ok(pair) if faults.is_empty() => return Ok(pair),
            _ => {}
        }
    }
    Err(faults)
}

/// Says why a name is none of an agent: what is observed later can be no ego, and an agent's later
/// action goes by the agent's name beside a lag.
fn no_agent(schema: &Schema, pointer: &str, name: &str) -> String {
    let agents = schema.agents().iter().map(|agent| agent.name.as_str());
    let values = schema
        .outcomes()
        .iter()
        .filter(|outcome| pointer == "/other" && outcome.agent.is_none())
        .map(|outcome| outcome.name.as_str());
    let names: Vec<&str> = agents.chain(values).collect();
    let expected = format!("expected one of {}", names.join(", "));

    let named = |outcome: &&Outcome| outcome.name == name;
    let Some(outcome) = schema.outcomes().iter().find(named) else {
        return format!("unknown agent {name:?}, {expected}");
    };
    let lag = outcome.lag;
    let after = if lag == 1 {
        "1 step".to_owned()
    } else {
        format!("{lag} steps")
    };
    match (pointer, outcome.agent) {
        ("/ego", _) => format!(
            "got {name:?}, which is observed {after} after the actions: what comes later influences nothing before it, {expected}"
        ),
        ("/other", Some(agent)) => {
            let agent = names[agent];
            format!("got {name:?}, expected {agent:?} with the lag {lag} beside it")
        }
        _ => format!("got {name:?}, which is an outcome and no agent, {expected}"),
    }
}

/// Returns a pair with the other's action at the lag that was written, if that is declared.
pub(super) fn at_written_lag(schema: &Schema, pair: &Pair, lag: i64) -> Result<Pair, Fault> {
    let declared = u32::try_from(lag)
        .ok()
        .and_then(|lag| pair.at_lag(schema, lag));
    declared.ok_or_else(|| Fault::new("/lag", no_lag(schema, pair, lag)))
}

/// Returns a pair with an outcome with values, which is observed at its own lag: 0 stands for that
/// too, as it cannot be told from none.
fn of_value_at_written_lag(
    schema: &Schema,
    ego: usize,
    value: usize,
    given: Vec<usize>,
    lag: i64,
) -> Result<Pair, Fault> {
    let outcome = &schema.outcomes()[value];
    let is_own = lag == 0 || lag == i64::from(outcome.lag);
    let wrong = || {
        let Outcome { name, lag: own, .. } = outcome;
        Fault::new(
            "/lag",
            format!("got {lag}, expected {own}, at which {name} is observed, or none"),
        )
    };
    is_own
        .then(|| Pair::of_value(schema, ego, value, given))
        .ok_or_else(wrong)
}

/// Says why nothing can be asked at a lag, and at which something can.
fn no_lag(schema: &Schema, pair: &Pair, lag: i64) -> String {
    let actions = schema.outcomes().iter();
    let mut lags: Vec<u32> = actions
        .filter(|outcome| outcome.agent == Some(pair.other))
        .map(|outcome| outcome.lag)
        .collect();
    lags.sort_unstable();

    let [ego, other] = [pair.ego, pair.other].map(|agent| schema.agents()[agent].name.as_str());
    let expected = match &lags[..] {
        [] => format!("expected 0: no later action of {other} is declared"),
        lags => {
            let lags: Vec<String> = lags.iter().map(ToString::to_string).collect();
            format!(
                "expected 0 or a lag that is declared for {other}: {}",
                lags.join(", ")
            )
        }
    };
    if lag < 0 {
        return format!(
            "got {lag}: {ego} would be observed after {other}, and what comes later influences nothing before it; {expected}. Exchange ego and other for the other direction"
        );
    }
    format!("got {lag}, {expected}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft, OutcomeDraft};

    /// Three agents, the first two of whose actions are declared at two lags, and a pot.
    fn kitchen() -> Schema {
        let feature = |name: &str| FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![KindDraft::Integer(0, 2)],
        };
        let agent = |name: &str| AgentDraft {
            name: name.into(),
            action: vec![feature("move")],
            ..AgentDraft::default()
        };
        let later = |agent: &str, lag| OutcomeDraft {
            agent: Some(agent.into()),
            lag: Some(lag),
            ..OutcomeDraft::default()
        };
        let pot = OutcomeDraft {
            name: "pot".into(),
            lag: Some(1),
            value: vec![feature("holds")],
            ..OutcomeDraft::default()
        };
        let outcomes = vec![later("b", 3), later("b", 2), later("a", 3), pot];
        Schema::try_from(&SchemaDraft {
            state: vec![feature("place")],
            agents: ["a", "b", "c"].map(agent).into(),
            outcomes,
            ..SchemaDraft::default()
        })
        .expect("valid")
    }

    fn asked(ego: &str, other: &str, lag: i64) -> Result<Pair, Vec<(String, String)>> {
        let draft = PairDraft {
            ego: Some(ego.into()),
            other: Some(other.into()),
            lag,
            ..PairDraft::default()
        };
        let told = |fault: Fault| (fault.pointer, fault.detail);
        Pair::named(&kitchen(), &draft).map_err(|faults| faults.into_iter().map(told).collect())
    }

    #[test]
    fn a_lag_is_one_that_is_declared_for_the_other() {
        let schema = kitchen();
        let pair = asked("a", "b", 3).expect("declared");
        assert_eq!((pair.later, pair.lag(&schema)), (Some(0), 3));
        assert_eq!(asked("a", "b", 0), Ok(Pair::new(0, 1, Vec::new())));
        assert_eq!(asked("c", "a", 3).expect("declared").later, Some(2));

        let refused = |ego, other, lag| asked(ego, other, lag).expect_err("wrong").remove(0);
        let at = |detail: &str| ("/lag".to_owned(), detail.to_owned());
        let b = "expected 0 or a lag that is declared for b: 2, 3";
        for lag in [1, 4, i64::MAX, 1 << 32] {
            assert_eq!(refused("a", "b", lag), at(&format!("got {lag}, {b}")));
        }
        assert_eq!(
            refused("a", "c", 3),
            at("got 3, expected 0: no later action of c is declared")
        );
        let (pointer, detail) = refused("a", "b", -3);
        assert_eq!(pointer, "/lag");
        assert!(
            detail.starts_with("got -3: a would be observed after b"),
            "{detail}"
        );
    }

    #[test]
    fn outcomes_are_told_from_agents() {
        let refused = |ego, other| asked(ego, other, 0).expect_err("wrong").remove(0);
        let expected = "expected one of a, b, c";
        let cases = [
            (
                refused("b@3", "a"),
                "/ego",
                "got \"b@3\", which is observed 3 steps after the actions: what comes later influences nothing before it",
            ),
            (
                refused("pot", "a"),
                "/ego",
                "got \"pot\", which is observed 1 step after the actions: what comes later influences nothing before it",
            ),
        ];
        for ((pointer, detail), at, says) in cases {
            assert_eq!(
                (pointer.as_str(), detail),
                (at, format!("{says}, {expected}"))
            );
        }
        assert_eq!(
            refused("a", "b@9"),
            (
                "/other".into(),
                format!("unknown agent \"b@9\", {expected}, pot")
            )
        );
        assert_eq!(
            refused("a", "b@3"),
            (
                "/other".into(),
                "got \"b@3\", expected \"b\" with the lag 3 beside it".into()
            )
        );
    }

    #[test]
    fn networks_are_of_what_questions_are_of() {
        let network =
            |other: &str, lag| Pair::of_network(&kitchen(), None, Some(other.into()), lag);
        assert_eq!(network("b", 0), Ok(Pair::new(0, 1, Vec::new())));
        assert_eq!(network("b", 3), Ok(asked("a", "b", 3).expect("declared")));
        let pointer = |other, lag| network(other, lag).expect_err("wrong").remove(0).pointer;
        assert_eq!([pointer("b@3", 0), pointer("b", 1)], ["/other", "/lag"]);
    }

    #[test]
    fn an_outcome_with_values_is_asked_about_at_its_own_lag() {
        let schema = kitchen();
        let pot = schema.outcome("pot").expect("declared");
        let pair = asked("b", "pot", 0).expect("its own lag");
        assert_eq!(pair, asked("b", "pot", 1).expect("the same"));
        assert_eq!((pair.ego, pair.later, pair.lag(&schema)), (1, Some(pot), 1));
        assert_eq!(pair.other_agent(&schema), None);
        assert_eq!(pair.name_of_other(&schema), "pot");
        assert_eq!(
            (&pair.undirected(), pair.family()),
            (&pair, Family::of_outcome(pot))
        );
        assert!(!pair.is_conditional(&schema), "no action of its own before");
        assert_eq!(
            pair.alphabet(&schema),
            Alphabet {
                rows: 3,
                columns: 3
            }
        );
        assert!(
            asked("a", "b", 3)
                .expect("declared")
                .is_conditional(&schema)
        );

        for lag in [-1, 2, 3, i64::MAX] {
            let faults = asked("b", "pot", lag).expect_err("another lag");
            let detail = format!("got {lag}, expected 1, at which pot is observed, or none");
            assert_eq!(faults, [("/lag".to_owned(), detail)]);
        }

        // The ego is the first agent where none is named, and others can be held fixed.
        let draft = |given: &[&str]| PairDraft {
            other: Some("pot".into()),
            given: given.iter().map(ToString::to_string).collect(),
            ..PairDraft::default()
        };
        let pair = Pair::named(&schema, &draft(&["c", "b"])).expect("valid");
        assert_eq!((pair.ego, &pair.given), (0, &vec![1, 2]));
        assert!(pair.is_conditional(&schema));
        for wrong in ["a", "pot", "b@3"] {
            let faults = Pair::named(&schema, &draft(&["b", wrong])).expect_err("no agent else");
            assert_eq!(faults[0].pointer, "/given/1", "{wrong}");
        }
        let faults = Pair::of_network(&schema, None, Some("pot".into()), 1).expect_err("no action");
        assert_eq!(faults[0].pointer, "/other");
        let says = "networks are of actions, expected one of a, b, c";
        assert!(faults[0].detail.ends_with(says), "{:?}", faults[0]);
    }

    #[test]
    fn a_pair_that_was_written_may_be_of_no_variables() {
        let schema = kitchen();
        let pair = |ego, other, given: &[usize], later| Pair {
            later,
            ..Pair::new(ego, other, given.to_vec())
        };
        let [b3, pot] = [0, 3];
        for of in [
            pair(2, 0, &[1], None),
            pair(0, 1, &[2], Some(b3)),
            pair(0, 3 + pot, &[], Some(pot)),
        ] {
            assert!(of.is_of(&schema), "{of:?}");
        }
        for wrong in [
            pair(3, 0, &[], None),
            pair(0, 3, &[], None),
            pair(0, 1, &[3], None),
            pair(0, 2, &[], Some(b3)),
            pair(0, 1, &[], Some(pot)),
            pair(0, 3 + pot, &[], None),
            pair(0, 3 + b3, &[], Some(b3)),
            pair(0, 1, &[], Some(4)),
        ] {
            assert!(!wrong.is_of(&schema), "{wrong:?}");
        }
    }

    #[test]
    fn pairs_at_a_lag_have_a_direction() {
        let schema = kitchen();
        let ends = |lag| {
            let pairs = Pair::every_at_lag(&schema, lag).into_iter();
            pairs.map(|pair| (pair.ego, pair.other)).collect::<Vec<_>>()
        };
        assert_eq!(ends(0), [(0, 1), (0, 2), (1, 2)]);
        assert_eq!(ends(3), [(0, 1), (1, 0), (2, 0), (2, 1)]);
        assert_eq!(ends(2), [(0, 1), (2, 1)]);
        assert_eq!(ends(1), []);
    }
}
