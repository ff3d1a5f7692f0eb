//! Descriptions: what an environment is, in a request and in a file.

use nudge_core::domain::draft::{
    AgentDraft, ChangeDraft, DerivedDraft, DerivedKindDraft, DescriptionDraft, FeatureDraft,
    KindDraft, OutcomeDraft, SchemaDraft,
};
use nudge_core::error::{Fault, Problem};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::decode::or_default;
use super::whole::{perhaps_whole, whole, wholes_if_any};
use super::{Rule, decode, words};

/// What an environment is: its state, its agents, its outcomes, its derived features and its
/// decision rule. What a service tells of an environment is such a description too.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of state, agents, outcomes, lags, derived and rule"
)]
pub struct Description {
    /// The name that a service told; checked against the path where it is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(pattern = "^[a-z0-9][a-z0-9._-]{0,62}$")]
    pub name: Option<String>,
    /// The service's own name of it, which another service does not know: passed over.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uid: Option<String>,
    /// The hash of state, agents and outcomes that a service told; checked where it is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub schema_hash: Option<String>,
    /// The coordinates of the state, 1 to 256.
    #[serde(default)]
    #[schema(required, min_items = 1, max_items = 256)]
    pub state: Vec<Feature>,
    /// The agents, 2 to 8; at most 2^62 joint actions.
    #[serde(default)]
    #[schema(required, min_items = 2, max_items = 8)]
    pub agents: Vec<Agent>,
    /// What is observed some steps later, at most 512 with those that `lags` stands for.
    #[serde(
        default,
        deserialize_with = "or_default",
        skip_serializing_if = "Vec::is_empty"
    )]
    #[schema(nullable, max_items = 512)]
    pub outcomes: Vec<Outcome>,
    /// Short for an outcome for each agent's action at each of these lags, 1 to 64: agent after
    /// agent, lags rising, before `outcomes`. What a service tells has them in `outcomes`.
    #[serde(
        default,
        deserialize_with = "wholes_if_any",
        skip_serializing_if = "Vec::is_empty"
    )]
    #[schema(nullable, example = json!([1, 2, 3]), max_items = 64)]
    pub lags: Vec<i64>,
    /// The derived features. Present, they set those of an environment that exists; absent, they
    /// are kept, or a new one has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(max_items = 64)]
    pub derived: Option<Vec<DerivedFeature>>,
    /// The rule. Present, it sets the rule of an environment that exists; absent, it keeps it, or
    /// takes the default for a new one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rule: Option<Rule>,
}

/// A change of an environment; what is absent is kept.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, expecting = "an object of rule and derived")]
pub struct EnvironmentChange {
    /// The parts of the rule to change.
    pub rule: Option<Rule>,
    /// All of the derived features.
    #[schema(max_items = 64)]
    pub derived: Option<Vec<DerivedFeature>>,
}

/// One decision maker.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of name, action and may_be_absent"
)]
pub struct Agent {
    /// Matches `[a-z0-9][a-z0-9._-]{0,62}`; unique among features of the state, agents and
    /// outcomes.
    #[serde(default)]
    #[schema(required, example = "robot", pattern = "^[a-z0-9][a-z0-9._-]{0,62}$")]
    pub name: String,
    /// The coordinates of its action; the first is most significant in the action's index.
    #[serde(default)]
    #[schema(required, min_items = 1, max_items = 16)]
    pub action: Vec<Feature>,
    /// Whether a transition may be without its action, which is then null: where agents take turns,
    /// or die. Such a transition counts for the pairs that acted.
    #[serde(
        default,
        deserialize_with = "or_default",
        skip_serializing_if = "std::ops::Not::not"
    )]
    #[schema(nullable)]
    pub may_be_absent: bool,
}

/// A variable that is observed some steps after the joint action, either an agent's later action
/// (`agent`) or another value (`value`). Each is counted beside the joint action, never beside other
/// outcomes, but for an agent's action at a lag k above 1: that is counted beside the same agent's
/// action at k - 1, where that is an outcome too.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of name, lag and one of agent, value"
)]
pub struct Outcome {
    /// `human@3` for an agent's action, which may be left out; else matches
    /// `[a-z0-9][a-z0-9._-]{0,62}`. Unique among features of the state, agents and outcomes.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable, example = "human@3")]
    pub name: String,
    /// The name of the agent whose action it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "human")]
    pub agent: Option<String>,
    /// How many steps after the joint action it is observed.
    #[serde(default, deserialize_with = "perhaps_whole")]
    #[schema(required, example = 3, minimum = 1, maximum = 64)]
    pub lag: Option<i64>,
    /// The coordinates of its value; the first is most significant in the value's index.
    #[serde(
        default,
        deserialize_with = "or_default",
        skip_serializing_if = "Vec::is_empty"
    )]
    #[schema(nullable, max_items = 16)]
    pub value: Vec<Feature>,
}

