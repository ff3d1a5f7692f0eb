//! Networks that PyTorch made: imported, they must say what PyTorch and onnxruntime say of the same
//! states; what does not fit must be refused by name.

use std::collections::{BTreeMap, HashMap};
use std::f64::consts::TAU;
use std::sync::Arc;

use nudge::domain::{Environment, StateKey};
use nudge::error::{ErrorKind, Problem};
use nudge::model::Network;
use nudge::store::NewModel;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde_json::{Value, json};

use super::{list, number};
use crate::support::{TestApp, open};

/// Between heads of 32 bits, and what is made of them.
const PRECISION: f64 = 1e-5;

const WORLD: &str = "/v1/environments/crossing";
const JOINT: &[u8] = include_bytes!("../../golden/networks_joint.safetensors");
const DIRECT: &[u8] = include_bytes!("../../golden/networks_direct.safetensors");

fn golden() -> Value {
    serde_json::from_str(include_str!("../../golden/networks.json"))
        .expect("the golden file is JSON")
}

fn keys(golden: &Value) -> Vec<StateKey> {
    list(&golden["states"])
        .iter()
        .map(|bins| StateKey::new(&bins_of(bins)))
        .collect()
}

fn bins_of(bins: &Value) -> Vec<u32> {
    list(bins).iter().map(|bin| number(bin) as u32).collect()
}

/// A service with the golden environment, in which the golden states are counted, so that an import
/// can be judged.
async fn crossing() -> (TestApp, Arc<Environment>) {
    crossing_of(|bins| bins).await
}

/// The same, in which nobody leaves the first four lanes, nor comes close to anybody.
async fn crossing_in_part() -> (TestApp, Arc<Environment>) {
    crossing_of(|bins| vec![bins[0], bins[1], bins[2].min(3), bins[3].max(1)]).await
}

async fn crossing_of(moved: impl Fn(Vec<u32>) -> Vec<u32>) -> (TestApp, Arc<Environment>) {
    let golden = golden();
    let app = TestApp::start().await;
    assert_eq!(
        app.rest("PUT", WORLD, Some(&golden["environment"])).await.0,
        201
    );
    let states = list(&golden["states"])
        .iter()
        .map(|bins| moved(bins_of(bins)));
    let transitions: Vec<Value> = states.flat_map(visits).collect();
    let body = json!({"producer": "p", "sequence": 1, "transitions": transitions});
    let (status, receipt) = app
        .rest("POST", &format!("{WORLD}/transitions"), Some(&body))
        .await;
    assert_eq!(
        (status, &receipt["rejected_count"]),
        (200, &json!(0)),
        "{receipt}"
    );
    let environment = app.app.environments.find("crossing").expect("made");
    (app, environment)
}

/// Visits of a state: every pair of actions, some more often than others.
fn visits(bins: Vec<u32>) -> impl Iterator<Item = Value> {
    const DISTANCES: [f64; 5] = [0.25, 0.75, 1.5, 3.0, 5.0];
    let state = json!({
        "held": bins[0],
        "bearing": TAU * f64::from(bins[1]) / 8.0,
        "lane": i64::from(bins[2]) - 2,
        "distance": DISTANCES[bins[3] as usize],
    });
    let often = bins.iter().sum::<u32>();
    let visit = move |(robot, human): (u32, u32)| {
        let count = 1 + (often + robot * human) % 4;
        json!({"state": state, "actions": {"robot": robot, "human": human}, "count": count})
    };
    (0..3)
        .flat_map(|robot| (0..4).map(move |human| (robot, human)))
        .map(visit)
}

async fn imported(app: &TestApp, environment: &Arc<Environment>, file: &[u8]) -> Arc<Network> {
    let networks = &app.app.networks;
    let model = networks
        .import(environment, file.to_vec())
        .await
        .expect("accepted");
    networks
        .network(environment, model.version)
        .await
        .expect("kept")
}

/// Returns the mean over the members of a golden figure, `at` telling where it stands.
fn mean(golden: &Value, at: impl Fn(&Value) -> f64) -> f64 {
    let members = list(&golden["members"]);
    members.iter().map(at).sum::<f64>() / members.len() as f64
}

fn close(what: &str, value: f64, golden: f64) {
    assert!(
        (value - golden).abs() <= PRECISION,
        "{what}: {value} instead of {golden}"
    );
}

