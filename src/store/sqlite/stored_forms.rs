//! Serialised forms of schemas, derived features, rules and receipts in the database: versioned JSON of our own,
//! apart from every face's, because it is kept for ever.
//!
//! Floats are texts in it: the shortest decimal, which the standard library reads back to the same
//! bits. JSON numbers would be read by rules of somebody else's.

use std::cmp::Ordering;
use std::fmt::Display;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::domain::draft::{
    AgentDraft, DerivedDraft, DerivedKindDraft, FeatureDraft, KindDraft, OutcomeDraft,
};
use crate::domain::{
    Angle, DerivedFeatures, Receipt, Rejection, RuleDraft, Schema, SchemaDraft, Threshold,
    WrittenRule,
};
use crate::error::Problem;
use crate::store::form::{self, Unreadable};

/// The version of the form of a schema that is written where it has neither outcomes nor an agent
/// that may be absent: builds before there were such would take it for one without.
const SCHEMA_FORM: u32 = 1;
/// The version of the form of a schema that has.
const SCHEMA_FORM_OF_OUTCOMES: u32 = 2;
/// The version of the form of derived features that is written.
const DERIVED_FORM: u32 = 1;
/// The version of the form of a rule that is written.
const RULE_FORM: u32 = 1;
/// The version of the form of a receipt that is written, without saying so.
const RECEIPT_FORM: u32 = 1;

#[derive(Serialize, Deserialize)]
struct SchemaText {
    state: Vec<FeatureText>,
    agents: Vec<AgentText>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    outcomes: Vec<OutcomeText>,
}

/// Of an agent's action, or of a value.
#[derive(Serialize, Deserialize)]
struct OutcomeText {
    name: String,
    lag: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    agent: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    value: Vec<FeatureText>,
}

#[derive(Serialize, Deserialize)]
struct AgentText {
    name: String,
    action: Vec<FeatureText>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    may_be_absent: bool,
}

#[derive(Serialize, Deserialize)]
struct FeatureText {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    unit: Option<String>,
    #[serde(flatten)]
    kind: KindText,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum KindText {
    Continuous(Vec<String>),
    /// Of radians, whatever the unit says: what every circular feature was before units were read.
    Circular(i64),
    /// Of degrees.
    CircularDegrees(i64),
    Integer(i64, i64),
    Categorical(Vec<String>),
}

#[derive(Serialize, Deserialize)]
struct DerivedText {
    derived: Vec<DerivedFeatureText>,
}

#[derive(Serialize, Deserialize)]
struct DerivedFeatureText {
    name: String,
    #[serde(flatten)]
    kind: DerivedKindText,
}

/// By names of features of the state.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum DerivedKindText {
    Difference(Vec<String>),
    Manhattan(Vec<Vec<String>>),
    Equal(Vec<String>),
}

#[derive(Serialize, Deserialize)]
struct RuleText {
    kind: String,
    /// Absent where a share is written instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    threshold: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    share: Option<String>,
    unit: String,
    min_visits: u64,
    confidence: String,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    estimators: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    exploration: Vec<String>,
}

/// Names are short, and version 1 goes without saying: a thousand receipts are kept of every
/// producer.
#[derive(Serialize, Deserialize)]
struct ReceiptText {
    accepted: u64,
    #[serde(default, skip_serializing_if = "is_zero")]
    rejected_count: u64,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    rejected: Vec<RejectionText>,
}

/// Index, field and reason.
type RejectionText = (u32, String, String);

/// Writes a schema.
pub(super) fn write_schema(schema: &Schema) -> String {
    let is_first = schema.outcomes().is_empty() && !schema.may_lack_actions();
    let form = match is_first {
        true => SCHEMA_FORM,
        false => SCHEMA_FORM_OF_OUTCOMES,
    };
    let draft = schema.draft();
    let text = SchemaText {
        state: features_text(draft.state),
        agents: draft.agents.into_iter().map(agent_text).collect(),
        outcomes: draft.outcomes.into_iter().map(outcome_text).collect(),
    };
    form::write(form, &text)
}

