//! A tensor as it was sent, and the states in its rows.

use bytes::Bytes;
use nudge_core::domain::{Feature, Schema, StateKey};
use nudge_core::error::Fault;

/// The type of every tensor, in and out.
pub const DATATYPE: &str = "FP32";

/// The most rows of one request.
pub const MOST_ROWS: usize = 100_000;

/// Faults of values that are told one by one: on gRPC they travel in headers, which clients limit
/// to a few kilobytes.
const MOST_TOLD: usize = 10;

const VALUE_BYTES: usize = size_of::<f32>();

/// A tensor as it was sent.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Its name.
    pub name: String,
    /// The type of its values.
    pub datatype: String,
    /// Its extent in each dimension.
    pub shape: Vec<i64>,
    /// What it holds.
    pub values: Values,
}

/// What a tensor holds, row by row.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Numbers, and how many stood in each row where the rows were lists of their own.
    Numbers(Vec<f32>, Option<usize>),
    /// Little-endian bytes, whatever they are of.
    Raw(Bytes),
    /// Nothing that can be read: what it is instead, as a fault of the tensor.
    Unreadable(Fault),
}

impl Values {
    /// Returns how many values there are, read or not.
    pub fn len(&self) -> usize {
        match self {
            Self::Numbers(numbers, _) => numbers.len(),
            Self::Raw(bytes) => bytes.len() / VALUE_BYTES,
            Self::Unreadable(_) => 0,
        }
    }

    /// Returns whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Tensor {
    /// Returns the state of each row, or what is wrong with the tensor.
    pub(super) fn states(&self, schema: &Schema) -> Result<Vec<StateKey>, Vec<Fault>> {
        let rows = self.checked(schema).map_err(|fault| vec![fault])?;
        match &self.values {
            Values::Numbers(numbers, _) => keys(schema, rows, numbers.iter().copied()),
            Values::Raw(bytes) => {
                let (values, _) = bytes.as_chunks::<VALUE_BYTES>();
                keys(
                    schema,
                    rows,
                    values.iter().map(|value| f32::from_le_bytes(*value)),
                )
            }
            Values::Unreadable(fault) => Err(vec![fault.clone()]),
        }
    }

    /// Returns the number of rows, once type, shape and length fit together.
    fn checked(&self, schema: &Schema) -> Result<usize, Fault> {
        if self.datatype != DATATYPE {
            return Err(Fault::new(
                "/datatype",
                format!("got {:?}, expected {DATATYPE}", self.datatype),
            ));
        }

        if let Values::Unreadable(fault) = &self.values {
            return Err(fault.clone());
        }

        let features = schema.state();
        let rows = match self.shape[..] {
            [rows, width] if usize::try_from(width) == Ok(features.len()) => {
                usize::try_from(rows).ok()
            }
            _ => {
                return Err(Fault::new(
                    "/shape",
                    format!("got {:?}, expected {}", self.shape, shape(features)),
                ));
            }
        };

        let Some(rows) = rows.filter(|rows| (1..=MOST_ROWS).contains(rows)) else {
            return Err(Fault::new(
                "/shape/0",
                format!("got {}, expected 1 to {MOST_ROWS} rows", self.shape[0]),
            ));
        };

        self.fits(rows, features.len()).map(|()| rows)
    }

    /// Checks that there are as many values as the shape says.
    fn fits(&self, rows: usize, width: usize) -> Result<(), Fault> {
        let expected = rows * width;
        match &self.values {
            Values::Numbers(_, Some(found)) if *found != width => Err(Fault::new(
                "/data/0",
                format!("got {found} values in a row, expected {width}"),
            )),
            Values::Numbers(numbers, _) if numbers.len() != expected => {
                let detail = format!(
                    "got {} values, expected {rows} x {width} = {expected}",
                    numbers.len()
                );
                Err(Fault::new("/data", detail))
            }
            Values::Raw(bytes) if bytes.len() != expected * VALUE_BYTES => {
                let (found, bytes) = (bytes.len(), expected * VALUE_BYTES);
                let detail = format!(
                    "got {found} bytes, expected {rows} x {width} x {VALUE_BYTES} = {bytes}"
                );
                Err(Fault::new("/data", detail))
            }
            _ => Ok(()),
        }
    }
}

/// Says which shape is expected, and of what.
fn shape(features: &[Feature]) -> String {
    let names: Vec<&str> = features
        .iter()
        .map(|feature| feature.name.as_str())
        .collect();
    format!("[rows, {}]: {}", features.len(), names.join(", "))
}

fn keys(
    schema: &Schema,
    rows: usize,
    mut values: impl Iterator<Item = f32>,
) -> Result<Vec<StateKey>, Vec<Fault>> {
    let mut row = vec![0.0; schema.state().len()];
    let mut keys = Vec::with_capacity(rows);
    let (mut faults, mut untold) = (Vec::new(), 0);
    for i in 0..rows {
        row.iter_mut()
            .zip(&mut values)
            .for_each(|(place, value)| *place = value);
        match schema.key_of_values(&row) {
            Ok(key) => keys.push(key),
            Err(found) => {
                let kept = found.len().min(MOST_TOLD - faults.len());
                untold += found.len() - kept;
                faults.extend(
                    found
                        .into_iter()
                        .take(kept)
                        .map(|fault| fault.under(&format!("/data/{i}"))),
                );
            }
        }
    }

    if faults.is_empty() {
        return Ok(keys);
    }

    if untold > 0 {
        faults.push(Fault::new(
            "/data",
            format!("{untold} more values are wrong"),
        ));
    }

    Err(faults)
}
