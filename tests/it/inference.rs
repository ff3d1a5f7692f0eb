//! The Open Inference Protocol over REST and gRPC: what clients of inference servers ask, answered
//! by a small network trained here.

use std::collections::HashMap;
use std::io::Write;
use std::sync::Arc;
use std::time::Duration;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use nudge::api::inference_proto::grpc_inference_service_client::GrpcInferenceServiceClient;
use nudge::api::inference_proto::infer_parameter::ParameterChoice::{
    self, DoubleParam, Int64Param, StringParam,
};
use nudge::api::inference_proto::model_infer_request::{
    InferInputTensor, InferRequestedOutputTensor,
};
use nudge::api::inference_proto::{
    InferParameter, InferTensorContents, ModelInferRequest, ModelInferResponse,
    ModelMetadataRequest, ModelReadyRequest, ServerLiveRequest, ServerMetadataRequest,
    ServerReadyRequest,
};
use nudge::domain::draft::TrainingDraft;
use nudge::domain::{Environment, JobState};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use reqwest::Response;
use serde_json::{Value, json};
use tonic::transport::Channel;
use tonic::{Code, Status};

use crate::support::{TestApp, reason};

const WORLD: &str = "/v1/environments/world";
const MODEL: &str = "world~robot~human";
const HEADER_LENGTH: &str = "inference-header-content-length";

const PLACES: u64 = 40;
/// Places below this are those where the human answers the robot.
const DEPENDENT: u64 = 20;

/// A world of three agents. Where the place says so the human mostly does what the robot does; the
/// light and the dog never matter.
async fn world() -> TestApp {
    let app = TestApp::start().await;
    let agent = |name: &str| json!({"name": name, "action": [{"name": "move", "integer": {"min": 0, "max": 2}}]});
    let description = json!({
        "state": [
            {"name": "place", "integer": {"min": 0, "max": PLACES - 1}},
            {"name": "light", "categorical": {"labels": ["red", "green"]}},
        ],
        "agents": [agent("robot"), agent("human"), agent("dog")],
    });
    assert_eq!(app.rest("PUT", WORLD, Some(&description)).await.0, 201);
    let body = json!({"producer": "p", "sequence": 1, "transitions": transitions()});
    let (status, receipt) = app
        .rest("POST", &format!("{WORLD}/transitions"), Some(&body))
        .await;
    assert_eq!(
        (status, &receipt["rejected_count"]),
        (200, &json!(0)),
        "{receipt}"
    );
    app
}

fn transitions() -> Vec<Value> {
    let mut random = StdRng::seed_from_u64(1);
    let transition = |i: u64| {
        let place = i % PLACES;
        let robot = random.random_range(0..3);
        let copies = place < DEPENDENT && random.random_bool(0.9);
        let human = if copies {
            robot
        } else {
            random.random_range(0..3)
        };
        let actions = json!({"robot": robot, "human": human, "dog": random.random_range(0..3)});
        json!({"state": {"place": place, "light": i / PLACES % 2}, "actions": actions})
    };
    (0..4_000).map(transition).collect()
}

fn environment(app: &TestApp) -> Arc<Environment> {
    app.app.environments.find("world").expect("known")
}

/// Trains a small network, makes it active and returns its version.
async fn train(app: &TestApp, other: &str, kind: &str) -> u64 {
    let environment = environment(app);
    let draft = TrainingDraft {
        other: Some(other.into()),
        kind: Some(kind.into()),
        width: Some(8),
        members: Some(2),
        folds: Some(2),
        epochs: Some(30),
        activate: true,
        ..TrainingDraft::default()
    };
    let mut job = app
        .app
        .networks
        .train(&environment, &draft)
        .await
        .expect("a valid training");
    while !job.state.is_over() {
        tokio::time::sleep(Duration::from_millis(20)).await;
        job = app.app.networks.job(&environment, job.id).expect("known");
    }
    assert_eq!(job.state, JobState::Done, "{}", job.message);
    job.version.expect("a version came out")
}

/// A world with an active network for its first two agents.
async fn trained() -> (TestApp, u64) {
    let app = world().await;
    let version = train(&app, "human", "joint").await;
    (app, version)
}

