//! A network as a file: safetensors, with the names and the layout that PyTorch's `state_dict`
//! gives a list of modules.
//!
//! | tensor | shape |
//! |---|---|
//! | `members.0.trunk.weight`, `.bias` | `[width, inputs]`, `[width]` |
//! | `members.0.ego.weight`, `.bias` | `[R, width]`, `[R]` (joint) |
//! | `members.0.other.weight`, `.bias` | `[K, width]`, `[K]` (joint) |
//! | `members.0.interaction.weight`, `.bias` | `[R K, width]`, `[R K]` (joint; row i K + j is D_ij) |
//! | `members.0.influence.weight`, `.bias` | `[1, width]`, `[1]` (direct) |
//!
//! At a lag a joint network has the same in each of H strata, one for each letter of the other's own
//! action one step before (its absence the last, where it may be absent):
//!
//! | tensor | shape |
//! |---|---|
//! | `members.0.own.weight`, `.bias` | `[H, width]`, `[H]`; absent where H is 1 |
//! | `members.0.ego.weight`, `.bias` | `[H R, width]`, `[H R]` (row h R + i) |
//! | `members.0.other.weight`, `.bias` | `[H K, width]`, `[H K]` (row h K + j) |
//! | `members.0.interaction.weight`, `.bias` | `[R K, width]`, `[R K]` (one D for all strata), or `[H R K, width]`, `[H R K]` (row (h R + i) K + j) |
//!
//! What the numbers cannot say stands in the file's metadata, text by text: `format` (`nudge/1`; at
//! a lag `nudge/2`, which has `lag` too), `kind`, `ego`, `other`, `schema_hash`, `threshold` (nats),
//! `scales` (JSON: for each feature `null`, or the mean and the deviation that its value is
//! standardised by), `card` (of `stored_forms`; absent, empty or `{}` in files of other tools), and,
//! absent from files of earlier builds and of other tools, `seen` (JSON: for each feature the bins
//! that the states of the training had, as runs `[first, last]` in order).
//!
//! The card belongs to what the network says: a probability is made by its calibration. A file that
//! is imported brings it along.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt::Display;
use std::str::FromStr;

use ndarray::{Array1, Array2};
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};

use super::encoder::{Encoder, Scale};
use super::letters::Letters;
use super::member::{Interaction, Layer, Member, heads};
use super::seen::Seen;
use super::stored_forms;
use crate::domain::{Card, Environment, ModelKind, Pair, Schema, Training, is_same_threshold};
use crate::error::{Fault, Problem};

/// The largest file.
pub const MOST_BYTES: usize = 64 << 20;

/// The largest weight: sums of more would not be finite.
const LARGEST: f32 = 1e6;

const FORMAT: &str = "nudge/1";

/// That of a network at a lag, which builds that know of no lags must refuse.
const FORMAT_AT_LAG: &str = "nudge/2";

/// The names of the metadata that may be absent.
const SEEN: &str = "seen";
const CARD: &str = "card";
const LAG: &str = "lag";

/// The bytes of a header's size, of which a header is a multiple.
const SIZE: usize = size_of::<u64>();

/// What a file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Content {
    /// What it predicts.
    pub kind: ModelKind,
    /// Whose influence on whom.
    pub pair: Pair,
    /// The threshold it was trained for, in nats.
    pub threshold: f64,
    /// How states become inputs.
    pub encoder: Encoder,
    /// The members.
    pub members: Vec<Member>,
    /// The bins that it was trained on; `None` in a file that does not say.
    pub seen: Option<Seen>,
}

