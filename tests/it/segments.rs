//! Segments with other habits, asked of the running service: what looks like dependence when they
//! are pooled, and is none within them.

use nudge::api::{json as dto, proto};
use serde_json::{Value, json};
use tonic::Code;

use crate::cli;
use crate::support::{TestApp, reason};

const WORLD: &str = "/v1/environments/world";

/// Places where two segments have opposite habits and nothing depends on anything.
const OPPOSITE: [u64; 6] = [0, 1, 2, 3, 4, 5];
/// Where the human copies the robot in both segments.
const COPIED: u64 = 6;
/// Where it copies it in one segment and does the opposite in the other.
const REVERSED: u64 = 7;
/// Where every visit is of a trial of its own.
const SINGLE: u64 = 8;
/// Seen in one segment only.
const ALONE: u64 = 9;
/// Never seen.
const UNSEEN: u64 = 10;

/// How often two agents with two actions did what, in two segments.
type Habits = [[u64; 4]; 2];

fn habits(place: u64) -> Habits {
    match place {
        COPIED => [[30, 0, 0, 30], [20, 0, 0, 20]],
        REVERSED => [[30, 0, 0, 30], [0, 30, 30, 0]],
        ALONE => [[12, 9, 8, 12], [0; 4]],
        SINGLE | UNSEEN => [[0; 4]; 2],
        // Outer products: 9 to 1 by 9 to 1, and the other way round.
        _ => [[81, 9, 9, 1], [1, 9, 9, 81]],
    }
}

async fn world() -> TestApp {
    let app = TestApp::start().await;
    let agent = |name: &str| json!({"name": name, "action": [{"name": "move", "integer": {"min": 0, "max": 1}}]});
    let description = json!({
        "state": [{"name": "place", "integer": {"min": 0, "max": UNSEEN}}],
        "agents": [agent("robot"), agent("human"), agent("dog")],
    });
    let (status, answer) = app.rest("PUT", WORLD, Some(&description)).await;
    assert_eq!(status, 201, "{answer}");
    for (sequence, segment) in [(1, "a"), (2, "b")] {
        let transitions = (0..UNSEEN).flat_map(|place| {
            let counted = habits(place)[sequence as usize - 1].into_iter().zip(0..);
            counted
                .filter(|(n, _)| *n > 0)
                .map(move |(n, joint)| transition(place, joint, n))
        });
        send(&app, sequence, segment, transitions.collect()).await;
    }
    for trial in 0..12 {
        send(
            &app,
            3 + trial,
            &format!("trial {trial}"),
            vec![transition(SINGLE, trial % 2 * 3, 1)],
        )
        .await;
    }
    app
}

/// The robot and the human acted; the dog never does anything else.
fn transition(place: u64, joint: u64, n: u64) -> Value {
    let actions = json!({"robot": joint / 2, "human": joint % 2, "dog": 0});
    json!({"state": {"place": place}, "actions": actions, "count": n})
}

async fn send(app: &TestApp, sequence: u64, segment: &str, transitions: Vec<Value>) {
    let body = json!({"producer": "p", "sequence": sequence, "segment": segment, "transitions": transitions});
    let (status, receipt) = app
        .rest("POST", &format!("{WORLD}/transitions"), Some(&body))
        .await;
    assert_eq!(
        (status, &receipt["rejected_count"]),
        (200, &json!(0)),
        "{receipt}"
    );
}

async fn get(app: &TestApp, path: &str) -> Value {
    app.get(&format!("{WORLD}/{path}")).await
}

async fn answer(app: &TestApp, query: &str) -> Value {
    get(app, &format!("influence?{query}")).await["answers"][0].take()
}

async fn p_value(app: &TestApp, query: &str) -> f64 {
    answer(app, query).await["significance"]["p_value"]
        .as_f64()
        .expect("tested")
}

/// Returns a figure of mutual information.
fn figure(answer: &Value, name: &str) -> f64 {
    answer["mutual_information"][name]
        .as_f64()
        .expect("a number")
}

fn keys(page: &Value) -> Vec<u64> {
    let states = page["states"].as_array().expect("a list");
    states
        .iter()
        .map(|state| {
            state["state"]["key"]
                .as_str()
                .expect("a key")
                .parse()
                .expect("a place")
        })
        .collect()
}

