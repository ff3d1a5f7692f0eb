//! An environment as somebody described it, before it has been checked. Every face decodes to this;
//! [`super::Schema`] is what comes of it.

use crate::error::{ErrorKind, Problem};

/// An environment as somebody described it, or as a service told it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DescriptionDraft {
    /// Its state and its agents.
    pub schema: SchemaDraft,
    /// The hash that it says state and agents have, because a service wrote it.
    pub schema_hash: Option<String>,
    /// Its derived features: absent, they are kept as they are.
    pub derived: Option<Vec<DerivedDraft>>,
    /// Its rule.
    pub rule: Option<RuleDraft>,
}

/// What is to be changed of an environment; what is absent is kept.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ChangeDraft {
    /// The parts of its rule.
    pub rule: Option<RuleDraft>,
    /// All of its derived features.
    pub derived: Option<Vec<DerivedDraft>>,
}

impl From<&SchemaDraft> for DescriptionDraft {
    fn from(schema: &SchemaDraft) -> Self {
        schema.clone().into()
    }
}

impl From<SchemaDraft> for DescriptionDraft {
    fn from(schema: SchemaDraft) -> Self {
        Self {
            schema,
            ..Self::default()
        }
    }
}

/// What is fixed of an environment, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SchemaDraft {
    /// The coordinates of the state, in order.
    pub state: Vec<FeatureDraft>,
    /// The agents, in order.
    pub agents: Vec<AgentDraft>,
    /// What is observed some steps later, in order; behind what `lags` stands for.
    pub outcomes: Vec<OutcomeDraft>,
    /// Short for an outcome for each agent's action at each of these lags: agent after agent, lags
    /// rising.
    pub lags: Vec<i64>,
}

impl SchemaDraft {
    /// The most bytes of a new description, as [`SchemaDraft::bytes`] counts them.
    pub const MOST_BYTES: usize = 1 << 20;

    /// Returns how large a description is: the bytes of its names, units and labels and 8 for each
    /// edge, with 3 more for each text and 16 for each feature. About what it takes on the wire.
    pub fn bytes(&self) -> usize {
        let text = |text: &String| text.len() + 3;
        let kind = |kind: &KindDraft| match kind {
            KindDraft::Continuous(edges) => 8 * edges.len(),
            KindDraft::Categorical(labels) => labels.iter().map(text).sum(),
            KindDraft::Circular(..) | KindDraft::Integer(..) => 0,
        };

        let feature = |feature: &FeatureDraft| {
            let kinds: usize = feature.kinds.iter().map(kind).sum();
            16 + text(&feature.name) + feature.unit.as_ref().map_or(0, text) + kinds
        };

        let agent = |agent: &AgentDraft| {
            text(&agent.name) + agent.action.iter().map(feature).sum::<usize>()
        };

        let outcome = |outcome: &OutcomeDraft| {
            let named = text(&outcome.name) + outcome.agent.as_ref().map_or(0, text);
            named + outcome.value.iter().map(feature).sum::<usize>()
        };
        // As large as what they stand for.
        let lagged = |agent: &AgentDraft| self.lags.len() * 2 * text(&agent.name);

        self.state.iter().map(feature).sum::<usize>()
            + self.agents.iter().map(agent).sum::<usize>()
            + self.outcomes.iter().map(outcome).sum::<usize>()
            + self.agents.iter().map(lagged).sum::<usize>()
    }

    /// Refuses a description that is larger than a new one may be.
    pub fn within_bytes(&self) -> Result<(), Problem> {
        let (bytes, limit) = (self.bytes(), Self::MOST_BYTES);
        if bytes <= limit {
            return Ok(());
        }
        let message = format!(
            "the description has {bytes} bytes of names, units, labels and edges, more than the limit of {limit}: use fewer labels and edges, or shorter ones"
        );
        let problem = Problem::new(ErrorKind::TooLarge, "DESCRIPTION_TOO_LARGE", message);
        Err(problem.with("bytes", bytes).with("limit_bytes", limit))
    }

    /// Returns what this description meant before angles had units: radians, unless it says
    /// otherwise by more than a unit.
    pub fn in_radians(&self) -> Self {
        let mut draft = self.clone();
        let actions = draft.agents.iter_mut().flat_map(|agent| &mut agent.action);

        for kind in draft
            .state
            .iter_mut()
            .chain(actions)
            .flat_map(|feature| &mut feature.kinds)
        {
            if let KindDraft::Circular(_, values) = kind {
                values.get_or_insert_with(|| super::Angle::Radians.as_str().into());
            }
        }
        draft
    }
}

/// An agent, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AgentDraft {
    /// Its name.
    pub name: String,
    /// The coordinates of its action, in order.
    pub action: Vec<FeatureDraft>,
    /// Whether a transition may be without its action.
    pub may_be_absent: bool,
}

/// An outcome, unchecked: exactly one of `agent` and `value` is expected.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OutcomeDraft {
    /// Its name; empty for the usual one of an agent's action.
    pub name: String,
    /// The agent whose action it is.
    pub agent: Option<String>,
    /// How many steps after the joint action it is observed.
    pub lag: Option<i64>,
    /// The coordinates of its value, in order.
    pub value: Vec<FeatureDraft>,
}

