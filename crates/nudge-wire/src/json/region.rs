//! Regions: `{"held": ["onion", "dish"], "lane": 2, "distance": {"from": 1, "below": 3}}`.

use std::fmt;

use nudge_core::domain::draft::{ConditionDraft, RangeDraft, RegionDraft, ValueDraft};
use serde::de::value::MapAccessDeserializer;
use serde::de::{
    Deserialize, Deserializer, Error, IntoDeserializer, MapAccess, SeqAccess, Visitor,
};
use serde::ser::{Serialize, Serializer};
use serde_json::{Value, json};

use super::loose::Loose;

/// Below it a double holds every whole number.
const WHOLE: f64 = 9_007_199_254_740_992.0;

/// A region as it is written in JSON: an object of features, each with a value, a list of values,
/// or an object of `from`, `to`, `below` or of `bins`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Region(pub RegionDraft);

impl<'de> Deserialize<'de> for Region {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(Conditions)
    }
}

/// In the order in which they were written, with what is given twice.
struct Conditions;

impl<'de> Visitor<'de> for Conditions {
    type Value = Region;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object of features and what they may be")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Region, A::Error> {
        let mut conditions = Vec::new();
        while let Some((name, Condition(draft))) = map.next_entry()? {
            conditions.push((name, draft));
        }
        Ok(Region(RegionDraft(conditions)))
    }
}

struct Condition(ConditionDraft);

impl<'de> Deserialize<'de> for Condition {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(AnyCondition).map(Self)
    }
}

/// What a condition is where it is an object.
#[derive(serde::Deserialize)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of from, to, below or bins"
)]
struct Members {
    from: Option<Loose>,
    to: Option<Loose>,
    below: Option<Loose>,
    bins: Option<Vec<Loose>>,
}

impl Members {
    fn into_draft(self) -> Result<ConditionDraft, &'static str> {
        let [from, to, below] =
            [self.from, self.to, self.below].map(|end| end.map(Loose::into_value));
        let range = RangeDraft { from, to, below };
        match self.bins {
            None => Ok(ConditionDraft::Between(range)),
            Some(bins) if range == RangeDraft::default() => Ok(ConditionDraft::Bins(values(bins))),
            Some(_) => Err("got bins beside a range, expected one of them"),
        }
    }
}

fn values(values: Vec<Loose>) -> Vec<ValueDraft> {
    values.into_iter().map(Loose::into_value).collect()
}

struct AnyCondition;

impl<'de> Visitor<'de> for AnyCondition {
    type Value = ConditionDraft;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value, a list of values, or an object of from, to, below or bins")
    }

    fn visit_unit<E: Error>(self) -> Result<ConditionDraft, E> {
        one(().into_deserializer())
    }

    fn visit_bool<E: Error>(self, truth: bool) -> Result<ConditionDraft, E> {
        one(truth.into_deserializer())
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<ConditionDraft, E> {
        one(number.into_deserializer())
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<ConditionDraft, E> {
        one(number.into_deserializer())
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<ConditionDraft, E> {
        one(number.into_deserializer())
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<ConditionDraft, E> {
        one(text.into_deserializer())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<ConditionDraft, A::Error> {
        let mut values = Vec::new();
        while let Some(value) = seq.next_element::<Loose>()? {
            values.push(value.into_value());
        }
        Ok(ConditionDraft::AnyOf(values))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<ConditionDraft, A::Error> {
        let members = Members::deserialize(MapAccessDeserializer::new(map))?;
        members.into_draft().map_err(A::Error::custom)
    }
}

fn one<'de, D: Deserializer<'de>>(value: D) -> Result<ConditionDraft, D::Error> {
    Loose::deserialize(value).map(|value| ConditionDraft::One(value.into_value()))
}

impl Serialize for Region {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self(RegionDraft(conditions)) = self;
        let written = conditions
            .iter()
            .map(|(name, draft)| (name, Written(draft)));
        serializer.collect_map(written)
    }
}

/// A condition on its way into JSON.
struct Written<'a>(&'a ConditionDraft);

impl Serialize for Written<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            ConditionDraft::One(one) => value(one).serialize(serializer),
            ConditionDraft::AnyOf(several) => serializer.collect_seq(several.iter().map(value)),
            ConditionDraft::Bins(bins) => {
                let bins: Vec<Value> = bins.iter().map(value).collect();
                serializer.collect_map([("bins", bins)])
            }
            ConditionDraft::Between(RangeDraft { from, to, below }) => {
                let ends = [("from", from), ("to", to), ("below", below)].into_iter();
                serializer
                    .collect_map(ends.filter_map(|(name, end)| Some((name, value(end.as_ref()?)))))
            }
        }
    }
}

fn value(draft: &ValueDraft) -> Value {
    match draft {
        // As a whole number, without the `.0` of a double.
        ValueDraft::Number(number) if number.fract() == 0.0 && number.abs() < WHOLE => {
            json!(*number as i64)
        }
        ValueDraft::Number(number) => json!(number),
        ValueDraft::Truth(truth) => json!(truth),
        ValueDraft::Text(text) | ValueDraft::Digits(text) | ValueDraft::Other(text) => json!(text),
    }
}