#[tokio::test]
async fn opposite_habits_are_no_dependence_within_segments() {
    let app = world().await;
    for within in ["", "&within=auto", "&within=segments"] {
        let p = p_value(&app, &format!("key=0&significance=auto{within}")).await;
        assert!(p > 0.999_999, "{within}: {p}");
    }
    assert!(p_value(&app, "key=0&significance=auto&within=pooled").await < 1e-6);
    // What is said of the test counts more than what is said of all.
    assert!(p_value(&app, "key=0&significance=pooled").await < 1e-6);
    assert!(p_value(&app, "key=0&significance=within_segments&within=pooled").await > 0.999_999);
    // Dependence that every segment has stays.
    assert!(p_value(&app, &format!("key={COPIED}&significance=auto")).await < 1e-6);
}

#[tokio::test]
async fn the_evidence_knows_about_segments() {
    let app = world().await;
    let (status, fitted) = app.rest("POST", &format!("{WORLD}/fit"), None).await;
    assert_eq!(status, 200, "{fitted}");
    let dependence = async |query: &str| {
        let told = answer(&app, query).await;
        (
            told["dependence"].as_str().expect("a word").to_owned(),
            told["probability"]["dependent"].as_f64(),
        )
    };
    for within in ["auto", "segments"] {
        let (word, p) = dependence(&format!("key=0&within={within}")).await;
        assert!(
            word != "established" && p < Some(0.5),
            "{within}: {word} {p:?}"
        );
        assert_eq!(
            dependence(&format!("key={COPIED}&within={within}")).await.0,
            "established",
            "{within}"
        );
        assert_eq!(
            dependence(&format!("key={REVERSED}&within={within}"))
                .await
                .0,
            "established",
            "{within}"
        );
    }
    assert_eq!(dependence("key=0&within=pooled").await.0, "established");

    // What was found in all segments is what one of them is judged by.
    let (word, p) = dependence("key=0&segments=a").await;
    assert!(word != "established" && p < Some(0.5), "{word} {p:?}");

    let differ = async |query: &str| answer(&app, query).await["segmentation"]["differ"].as_f64();
    assert!(
        differ("key=0").await > Some(0.9),
        "{:?}",
        differ("key=0").await
    );
    assert_eq!(
        (
            differ("key=0&within=pooled").await,
            differ("key=0&segments=a").await
        ),
        (None, None)
    );
    let summary = get(&app, "summary").await;
    assert!(summary["segmentation"]["differ"].as_f64() > Some(0.3));
    assert!(summary["habits_differ"].as_f64() > Some(0.3));

    // Nobody needs to ask for a test to be warned.
    let warned = answer(&app, "key=0").await["warnings"].clone();
    let warned = warned[0].as_str().expect("a sentence");
    assert!(
        warned.starts_with("pooled P(dependent) ")
            && warned.ends_with("segments whose habits differ"),
        "{warned}"
    );
    assert_eq!(
        answer(&app, &format!("key={COPIED}")).await.get("warnings"),
        None
    );
    let expected = "in 6 states pooled P(dependent) >= 0.95, but <= 0.5 where segments are told apart: \
                    what looks like dependence may be segments whose habits differ";
    let summary = get(&app, "summary").await;
    assert!(
        summary["warnings"]
            .as_array()
            .expect("a list")
            .contains(&json!(expected)),
        "{}",
        summary["warnings"]
    );

    let listed = async |within: &str| {
        let mut listed = keys(&get(&app, &format!("states?fdr=0.05&within={within}")).await);
        listed.sort_unstable();
        listed
    };
    // In a dozen trials of one visit each both did the same every time: habits of their own would
    // hardly agree so often.
    assert_eq!(listed("auto").await, [COPIED, REVERSED, SINGLE]);
    assert!(listed("pooled").await.starts_with(&OPPOSITE));

    let moved = async |within: &str| {
        let told = answer(&app, &format!("key=0&view=full&within={within}")).await;
        told["by_action"][1]["divergence"].as_f64().expect("seen")
    };
    let (auto, pooled) = (moved("auto").await, moved("pooled").await);
    assert!(auto < 0.05 && pooled > 0.1, "{auto} {pooled}");
}