/// One named coordinate of a state or of an action, with exactly one of `continuous`, `circular`,
/// `integer` and `categorical`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of name, unit and one of continuous, circular, integer, categorical"
)]
pub struct Feature {
    /// Matches `[a-z0-9][a-z0-9._-]{0,62}`; unique.
    #[serde(default)]
    #[schema(
        required,
        example = "distance",
        pattern = "^[a-z0-9][a-z0-9._-]{0,62}$"
    )]
    pub name: String,
    /// The unit of its values, for people. That of a circular feature says how angles are measured:
    /// `deg`, `degrees` and `°` degrees; `rad`, `radians` and none radians; others are refused,
    /// unless `circular.values` says it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "m")]
    pub unit: Option<String>,
    /// Real numbers, cut at edges.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub continuous: Option<Continuous>,
    /// Angles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub circular: Option<Circular>,
    /// Whole numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub integer: Option<Integer>,
    /// Labels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub categorical: Option<Categorical>,
}

/// A coordinate that follows from a state's bins, with exactly one of `difference`, `manhattan` and
/// `equal`. Questions are asked in it; nothing is counted by it, the schema hash does not know it,
/// and it may be changed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of name and one of difference, manhattan, equal"
)]
pub struct DerivedFeature {
    /// Matches `[a-z0-9][a-z0-9._-]{0,62}`; unique among features of the state, agents, outcomes
    /// and derived features.
    #[serde(default)]
    #[schema(required, example = "dx", pattern = "^[a-z0-9][a-z0-9._-]{0,62}$")]
    pub name: String,
    /// The first feature of the state less the second: of two integer features a whole number, of
    /// two circular ones with the same bins and unit a sector of that circle.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = json!(["human.x", "robot.x"]), min_items = 2, max_items = 2)]
    pub difference: Option<Vec<String>>,
    /// The sum of the absolute differences of pairs of integer features of the state.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(min_items = 1, max_items = 16)]
    pub manhattan: Option<Vec<Vec<String>>>,
    /// Whether two features of the state are the same, `false` or `true`: of two integer features
    /// the same number, of others with the same bins the same bin.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(min_items = 2, max_items = 2)]
    pub equal: Option<Vec<String>>,
}

/// Bin = number of edges <= value, so k edges make k + 1 bins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, expecting = "an object of edges")]
pub struct Continuous {
    /// Strictly increasing after rounding to 32-bit floats, in the feature's unit.
    #[schema(example = json!([0.5, 1, 2]), max_items = 65_535)]
    pub edges: Vec<f64>,
}

/// Equal bins of an angle; the first is centred on 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, expecting = "an object of bins and values")]
pub struct Circular {
    /// The number of bins, 1 to 65,536, each of width 2 pi / bins radians, or 360 / bins degrees.
    #[serde(deserialize_with = "whole")]
    #[schema(example = 8, minimum = 1, maximum = 65_536)]
    pub bins: i64,
    /// What values are measured in, `radians` or `degrees`; absent for what the feature's unit
    /// says. Environments that were made before units were read have `radians` beside a unit that
    /// says otherwise.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "degrees", value_type = Option<words::AngleUnit>)]
    pub values: Option<String>,
}

/// A bin for every whole number from min to max.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, expecting = "an object of min and max")]
pub struct Integer {
    /// The smallest value, within +-2^24.
    #[serde(deserialize_with = "whole")]
    #[schema(example = 0, minimum = -16_777_216, maximum = 16_777_216)]
    pub min: i64,
    /// The largest value, within +-2^24, at least min.
    #[serde(deserialize_with = "whole")]
    #[schema(example = 3, minimum = -16_777_216, maximum = 16_777_216)]
    pub max: i64,
}

/// A bin for every label. A value is a label, or its index from 0 where no label reads as a number;
/// where one does, a number is the label that reads as it, and other numbers are refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, expecting = "an object of labels")]
pub struct Categorical {
    /// 1 to 65,536 different labels of 1 to 64 printable characters.
    #[schema(example = json!(["north", "south", "stay"]), min_items = 1, max_items = 65_536)]
    pub labels: Vec<String>,
}

