//! Who is let in: every endpoint of every face, without a key, with wrong ones, from foreign pages
//! and for foreign hosts.

mod changes;
mod process;
mod slow;
mod wire;

use std::sync::Arc;

use nudge::access::{Keys, Line, Secret, generate};
use nudge::serve::Settings;
use nudge::serve::access::Keyring;
use nudge::store::Options;
use tempfile::TempDir;

use self::wire::{Asked, Face, Wire, endpoints};
use crate::support::{TestApp, lane_json, open};

/// Keys by name, and a service that lets them in.
pub struct Guarded {
    pub app: TestApp,
    pub ring: Keyring,
}

/// A key and its line: `name scopes options`.
pub fn key(line: &str) -> (Secret, String) {
    let secret = generate().expect("randomness");
    let (name, rest) = line.split_once(' ').expect("a name and scopes");
    let line = format!("{name} {} {rest}", secret.digest());
    line.parse::<Line>().expect("a line");
    (secret, line)
}

pub fn keys(lines: &[&str]) -> Keys {
    Keys::parse(&lines.join("\n")).expect("right lines")
}

impl Guarded {
    /// Starts a service that lets in these lines.
    pub async fn start(lines: &[&str]) -> Self {
        Self::with(lines, Settings::default()).await
    }

    pub async fn with(lines: &[&str], settings: Settings) -> Self {
        let directory = Arc::new(TempDir::new().expect("a temporary directory"));
        let store = open(directory.path(), Options::default()).await;
        let ring = Keyring::new(keys(lines));
        let app = TestApp::set(
            directory,
            store,
            Settings {
                keys: Some(ring.clone()),
                ..settings
            },
        )
        .await;
        app.app
            .environments
            .apply("lane", described())
            .await
            .expect("an environment");
        Self { app, ring }
    }
}

fn described() -> nudge::domain::draft::DescriptionDraft {
    let json: nudge::api::json::Description =
        serde_json::from_value(lane_json()).expect("a description");
    json.of_name("lane").expect("its name")
}

pub fn bearer(key: &Secret) -> Vec<u8> {
    format!("Bearer {}", key.reveal()).into_bytes()
}

/// What needs no key.
fn is_open(endpoint: &Asked) -> bool {
    const OPEN: [&str; 12] = [
        "GET /",
        "GET /docs/",
        "GET /openapi.json",
        "GET /livez",
        "GET /readyz",
        "GET /v2/health/live",
        "GET /v2/health/ready",
        "/grpc.health.v1.Health/Check",
        "/inference.GRPCInferenceService/ServerLive",
        "/inference.GRPCInferenceService/ServerReady",
        "GET /docs/swagger-ui-bundle.js",
        "GET /docs/swagger-initializer.js",
    ];
    OPEN.contains(&endpoint.name.as_str())
}

/// The scopes of which each alone is enough, told here once more than in the service.
fn scopes(endpoint: &Asked) -> &'static [&'static str] {
    const ANY: &[&str] = &["read", "ingest", "train", "admin"];
    let name = endpoint.name.as_str();
    let method = name.rsplit('/').next().unwrap_or_default();
    match name {
        "GET /v1/environments" | "GET /v1/environments/{environment}" => ANY,
        "PUT /v1/environments/{environment}"
        | "PATCH /v1/environments/{environment}"
        | "DELETE /v1/environments/{environment}"
        | "DELETE /v1/environments/{environment}/models/{model}" => &["admin"],
        "POST /v1/environments/{environment}/transitions" => &["ingest"],
        "GET /v1/environments/{environment}/producers/{producer}" => &["read", "ingest"],
        "POST /v1/environments/{environment}/fit"
        | "POST /v1/environments/{environment}/models"
        | "POST /v1/environments/{environment}/models/import"
        | "PUT /v1/environments/{environment}/models/{model}/active"
        | "DELETE /v1/environments/{environment}/models/{model}/active" => &["train"],
        _ if name.starts_with("GET /v1/environments/{environment}/models") => &["read", "train"],
        _ if endpoint.face == Face::Rest => &["read"],
        _ => match method {
            "ListEnvironments" | "GetEnvironment" => ANY,
            "ApplyEnvironment" | "UpdateEnvironment" | "UpdateRule" | "DeleteEnvironment"
            | "DeleteModel" => &["admin"],
            "Ingest" | "Write" => &["ingest"],
            "GetProducer" => &["read", "ingest"],
            "FitPrior" | "TrainModel" | "ActivateModel" | "RollBackModel" | "CancelJob"
            | "ImportModel" => &["train"],
            "ListModels" | "GetModel" | "GetJob" | "ExportModel" => &["read", "train"],
            _ => &["read"],
        },
    }
}