#[tokio::test]
async fn figures_are_pooled_unless_they_are_asked_for_within_segments() {
    let app = world().await;
    let [auto, pooled, segments] =
        ["auto", "pooled", "segments"].map(|within| format!("key=0&within={within}"));
    let (auto, pooled) = (answer(&app, &auto).await, answer(&app, &pooled).await);
    for name in ["plug_in", "expected_if_independent"] {
        assert_eq!(
            figure(&auto, name),
            figure(&pooled, name),
            "the paper's figure"
        );
    }
    assert!(figure(&auto, "plug_in") > 0.2, "{auto}");
    let within = answer(&app, &segments).await;
    assert!(figure(&within, "plug_in") < 1e-12, "{within}");
    assert!(
        figure(&within, "expected_if_independent") > figure(&auto, "expected_if_independent"),
        "two small tables"
    );
    let moved = |answer: &Value| {
        answer["by_action"][0]["plug_in_divergence"]
            .as_f64()
            .expect("visited")
    };
    assert!(
        moved(&within) < 1e-12 && moved(&auto) > 0.1,
        "its parts are within segments too"
    );
    // The paper's rule goes by the plug-in that is told.
    let verdict = async |within: &str| {
        let query = format!("key=0&rule.kind=paper&rule.threshold=0.1&within={within}");
        answer(&app, &query).await["verdict"]
            .as_str()
            .expect("a word")
            .to_owned()
    };
    let verdicts = [
        verdict("auto").await,
        verdict("segments").await,
        verdict("auto").await,
    ];
    assert_eq!(
        verdicts,
        ["influences", "no_influence", "influences"],
        "none of them remembers the other"
    );
}

#[tokio::test]
async fn one_segment_is_the_same_to_the_bit_however_it_is_asked_about() {
    let app = world().await;
    for asked in [
        format!("key={ALONE}"),
        "key=0&segments=a".into(),
        format!("key={UNSEEN}"),
        "key=3&segments=b&given=dog".into(),
    ] {
        let told = async |within: &str| {
            answer(
                &app,
                &format!("{asked}&estimators=nsb,excess&significance=auto&within={within}"),
            )
            .await
        };
        let pooled = told("pooled").await;
        assert!(
            pooled["segmentation"]["count"].as_u64().expect("a number") <= 1,
            "{pooled}"
        );
        assert_eq!(
            [told("auto").await, told("segments").await],
            [pooled.clone(), pooled],
            "{asked}"
        );
    }
    let named = p_value(&app, "key=0&segments=a&significance=auto").await;
    assert_eq!(
        named,
        p_value(&app, "key=0&segments=a&significance=pooled").await
    );
}

#[tokio::test]
async fn listings_are_within_segments_unless_they_are_pooled() {
    let app = world().await;
    let mut found = Vec::new();
    for within in ["auto", "pooled", "auto"] {
        let page = get(&app, &format!("states?fdr=0.05&method=bh&within={within}")).await;
        let summary = get(&app, &format!("summary?fdr=0.05&method=bh&within={within}")).await;
        assert_eq!(
            summary["discoveries"]["states"],
            keys(&page).len(),
            "{within}"
        );
        let mut listed = keys(&page);
        listed.sort_unstable();
        found.push(listed);
    }
    assert_eq!(
        found[0],
        [COPIED, REVERSED],
        "nothing depends on anything elsewhere"
    );
    assert_eq!(
        found[2], found[0],
        "what was found otherwise meanwhile is kept apart"
    );
    let pooled: Vec<u64> = OPPOSITE.into_iter().chain([COPIED, SINGLE]).collect();
    assert_eq!(found[1], pooled);
    let page = async |within: &str| {
        get(
            &app,
            &format!("states?order_by=plug_in%20desc&page_size=1&within={within}"),
        )
        .await
    };
    assert_eq!(keys(&page("segments").await).len(), 1);
    let least = get(
        &app,
        "states?order_by=plug_in%20asc&page_size=7&within=segments",
    )
    .await;
    let mut least = keys(&least);
    least.sort_unstable();
    assert_eq!(
        least,
        [&OPPOSITE[..], &[SINGLE]].concat(),
        "a ranking is of what is told"
    );
}

#[tokio::test]
async fn answers_and_the_summary_say_which_segments_they_come_from() {
    let app = world().await;
    for (query, count) in [
        ("key=0", 2),
        ("key=0&segments=a", 1),
        ("key=0&segments=a,b&within=pooled", 2),
        (&*format!("key={SINGLE}"), 12),
        (&*format!("key={SINGLE}&segments=a,b"), 0),
        (&*format!("key={UNSEEN}"), 0),
    ] {
        assert_eq!(
            answer(&app, query).await["segmentation"]["count"],
            count,
            "{query}"
        );
    }
    assert!(
        answer(&app, "key=0&view=verdict")
            .await
            .get("segmentation")
            .is_none()
    );
    for (query, count) in [("", 14), ("?segments=a,b", 2), ("?segments=trial%203", 1)] {
        assert_eq!(
            get(&app, &format!("summary{query}")).await["segmentation"]["count"],
            count,
            "{query}"
        );
    }
    // Transitions without a segment are one.
    send(&app, 15, "a", vec![transition(UNSEEN, 0, 1)]).await;
    let body = json!({"producer": "p", "sequence": 16, "transitions": [transition(UNSEEN, 0, 1)]});
    assert_eq!(
        app.rest("POST", &format!("{WORLD}/transitions"), Some(&body))
            .await
            .0,
        200
    );
    assert_eq!(
        answer(&app, &format!("key={UNSEEN}")).await["segmentation"]["count"],
        2
    );
    assert_eq!(get(&app, "summary").await["segmentation"]["count"], 15);
}

