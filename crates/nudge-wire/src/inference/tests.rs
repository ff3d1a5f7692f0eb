//! Both forms of a request decode to the same, every fault has its place, and both forms of an
//! answer say the same.

use bytes::Bytes;
use nudge_core::domain::SchemaDraft;
use nudge_core::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
use serde_json::{Value, json};

use super::*;
use crate::inference_proto::model_infer_request::{InferInputTensor, InferRequestedOutputTensor};
use crate::inference_proto::{
    InferTensorContents, ModelInferRequest, ModelInferResponse, ModelMetadataResponse,
};

/// `distance` with edges 0.5 and 1, `lane` 0 to 3; two agents.
fn schema() -> Schema {
    let feature = |name: &str, kind| FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![kind],
    };
    let agent = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![feature("move", KindDraft::Integer(0, 1))],
        ..AgentDraft::default()
    };
    let state = vec![
        feature("distance", KindDraft::Continuous(vec![0.5, 1.0])),
        feature("lane", KindDraft::Integer(0, 3)),
    ];
    Schema::try_from(&SchemaDraft {
        state,
        agents: vec![agent("robot"), agent("human")],
        ..SchemaDraft::default()
    })
    .expect("valid")
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

/// A request whose only input has this datatype, shape and data.
fn document(datatype: &str, shape: &[i64], data: Value) -> Value {
    json!({"inputs": [{"name": "state", "datatype": datatype, "shape": shape, "data": data}]})
}

fn of_json(document: &Value) -> Result<Request, Problem> {
    rest::request(&Bytes::from(document.to_string()), None).map(|(request, _)| request)
}

/// Sends `document` with tensors after it.
fn of_bytes(document: &Value, tail: &[u8]) -> Result<(Request, rest::Form), Problem> {
    let head = document.to_string();
    let body = [head.as_bytes(), tail].concat();
    rest::request(&Bytes::from(body), Some(&head.len().to_string()))
}

fn binary(size: usize) -> Value {
    json!({"name": "state", "datatype": "FP32", "shape": [2, 2], "parameters": {"binary_data_size": size}})
}

fn keys(request: &Request) -> Vec<String> {
    request
        .states(&schema())
        .expect("valid")
        .iter()
        .map(ToString::to_string)
        .collect()
}

/// The place and the text of the first fault.
fn fault(result: Result<impl std::fmt::Debug, Problem>) -> (String, String) {
    let fault = result.expect_err("wrong").faults.remove(0);
    (fault.pointer, fault.detail)
}

fn states_fault(document: &Value) -> (String, String) {
    fault(of_json(document).and_then(|request| request.states(&schema())))
}

#[test]
fn flat_nested_and_binary_values_are_the_same_states() {
    let expected = ["1.3", "0.0"];
    let flat = of_json(&document("FP32", &[2, 2], json!([0.7, 3, 0.1, 0]))).expect("valid");
    let nested = of_json(&document("FP32", &[2, 2], json!([[0.7, 3], [0.1, 0]]))).expect("valid");
    let (raw, _) = of_bytes(
        &json!({"inputs": [binary(16)]}),
        &bytes(&[0.7, 3.0, 0.1, 0.0]),
    )
    .expect("valid");
    assert_eq!([keys(&flat), keys(&nested), keys(&raw)], [expected; 3]);
}

#[test]
fn a_message_is_read_from_either_of_its_contents() {
    let input = |contents| InferInputTensor {
        name: "state".into(),
        datatype: "FP32".into(),
        shape: vec![2, 2],
        contents,
        ..Default::default()
    };
    let values = vec![0.7, 3.0, 0.1, 0.0];
    let fp32 = InferTensorContents {
        fp32_contents: values.clone(),
        ..Default::default()
    };
    let typed = ModelInferRequest {
        id: "7".into(),
        inputs: vec![input(Some(fp32.clone()))],
        ..Default::default()
    };
    let raw = ModelInferRequest {
        inputs: vec![input(None)],
        outputs: vec![InferRequestedOutputTensor {
            name: "mutual_information".into(),
            ..Default::default()
        }],
        raw_input_contents: vec![bytes(&values)],
        ..Default::default()
    };
    let read = grpc::request(typed.clone()).expect("valid");
    assert_eq!(
        (keys(&read), read.id.as_deref()),
        (vec!["1.3".to_owned(), "0.0".to_owned()], Some("7"))
    );
    let read = grpc::request(raw.clone()).expect("valid");
    assert_eq!(
        (keys(&read), read.id),
        (vec!["1.3".to_owned(), "0.0".to_owned()], None)
    );
    assert_eq!(read.outputs, ["mutual_information"]);

    let both = ModelInferRequest {
        raw_input_contents: vec![bytes(&values)],
        ..typed.clone()
    };
    assert_eq!(fault(grpc::request(both)).0, "/inputs/0/contents");
    let two = ModelInferRequest {
        raw_input_contents: vec![Vec::new(); 2],
        ..raw.clone()
    };
    assert_eq!(fault(grpc::request(two)).0, "/raw_input_contents");
    let none = ModelInferRequest {
        raw_input_contents: Vec::new(),
        ..raw
    };
    assert_eq!(
        fault(grpc::request(none).expect("read").states(&schema())).0,
        "/inputs/0/contents"
    );
    let fp64 = InferTensorContents {
        fp64_contents: vec![0.0; 4],
        ..Default::default()
    };
    let other_list = ModelInferRequest {
        inputs: vec![input(Some(fp64))],
        ..typed
    };
    assert_eq!(
        fault(grpc::request(other_list).expect("read").states(&schema())).0,
        "/inputs/0/contents"
    );
}

