//! From bytes to a typed request: what is wrong is told with its place as a JSON pointer.

use std::fmt;

use nudge_core::error::{Fault, Problem, pointer};
use serde::Deserialize;
use serde::de::{Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde_path_to_error::Segment;

/// Decodes a JSON document, which is an object; `what` names it in the problem.
pub fn decode<'a, T: Deserialize<'a>>(what: &str, bytes: &'a [u8]) -> Result<T, Problem> {
    let decoded = serde_json::from_slice(bytes);
    // Serde takes the members of an object in order too, as a list.
    if decoded.is_ok() && bytes.trim_ascii_start().starts_with(b"[") {
        let fault = Fault::new("", "got a list, expected an object");
        return Err(Problem::invalid(what, vec![fault]));
    }
    decoded.map_err(|error| {
        let fault = not_finite(bytes, &error)
            .unwrap_or_else(|| fault(place::<T>(bytes), &error.to_string()));
        Problem::invalid(what, vec![fault])
    })
}

/// Decodes a member that may be left out: null means that it is.
pub(super) fn or_default<'de, T: Deserialize<'de> + Default, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<T, D::Error> {
    Option::<T>::deserialize(deserializer).map(Option::unwrap_or_default)
}

/// Returns the fault of a text that is not JSON because it has a NaN or an infinity where a number
/// should be, as some languages write them.
pub(super) fn not_finite(text: &[u8], error: &serde_json::Error) -> Option<Fault> {
    let word = Some(error)
        .filter(|error| error.is_syntax())
        .and_then(|error| word_at(text, error))?;
    let number = word.trim_start_matches(['-', '+']).to_ascii_lowercase();
    let told = ["nan", "inf", "infinity"].contains(&number.as_str()).then(|| {
        let (line, column) = (error.line(), error.column());
        format!("got {word}, expected a finite number: JSON has no NaN and no Infinity (line {line} column {column})")
    });
    told.map(|detail| Fault::new(place::<Anything>(text), detail))
}

/// Returns the word, with its sign, in which a text stops being JSON.
fn word_at<'a>(text: &'a [u8], error: &serde_json::Error) -> Option<&'a str> {
    let is_part = |byte: &u8| byte.is_ascii_alphabetic() || matches!(byte, b'-' | b'+');
    let line: usize = text
        .split_inclusive(|byte| *byte == b'\n')
        .take(error.line().checked_sub(1)?)
        .map(<[u8]>::len)
        .sum();
    let at = line + error.column().checked_sub(1)?;
    let before = text
        .get(..at)?
        .iter()
        .rev()
        .take_while(|byte| is_part(byte))
        .count();
    let after = text[at..].iter().take_while(|byte| is_part(byte)).count();

    str::from_utf8(&text[at - before..at + after]).ok()
}

/// What is missing has a place too: where it would be.
fn fault(place: String, message: &str) -> Fault {
    let missing = message
        .strip_prefix("missing field `")
        .and_then(|rest| rest.split_once('`'));
    match missing {
        Some((name, _)) => Fault::new(place + &pointer(name), "missing"),
        None => Fault::new(place, in_words_of_json(message)),
    }
}

/// Decodes once more to learn where it fails. Keeping track of the place costs time, which only
/// documents that fail should pay.
fn place<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> String {
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    match serde_path_to_error::deserialize::<_, T>(&mut deserializer) {
        Ok(_) => String::new(),
        Err(error) => error.path().iter().map(step).collect(),
    }
}

fn step(segment: &Segment) -> String {
    match segment {
        Segment::Seq { index } => format!("/{index}"),
        Segment::Map { key } => pointer(key),
        Segment::Enum { .. } | Segment::Unknown => String::new(),
    }
}

/// Any JSON value, of which nothing is kept: only the way to where it ends being one.
struct Anything;

impl<'de> Deserialize<'de> for Anything {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Self)
    }
}