fn outcome_text(outcome: OutcomeDraft) -> OutcomeText {
    OutcomeText {
        name: outcome.name,
        lag: outcome
            .lag
            .and_then(|lag| lag.try_into().ok())
            .expect("a schema's outcomes have a lag"),
        agent: outcome.agent,
        value: features_text(outcome.value),
    }
}

fn agent_text(agent: AgentDraft) -> AgentText {
    AgentText {
        name: agent.name,
        action: features_text(agent.action),
        may_be_absent: agent.may_be_absent,
    }
}

/// Reads a schema back.
pub(super) fn read_schema(text: &str) -> Result<Schema, Unreadable> {
    match form::version(text)? {
        SCHEMA_FORM | SCHEMA_FORM_OF_OUTCOMES => schema(form::read_content(text)?),
        found => Err(Unreadable::Newer {
            found,
            newest: SCHEMA_FORM_OF_OUTCOMES,
        }),
    }
}

fn schema(text: SchemaText) -> Result<Schema, Unreadable> {
    let agents = text.agents.into_iter().map(agent);
    let outcomes = text.outcomes.into_iter().map(outcome);
    let draft = SchemaDraft {
        agents: agents.collect::<Result<_, Unreadable>>()?,
        state: features(text.state)?,
        outcomes: outcomes.collect::<Result<_, Unreadable>>()?,
        lags: Vec::new(),
    };

    Schema::try_from(&draft)
        .map_err(|faults| Unreadable::spoiled(Problem::invalid("schema", faults)))
}

fn agent(text: AgentText) -> Result<AgentDraft, Unreadable> {
    Ok(AgentDraft {
        name: text.name,
        action: features(text.action)?,
        may_be_absent: text.may_be_absent,
    })
}

fn outcome(text: OutcomeText) -> Result<OutcomeDraft, Unreadable> {
    Ok(OutcomeDraft {
        name: text.name,
        agent: text.agent,
        lag: Some(i64::from(text.lag)),
        value: features(text.value)?,
    })
}

/// Writes derived features; `None` where there are none.
pub(super) fn write_derived(derived: &DerivedFeatures, schema: &Schema) -> Option<String> {
    let features: Vec<_> = derived
        .draft(schema)
        .into_iter()
        .map(derived_text)
        .collect();
    (!features.is_empty()).then(|| form::write(DERIVED_FORM, &DerivedText { derived: features }))
}

fn derived_text(draft: DerivedDraft) -> DerivedFeatureText {
    let kind = draft.kinds.into_iter().next();
    let kind = match kind.expect("a derived feature has one kind") {
        DerivedKindDraft::Difference(names) => DerivedKindText::Difference(names),
        DerivedKindDraft::Manhattan(pairs) => DerivedKindText::Manhattan(pairs),
        DerivedKindDraft::Equal(names) => DerivedKindText::Equal(names),
    };
    DerivedFeatureText {
        name: draft.name,
        kind,
    }
}

/// Reads derived features back.
pub(super) fn read_derived(text: &str, schema: &Schema) -> Result<DerivedFeatures, Unreadable> {
    match form::version(text)? {
        1 => first_derived(form::read_content(text)?, schema),
        found => Err(Unreadable::Newer {
            found,
            newest: DERIVED_FORM,
        }),
    }
}

fn first_derived(text: DerivedText, schema: &Schema) -> Result<DerivedFeatures, Unreadable> {
    let drafts: Vec<DerivedDraft> = text.derived.into_iter().map(derived).collect();
    let spoiled = |faults| Unreadable::spoiled(Problem::invalid("derived features", faults));
    DerivedFeatures::checked(&drafts, schema).map_err(spoiled)
}

fn derived(text: DerivedFeatureText) -> DerivedDraft {
    let kind = match text.kind {
        DerivedKindText::Difference(names) => DerivedKindDraft::Difference(names),
        DerivedKindText::Manhattan(pairs) => DerivedKindDraft::Manhattan(pairs),
        DerivedKindText::Equal(names) => DerivedKindDraft::Equal(names),
    };
    DerivedDraft {
        name: text.name,
        kinds: vec![kind],
    }
}