#[tokio::test]
async fn a_joint_network_says_what_pytorch_says() {
    let (app, environment) = crossing().await;
    let (golden, network) = (golden(), imported(&app, &environment, JOINT).await);
    let keys = keys(&golden);
    let predictions = network.predict(&keys, number(&golden["meta"]["threshold_nats"]));
    for (state, (key, prediction)) in keys.iter().zip(predictions).enumerate() {
        let joint = |at: &dyn Fn(&Value) -> f64| mean(&golden["joint"], at);
        let information = prediction.mutual_information.expect("a joint network's");
        close(
            "mutual information",
            information,
            joint(&|member| number(&member["mutual_information"][state])),
        );
        let actions = network.by_action(&environment, key);
        assert_eq!(
            actions
                .iter()
                .map(|action| &action.action[..])
                .collect::<Vec<_>>(),
            ["stay", "go", "turn"]
        );
        for (i, action) in actions.iter().enumerate() {
            close(
                "policy",
                action.probability,
                joint(&|member| number(&member["policy"][state][i])),
            );
            close(
                "divergence",
                action.divergence,
                joint(&|member| number(&member["divergence"][state][i])),
            );
            assert_eq!(action.response.len(), 4);
            for (j, response) in action.response.iter().enumerate() {
                close(
                    "response",
                    *response,
                    joint(&|member| number(&member["response"][state][i][j])),
                );
            }
        }
    }
    app.stop().await;
}

#[tokio::test]
async fn a_direct_network_says_what_pytorch_says() {
    let (app, environment) = crossing().await;
    let (golden, network) = (golden(), imported(&app, &environment, DIRECT).await);
    let keys = keys(&golden);
    let threshold = number(&golden["meta"]["threshold_nats"]);
    for (state, prediction) in network.predict(&keys, threshold).into_iter().enumerate() {
        let expected = mean(&golden["direct"], |member| {
            number(&member["probability"][state])
        });
        close(
            "probability",
            prediction.probability.expect("at its own threshold"),
            expected,
        );
        assert_eq!(prediction.mutual_information, None);
    }
    assert!(
        network
            .predict(&keys, 2.0 * threshold)
            .iter()
            .all(|prediction| prediction.probability.is_none())
    );
    assert_eq!(network.by_action(&environment, &keys[0]), []);
    app.stop().await;
}

#[tokio::test]
async fn what_is_exported_is_what_was_imported() {
    let (app, environment) = crossing().await;
    for file in [JOINT, DIRECT] {
        let model = app
            .app
            .networks
            .import(&environment, file.to_vec())
            .await
            .expect("accepted");
        assert!(
            model.card.as_ref().is_ok_and(|card| card.imported) && !model.active,
            "{model:?}"
        );
        let exported = app
            .app
            .networks
            .export(&environment, model.version)
            .await
            .expect("kept");
        assert_eq!(
            File::from_bytes(&exported).tensors,
            File::from_bytes(file).tensors
        );
    }
    app.stop().await;
}

/// A safetensors file, taken apart.
struct File {
    metadata: HashMap<String, String>,
    tensors: BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)>,
}

impl File {
    fn from_bytes(bytes: &[u8]) -> Self {
        let (_, header) = SafeTensors::read_metadata(bytes).expect("a header");
        let tensors = SafeTensors::deserialize(bytes).expect("a safetensors file");
        let part = |(name, view): (String, TensorView<'_>)| {
            (
                name,
                (view.dtype(), view.shape().to_vec(), view.data().to_vec()),
            )
        };
        Self {
            metadata: header.metadata().clone().expect("metadata"),
            tensors: tensors.tensors().into_iter().map(part).collect(),
        }
    }

    fn write(&self) -> Vec<u8> {
        let views = self.tensors.iter().map(|(name, (dtype, shape, bytes))| {
            (
                name,
                TensorView::new(*dtype, shape.clone(), bytes)
                    .expect("as many bytes as the shape says"),
            )
        });
        serialize(views, Some(self.metadata.clone())).expect("names differ")
    }

    fn tell(&mut self, field: &str, text: &str) {
        self.metadata.insert(field.to_owned(), text.to_owned());
    }

    fn tensor(&mut self, name: &str) -> &mut (Dtype, Vec<usize>, Vec<u8>) {
        self.tensors
            .get_mut(name)
            .expect("a tensor of the golden file")
    }

    fn set_first(&mut self, name: &str, number: f32) {
        self.tensor(name).2[..4].copy_from_slice(&number.to_le_bytes());
    }
}