impl<'de> Visitor<'de> for Anything {
    type Value = Self;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E: Error>(self) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_bool<E: Error>(self, _: bool) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_u64<E: Error>(self, _: u64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_i64<E: Error>(self, _: i64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_f64<E: Error>(self, _: f64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_str<E: Error>(self, _: &str) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self, A::Error> {
        while seq.next_element::<Self>()?.is_some() {}
        Ok(self)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self, A::Error> {
        while map.next_entry::<String, Self>()?.is_some() {}
        Ok(self)
    }
}

/// Says "a number" where the decoder says `f64`.
fn in_words_of_json(message: &str) -> String {
    const WORDS: [(&str, &str); 7] = [
        (
            "number out of range",
            "got a number that no double holds, expected a smaller one",
        ),
        ("expected f64", "expected a number"),
        ("expected u64", "expected a whole number, at least 0"),
        ("expected i64", "expected a whole number"),
        ("expected a sequence", "expected a list"),
        ("expected any valid JSON value", "expected a value"),
        ("invalid type: map", "invalid type: object"),
    ];
    WORDS
        .iter()
        .fold(message.to_owned(), |message, (theirs, ours)| {
            message.replace(theirs, ours)
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::json::{Description, EnvironmentChange};

    fn fault(text: &str) -> Fault {
        decode::<Description>("environment", text.as_bytes())
            .expect_err("wrong")
            .faults
            .remove(0)
    }

    #[test]
    fn a_wrong_type_is_told_with_its_place() {
        let fault = fault(r#"{"state": [{"name": "a", "continuous": {"edges": [1, "2"]}}]}"#);
        assert_eq!(fault.pointer, "/state/0/continuous/edges/1");
        assert!(
            fault.detail.contains("expected a number"),
            "{}",
            fault.detail
        );
    }

    #[test]
    fn an_unknown_field_is_told_with_its_place() {
        let fault = fault(r#"{"state": [{"name": "a", "circluar": {"bins": 8}}]}"#);
        assert_eq!(fault.pointer, "/state/0/circluar");
        assert!(
            fault.detail.contains("unknown field `circluar`"),
            "{}",
            fault.detail
        );
    }

    #[test]
    fn what_is_missing_is_told_with_its_place() {
        let fault = fault(r#"{"state": [{"name": "a", "integer": {"min": 1}}]}"#);
        assert_eq!(
            (fault.pointer.as_str(), fault.detail.as_str()),
            ("/state/0/integer/max", "missing")
        );
    }

    #[test]
    fn numbers_out_of_range_are_faults() {
        assert_eq!(
            fault(r#"{"state": [{"circular": {"bins": 1e30}}]}"#).pointer,
            "/state/0/circular/bins"
        );
        let edge = fault(r#"{"state": [{"continuous": {"edges": [1e999]}}]}"#);
        assert_eq!(edge.pointer, "/state/0/continuous/edges/0");
        assert!(
            edge.detail
                .starts_with("got a number that no double holds, expected a smaller one"),
            "{edge:?}"
        );
        assert_eq!(
            fault(r#"{"state": [{"integer": {"min": -9223372036854775809, "max": 1}}]}"#).pointer,
            "/state/0/integer/min"
        );
    }

    #[test]
    fn what_is_not_json_is_told_with_its_line() {
        for text in ["", "{", "nonsense", "{} {}", "{\"state\": NaN}"] {
            assert!(fault(text).detail.contains("line 1 column"), "{text}");
        }
        assert!(decode::<Description>("environment", b"{\"state\": \"\xff\"}").is_err());
        assert!(decode::<Description>("environment", "[".repeat(100_000).as_bytes()).is_err());
        let change = decode::<EnvironmentChange>("body", b" [null, null]").expect_err("a list");
        assert_eq!(change.faults[0].detail, "got a list, expected an object");
    }

    #[test]
    fn what_is_no_finite_number_is_told_with_its_place() {
        for word in [
            "NaN",
            "nan",
            "-NaN",
            "Infinity",
            "-Infinity",
            "inf",
            "-inf",
            "+inf",
        ] {
            let fault = fault(&format!(
                "{{\"state\": [\n{{\"name\": \"a\", \"continuous\": {{\"edges\": [1, {word}]}}}}]}}"
            ));
            assert_eq!(fault.pointer, "/state/0/continuous/edges/1", "{word}");
            let told = format!(
                "got {word}, expected a finite number: JSON has no NaN and no Infinity (line 2 column"
            );
            assert!(fault.detail.starts_with(&told), "{word}: {}", fault.detail);
        }
        for text in ["NaN", "[NaN", "{\"state\": [NaN"] {
            assert!(fault(text).detail.starts_with("got NaN, "), "{text}");
        }
        for text in [
            "nothing",
            "{\"state\": nano}",
            "{\"state\": \"NaN\"}",
            "{\"state\": \"NaN\", }",
            "-",
            "NaN\u{e9}x\n\n",
        ] {
            let detail = fault(text).detail;
            assert!(
                !detail.contains("got NaN") || text.starts_with("NaN"),
                "{text}: {detail}"
            );
        }
    }

    #[test]
    fn pointers_escape_what_they_are_made_of() {
        assert_eq!(pointer("a/b~c"), "/a~1b~0c");
    }
}