#[cfg(test)]
mod tests {
    use nudge_core::domain::draft::{DerivedDraft, DerivedKindDraft};
    use nudge_core::domain::{self, Coordinates, DerivedFeatures, Schema};
    use nudge_core::error::Problem;

    use super::*;
    use crate::json::{decode, description_of_text};
    use crate::proto;

    const KITCHEN: &str = r#"
        { "state":  [ {"name": "gap", "unit": "m", "continuous": {"edges": [0.5, 0.7, 1, 1.5]}},
                      {"name": "bearing", "circular": {"bins": 8}},
                      {"name": "lane", "integer": {"min": -1, "max": 3}},
                      {"name": "goal", "integer": {"min": 0, "max": 3}},
                      {"name": "held", "categorical": {"labels": ["nothing", "onion", "dish"]}} ],
          "agents": [ {"name": "a", "action": [{"name": "go", "integer": {"min": 0, "max": 1}}]},
                      {"name": "b", "action": [{"name": "go", "integer": {"min": 0, "max": 1}}]} ] }"#;

    fn coordinates() -> Coordinates {
        let draft = description_of_text(KITCHEN).expect("valid");
        let schema = Schema::try_from(&draft.schema).expect("valid");
        let names = ["lane", "goal"].map(String::from).to_vec();
        let there = DerivedDraft {
            name: "there".into(),
            kinds: vec![DerivedKindDraft::Equal(names)],
        };
        let derived = DerivedFeatures::checked(&[there], &schema).expect("valid");
        Coordinates::new(&schema, &derived)
    }

    fn read(text: &str) -> Result<domain::Region, Problem> {
        let Region(draft) = decode("region", text.as_bytes())?;
        let region = domain::Region::checked(&draft, &coordinates());
        region.map_err(|faults| Problem::invalid("region", faults))
    }

    #[test]
    fn a_region_comes_back_in_its_canonical_form_over_both_faces() {
        for (text, canonical) in [
            ("{}", "{}"),
            (r#"{"lane": 2}"#, r#"{"lane":2}"#),
            (r#"{"lane": [3, "-1", 3]}"#, r#"{"lane":[-1,3]}"#),
            (
                r#"{"held": ["dish", "onion"], "lane": {"from": 0, "to": 2}}"#,
                r#"{"lane":{"from":0,"below":3},"held":["onion","dish"]}"#,
            ),
            (r#"{"lane": {"from": -1, "below": 4}}"#, "{}"),
            (r#"{"gap": {"from": 0.7}}"#, r#"{"gap":{"from":0.7}}"#),
            (
                r#"{"gap": {"from": null, "below": 0.7}}"#,
                r#"{"gap":{"below":0.7}}"#,
            ),
            (r#"{"gap": [0.1, "[1, 1.5)"]}"#, r#"{"gap":{"bins":[0,3]}}"#),
            (
                r#"{"bearing": {"bins": [7, 0]}}"#,
                r#"{"bearing":{"bins":[0,7]}}"#,
            ),
            (r#"{"there": true}"#, r#"{"there":"true"}"#),
        ] {
            let region = read(text).expect(text);
            let message = proto::Region::from(region.draft());
            let told = Region(RegionDraft::from(message));
            let told = serde_json::to_string(&told).expect("JSON");
            assert_eq!(told, canonical, "{text}");
            assert_eq!(read(&told).expect("its own"), region);
        }
    }

    #[test]
    fn what_is_wrong_is_told_by_pointer() {
        for (text, pointers) in [
            ("[]", vec![""]),
            (r#"{"lane": {"form": 1}}"#, vec!["/lane/form"]),
            (r#"{"lane": {"from": 1, "bins": [1]}}"#, vec!["/lane"]),
            (
                r#"{"lane": null, "held": [[], "x"]}"#,
                vec!["/lane", "/held/0", "/held/1"],
            ),
            (r#"{"lane": 1, "lane": 1}"#, vec!["/lane"]),
            (
                r#"{"gap": {"from": 0.6, "below": 9}, "a/b": 1}"#,
                vec!["/gap/from", "/gap/below", "/a~1b"],
            ),
            (
                r#"{"lane": {"bins": [0.5, -1, 5, "x"]}}"#,
                vec![
                    "/lane/bins/0",
                    "/lane/bins/1",
                    "/lane/bins/2",
                    "/lane/bins/3",
                ],
            ),
        ] {
            let faults = read(text).expect_err(text).faults;
            let told: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
            assert_eq!(told, pointers, "{text}");
        }
    }

    #[test]
    fn a_message_that_says_nothing_of_a_feature_is_refused() {
        let message = proto::Region {
            conditions: vec![proto::Condition {
                feature: "lane".into(),
                bins: None,
            }],
        };
        let faults = domain::Region::checked(&message.into(), &coordinates()).expect_err("nothing");
        assert_eq!(faults[0].pointer, "/lane");
    }
}
