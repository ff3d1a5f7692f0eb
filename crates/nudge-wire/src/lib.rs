//! The wire: generated proto types, and their conversions to and from the domain, in one place.
//!
//! Requests become drafts, which the domain checks; answers become proto messages, and JSON is made
//! of those, so that the faces cannot disagree.
//!
//! # The map, in reading order
//!
//! * [`proto`], [`inference_proto`]: what is generated from `proto/`: messages, and with the feature
//!   `grpc` the clients and servers of their services.
//! * [`grpc`]: between the messages of `nudge.v1` and the domain.
//! * `json`, with the feature `rest`: between JSON and the domain, with the schemas of OpenAPI.
//! * [`inference`]: the Open Inference Protocol, whose JSON is of the feature `rest` too.
//! * [`page`], [`parts`], [`fitting`]: what fits into a message.
//!
//! Both features are there by default. Nothing here listens or connects.
//!
//! # A batch, and its receipt
//!
//! ```
//! use nudge_core::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
//! use nudge_core::domain::{Schema, SchemaDraft};
//! use nudge_wire::{grpc, proto};
//!
//! let feature = |name: &str| FeatureDraft {
//!     name: name.into(),
//!     kinds: vec![KindDraft::Categorical(vec!["left".into(), "right".into()])],
//!     ..Default::default()
//! };
//! let agent = |name: &str| AgentDraft { name: name.into(), action: vec![feature("turn")], ..AgentDraft::default() };
//! let draft = SchemaDraft { state: vec![feature("lane")], agents: vec![agent("robot"), agent("human")], ..SchemaDraft::default() };
//! let schema = Schema::try_from(&draft).expect("a description");
//!
//! let transition = proto::Transition { state: vec![0.0], actions: vec![1.0, 0.0], ..Default::default() };
//! let rows = proto::Rows { transitions: vec![transition] };
//! let message = proto::Batch {
//!     sequence: 1,
//!     transitions: Some(proto::batch::Transitions::Rows(rows)),
//!     ..Default::default()
//! };
//! let batch = grpc::batch(&schema, message).expect("a batch");
//! assert_eq!(batch.records.len, 1);
//! ```

pub mod grpc;
pub mod inference;
#[cfg(feature = "rest")]
pub mod json;

use nudge_core::domain::View;
use nudge_core::error::{ErrorKind, Problem};

/// The messages and services of package `nudge.v1`, generated from `proto/`. Its comments are not
/// written for rustdoc: brackets in them are no links.
#[allow(missing_docs, clippy::all, rustdoc::broken_intra_doc_links)]
pub mod proto {
    include!(concat!(env!("OUT_DIR"), "/nudge.v1.rs"));

    /// The encoded descriptors of every message and service, for reflection.
    pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
}

/// The messages and the service of the Open Inference Protocol, package `inference`, generated from
/// `proto/`.
#[allow(missing_docs, clippy::all, rustdoc::broken_intra_doc_links)]
pub mod inference_proto {
    include!(concat!(env!("OUT_DIR"), "/inference.rs"));
}

/// Returns the text, or `None` where proto says "absent" by an empty one.
fn present(text: String) -> Option<String> {
    Some(text).filter(|text| !text.is_empty())
}

/// The largest gRPC message, either way, in bytes.
pub const MOST_MESSAGE_BYTES: usize = 4 << 20;

/// The most transitions of a batch.
pub const MOST_BATCH_TRANSITIONS: usize = 10_000;

/// Returns the path of every method of gRPC: `/nudge.v1.IngestService/Write`.
pub fn grpc_methods() -> Vec<String> {
    let described: prost_types::FileDescriptorSet =
        prost::Message::decode(proto::DESCRIPTORS).unwrap_or_default();
    let services = described
        .file
        .iter()
        .flat_map(|file| file.service.iter().map(|service| (file.package(), service)));
    let methods = services.flat_map(|(package, service)| {
        service
            .method
            .iter()
            .map(move |method| format!("/{package}.{}/{}", service.name(), method.name()))
    });

    methods.collect()
}

/// Returns an answer in a view if it fits into a message.
pub fn fitting<M: prost::Message>(answer: M, view: View) -> Result<M, Problem> {
    if fits(&answer) {
        Ok(answer)
    } else {
        Err(too_large(view))
    }
}

/// Returns a message that holds the file of a network if it is within the limit of a message; if it
/// is not, says which path of REST takes it.
pub fn fitting_file<M: prost::Message>(message: M, path: &str) -> Result<M, Problem> {
    if fits(&message) {
        return Ok(message);
    }
    let message = format!(
        "the file is larger than a message, which has at most {MOST_MESSAGE_BYTES} bytes: use REST, {path}"
    );
    Err(Problem::new(ErrorKind::TooLarge, "FILE_TOO_LARGE", message)
        .with("limit_bytes", MOST_MESSAGE_BYTES))
}