#[test]
fn unknown_members_are_ignored() {
    let mut request = document("FP32", &[1, 2], json!([0, 0]));
    request["id"] = json!("mine");
    request["parameters"] = json!({"priority": 3, "binary_data_output": null});
    request["inputs"][0]["parameters"] = json!({"content_type": "np"});
    request["outputs"] = Value::Null;
    request["speed"] = json!({"high": []});
    let request = of_json(&request).expect("valid");
    assert_eq!(
        (request.id.as_deref(), request.outputs.len()),
        (Some("mine"), 0)
    );
}

#[test]
fn a_type_other_than_fp32_is_named() {
    for (datatype, data) in [
        ("FP64", json!([0, 0])),
        ("INT64", json!([0, 0])),
        ("BYTES", json!(["a", "b"])),
        ("", json!([])),
    ] {
        let (pointer, detail) = states_fault(&document(datatype, &[1, 2], data));
        assert_eq!(
            (pointer.as_str(), detail),
            (
                "/inputs/0/datatype",
                format!("got {datatype:?}, expected FP32")
            )
        );
    }
}

#[test]
fn a_shape_is_rows_by_features() {
    for shape in [&[][..], &[2], &[1, 3], &[1, -1], &[1, 1, 2], &[2, 1]] {
        let (pointer, detail) = states_fault(&document("FP32", shape, json!([0, 0])));
        assert_eq!(pointer, "/inputs/0/shape");
        assert!(
            detail.ends_with("expected [rows, 2]: distance, lane"),
            "{detail}"
        );
    }
    for rows in [0, -1, i64::MIN, i64::MAX, MOST_ROWS as i64 + 1] {
        assert_eq!(
            states_fault(&document("FP32", &[rows, 2], json!([0, 0]))).0,
            "/inputs/0/shape/0",
            "{rows}"
        );
    }
}

#[test]
fn values_are_as_many_as_the_shape_says() {
    let told = |shape: &[i64], data| states_fault(&document("FP32", shape, data));
    let few = (
        "/inputs/0/data".to_owned(),
        "got 3 values, expected 2 x 2 = 4".to_owned(),
    );
    assert_eq!(told(&[2, 2], json!([0, 0, 0])), few);
    // As many as expected, but not in rows of two.
    assert_eq!(told(&[2, 2], json!([[0, 0, 0, 0]])).0, "/inputs/0/data/0");
    assert_eq!(
        told(&[2, 2], json!([[0, 0], [0], [0]])).0,
        "/inputs/0/data/1"
    );
    assert_eq!(told(&[2, 2], json!([[0, 0], 0, 0])).0, "/inputs/0/data/1");
    assert_eq!(told(&[2, 2], json!([0, 0, [0, 0]])).0, "/inputs/0/data/2");
    let (request, _) = of_bytes(&json!({"inputs": [binary(12)]}), &[0; 12]).expect("read");
    let (pointer, detail) = fault(request.states(&schema()));
    assert_eq!(
        (pointer.as_str(), detail.as_str()),
        ("/inputs/0/data", "got 12 bytes, expected 2 x 2 x 4 = 16")
    );
}

#[test]
fn what_is_no_number_is_told_with_its_place() {
    for (data, place, told) in [
        (json!([0, null]), "/1", "got null"),
        (json!([true, 0]), "/0", "got true"),
        (json!([[0, 0], [0, "a"]]), "/1/1", "got text"),
        (json!([[0, {}]]), "/0/1", "got an object"),
        (json!([[[0, 0]]]), "/0/0", "got a list"),
    ] {
        let (pointer, detail) = states_fault(&document("FP32", &[1, 2], data));
        assert_eq!(
            (pointer, &detail[..told.len()]),
            (format!("/inputs/0/data{place}"), told)
        );
    }
    // Python writes NaN into JSON, which has no such number.
    let body = document("FP32", &[1, 2], json!([0, 0]))
        .to_string()
        .replace("[0,0]", "[0,NaN]");
    assert!(rest::request(&Bytes::from(body), None).is_err());
}