/// Returns whether an endpoint is about one environment, which its path or its message names.
fn is_of_environment(endpoint: &Asked) -> bool {
    match endpoint.face {
        Face::Rest => endpoint.name.contains("{environment}"),
        _ => !["ListEnvironments", "ServerMetadata"]
            .iter()
            .any(|method| endpoint.name.ends_with(method)),
    }
}

#[tokio::test]
async fn every_endpoint_wants_a_key_that_is_let_in() {
    let (right, line) = key("right read,ingest,train,admin");
    let Guarded { app, .. } = Guarded::start(&[&line]).await;
    let (wire, stranger) = (Wire::new(&app), generate().expect("randomness"));
    let right = bearer(&right);
    let long = [b"Bearer ".to_vec(), vec![b'a'; 1 << 20]].concat();
    let basic = b"Basic dXNlcjpwYXNz".to_vec();
    let cases: Vec<(&str, Vec<Vec<u8>>)> = vec![
        ("none", vec![]),
        ("a stranger's", vec![bearer(&stranger)]),
        ("two right ones", vec![right.clone(), right.clone()]),
        (
            "a right one and another",
            vec![right.clone(), basic.clone()],
        ),
        ("another scheme", vec![basic]),
        ("no scheme", vec![right[7..].to_vec()]),
        ("no key", vec![b"Bearer ".to_vec()]),
        ("empty", vec![b"".to_vec()]),
        (
            "not ASCII",
            vec!["Bearer schl\u{fc}ssel".as_bytes().to_vec()],
        ),
        (
            "a right one and more",
            vec![[right.clone(), b"a".to_vec()].concat()],
        ),
        ("half of a right one", vec![right[..40].to_vec()]),
    ];
    for endpoint in endpoints(&app).await {
        for (case, values) in &cases {
            let headers: Vec<(&str, &[u8])> = values
                .iter()
                .map(|value| ("authorization", value.as_slice()))
                .collect();
            let answer = wire.ask(&endpoint, "lane", &headers).await;
            if is_open(&endpoint) {
                assert!(answer.is_let_in(), "{endpoint:?} {case}: {answer:?}");
                continue;
            }
            assert_eq!(answer.status, 401, "{endpoint:?} {case}: {answer:?}");
            let is_v2 = endpoint.name.contains(" /v2");
            assert_eq!(
                answer.reason,
                if is_v2 { "" } else { "UNAUTHENTICATED" },
                "{endpoint:?} {case}: {answer:?}"
            );
            assert!(
                !is_v2 || answer.text.starts_with("{\"error\":"),
                "{answer:?}"
            );
            if endpoint.face == Face::Rest {
                assert_eq!(answer.headers["www-authenticate"], "Bearer realm=\"nudge\"");
            }
            for value in values.iter().filter(|value| value.len() > 20) {
                let secret = String::from_utf8_lossy(&value[10..]).into_owned();
                assert!(
                    !answer.text.contains(&secret),
                    "{endpoint:?} {case} tells the header"
                );
            }
        }
        if !is_open(&endpoint) {
            let answer = wire
                .ask(&endpoint, "lane", &[("authorization", &long)])
                .await;
            assert!(
                [0, 401, 431].contains(&answer.status),
                "{endpoint:?} with a megabyte: {answer:?}"
            );
        }
    }
    assert!(
        app.app.environments.find("lane").is_ok(),
        "nothing of it was done"
    );
}