/// Writes a rule.
pub(super) fn write_rule(rule: &WrittenRule) -> String {
    let (threshold, share) = match rule.threshold {
        Threshold::Information(threshold) => (Some(threshold.to_string()), None),
        Threshold::Share(share) => (None, Some(share.to_string())),
    };

    let text = RuleText {
        kind: rule.kind.as_str().into(),
        threshold,
        share,
        unit: rule.unit.as_str().into(),
        min_visits: rule.min_visits,
        confidence: rule.confidence.to_string(),
        estimators: rule
            .estimators
            .iter()
            .map(|estimator| estimator.as_str().to_owned())
            .collect(),
        exploration: rule.exploration.iter().map(ToString::to_string).collect(),
    };
    form::write(RULE_FORM, &text)
}

/// Reads a rule back.
pub(super) fn read_rule(text: &str) -> Result<WrittenRule, Unreadable> {
    match form::version(text)? {
        1 => first_rule(form::read_content(text)?),
        found => Err(Unreadable::Newer {
            found,
            newest: RULE_FORM,
        }),
    }
}

fn first_rule(text: RuleText) -> Result<WrittenRule, Unreadable> {
    let draft = RuleDraft {
        kind: Some(text.kind),
        threshold: number("threshold", text.threshold)?,
        share: number("share", text.share)?,
        unit: Some(text.unit),
        min_visits: Some(text.min_visits),
        confidence: number("confidence", Some(text.confidence))?,
        estimators: Some(text.estimators),
        exploration: Some(text.exploration),
    };

    // A rule is merged over another one, which has a threshold.
    if draft.threshold.is_none() && draft.share.is_none() {
        return Err(Unreadable::spoiled("it has neither threshold nor share"));
    }

    let merged = WrittenRule::default().merged(&draft);
    merged.map_err(|faults| Unreadable::spoiled(Problem::invalid("rule", faults)))
}

fn number(name: &str, text: Option<String>) -> Result<Option<f64>, Unreadable> {
    text.map(|text| parsed(name, &text)).transpose()
}

/// Writes a receipt.
pub(super) fn write_receipt(receipt: &Receipt) -> String {
    form::write_plain(&ReceiptText {
        accepted: receipt.accepted,
        rejected_count: receipt.rejected_count,
        rejected: receipt.rejected.iter().map(rejection_text).collect(),
    })
}

fn rejection_text(rejection: &Rejection) -> RejectionText {
    let Rejection {
        index,
        field,
        reason,
    } = rejection;
    (*index, field.clone(), reason.clone())
}

/// Reads a receipt back.
pub(super) fn read_receipt(text: &str) -> Result<Receipt, Unreadable> {
    match form::version(text)? {
        1 => Ok(first_receipt(form::read_content(text)?)),
        found => Err(Unreadable::Newer {
            found,
            newest: RECEIPT_FORM,
        }),
    }
}

fn first_receipt(text: ReceiptText) -> Receipt {
    Receipt {
        accepted: text.accepted,
        rejected_count: text.rejected_count,
        rejected: text.rejected.into_iter().map(rejection).collect(),
    }
}

fn rejection((index, field, reason): RejectionText) -> Rejection {
    Rejection {
        index,
        field,
        reason,
    }
}

/// Writes a list of texts.
pub(super) fn json_texts<T: Display>(texts: impl IntoIterator<Item = T>) -> String {
    form::write_plain(
        &texts
            .into_iter()
            .map(|text| text.to_string())
            .collect::<Vec<_>>(),
    )
}

/// Writes a list of numbers.
pub(super) fn json_numbers(numbers: impl IntoIterator<Item = i64>) -> String {
    form::write_plain(&numbers.into_iter().collect::<Vec<_>>())
}