/// Writes a file; the card is JSON.
pub fn write_network(environment: &Environment, content: &Content, card: &str) -> Vec<u8> {
    let agent = |at: usize| environment.schema.agents()[at].name.to_string();
    let scales: Vec<Option<ScaleText>> = content
        .encoder
        .scales()
        .into_iter()
        .map(|scale| scale.map(write_scale))
        .collect();
    let scales = serde_json::to_string(&scales).expect("numbers are finite");

    let lag = content.pair.lag(&environment.schema);
    let format = if lag == 0 { FORMAT } else { FORMAT_AT_LAG };
    let metadata = [
        ("format", format.to_owned()),
        ("kind", content.kind.as_str().to_owned()),
        ("ego", agent(content.pair.ego)),
        ("other", agent(content.pair.other)),
        ("schema_hash", environment.schema.hash().to_string()),
        ("threshold", content.threshold.to_string()),
        ("scales", scales),
        (CARD, card.to_owned()),
    ];
    let mut metadata = BTreeMap::from(metadata);
    if let Some(seen) = &content.seen {
        metadata.insert(
            SEEN,
            serde_json::to_string(seen.runs()).expect("lists of numbers"),
        );
    }

    if lag > 0 {
        metadata.insert(LAG, lag.to_string());
    }

    let letters = Letters::of_pair(&environment.schema, &content.pair);
    let tensors: Vec<Tensor> = (0..)
        .zip(&content.members)
        .flat_map(|(at, member)| {
            let names = heads(content.kind, letters, Interaction::Shared);
            tensors(at, names, member)
        })
        .collect();
    let views = tensors.iter().map(|tensor| {
        let view = TensorView::new(Dtype::F32, tensor.shape.clone(), &tensor.bytes)
            .expect("as many bytes as the shape says");
        (tensor.name.as_str(), view)
    });
    let file = serialize(views, None).expect("names differ, and sizes fit");
    with_metadata(&file, &metadata)
}

/// Puts metadata at the head of a file that has none, in the order of their names: the library's
/// own differ in order from run to run.
fn with_metadata(file: &[u8], metadata: &BTreeMap<&str, String>) -> Vec<u8> {
    let (size, rest) = file
        .split_first_chunk::<SIZE>()
        .expect("a file begins with the size of its header");
    let (header, numbers) = rest.split_at(u64::from_le_bytes(*size) as usize);
    let tensors = header.strip_prefix(b"{").expect("a header is an object");

    let metadata = serde_json::to_string(metadata).expect("texts can always be written");
    let mut header = [
        format!("{{\"__metadata__\":{metadata},").as_bytes(),
        tensors,
    ]
    .concat();
    header.resize(header.len().next_multiple_of(SIZE), b' ');
    [&(header.len() as u64).to_le_bytes(), &header[..], numbers].concat()
}

/// How a scale stands in the metadata.
#[derive(Serialize, Deserialize)]
struct ScaleText {
    mean: f64,
    deviation: f64,
}

fn write_scale(scale: Scale) -> ScaleText {
    let Scale { mean, deviation } = scale;
    ScaleText { mean, deviation }
}

fn read_scales(text: &str) -> Option<Vec<Option<Scale>>> {
    let scale = |ScaleText { mean, deviation }| Scale { mean, deviation };
    let texts: Vec<Option<ScaleText>> = serde_json::from_str(text).ok()?;
    Some(texts.into_iter().map(|text| text.map(scale)).collect())
}