/// A feature, unchecked: exactly one kind is expected.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FeatureDraft {
    /// Its name.
    pub name: String,
    /// The unit of its values, for people; that of a circular feature says how angles are measured,
    /// unless its kind does.
    pub unit: Option<String>,
    /// The kinds that were given.
    pub kinds: Vec<KindDraft>,
}

/// A kind of feature, unchecked.
#[derive(Debug, Clone, PartialEq)]
pub enum KindDraft {
    /// Edges, which are rounded to f32 here and must still increase.
    Continuous(Vec<f64>),
    /// The number of bins, and what values are measured in: `radians` or `degrees`, by the
    /// feature's unit if absent.
    Circular(i64, Option<String>),
    /// The smallest and the largest value.
    Integer(i64, i64),
    /// The labels.
    Categorical(Vec<String>),
}

/// A derived feature, unchecked: exactly one kind is expected.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DerivedDraft {
    /// Its name.
    pub name: String,
    /// The kinds that were given.
    pub kinds: Vec<DerivedKindDraft>,
}

/// A kind of derived feature, unchecked: names of features of the state, of which two are expected.
#[derive(Debug, Clone, PartialEq)]
pub enum DerivedKindDraft {
    /// The first less the second.
    Difference(Vec<String>),
    /// The sum of the absolute differences of pairs.
    Manhattan(Vec<Vec<String>>),
    /// Whether both are the same.
    Equal(Vec<String>),
}

/// A rule, or the part of one that was given.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RuleDraft {
    /// `evidence` or `paper`.
    pub kind: Option<String>,
    /// In `unit` where one is given beside it, else in the unit of the rule it is merged over.
    pub threshold: Option<f64>,
    /// The same as a share of the largest mutual information that a pair can have, instead of
    /// `threshold`.
    pub share: Option<f64>,
    /// `nats` or `bits`.
    pub unit: Option<String>,
    /// Visits below which the paper's rule stays undecided.
    pub min_visits: Option<u64>,
    /// Probability from which the evidence rule decides.
    pub confidence: Option<f64>,
    /// Names of the estimators that answers tell.
    pub estimators: Option<Vec<String>>,
    /// Segments in which agents explored.
    pub exploration: Option<Vec<String>>,
}

/// A value of a feature, as it was written.
#[derive(Debug, Clone, PartialEq)]
pub enum ValueDraft {
    /// A number.
    Number(f64),
    /// True or false.
    Truth(bool),
    /// Text, also from a place that knows no types, such as a query string: it reads the same.
    Text(String),
    /// A whole number that a double would round, digit by digit: it reads as the same text does.
    Digits(String),
    /// Something that no feature can take, as it was written.
    Other(String),
}

/// The values of features by name, in the order in which they were written.
pub type NamedValues = Vec<(String, ValueDraft)>;

/// An agent's action, or the value of an outcome, as it was written.
#[derive(Debug, Clone, PartialEq)]
pub enum ActionDraft {
    /// None: it was not taken, or not observed.
    Absent,
    /// The only feature's value.
    Bare(ValueDraft),
    /// A value a feature.
    Named(NamedValues),
}

/// A region, unchecked: what each of some features may be, by name, in the order in which it was
/// written. Without any it is the whole environment.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RegionDraft(pub Vec<(String, ConditionDraft)>);

/// What a feature may be in a region, unchecked.
#[derive(Debug, Clone, PartialEq)]
pub enum ConditionDraft {
    /// What one value is, a label or a number.
    One(ValueDraft),
    /// What any of these values is.
    AnyOf(Vec<ValueDraft>),
    /// What lies between two values.
    Between(RangeDraft),
    /// Any of these bins, by their numbers from 0.
    Bins(Vec<ValueDraft>),
}

/// A range of values, unchecked: open at an end that is absent.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RangeDraft {
    /// The first value in it.
    pub from: Option<ValueDraft>,
    /// The last value in it.
    pub to: Option<ValueDraft>,
    /// The first value that is not in it any more, instead of `to`.
    pub below: Option<ValueDraft>,
}

/// The states of a question, unchecked.
#[derive(Debug, Clone, PartialEq)]
pub enum StatesDraft {
    /// A value a feature, in the environment's order.
    Positional(Vec<Vec<f32>>),
    /// Values by name.
    Named(Vec<NamedValues>),
    /// Keys, `3.0.7`.
    Keys(Vec<String>),
    /// Regions, each of which is asked about as one.
    Regions(Vec<RegionDraft>),
    /// The same of one, whose faults are below `/region`.
    Region(RegionDraft),
}

impl StatesDraft {
    /// Returns how many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Positional(states) => states.len(),
            Self::Named(states) => states.len(),
            Self::Keys(keys) => keys.len(),
            Self::Regions(regions) => regions.len(),
            Self::Region(_) => 1,
        }
    }

    /// Returns whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Default for StatesDraft {
    fn default() -> Self {
        Self::Keys(Vec::new())
    }
}

