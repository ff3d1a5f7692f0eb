//! From bytes to a typed request: what is wrong is told with its place as a JSON pointer.

use serde::Deserialize;
use serde_path_to_error::Segment;

use crate::error::{Fault, Problem, pointer};

/// Decodes a JSON document; `what` names it in the problem.
pub fn decode<'a, T: Deserialize<'a>>(what: &str, bytes: &'a [u8]) -> Result<T, Problem> {
    serde_json::from_slice(bytes)
        .map_err(|error| Problem::invalid(what, vec![fault(place::<T>(bytes), &error.to_string())]))
}

/// What is missing has a place too: where it would be.
fn fault(place: String, message: &str) -> Fault {
    let missing = message.strip_prefix("missing field `").and_then(|rest| rest.split_once('`'));
    match missing {
        Some((name, _)) => Fault::new(place + &pointer(name), "missing"),
        None => Fault::new(place, in_words_of_json(message)),
    }
}

/// Decodes once more to learn where it fails. Keeping track of the place costs time, which only documents that fail should pay.
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

/// Says "a number" where the decoder says `f64`.
fn in_words_of_json(message: &str) -> String {
    const WORDS: [(&str, &str); 7] = [
        ("number out of range", "got a number that no double holds, expected a smaller one"),
        ("expected f64", "expected a number"),
        ("expected u64", "expected a whole number, at least 0"),
        ("expected i64", "expected a whole number"),
        ("expected a sequence", "expected a list"),
        ("expected any valid JSON value", "expected a value"),
        ("invalid type: map", "invalid type: object"),
    ];
    WORDS.iter().fold(message.to_owned(), |message, (theirs, ours)| message.replace(theirs, ours))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::json::Description;

    fn fault(text: &str) -> Fault {
        decode::<Description>("environment", text.as_bytes()).expect_err("wrong").faults.remove(0)
    }

    #[test]
    fn a_wrong_type_is_told_with_its_place() {
        let fault = fault(r#"{"state": [{"name": "a", "continuous": {"edges": [1, "2"]}}]}"#);
        assert_eq!(fault.pointer, "/state/0/continuous/edges/1");
        assert!(fault.detail.contains("expected a number"), "{}", fault.detail);
    }

    #[test]
    fn an_unknown_field_is_told_with_its_place() {
        let fault = fault(r#"{"state": [{"name": "a", "circluar": {"bins": 8}}]}"#);
        assert_eq!(fault.pointer, "/state/0/circluar");
        assert!(fault.detail.contains("unknown field `circluar`"), "{}", fault.detail);
    }

    #[test]
    fn what_is_missing_is_told_with_its_place() {
        let fault = fault(r#"{"state": [{"name": "a", "integer": {"min": 1}}]}"#);
        assert_eq!((fault.pointer.as_str(), fault.detail.as_str()), ("/state/0/integer/max", "missing"));
    }

    #[test]
    fn numbers_out_of_range_are_faults() {
        assert_eq!(fault(r#"{"state": [{"circular": {"bins": 1e30}}]}"#).pointer, "/state/0/circular/bins");
        let edge = fault(r#"{"state": [{"continuous": {"edges": [1e999]}}]}"#);
        assert_eq!(edge.pointer, "/state/0/continuous/edges/0");
        assert!(edge.detail.starts_with("got a number that no double holds, expected a smaller one"), "{edge:?}");
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
    }

    #[test]
    fn pointers_escape_what_they_are_made_of() {
        assert_eq!(pointer("a/b~c"), "/a~1b~0c");
    }
}
