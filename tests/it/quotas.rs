//! Bounds of what had none: environments, models, bytes of a description and of every page of a
//! list.

use std::sync::Arc;

use nudge::api::proto;
use nudge::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
use nudge::domain::{Schema, SchemaDraft};
use nudge::store::{NewModel, Options, Quotas};
use prost::Message;
use serde_json::{Value, json};
use tempfile::TempDir;
use tonic::{Code, Status};
use tonic_types::StatusExt;

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::{TestApp, lane_json, lane_schema, open, reason};

const ENVIRONMENTS: &str = "/v1/environments";
const MESSAGE: usize = 4 << 20;

async fn with(quotas: Quotas) -> TestApp {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(
        directory.path(),
        Options {
            quotas,
            ..Options::default()
        },
    )
    .await;
    TestApp::with(directory, store).await
}

/// A world whose description is mostly edges: so many features of the state with so many of them.
fn wide(features: usize, edges: u32) -> SchemaDraft {
    let feature = |name: String, kind| FeatureDraft {
        name,
        unit: None,
        kinds: vec![kind],
    };
    let edges: Vec<f64> = (0..edges).map(f64::from).collect();
    let agent = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![feature("move".into(), KindDraft::Integer(0, 1))],
        ..AgentDraft::default()
    };
    let state = (0..features)
        .map(|at| feature(format!("f{at}"), KindDraft::Continuous(edges.clone())))
        .collect();
    SchemaDraft {
        state,
        agents: vec![agent("robot"), agent("human")],
        ..SchemaDraft::default()
    }
}

fn described(draft: &SchemaDraft) -> Value {
    let feature = |feature: &FeatureDraft| match &feature.kinds[0] {
        KindDraft::Continuous(edges) => {
            json!({"name": feature.name, "continuous": {"edges": edges}})
        }
        KindDraft::Integer(min, max) => {
            json!({"name": feature.name, "integer": {"min": min, "max": max}})
        }
        other => panic!("{other:?}"),
    };
    let features = |features: &[FeatureDraft]| features.iter().map(feature).collect::<Value>();
    let agent = |agent: &AgentDraft| json!({"name": agent.name, "action": features(&agent.action)});
    json!({"state": features(&draft.state), "agents": draft.agents.iter().map(agent).collect::<Value>()})
}

async fn apply(app: &TestApp, name: &str, schema: proto::Schema) -> Result<(), Status> {
    let request = proto::ApplyEnvironmentRequest {
        name: name.into(),
        schema: Some(schema),
        rule: None,
        derived: None,
    };
    app.environments()
        .await
        .max_encoding_message_size(64 << 20)
        .apply_environment(request)
        .await
        .map(drop)
}

/// Makes one in the store, as an earlier build did.
async fn stored(app: &TestApp, name: &str, draft: &SchemaDraft) {
    let schema = Schema::try_from(draft).expect("valid");
    let name = name.parse().expect("a name");
    app.app
        .store
        .create(&name, &schema, &Default::default())
        .await
        .expect("made");
}

#[tokio::test]
async fn environments_have_a_quota_on_both_faces() {
    let app = with(Quotas {
        environments: 2,
        ..Quotas::default()
    })
    .await;
    let put = async |name: &str| {
        app.rest("PUT", &format!("{ENVIRONMENTS}/{name}"), Some(&lane_json()))
            .await
    };
    assert_eq!([put("a").await.0, put("b").await.0], [201, 201]);
    let (status, problem) = put("c").await;
    assert_eq!(
        (status, &problem["reason"], &problem["limit"]),
        (429, &json!("QUOTA_EXCEEDED"), &json!(2))
    );
    let detail = "2 environments are the most there may be here, and there are as many: delete one, or raise --max-environments";
    assert_eq!(problem["detail"], detail);
    let refused = apply(&app, "c", lane_schema()).await.expect_err("no room");
    assert_eq!(
        (refused.code(), reason(&refused)),
        (Code::ResourceExhausted, "QUOTA_EXCEEDED".into())
    );
    assert_eq!(refused.message(), detail);
    let metadata = refused.get_details_error_info().expect("details").metadata;
    assert_eq!(metadata.get("limit").map(String::as_str), Some("2"));

    assert_eq!(put("b").await.0, 200, "one that exists is no new one");
    assert_eq!(
        app.rest("DELETE", &format!("{ENVIRONMENTS}/a"), None)
            .await
            .0,
        204
    );
    assert_eq!(put("c").await.0, 201, "room is there at once");
}