/// Whose habits weigh the ego's actions, unchecked.
#[derive(Debug, Clone, PartialEq)]
pub enum PolicyDraft {
    /// `observed` or `uniform`.
    Word(String),
    /// Those of segments.
    Segments(Vec<String>),
}

/// Which figures of which pair, unchecked: what every question about influence has in common.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PairDraft {
    /// The agent whose influence is asked about; the first one if absent.
    pub ego: Option<String>,
    /// The agent that may be influenced; the second one if absent.
    pub other: Option<String>,
    /// How many steps later the other's action is observed; 0 for the same tick.
    pub lag: i64,
    /// Agents whose actions are held fixed.
    pub given: Vec<String>,
    /// The segments to count; all if empty.
    pub segments: Vec<String>,
    /// `auto` (default), `segments` or `pooled`.
    pub within: Option<String>,
    /// Whose habits weigh the ego's actions; those observed if absent.
    pub policy: Option<PolicyDraft>,
    /// The parts of the rule that differ from the environment's.
    pub rule: RuleDraft,
    /// The unit of the answer's figures.
    pub unit: Option<String>,
}

/// A question about influence, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct QuestionDraft {
    /// Whose influence on whom, from which counts, by which rule.
    pub pair: PairDraft,
    /// The states, or the regions, that are asked about.
    pub states: StatesDraft,
    /// The grain of regions: coordinates that are kept; all features if empty.
    pub features: Vec<String>,
    /// Names of further estimators of mutual information.
    pub estimators: Vec<String>,
    /// `verdict`, `figures` or `full`.
    pub view: Option<String>,
    /// `auto`, `pooled` or `within_segments`; absent for no test of independence.
    pub significance: Option<String>,
    /// Whether it is wanted how many more visits a verdict would take.
    pub visits_to_decide: bool,
}

/// How a network is to be trained, unchecked; what is absent has its default.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TrainingDraft {
    /// The agent whose influence is learned; the first one if absent.
    pub ego: Option<String>,
    /// The agent that may be influenced; the second one if absent.
    pub other: Option<String>,
    /// How many steps later the other's action is observed; 0 for the same tick.
    pub lag: i64,
    /// `joint` (default) or `direct`.
    pub kind: Option<String>,
    /// Units of the hidden layer.
    pub width: Option<u64>,
    /// Networks that are trained and averaged.
    pub members: Option<u64>,
    /// Parts that the states are cut into.
    pub folds: Option<u64>,
    /// The most passes over the states.
    pub epochs: Option<u64>,
    /// `visits` (default) or `states`.
    pub weighting: Option<String>,
    /// Where all randomness comes from.
    pub seed: Option<u64>,
    /// Whether the version is made active even where it does not beat its baselines.
    pub activate: bool,
}

/// Which states count as discoveries, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DiscoveryDraft {
    /// The share of false ones among them that is accepted on average.
    pub fdr: Option<f64>,
    /// `bayes` (default) or `bh`.
    pub method: Option<String>,
}

/// A question for what all states say together, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SummaryDraft {
    /// Whose influence on whom, from which counts, by which rule.
    pub pair: PairDraft,
    /// Which states count as discoveries.
    pub discovery: DiscoveryDraft,
    /// Whether the names of the segments are left out: there may be thousands.
    pub omit_segments: bool,
}

/// A question for the profile of a pair, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ProfileDraft {
    /// Whose influence on whom, from which counts, without a lag.
    pub pair: PairDraft,
    /// The states that are asked about.
    pub region: RegionDraft,
    /// The lags; 0 and all that are declared for the other where there are none.
    pub lags: Vec<i64>,
}

/// A question for the regions in which a pair depends, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RegionSearchDraft {
    /// Whose influence on whom, from which counts.
    pub pair: PairDraft,
    /// The states that are searched.
    pub region: RegionDraft,
    /// The most regions; 0 for the default.
    pub most: u64,
    /// The share of false ones among those told that is accepted on average.
    pub fdr: Option<f64>,
}

/// A question for what to try next, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ExplorationDraft {
    /// Whose influence on whom, from which counts, by which rule.
    pub pair: PairDraft,
    /// Leaves out states with fewer visits.
    pub min_visits: u64,
    /// The most to return; 0 for the default.
    pub limit: u64,
}

/// A question for a page of states, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ListingDraft {
    /// Whose influence on whom, from which counts, by which rule.
    pub pair: PairDraft,
    /// `visits`, `plug_in`, `posterior_mean` or `p_dependent`, then `desc` (default) or `asc`.
    pub order_by: Option<String>,
    /// Leaves out states with fewer visits.
    pub min_visits: u64,
    /// Leaves out states with another verdict.
    pub verdict: Option<String>,
    /// Leaves out states that are not among the discoveries.
    pub discovery: DiscoveryDraft,
    /// The most to return; 0 for the default.
    pub page_size: u64,
    /// The token of the page before.
    pub page_token: Option<String>,
}
