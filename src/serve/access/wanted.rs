//! Authorization: what each endpoint wants of whoever asks, in one table for REST and the inference
//! protocol and one for gRPC. `docs/access.md` tells it.
//!
//! What is not listed wants a key, whatever for: an endpoint that somebody forgets here is closed,
//! and a test says so.

use axum::extract::{MatchedPath, Request};
use http::Method;

use crate::domain::{KeyScope, Principal, Scopes};
use crate::error::Problem;
use crate::serve::operations;

/// The permission that an endpoint wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// Nothing: it holds no data.
    Nothing,
    /// A key that has one of these scopes.
    OneOf(Scopes),
    /// A key to read with, for every environment: it tells of the whole service.
    Everywhere,
    /// What is on no list, which any key may find out.
    Unlisted,
}

use Wanted::{Everywhere, Nothing, OneOf};

const READ: Wanted = OneOf(Scopes::new(&[KeyScope::Read]));
const INGEST: Wanted = OneOf(Scopes::new(&[KeyScope::Ingest]));
const TRAIN: Wanted = OneOf(Scopes::new(&[KeyScope::Train]));
const ADMIN: Wanted = OneOf(Scopes::new(&[KeyScope::Admin]));
/// What every client asks first: which environments there are for it, and how they are described.
const ANY: Wanted = OneOf(Scopes::ALL);
/// How far a producer is.
const PROGRESS: Wanted = OneOf(Scopes::new(&[KeyScope::Read, KeyScope::Ingest]));
/// Which networks and trainings there are.
const MODELS: Wanted = OneOf(Scopes::new(&[KeyScope::Read, KeyScope::Train]));

/// Routes of REST and the inference protocol.
const REST: &[(&str, Wanted)] = &[
    ("GET /", Nothing),
    ("GET /docs", Nothing),
    ("GET /docs/", Nothing),
    ("GET /docs/{*rest}", Nothing),
    ("GET /openapi.json", Nothing),
    ("GET /livez", Nothing),
    ("GET /readyz", Nothing),
    ("GET /metrics", Everywhere),
    ("GET /v1/environments", ANY),
    ("GET /v1/environments/{environment}", ANY),
    ("PUT /v1/environments/{environment}", ADMIN),
    ("PATCH /v1/environments/{environment}", ADMIN),
    ("DELETE /v1/environments/{environment}", ADMIN),
    ("POST /v1/environments/{environment}/transitions", INGEST),
    (
        "GET /v1/environments/{environment}/producers/{producer}",
        PROGRESS,
    ),
    ("GET /v1/environments/{environment}/influence", READ),
    ("POST /v1/environments/{environment}/influence", READ),
    ("GET /v1/environments/{environment}/states", READ),
    ("GET /v1/environments/{environment}/states/{key}", READ),
    ("GET /v1/environments/{environment}/summary", READ),
    ("GET /v1/environments/{environment}/profile", READ),
    ("POST /v1/environments/{environment}/profile", READ),
    ("GET /v1/environments/{environment}/regions", READ),
    ("POST /v1/environments/{environment}/regions", READ),
    ("GET /v1/environments/{environment}/graph", READ),
    ("GET /v1/environments/{environment}/explore", READ),
    ("POST /v1/environments/{environment}/fit", TRAIN),
    ("GET /v1/environments/{environment}/models", MODELS),
    ("POST /v1/environments/{environment}/models", TRAIN),
    ("POST /v1/environments/{environment}/models/import", TRAIN),
    ("GET /v1/environments/{environment}/models/{model}", MODELS),
    // Of a version. A job is ended by whoever may begin one.
    (
        "DELETE /v1/environments/{environment}/models/{model}",
        ADMIN,
    ),
    (
        "PUT /v1/environments/{environment}/models/{model}/active",
        TRAIN,
    ),
    (
        "DELETE /v1/environments/{environment}/models/{model}/active",
        TRAIN,
    ),
    (
        "GET /v1/environments/{environment}/models/{model}/weights",
        MODELS,
    ),
    ("GET /v2", READ),
    ("GET /v2/", READ),
    ("GET /v2/health/live", Nothing),
    ("GET /v2/health/ready", Nothing),
    ("GET /v2/models/{model}", READ),
    ("GET /v2/models/{model}/ready", READ),
    ("POST /v2/models/{model}/infer", READ),
    ("GET /v2/models/{model}/versions/{version}", READ),
    ("GET /v2/models/{model}/versions/{version}/ready", READ),
    ("POST /v2/models/{model}/versions/{version}/infer", READ),
];

