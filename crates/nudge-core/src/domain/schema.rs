//! The fixed part of an environment: its state, its agents, its outcomes, and their arithmetic. A
//! [`Schema`] cannot be wrong.

use std::sync::Arc;

use super::checked::{self, Faults};
use super::draft::DescriptionDraft;
use super::{Agent, Feature, FeatureKind, Outcome, SchemaDraft, SchemaHash, StateKey};
use crate::error::Fault;

/// The state, the agents and the outcomes of an environment. Cloning is cheap.
#[derive(Debug, Clone, PartialEq)]
pub struct Schema(Arc<Parts>);

#[derive(Debug, PartialEq)]
struct Parts {
    state: Vec<Feature>,
    agents: Vec<Agent>,
    outcomes: Vec<Outcome>,
    /// For each outcome the position of the one whose value is in its cells instead of the agent's
    /// action now.
    befores: Vec<Option<usize>>,
    /// Joint actions per step of each agent's action, and its number of letters: the first agent is
    /// most significant.
    radix: Vec<(u64, u64)>,
    may_lack_actions: bool,
    /// How many cells a state can have of each family, in order of their numbers.
    cells: Vec<u64>,
    /// The kinds of all action features, agent after agent: what the discretiser runs over.
    action_kinds: Vec<FeatureKind>,
    hash: SchemaHash,
}

impl Schema {
    /// Returns the coordinates of the state.
    pub fn state(&self) -> &[Feature] {
        &self.0.state
    }

    /// Returns the agents.
    pub fn agents(&self) -> &[Agent] {
        &self.0.agents
    }

    /// Returns the position of the agent of that name.
    pub fn agent(&self, name: &str) -> Option<usize> {
        self.agents()
            .iter()
            .position(|agent| agent.name.as_str() == name)
    }

    /// Returns what is observed some steps later.
    pub fn outcomes(&self) -> &[Outcome] {
        &self.0.outcomes
    }

    /// Returns the position of the outcome of that name.
    pub fn outcome(&self, name: &str) -> Option<usize> {
        self.outcomes()
            .iter()
            .position(|outcome| outcome.name == name)
    }

    /// Returns the position of the outcome that an agent's action is some steps later.
    pub fn action_at(&self, agent: usize, lag: u32) -> Option<usize> {
        self.outcomes()
            .iter()
            .position(|outcome| outcome.agent == Some(agent) && outcome.lag == lag)
    }

    pub(super) fn cells(&self) -> &[u64] {
        &self.0.cells
    }

    pub(super) fn befores(&self) -> &[Option<usize>] {
        &self.0.befores
    }

    /// Returns whether an agent may be absent from a transition.
    pub fn may_lack_actions(&self) -> bool {
        self.0.may_lack_actions
    }

    /// Returns every action feature, agent after agent: the order of positional action values.
    pub fn action_features(&self) -> impl Iterator<Item = (&Agent, &Feature)> {
        self.agents()
            .iter()
            .flat_map(|agent| agent.action.iter().map(move |feature| (agent, feature)))
    }

    /// Returns every feature of an outcome's value, outcome after outcome: the order of positional
    /// outcome values.
    pub fn outcome_features(&self) -> impl Iterator<Item = (&Outcome, &Feature)> {
        self.outcomes()
            .iter()
            .flat_map(|outcome| outcome.value.iter().map(move |feature| (outcome, feature)))
    }

    /// Returns how many action values a transition has.
    pub fn action_width(&self) -> usize {
        self.0.action_kinds.len()
    }

    /// Returns the kinds of all action features, agent after agent.
    pub(super) fn action_kinds(&self) -> &[FeatureKind] {
        &self.0.action_kinds
    }

    /// Returns how many joint actions there are, those from which agents are absent too; at most
    /// 2^62.
    pub fn joint_actions(&self) -> u64 {
        self.0.cells[0]
    }