#[tokio::test]
async fn every_endpoint_wants_its_scope() {
    let made =
        ["read", "ingest", "train", "admin"].map(|scope| (scope, key(&format!("{scope} {scope}"))));
    let lines: Vec<&str> = made.iter().map(|(_, (_, line))| line.as_str()).collect();
    let Guarded { app, .. } = Guarded::start(&lines).await;
    let wire = Wire::new(&app);
    for endpoint in endpoints(&app).await {
        for (scope, (key, _)) in &made {
            let key = [b"bearer ".as_slice(), key.reveal().as_bytes()].concat();
            // What is let in finds nothing, and leaves the environment as it is.
            let answer = wire
                .ask(&endpoint, "nowhere", &[("authorization", &key)])
                .await;
            if is_open(&endpoint) || scopes(&endpoint).contains(scope) {
                assert!(answer.is_let_in(), "{endpoint:?} {scope}: {answer:?}");
            } else {
                assert_eq!(answer.status, 403, "{endpoint:?} {scope}: {answer:?}");
                let is_v2 = endpoint.name.contains(" /v2");
                assert_eq!(
                    answer.reason,
                    if is_v2 { "" } else { "SCOPE_MISSING" },
                    "{endpoint:?} {scope}"
                );
                assert!(
                    answer.text.contains(scopes(&endpoint)[0]),
                    "{endpoint:?} {scope}: {answer:?}"
                );
            }
        }
    }
}

#[tokio::test]
async fn a_key_sees_its_environments_and_not_whether_there_are_others() {
    let (key, line) = key("other read,ingest,train,admin environments=other*,mine");
    let Guarded { app, .. } = Guarded::start(&[&line]).await;
    let (wire, key) = (Wire::new(&app), bearer(&key));
    let headers = [("authorization", key.as_slice())];
    for endpoint in endpoints(&app)
        .await
        .iter()
        .filter(|endpoint| is_of_environment(endpoint) && !is_open(endpoint))
    {
        let [there, not] =
            ["lane", "lone"].map(|environment| wire.ask(endpoint, environment, &headers));
        let (there, not) = (there.await, not.await);
        assert_eq!(
            (there.status, not.status),
            (403, 403),
            "{endpoint:?}: {there:?} {not:?}"
        );
        assert_eq!(there.reason, not.reason, "{endpoint:?}");
        assert!(
            there.reason == "ENVIRONMENT_FORBIDDEN" || endpoint.name.contains(" /v2"),
            "{there:?}"
        );
        // What is told to clients of gRPC-Web is told once more in base64.
        let told = |text: &str| {
            text.split("grpc-status-details-bin")
                .next()
                .map(|text| text.replace("lane", "lone"))
        };
        assert_eq!(
            told(&there.text),
            told(&not.text),
            "{endpoint:?} tells them apart"
        );
        let theirs = wire.ask(endpoint, "other-1", &headers).await;
        assert!(theirs.is_let_in(), "{endpoint:?}: {theirs:?}");
    }
    for endpoint in ["GET /metrics", "GET /readyz?verbose"] {
        let endpoint = Asked {
            face: Face::Rest,
            name: endpoint.into(),
        };
        assert_eq!(
            wire.ask(&endpoint, "", &headers).await.status,
            403,
            "{endpoint:?} tells of all"
        );
    }
    app.app
        .environments
        .apply("mine", described_as("mine"))
        .await
        .expect("made");
    let list = Asked {
        face: Face::Rest,
        name: "GET /v1/environments".into(),
    };
    let listed = wire.ask(&list, "", &headers).await.text;
    assert!(
        listed.contains("\"mine\"") && !listed.contains("\"lane\""),
        "{listed}"
    );
    // A hint at a similar name is of theirs alone.
    let near = Asked {
        face: Face::Rest,
        name: "GET /v1/environments/{environment}".into(),
    };
    assert!(
        !wire
            .ask(&near, "other-lane", &headers)
            .await
            .text
            .contains("`lane`")
    );
}