#[test]
fn a_value_without_a_bin_names_row_feature_and_value() {
    let nan = bytes(&[0.0, 0.0, f32::NAN, 9.0]);
    let (request, _) = of_bytes(&json!({"inputs": [binary(16)]}), &nan).expect("read");
    let faults = request.states(&schema()).expect_err("wrong").faults;
    let places: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
    assert_eq!(
        places,
        ["/inputs/0/data/1/distance", "/inputs/0/data/1/lane"]
    );
    assert!(
        faults[0].detail.starts_with("got NaN"),
        "{}",
        faults[0].detail
    );
    assert!(
        faults[1].detail.starts_with("got 9"),
        "{}",
        faults[1].detail
    );
    let infinite = states_fault(&document("FP32", &[1, 2], json!([1e39, 0])));
    assert!(infinite.1.starts_with("got inf"), "{infinite:?}");
}

#[test]
fn only_the_first_faults_are_told_and_the_others_counted() {
    let data: Vec<f32> = [0.0, 7.0].repeat(1_000);
    let faults = of_json(&document("FP32", &[1_000, 2], json!(data)))
        .and_then(|request| request.states(&schema()))
        .expect_err("wrong")
        .faults;
    assert_eq!(faults.len(), 11);
    assert_eq!(
        faults[10],
        Fault::new("/inputs/0/data", "990 more values are wrong")
    );
}

#[test]
fn the_only_input_is_the_state() {
    let told = |inputs: Value| states_fault(&json!({ "inputs": inputs })).0;
    let state = json!({"name": "state", "datatype": "FP32", "shape": [1, 2], "data": [0, 0]});
    assert_eq!(told(json!([])), "/inputs");
    assert_eq!(told(json!([state, state])), "/inputs");
    assert_eq!(
        told(json!([state, {"name": "x", "datatype": "FP32", "shape": [1], "data": [0]}])),
        "/inputs/1/name"
    );
    assert_eq!(
        told(json!([{"name": "state", "datatype": "FP32", "shape": [1, 2]}])),
        "/inputs/0/data"
    );
    assert_eq!(fault(of_json(&json!({}))).0, "/inputs");
}

#[test]
fn the_header_says_where_the_tensors_begin() {
    let document = json!({"inputs": [binary(16)]});
    let length = document.to_string().len();
    assert_eq!(
        fault(of_bytes(&document, &[0; 15])).0,
        "/inputs/0/parameters/binary_data_size"
    );
    assert_eq!(
        fault(of_bytes(&document, &[0; 17])),
        (String::new(), "1 bytes follow the tensors".to_owned())
    );
    // Without the header all of it is JSON.
    assert_eq!(
        fault(of_json(&document)).0,
        "/inputs/0/parameters/binary_data_size"
    );
    let body = Bytes::from([document.to_string().as_bytes(), &[0; 16]].concat());
    for header in ["", "-1", "x", "1e3", &(length + 17).to_string()] {
        assert!(
            fault(rest::request(&body, Some(header)))
                .1
                .contains(rest::HEADER_LENGTH),
            "{header}"
        );
    }
    assert!(rest::request(&body, Some("3")).is_err());
    assert!(rest::request(&body, None).is_err());
    assert!(rest::request(&body, Some(&format!(" {length} "))).is_ok());
    let mut both = binary(16);
    both["data"] = json!([0, 0, 0, 0]);
    assert_eq!(
        fault(of_bytes(&json!({"inputs": [both]}), &[0; 16])).0,
        "/inputs/0/data"
    );
}

#[test]
fn outputs_are_as_asked() {
    let ask = |names: &[&str]| {
        let mut request = document("FP32", &[1, 2], json!([0, 0]));
        request["outputs"] = names.iter().map(|name| json!({ "name": name })).collect();
        of_json(&request).expect("valid")
    };
    let (probability, information) = (Figure::InfluenceProbability, Figure::MutualInformation);
    assert_eq!(
        ask(&[]).figures(ModelKind::Joint),
        Ok(vec![probability, information])
    );
    assert_eq!(ask(&[]).figures(ModelKind::Direct), Ok(vec![probability]));
    let swapped = ask(&["mutual_information", "influence_probability"]);
    assert_eq!(
        swapped.figures(ModelKind::Joint),
        Ok(vec![information, probability])
    );
    let (pointer, detail) = fault(swapped.figures(ModelKind::Direct));
    assert_eq!(
        (pointer.as_str(), detail.as_str()),
        (
            "/outputs/0/name",
            "got \"mutual_information\", expected influence_probability"
        )
    );
    assert_eq!(
        fault(ask(&["influence_probability", "x"]).figures(ModelKind::Joint)).0,
        "/outputs/1/name"
    );
}