/// Writes a list of pairs of a text and a number, or none.
pub(super) fn json_pairs<T: Display>(pairs: impl IntoIterator<Item = (T, Option<i64>)>) -> String {
    let pair = |(text, number): (T, Option<i64>)| (text.to_string(), number);
    form::write_plain(&pairs.into_iter().map(pair).collect::<Vec<_>>())
}

/// Compares the texts of two keys as [`crate::domain::StateKey`]s compare: bin by bin. A number
/// without leading zeros is less if it is shorter.
pub(super) fn compare_keys(a: &str, b: &str) -> Ordering {
    fn numbers(key: &str) -> impl Iterator<Item = (usize, &str)> {
        key.split('.').map(|bin| (bin.len(), bin))
    }
    numbers(a).cmp(numbers(b))
}

fn features_text(features: Vec<FeatureDraft>) -> Vec<FeatureText> {
    features.into_iter().map(feature_text).collect()
}

fn feature_text(feature: FeatureDraft) -> FeatureText {
    let kind = feature
        .kinds
        .into_iter()
        .next()
        .map(kind_text)
        .expect("a schema's feature has one kind");
    FeatureText {
        name: feature.name,
        unit: feature.unit,
        kind,
    }
}

fn kind_text(kind: KindDraft) -> KindText {
    match kind {
        // An edge is an f32 widened, and its shortest decimal is that of the f32.
        KindDraft::Continuous(edges) => {
            KindText::Continuous(edges.iter().map(|e| (*e as f32).to_string()).collect())
        }
        KindDraft::Circular(bins, values) if values.as_deref() == Some(Angle::Degrees.as_str()) => {
            KindText::CircularDegrees(bins)
        }
        KindDraft::Circular(bins, _) => KindText::Circular(bins),
        KindDraft::Integer(min, max) => KindText::Integer(min, max),
        KindDraft::Categorical(labels) => KindText::Categorical(labels),
    }
}

fn features(texts: Vec<FeatureText>) -> Result<Vec<FeatureDraft>, Unreadable> {
    texts.into_iter().map(feature).collect()
}

fn feature(text: FeatureText) -> Result<FeatureDraft, Unreadable> {
    Ok(FeatureDraft {
        name: text.name,
        unit: text.unit,
        kinds: vec![kind(text.kind)?],
    })
}

fn kind(text: KindText) -> Result<KindDraft, Unreadable> {
    Ok(match text {
        KindText::Continuous(edges) => {
            let edges = edges.iter().map(|text| edge(text));
            KindDraft::Continuous(edges.collect::<Result<_, _>>()?)
        }
        KindText::Circular(bins) => KindDraft::Circular(bins, Some(Angle::Radians.as_str().into())),
        KindText::CircularDegrees(bins) => {
            KindDraft::Circular(bins, Some(Angle::Degrees.as_str().into()))
        }
        KindText::Integer(min, max) => KindDraft::Integer(min, max),
        KindText::Categorical(labels) => KindDraft::Categorical(labels),
    })
}

/// Widening an f32 is exact, so it cannot be rounded twice.
fn edge(text: &str) -> Result<f64, Unreadable> {
    parsed::<f32>("edges", text).map(f64::from)
}

/// Reads a number or a word of ours.
fn parsed<T: FromStr<Err: Display>>(name: &str, text: &str) -> Result<T, Unreadable> {
    text.parse()
        .map_err(|error| Unreadable::spoiled(format!("{name} {text:?}: {error}")))
}