fn described_as(name: &str) -> nudge::domain::draft::DescriptionDraft {
    let json: nudge::api::json::Description =
        serde_json::from_value(lane_json()).expect("a description");
    json.of_name(name).expect("its name")
}

#[tokio::test]
async fn pages_of_other_origins_change_nothing() {
    let (key, line) = key("right read,ingest,train,admin");
    let settings = Settings {
        cors_origins: vec!["https://game.example".into()],
        ..Settings::default()
    };
    let guarded = Guarded::with(&[&line], settings).await;
    let key = bearer(&key);
    // With keys and without, for a page may sit on a machine that needs none.
    let open = TestApp::start().await;
    for (app, headers) in [
        (&guarded.app, vec![("authorization", key.as_slice())]),
        (&open, vec![]),
    ] {
        let wire = Wire::new(app);
        for endpoint in endpoints(app).await {
            let changes = endpoint.face != Face::Rest || !endpoint.name.starts_with("GET");
            for (name, value) in [
                ("origin", "https://evil.example"),
                ("origin", "null"),
                ("origin", "http://127.0.0.1:1"),
                ("sec-fetch-site", "cross-site"),
                ("sec-fetch-site", "same-site"),
            ] {
                let headers = [headers.clone(), vec![(name, value.as_bytes())]].concat();
                let answer = wire.ask(&endpoint, "nowhere", &headers).await;
                if changes {
                    assert_eq!(
                        answer.status, 403,
                        "{endpoint:?} {name}: {value}: {answer:?}"
                    );
                    assert!(answer.text.contains("--cors-origins"), "{answer:?}");
                } else {
                    assert!(
                        answer.is_let_in(),
                        "{endpoint:?} {name}: {value}: {answer:?}"
                    );
                }
            }
            let own = format!("http://{}", app.address);
            let headers = [
                headers.clone(),
                vec![
                    ("origin", own.as_bytes()),
                    ("sec-fetch-site", b"same-origin"),
                ],
            ]
            .concat();
            assert!(
                wire.ask(&endpoint, "nowhere", &headers).await.is_let_in(),
                "{endpoint:?} of its own page"
            );
        }
    }
    let wire = Wire::new(&guarded.app);
    let headers = [
        ("authorization", key.as_slice()),
        ("origin", b"https://game.example"),
    ];
    let fit = Asked {
        face: Face::Rest,
        name: "POST /v1/environments/{environment}/fit".into(),
    };
    assert!(
        wire.ask(&fit, "nowhere", &headers).await.is_let_in(),
        "an origin that is allowed"
    );
}

#[tokio::test]
async fn preflights_pass_and_allow_the_header_of_keys() {
    let settings = Settings {
        cors_origins: vec!["https://game.example".into()],
        ..Settings::default()
    };
    let Guarded { app, .. } = Guarded::with(&[], settings).await;
    let request =
        reqwest::Client::new().request(http::Method::OPTIONS, app.url("/v1/environments/lane"));
    let request = request
        .header("origin", "https://game.example")
        .header("access-control-request-method", "PUT");
    let response = request
        .header("access-control-request-headers", "authorization")
        .send()
        .await
        .expect("answered");
    assert_eq!(response.status(), 200);
    let allowed = response.headers()["access-control-allow-headers"]
        .to_str()
        .expect("text")
        .to_owned();
    assert!(allowed.contains("authorization"), "{allowed}");
}