fn answer() -> Answer {
    let output = |figure, threshold, unit, values| Output {
        figure,
        threshold,
        unit,
        values,
    };
    Answer {
        model: "lane~robot~human".into(),
        version: 3,
        id: Some("mine".into()),
        outputs: vec![
            output(
                Figure::InfluenceProbability,
                Some(0.1),
                None,
                vec![0.1, 1.0],
            ),
            output(
                Figure::MutualInformation,
                None,
                Some("nats"),
                vec![0.25, 0.5],
            ),
        ],
    }
}

/// The form in which a request with these `parameters` and `outputs` wants its answer.
fn form(parameters: Value, outputs: Value) -> rest::Form {
    let mut request = document("FP32", &[1, 2], json!([0, 0]));
    request["parameters"] = parameters;
    request["outputs"] = outputs;
    rest::request(&Bytes::from(request.to_string()), None)
        .expect("valid")
        .1
}

#[test]
fn an_answer_is_json_unless_bytes_are_wanted() {
    let encoded = rest::Encoded::new(&answer(), &rest::Form::default());
    assert_eq!(encoded.header_length, None);
    let told: Value = serde_json::from_slice(&encoded.body).expect("JSON");
    assert_eq!(
        told,
        json!({
            "id": "mine", "model_name": "lane~robot~human", "model_version": "3",
            "outputs": [
                {"name": "influence_probability", "datatype": "FP32", "shape": [2],
                    "parameters": {"threshold_nats": 0.1}, "data": [0.1, 1.0]},
                {"name": "mutual_information", "datatype": "FP32", "shape": [2],
                    "parameters": {"unit": "nats"}, "data": [0.25, 0.5]},
            ]
        })
    );
}

#[test]
fn each_output_says_whether_it_is_wanted_as_bytes() {
    let outputs = json!([
        {"name": "influence_probability", "parameters": {"binary_data": false}},
        {"name": "mutual_information"},
    ]);
    let encoded = rest::Encoded::new(
        &answer(),
        &form(json!({"binary_data_output": true}), outputs),
    );
    let length = encoded.header_length.expect("a header");
    let told: Value = serde_json::from_slice(&encoded.body[..length]).expect("JSON");
    assert_eq!(told["outputs"][0]["data"], json!([0.1, 1.0]));
    assert_eq!(
        told["outputs"][1]["parameters"],
        json!({"unit": "nats", "binary_data_size": 8})
    );
    assert_eq!(told["outputs"][1].get("data"), None);
    assert_eq!(encoded.body[length..], bytes(&[0.25, 0.5]));

    let both = rest::Encoded::new(
        &answer(),
        &form(json!({"binary_data_output": true}), Value::Null),
    );
    assert_eq!(
        both.body[both.header_length.expect("a header")..],
        bytes(&[0.1, 1.0, 0.25, 0.5])
    );
}

#[test]
fn a_message_tells_the_same_as_bytes() {
    let message = ModelInferResponse::from(answer());
    assert_eq!(
        (message.model_version.as_str(), message.id.as_str()),
        ("3", "mine")
    );
    assert_eq!(
        message.raw_output_contents,
        [bytes(&[0.1, 1.0]), bytes(&[0.25, 0.5])]
    );
    let told: Vec<_> = message
        .outputs
        .iter()
        .map(|output| (output.name.as_str(), &output.shape[..]))
        .collect();
    assert_eq!(
        told,
        [
            ("influence_probability", &[2][..]),
            ("mutual_information", &[2][..])
        ]
    );
    assert!(
        message
            .outputs
            .iter()
            .all(|output| output.contents.is_none() && output.parameters.len() == 1)
    );
}

#[test]
fn metadata_is_the_same_in_both_forms() {
    let metadata = Metadata {
        model: "lane".into(),
        versions: vec![1, 4],
        features: 2,
        figures: Figure::of_kind(ModelKind::Joint),
    };
    let told = serde_json::to_value(rest::Model::from(ModelMetadataResponse::from(metadata)))
        .expect("JSON");
    assert_eq!(
        told,
        json!({
            "name": "lane", "versions": ["1", "4"], "platform": "nudge",
            "inputs": [{"name": "state", "datatype": "FP32", "shape": [-1, 2]}],
            "outputs": [
                {"name": "influence_probability", "datatype": "FP32", "shape": [-1]},
                {"name": "mutual_information", "datatype": "FP32", "shape": [-1]},
            ]
        })
    );
    let server = serde_json::to_value(rest::Server::from(grpc::server())).expect("JSON");
    assert_eq!(server["extensions"], json!(["binary_tensor_data"]));
}