fn is_zero(number: &u64) -> bool {
    *number == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::{Estimator, RuleKind, Unit};

    fn named(name: &str, kind: KindDraft) -> FeatureDraft {
        FeatureDraft {
            name: name.into(),
            unit: Some("m/s²".into()),
            kinds: vec![kind],
        }
    }

    fn schema_with_edges(edges: Vec<f64>) -> Schema {
        let labels = KindDraft::Categorical(vec!["a\"b\\".into(), "左".into()]);
        let agent = |name: &str| AgentDraft {
            name: name.into(),
            action: vec![named("move", labels.clone())],
            ..AgentDraft::default()
        };
        let state = vec![
            named("x", KindDraft::Continuous(edges)),
            named("y", KindDraft::Circular(8, Some("radians".into()))),
            FeatureDraft {
                unit: Some("°".into()),
                ..named("w", KindDraft::Circular(8, None))
            },
            named("z", KindDraft::Integer(-3, 3)),
        ];
        Schema::try_from(&SchemaDraft {
            state,
            agents: vec![agent("robot"), agent("human")],
            ..SchemaDraft::default()
        })
        .expect("valid")
    }

    #[test]
    fn a_schema_reads_back_exactly() {
        let awkward = [
            f32::MIN,
            -0.1,
            f32::MIN_POSITIVE / 8.0,
            0.7,
            16_777_217.0,
            3.4e38,
        ];
        let written = schema_with_edges(awkward.map(f64::from).to_vec());
        let text = write_schema(&written);
        assert!(text.contains("\"0.7\""), "{text}");
        let read = read_schema(&text).expect("what we wrote");
        assert_eq!((read.hash(), &read), (written.hash(), &written));
        assert!(read_schema("{}").is_err());
    }

    #[test]
    fn outcomes_and_absences_are_written_in_a_form_of_their_own() {
        let plain = schema_with_edges(vec![0.5]);
        // To the letter what builds before outcomes wrote: nothing of it may be told otherwise.
        let kept = r#"{"form":1,"state":[{"name":"x","unit":"m/s²","continuous":["0.5"]},{"name":"y","unit":"m/s²","circular":8},{"name":"w","unit":"°","circular_degrees":8},{"name":"z","unit":"m/s²","integer":[-3,3]}],"agents":[{"name":"robot","action":[{"name":"move","unit":"m/s²","categorical":["a\"b\\","左"]}]},{"name":"human","action":[{"name":"move","unit":"m/s²","categorical":["a\"b\\","左"]}]}]}"#;
        assert_eq!(write_schema(&plain), kept);

        let mut absent = plain.draft();
        absent.agents[1].may_be_absent = true;
        let mut observed = plain.draft();
        observed.lags = vec![2, 1];
        observed.outcomes = vec![OutcomeDraft {
            name: "pot".into(),
            agent: None,
            lag: Some(64),
            value: vec![named("held", KindDraft::Continuous(vec![0.7]))],
        }];
        let both = SchemaDraft {
            agents: absent.agents.clone(),
            ..observed.clone()
        };
        for draft in [absent, observed, both] {
            let written = Schema::try_from(&draft).expect("valid");
            let text = write_schema(&written);
            assert!(text.starts_with(r#"{"form":2,"#), "{text}");
            let read = read_schema(&text).expect("what we wrote");
            assert_eq!((read.hash(), &read), (written.hash(), &written));
        }
    }

    #[test]
    fn derived_features_read_back_exactly_and_none_are_not_written() {
        let mut draft = schema_with_edges(vec![0.7]).draft();
        let feature = |name: &str| FeatureDraft {
            unit: None,
            ..named(name, KindDraft::Integer(0, 3))
        };
        draft.state.extend([feature("a"), feature("b")]);
        let schema = Schema::try_from(&draft).expect("valid");
        let none = DerivedFeatures::default();
        assert_eq!(write_derived(&none, &schema), None);

        let kept = r#"{"form":1,"derived":[{"name":"d","difference":["a","b"]},{"name":"m","manhattan":[["a","b"],["z","a"]]},{"name":"e","equal":["b","a"]}]}"#;
        let read = read_derived(kept, &schema).expect("what is kept");
        assert_eq!(read.len(), 3);
        assert_eq!(write_derived(&read, &schema).as_deref(), Some(kept));

        let why = |text: &str| read_derived(text, &schema).expect_err("wrong").to_string();
        let newer = why(&kept.replacen(":1,", ":2,", 1));
        assert!(newer.contains("form 2 of a newer build"), "{newer}");
        let gone = why(&kept.replacen("\"b\"", "\"c\"", 1));
        assert!(
            gone.contains("/derived/0/difference/1: unknown feature"),
            "{gone}"
        );
    }

    proptest::proptest! {
        #[test]
        fn any_edge_reads_back_exactly(bits: u32) {
            let edge = f32::from_bits(bits);
            proptest::prop_assume!(edge.is_finite());
            let written = schema_with_edges(vec![f64::from(edge)]);
            proptest::prop_assert_eq!(read_schema(&write_schema(&written)), Ok(written));
        }

        #[test]
        fn any_rule_reads_back_exactly(threshold in 0.0..1e300, share in 0.0..1.0, confidence in 0.500_001..1.0, min_visits in 0..=i64::MAX as u64) {
            for threshold in [Threshold::Information(threshold), Threshold::Share(share)] {
                let written = WrittenRule {
                    kind: RuleKind::Paper,
                    threshold,
                    unit: Unit::Bits,
                    min_visits,
                    confidence,
                    estimators: [Estimator::Nsb].into_iter().collect(),
                    exploration: vec!["tried".parse().expect("a label")],
                };
                proptest::prop_assert_eq!(read_rule(&write_rule(&written)), Ok(written));
            }
        }
    }

    #[test]
    fn what_was_written_before_units_and_shares_reads_as_it_was_meant() {
        let text = r#"{"state":[{"name":"x","unit":"deg","circular":8},{"name":"y","unit":"turns","circular":3},{"name":"z","circular":4}],
            "agents":[{"name":"a","action":[{"name":"go","integer":[0,1]}]},{"name":"b","action":[{"name":"go","integer":[0,1]}]}]}"#;
        let read = read_schema(text).expect("an old schema");
        assert_eq!(
            [0, 1, 2].map(|at| read.state()[at].kind.expected()),
            ["a finite angle in radians"; 3]
        );
        // As af3f5d0, the first to write schemas, hashed it.
        assert_eq!(
            read.hash().to_string(),
            "4051a8fd0e83a1b3fde790816df0ae25c5bca55026ff916017b5a38b6f79254a"
        );
        assert_eq!(read_schema(&write_schema(&read)), Ok(read));
        let old =
            r#"{"kind":"paper","threshold":"0.8","unit":"nats","min_visits":8,"confidence":"0.8"}"#;
        assert_eq!(
            read_rule(old).expect("an old rule").threshold,
            Threshold::Information(0.8)
        );
        assert_eq!(
            write_rule(&read_rule(old).expect("an old rule")),
            old.replacen('{', "{\"form\":1,", 1)
        );
    }

    #[test]
    fn degrees_and_shares_are_written_so() {
        let degrees = r#"{"form":1,"state":[{"name":"x","unit":"deg","circular_degrees":8}],
            "agents":[{"name":"a","action":[{"name":"go","integer":[0,1]}]},{"name":"b","action":[{"name":"go","integer":[0,1]}]}]}"#;
        let read = read_schema(degrees).expect("a schema");
        assert_eq!(read.state()[0].kind.expected(), "a finite angle in degrees");
        assert_eq!(read_schema(&write_schema(&read)), Ok(read));

        let share = r#"{"form":1,"kind":"evidence","share":"0.7","unit":"bits","min_visits":8,"confidence":"0.8"}"#;
        let read = read_rule(share).expect("a rule");
        assert_eq!(read.threshold, Threshold::Share(0.7));
        assert_eq!(write_rule(&read), share);
    }

    #[test]
    fn a_rule_that_nobody_could_give_is_spoiled() {
        let written = write_rule(&WrittenRule::default());
        let share = written.replace("\"threshold\":\"0.5\"", "\"share\":\"0.5\"");
        for (text, right, wrong, why) in [
            (
                &written,
                "\"0.5\"",
                "\"NaN\"",
                "/threshold: got NaN, expected a finite number",
            ),
            (&written, "\"0.5\"", "\"inf\"", "/threshold: got inf"),
            (&written, "\"0.5\"", "\"1e400\"", "/threshold: got inf"),
            (&written, "\"0.5\"", "\"-0.1\"", "/threshold: got -0.1"),
            (
                &written,
                "\"0.5\"",
                "\"half\"",
                "threshold \"half\": invalid float",
            ),
            (
                &share,
                "\"0.5\"",
                "\"NaN\"",
                "/share: got NaN, expected a number, at least 0 and below 1",
            ),
            (&share, "\"0.5\"", "\"1\"", "/share: got 1"),
            (&share, "\"0.5\"", "\"-0.1\"", "/share: got -0.1"),
            (
                &share,
                "\"share\"",
                "\"threshold\":\"0.5\",\"share\"",
                "/share: got a threshold too",
            ),
            (
                &share,
                "\"share\"",
                "\"shares\"",
                "it has neither threshold nor share",
            ),
            (
                &written,
                "\"0.8\"",
                "\"NaN\"",
                "/confidence: got NaN, expected a number above 0.5 and below 1",
            ),
            (&written, "\"0.8\"", "\"1\"", "/confidence: got 1"),
            (&written, "\"0.8\"", "\"0.5\"", "/confidence: got 0.5"),
            (
                &written,
                ":8,",
                ":9223372036854775808,",
                "/min_visits: got 9223372036854775808",
            ),
            (
                &written,
                "evidence",
                "guess",
                "/kind: got \"guess\", expected evidence or paper",
            ),
            (&written, "nats", "hartleys", "/unit: got \"hartleys\""),
        ] {
            assert!(text.contains(right), "{text}");
            let told = read_rule(&text.replacen(right, wrong, 1))
                .expect_err("no rule")
                .to_string();
            assert!(
                told.starts_with("it is not as it was written: ") && told.contains(why),
                "{why}: {told}"
            );
        }
    }

    #[test]
    fn a_receipt_reads_back_and_a_plain_one_is_short() {
        let plain = Receipt {
            accepted: 7,
            ..Receipt::default()
        };
        assert_eq!(write_receipt(&plain), r#"{"accepted":7}"#);
        let rejection = Rejection {
            index: 3,
            field: "/state/x".into(),
            reason: "got NaN, \"expected\"".into(),
        };
        let full = Receipt {
            accepted: u64::MAX,
            rejected_count: 1,
            rejected: vec![rejection],
        };
        for written in [plain, full] {
            assert_eq!(read_receipt(&write_receipt(&written)), Ok(written));
        }
    }

    #[test]
    fn schemas_and_rules_say_their_version_and_the_first_said_none() {
        let (schema_text, rule_text) = (
            write_schema(&schema_with_edges(vec![0.7])),
            write_rule(&WrittenRule::default()),
        );
        for text in [&schema_text, &rule_text] {
            assert!(text.starts_with(r#"{"form":1,"#), "{text}");
        }
        let before = |text: &str| text.replacen("\"form\":1,", "", 1);
        assert_eq!(
            read_schema(&before(&schema_text)),
            Ok(schema_with_edges(vec![0.7]))
        );
        assert_eq!(read_rule(&before(&rule_text)), Ok(WrittenRule::default()));
    }

    #[test]
    fn what_cannot_be_read_says_why() {
        let newer = |text: String| text.replacen("\"form\":1", "\"form\":4", 1);
        let told = |newest| Unreadable::Newer { found: 4, newest };
        assert_eq!(
            read_schema(&newer(write_schema(&schema_with_edges(vec![0.7])))),
            Err(told(2))
        );
        assert_eq!(
            read_rule(&newer(write_rule(&WrittenRule::default()))),
            Err(told(1))
        );
        assert_eq!(read_receipt(r#"{"form":4,"accepted":7}"#), Err(told(1)));

        let why = |text: &str| read_schema(text).expect_err("no schema").to_string();
        let one_agent = r#"{"state":[],"agents":[]}"#;
        assert!(
            why(one_agent).starts_with("it is not as it was written: invalid schema: "),
            "{}",
            why(one_agent)
        );
        let edge = write_schema(&schema_with_edges(vec![0.7])).replace("\"0.7\"", "\"high\"");
        assert!(
            why(&edge).contains("edges \"high\": invalid float"),
            "{}",
            why(&edge)
        );
    }
}