struct Tensor {
    name: String,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

fn tensors(at: usize, heads: Vec<(&'static str, usize)>, member: &Member) -> Vec<Tensor> {
    let names = heads.into_iter().map(|(name, _)| name);

    let layers = std::iter::once("trunk")
        .chain(names)
        .zip(std::iter::once(&member.trunk).chain(&member.heads));
    let both = |(name, layer): (&str, &Layer)| {
        let bytes = |numbers: &mut dyn Iterator<Item = &f32>| {
            numbers.flat_map(|number| number.to_le_bytes()).collect()
        };
        let (inputs, outputs) = layer.shape();
        let name = |part: &str| format!("members.{at}.{name}.{part}");
        [
            Tensor {
                name: name("weight"),
                shape: vec![outputs, inputs],
                bytes: bytes(&mut layer.weight.iter()),
            },
            Tensor {
                name: name("bias"),
                shape: vec![outputs],
                bytes: bytes(&mut layer.bias.iter()),
            },
        ]
    };
    layers.flat_map(both).collect()
}

/// Reads a file that belongs to an environment, or lists what is wrong with it.
pub fn read_network(environment: &Environment, bytes: &[u8]) -> Result<Content, Problem> {
    parse(environment, bytes).map_err(|faults| Problem::invalid("network", faults))
}

/// Reads a file that is brought from elsewhere, with the card that an export writes into it.
pub fn imported(
    environment: &Environment,
    bytes: &[u8],
) -> Result<(Content, Option<Card>), Problem> {
    let content = read_network(environment, bytes)?;
    let (_, header) = SafeTensors::read_metadata(bytes).expect("it was read before");
    let told = header
        .metadata()
        .as_ref()
        .and_then(|metadata| metadata.get(CARD));

    let card = told
        .filter(|text| !matches!(text.trim(), "" | "{}"))
        .map(|text| card_of(environment, &content, text));
    let card = card
        .transpose()
        .map_err(|detail| Problem::invalid("network", vec![fault(CARD, detail)]))?;
    Ok((content, card))
}

/// Reads a card, which has to be that of its network. The text is not repeated: it is long.
fn card_of(environment: &Environment, content: &Content, text: &str) -> Result<Card, String> {
    const WITHOUT: &str =
        "take it as an export wrote it, or leave it out to have the network calibrated here";
    let card =
        stored_forms::read_card(text).map_err(|why| format!("cannot be read: {why}; {WITHOUT}"))?;

    let width = content
        .members
        .first()
        .map_or(0, |member| member.trunk.shape().1);
    let network = (content.kind.as_str(), content.members.len(), width);
    let told = (
        card.training.kind.as_str(),
        card.training.members,
        card.training.width,
    );
    if told != network {
        return Err(format!(
            "is of a network {told:?}, expected {network:?} (kind, members, width); {WITHOUT}"
        ));
    }

    stored_forms::check_lag(&card, &environment.schema, &content.pair)
        .map_err(|why| format!("{why}; {WITHOUT}"))?;

    let fewest = if card.is_split_known() {
        card.training.members
    } else {
        0
    }
    .max(Training::FEWEST_FOLDS);
    if !(fewest..=Training::MOST_FOLDS).contains(&card.training.folds) {
        let (folds, most) = (card.training.folds, Training::MOST_FOLDS);
        return Err(format!(
            "got {folds} folds, expected {fewest} to {most}; {WITHOUT}"
        ));
    }

    if !is_same_threshold(card.threshold, content.threshold) {
        let (told, expected) = (card.threshold, content.threshold);
        return Err(format!(
            "is of a threshold of {told} nats, expected {expected}; {WITHOUT}"
        ));
    }
    Ok(card)
}

fn parse(environment: &Environment, bytes: &[u8]) -> Result<Content, Vec<Fault>> {
    let unreadable =
        |error: &dyn Display| vec![Fault::new("", format!("is no safetensors file: {error}"))];
    if bytes.len() > MOST_BYTES {
        return Err(vec![Fault::new(
            "",
            format!("got {} bytes, expected at most {MOST_BYTES}", bytes.len()),
        )]);
    }

    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|error| unreadable(&error))?;
    let tensors = SafeTensors::deserialize(bytes).map_err(|error| unreadable(&error))?;
    let metadata = Metadata(header.metadata().clone().unwrap_or_default());

    let CheckedMetadata {
        kind,
        pair,
        threshold,
        encoder,
        seen,
    } = metadata.checked(environment)?;

    let shapes = Shapes {
        tensors: &tensors,
        kind,
        pair: &pair,
        inputs: encoder.width(),
        environment,
    };
    Ok(Content {
        members: shapes.members()?,
        kind,
        pair,
        threshold,
        encoder,
        seen,
    })
}

/// What a file says beside its numbers.
struct Metadata(HashMap<String, String>);

/// The same, checked.
struct CheckedMetadata {
    kind: ModelKind,
    pair: Pair,
    threshold: f64,
    encoder: Encoder,
    seen: Option<Seen>,
}

impl Metadata {
    fn checked(&self, environment: &Environment) -> Result<CheckedMetadata, Vec<Fault>> {
        let schema = &environment.schema;
        let mut faults = Vec::new();
        let is_lagged = self.is_lagged(&mut faults);
        self.equal("schema_hash", &schema.hash().to_string(), &mut faults);
        let kind = self.parsed::<ModelKind>("kind", &mut faults);
        let pair = self.pair(schema, is_lagged, &mut faults);
        let threshold = self.threshold(&mut faults);
        let encoder = self.encoder(schema, &mut faults);
        let seen = self.seen(schema, &mut faults);

        match (kind, pair, threshold, encoder) {
            (Some(kind), Some(pair), Some(threshold), Some(encoder)) if faults.is_empty() => {
                Ok(CheckedMetadata {
                    kind,
                    pair,
                    threshold,
                    encoder,
                    seen,
                })
            }
            _ => Err(faults),
        }
    }

    /// Returns whether the format is that of a network at a lag.
    fn is_lagged(&self, faults: &mut Vec<Fault>) -> bool {
        match self.text("format", faults) {
            Some(FORMAT_AT_LAG) => return true,
            Some(FORMAT) | None => {}
            Some(text) => {
                let expected = format!("expected {FORMAT:?}, or at a lag {FORMAT_AT_LAG:?}");
                faults.push(fault("format", format!("got {text:?}, {expected}")));
            }
        }
        false
    }

