//! How every route refuses, as the OpenAPI document describes it: an RFC 9457 problem by each
//! status.

use std::collections::BTreeMap;

use utoipa::IntoResponses;
use utoipa::openapi::response::Response;
use utoipa::openapi::schema::{Object, Type};
use utoipa::openapi::{ContentBuilder, Header, HeaderBuilder, Ref, RefOr, ResponseBuilder};

/// How every route refuses: with a problem.
pub struct Refusals;

impl IntoResponses for Refusals {
    fn responses() -> BTreeMap<String, RefOr<Response>> {
        const REFUSALS: [(&str, &str); 11] = [
            ("400", "The input is wrong; its faults are listed"),
            ("401", "There is no key, or none that is let in"),
            (
                "403",
                "The key has not the scope, or is not for the environment or the producer; or a page of another origin asks, or for another host",
            ),
            ("404", "The thing named does not exist"),
            (
                "405",
                "The path does not take the method; `Allow` names those that it takes",
            ),
            (
                "409",
                "The request contradicts what is stored, or a sequence is ahead",
            ),
            ("413", "The body, the batch or the answer is too large"),
            ("415", "The body is of another type"),
            (
                "429",
                "A quota of the service is used up: remove something, or have the quota raised; or the rate of the key is: ask again after `Retry-After`",
            ),
            ("500", "A defect; the cause is in the log"),
            (
                "503",
                "Not now, or no answer in time: where there is a `Retry-After`, ask again after it",
            ),
        ];
        REFUSALS
            .into_iter()
            .map(|(status, description)| (status.to_owned(), refusal(status, description)))
            .collect()
    }
}

fn refusal(status: &str, description: &str) -> RefOr<Response> {
    let problem = ContentBuilder::new()
        .schema(Some(Ref::from_schema_name("Problem")))
        .build();
    let response = ResponseBuilder::new()
        .description(description)
        .content("application/problem+json", problem);
    match status {
        "405" => response.header(
            "Allow",
            response_header(
                "The methods that the path takes, joined by commas",
                Type::String,
            ),
        ),
        "401" => response.header(
            "WWW-Authenticate",
            response_header("How to show a key: `Bearer`", Type::String),
        ),
        "429" | "503" => response.header(
            "Retry-After",
            response_header(
                "After how many seconds the same may be sent again",
                Type::Integer,
            ),
        ),
        _ => response,
    }
    .build()
    .into()
}

fn response_header(description: &str, kind: Type) -> Header {
    let schema = Object::builder().schema_type(kind);
    HeaderBuilder::new()
        .schema(Some(schema.build()))
        .description(Some(description))
        .build()
}