    /// Returns the joint action of one value an action feature, where all agents act: mixed radix
    /// over all of them, the first most significant. `None` where a value has no bin.
    pub fn joint_action(&self, values: &[f32]) -> Option<u64> {
        let mut values = values.iter();
        self.agents().iter().try_fold(0, |joint, agent| {
            let mut features = agent.action.iter().zip(values.by_ref());
            let action = features.try_fold(0, |action, (feature, value)| {
                let bin = feature.kind.bin(*value).ok()?;
                Some(action * u64::from(feature.kind.bins()) + u64::from(bin))
            })?;
            Some(joint * agent.letters() + action)
        })
    }

    /// Returns how many joint actions lie between neighbouring actions of an agent.
    pub(super) fn stride(&self, agent: usize) -> u64 {
        self.0.radix[agent].0
    }

    /// Returns what tells this schema from any other.
    pub fn hash(&self) -> SchemaHash {
        self.0.hash
    }

    /// Returns the action of one agent in a joint action; [`Agent::absence`] where it took none.
    #[inline]
    pub fn action_of(&self, joint: u64, agent: usize) -> u64 {
        // Divisions are what this costs, and the first and the last agent each need but one.
        let (stride, actions) = self.0.radix[agent];
        let rest = if stride == 1 { joint } else { joint / stride };
        if agent == 0 { rest } else { rest % actions }
    }

    /// Returns the action that one agent took in a joint action; `None` where it was absent.
    #[inline]
    pub fn taken_action(&self, joint: u64, agent: usize) -> Option<u64> {
        let action = self.action_of(joint, agent);
        (action != self.agents()[agent].absence()).then_some(action)
    }

    /// Returns every agent's action in a joint action.
    pub fn actions_of(&self, joint: u64) -> Vec<u64> {
        (0..self.agents().len())
            .map(|agent| self.action_of(joint, agent))
            .collect()
    }

    /// Returns the key of a state given as one value a feature, or every fault.
    pub fn key_of_values(&self, values: &[f32]) -> Result<StateKey, Vec<Fault>> {
        if values.len() != self.state().len() {
            let detail = format!(
                "got {} values, expected {}",
                values.len(),
                self.state().len()
            );
            return Err(vec![Fault::new("", detail)]);
        }

        let mut faults = Vec::new();
        let mut bins = Vec::with_capacity(values.len());
        for (feature, &value) in self.state().iter().zip(values) {
            match feature.kind.bin(value) {
                Ok(bin) => bins.push(bin),
                Err(error) => {
                    faults.push(Fault::new(format!("/{}", feature.name), error.to_string()))
                }
            }
        }

        if faults.is_empty() {
            Ok(StateKey::new(&bins))
        } else {
            Err(faults)
        }
    }

    /// Returns the key written as `text`, `3.0.7`, or what is wrong with it.
    pub fn key_of_text(&self, text: &str) -> Result<StateKey, String> {
        let parts: Vec<&str> = text.split('.').collect();
        if parts.len() != self.state().len() {
            return Err(format!(
                "got {text:?}, expected {} bin numbers joined by dots",
                self.state().len()
            ));
        }

        let bin = |(part, feature): (&&str, &Feature)| {
            let bin: Option<u32> = part.parse().ok().filter(|bin| *bin < feature.kind.bins());
            bin.filter(|bin| bin.to_string() == **part).ok_or_else(|| {
                let last = feature.kind.bins() - 1;
                format!(
                    "got {part:?} for {} in {text:?}, expected a bin from 0 to {last}",
                    feature.name
                )
            })
        };

        let bins: Vec<u32> = parts
            .iter()
            .zip(self.state())
            .map(bin)
            .collect::<Result<_, _>>()?;
        Ok(StateKey::new(&bins))
    }

    /// Returns this schema as it would be described, for people and files.
    pub fn draft(&self) -> SchemaDraft {
        checked::draft_of(self.state(), self.agents(), self.outcomes())
    }
}