#[tokio::test]
async fn models_have_a_quota_and_nothing_is_trained_for_none() {
    let app = with(Quotas {
        models: 1,
        ..Quotas::default()
    })
    .await;
    app.lane().await;
    let environment = app.app.environments.find("lane").expect("made");
    let model = NewModel {
        ego: 0,
        other: 1,
        kind: "joint".into(),
        card: "{}".into(),
        weights: vec![1],
    };
    app.app
        .store
        .keep_model(environment.id, &model)
        .await
        .expect("kept");
    let (status, problem) = app
        .rest("POST", "/v1/environments/lane/models", Some(&json!({})))
        .await;
    assert_eq!(
        (status, &problem["reason"], &problem["limit"]),
        (429, &json!("QUOTA_EXCEEDED"), &json!(1)),
        "{problem}"
    );
    assert!(
        problem["detail"]
            .as_str()
            .is_some_and(|detail| detail.ends_with("--max-models")),
        "{problem}"
    );
    let request = proto::TrainModelRequest {
        environment: "lane".into(),
        ..Default::default()
    };
    let refused = app
        .models()
        .await
        .train_model(request)
        .await
        .expect_err("no room");
    assert_eq!(
        (refused.code(), reason(&refused)),
        (Code::ResourceExhausted, "QUOTA_EXCEEDED".into())
    );
    assert_eq!(
        app.get("/v1/environments/lane/models").await["jobs"],
        json!([])
    );
}

#[tokio::test]
async fn a_new_description_is_bounded_and_an_old_one_stays() {
    let app = TestApp::start().await;
    let larger = wide(3, 60_000);
    let put = async |name: &str, draft: &SchemaDraft| {
        app.rest(
            "PUT",
            &format!("{ENVIRONMENTS}/{name}"),
            Some(&described(draft)),
        )
        .await
    };
    let (status, problem) = put("world", &larger).await;
    assert_eq!(
        (status, &problem["reason"]),
        (413, &json!("DESCRIPTION_TOO_LARGE")),
        "{problem}"
    );
    assert_eq!(
        (&problem["bytes"], &problem["limit_bytes"]),
        (&json!(larger.bytes()), &json!(1 << 20))
    );
    let words = format!(
        "the description has {} bytes of names, units, labels and edges, more than the limit of 1048576",
        larger.bytes()
    );
    assert!(
        problem["detail"]
            .as_str()
            .is_some_and(|detail| detail.starts_with(&words)),
        "{problem}"
    );
    let refused = apply(&app, "world", larger.clone().into())
        .await
        .expect_err("too large");
    assert_eq!(
        (refused.code(), reason(&refused)),
        (Code::OutOfRange, "DESCRIPTION_TOO_LARGE".into())
    );
    assert_eq!(
        app.rest("GET", &format!("{ENVIRONMENTS}/world"), None)
            .await
            .0,
        404
    );

    // What an earlier build took is confirmed, changed and opened as before; another of its size is
    // another schema.
    stored(&app, "world", &larger).await;
    assert_eq!(put("world", &larger).await.0, 200);
    assert_eq!(put("world", &wide(2, 60_000)).await.0, 409);
    assert_eq!(put("world", &wide(3, 60_001)).await.0, 413);
    let app = app.restart().await;
    let (status, again) = app
        .rest(
            "PUT",
            &format!("{ENVIRONMENTS}/world"),
            Some(&described(&larger)),
        )
        .await;
    assert_eq!(
        (status, again["state"].as_array().map(Vec::len)),
        (200, Some(3))
    );
}

/// Follows the pages of a list over REST and returns the names on each.
async fn pages(app: &TestApp, path: &str, list: &str, name: &str) -> Vec<Vec<String>> {
    let mut pages = Vec::new();
    let mut token = String::new();
    loop {
        let page = app.get(&format!("{path}page_token={token}")).await;
        let text = |item: &Value| {
            item[name]
                .as_str()
                .map_or_else(|| item[name].to_string(), str::to_owned)
        };
        pages.push(
            page[list]
                .as_array()
                .expect("a list")
                .iter()
                .map(text)
                .collect(),
        );
        match page["next_page_token"].as_str() {
            Some(next) => token = next.to_owned(),
            None => return pages,
        }
    }
}

