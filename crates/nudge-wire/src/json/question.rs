//! Questions as a body asks them.

use std::fmt;

use nudge_core::domain::draft::{NamedValues, PairDraft, PolicyDraft, QuestionDraft, StatesDraft};
use nudge_core::error::{Fault, Problem};
use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, Visitor};
use utoipa::ToSchema;

use super::decode::or_default;
use super::loose::Loose;
use super::whole::perhaps_whole;
use super::{FeatureValue, Region, Rule, words};

/// A question about influence in up to 10,000 states, `states` or `keys`, or in up to 1,000 regions:
/// one of the lists.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of states, keys or regions, ego, other and more"
)]
pub struct Question {
    /// The agent whose influence is asked about; absent for the first.
    #[schema(example = "robot")]
    pub ego: Option<String>,
    /// The agent that may be influenced; absent for the second. Or an outcome with values.
    #[schema(example = "human")]
    pub other: Option<String>,
    /// How many steps later the other's action is observed, one of the lags that are declared for
    /// it; 0, or absent, for the same tick. The other's own action one step before, as far as that is
    /// declared, is held fixed too. An outcome with values has a lag of its own.
    #[serde(default, deserialize_with = "perhaps_whole")]
    #[schema(minimum = 0, maximum = 64, example = 3)]
    pub lag: Option<i64>,
    /// Agents whose actions are held fixed.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable)]
    pub given: Vec<String>,
    /// The segments to count; all if empty.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable)]
    pub segments: Vec<String>,
    /// What is compared within each segment alone: `auto` (the default) tests of independence only,
    /// `segments` the plug-in and its mean under independence too, `pooled` nothing.
    #[schema(example = "auto", value_type = Option<words::Within>)]
    pub within: Option<String>,
    /// Whose habits weigh the ego's actions: `observed` (the default), `uniform`, or those seen in
    /// `{"segments": [...]}`. Responses are by all visits.
    #[schema(value_type = Option<Object>, example = "uniform")]
    pub policy: Option<Policy>,
    /// The parts of the rule that differ from the environment's.
    pub rule: Option<Rule>,
    /// The unit of the answer's figures, `nats` or `bits`; absent for the rule's.
    #[schema(value_type = Option<words::Unit>)]
    pub unit: Option<String>,
    /// Further estimators of mutual information, instead of the environment's: `excess`,
    /// `miller_madow`, `chao_shen`, `james_stein`, `grassberger_2003`, `nsb`, `dirichlet`,
    /// `adjusted`, `uniform_policy`.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable, value_type = Vec<words::Estimator>)]
    pub estimators: Vec<String>,
    /// Wants the test of independence: `auto` to follow `within`, or `pooled`, or `within_segments`
    /// to permute within each segment only.
    #[schema(value_type = Option<words::Permutations>)]
    pub significance: Option<String>,
    /// Wants to know how many more visits a verdict would take.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable)]
    pub visits_to_decide: bool,
    /// `verdict`, `figures` (the default for several states) or `full` (the default for one).
    #[schema(value_type = Option<words::View>)]
    pub view: Option<String>,
    /// States, each a value a feature: a number in the feature's unit, or a label.
    #[schema(value_type = Option<Vec<BTreeMap<String, FeatureValue>>>, example = json!([{"distance": 1.2, "held": "onion"}]), min_items = 1, max_items = 10_000)]
    pub states: Option<Vec<NamedState>>,
    /// States by key.
    #[schema(min_items = 1, max_items = 10_000)]
    pub keys: Option<Vec<String>>,
    /// Regions, each of which is asked about as one: what some features of their states, or derived
    /// ones, may be.
    #[schema(value_type = Option<Vec<Object>>, example = json!([{"held": ["onion", "dish"], "distance": {"from": 1, "below": 3}}]), min_items = 1, max_items = 1_000)]
    pub regions: Option<Vec<Region>>,
    /// The same of one region; `{}` is all states.
    #[schema(value_type = Option<Object>, example = json!({"distance": {"from": 1, "below": 3}}))]
    pub region: Option<Region>,
    /// The grain of regions: features of their states, or derived ones, that are kept; all features if
    /// empty. States that agree in these are taken for one, and the figures with nothing left out
    /// stand beside.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable, example = json!(["dx", "dy"]))]
    pub features: Vec<String>,
}

/// Whose habits weigh the ego's actions.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged, expecting = "observed, uniform, or an object of segments")]
pub enum Policy {
    /// `observed` or `uniform`.
    Word(String),
    /// Those of segments.
    Habits(PolicySegments),
}

/// Segments whose habits weigh the ego's actions.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicySegments {
    /// At least one.
    pub segments: Vec<String>,
}

impl From<Policy> for PolicyDraft {
    fn from(policy: Policy) -> Self {
        match policy {
            Policy::Word(word) => Self::Word(word),
            Policy::Habits(habits) => Self::Segments(habits.segments),
        }
    }
}

/// A state by the names of its features.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedState(NamedValues);

impl TryFrom<Question> for QuestionDraft {
    type Error = Problem;