    fn pair(&self, schema: &Schema, is_lagged: bool, faults: &mut Vec<Fault>) -> Option<Pair> {
        let (ego, other) = self.agents(schema, faults)?;
        let pair = Pair::new(ego, other, Vec::new());
        let told = self.0.get(LAG).map(String::as_str);
        let expected = match (is_lagged, told) {
            (false, None) => return Some(pair),
            (false, Some(_)) => format!("expected none in format {FORMAT:?}"),
            (true, told) => {
                let lag = told.and_then(|text| text.parse().ok());
                let found = lag
                    .filter(|lag| *lag > 0)
                    .and_then(|lag| pair.at_lag(schema, lag));
                if found.is_some() {
                    return found;
                }
                let other = &schema.agents()[other].name;
                format!("expected a lag above 0 that is declared for {other}")
            }
        };
        let told = told.map_or_else(|| "none".to_owned(), |text| format!("{text:?}"));
        faults.push(fault(LAG, format!("got {told}, {expected}")));
        None
    }

    fn agents(&self, schema: &Schema, faults: &mut Vec<Fault>) -> Option<(usize, usize)> {
        let mut agent = |name: &'static str| {
            let text = self.text(name, faults)?;
            let found = schema.agent(text);
            if found.is_none() {
                faults.push(fault(name, format!("unknown agent {text:?}")));
            }
            found
        };
        let pair = agent("ego").zip(agent("other"));

        if pair.is_some_and(|(ego, other)| ego == other) {
            faults.push(fault(
                "other",
                "is the ego too; expected another agent".into(),
            ));
            return None;
        }
        pair
    }

    fn threshold(&self, faults: &mut Vec<Fault>) -> Option<f64> {
        let threshold = self
            .text("threshold", faults)
            .and_then(|text| text.parse::<f64>().ok())
            .filter(|nats| nats.is_finite() && *nats >= 0.0);
        if threshold.is_none() {
            faults.push(fault(
                "threshold",
                "expected a number of nats, at least 0".into(),
            ));
        }
        threshold
    }

    fn encoder(&self, schema: &Schema, faults: &mut Vec<Fault>) -> Option<Encoder> {
        let scales = self.text("scales", faults).and_then(read_scales);
        let encoder = scales.and_then(|scales| Encoder::with_scales(schema, scales));
        if encoder.is_none() {
            let expected = "expected a JSON list with {\"mean\", \"deviation\"} for each feature that is a number, null for the others";
            faults.push(fault("scales", expected.into()));
        }
        encoder
    }

    fn seen(&self, schema: &Schema, faults: &mut Vec<Fault>) -> Option<Seen> {
        let runs = serde_json::from_str(self.0.get(SEEN)?).ok();
        let seen = runs.and_then(|runs| Seen::from_runs(schema, runs));
        if seen.is_none() {
            let expected = "expected a JSON list with a list of runs [first, last] of bins for each feature, in order";
            faults.push(fault(SEEN, expected.into()));
        }
        seen
    }

    fn text(&self, name: &str, faults: &mut Vec<Fault>) -> Option<&str> {
        let text = self.0.get(name).map(String::as_str);
        if text.is_none() {
            faults.push(fault(name, "is missing from the file's metadata".into()));
        }
        text
    }

    fn equal(&self, name: &str, expected: &str, faults: &mut Vec<Fault>) {
        if let Some(text) = self.text(name, faults)
            && text != expected
        {
            faults.push(fault(name, format!("got {text:?}, expected {expected:?}")));
        }
    }

    fn parsed<T: FromStr<Err = String>>(&self, name: &str, faults: &mut Vec<Fault>) -> Option<T> {
        let text = self.text(name, faults)?;
        text.parse()
            .map_err(|detail| faults.push(fault(name, detail)))
            .ok()
    }
}

fn fault(name: &str, detail: String) -> Fault {
    Fault::new(format!("/metadata/{name}"), detail)
}

/// What the tensors of a file must look like.
struct Shapes<'a> {
    tensors: &'a SafeTensors<'a>,
    kind: ModelKind,
    pair: &'a Pair,
    inputs: usize,
    environment: &'a Environment,
}