async fn refused(app: &TestApp, environment: &Arc<Environment>, file: Vec<u8>) -> Problem {
    let problem = app
        .app
        .networks
        .import(environment, file)
        .await
        .expect_err("it does not fit");
    assert_eq!(problem.kind, ErrorKind::Invalid, "{problem}");
    problem
}

/// What is done to the golden joint network, and where the fault is.
type Edit = (&'static str, fn(&mut File));

const EDITS: &[Edit] = &[
    ("/metadata/schema_hash", |file| {
        file.tell("schema_hash", &"0".repeat(64))
    }),
    ("/metadata/format", |file| file.tell("format", "nudge/3")),
    ("/metadata/kind", |file| file.tell("kind", "deep")),
    ("/metadata/ego", |file| file.tell("ego", "cat")),
    ("/metadata/other", |file| file.tell("other", "robot")),
    ("/metadata/threshold", |file| file.tell("threshold", "-1")),
    ("/metadata/threshold", |file| file.tell("threshold", "NaN")),
    ("/metadata/scales", |file| {
        file.tell("scales", "[null, null, null, null]")
    }),
    ("/metadata/scales", |file| {
        let zero = r#"{"mean": 0.0, "deviation": 0.0}"#;
        file.tell("scales", &format!("[null, null, {zero}, {zero}]"));
    }),
    // Not for each feature, not in order, and a bin that no feature has.
    ("/metadata/seen", |file| file.tell("seen", "[[[0, 1]]]")),
    ("/metadata/seen", |file| {
        file.tell("seen", "[[[0, 0]], [[3, 4], [1, 2]], [[0, 0]], [[0, 0]]]")
    }),
    ("/metadata/seen", |file| {
        file.tell("seen", "[[[0, 0]], [[0, 8]], [[0, 0]], [[0, 0]]]")
    }),
    ("/metadata/seen", |file| file.tell("seen", "some")),
    // A wrong shape, with the right number of weights and with another.
    ("/members.1.other.weight", |file| {
        file.tensor("members.1.other.weight").1 = vec![8, 4]
    }),
    ("/members.0.trunk.weight", |file| {
        let (_, shape, bytes) = file.tensor("members.0.trunk.weight");
        shape[1] -= 1;
        bytes.truncate(4 * shape[0] * shape[1]);
    }),
    ("/members.0.ego.bias", |file| {
        let (dtype, _, bytes) = file.tensor("members.0.ego.bias");
        *dtype = Dtype::F16;
        bytes.truncate(6);
    }),
    ("/members.0.interaction.bias", |file| {
        drop(file.tensors.remove("members.0.interaction.bias"))
    }),
    ("/members.1.trunk.bias", |file| {
        drop(file.tensors.remove("members.1.trunk.bias"))
    }),
    ("/members.0.trunk.weight", |file| {
        drop(file.tensors.remove("members.0.trunk.weight"))
    }),
    // Without its hidden layer there is no second member, and its heads belong to nobody.
    ("/members.1.ego.weight", |file| {
        drop(file.tensors.remove("members.1.trunk.weight"))
    }),
    ("/members.0.influence.weight", |file| {
        file.tell("kind", "direct")
    }),
    ("/members.0.extra", |file| {
        drop(
            file.tensors
                .insert("members.0.extra".into(), (Dtype::F32, vec![1], vec![0; 4])),
        )
    }),
    ("/members.1.ego.weight", |file| {
        file.set_first("members.1.ego.weight", f32::NAN)
    }),
    ("/members.0.trunk.bias", |file| {
        file.set_first("members.0.trunk.bias", f32::INFINITY)
    }),
    // Finite, but nothing that is computed with it would be.
    ("/members.1.trunk.weight", |file| {
        file.set_first("members.1.trunk.weight", 1e30)
    }),
];

#[tokio::test]
async fn what_does_not_fit_is_refused_by_name() {
    let (app, environment) = crossing().await;
    for (at, edit) in EDITS {
        let mut file = File::from_bytes(JOINT);
        edit(&mut file);
        let problem = refused(&app, &environment, file.write()).await;
        assert!(
            problem.faults.iter().any(|fault| fault.pointer == *at),
            "{at}: {problem}"
        );
    }
    for field in [
        "format",
        "kind",
        "ego",
        "other",
        "schema_hash",
        "threshold",
        "scales",
    ] {
        let mut file = File::from_bytes(JOINT);
        file.metadata.remove(field);
        let problem = refused(&app, &environment, file.write()).await;
        assert!(
            problem.message.contains(&format!("/metadata/{field}")),
            "{problem}"
        );
    }
    for broken in [
        &JOINT[..JOINT.len() - 1],
        &JOINT[..100],
        b"",
        b"not a file of weights",
    ] {
        let problem = refused(&app, &environment, broken.to_vec()).await;
        assert!(
            problem.message.contains("is no safetensors file"),
            "{problem}"
        );
    }
    let kept = app
        .app
        .networks
        .list(&environment)
        .await
        .expect("listed")
        .models;
    assert!(kept.is_empty(), "{kept:?}");
    app.stop().await;
}

#[tokio::test]
async fn who_does_not_say_what_it_was_trained_on_is_believed_where_it_was_judged() {
    let (app, environment) = crossing_in_part().await;
    assert!(
        !File::from_bytes(JOINT).metadata.contains_key("seen"),
        "PyTorch's file says nothing of it"
    );
    let network = imported(&app, &environment, JOINT).await;
    let outside = |bins: [u32; 4]| network.out_of_range(&environment, &StateKey::new(&bins));
    for bins in [[0, 0, 0, 1], [2, 7, 3, 4], [1, 3, 2, 2]] {
        assert!(
            outside(bins).is_empty(),
            "each bin was seen, if not together: {bins:?}"
        );
    }
    assert_eq!(outside([0, 0, 4, 1]), ["lane"]);
    assert_eq!(outside([2, 7, 4, 0]), ["lane", "distance"]);
    let exported = app
        .app
        .networks
        .export(&environment, 1)
        .await
        .expect("kept");
    let kept = File::from_bytes(&exported)
        .metadata
        .remove("seen")
        .expect("it is kept with the weights");
    let mut told = File::from_bytes(JOINT);
    told.tell("seen", "[[[0, 0]], [], [[0, 0]], [[1, 2]]]");
    let told = imported(&app, &environment, &told.write()).await;
    assert!(kept.starts_with("[[["), "{kept}");
    let outside = told.out_of_range(&environment, &StateKey::new(&[0, 0, 1, 1]));
    assert_eq!(
        outside,
        ["bearing", "lane"],
        "what a file says of itself is kept"
    );
    app.stop().await;
}

#[tokio::test]
async fn versions_of_earlier_builds_answer_where_something_was_counted() {
    let (app, environment) = crossing_in_part().await;
    let networks = &app.app.networks;
    let version = networks
        .import(&environment, JOINT.to_vec())
        .await
        .expect("accepted")
        .version;
    // Earlier builds kept neither what a network was trained on nor what it says on average.
    let mut file = File::from_bytes(&networks.export(&environment, version).await.expect("kept"));
    file.metadata.remove("seen").expect("kept with the weights");
    let mut card: Value = serde_json::from_str(&file.metadata["card"]).expect("JSON");
    card.as_object_mut()
        .expect("an object")
        .remove("base_rate")
        .expect("it was judged");
    let record = NewModel {
        ego: 0,
        other: 1,
        kind: "joint".into(),
        card: card.to_string(),
        weights: file.write(),
    };
    let directory = app.directory.clone();
    app.stop().await;
    let store = open(directory.path(), Default::default()).await;
    let earlier = store
        .keep_model(environment.id, &record)
        .await
        .expect("kept");
    let app = TestApp::with(directory, store).await;

    let models = app
        .app
        .networks
        .list(&environment)
        .await
        .expect("listed")
        .models;
    assert_eq!(
        models.iter().map(|model| model.version).collect::<Vec<_>>(),
        [version, earlier]
    );
    let base_rate = |at: usize| models[at].card.as_ref().expect("it can be read").base_rate;
    assert_eq!((base_rate(0).is_some(), base_rate(1)), (true, None));
    let [network, older] = [
        app.app.networks.network(&environment, version).await,
        app.app.networks.network(&environment, earlier).await,
    ];
    let [network, older] = [network.expect("kept"), older.expect("still readable")];
    let keys = keys(&golden());
    assert!(older.predict(&keys, older.threshold) == network.predict(&keys, network.threshold));
    assert_eq!(
        older.out_of_range(&environment, &StateKey::new(&[0, 0, 4, 1])),
        ["lane"]
    );
    app.stop().await;
}
