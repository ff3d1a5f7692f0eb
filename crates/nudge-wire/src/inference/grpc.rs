//! Conversions between the protocol's proto messages and its request and answer.

use std::collections::HashMap;

use nudge_core::error::{Fault, Problem};

use super::{Answer, DATATYPE, INPUT, Metadata, Output, Request, Tensor, Values, unsupported};
use crate::inference_proto::infer_parameter::ParameterChoice;
use crate::inference_proto::model_infer_request::InferInputTensor;
use crate::inference_proto::model_infer_response::InferOutputTensor;
use crate::inference_proto::model_metadata_response::TensorMetadata;
use crate::inference_proto::{
    InferParameter, InferTensorContents, ModelInferRequest, ModelInferResponse,
    ModelMetadataResponse, ServerMetadataResponse,
};

/// Returns the request in a message. The model and its version stay behind.
pub fn request(message: ModelInferRequest) -> Result<Request, Problem> {
    let ModelInferRequest {
        id,
        parameters,
        inputs,
        outputs,
        raw_input_contents: raw,
        ..
    } = message;

    if !raw.is_empty() && raw.len() != inputs.len() {
        let detail = format!(
            "got {}, expected one for each of {} inputs, or none",
            raw.len(),
            inputs.len()
        );
        return Err(invalid("/raw_input_contents", detail));
    }

    if let Some(both) = inputs
        .iter()
        .position(|input| !raw.is_empty() && input.contents.is_some())
    {
        let detail =
            "got values here and in raw_input_contents, expected them in one of the two".to_owned();
        return Err(invalid(&format!("/inputs/{both}/contents"), detail));
    }

    let inputs_with = inputs
        .iter()
        .enumerate()
        .map(|(i, input)| (format!("/inputs/{i}"), &input.parameters));
    let outputs_with = outputs
        .iter()
        .enumerate()
        .map(|(i, output)| (format!("/outputs/{i}"), &output.parameters));
    let mut tensors = std::iter::once((String::new(), &parameters))
        .chain(inputs_with)
        .chain(outputs_with);
    if let Some(fault) = tensors
        .find_map(|(tensor, parameters)| unsupported(&tensor, |name| is_set(parameters, name)))
    {
        return Err(Problem::invalid("inference request", vec![fault]));
    }

    let mut raw = raw.into_iter();

    Ok(Request {
        id: Some(id).filter(|id| !id.is_empty()),
        inputs: inputs
            .into_iter()
            .map(|input| tensor(input, raw.next()))
            .collect(),
        outputs: outputs.into_iter().map(|output| output.name).collect(),
    })
}

fn invalid(pointer: &str, detail: String) -> Problem {
    Problem::invalid("inference request", vec![Fault::new(pointer, detail)])
}

/// Tells whether a parameter says something: 0 says nothing.
fn is_set(parameters: &HashMap<String, InferParameter>, name: &str) -> bool {
    let choice = parameters
        .get(name)
        .and_then(|parameter| parameter.parameter_choice.as_ref());
    choice.is_some_and(|choice| match choice {
        ParameterChoice::Int64Param(number) => *number != 0,
        ParameterChoice::Uint64Param(number) => *number != 0,
        ParameterChoice::DoubleParam(number) => *number != 0.0,
        ParameterChoice::BoolParam(_) | ParameterChoice::StringParam(_) => true,
    })
}

fn tensor(input: InferInputTensor, raw: Option<Vec<u8>>) -> Tensor {
    let InferInputTensor {
        name,
        datatype,
        shape,
        contents,
        ..
    } = input;
    let values = raw.map_or_else(|| typed(contents), |bytes| Values::Raw(bytes.into()));
    Tensor {
        name,
        datatype,
        shape,
        values,
    }
}

/// Returns the values of the only list that is read; values in another list are no values.
fn typed(contents: Option<InferTensorContents>) -> Values {
    match contents {
        Some(contents) if !contents.fp32_contents.is_empty() => {
            Values::Numbers(contents.fp32_contents, None)
        }
        Some(_) => Values::Unreadable(Fault::new(
            "/contents",
            "got no values in fp32_contents, expected them there",
        )),
        None => Values::Unreadable(Fault::new(
            "/contents",
            "missing; raw_input_contents is empty too",
        )),
    }
}

impl From<Answer> for ModelInferResponse {
    fn from(answer: Answer) -> Self {
        Self {
            model_name: answer.model.to_string(),
            model_version: answer.version.to_string(),
            id: answer.id.unwrap_or_default(),
            parameters: Default::default(),
            // Always raw: a client by Triton does not read typed contents.
            raw_output_contents: answer.outputs.iter().map(Output::bytes).collect(),
            outputs: answer.outputs.iter().map(Into::into).collect(),
        }
    }
}

impl From<&Output> for InferOutputTensor {
    fn from(output: &Output) -> Self {
        let threshold = output
            .threshold
            .map(|nats| ("threshold_nats", ParameterChoice::DoubleParam(nats)));
        let unit = output
            .unit
            .map(|unit| ("unit", ParameterChoice::StringParam(unit.to_owned())));

        Self {
            name: output.figure.as_str().to_owned(),
            datatype: DATATYPE.to_owned(),
            shape: vec![output.values.len() as i64],
            parameters: threshold.into_iter().chain(unit).map(parameter).collect(),
            contents: None,
        }
    }
}

fn parameter((name, choice): (&str, ParameterChoice)) -> (String, InferParameter) {
    let parameter = InferParameter {
        parameter_choice: Some(choice),
    };
    (name.to_owned(), parameter)
}

impl From<Metadata> for ModelMetadataResponse {
    fn from(metadata: Metadata) -> Self {
        Self {
            name: metadata.model.to_string(),
            versions: metadata.versions.iter().map(u64::to_string).collect(),
            platform: "nudge".to_owned(),
            inputs: vec![tensor_metadata(INPUT, vec![-1, metadata.features as i64])],
            outputs: metadata
                .figures
                .iter()
                .map(|figure| tensor_metadata(figure.as_str(), vec![-1]))
                .collect(),
        }
    }
}

fn tensor_metadata(name: &str, shape: Vec<i64>) -> TensorMetadata {
    TensorMetadata {
        name: name.to_owned(),
        datatype: DATATYPE.to_owned(),
        shape,
    }
}

/// Returns what this server is.
pub fn server() -> ServerMetadataResponse {
    ServerMetadataResponse {
        name: "nudge".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        extensions: vec!["binary_tensor_data".to_owned()],
    }
}