/// Methods of gRPC. Health and reflection hold no data, as the OpenAPI document holds none.
const GRPC: &[(&str, Wanted)] = &[
    ("/grpc.health.v1.Health/Check", Nothing),
    ("/grpc.health.v1.Health/List", Nothing),
    ("/grpc.health.v1.Health/Watch", Nothing),
    (
        "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
        Nothing,
    ),
    (
        "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
        Nothing,
    ),
    ("/nudge.v1.EnvironmentService/ListEnvironments", ANY),
    ("/nudge.v1.EnvironmentService/GetEnvironment", ANY),
    ("/nudge.v1.EnvironmentService/ApplyEnvironment", ADMIN),
    ("/nudge.v1.EnvironmentService/UpdateEnvironment", ADMIN),
    ("/nudge.v1.EnvironmentService/UpdateRule", ADMIN),
    ("/nudge.v1.EnvironmentService/DeleteEnvironment", ADMIN),
    ("/nudge.v1.IngestService/Ingest", INGEST),
    ("/nudge.v1.IngestService/Write", INGEST),
    ("/nudge.v1.IngestService/GetProducer", PROGRESS),
    ("/nudge.v1.InfluenceService/GetInfluence", READ),
    ("/nudge.v1.InfluenceService/BatchGetInfluence", READ),
    ("/nudge.v1.InfluenceService/GetState", READ),
    ("/nudge.v1.InfluenceService/ListStates", READ),
    ("/nudge.v1.InfluenceService/Summarize", READ),
    ("/nudge.v1.InfluenceService/GetProfile", READ),
    ("/nudge.v1.InfluenceService/FindRegions", READ),
    ("/nudge.v1.InfluenceService/GetGraph", READ),
    ("/nudge.v1.InfluenceService/Explore", READ),
    ("/nudge.v1.InfluenceService/FitPrior", TRAIN),
    ("/nudge.v1.ModelService/TrainModel", TRAIN),
    ("/nudge.v1.ModelService/ListModels", MODELS),
    ("/nudge.v1.ModelService/GetModel", MODELS),
    ("/nudge.v1.ModelService/GetJob", MODELS),
    ("/nudge.v1.ModelService/ActivateModel", TRAIN),
    ("/nudge.v1.ModelService/RollBackModel", TRAIN),
    ("/nudge.v1.ModelService/DeleteModel", ADMIN),
    ("/nudge.v1.ModelService/CancelJob", TRAIN),
    ("/nudge.v1.ModelService/ExportModel", MODELS),
    ("/nudge.v1.ModelService/ImportModel", TRAIN),
    ("/inference.GRPCInferenceService/ServerLive", Nothing),
    ("/inference.GRPCInferenceService/ServerReady", Nothing),
    ("/inference.GRPCInferenceService/ServerMetadata", READ),
    ("/inference.GRPCInferenceService/ModelReady", READ),
    ("/inference.GRPCInferenceService/ModelMetadata", READ),
    ("/inference.GRPCInferenceService/ModelInfer", READ),
];

impl Wanted {
    /// Returns what the endpoint of a request wants.
    pub fn of_request(request: &Request) -> Self {
        let (uri, method) = (request.uri(), request.method());
        if is_grpc_path(uri.path()) {
            return found(GRPC, uri.path());
        }

        if method == Method::OPTIONS {
            return Nothing;
        }

        let Some(path) = request.extensions().get::<MatchedPath>() else {
            return Self::Unlisted;
        };

        match found(REST, &route(method, path.as_str())) {
            Nothing if path.as_str() == "/readyz" && operations::is_verbose(uri.query()) => {
                Everywhere
            }
            ADMIN if path.as_str().ends_with("/models/{model}") && names_a_job(uri.path()) => TRAIN,
            wanted => wanted,
        }
    }

    /// Returns what a route of REST wants, `GET /v1/environments`; `None` where it is on no list.
    pub fn of_route(route: &str) -> Option<Self> {
        Some(found(REST, route)).filter(|wanted| *wanted != Self::Unlisted)
    }

    /// Refuses a principal that has not what is wanted.
    pub fn authorize(self, principal: &Principal) -> Result<(), Problem> {
        match self {
            Nothing | Self::Unlisted => Ok(()),
            OneOf(scopes) => principal.authorize(scopes),
            Everywhere => {
                principal.authorize(Scopes::new(&[KeyScope::Read]))?;
                principal.admit_everywhere()
            }
        }
    }