impl Shapes<'_> {
    fn members(&self) -> Result<Vec<Member>, Vec<Fault>> {
        let most = crate::domain::Training::MOST_MEMBERS;
        let members = (0..=most)
            .take_while(|at| {
                self.tensors
                    .tensor(&format!("members.{at}.trunk.weight"))
                    .is_ok()
            })
            .count();
        if !(1..=most).contains(&members) {
            return Err(vec![Fault::new(
                "/members.0.trunk.weight",
                format!("got {members} members, expected 1 to {most}"),
            )]);
        }

        let mut faults = Vec::new();
        let found: Vec<Member> = (0..members)
            .filter_map(|at| self.member(at, &mut faults))
            .collect();

        let expected = self.expected(members);
        let named = self
            .tensors
            .names()
            .into_iter()
            .filter(|name| !expected.contains(*name));
        faults.extend(
            named.map(|name| Fault::new(format!("/{name}"), "is no tensor of such a network")),
        );

        if faults.is_empty() {
            Ok(found)
        } else {
            Err(faults)
        }
    }

    /// Returns the heads of a member: by how many outputs its interaction has, strata share it.
    fn heads(&self, at: usize) -> Vec<(&'static str, usize)> {
        let letters = Letters::of_pair(&self.environment.schema, self.pair);
        let shared = letters.actions.rows * letters.actions.columns;
        let name = format!("members.{at}.interaction.bias");
        let interaction = match self.tensors.tensor(&name) {
            Ok(bias) if bias.shape() == [shared as usize] => Interaction::Shared,
            _ => Interaction::ByStratum,
        };
        heads(self.kind, letters, interaction)
    }

    /// Returns the names of all tensors of so many members.
    fn expected(&self, members: usize) -> HashSet<String> {
        let layers: Vec<&str> = std::iter::once("trunk")
            .chain(self.heads(0).into_iter().map(|(head, _)| head))
            .collect();
        let of_layer = |at: usize, layer: &str| {
            ["weight", "bias"].map(|part| format!("members.{at}.{layer}.{part}"))
        };
        (0..members)
            .flat_map(|at| layers.iter().flat_map(move |layer| of_layer(at, layer)))
            .collect()
    }

    fn member(&self, at: usize, faults: &mut Vec<Fault>) -> Option<Member> {
        let width = self
            .tensors
            .tensor(&format!("members.{at}.trunk.weight"))
            .ok()?
            .shape()
            .first()
            .copied()
            .unwrap_or(0);
        if !(1..=Training::MOST_WIDTH).contains(&width) {
            let expected = Training::MOST_WIDTH;
            faults.push(Fault::new(
                format!("/members.{at}.trunk.weight"),
                format!("got {width} units, expected 1 to {expected}"),
            ));
            return None;
        }

        let trunk = self.layer(at, "trunk", [width, self.inputs], faults);
        let heads: Vec<Option<Layer>> = self
            .heads(at)
            .into_iter()
            .map(|(name, outputs)| self.layer(at, name, [outputs, width], faults))
            .collect();
        Some(Member {
            trunk: trunk?,
            heads: heads.into_iter().collect::<Option<_>>()?,
        })
    }

    fn layer(
        &self,
        at: usize,
        name: &str,
        [outputs, inputs]: [usize; 2],
        faults: &mut Vec<Fault>,
    ) -> Option<Layer> {
        let mut numbers = |part: &str, shape: &[usize]| {
            let name = format!("members.{at}.{name}.{part}");
            self.numbers(&name, shape)
                .map_err(|detail| faults.push(Fault::new(format!("/{name}"), detail)))
                .ok()
        };

        let weight = numbers("weight", &[outputs, inputs]);
        let bias = numbers("bias", &[outputs]);
        let weight = Array2::from_shape_vec((outputs, inputs), weight?).ok()?;
        Some(Layer {
            weight,
            bias: Array1::from_vec(bias?),
        })
    }

    fn numbers(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, String> {
        let tensor = self
            .tensors
            .tensor(name)
            .map_err(|_| "is missing".to_owned())?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            return Err(format!(
                "got {:?} {:?}, expected F32 {shape:?}",
                tensor.dtype(),
                tensor.shape()
            ));
        }

        let numbers: Vec<f32> = tensor
            .data()
            .as_chunks::<4>()
            .0
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect();
        match numbers
            .iter()
            .find(|number| number.is_nan() || number.abs() > LARGEST)
        {
            Some(number) => Err(format!(
                "has the number {number}, expected none beyond {LARGEST}"
            )),
            None => Ok(numbers),
        }
    }
}
