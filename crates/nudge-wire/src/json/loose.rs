//! Any JSON value, kept in the order and with the doubles in which it was written, so that the
//! domain can say what is wrong with it.

use std::fmt;
use std::marker::PhantomData;

use nudge_core::domain::draft::{ActionDraft, NamedValues, ValueDraft};
use serde::de::{Deserialize, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;

/// Longer than any label, so a text beyond it need not be told in full.
const LONGEST_TOLD: usize = 64;

/// Above it, f64 does not tell neighbouring whole numbers apart.
const EXACT: u64 = 1 << 53;

/// Objects within objects whose members are told apart: a transition, its actions, an action of
/// several features.
const MEMBERS_WITHIN: usize = 3;

/// A JSON value.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Loose {
    Null,
    Bool(bool),
    /// Apart from other numbers, because f64 would round a large count.
    Whole(u64),
    Number(f64),
    /// A number that no double holds, or a negative one that it would round, as it was written.
    Large(String),
    Text(String),
    List(usize),
    Object(Vec<(String, Loose)>),
}

impl Loose {
    /// Reads any JSON value. A number that no double holds is one too, so that it can be told whose
    /// value it is.
    pub(super) fn parse(text: &[u8]) -> serde_json::Result<Self> {
        serde_json::from_slice(text).or_else(|error| {
            // Reading it in parts costs time, which only documents with such a number should pay.
            if !error.to_string().starts_with("number out of range") {
                return Err(error);
            }
            serde_json::from_slice(text).and_then(|raw| Self::in_parts(raw, MEMBERS_WITHIN))
        })
    }

    /// Reads a value whose objects are of interest down to a depth; below, they are as good as
    /// empty.
    fn in_parts(raw: &RawValue, depth: usize) -> serde_json::Result<Self> {
        match raw.get().as_bytes() {
            [b'{', ..] if depth == 0 => Ok(Self::Object(Vec::new())),
            [b'{', ..] => {
                let Members(members) = serde_json::from_str::<Members<&RawValue>>(raw.get())?;
                let part = |(name, value)| Ok((name, Self::in_parts(value, depth - 1)?));
                Ok(Self::Object(
                    members
                        .into_iter()
                        .map(part)
                        .collect::<serde_json::Result<_>>()?,
                ))
            }
            [b'[', ..] => Ok(Self::List(
                serde_json::from_str::<Vec<&RawValue>>(raw.get())?.len(),
            )),
            [b'-' | b'0'..=b'9', ..] => Ok(serde_json::from_str(raw.get())
                .unwrap_or_else(|_| Self::Large(raw.get().to_owned()))),
            _ => serde_json::from_str(raw.get()),
        }
    }

    /// Returns this value as that of a feature.
    pub(super) fn into_value(self) -> ValueDraft {
        match self {
            // A double would round it, and it may be somebody's number, written as a label.
            Self::Whole(number) if number > EXACT => ValueDraft::Digits(number.to_string()),
            Self::Whole(number) => ValueDraft::Number(number as f64),
            Self::Bool(truth) => ValueDraft::Truth(truth),
            Self::Number(number) => ValueDraft::Number(number),
            Self::Large(digits) if digits.parse::<i64>().is_ok() => ValueDraft::Digits(digits),
            Self::Text(text) if text.chars().nth(LONGEST_TOLD).is_none() => ValueDraft::Text(text),
            other => ValueDraft::Other(other.to_string()),
        }
    }

    /// Returns this value as an agent's action, or as that of an outcome.
    pub(super) fn into_action(self) -> ActionDraft {
        match self {
            Self::Object(members) => ActionDraft::Named(named_values(members)),
            Self::Null => ActionDraft::Absent,
            other => ActionDraft::Bare(other.into_value()),
        }
    }
}

/// Returns members as values of features.
pub(super) fn named_values(members: Vec<(String, Loose)>) -> NamedValues {
    members
        .into_iter()
        .map(|(name, value)| (name, value.into_value()))
        .collect()
}

