//! Causal graphs: the same on every face, and as often right as they must be where it is known who
//! looks at whom.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use nudge::api::{json as dto, proto};
use nudge::app::App;
use nudge::domain::draft::{
    AgentDraft, FeatureDraft, KindDraft, QuestionDraft, SchemaDraft, StatesDraft,
};
use nudge::domain::{
    Acknowledged, Batch, EdgeKind, Entry, Environment, Graph, Pair, Record, Records, Sequence,
    Widths,
};
use nudge::priors::PriorRegistry;
use nudge::simulation::planted::graphs::{Options, Played, Structure, played};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::TestApp;

/// Actions of each agent where skeletons are counted.
const LETTERS: usize = 6;

const HOUR: Duration = Duration::from_secs(3_600);

/// Makes an environment of numbered states in which so many agents have so many actions each.
async fn environment(
    app: &App,
    name: &str,
    states: usize,
    agents: usize,
    letters: usize,
) -> Arc<Environment> {
    let integer = |name: &str, values: usize| {
        let kinds = vec![KindDraft::Integer(0, values as i64 - 1)];
        FeatureDraft {
            name: name.into(),
            unit: None,
            kinds,
        }
    };
    let agent = |at: usize| AgentDraft {
        name: format!("agent-{at}"),
        action: vec![integer("action", letters)],
        ..AgentDraft::default()
    };
    let schema = SchemaDraft {
        state: vec![integer("state", states)],
        agents: (0..agents).map(agent).collect(),
        ..SchemaDraft::default()
    };
    app.environments
        .apply(name, schema.into())
        .await
        .expect("a valid schema")
        .0
}

/// Counts what was played, a state each, under the sequence given and those that follow.
async fn count(app: &App, environment: &Arc<Environment>, first: u64, played: &[Vec<Vec<u64>>]) {
    let records: Vec<Record> = played
        .iter()
        .enumerate()
        .flat_map(|(at, visits)| records(at, visits))
        .collect();
    for (sequence, records) in (first..).zip(records.chunks(10_000)) {
        let records = Records::collect(
            Widths::of_schema(&environment.schema),
            records.iter().cloned().map(Ok),
        );
        let batch = Batch {
            sequence: Sequence::new(sequence).expect("above 0"),
            segment: None,
            records,
        };
        let told = app
            .ingest
            .write(environment, "test".parse().expect("a producer"), batch)
            .await
            .expect("counted");
        assert!(matches!(told, Acknowledged::Applied(receipt) if receipt.rejected_count == 0));
    }
}

fn records(state: usize, visits: &[Vec<u64>]) -> impl Iterator<Item = Record> {
    let mut cells: BTreeMap<&[u64], u64> = BTreeMap::new();
    visits
        .iter()
        .for_each(|actions| *cells.entry(actions).or_default() += 1);
    cells.into_iter().map(move |(actions, count)| Record {
        entry: Entry::Entered,
        count,
        ..Record::new(
            vec![state as f32],
            actions.iter().map(|action| *action as f32).collect(),
        )
    })
}

async fn graph(app: &App, environment: &Arc<Environment>, state: usize) -> Graph {
    let draft = QuestionDraft {
        states: StatesDraft::Keys(vec![state.to_string()]),
        ..QuestionDraft::default()
    };
    app.influence
        .graph(environment, &draft)
        .await
        .expect("a graph")
}

/// Returns the graph of every state of a world that was drawn, counted and fitted.
async fn graphs(app: &App, options: &Options) -> Vec<(Played, Graph)> {
    let Options {
        structure,
        letters,
        states,
        visits,
        ..
    } = *options;
    let name = format!("{}-{visits}", structure.as_str());
    let environment = environment(app, &name, states, structure.agents(), letters).await;
    let drawn = played(options);
    let visits: Vec<Vec<Vec<u64>>> = drawn.iter().map(|state| state.visits.clone()).collect();
    count(app, &environment, 1, &visits).await;
    app.influence.fit(&environment, None).await.expect("fitted");

    let mut graphs = Vec::new();
    for (at, state) in drawn.into_iter().enumerate() {
        graphs.push((state, graph(app, &environment, at).await));
    }
    graphs
}

/// Returns the pairs of that kind.
fn of_kind(graph: &Graph, kind: EdgeKind) -> Vec<(usize, usize)> {
    graph
        .edges
        .iter()
        .filter(|edge| edge.kind == kind)
        .map(|edge| (edge.from, edge.to))
        .collect()
}

/// Returns the share of states of which something is true.
fn share(of: &[(Played, Graph)], structured: bool, is_so: impl Fn(&Graph) -> bool) -> f64 {
    let all: Vec<&Graph> = of
        .iter()
        .filter(|(state, _)| state.structured == structured)
        .map(|(_, told)| told)
        .collect();
    all.iter().filter(|told| is_so(told)).count() as f64 / all.len() as f64
}