impl Schema {
    /// Returns the schema that a description means; `kept` is the hash of the one that its name has
    /// already. Lists every fault by pointer.
    ///
    /// Angles were radians whatever their unit said, before units were read. A description from
    /// that time is known by the hash that it says it has, or that is kept, and stays what it was.
    pub fn described(
        draft: &DescriptionDraft,
        kept: Option<SchemaHash>,
    ) -> Result<Self, Vec<Fault>> {
        let wrong = |detail: String| vec![Fault::new("/schema_hash", detail)];
        let said: Option<SchemaHash> = draft
            .schema_hash
            .as_deref()
            .map(str::parse)
            .transpose()
            .map_err(wrong)?;

        if let Some(old) = said
            .or(kept)
            .and_then(|hash| Self::in_radians(&draft.schema, hash))
        {
            return Ok(old);
        }

        let schema = Self::try_from(&draft.schema)?;
        match (said, schema.hash()) {
            (Some(said), found) if said != found => Err(wrong(format!(
                "got {said}, and what is described has {found}: leave it out of a description that was changed"
            ))),
            _ => Ok(schema),
        }
    }

    fn in_radians(draft: &SchemaDraft, hash: SchemaHash) -> Option<Self> {
        Self::try_from(&draft.in_radians())
            .ok()
            .filter(|schema| schema.hash() == hash)
    }
}

impl TryFrom<&SchemaDraft> for Schema {
    type Error = Vec<Fault>;

    /// Checks a description and lists every fault by pointer.
    fn try_from(draft: &SchemaDraft) -> Result<Self, Vec<Fault>> {
        let mut faults = Faults::default();
        let state = checked::state_features(&draft.state, &mut faults);
        let agents = checked::agents(&draft.agents, &mut faults);
        checked::one_namespace(draft, &mut faults);
        let strides = checked::strides(&agents, &mut faults);
        let outcomes = checked::outcomes(draft, &agents, &mut faults);
        faults.into_result()?;

        let hash = super::hash::schema_hash(&state, &agents, &outcomes);
        let befores = outcomes
            .iter()
            .map(|outcome| before(&outcomes, outcome))
            .collect();

        let joint: u64 = agents.iter().map(Agent::letters).product();
        let values = outcomes.iter().map(Outcome::values);
        let cells = std::iter::once(1)
            .chain(values)
            .map(|values| joint * values)
            .collect();

        let radix = strides
            .into_iter()
            .zip(agents.iter().map(Agent::letters))
            .collect();
        let action_kinds = agents
            .iter()
            .flat_map(|agent| &agent.action)
            .map(|feature| feature.kind.clone())
            .collect();

        let may_lack_actions = agents.iter().any(|agent| agent.may_be_absent);
        Ok(Self(Arc::new(Parts {
            state,
            agents,
            outcomes,
            befores,
            radix,
            may_lack_actions,
            cells,
            action_kinds,
            hash,
        })))
    }
}

/// Returns the position of the same agent's action one step before.
fn before(outcomes: &[Outcome], outcome: &Outcome) -> Option<usize> {
    let agent = outcome.agent?;
    outcomes
        .iter()
        .position(|one| one.agent == Some(agent) && one.lag + 1 == outcome.lag)
}

#[cfg(test)]
mod tests {
    use super::super::draft::{AgentDraft, FeatureDraft, KindDraft};
    use super::*;