#[tokio::test]
async fn tests_that_disagree_are_told() {
    let app = world().await;
    let warnings = async |query: &str| {
        let told = answer(&app, query).await["warnings"]
            .as_array()
            .cloned()
            .unwrap_or_default();
        told.iter()
            .map(|told| told.as_str().expect("a sentence").to_owned())
            .collect::<Vec<_>>()
    };
    for test in ["auto", "pooled", "within_segments"] {
        for (place, ending) in [
            (
                0,
                "what looks like dependence may be segments whose habits differ",
            ),
            (
                REVERSED,
                "segments depend in different ways, which pooling hides",
            ),
            (
                SINGLE,
                "each has too few draws to tell dependence from habits that differ",
            ),
        ] {
            let told = warnings(&format!("key={place}&significance={test}")).await;
            assert!(
                told.len() == 1 && told[0].ends_with(ending),
                "{place}: {told:?}"
            );
        }
        for place in [COPIED, ALONE, UNSEEN] {
            assert!(
                warnings(&format!("key={place}&significance={test}"))
                    .await
                    .is_empty(),
                "{place}"
            );
        }
        assert!(
            warnings(&format!("key=0&segments=a&significance={test}"))
                .await
                .is_empty(),
            "one segment alone"
        );
    }
    let by_evidence = warnings("key=0").await;
    assert!(
        by_evidence
            .iter()
            .all(|told| told.starts_with("pooled P(dependent) ")),
        "no test, no word about tests"
    );
    assert!(
        warnings("key=0&within=pooled").await.is_empty(),
        "nothing to compare"
    );
    let expected = json!([
        "in 6 states pooled p <= 0.01, but within segments p > 0.1: what looks like dependence may be segments whose habits differ",
        "in 1 state pooled p <= 0.01, but within segments p > 0.1: each has too few draws to tell dependence from habits that differ",
        "in 1 state within segments p <= 0.01, but pooled p > 0.1: segments depend in different ways, which pooling hides",
    ]);
    for within in ["auto", "pooled", "segments"] {
        let summary = get(&app, &format!("summary?fdr=0.05&method=bh&within={within}")).await;
        assert_eq!(summary["warnings"], expected, "{within}");
    }
    assert!(
        get(&app, "summary?within=pooled")
            .await
            .get("warnings")
            .is_none()
    );
}

/// Every question of a pair in a query string.
const QUESTIONS: [&str; 5] = [
    "influence?key=0",
    "states?",
    "summary?",
    "explore?",
    "graph?key=0",
];

#[tokio::test]
async fn every_question_takes_the_words_and_refuses_others() {
    let app = world().await;
    let wrong = |word: &str| format!("got {word:?}, expected auto, segments or pooled");
    for question in QUESTIONS {
        for word in ["auto", "segments", "pooled"] {
            get(&app, &format!("{question}&within={word}")).await;
        }
        for word in ["Auto", "segment", "within_segments", "0"] {
            let (status, problem) = app
                .rest("GET", &format!("{WORLD}/{question}&within={word}"), None)
                .await;
            let faults = json!([{"pointer": "/within", "detail": wrong(word)}]);
            assert_eq!(
                (status, &problem["errors"]),
                (400, &faults),
                "{question} {word}"
            );
        }
    }
    let body = |within: Value| json!({"keys": ["0"], "within": within});
    let influence = format!("{WORLD}/influence");
    assert_eq!(
        app.rest("POST", &influence, Some(&body(json!("segments"))))
            .await
            .0,
        200
    );
    for (within, detail) in [
        (json!("all"), Some(wrong("all"))),
        (json!(""), Some(wrong(""))),
        (json!(1), None),
    ] {
        let (status, problem) = app.rest("POST", &influence, Some(&body(within))).await;
        assert_eq!(
            (status, &problem["errors"][0]["pointer"]),
            (400, &json!("/within")),
            "{problem}"
        );
        assert!(
            detail.is_none_or(|detail| problem["errors"][0]["detail"] == *detail),
            "{problem}"
        );
    }
}