/// Reads a description from a file's text.
pub fn description_of_text(text: &str) -> Result<DescriptionDraft, Problem> {
    decode::<Description>("environment", text.as_bytes()).map(Into::into)
}

impl Description {
    /// Returns this description for an environment of that name, unless it says that it has
    /// another.
    pub fn of_name(self, name: &str) -> Result<DescriptionDraft, Problem> {
        match &self.name {
            Some(said) if said != name => {
                let detail = format!(
                    "got {said:?}, expected {name:?}, as the request says: leave it out of a copy"
                );
                Err(Problem::invalid(
                    "environment",
                    vec![Fault::new("/name", detail)],
                ))
            }
            _ => Ok(self.into()),
        }
    }
}

impl From<Description> for DescriptionDraft {
    fn from(description: Description) -> Self {
        let state = description.state.into_iter().map(Into::into).collect();
        let agents = description.agents.into_iter().map(Into::into).collect();
        let outcomes = description.outcomes.into_iter().map(Into::into).collect();
        Self {
            schema: SchemaDraft {
                state,
                agents,
                outcomes,
                lags: description.lags,
            },
            schema_hash: description.schema_hash,
            derived: description.derived.map(drafts),
            rule: description.rule.map(Into::into),
        }
    }
}

impl From<DescriptionDraft> for Description {
    fn from(draft: DescriptionDraft) -> Self {
        let SchemaDraft {
            state,
            agents,
            outcomes,
            lags,
        } = draft.schema;
        let derived = draft.derived;
        Self {
            name: None,
            uid: None,
            schema_hash: draft.schema_hash,
            state: state.into_iter().map(Into::into).collect(),
            agents: agents.into_iter().map(Into::into).collect(),
            outcomes: outcomes.into_iter().map(Into::into).collect(),
            lags,
            derived: derived.map(|derived| derived.into_iter().map(Into::into).collect()),
            rule: draft.rule.map(Into::into),
        }
    }
}

impl From<EnvironmentChange> for ChangeDraft {
    fn from(change: EnvironmentChange) -> Self {
        Self {
            rule: change.rule.map(Into::into),
            derived: change.derived.map(drafts),
        }
    }
}

fn drafts(derived: Vec<DerivedFeature>) -> Vec<DerivedDraft> {
    derived.into_iter().map(Into::into).collect()
}

impl From<DerivedFeature> for DerivedDraft {
    fn from(feature: DerivedFeature) -> Self {
        let kinds = [
            feature.difference.map(DerivedKindDraft::Difference),
            feature.manhattan.map(DerivedKindDraft::Manhattan),
            feature.equal.map(DerivedKindDraft::Equal),
        ];
        Self {
            name: feature.name,
            kinds: kinds.into_iter().flatten().collect(),
        }
    }
}

impl From<DerivedDraft> for DerivedFeature {
    fn from(draft: DerivedDraft) -> Self {
        let mut feature = Self {
            name: draft.name,
            ..Self::default()
        };
        for kind in draft.kinds {
            match kind {
                DerivedKindDraft::Difference(names) => feature.difference = Some(names),
                DerivedKindDraft::Manhattan(pairs) => feature.manhattan = Some(pairs),
                DerivedKindDraft::Equal(names) => feature.equal = Some(names),
            }
        }
        feature
    }
}