#[tokio::test]
async fn a_host_is_one_of_the_service_unless_there_is_a_key() {
    let (key, line) = key("right read,ingest,train,admin");
    let settings = || Settings {
        hosts: vec!["nudge.example".into()],
        ..Settings::default()
    };
    let guarded = Guarded::with(&[&line], settings()).await;
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    let open = TestApp::set(directory, store, settings()).await;
    let key = bearer(&key);
    for app in [&guarded.app, &open] {
        let wire = Wire::new(app);
        for endpoint in endpoints(app).await {
            let is_for_machines = [
                "/metrics",
                "/livez",
                "/readyz",
                "/v2/health/live",
                "/v2/health/ready",
            ]
            .iter()
            .any(|path| endpoint.name.ends_with(path))
                || ["/Check", "/ServerLive", "/ServerReady"]
                    .iter()
                    .any(|method| endpoint.name.ends_with(method));
            for foreign in ["evil.example", "127.0.0.1.evil.example:8080", "10.9.8.7"] {
                let answer = wire
                    .ask(&endpoint, "nowhere", &[("host", foreign.as_bytes())])
                    .await;
                if is_for_machines {
                    assert_ne!(answer.status, 403, "{endpoint:?} for {foreign}: {answer:?}");
                } else {
                    assert_eq!(answer.status, 403, "{endpoint:?} for {foreign}: {answer:?}");
                    assert!(answer.text.contains("--hosts"), "{answer:?}");
                }
            }
            let named = wire
                .ask(&endpoint, "nowhere", &[("host", b"nudge.example:8080")])
                .await;
            assert_ne!(named.status, 403, "{endpoint:?}: {named:?}");
        }
    }
    let wire = Wire::new(&guarded.app);
    for endpoint in endpoints(&guarded.app).await {
        let answer = wire
            .ask(
                &endpoint,
                "nowhere",
                &[("authorization", &key), ("host", b"evil.example")],
            )
            .await;
        assert!(answer.is_let_in(), "{endpoint:?} with a key: {answer:?}");
    }
}

#[tokio::test]
async fn what_does_not_say_that_it_is_grpc_is_none() {
    let app = TestApp::start().await;
    app.lane().await;
    let wire = Wire::new(&app);
    for method in nudge::api::grpc_methods() {
        for media in [
            "text/plain",
            "application/x-www-form-urlencoded",
            "multipart/form-data",
            "application/json",
            "application/grpcx",
            "application/grpc+json",
            "application/grpc-web+thrift",
            "",
        ] {
            let answer = wire.grpc(&method, "lane", &[], media).await;
            assert_eq!(
                (answer.status, answer.reason.as_str()),
                (415, "UNSUPPORTED_MEDIA_TYPE"),
                "{method} as {media}"
            );
        }
    }
    app.app
        .environments
        .find("lane")
        .expect("it is still there");
    // A browser sends these from any page, some of them without asking; no call of gRPC is one.
    for (method, status) in [("GET", 405), ("HEAD", 405), ("PUT", 405), ("DELETE", 405)] {
        for media in [
            "application/grpc",
            "application/grpc-web+proto",
            "text/plain",
        ] {
            let path = app.url("/nudge.v1.EnvironmentService/DeleteEnvironment");
            let request = reqwest::Client::new().request(method.parse().expect("a method"), path);
            let answer = request
                .header("content-type", media)
                .body("x")
                .send()
                .await
                .expect("answered");
            assert_eq!(
                (answer.status().as_u16(), &answer.headers()["allow"]),
                (status, &"POST".parse().expect("a value"))
            );
        }
    }
    let answer = wire
        .grpc(
            "/nudge.v1.EnvironmentService/DeleteEnvironment",
            "lane",
            &[],
            "application/grpc+proto",
        )
        .await;
    assert!(
        answer.is_let_in() && app.app.environments.find("lane").is_err(),
        "{answer:?}"
    );
}

#[tokio::test]
async fn a_stranger_is_told_no_more_than_that_a_key_is_wanted() {
    let (_, line) = key("game read");
    let Guarded { app, .. } = Guarded::start(&[&line]).await;
    let wire = Wire::new(&app);
    for method in [
        "/nudge.v1.EnvironmentService/Invented",
        "/nudge.v1.EnvironmentService/DeleteEnvironment",
    ] {
        for media in [
            "application/grpc",
            "application/grpc+json",
            "text/plain",
            "",
        ] {
            let answer = wire.grpc(method, "lane", &[], media).await;
            assert_eq!(answer.status, 401, "{method} as {media:?}: {answer:?}");
        }
    }
}