#[tokio::test]
async fn large_environments_make_pages_that_can_be_sent() {
    let app = TestApp::start().await;
    let large = wide(2, 60_000);
    for at in 10..22 {
        apply(&app, &format!("world-{at}"), large.clone().into())
            .await
            .expect("made");
    }
    // One of an earlier build, which no message holds.
    stored(&app, "world-15.old", &wide(10, 60_000)).await;

    let mut client = app.environments().await;
    let mut listed: Vec<Vec<String>> = Vec::new();
    let mut page_token = String::new();
    loop {
        let request = proto::ListEnvironmentsRequest {
            page_size: 1_000,
            page_token,
        };
        let page = client
            .list_environments(request)
            .await
            .expect("a page that can be sent")
            .into_inner();
        assert!(page.encoded_len() <= MESSAGE, "{}", page.encoded_len());
        let is_whole =
            |one: &proto::Environment| one.schema.is_some() || one.name == "world-15.old";
        assert!(page.environments.iter().all(is_whole));
        listed.push(
            page.environments
                .into_iter()
                .map(|environment| environment.name)
                .collect(),
        );
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    let mut expected: Vec<String> = (10..22).map(|at| format!("world-{at}")).collect();
    expected.push("world-15.old".into());
    expected.sort();
    assert_eq!(listed.concat(), expected);
    assert!(
        listed.len() >= 4 && listed.iter().all(|page| !page.is_empty()),
        "{listed:?}"
    );
    assert_eq!(
        pages(
            &app,
            &format!("{ENVIRONMENTS}?page_size=1000&"),
            "environments",
            "name"
        )
        .await,
        listed
    );

    // Over REST it is told in whole.
    let old = app.get(&format!("{ENVIRONMENTS}/world-15.old")).await;
    assert_eq!(old["state"].as_array().map(Vec::len), Some(10));
    let (code, stdout, stderr) =
        exit_and_texts(&output(nudge(&app.address.to_string(), &["env", "list"])).await);
    assert_eq!(
        (code, stdout.lines().count()),
        (0, 1 + expected.len()),
        "{stdout}{stderr}"
    );
    assert!(
        stdout.lines().any(|line| line.starts_with("world-15.old ") && line.contains("larger than a message")),
        "{stdout}"
    );
}

#[tokio::test]
async fn large_states_make_pages_that_can_be_sent() {
    let app = TestApp::start().await;
    let label = |at: usize| format!("{}{at}", "左".repeat(62));
    let feature = |at: usize| json!({"name": format!("{}{at}", "f".repeat(60)), "categorical": {"labels": [label(0), label(1)]}});
    let state: Vec<Value> = (0..250).map(feature).collect();
    let description = json!({"state": state, "agents": lane_json()["agents"]});
    assert_eq!(
        app.rest("PUT", &format!("{ENVIRONMENTS}/wide"), Some(&description))
            .await
            .0,
        201
    );
    let states = 100_u32;
    let values = |at: u32| {
        (0..250)
            .map(|feature| {
                if feature < 7 {
                    (at >> feature & 1) as f32
                } else {
                    0.0
                }
            })
            .collect()
    };
    let row = |at| proto::Transition {
        state: values(at),
        actions: vec![0.0, 1.0],
        entry: 0,
        count: None,
        ..proto::Transition::default()
    };
    let write = proto::WriteRequest {
        environment: "wide".into(),
        producer: "p".into(),
        batch: Some(crate::support::rows(1, (0..states).map(row).collect())),
        ..Default::default()
    };
    app.ingest().await.write(write).await.expect("counted");

    let (mut seen, mut sizes) = (Vec::new(), Vec::new());
    let mut page_token = String::new();
    loop {
        let scope = Some(proto::Scope {
            environment: "wide".into(),
            ..Default::default()
        });
        let request = proto::ListStatesRequest {
            scope,
            page_size: 1_000,
            page_token,
            ..Default::default()
        };
        let page = app
            .influence()
            .await
            .list_states(request)
            .await
            .expect("a page that can be sent")
            .into_inner();
        assert!(page.encoded_len() <= MESSAGE);
        sizes.push(page.states.len());
        seen.extend(
            page.states
                .into_iter()
                .filter_map(|figures| Some(figures.state?.key)),
        );
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    let distinct: std::collections::BTreeSet<&String> = seen.iter().collect();
    assert_eq!(
        (seen.len(), distinct.len()),
        (states as usize, states as usize)
    );
    assert!(
        sizes.len() > 1 && sizes.iter().all(|size| *size > 0),
        "{sizes:?}"
    );
    let rest = pages(
        &app,
        &format!("{ENVIRONMENTS}/wide/states?page_size=1000&"),
        "states",
        "key",
    )
    .await;
    assert_eq!(
        rest.iter().map(Vec::len).collect::<Vec<_>>(),
        sizes,
        "the faces agree"
    );
}

#[tokio::test]
async fn models_come_in_pages() {
    let app = TestApp::start().await;
    app.lane().await;
    let environment = app.app.environments.find("lane").expect("made");
    let model = NewModel {
        ego: 0,
        other: 1,
        kind: "joint".into(),
        card: "{}".into(),
        weights: vec![1],
    };
    for _ in 0..5 {
        app.app
            .store
            .keep_model(environment.id, &model)
            .await
            .expect("kept");
    }
    let path = "/v1/environments/lane/models";
    let rest = pages(&app, &format!("{path}?page_size=2&"), "models", "version").await;
    assert_eq!(rest, [vec!["1", "2"], vec!["3", "4"], vec!["5"]]);
    assert_eq!(
        app.get(path).await["models"].as_array().map(Vec::len),
        Some(5)
    );
    assert_eq!(app.get(path).await["next_page_token"], Value::Null);
    let request = |page_size, token: &str| proto::ListModelsRequest {
        environment: "lane".into(),
        page_size,
        page_token: token.into(),
    };
    let page = app
        .models()
        .await
        .list_models(request(3, ""))
        .await
        .expect("a page")
        .into_inner();
    assert_eq!((page.models.len(), page.next_page_token.as_str()), (3, "3"));
    for (query, pointer) in [
        ("page_token=x", "/page_token"),
        ("page_token=03", "/page_token"),
        ("page_size=1001", "/page_size"),
    ] {
        let (status, problem) = app.rest("GET", &format!("{path}?{query}"), None).await;
        assert_eq!(
            (status, &problem["errors"][0]["pointer"]),
            (400, &json!(pointer)),
            "{query}: {problem}"
        );
    }
    let refused = app
        .models()
        .await
        .list_models(request(0, "-1"))
        .await
        .expect_err("no token");
    assert_eq!(refused.code(), Code::InvalidArgument);
}

#[tokio::test]
async fn what_is_no_token_of_a_page_is_refused_by_every_list() {
    let app = TestApp::start().await;
    app.lane().await;
    let lists = [
        ENVIRONMENTS,
        "/v1/environments/lane/states",
        "/v1/environments/lane/models",
    ];
    // The last one is a name that an environment may have.
    for token in [
        "garbage",
        "lane~",
        "lane~00000000",
        "vd-",
        "vd-+1-0.0",
        "~",
        "\u{5de6}",
        "%20",
        "-1",
        "lane",
    ] {
        for list in lists {
            let query: String = token.bytes().map(|byte| format!("%{byte:02x}")).collect();
            let (status, problem) = app
                .rest("GET", &format!("{list}?page_token={query}"), None)
                .await;
            let fault = &problem["errors"][0];
            assert_eq!(
                (status, &fault["pointer"]),
                (400, &json!("/page_token")),
                "{list} {token:?}: {problem}"
            );
            assert!(
                fault["detail"]
                    .as_str()
                    .expect("text")
                    .contains(&format!("{token:?}")),
                "{problem}"
            );
        }
        let page_token = token.to_owned();
        let request = proto::ListEnvironmentsRequest {
            page_size: 0,
            page_token: page_token.clone(),
        };
        let environments = app
            .environments()
            .await
            .list_environments(request)
            .await
            .expect_err("no token");
        let scope = Some(proto::Scope {
            environment: "lane".into(),
            ..Default::default()
        });
        let request = proto::ListStatesRequest {
            scope,
            page_token: page_token.clone(),
            ..Default::default()
        };
        let states = app
            .influence()
            .await
            .list_states(request)
            .await
            .expect_err("no token");
        let request = proto::ListModelsRequest {
            environment: "lane".into(),
            page_size: 0,
            page_token,
        };
        let models = app
            .models()
            .await
            .list_models(request)
            .await
            .expect_err("no token");
        for refused in [environments, states, models] {
            assert_eq!(refused.code(), Code::InvalidArgument, "{token:?}");
            let faults = refused
                .get_details_bad_request()
                .expect("the field is named")
                .field_violations;
            assert_eq!(faults[0].field, "/page_token", "{token:?}");
        }
    }
}