#[tokio::test(flavor = "multi_thread")]
async fn skeletons_are_as_often_right_as_they_must_be() {
    let app = TestApp::start().await;
    for (visits, least) in [(60, 0.5), (300, 0.95), (3_000, 0.98)] {
        let mut right = 0.0;
        let structures = [
            Structure::Chain,
            Structure::Fork,
            Structure::Collider,
            Structure::Diamond,
        ];
        for structure in structures {
            let options = Options {
                structure,
                letters: LETTERS,
                states: 60,
                structured: 0.5,
                visits,
                seed: 1,
            };
            let graphs = graphs(&app.app, &options).await;
            let drawn = share(&graphs, true, |told| {
                of_kind(told, EdgeKind::Direct) == structure.skeleton()
            });
            let empty = share(&graphs, false, |told| {
                of_kind(told, EdgeKind::Direct).is_empty()
            });
            println!(
                "{} at {visits} visits: {drawn:.2} right; {empty:.2} where there is nothing",
                structure.as_str()
            );
            right += drawn / structures.len() as f64;

            assert!(empty >= 0.9, "{structure:?} at {visits}: {empty}");
            let opened = share(&graphs, false, |told| {
                told.edges.iter().any(|edge| !edge.opened_by.is_empty())
            });
            assert!(opened <= 0.1, "{structure:?} at {visits}: {opened}");
        }
        assert!(right >= least, "{visits} visits: {right}");
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_acts_only_together_is_opened_and_never_dropped() {
    let app = TestApp::start().await;
    let options = Options {
        structure: Structure::Xor,
        letters: 3,
        states: 40,
        structured: 0.5,
        visits: 300,
        seed: 1,
    };
    let graphs = graphs(&app.app, &options).await;
    let opened = |told: &Graph| {
        let others = told
            .edges
            .iter()
            .map(|edge| (edge.kind, edge.opened_by.as_slice()));
        others.eq([
            (EdgeKind::Open, [2].as_slice()),
            (EdgeKind::Open, &[1]),
            (EdgeKind::Open, &[0]),
        ])
    };
    assert!(share(&graphs, true, opened) >= 0.95);
    assert!(
        share(&graphs, false, |told| told
            .edges
            .iter()
            .any(|edge| !edge.opened_by.is_empty()))
            <= 0.05
    );
    app.stop().await;
}

/// Two agents that act for themselves; a third does what the first does, mostly, and a fourth
/// follows the third. `effect` comes about where the first or the second is at 2.
fn street() -> Vec<Vec<u64>> {
    let mut next = chance();
    let mut visit = || {
        let (first, second) = (next(3), next(3));
        let third = if next(4) == 0 { next(3) } else { first };
        let fourth = if next(4) == 0 { next(3) } else { third };
        let effect = if next(10) == 0 {
            next(3)
        } else {
            u64::from(first == 2 || second == 2) * 2
        };
        vec![first, second, third, fourth, effect]
    };
    (0..600).map(|_| visit()).collect()
}

/// Returns numbers below a bound, always the same ones.
fn chance() -> impl FnMut(u64) -> u64 {
    let mut random = StdRng::seed_from_u64(7);
    move |below| random.random_range(0..below)
}

async fn run(app: &TestApp, arguments: &[&str]) -> (i32, String, String) {
    exit_and_texts(&output(nudge(&app.address.to_string(), arguments)).await)
}

#[tokio::test(flavor = "multi_thread")]
async fn every_face_tells_the_same_graph() {
    let app = TestApp::start().await;
    let environment = environment(&app.app, "street", 4, 5, 3).await;
    let mut next = chance();
    let scattered: Vec<Vec<u64>> = (0..600)
        .map(|_| (0..5).map(|_| next(3)).collect())
        .collect();
    count(&app.app, &environment, 1, &[street(), street(), scattered]).await;
    app.app
        .influence
        .fit(&environment, None)
        .await
        .expect("fitted");

    let (status, over_rest) = app
        .rest("GET", "/v1/environments/street/graph?key=0&unit=bits", None)
        .await;
    assert_eq!(status, 200, "{over_rest}");
    let request = proto::GetGraphRequest {
        environment: "street".into(),
        state: Some(proto::get_graph_request::State::Key("0".into())),
        unit: "bits".into(),
        ..Default::default()
    };
    let over_grpc = app
        .influence()
        .await
        .get_graph(request)
        .await
        .expect("valid")
        .into_inner();
    assert_eq!(
        over_rest,
        serde_json::to_value(dto::Graph::from(over_grpc.clone())).expect("JSON")
    );
    let (code, by_cli, stderr) = run(
        &app,
        &[
            "query", "street", "--key", "0", "--unit", "bits", "--graph", "--json",
        ],
    )
    .await;
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(
        over_rest,
        serde_json::from_str::<Value>(&by_cli).expect("JSON")
    );

    let edge = |from: usize, to: usize| {
        let names = [from, to].map(|agent| format!("agent-{agent}"));
        let edges = over_rest["edges"].as_array().expect("edges");
        edges
            .iter()
            .find(|edge| edge["from"] == names[0] && edge["to"] == names[1])
            .expect("every pair")
            .clone()
    };
    for (from, to) in [(0, 2), (2, 3), (0, 4), (1, 4)] {
        let told = edge(from, to);
        assert_eq!(
            (&told["kind"], &told["explained_by"], &told["opened_by"]),
            (&json!("direct"), &json!([]), &json!([]))
        );
    }
    let explained = edge(0, 3);
    assert_eq!(
        (&explained["kind"], &explained["explained_by"]),
        (&json!("explained"), &json!(["agent-2"]))
    );
    assert_eq!(
        explained["answer"]["dependence"], "established",
        "by itself"
    );
    assert_eq!(
        explained["note"],
        "dependent by themselves, but not while agent-2 is held fixed"
    );
    let opened = edge(0, 1);
    assert_eq!(
        (&opened["kind"], &opened["opened_by"]),
        (&json!("open"), &json!(["agent-4"])),
        "{opened}"
    );
    let note = opened["note"].as_str().expect("a sentence");
    assert!(note.ends_with(
        "holding a common effect of two agents fixed makes them dependent, so this need be no edge"
    ));

    let dot = over_grpc.dot;
    assert!(
        dot.contains(r#""agent-0" -- "agent-2" [style=solid, label=""#) && !dot.contains("->"),
        "{dot}"
    );
    let dotted = r#""agent-0" -- "agent-3" [style=dotted, label=""#;
    assert!(
        dot.contains(dotted) && dot.contains("; explained by agent-2\"];"),
        "{dot}"
    );
    let dashed = r#""agent-0" -- "agent-1" [style=dashed, label=""#;
    assert!(
        dot.contains(dashed) && dot.contains("; opened by agent-4\"];"),
        "{dot}"
    );
    let lines = over_rest["edges"]
        .as_array()
        .expect("edges")
        .iter()
        .filter(|edge| edge["kind"] != "absent")
        .count();
    assert_eq!(dot.matches(" -- ").count(), lines, "{dot}");

    let (code, text, stderr) =
        run(&app, &["query", "street", "--state", "state=0", "--graph"]).await;
    assert_eq!(code, 0, "{stderr}");
    for line in [
        "agent-0 - agent-2  direct",
        "agent-0 - agent-3  explained",
        "agent-0 - agent-1  opened",
    ] {
        assert!(text.contains(line), "{line}: {text}");
    }
    assert!(
        text.contains(
            "\nagent-0 - agent-3: dependent by themselves, but not while agent-2 is held fixed\n"
        ),
        "{text}"
    );
    app.stop().await;
}

#[tokio::test]
async fn what_cannot_be_drawn_is_refused() {
    let app = TestApp::start().await;
    environment(&app.app, "street", 2, 3, 3).await;
    for (arguments, code, message) in [
        (
            ["--key", "0", "1", "--graph"].as_slice(),
            2,
            "got 2 states, expected one",
        ),
        (
            &["--key", "0", "--graph", "--given", "agent-2"],
            2,
            "cannot be used with",
        ),
        (&["--key", "7", "--graph"], 1, "/keys/0"),
    ] {
        let (ended, _, stderr) = run(&app, &[&["query", "street"], arguments].concat()).await;
        assert!(
            ended == code && stderr.contains(message),
            "{arguments:?}: {ended} {stderr}"
        );
    }

    // Nothing was seen: nothing is decided, and nobody is asked to hold anything fixed.
    let (_, told) = app
        .rest("GET", "/v1/environments/street/graph?key=1", None)
        .await;
    let edges = told["edges"].as_array().expect("edges");
    assert!(
        edges.len() == 3
            && edges
                .iter()
                .all(|edge| edge["kind"] == "open" && edge["opened_by"] == json!([]))
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn agents_with_one_action_or_thousands_are_open() {
    let app = TestApp::start().await;
    let agent = |name: &str, actions: u64| json!({"name": name, "action": [{"name": "do", "integer": {"min": 0, "max": actions - 1}}]});
    let description = json!({
        "state": [{"name": "x", "integer": {"min": 0, "max": 1}}],
        "agents": [agent("one", 1), agent("two", 2), agent("many", 5_000), agent("more", 256)],
    });
    assert_eq!(
        app.rest("PUT", "/v1/environments/odd", Some(&description))
            .await
            .0,
        201
    );
    let transition = |i: u64| json!({"state": {"x": 0}, "actions": {"one": 0, "two": i % 2, "many": i * 7, "more": i % 256}});
    let batch = json!({"producer": "p", "sequence": 1, "transitions": (0..600).map(transition).collect::<Vec<_>>()});
    assert_eq!(
        app.rest("POST", "/v1/environments/odd/transitions", Some(&batch))
            .await
            .1["accepted"],
        600
    );
    assert_eq!(
        app.rest("POST", "/v1/environments/odd/fit", None).await.0,
        200
    );
    let (status, told) = app
        .rest("GET", "/v1/environments/odd/graph?key=0", None)
        .await;
    assert_eq!(status, 200, "{told}");
    for edge in told["edges"].as_array().expect("edges") {
        let is_told = edge["from"] == "two" && edge["to"] == "more";
        assert!(is_told || edge["kind"] == "open", "{edge}");
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn eight_agents_are_drawn_while_one_waits() {
    let app = TestApp::start().await;
    let environment = environment(&app.app, "crowd", 1, 8, 6).await;
    // Everybody mostly does what the one before did.
    let mut next = chance();
    let mut act = |actions: &mut Vec<u64>| {
        let action = if actions.is_empty() || next(3) == 0 {
            next(6)
        } else {
            actions[actions.len() - 1]
        };
        actions.push(action);
    };
    let visits = (0..3_000).map(|_| {
        let mut actions = Vec::new();
        (0..8).for_each(|_| act(&mut actions));
        actions
    });
    count(&app.app, &environment, 1, &[visits.collect()]).await;
    let started = Instant::now();
    let told = graph(&app.app, &environment, 0).await;
    println!("eight agents took {:.2} s", started.elapsed().as_secs_f64());
    let chain: Vec<(usize, usize)> = (0..7).map(|at| (at, at + 1)).collect();
    assert_eq!(of_kind(&told, EdgeKind::Direct), chain);
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn fits_are_kept_up_for_an_hour_after_somebody_asked() {
    let app = TestApp::start().await;
    let environment = environment(&app.app, "street", 1, 5, 3).await;
    let fits = PriorRegistry::new(app.app.store.clone());
    let [plain, given, never] = [(0, 1, vec![]), (0, 3, vec![2]), (1, 4, vec![])]
        .map(|(ego, other, given)| Pair { ego, other, given });
    let versions = async || {
        let mut versions = Vec::new();
        for pair in [&plain, &given, &never] {
            versions.push(
                fits.get(&environment, pair)
                    .await
                    .expect("read")
                    .expect("few actions")
                    .id
                    .version,
            );
        }
        versions
    };
    count(&app.app, &environment, 1, &[street()]).await;
    fits.keep_up_once(Instant::now()).await;
    assert_eq!(versions().await, [0, 0, 0], "nobody asked");

    for pair in [&plain, &given] {
        fits.informed(&environment, pair).await.expect("read");
    }
    fits.keep_up_once(Instant::now()).await;
    assert_eq!(versions().await, [1, 1, 0]);
    fits.keep_up_once(Instant::now()).await;
    assert_eq!(versions().await, [1, 1, 0], "nothing more was counted");

    // Fitting is not asking: the hour goes on.
    count(&app.app, &environment, 2, &[street()]).await;
    fits.keep_up_once(Instant::now() + HOUR - Duration::from_secs(60))
        .await;
    assert_eq!(versions().await, [2, 2, 0]);
    count(&app.app, &environment, 3, &[street()]).await;
    fits.informed(&environment, &plain).await.expect("read");
    fits.keep_up_once(Instant::now() + HOUR + Duration::from_secs(60))
        .await;
    assert_eq!(versions().await, [2, 2, 0], "the hour is over");
    fits.fit(&environment, &given).await.expect("read");
    count(&app.app, &environment, 4, &[street()]).await;
    fits.keep_up_once(Instant::now()).await;
    assert_eq!(versions().await, [2, 4, 0]);
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_graph_makes_no_fit_for_its_conditional_tests() {
    let app = TestApp::start().await;
    let environment = environment(&app.app, "street", 1, 5, 3).await;
    count(&app.app, &environment, 1, &[street()]).await;
    app.app
        .influence
        .fit(&environment, None)
        .await
        .expect("fitted");
    graph(&app.app, &environment, 0).await;
    let kept = app.app.store.fits(environment.id).await.expect("read");
    assert!(
        kept.len() == 10 && kept.iter().all(|fit| !fit.pair.contains('|')),
        "{kept:?}"
    );
    app.stop().await;
}
