//! The wire: generated proto types, and their conversions to and from the domain, in one place.
//!
//! Requests become drafts, which the domain checks; answers become proto messages, and JSON is made of those, so that the faces cannot disagree.

pub mod grpc;
pub mod json;

/// The messages and services of package `nudge.v1`, generated from `proto/`.
#[allow(missing_docs, clippy::all)]
pub mod proto {
    tonic::include_proto!("nudge.v1");

    /// The encoded descriptors of every message and service, for reflection.
    pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
}

/// The largest gRPC message, either way, in bytes.
pub const MOST_MESSAGE_BYTES: usize = 4 << 20;

/// The most transitions of a batch.
pub const MOST_BATCH_TRANSITIONS: usize = 10_000;