impl fmt::Display for Loose {
    /// Tells a value briefly, for error messages.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Null => f.write_str("null"),
            Self::Bool(flag) => flag.fmt(f),
            Self::Whole(number) => number.fmt(f),
            // Debug tells 1e300 as that, Display with three hundred zeros.
            Self::Number(number) => write!(f, "{number:?}"),
            Self::Large(digits) => match digits.get(..LONGEST_TOLD) {
                None => f.write_str(digits),
                Some(first) => write!(f, "{first}..."),
            },
            Self::Text(text) => match text.char_indices().nth(LONGEST_TOLD) {
                None => write!(f, "{text:?}"),
                Some((end, _)) => write!(f, "{:?}...", &text[..end]),
            },
            Self::List(len) => write!(f, "a list of {len}"),
            Self::Object(_) => f.write_str("an object"),
        }
    }
}

impl<'de> Deserialize<'de> for Loose {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Anything)
    }
}

struct Anything;

impl<'de> Visitor<'de> for Anything {
    type Value = Loose;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E: Error>(self) -> Result<Loose, E> {
        Ok(Loose::Null)
    }

    fn visit_bool<E: Error>(self, flag: bool) -> Result<Loose, E> {
        Ok(Loose::Bool(flag))
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<Loose, E> {
        Ok(Loose::Whole(number))
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Loose, E> {
        Ok(match number.unsigned_abs() > EXACT {
            true => Loose::Large(number.to_string()),
            false => Loose::Number(number as f64),
        })
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<Loose, E> {
        Ok(Loose::Number(number))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Loose, E> {
        Ok(Loose::Text(text.to_owned()))
    }

    fn visit_string<E: Error>(self, text: String) -> Result<Loose, E> {
        Ok(Loose::Text(text))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Loose, A::Error> {
        let mut len = 0;
        while seq.next_element::<Loose>()?.is_some() {
            len += 1;
        }
        Ok(Loose::List(len))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Loose, A::Error> {
        Ok(Loose::Object(members(map)?))
    }
}

/// The members of an object, in the order in which they were written, with what is given twice.
struct Members<T>(Vec<(String, T)>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Members<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(AnyMembers(PhantomData))
    }
}

struct AnyMembers<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for AnyMembers<T> {
    type Value = Members<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Members<T>, A::Error> {
        Ok(Members(members(map)?))
    }
}

fn members<'de, A: MapAccess<'de>, T: Deserialize<'de>>(
    mut map: A,
) -> Result<Vec<(String, T)>, A::Error> {
    let mut members = Vec::with_capacity(map.size_hint().unwrap_or(8));
    while let Some(member) = map.next_entry()? {
        members.push(member);
    }
    Ok(members)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loose(text: &str) -> Loose {
        serde_json::from_str(text).expect("JSON")
    }

    #[test]
    fn doubles_and_order_are_kept() {
        let Loose::Object(members) = loose(r#"{"b": 1, "a": "x", "b": null}"#) else {
            panic!("an object")
        };
        let names: Vec<&str> = members.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["b", "a", "b"]);
    }

    #[test]
    fn values_are_told_briefly() {
        let told = |text: &str| match loose(text).into_value() {
            ValueDraft::Other(told) => told,
            other => panic!("{other:?}"),
        };
        assert_eq!(told("null"), "null");
        assert_eq!(told("[1, [2]]"), "a list of 2");
        assert_eq!(told("{}"), "an object");
        let long = told(&format!("\"{}\"", "é".repeat(1_000)));
        assert_eq!(long, format!("\"{}\"...", "é".repeat(64)));
    }

    #[test]
    fn numbers_and_labels_are_values() {
        assert_eq!(loose("-3").into_value(), ValueDraft::Number(-3.0));
        assert_eq!(loose("true").into_value(), ValueDraft::Truth(true));
        assert_eq!(
            loose("9007199254740992").into_value(),
            ValueDraft::Number(9_007_199_254_740_992.0)
        );
        assert_eq!(
            loose("9007199254740993").into_value(),
            ValueDraft::Digits("9007199254740993".into())
        );
        assert_eq!(
            loose("-9007199254740993").into_value(),
            ValueDraft::Digits("-9007199254740993".into())
        );
        assert_eq!(loose("0.7").into_value(), ValueDraft::Number(0.7));
        assert_eq!(loose("\"左\"").into_value(), ValueDraft::Text("左".into()));
        assert_eq!(loose("18446744073709551615"), Loose::Whole(u64::MAX));
    }
}
