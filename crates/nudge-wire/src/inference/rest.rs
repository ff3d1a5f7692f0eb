//! Between the protocol's JSON with the binary tensors after it, and its request and answer.

use std::collections::HashMap;

use bytes::Bytes;
use nudge_core::error::{Fault, Problem};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Answer, DATATYPE, Output, Request, Tensor, Values, unsupported};
use crate::inference_proto::model_metadata_response::TensorMetadata;
use crate::inference_proto::{ModelMetadataResponse, ServerMetadataResponse};
use crate::json;

mod data;

use data::Data;

/// Where a body says how much of it is JSON; the tensors come after that.
pub const HEADER_LENGTH: &str = "inference-header-content-length";

const WHAT: &str = "inference request";

/// Which outputs are wanted as bytes after the JSON.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Form {
    all: bool,
    /// What each of the outputs that were asked for says of itself.
    outputs: Vec<Option<bool>>,
}

/// An answer as it is sent.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoded {
    /// How much of the body is JSON, where tensors come after it.
    pub header_length: Option<usize>,
    /// The body.
    pub body: Vec<u8>,
}

#[derive(Deserialize)]
struct Document {
    id: Option<String>,
    parameters: Option<RequestParameters>,
    inputs: Vec<Input>,
    outputs: Option<Vec<Wanted>>,
}

#[derive(Deserialize)]
struct RequestParameters {
    binary_data_output: Option<bool>,
    #[serde(flatten)]
    others: HashMap<String, Value>,
}

#[derive(Deserialize)]
struct Input {
    name: String,
    datatype: String,
    #[serde(deserialize_with = "json::wholes")]
    shape: Vec<i64>,
    parameters: Option<InputParameters>,
    data: Option<Data>,
}

#[derive(Deserialize)]
struct InputParameters {
    #[serde(default, deserialize_with = "json::perhaps_whole")]
    binary_data_size: Option<usize>,
    #[serde(flatten)]
    others: HashMap<String, Value>,
}

#[derive(Deserialize)]
struct Wanted {
    name: String,
    parameters: Option<WantedParameters>,
}

#[derive(Deserialize)]
struct WantedParameters {
    binary_data: Option<bool>,
    #[serde(flatten)]
    others: HashMap<String, Value>,
}

/// Returns the request in a body, and the form of its answer. Members that are not known are
/// ignored, as the protocol wants it.
pub fn request(body: &Bytes, header_length: Option<&str>) -> Result<(Request, Form), Problem> {
    let fault = |fault| Problem::invalid(WHAT, vec![fault]);
    let (head, tail) = split(body, header_length).map_err(fault)?;
    let Document {
        id,
        parameters,
        inputs,
        outputs,
    } = json::decode(WHAT, &head)?;
    let outputs = outputs.unwrap_or_default();
    let others = parameters.as_ref().map(|parameters| &parameters.others);
    supported(others, &inputs, &outputs).map_err(fault)?;
    let form = Form {
        all: parameters
            .and_then(|parameters| parameters.binary_data_output)
            .unwrap_or_default(),
        outputs: outputs.iter().map(Wanted::is_binary).collect(),
    };

    let inputs = tensors(inputs, tail).map_err(fault)?;
    let outputs = outputs.into_iter().map(|output| output.name).collect();

    Ok((
        Request {
            id,
            inputs,
            outputs,
        },
        form,
    ))
}

/// Returns the JSON and what comes after it.
fn split(body: &Bytes, header_length: Option<&str>) -> Result<(Bytes, Bytes), Fault> {
    let Some(text) = header_length else {
        return Ok((body.clone(), Bytes::new()));
    };
    match text.trim().parse::<usize>() {
        Ok(length) if length <= body.len() => Ok((body.slice(..length), body.slice(length..))),
        _ => {
            let detail = format!(
                "got {HEADER_LENGTH} {text:?}, expected 0 to {}, the bytes of the body",
                body.len()
            );
            Err(Fault::new("", detail))
        }
    }
}

/// Checks that the values of every tensor are in the body, and are told as they are, by its own
/// parameters and the request's.
fn supported(
    request: Option<&HashMap<String, Value>>,
    inputs: &[Input],
    outputs: &[Wanted],
) -> Result<(), Fault> {
    let inputs = inputs.iter().map(|input| {
        input
            .parameters
            .as_ref()
            .map(|parameters| &parameters.others)
    });
    let outputs = outputs.iter().map(|output| {
        output
            .parameters
            .as_ref()
            .map(|parameters| &parameters.others)
    });
    let inputs = inputs
        .enumerate()
        .map(|(i, parameters)| (format!("/inputs/{i}"), parameters));
    let outputs = outputs
        .enumerate()
        .map(|(i, parameters)| (format!("/outputs/{i}"), parameters));

    std::iter::once((String::new(), request))
        .chain(inputs)
        .chain(outputs)
        .find_map(|(tensor, parameters)| unsupported_of(&tensor, parameters))
        .map_or(Ok(()), Err)
}

fn unsupported_of(tensor: &str, parameters: Option<&HashMap<String, Value>>) -> Option<Fault> {
    unsupported(tensor, |name| {
        parameters.is_some_and(|parameters| is_set(parameters, name))
    })
}