fn fits(message: &impl prost::Message) -> bool {
    message.encoded_len() <= MOST_MESSAGE_BYTES
}

/// Returns the size of a message in bytes.
pub fn bytes(message: &impl prost::Message) -> usize {
    message.encoded_len()
}

/// The most bytes of the items of a page: a part of its message is for what stands beside them.
const MOST_PAGE_BYTES: usize = MOST_MESSAGE_BYTES - (64 << 10);

/// Bytes of an item beside itself: its field and its length.
const ITEM: usize = 8;

/// Returns whether an item can be on any page of a message.
pub fn fits_on_a_page(item: &impl prost::Message) -> bool {
    item.encoded_len() + ITEM <= MOST_PAGE_BYTES
}

/// The beginning of a list.
#[derive(Debug, PartialEq)]
pub struct Page<T> {
    /// One item at least, where there is any.
    pub items: Vec<T>,
    /// Whether the list goes on.
    pub has_more: bool,
}

/// Returns the first items of a list, at most so many and no more than fit into a message of which
/// some bytes are spent already. The first is on the page however large it is, for else no page
/// would come after it.
pub fn page<T, M: prost::Message>(
    items: impl IntoIterator<Item = T>,
    most: usize,
    spent: usize,
    message: impl Fn(&T) -> M,
) -> Page<T> {
    page_of(items, most, spent, |item| message(item).encoded_len())
}

/// Returns the same by the bytes of each item, where they are known without making it.
pub fn page_of<T>(
    items: impl IntoIterator<Item = T>,
    most: usize,
    spent: usize,
    size: impl Fn(&T) -> usize,
) -> Page<T> {
    let (mut page, mut bytes) = (Vec::new(), spent);
    for item in items {
        bytes += size(&item) + ITEM;
        if page.len() == most || (bytes > MOST_PAGE_BYTES && !page.is_empty()) {
            return Page {
                items: page,
                has_more: true,
            };
        }
        page.push(item);
    }
    Page {
        items: page,
        has_more: false,
    }
}

/// Returns a list in parts, in order, each of which fits into a message; an item that does not is a
/// part of its own.
pub fn parts<M: prost::Message>(items: impl IntoIterator<Item = M>) -> Vec<Vec<M>> {
    let (mut parts, mut bytes) = (Vec::<Vec<M>>::new(), 0);
    for item in items {
        let size = item.encoded_len() + ITEM;
        bytes += size;
        match parts.last_mut() {
            Some(part) if bytes <= MOST_PAGE_BYTES => part.push(item),
            _ => {
                bytes = size;
                parts.push(vec![item]);
            }
        }
    }
    parts
}

/// Says that an answer does not fit into a message, and what to ask for instead.
pub fn too_large(view: View) -> Problem {
    let instead = match view {
        View::Full => "ask for view figures, or for fewer states",
        View::Figures => "ask for view verdict, or for fewer states",
        View::Verdict => "ask for fewer states",
    };

    let view = view.as_str();
    let message = format!(
        "the answer in view {view} is larger than the limit of {MOST_MESSAGE_BYTES} bytes: {instead}"
    );

    Problem::new(ErrorKind::TooLarge, "ANSWER_TOO_LARGE", message)
        .with("limit_bytes", MOST_MESSAGE_BYTES)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paged(items: &[usize], most: usize, spent: usize) -> (usize, bool) {
        let page = page(items.iter().copied(), most, spent, |bytes| {
            "x".repeat(*bytes)
        });
        assert_eq!(page.items, items[..page.items.len()]);
        (page.items.len(), page.has_more)
    }

    #[test]
    fn a_page_ends_at_its_size_or_at_its_bytes() {
        let quarter = MOST_PAGE_BYTES / 4 - 20;
        assert_eq!(paged(&[], 3, 0), (0, false));
        assert_eq!(paged(&[1; 3], 3, 0), (3, false));
        assert_eq!(paged(&[1; 4], 3, 0), (3, true));
        assert_eq!(paged(&[quarter; 4], 100, 0), (4, false));
        assert_eq!(paged(&[quarter; 5], 100, 0), (4, true));
        assert_eq!(paged(&[quarter; 5], 100, 2 * quarter), (2, true));
        assert_eq!(
            paged(&[5 * quarter, 1], 100, 0),
            (1, true),
            "one that fits nowhere has a page of its own"
        );
        assert_eq!(paged(&[1, 5 * quarter, 1], 100, 0), (1, true));
    }
}
