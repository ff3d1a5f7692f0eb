//! One default, one truth: what OpenAPI, the protos and `--help` say of defaults and limits is what
//! the service does.

use std::path::Path;

use nudge::domain::{Training, page_size};
use serde_json::{Value, json};

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::TestApp;

/// The numbers of a training, with their defaults.
fn training() -> [(&'static str, u64); 5] {
    let usual = Training::default();
    [
        ("width", usual.width as u64),
        ("members", usual.members as u64),
        ("folds", usual.folds as u64),
        ("epochs", usual.epochs as u64),
        ("seed", usual.seed),
    ]
}

/// Returns a number as people read it: 1,024.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let groups: Vec<_> = digits.as_bytes().rchunks(3).rev().collect();
    String::from_utf8(groups.join(&b',')).expect("digits")
}

/// Returns what a proto file says above a field of a message.
fn comment(file: &str, message: &str, field: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("proto/nudge/v1")
        .join(file);
    let text = std::fs::read_to_string(path).expect("a proto file");
    let (_, body) = text
        .split_once(&format!("message {message} {{"))
        .unwrap_or_else(|| panic!("no {message} in {file}"));
    let (body, _) = body.split_once("\n}").expect("its end");

    let mut comment = String::new();
    for line in body.lines().map(str::trim) {
        match line.strip_prefix("//") {
            Some(said) => comment += said,
            None if line.contains(&format!(" {field} = ")) => return comment,
            None => comment.clear(),
        }
    }
    panic!("no {message}.{field} in {file}")
}

/// Returns the limits of a number that the service tells whoever passes them: "1 to 1,024".
async fn limits(app: &TestApp, number: &str) -> String {
    let asked = json!({ number: 4_000_000_000_u64 });
    let (status, told) = app
        .rest("POST", "/v1/environments/lane/models", Some(&asked))
        .await;
    assert_eq!(status, 400, "{told}");
    let faults = told["errors"].as_array().expect("faults").clone();
    let fault = faults
        .iter()
        .find(|fault| fault["pointer"] == format!("/{number}"))
        .unwrap_or_else(|| panic!("{number}: {told}"));
    let (_, limits) = fault["detail"]
        .as_str()
        .and_then(|detail| detail.split_once("expected "))
        .expect("what was expected");
    let (fewest, most) = limits.split_once(" to ").expect("two numbers");
    let [fewest, most] = [fewest, most].map(|number| number.parse().expect("a number"));
    format!("{} to {}", grouped(fewest), grouped(most))
}

#[tokio::test]
async fn a_training_is_documented_as_it_is_done() {
    let app = TestApp::start().await;
    app.lane().await;
    let document = app.get("/openapi.json").await;
    let fields = &document["components"]["schemas"]["TrainingRequest"]["properties"];

    for (name, usual) in training() {
        let default = format!("{} by default", grouped(usual));
        let in_proto = comment("model.proto", "TrainModelRequest", name);
        assert!(in_proto.contains(&default), "{name}: {in_proto}");
        let in_openapi = fields[name]["description"].as_str().expect("a text");
        assert!(in_openapi.contains(&default), "{name}: {in_openapi}");

        // Every seed is one.
        if name == "seed" {
            continue;
        }
        let limits = limits(&app, name).await;
        assert!(in_proto.contains(&limits), "{name} is {limits}: {in_proto}");
        let [fewest, most] = ["minimum", "maximum"].map(|bound| {
            let bound = &fields[name][bound];
            grouped(bound.as_u64().unwrap_or_else(|| panic!("{name}: {bound}")))
        });
        assert_eq!(format!("{fewest} to {most}"), limits, "{name} in OpenAPI");
    }
    app.stop().await;
}

#[tokio::test]
async fn train_tells_its_defaults() {
    let (code, help, _) = exit_and_texts(&output(nudge("", &["train", "--help"])).await);
    assert_eq!(code, 0);
    for (name, usual) in training() {
        let (_, after) = help
            .split_once(&format!("--{name} <"))
            .unwrap_or_else(|| panic!("{name}: {help}"));
        let (said, _) = after.split_once("\n\n").unwrap_or((after, ""));
        let words = said.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(
            words.ends_with(&format!("; {} unless given", grouped(usual))),
            "{name}: {words}"
        );
    }
}

#[tokio::test]
async fn pages_are_documented_as_they_are_cut() {
    let app = TestApp::start().await;
    app.lane().await;
    let usual = page_size(0).expect("a default") as u64;
    let most = (1..=100_000)
        .rev()
        .find(|size| page_size(*size).is_ok())
        .expect("a limit");
    let document = app.get("/openapi.json").await;

    let lists = [
        ("", usual, ("environment.proto", "ListEnvironmentsRequest")),
        (
            "/{environment}/states",
            usual,
            ("influence.proto", "ListStatesRequest"),
        ),
        (
            "/{environment}/models",
            most,
            ("model.proto", "ListModelsRequest"),
        ),
    ];
    for (path, usual, (file, message)) in lists {
        let in_proto = comment(file, message, "page_size");
        let expected = format!("1 to {}; 0 for {}", grouped(most), grouped(usual));
        assert!(in_proto.contains(&expected), "{message}: {in_proto}");

        let operation = &document["paths"][format!("/v1/environments{path}")]["get"];
        let parameters = operation["parameters"].as_array().expect("parameters");
        let parameter: &Value = parameters
            .iter()
            .find(|parameter| parameter["name"] == "page_size")
            .expect("a page size");
        assert_eq!(parameter["schema"]["maximum"], most, "{path}");
        let said = parameter["description"].as_str().expect("a text");
        let expected = format!("1 to {}; {} by default", grouped(most), grouped(usual));
        assert!(said.contains(&expected), "{path}: {said}");

        let asked = format!("/v1/environments{path}?page_size={}", most + 1);
        let asked = asked.replace("{environment}", "lane");
        assert_eq!(app.rest("GET", &asked, None).await.0, 400, "{asked}");
    }
    app.stop().await;
}