/// Tells whether a parameter says something: 0 says nothing.
fn is_set(parameters: &HashMap<String, Value>, name: &str) -> bool {
    parameters
        .get(name)
        .is_some_and(|value| !value.is_null() && value.as_f64() != Some(0.0))
}

/// Gives each input its values: those in its JSON, or its share of the bytes after the JSON.
fn tensors(inputs: Vec<Input>, mut tail: Bytes) -> Result<Vec<Tensor>, Fault> {
    let mut tensors = Vec::with_capacity(inputs.len());
    for (i, input) in inputs.into_iter().enumerate() {
        let size = input
            .parameters
            .and_then(|parameters| parameters.binary_data_size);
        let values = match (input.data, size) {
            (Some(_), Some(_)) => {
                let detail = "got values here and binary_data_size, expected one of the two";
                return Err(Fault::new(format!("/inputs/{i}/data"), detail));
            }
            (Some(data), None) => data.into(),
            (None, Some(size)) if size <= tail.len() => Values::Raw(tail.split_to(size)),
            (None, Some(size)) => {
                let detail = format!(
                    "got {size}, but {} bytes are left after the JSON",
                    tail.len()
                );
                return Err(Fault::new(
                    format!("/inputs/{i}/parameters/binary_data_size"),
                    detail,
                ));
            }
            (None, None) => Values::Unreadable(Fault::new(
                "/data",
                "missing, and so is parameters.binary_data_size",
            )),
        };
        tensors.push(Tensor {
            name: input.name,
            datatype: input.datatype,
            shape: input.shape,
            values,
        });
    }
    if tail.is_empty() {
        Ok(tensors)
    } else {
        Err(Fault::new(
            "",
            format!("{} bytes follow the tensors", tail.len()),
        ))
    }
}

impl Wanted {
    fn is_binary(&self) -> Option<bool> {
        self.parameters
            .as_ref()
            .and_then(|parameters| parameters.binary_data)
    }
}

#[derive(Serialize)]
struct AnswerDocument<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<&'a str>,
    model_name: &'a str,
    model_version: String,
    outputs: Vec<OutputDocument<'a>>,
}

#[derive(Serialize)]
struct OutputDocument<'a> {
    name: &'static str,
    datatype: &'static str,
    shape: [usize; 1],
    parameters: OutputParameters,
    #[serde(skip_serializing_if = "Option::is_none")]
    data: Option<&'a [f32]>,
}

#[derive(Serialize)]
struct OutputParameters {
    #[serde(skip_serializing_if = "Option::is_none")]
    threshold_nats: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    unit: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    binary_data_size: Option<usize>,
}

impl Encoded {
    /// Encodes an answer in the form that was wanted.
    pub fn new(answer: &Answer, form: &Form) -> Self {
        let mut tail = Vec::new();
        let outputs = answer.outputs.iter().enumerate().map(|(i, output)| {
            let bytes = form.wants_bytes(i).then(|| output.bytes());
            tail.extend(bytes.iter().flatten());
            document(output, bytes.map(|bytes| bytes.len()))
        });
        let head = AnswerDocument {
            id: answer.id.as_deref(),
            model_name: &answer.model,
            model_version: answer.version.to_string(),
            outputs: outputs.collect(),
        };

        let mut body = serde_json::to_vec(&head).expect("numbers and text become JSON");
        let header_length = (!tail.is_empty()).then_some(body.len());
        body.append(&mut tail);

        Self {
            header_length,
            body,
        }
    }
}

impl Form {
    fn wants_bytes(&self, output: usize) -> bool {
        self.outputs
            .get(output)
            .copied()
            .flatten()
            .unwrap_or(self.all)
    }
}

fn document(output: &Output, binary_data_size: Option<usize>) -> OutputDocument<'_> {
    OutputDocument {
        name: output.figure.as_str(),
        datatype: DATATYPE,
        shape: [output.values.len()],
        parameters: OutputParameters {
            threshold_nats: output.threshold,
            unit: output.unit,
            binary_data_size,
        },
        data: binary_data_size.is_none().then_some(&output.values),
    }
}

/// What this server is, as JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Server {
    name: String,
    version: String,
    extensions: Vec<String>,
}

impl From<ServerMetadataResponse> for Server {
    fn from(server: ServerMetadataResponse) -> Self {
        let ServerMetadataResponse {
            name,
            version,
            extensions,
        } = server;
        Self {
            name,
            version,
            extensions,
        }
    }
}

/// What a model takes and answers, as JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Model {
    name: String,
    versions: Vec<String>,
    platform: String,
    inputs: Vec<Port>,
    outputs: Vec<Port>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct Port {
    name: String,
    datatype: String,
    shape: Vec<i64>,
}

impl From<ModelMetadataResponse> for Model {
    fn from(model: ModelMetadataResponse) -> Self {
        let ports = |tensors: Vec<TensorMetadata>| tensors.into_iter().map(Port::from).collect();
        Self {
            name: model.name,
            versions: model.versions,
            platform: model.platform,
            inputs: ports(model.inputs),
            outputs: ports(model.outputs),
        }
    }
}

impl From<TensorMetadata> for Port {
    fn from(tensor: TensorMetadata) -> Self {
        let TensorMetadata {
            name,
            datatype,
            shape,
        } = tensor;
        Self {
            name,
            datatype,
            shape,
        }
    }
}