    fn feature(name: &str, kind: KindDraft) -> FeatureDraft {
        FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![kind],
        }
    }

    fn labels(labels: &[&str]) -> KindDraft {
        KindDraft::Categorical(labels.iter().map(|l| l.to_string()).collect())
    }

    fn hallway() -> SchemaDraft {
        let turn = feature("turn", KindDraft::Continuous(vec![-0.2, 0.2]));
        let speed = feature("speed", labels(&["slow", "fast"]));
        SchemaDraft {
            state: vec![
                feature("distance", KindDraft::Continuous(vec![0.5, 0.7, 1.0])),
                feature("lane", KindDraft::Integer(0, 3)),
            ],
            agents: vec![
                AgentDraft {
                    name: "robot".into(),
                    action: vec![turn, speed],
                    ..AgentDraft::default()
                },
                AgentDraft {
                    name: "human".into(),
                    action: vec![feature("move", labels(&["stay", "go", "wave"]))],
                    ..AgentDraft::default()
                },
            ],
            ..SchemaDraft::default()
        }
    }

    #[test]
    fn a_joint_action_comes_apart_again() {
        let schema = Schema::try_from(&hallway()).expect("valid");
        assert_eq!(schema.agents()[0].actions(), 6);
        assert_eq!(schema.agents()[0].action_label(3), "[-0.2, 0.2)/fast");
        assert_eq!(schema.actions_of(3 * 3 + 2), [3, 2]);
    }

    #[test]
    fn values_and_keys_name_the_same_state() {
        let schema = Schema::try_from(&hallway()).expect("valid");
        let key = schema.key_of_values(&[0.7, 3.0]).expect("valid");
        assert_eq!(key.to_string(), "2.3");
        assert_eq!(schema.key_of_text("2.3"), Ok(key));
        for bad in ["2", "2.3.1", "4.0", "02.3", "+2.3", "", "a.b", "2.-1"] {
            assert!(schema.key_of_text(bad).is_err(), "{bad}");
        }
        let faults = schema
            .key_of_values(&[f32::NAN, 1.5])
            .expect_err("both wrong");
        assert_eq!(
            faults
                .iter()
                .map(|f| f.pointer.as_str())
                .collect::<Vec<_>>(),
            ["/distance", "/lane"]
        );
    }

    #[test]
    fn a_description_comes_back_as_it_was() {
        let draft = hallway();
        let schema = Schema::try_from(&draft).expect("valid");
        let again = Schema::try_from(&schema.draft()).expect("valid");
        assert_eq!((again.hash(), again), (schema.hash(), schema));
    }

    #[test]
    fn the_hash_tells_schemas_apart() {
        let base = Schema::try_from(&hallway()).expect("valid").hash();
        let mut other = hallway();
        other.state[0].kinds = vec![KindDraft::Continuous(vec![0.5, 0.7, 1.5])];
        assert_ne!(Schema::try_from(&other).expect("valid").hash(), base);
        other = hallway();
        other.agents.swap(0, 1);
        assert_ne!(Schema::try_from(&other).expect("valid").hash(), base);
        assert_eq!(base.to_string().parse(), Ok(base));
    }

    #[test]
    fn every_fault_of_a_description_is_listed_by_pointer() {
        let mut draft = hallway();
        draft.state[0].kinds = vec![KindDraft::Continuous(vec![1.0, 0.5, f64::NAN])];
        draft.state[1].name = "Robot".into();
        draft
            .state
            .push(feature("robot", KindDraft::Circular(0, None)));
        draft.agents[1].action[0].kinds = vec![labels(&["a", "a", ""])];
        draft.agents[0].action[1].kinds.clear();
        let faults = Schema::try_from(&draft).expect_err("wrong");
        let pointers: Vec<&str> = faults.iter().map(|f| f.pointer.as_str()).collect();
        assert_eq!(
            pointers,
            [
                "/state/0/continuous/edges/1",
                "/state/0/continuous/edges/2",
                "/state/1/name",
                "/state/2/circular/bins",
                "/agents/0/action/1",
                "/agents/1/action/0/categorical/labels/1",
                "/agents/1/action/0/categorical/labels/2",
                "/agents/0/name",
            ]
        );
    }

    #[test]
    fn edges_that_are_one_f32_do_not_increase() {
        let mut draft = hallway();
        draft.state[0].kinds = vec![KindDraft::Continuous(vec![0.7, 0.700_000_001])];
        assert!(Schema::try_from(&draft).is_err());
    }

    #[test]
    fn the_joint_alphabet_has_a_limit() {
        let mut draft = hallway();
        let wide = || feature("x", KindDraft::Integer(0, (1 << 21) - 1));
        draft.agents = (0..3)
            .map(|i| AgentDraft {
                name: format!("a{i}"),
                action: vec![wide()],
                ..AgentDraft::default()
            })
            .collect();
        let faults = Schema::try_from(&draft).expect_err("2^63 joint actions");
        assert_eq!(faults[0].pointer, "/agents");
        draft.agents[0].action[0].kinds = vec![KindDraft::Integer(0, (1 << 20) - 1)];
        assert!(Schema::try_from(&draft).is_ok(), "2^62 joint actions");
    }
    fn angle(unit: Option<&str>, values: Option<&str>) -> SchemaDraft {
        let mut draft = hallway();
        draft.state[0].unit = unit.map(Into::into);
        draft.state[0].kinds = vec![KindDraft::Circular(8, values.map(Into::into))];
        draft
    }

    #[test]
    fn the_unit_of_an_angle_says_how_it_is_measured() {
        let bin = |draft: SchemaDraft| {
            Schema::try_from(&draft)
                .map(|schema| schema.state()[0].kind.bin(90.0).expect("an angle"))
        };
        // 90 radians are 14.3 turns.
        for (unit, values) in [
            (None, None),
            (Some("rad"), None),
            (Some("radians"), None),
            (Some("deg"), Some("radians")),
        ] {
            assert_eq!(bin(angle(unit, values)), Ok(3), "{unit:?} {values:?}");
        }
        for (unit, values) in [
            (Some("deg"), None),
            (Some("degrees"), None),
            (Some("°"), None),
            (None, Some("degrees")),
        ] {
            assert_eq!(bin(angle(unit, values)), Ok(2), "{unit:?} {values:?}");
        }
        assert_eq!(
            bin(angle(Some("turns"), Some("radians"))),
            Ok(3),
            "what it says itself counts"
        );
        for (unit, values, pointer) in [
            (Some("turns"), None, "/state/0/unit"),
            (Some("Deg"), None, "/state/0/unit"),
            (Some("rad"), Some("degrees"), "/state/0/unit"),
            (Some("turns"), Some("degrees"), "/state/0/unit"),
            (None, Some("turns"), "/state/0/circular/values"),
        ] {
            let faults = bin(angle(unit, values)).expect_err("no angle");
            assert_eq!(
                faults
                    .iter()
                    .map(|fault| fault.pointer.as_str())
                    .collect::<Vec<_>>(),
                [pointer]
            );
        }
    }

    #[test]
    fn every_angle_describes_itself() {
        for (unit, values, told) in [
            (None, None, None),
            (Some("rad"), Some("radians"), None),
            (Some("deg"), None, Some("degrees")),
            (None, Some("degrees"), Some("degrees")),
            (Some("deg"), Some("radians"), Some("radians")),
            (Some("turns"), Some("radians"), Some("radians")),
        ] {
            let schema = Schema::try_from(&angle(unit, values)).expect("valid");
            assert_eq!(
                schema.draft().state[0].kinds,
                [KindDraft::Circular(8, told.map(Into::into))]
            );
            assert_eq!(
                Schema::try_from(&schema.draft()).expect("valid").hash(),
                schema.hash()
            );
        }
        let hash = |draft| Schema::try_from(&draft).expect("valid").hash();
        assert_ne!(
            hash(angle(Some("deg"), None)),
            hash(angle(Some("deg"), Some("radians")))
        );
    }

    #[test]
    fn what_was_described_before_units_were_read_is_known_by_its_hash() {
        let (deg, turns) = (angle(Some("deg"), None), angle(Some("turns"), None));
        let old =
            |draft: &SchemaDraft| Schema::try_from(&draft.in_radians()).expect("valid").hash();
        let described = |schema: &SchemaDraft, said: Option<String>, kept: Option<SchemaHash>| {
            let draft = DescriptionDraft {
                schema: schema.clone(),
                schema_hash: said,
                ..DescriptionDraft::default()
            };
            Schema::described(&draft, kept).map(|schema| schema.hash())
        };
        for draft in [&deg, &turns] {
            assert_eq!(described(draft, None, Some(old(draft))), Ok(old(draft)));
            assert_eq!(
                described(draft, Some(old(draft).to_string()), None),
                Ok(old(draft))
            );
        }
        let new = Schema::try_from(&deg).expect("valid").hash();
        assert_eq!(described(&deg, None, None), Ok(new));
        assert_eq!(described(&deg, None, Some(new)), Ok(new));
        assert_eq!(
            described(&deg, Some(new.to_string()), Some(old(&deg))),
            Ok(new)
        );
        assert!(described(&turns, None, Some(new)).is_err());
        for said in ["", "0", &"f".repeat(64)] {
            let faults = described(&deg, Some(said.into()), None).expect_err("another hash");
            assert_eq!(faults[0].pointer, "/schema_hash");
        }
    }
}
