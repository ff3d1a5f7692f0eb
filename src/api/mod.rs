//! The wire: generated proto types, and their conversions to and from the domain, in one place.
//!
//! Requests become drafts, which the domain checks; answers become proto messages, and JSON is made of those, so that the faces cannot disagree.

pub mod grpc;
pub mod inference;
pub mod json;

use crate::domain::View;
use crate::error::{ErrorKind, Problem};

/// The messages and services of package `nudge.v1`, generated from `proto/`.
#[allow(missing_docs, clippy::all)]
pub mod proto {
    tonic::include_proto!("nudge.v1");

    /// The encoded descriptors of every message and service, for reflection.
    pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
}

/// The messages and the service of the Open Inference Protocol, package `inference`, generated from `proto/`.
#[allow(missing_docs, clippy::all)]
pub mod inference_proto {
    tonic::include_proto!("inference");
}

/// The largest gRPC message, either way, in bytes.
pub const MOST_MESSAGE_BYTES: usize = 4 << 20;

/// The largest description of an environment, in bytes as it is sent: a feature of the most bins fits, and reading it takes milliseconds.
pub const MOST_DESCRIPTION_BYTES: usize = 1 << 20;

/// The most transitions of a batch.
pub const MOST_BATCH_TRANSITIONS: usize = 10_000;

/// Returns an answer in a view if it fits into a message.
pub fn fitting<M: prost::Message>(answer: M, view: View) -> Result<M, Problem> {
    if fits(&answer) { Ok(answer) } else { Err(too_large(view)) }
}

/// Returns a message that describes an environment if it is within the limit of descriptions.
pub fn fitting_description<M: prost::Message>(message: M) -> Result<M, Problem> {
    if message.encoded_len() <= MOST_DESCRIPTION_BYTES {
        return Ok(message);
    }
    let message = format!("the description is larger than {} MiB", MOST_DESCRIPTION_BYTES >> 20);
    Err(Problem::new(ErrorKind::TooLarge, "BODY_TOO_LARGE", message).with("limit_bytes", MOST_DESCRIPTION_BYTES))
}

/// Returns a message that holds the file of a network if it is within the limit of a message; if it is not, says which path of REST takes it.
pub fn fitting_file<M: prost::Message>(message: M, path: &str) -> Result<M, Problem> {
    if fits(&message) {
        return Ok(message);
    }
    let message =
        format!("the file is larger than a message, which has at most {MOST_MESSAGE_BYTES} bytes: use REST, {path}");
    Err(Problem::new(ErrorKind::TooLarge, "FILE_TOO_LARGE", message).with("limit_bytes", MOST_MESSAGE_BYTES))
}

fn fits(message: &impl prost::Message) -> bool {
    message.encoded_len() <= MOST_MESSAGE_BYTES
}

/// Says that an answer does not fit into a message, and what to ask for instead.
pub fn too_large(view: View) -> Problem {
    let instead = match view {
        View::Full => "ask for view figures, or for fewer states",
        View::Figures => "ask for view verdict, or for fewer states",
        View::Verdict => "ask for fewer states",
    };
    let view = view.as_str();
    let message =
        format!("the answer in view {view} is larger than the limit of {MOST_MESSAGE_BYTES} bytes: {instead}");
    Problem::new(ErrorKind::TooLarge, "ANSWER_TOO_LARGE", message).with("limit_bytes", MOST_MESSAGE_BYTES)
}