/// Every state, again and again.
fn rows(number: usize) -> Vec<f32> {
    let places = PLACES as usize;
    (0..number)
        .flat_map(|i| [(i % places) as f32, (i / places % 2) as f32])
        .collect()
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

fn values(bytes: &[u8]) -> Vec<f32> {
    bytes
        .chunks_exact(4)
        .map(|value| f32::from_le_bytes(value.try_into().expect("four bytes")))
        .collect()
}

/// The figures of an answer, in the order of its outputs.
type Figures = Vec<(String, Vec<f32>)>;

/// What the network itself says of these rows.
async fn expected(app: &TestApp, version: u64, rows: &[f32]) -> Figures {
    let environment = environment(app);
    let network = app
        .app
        .networks
        .network(&environment, version)
        .await
        .expect("kept");
    let keys: Vec<_> = rows
        .chunks(2)
        .map(|row| environment.schema.key_of_values(row).expect("valid"))
        .collect();
    let predictions = network.predict(&keys, network.threshold);
    let figure = |name: &str, value: &dyn Fn(&nudge::model::Prediction) -> Option<f64>| {
        let told: Option<Vec<f32>> = predictions
            .iter()
            .map(|one| value(one).map(|value| value as f32))
            .collect();
        told.map(|told| (name.to_owned(), told))
    };
    let probability =
        figure("influence_probability", &|one| one.probability).expect("told at its own threshold");
    [
        Some(probability),
        figure("mutual_information", &|one| one.mutual_information),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn document(rows: &[f32]) -> Value {
    let shape = [rows.len() / 2, 2];
    json!({"id": "mine", "inputs": [{"name": "state", "datatype": "FP32", "shape": shape, "data": rows}]})
}

/// Posts without a content type, as Triton's client does.
async fn post(app: &TestApp, path: &str, headers: &[(&str, &str)], body: Vec<u8>) -> Response {
    let request = reqwest::Client::new().post(app.url(path)).body(body);
    let request = headers.iter().fold(request, |request, (name, value)| {
        request.header(*name, *value)
    });
    request.send().await.expect("answered")
}

async fn infer(app: &TestApp, model: &str, document: &Value) -> (u16, Value) {
    let response = post(
        app,
        &format!("/v2/models/{model}/infer"),
        &[],
        document.to_string().into(),
    )
    .await;
    (
        response.status().as_u16(),
        response.json().await.expect("JSON"),
    )
}

fn of_json(answer: &Value) -> Figures {
    let output = |output: &Value| {
        let data: Vec<f32> = serde_json::from_value(output["data"].clone()).expect("numbers");
        assert_eq!(output["shape"], json!([data.len()]));
        (output["name"].as_str().expect("a name").to_owned(), data)
    };
    answer["outputs"]
        .as_array()
        .expect("outputs")
        .iter()
        .map(output)
        .collect()
}

/// Sends and wants binary tensors.
async fn infer_binary(app: &TestApp, rows: &[f32]) -> Figures {
    let mut document = document(rows);
    let input = document["inputs"][0].as_object_mut().expect("an input");
    input.remove("data");
    input.insert(
        "parameters".into(),
        json!({"binary_data_size": rows.len() * 4}),
    );
    document["parameters"] = json!({"binary_data_output": true});
    let head = document.to_string();
    let body = [head.as_bytes(), &bytes(rows)].concat();
    let response = post(
        app,
        &format!("/v2/models/{MODEL}/infer"),
        &[(HEADER_LENGTH, &head.len().to_string())],
        body,
    )
    .await;
    assert_eq!(response.status(), 200);
    assert_eq!(
        response.headers()["content-type"],
        "application/octet-stream"
    );
    let length: usize = response.headers()[HEADER_LENGTH]
        .to_str()
        .expect("text")
        .parse()
        .expect("a number");
    let body = response.bytes().await.expect("a body");
    let (head, mut tail) = body.split_at(length);
    let head: Value = serde_json::from_slice(head).expect("JSON");
    assert_eq!(head["id"], "mine");
    let mut output = |output: &Value| {
        let size = output["parameters"]["binary_data_size"]
            .as_u64()
            .expect("a size") as usize;
        let (data, rest) = tail.split_at(size);
        tail = rest;
        (
            output["name"].as_str().expect("a name").to_owned(),
            values(data),
        )
    };
    let figures = head["outputs"]
        .as_array()
        .expect("outputs")
        .iter()
        .map(&mut output)
        .collect();
    assert!(tail.is_empty());
    figures
}

async fn client(app: &TestApp) -> GrpcInferenceServiceClient<Channel> {
    GrpcInferenceServiceClient::new(app.channel().await)
}

fn message(rows: &[f32]) -> ModelInferRequest {
    let input = InferInputTensor {
        name: "state".into(),
        datatype: "FP32".into(),
        shape: vec![rows.len() as i64 / 2, 2],
        ..Default::default()
    };
    ModelInferRequest {
        model_name: MODEL.into(),
        id: "mine".into(),
        inputs: vec![input],
        raw_input_contents: vec![bytes(rows)],
        ..Default::default()
    }
}

fn typed(rows: &[f32]) -> ModelInferRequest {
    let mut message = message(rows);
    message.raw_input_contents.clear();
    message.inputs[0].contents = Some(InferTensorContents {
        fp32_contents: rows.to_vec(),
        ..Default::default()
    });
    message
}

async fn call(app: &TestApp, message: ModelInferRequest) -> Result<ModelInferResponse, Status> {
    client(app)
        .await
        .model_infer(message)
        .await
        .map(tonic::Response::into_inner)
}

fn of_message(answer: &ModelInferResponse) -> Figures {
    assert_eq!(answer.outputs.len(), answer.raw_output_contents.len());
    let outputs = answer.outputs.iter().zip(&answer.raw_output_contents);
    outputs
        .map(|(output, raw)| (output.name.clone(), values(raw)))
        .collect()
}

#[tokio::test]
async fn the_server_says_what_it_is_and_that_it_can_work() {
    let app = TestApp::start().await;
    let server = json!({"name": "nudge", "version": env!("CARGO_PKG_VERSION"), "extensions": ["binary_tensor_data"]});
    assert_eq!(app.rest("GET", "/v2", None).await, (200, server.clone()));
    assert_eq!(app.rest("GET", "/v2/", None).await, (200, server));
    assert_eq!(
        app.rest("GET", "/v2/health/live", None).await,
        (200, json!({"live": true}))
    );
    assert_eq!(
        app.rest("GET", "/v2/health/ready", None).await,
        (200, json!({"ready": true}))
    );
    let mut client = client(&app).await;
    assert!(
        client
            .server_live(ServerLiveRequest {})
            .await
            .expect("answered")
            .into_inner()
            .live
    );
    assert!(
        client
            .server_ready(ServerReadyRequest {})
            .await
            .expect("answered")
            .into_inner()
            .ready
    );
    let told = client
        .server_metadata(ServerMetadataRequest {})
        .await
        .expect("answered")
        .into_inner();
    assert_eq!(
        (told.name.as_str(), told.extensions),
        ("nudge", vec!["binary_tensor_data".to_owned()])
    );
}

#[tokio::test]
async fn every_error_below_v2_is_a_text() {
    let app = world().await;
    let cases = [
        ("GET", "/v2/nothing/here", 404),
        ("GET", "/v2/models", 404),
        ("GET", "/v2/models/world/versions", 404),
        ("POST", "/v2/health/live", 405),
        ("GET", "/v2/models/world/infer", 405),
        ("GET", "/v2/models/nowhere", 404),
        ("GET", "/v2/models/nowhere/ready", 404),
        ("GET", "/v2/models/world~robot", 404),
        ("GET", "/v2/models/world~robot~robot", 404),
        ("GET", "/v2/models/world~robot~cat/ready", 404),
        ("GET", "/v2/models/world/versions/latest", 400),
        ("GET", "/v2/models/%FF", 400),
        ("POST", "/v2/models/world/infer", 400),
        ("POST", "/v2/models/nowhere/versions/1/infer", 400),
    ];
    for (method, path, expected) in cases {
        let request =
            reqwest::Client::new().request(method.parse().expect("a method"), app.url(path));
        let response = request.send().await.expect("answered");
        assert_eq!(response.status().as_u16(), expected, "{method} {path}");
        assert_eq!(
            response.headers()["content-type"],
            "application/json",
            "{method} {path}"
        );
        let body: Value = response.json().await.expect("JSON");
        let members: Vec<_> = body.as_object().expect("an object").keys().collect();
        assert_eq!(members, ["error"], "{method} {path}");
    }
}

#[tokio::test]
async fn a_compressed_body_is_read_within_the_limit() {
    let app = TestApp::start().await;
    let path = "/v2/models/nowhere/infer";
    let plain = document(&rows(1)).to_string();
    let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
    gzip.write_all(plain.as_bytes()).expect("memory");
    let mut deflate = ZlibEncoder::new(Vec::new(), Compression::fast());
    deflate.write_all(plain.as_bytes()).expect("memory");
    let status = async |encoding, body| {
        post(&app, path, &[("content-encoding", encoding)], body)
            .await
            .status()
            .as_u16()
    };
    // It was read where what is unknown is the model.
    assert_eq!(status("gzip", gzip.finish().expect("memory")).await, 404);
    assert_eq!(
        status("deflate", deflate.finish().expect("memory")).await,
        404
    );
    assert_eq!(status("gzip", plain.clone().into()).await, 400);
    assert_eq!(status("br", plain.into()).await, 415);
    let mut bomb = GzEncoder::new(Vec::new(), Compression::best());
    bomb.write_all(&vec![b' '; 17 << 20]).expect("memory");
    assert_eq!(status("gzip", bomb.finish().expect("memory")).await, 413);
}

#[tokio::test]
async fn every_form_tells_what_the_network_says() {
    let (app, version) = trained().await;
    for number in [1, 1_024] {
        let rows = rows(number);
        let expected = expected(&app, version, &rows).await;
        let (status, answer) = infer(&app, MODEL, &document(&rows)).await;
        assert_eq!(status, 200, "{answer}");
        assert_eq!(
            (&answer["id"], &answer["model_name"]),
            (&json!("mine"), &json!(MODEL))
        );
        assert_eq!(answer["model_version"], version.to_string());
        assert_eq!(of_json(&answer), expected);
        let mut nested = document(&rows);
        nested["inputs"][0]["data"] = json!(rows.chunks(2).collect::<Vec<_>>());
        assert_eq!(of_json(&infer(&app, MODEL, &nested).await.1), expected);
        assert_eq!(infer_binary(&app, &rows).await, expected);
        for message in [message(&rows), typed(&rows)] {
            let answer = call(&app, message).await.expect("valid");
            assert_eq!(
                (answer.id.as_str(), answer.model_version),
                ("mine", version.to_string())
            );
            assert_eq!(
                of_message(&ModelInferResponse {
                    model_version: String::new(),
                    ..answer
                }),
                expected
            );
        }
    }
}

#[tokio::test]
async fn a_model_says_what_it_takes_and_answers() {
    let (app, version) = trained().await;
    let versioned = format!("/v2/models/{MODEL}/versions/{version}");
    let metadata = json!({
        "name": MODEL, "versions": [version.to_string()], "platform": "nudge",
        "inputs": [{"name": "state", "datatype": "FP32", "shape": [-1, 2]}],
        "outputs": [
            {"name": "influence_probability", "datatype": "FP32", "shape": [-1]},
            {"name": "mutual_information", "datatype": "FP32", "shape": [-1]},
        ],
    });
    assert_eq!(
        app.rest("GET", &format!("/v2/models/{MODEL}"), None).await,
        (200, metadata.clone())
    );
    assert_eq!(app.rest("GET", &versioned, None).await, (200, metadata));
    // The environment alone means its first two agents.
    assert_eq!(
        app.rest("GET", "/v2/models/world", None).await.1["name"],
        "world"
    );
    for path in [
        &format!("/v2/models/{MODEL}/ready"),
        &format!("{versioned}/ready"),
    ] {
        assert_eq!(
            app.rest("GET", path, None).await,
            (200, json!({"name": MODEL, "ready": true}))
        );
    }
    let mut client = client(&app).await;
    let ready = ModelReadyRequest {
        name: MODEL.into(),
        version: version.to_string(),
    };
    assert!(
        client
            .model_ready(ready)
            .await
            .expect("known")
            .into_inner()
            .ready
    );
    let metadata = ModelMetadataRequest {
        name: "world".into(),
        version: String::new(),
    };
    let told = client
        .model_metadata(metadata)
        .await
        .expect("known")
        .into_inner();
    assert_eq!(
        (told.versions, told.inputs[0].shape.as_slice()),
        (vec![version.to_string()], &[-1, 2][..])
    );
    assert_eq!(told.outputs.len(), 2);
}

#[tokio::test]
async fn any_version_of_a_pair_can_be_asked_by_its_number() {
    let (app, first) = trained().await;
    let direct = train(&app, "human", "direct").await;
    let of_dog = train(&app, "dog", "joint").await;
    let rows = rows(3);
    for version in [first, direct] {
        let expected = expected(&app, version, &rows).await;
        let (status, answer) = infer(
            &app,
            &format!("{MODEL}/versions/{version}"),
            &document(&rows),
        )
        .await;
        assert_eq!(
            (status, &answer["model_version"]),
            (200, &json!(version.to_string())),
            "{answer}"
        );
        assert_eq!(of_json(&answer), expected);
        let message = ModelInferRequest {
            model_version: version.to_string(),
            ..message(&rows)
        };
        assert_eq!(
            of_message(&call(&app, message).await.expect("kept")),
            expected
        );
    }
    // A direct network knows only the probability.
    let (_, metadata) = app
        .rest(
            "GET",
            &format!("/v2/models/{MODEL}/versions/{direct}"),
            None,
        )
        .await;
    assert_eq!(
        metadata["versions"],
        json!([first.to_string(), direct.to_string()])
    );
    assert_eq!(metadata["outputs"].as_array().map(Vec::len), Some(1));
    // A version of another pair is none of this model's.
    for version in [of_dog, 999] {
        let (code, told) = infer(
            &app,
            &format!("{MODEL}/versions/{version}"),
            &document(&rows),
        )
        .await;
        let known = if version == of_dog {
            format!("{first}, {direct}")
        } else {
            format!("{first}, {direct}, {of_dog}")
        };
        assert_eq!(code, 404);
        assert!(
            told["error"]
                .as_str()
                .is_some_and(|told| told.ends_with(&format!("; known: {known}"))),
            "{told}"
        );
        let message = ModelInferRequest {
            model_version: version.to_string(),
            ..message(&rows)
        };
        let status = call(&app, message).await.expect_err("not of this pair");
        assert_eq!(
            (status.code(), reason(&status).as_str()),
            (Code::NotFound, "MODEL_NOT_FOUND")
        );
        assert_eq!(status.message(), told["error"]);
    }
    // Nobody trained this one.
    assert_eq!(
        infer(&app, "world~dog~human", &document(&rows)).await.0,
        404
    );
}

#[tokio::test]
async fn outputs_come_as_asked() {
    let (app, version) = trained().await;
    let rows = rows(2);
    let mut swapped = expected(&app, version, &rows).await;
    swapped.reverse();
    let names = ["mutual_information", "influence_probability"];
    let mut asked = document(&rows);
    asked["outputs"] = names.iter().map(|name| json!({ "name": name })).collect();
    assert_eq!(of_json(&infer(&app, MODEL, &asked).await.1), swapped);
    let output = |name: &str| InferRequestedOutputTensor {
        name: name.into(),
        ..Default::default()
    };
    let message = ModelInferRequest {
        outputs: names.iter().map(|name| output(name)).collect(),
        ..message(&rows)
    };
    assert_eq!(
        of_message(&call(&app, message).await.expect("valid")),
        swapped
    );
}

#[tokio::test]
async fn both_faces_refuse_the_same() {
    let (app, _) = trained().await;
    let good = message(&rows(2));
    let with = |change: &dyn Fn(&mut ModelInferRequest)| {
        let mut message = good.clone();
        change(&mut message);
        message
    };
    let output = InferRequestedOutputTensor {
        name: "speed".into(),
        ..Default::default()
    };
    let elsewhere = output_with("shared_memory_region", StringParam("mine".into()));
    let cases = [
        (
            "/inputs/0/shape",
            with(&|message| message.inputs[0].shape = vec![4, 1]),
        ),
        (
            "/inputs/0/datatype",
            with(&|message| message.inputs[0].datatype = "FP64".into()),
        ),
        (
            "/inputs/0/name",
            with(&|message| message.inputs[0].name = "x".into()),
        ),
        (
            "/inputs/0/data",
            with(&|message| message.inputs[0].shape = vec![3, 2]),
        ),
        (
            "/inputs/0/data/1/place: got NaN",
            with(&|message| {
                message.raw_input_contents[0][8..12].copy_from_slice(&f32::NAN.to_le_bytes())
            }),
        ),
        (
            "/inputs/0/data/0/light: got 2",
            with(&|message| {
                message.raw_input_contents[0][4..8].copy_from_slice(&2f32.to_le_bytes())
            }),
        ),
        (
            "/outputs/0/name",
            with(&|message| message.outputs = vec![output.clone()]),
        ),
        (
            "/outputs/0/parameters/shared_memory_region",
            with(&|message| message.outputs = vec![elsewhere.clone()]),
        ),
        (
            "/outputs/0/parameters/shared_memory_byte_size",
            with(&|message| {
                message.outputs = vec![output_with("shared_memory_byte_size", Int64Param(8))]
            }),
        ),
        (
            "/outputs/0/parameters/classification",
            with(&|message| message.outputs = vec![output_with("classification", Int64Param(3))]),
        ),
        (
            "/outputs/0/parameters/class_count",
            with(&|message| message.outputs = vec![output_with("class_count", Int64Param(3))]),
        ),
        (
            "/outputs/0/parameters/classification",
            with(&|message| {
                message.outputs = vec![output_with("classification", DoubleParam(0.5))]
            }),
        ),
        (
            "/parameters/classification",
            with(&|message| message.parameters = parameter("classification", Int64Param(3))),
        ),
        (
            "/parameters/class_count",
            with(&|message| message.parameters = parameter("class_count", Int64Param(3))),
        ),
        (
            "/parameters/shared_memory_region",
            with(&|message| {
                message.parameters = parameter("shared_memory_region", StringParam("mine".into()))
            }),
        ),
        (
            "/inputs/0/parameters/shared_memory_region",
            with(&|message| {
                message.inputs[0].parameters =
                    parameter("shared_memory_region", StringParam("mine".into()));
            }),
        ),
    ];
    for (fault, message) in cases {
        let status = call(&app, message.clone()).await.expect_err(fault);
        assert_eq!(
            (status.code(), reason(&status).as_str()),
            (Code::InvalidArgument, "INVALID_INPUT"),
            "{fault}"
        );
        assert!(
            status.message().contains(fault),
            "{fault} in {}",
            status.message()
        );
        let (code, answer) = binary(&app, &message).await;
        assert_eq!(
            (code, &answer),
            (400, &json!({"error": status.message()})),
            "{fault}"
        );
    }
}

fn parameter(name: &str, choice: ParameterChoice) -> HashMap<String, InferParameter> {
    HashMap::from([(
        name.to_owned(),
        InferParameter {
            parameter_choice: Some(choice),
        },
    )])
}

fn output_with(name: &str, choice: ParameterChoice) -> InferRequestedOutputTensor {
    InferRequestedOutputTensor {
        name: "influence_probability".into(),
        parameters: parameter(name, choice),
    }
}

/// Returns parameters as REST has them.
fn as_json(parameters: &HashMap<String, InferParameter>) -> Value {
    let value = |parameter: &InferParameter| match &parameter.parameter_choice {
        Some(Int64Param(number)) => json!(number),
        Some(StringParam(text)) => json!(text),
        Some(DoubleParam(number)) => json!(number),
        other => panic!("no case has {other:?}"),
    };
    parameters
        .iter()
        .map(|(name, parameter)| (name.clone(), value(parameter)))
        .collect::<serde_json::Map<_, _>>()
        .into()
}

#[tokio::test]
async fn parameters_that_say_nothing_are_no_fault() {
    let (app, _) = trained().await;
    let rows = rows(2);
    let mut zero = document(&rows);
    zero["outputs"] = json!([{"name": "influence_probability", "parameters": {"classification": 0, "priority": 3}}]);
    zero["inputs"][0]["parameters"] = json!({"shared_memory_offset": null, "colour": "red"});
    assert_eq!(infer(&app, MODEL, &zero).await.0, 200);
    zero["outputs"][0]["parameters"] = json!({"classification": 0.0, "class_count": null});
    zero["parameters"] = json!({"classification": 0.0, "priority": 3});
    assert_eq!(infer(&app, MODEL, &zero).await.0, 200);
    for nothing in [Int64Param(0), DoubleParam(0.0)] {
        let outputs = vec![output_with("classification", nothing.clone())];
        let parameters = parameter("class_count", nothing);
        call(
            &app,
            ModelInferRequest {
                outputs,
                parameters,
                ..message(&rows)
            },
        )
        .await
        .expect("0 classes are none");
    }
}

#[tokio::test]
async fn an_unknown_model_is_not_ready() {
    let (app, version) = trained().await;
    let mut client = client(&app).await;
    let cases = [
        (MODEL, version.to_string(), true),
        (MODEL, String::new(), true),
        (MODEL, "999".into(), false),
        ("nowhere", String::new(), false),
        ("world~robot~cat", String::new(), false),
        // Nobody trained this one.
        ("world~dog~human", String::new(), false),
        ("", String::new(), false),
    ];
    for (name, version, expected) in cases {
        let request = ModelReadyRequest {
            name: name.into(),
            version: version.clone(),
        };
        let ready = client
            .model_ready(request)
            .await
            .expect("answered")
            .into_inner()
            .ready;
        assert_eq!(ready, expected, "{name} {version}");
    }
    let wrong = ModelReadyRequest {
        name: MODEL.into(),
        version: "latest".into(),
    };
    assert_eq!(
        client
            .model_ready(wrong)
            .await
            .expect_err("no version")
            .code(),
        Code::InvalidArgument
    );
}

/// Sends the same over REST, as binary tensors.
async fn binary(app: &TestApp, message: &ModelInferRequest) -> (u16, Value) {
    let (input, raw) = (&message.inputs[0], &message.raw_input_contents[0]);
    let wanted = |output: &InferRequestedOutputTensor| json!({"name": output.name, "parameters": as_json(&output.parameters)});
    let outputs: Vec<Value> = message.outputs.iter().map(wanted).collect();
    let mut parameters = as_json(&input.parameters);
    parameters["binary_data_size"] = raw.len().into();
    let head = json!({
        "inputs": [{"name": input.name, "datatype": input.datatype, "shape": input.shape,
            "parameters": parameters}],
        "outputs": outputs,
        "parameters": as_json(&message.parameters),
    });
    let head = head.to_string();
    let body = [head.as_bytes(), raw].concat();
    let headers = [(HEADER_LENGTH, &*head.len().to_string())];
    let response = post(app, &format!("/v2/models/{MODEL}/infer"), &headers, body).await;
    (
        response.status().as_u16(),
        response.json().await.expect("JSON"),
    )
}

#[tokio::test]
async fn predictions_are_measured() {
    let (app, _) = trained().await;
    infer(&app, MODEL, &document(&rows(5))).await;
    infer(&app, "world~dog~human", &document(&rows(5))).await;
    let (_, text) = app.rest("GET", "/metrics", None).await;
    let text = text.as_str().expect("text");
    for line in [
        "nudge_inferences_total{code=\"OK\"}",
        "nudge_inferences_total{code=\"MODEL_NOT_FOUND\"}",
        "nudge_inference_states_total",
        "nudge_inference_duration_seconds_bucket",
        "route=\"POST /v2/models/{model}/infer\"",
    ] {
        assert!(text.contains(line), "{line} in\n{text}");
    }
}