    fn try_from(question: Question) -> Result<Self, Problem> {
        let pair = PairDraft {
            ego: question.ego,
            other: question.other,
            lag: question.lag.unwrap_or_default(),
            given: question.given,
            segments: question.segments,
            within: question.within,
            policy: question.policy.map(Into::into),
            rule: question.rule.map(Into::into).unwrap_or_default(),
            unit: question.unit,
        };
        let states = states(
            question.states,
            question.keys,
            question.regions,
            question.region,
        )?;
        Ok(Self {
            pair,
            states,
            features: question.features,
            estimators: question.estimators,
            view: question.view,
            significance: question.significance,
            visits_to_decide: question.visits_to_decide,
        })
    }
}

/// Returns what a question is about, of which one list alone may be given.
fn states(
    states: Option<Vec<NamedState>>,
    keys: Option<Vec<String>>,
    regions: Option<Vec<Region>>,
    region: Option<Region>,
) -> Result<StatesDraft, Problem> {
    let states = states.map(|states| {
        let states = states.into_iter().map(|NamedState(values)| values);
        ("states", StatesDraft::Named(states.collect()))
    });
    let keys = keys.map(|keys| ("keys", StatesDraft::Keys(keys)));
    let regions = regions.map(|regions| {
        let regions = regions.into_iter().map(|Region(draft)| draft);
        ("regions", StatesDraft::Regions(regions.collect()))
    });
    let region = region.map(|Region(draft)| ("region", StatesDraft::Region(draft)));

    let mut given = [states, keys, regions, region].into_iter().flatten();
    match (given.next(), given.next()) {
        (Some((first, _)), Some((second, _))) => Err(Problem::invalid(
            "question",
            vec![Fault::new(
                format!("/{second}"),
                format!("got {first} too, expected one of them"),
            )],
        )),
        (Some((_, draft)), None) => Ok(draft),
        // The domain says how many states are expected.
        (None, _) => Ok(StatesDraft::default()),
    }
}

impl<'de> Deserialize<'de> for NamedState {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(Features)
    }
}

struct Features;

impl<'de> Visitor<'de> for Features {
    type Value = NamedState;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object of features")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<NamedState, A::Error> {
        let mut values = Vec::with_capacity(8);
        while let Some((name, value)) = map.next_entry::<String, Loose>()? {
            values.push((name, value.into_value()));
        }
        Ok(NamedState(values))
    }
}

#[cfg(test)]
mod tests {
    use nudge_core::domain::RuleDraft;
    use nudge_core::domain::draft::ValueDraft;

    use super::*;
    use crate::json::decode;

    fn draft(text: &str) -> Result<QuestionDraft, Problem> {
        decode::<Question>("question", text.as_bytes())?.try_into()
    }

    #[test]
    fn everything_can_be_asked() {
        let text = r#"{"ego": "a", "other": "b", "lag": 3, "given": ["c"], "segments": ["train"], "within": "pooled", "rule": {"threshold": 1},
            "unit": "bits", "estimators": ["excess"], "view": "full",
            "significance": "pooled", "visits_to_decide": true, "states": [{"x": 1, "held": "dish", "x": null}]}"#;
        let named = vec![
            ("x".to_owned(), ValueDraft::Number(1.0)),
            ("held".to_owned(), ValueDraft::Text("dish".into())),
            ("x".to_owned(), ValueDraft::Other("null".into())),
        ];
        let pair = PairDraft {
            ego: Some("a".into()),
            other: Some("b".into()),
            lag: 3,
            given: vec!["c".into()],
            segments: vec!["train".into()],
            within: Some("pooled".into()),
            policy: None,
            rule: RuleDraft {
                threshold: Some(1.0),
                ..RuleDraft::default()
            },
            unit: Some("bits".into()),
        };
        let expected = QuestionDraft {
            pair,
            states: StatesDraft::Named(vec![named]),
            features: Vec::new(),
            estimators: vec!["excess".into()],
            view: Some("full".into()),
            significance: Some("pooled".into()),
            visits_to_decide: true,
        };
        assert_eq!(draft(text), Ok(expected));
    }

    #[test]
    fn states_and_keys_exclude_each_other() {
        assert_eq!(
            draft(r#"{"states": [], "keys": []}"#)
                .expect_err("both")
                .faults[0]
                .pointer,
            "/keys"
        );
        assert_eq!(
            draft("{}").expect("for the domain to refuse").states,
            StatesDraft::default()
        );
        assert_eq!(
            draft(r#"{"keys": ["1.2"]}"#).expect("valid").states,
            StatesDraft::Keys(vec!["1.2".into()])
        );
    }

    #[test]
    fn faults_name_their_place() {
        let pointer = |text: &str| draft(text).expect_err("wrong").faults.remove(0).pointer;
        assert_eq!(pointer(r#"{"states": [{}, 3]}"#), "/states/1");
        assert_eq!(pointer(r#"{"stats": []}"#), "/stats");
        assert_eq!(
            pointer(r#"{"rule": {"min_visits": -1}}"#),
            "/rule/min_visits"
        );
        assert_eq!(pointer(r#"{"keys": ["1", 2]}"#), "/keys/1");
    }
}