impl From<Outcome> for OutcomeDraft {
    fn from(outcome: Outcome) -> Self {
        Self {
            name: outcome.name,
            agent: outcome.agent,
            lag: outcome.lag,
            value: outcome.value.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<OutcomeDraft> for Outcome {
    fn from(draft: OutcomeDraft) -> Self {
        Self {
            name: draft.name,
            agent: draft.agent,
            lag: draft.lag,
            value: draft.value.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<Agent> for AgentDraft {
    fn from(agent: Agent) -> Self {
        Self {
            name: agent.name,
            action: agent.action.into_iter().map(Into::into).collect(),
            may_be_absent: agent.may_be_absent,
        }
    }
}

impl From<AgentDraft> for Agent {
    fn from(draft: AgentDraft) -> Self {
        Self {
            name: draft.name,
            action: draft.action.into_iter().map(Into::into).collect(),
            may_be_absent: draft.may_be_absent,
        }
    }
}

impl From<Feature> for FeatureDraft {
    fn from(feature: Feature) -> Self {
        let Feature {
            name,
            unit,
            continuous,
            circular,
            integer,
            categorical,
        } = feature;
        let kinds = [
            continuous.map(|continuous| KindDraft::Continuous(continuous.edges)),
            circular.map(|circular| KindDraft::Circular(circular.bins, circular.values)),
            integer.map(|integer| KindDraft::Integer(integer.min, integer.max)),
            categorical.map(|categorical| KindDraft::Categorical(categorical.labels)),
        ];
        Self {
            name,
            unit,
            kinds: kinds.into_iter().flatten().collect(),
        }
    }
}

impl From<FeatureDraft> for Feature {
    fn from(draft: FeatureDraft) -> Self {
        let mut feature = Self {
            name: draft.name,
            unit: draft.unit,
            ..Self::default()
        };
        for kind in draft.kinds {
            match kind {
                KindDraft::Continuous(edges) => feature.continuous = Some(Continuous { edges }),
                KindDraft::Circular(bins, values) => {
                    feature.circular = Some(Circular { bins, values })
                }
                KindDraft::Integer(min, max) => feature.integer = Some(Integer { min, max }),
                KindDraft::Categorical(labels) => {
                    feature.categorical = Some(Categorical { labels })
                }
            }
        }
        feature
    }
}

#[cfg(test)]
mod tests {
    use nudge_core::domain::{DerivedFeatures, Schema, WrittenRule};

    use super::*;
    use crate::proto;

    const HALLWAY: &str = r#"
        { "state":  [ {"name": "distance", "unit": "m",  "continuous": {"edges": [0.5, 0.7, 1, 1.5]}},
                      {"name": "bearing",  "unit": "rad","circular":   {"bins": 8}},
                      {"name": "lane",                  "integer":    {"min": 0, "max": 3}},
                      {"name": "goal",                  "integer":    {"min": 0, "max": 3}},
                      {"name": "held",                  "categorical":{"labels": ["nothing", "oignon é", "左"]}} ],
          "agents": [ {"name": "robot", "action": [ {"name": "turn",  "continuous": {"edges": [-0.2, 0.2]}},
                                                    {"name": "speed", "continuous": {"edges": []}} ]},
                      {"name": "human", "action": [ {"name": "move", "categorical": {"labels": ["go", "stay"]}} ]} ],
          "derived": [ {"name": "lanes", "difference": ["lane", "goal"]}, {"name": "apart", "manhattan": [["lane", "goal"]]},
                       {"name": "there", "equal": ["lane", "goal"]} ],
          "rule":   { "kind": "paper", "threshold": 0.5, "unit": "nats", "min_visits": 8, "confidence": 0.8,
                      "estimators": ["nsb"] } }"#;

    #[test]
    fn a_description_goes_through_the_domain_and_comes_back() {
        let draft = description_of_text(HALLWAY).expect("valid");
        let schema = Schema::try_from(&draft.schema).expect("valid");
        let derived = DerivedFeatures::checked(&draft.derived.expect("given"), &schema);
        let rule = WrittenRule::default()
            .merged(&draft.rule.expect("given"))
            .expect("valid");
        let again = Description::from(DescriptionDraft {
            schema: schema.draft(),
            schema_hash: None,
            derived: Some(derived.expect("valid").draft(&schema)),
            rule: Some(proto::Rule::from(rule).into()),
        });
        let written = serde_json::to_value(again).expect("JSON");
        let given: serde_json::Value = serde_json::from_str(HALLWAY).expect("JSON");
        // 1 and 1.0 are the same edge, so the edges are compared as numbers.
        assert_eq!(written["state"][0]["continuous"]["edges"][1], 0.7);
        let rest =
            |value: &serde_json::Value| value["state"].as_array().expect("a list")[1..].to_vec();
        assert_eq!(rest(&written), rest(&given));
        for member in ["derived", "rule"] {
            assert_eq!(written[member], given[member]);
        }
        let text = serde_json::to_string(&written).expect("JSON");
        let same = description_of_text(&text).expect("valid");
        assert_eq!(
            Schema::try_from(&same.schema).expect("valid").hash(),
            schema.hash()
        );
    }

    #[test]
    fn the_domain_says_that_one_kind_is_expected() {
        let text = r#"{"state": [{"name": "a", "circular": {"bins": 1}, "integer": {"min": 0, "max": 1}}, {"name": "b"}]}"#;
        let draft = description_of_text(text).expect("JSON");
        let faults = Schema::try_from(&draft.schema).expect_err("wrong");
        let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(pointers, ["/state/0", "/state/1", "/agents"]);
    }

    #[test]
    fn an_empty_description_is_for_the_domain_to_refuse() {
        let draft = description_of_text("{}").expect("JSON");
        assert!(Schema::try_from(&draft.schema).is_err());
        assert_eq!((draft.rule, draft.derived), (None, None));
    }
}
