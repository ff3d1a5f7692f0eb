//! The grain of a question: which coordinates of a state are kept. States that agree in all of them
//! are one coarse state.

use super::{Coordinate, Coordinates, StateKey};
use crate::error::Fault;

/// Some coordinates of states, derived ones among them, in the order in which they were named.
#[derive(Debug, Clone, PartialEq)]
pub struct Grain {
    kept: Vec<Coordinate>,
    left_out: Vec<Coordinate>,
}

/// A coarse state: its bins in mixed radix, the coordinate named first most significant. Below the
/// product of their numbers of bins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CoarseKey(pub u128);

impl Grain {
    /// Returns the grain that keeps coordinates of these names, or every fault by its pointer,
    /// `/features/1`.
    pub fn checked<S: AsRef<str>>(
        names: &[S],
        coordinates: &Coordinates,
    ) -> Result<Self, Vec<Fault>> {
        let (mut kept, mut faults) = (Vec::<Coordinate>::new(), Vec::new());
        for (i, name) in names.iter().map(AsRef::as_ref).enumerate() {
            let is_twice = kept.iter().any(|one| one.name().as_str() == name);
            let detail = match coordinates.find(name) {
                Some(found) if !is_twice => {
                    kept.push(found.clone());
                    continue;
                }
                Some(_) => format!("{name:?} is used twice"),
                None => coordinates.unknown(name, faults.len()),
            };
            faults.push(Fault::new(format!("/features/{i}"), detail));
        }

        let size = |size: u128, one: &Coordinate| size.checked_mul(u128::from(one.kind().bins()));
        if kept.iter().try_fold(1, size).is_none() {
            let detail = "more than 2^128 coarse states: keep fewer features";
            faults.push(Fault::new("/features", detail));
        }
        if !faults.is_empty() {
            return Err(faults);
        }

        let is_left_out = |one: &&Coordinate| kept.iter().all(|kept| kept.place() != one.place());
        let left_out = coordinates.features().iter().filter(is_left_out).cloned();
        let left_out = left_out.collect();
        Ok(Self { kept, left_out })
    }

    /// Returns what is kept.
    pub fn kept(&self) -> &[Coordinate] {
        &self.kept
    }

    /// Returns the features of the state that are not kept by themselves, in order.
    pub fn left_out(&self) -> &[Coordinate] {
        &self.left_out
    }

    /// Returns the coarse state that a state belongs to.
    #[inline]
    pub fn coarse(&self, key: &StateKey) -> CoarseKey {
        let digit = |number: u128, one: &Coordinate| {
            number * u128::from(one.kind().bins()) + u128::from(one.bin(key))
        };
        CoarseKey(self.kept.iter().fold(0, digit))
    }

    /// Returns the bin of each coordinate that is kept.
    pub fn bins(&self, CoarseKey(mut number): CoarseKey) -> Vec<u32> {
        let mut bins: Vec<u32> = self.kept.iter().map(|one| one.kind().bins()).collect();
        for bin in bins.iter_mut().rev() {
            let radix = u128::from(*bin);
            *bin = (number % radix) as u32;
            number /= radix;
        }
        bins
    }
}
