//! Problems as RFC 9457 tells them.

use nudge_core::error;
use serde::Serialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

/// What went wrong, by RFC 9457. Further members, such as `expected_sequence`, depend on the
/// reason.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Problem {
    /// Identifies the reason: `urn:nudge:problem:` and the reason.
    #[serde(rename = "type")]
    #[schema(example = "urn:nudge:problem:INVALID_INPUT")]
    pub kind: String,
    /// The reason in words.
    #[schema(example = "Invalid input")]
    pub title: String,
    /// The HTTP status.
    #[schema(example = 400, minimum = 400, maximum = 599)]
    pub status: u16,
    /// What went wrong this time: one sentence that names the thing.
    pub detail: String,
    /// The path of the request.
    #[schema(example = "/v1/environments/hallway")]
    pub instance: String,
    /// One UPPER_SNAKE word, the same on every face.
    #[schema(example = "INVALID_INPUT", pattern = "^[A-Z0-9_]+$")]
    pub reason: String,
    /// Every fault of the input.
    pub errors: Vec<Fault>,
    /// Numbers and names that a program can act on.
    #[serde(flatten)]
    #[schema(ignore)]
    pub details: Map<String, Value>,
}

/// One fault of an input.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Fault {
    /// A JSON pointer into the body, or the parameter's name after a slash.
    #[schema(example = "/states/17/distance")]
    pub pointer: String,
    /// The value that was found and what was expected.
    pub detail: String,
}

impl Problem {
    /// Tells a problem under an HTTP status about the request of that path.
    pub fn new(problem: &error::Problem, status: u16, instance: &str) -> Self {
        Self {
            kind: format!("urn:nudge:problem:{}", problem.reason),
            title: in_words(problem.reason),
            status,
            detail: problem.message.clone(),
            instance: instance.to_owned(),
            reason: problem.reason.to_owned(),
            errors: problem.faults.iter().map(Into::into).collect(),
            details: problem
                .details
                .iter()
                .map(|(name, text)| ((*name).to_owned(), value(text)))
                .collect(),
        }
    }
}

impl From<&error::Fault> for Fault {
    fn from(fault: &error::Fault) -> Self {
        Self {
            pointer: fault.pointer.clone(),
            detail: fault.detail.clone(),
        }
    }
}

/// Turns `SEQUENCE_GAP` into "Sequence gap".
fn in_words(reason: &str) -> String {
    let (first, rest) = reason.split_at(reason.len().min(1));
    format!("{first}{}", rest.to_lowercase().replace('_', " "))
}

/// Details are kept as text; what reads back as the same number is told as one.
fn value(text: &str) -> Value {
    match text.parse::<u64>() {
        Ok(number) if number.to_string() == text => number.into(),
        _ => text.into(),
    }
}

#[cfg(test)]
mod tests {
    use nudge_core::error::ErrorKind;
    use serde_json::json;

    use super::*;

    #[test]
    fn details_are_members_and_numbers_are_numbers() {
        let problem = error::Problem::new(
            ErrorKind::OutOfOrder,
            "SEQUENCE_GAP",
            "got sequence 9, expected 4",
        )
        .with("expected_sequence", 4)
        .with("schema_hash", "00ff");
        let told = serde_json::to_value(Problem::new(&problem, 409, "/v1/x")).expect("JSON");
        assert_eq!(
            told,
            json!({
                "type": "urn:nudge:problem:SEQUENCE_GAP",
                "title": "Sequence gap",
                "status": 409,
                "detail": "got sequence 9, expected 4",
                "instance": "/v1/x",
                "reason": "SEQUENCE_GAP",
                "errors": [],
                "expected_sequence": 4,
                "schema_hash": "00ff",
            })
        );
    }

    #[test]
    fn faults_are_told_with_their_place() {
        let problem =
            error::Problem::invalid("question", vec![error::Fault::new("/ego", "unknown agent")]);
        let told = serde_json::to_value(Problem::new(&problem, 400, "/")).expect("JSON");
        assert_eq!(
            told["errors"],
            json!([{"pointer": "/ego", "detail": "unknown agent"}])
        );
    }
}