    /// Returns the scopes of which one is wanted.
    pub fn scopes(self) -> Option<Scopes> {
        match self {
            OneOf(scopes) => Some(scopes),
            Everywhere => Some(Scopes::new(&[KeyScope::Read])),
            Nothing | Self::Unlisted => None,
        }
    }
}

/// Returns whether a path is one of a service of gRPC.
pub fn is_grpc_path(path: &str) -> bool {
    ["/nudge.v1.", "/inference.", "/grpc."]
        .iter()
        .any(|package| path.starts_with(package))
}

fn found(list: &[(&str, Wanted)], asked: &str) -> Wanted {
    list.iter()
        .find(|(listed, _)| *listed == asked)
        .map_or(Wanted::Unlisted, |(_, wanted)| *wanted)
}

fn route(method: &Method, path: &str) -> String {
    let method = if method == Method::HEAD {
        &Method::GET
    } else {
        method
    };
    format!("{method} {path}")
}

/// Whatever is written in another way, `%33` for one, is taken for a version, which wants more.
fn names_a_job(path: &str) -> bool {
    let number = path
        .rsplit('/')
        .next()
        .and_then(|last| last.strip_prefix("job-"));
    number.is_some_and(|number| {
        !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::api;
    use crate::serve::rest;

    #[test]
    fn every_endpoint_is_listed_once_and_no_other() {
        let listed: BTreeSet<&str> = GRPC
            .iter()
            .chain(REST)
            .map(|(endpoint, _)| *endpoint)
            .collect();
        assert_eq!(listed.len(), GRPC.len() + REST.len());
        for endpoint in api::grpc_methods().into_iter().chain(rest::documented()) {
            assert!(
                listed.contains(endpoint.as_str()),
                "{endpoint} is on no list: say what it wants"
            );
        }
        let known: BTreeSet<String> = api::grpc_methods()
            .into_iter()
            .chain(rest::documented())
            .collect();
        for gone in listed
            .iter()
            .filter(|listed| listed.starts_with("/nudge") || listed.contains(" /v1/"))
        {
            assert!(known.contains(*gone), "{gone} is listed and not served");
        }
    }

    #[test]
    fn only_what_is_surely_a_job_is_taken_for_one() {
        assert!(names_a_job("/v1/environments/lane/models/job-12"));
        for other in [
            "3", "%33", "+3", "job-", "job-1x", "job-+1", "JOB-1", "job%2D1", "",
        ] {
            assert!(
                !names_a_job(&format!("/v1/environments/lane/models/{other}")),
                "{other}"
            );
        }
    }

    #[test]
    fn the_page_tells_what_each_endpoint_wants() {
        const MARKS: [&str; 2] = [
            "<!-- the table: made of src/serve/access/wanted.rs -->\n",
            "<!-- its end -->",
        ];
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/access.md");
        let text = std::fs::read_to_string(&path).expect("the page");
        let (before, rest) = text.split_once(MARKS[0]).expect("the begin of the table");
        let (table, after) = rest.split_once(MARKS[1]).expect("the end of the table");
        let mut made = "| endpoint | wants |\n|---|---|\n".to_owned();
        for (endpoint, wanted) in REST.iter().chain(GRPC) {
            let told = match wanted {
                Nothing => "nothing".to_owned(),
                Everywhere => "`read`, for every environment".to_owned(),
                _ => format!(
                    "`{}`",
                    wanted
                        .scopes()
                        .unwrap_or_default()
                        .to_string()
                        .replace(',', "`, `")
                ),
            };
            made += &format!("| `{endpoint}` | {told} |\n");
        }
        if std::env::var_os("NUDGE_WRITE_DOCS").is_some() {
            std::fs::write(&path, [before, MARKS[0], &made, MARKS[1], after].concat())
                .expect("written");
            return;
        }
        assert_eq!(table, made, "run this test with NUDGE_WRITE_DOCS=1");
    }

    #[test]
    fn what_changes_something_wants_a_scope_that_reading_is_not() {
        for (endpoint, wanted) in REST {
            let asks = endpoint.starts_with("GET")
                || endpoint.ends_with("/influence")
                || endpoint.ends_with("/profile")
                || endpoint.ends_with("/regions")
                || endpoint.ends_with("/infer");
            let reads = wanted
                .scopes()
                .is_none_or(|scopes| scopes.meets(Scopes::new(&[KeyScope::Read])));
            assert_eq!(asks, reads, "{endpoint}");
        }
    }
}