#[tokio::test]
async fn the_other_faces_say_the_same() {
    let app = world().await;
    let mut client = app.influence().await;
    for (word, within) in [
        ("auto", proto::Within::Auto),
        ("segments", proto::Within::Segments),
        ("pooled", proto::Within::Pooled),
    ] {
        let scope = || {
            Some(proto::Scope {
                environment: "world".into(),
                within: within.into(),
                ..Default::default()
            })
        };
        let (_, over_rest) = app
            .rest(
                "GET",
                &format!("{WORLD}/influence?key=0&significance=auto&within={word}"),
                None,
            )
            .await;
        let request = proto::BatchGetInfluenceRequest {
            scope: scope(),
            keys: vec!["0".into()],
            view: proto::View::Full.into(),
            significance: proto::Permutations::Auto.into(),
            ..Default::default()
        };
        let over_grpc = client
            .batch_get_influence(request)
            .await
            .expect("valid")
            .into_inner();
        assert_eq!(
            serde_json::to_value(dto::Answers::from(over_grpc)).expect("JSON"),
            over_rest,
            "{word}"
        );

        let address = app.address.to_string();
        let arguments = [
            "query",
            "world",
            "--key",
            "0",
            "--significance",
            "auto",
            "--within",
            word,
            "--json",
        ];
        let (code, stdout, stderr) =
            cli::exit_and_texts(&cli::output(cli::nudge(&address, &arguments)).await);
        assert_eq!(code, 0, "{stderr}");
        assert_eq!(
            serde_json::from_str::<Value>(&stdout).expect("JSON"),
            over_rest,
            "{word}"
        );

        let discovery = Some(proto::Discovery {
            fdr: Some(0.05),
            method: proto::DiscoveryMethod::Bh.into(),
        });
        let summary = client
            .summarize(proto::SummarizeRequest {
                scope: scope(),
                discovery,
                omit_segments: false,
            })
            .await;
        let summary = dto::Summary::from(summary.expect("valid").into_inner());
        let over_rest = get(&app, &format!("summary?fdr=0.05&method=bh&within={word}")).await;
        assert_eq!(
            serde_json::to_value(summary).expect("JSON"),
            over_rest,
            "{word}"
        );
    }
}

#[tokio::test]
async fn the_other_faces_refuse_the_same() {
    let app = world().await;
    let mut client = app.influence().await;
    let scope = || {
        Some(proto::Scope {
            environment: "world".into(),
            within: 9,
            ..Default::default()
        })
    };
    let key = Some(proto::get_influence_request::State::Key("0".into()));
    let refusals = [
        client
            .get_influence(proto::GetInfluenceRequest {
                scope: scope(),
                state: key,
                ..Default::default()
            })
            .await
            .err(),
        client
            .batch_get_influence(proto::BatchGetInfluenceRequest {
                scope: scope(),
                ..Default::default()
            })
            .await
            .err(),
        client
            .list_states(proto::ListStatesRequest {
                scope: scope(),
                ..Default::default()
            })
            .await
            .err(),
        client
            .summarize(proto::SummarizeRequest {
                scope: scope(),
                ..Default::default()
            })
            .await
            .err(),
        client
            .explore(proto::ExploreRequest {
                scope: scope(),
                ..Default::default()
            })
            .await
            .err(),
    ];
    for refused in refusals {
        let refused = refused.expect("9 is no word");
        assert_eq!(
            (refused.code(), &*reason(&refused)),
            (Code::InvalidArgument, "INVALID_INPUT")
        );
        assert!(
            refused.message().contains("/within") && refused.message().contains("got 9"),
            "{refused}"
        );
    }
    let arguments = ["query", "world", "--key", "0", "--within", "all"];
    let (code, _, stderr) =
        cli::exit_and_texts(&cli::output(cli::nudge(&app.address.to_string(), &arguments)).await);
    assert_eq!(code, 2);
    assert!(
        stderr.contains("--within")
            && stderr.contains("all")
            && stderr.contains("auto, segments, pooled"),
        "{stderr}"
    );
}

#[tokio::test]
async fn a_person_is_told_of_segments_and_warned() {
    let app = world().await;
    let arguments = ["query", "world", "--key", "0", "--significance", "auto"];
    let (code, stdout, _) =
        cli::exit_and_texts(&cli::output(cli::nudge(&app.address.to_string(), &arguments)).await);
    assert_eq!(code, 0);
    assert!(
        stdout.contains("\nfrom 2 segments\n")
            || stdout.contains("\nfrom 2 segments, P(habits differ)"),
        "{stdout}"
    );
    assert!(
        stdout.contains("\nwarning: pooled p < 0.0001, but within segments p = 1.0000: "),
        "{stdout}"
    );
}
