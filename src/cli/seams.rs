//! SEAM: where the commands meet the JSON of `api::json`. Each function is one line once that module is there, and then belongs where it is called.
#![allow(clippy::todo, reason = "filled in when `api::json` is merged")]

use serde_json::Value;

use crate::api::proto;
use crate::domain::{RuleDraft, SchemaDraft};
use crate::error::Problem;

/// Reads an environment description. SEAM: `json::description_of_text(text)`.
pub(super) fn parse_description(_text: &str) -> Result<(SchemaDraft, Option<RuleDraft>), Problem> {
    todo!("api::json")
}

/// Returns answers as REST tells them. SEAM: `json::Answers::from(response)`, serialised.
pub(super) fn to_json(_response: proto::BatchGetInfluenceResponse) -> Value {
    todo!("api::json")
}

/// Returns an environment as REST tells it. SEAM: `json::Environment::from(environment)`, serialised.
pub(super) fn environment_to_json(_environment: proto::Environment) -> Value {
    todo!("api::json")
}
