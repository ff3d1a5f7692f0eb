//! Coordinates of a state that questions name: its features, and the derived ones.

use std::collections::HashMap;

use super::near::hint_after;
use super::{DerivedFeature, DerivedFeatures, Feature, FeatureKind, Label, Name, Schema, StateKey};

/// One named coordinate of a state: a feature of it, or a derived one. Cloning is cheap.
#[derive(Debug, Clone, PartialEq)]
pub struct Coordinate {
    at: usize,
    source: Source,
}

#[derive(Debug, Clone, PartialEq)]
enum Source {
    /// The feature at `at`.
    State(Feature),
    Derived(DerivedFeature),
}

/// Every coordinate of the states of one environment, by name.
#[derive(Debug, Clone)]
pub struct Coordinates {
    all: Vec<Coordinate>,
    by_name: HashMap<Name, usize>,
    features: usize,
}

impl Coordinate {
    /// Returns its name.
    pub fn name(&self) -> &Name {
        match &self.source {
            Source::State(feature) => &feature.name,
            Source::Derived(feature) => &feature.name,
        }
    }

    /// Returns whether it is a derived one.
    pub fn is_derived(&self) -> bool {
        matches!(self.source, Source::Derived(_))
    }

    /// Returns the unit of its values, for people; derived ones have none.
    pub fn unit(&self) -> Option<&Label> {
        match &self.source {
            Source::State(feature) => feature.unit.as_ref(),
            Source::Derived(_) => None,
        }
    }

    /// Returns its alphabet.
    pub fn kind(&self) -> &FeatureKind {
        match &self.source {
            Source::State(feature) => &feature.kind,
            Source::Derived(feature) => &feature.kind,
        }
    }

    /// Returns its bin in a state.
    #[inline]
    pub fn bin(&self, key: &StateKey) -> u32 {
        match &self.source {
            Source::State(_) => key.bins()[self.at],
            Source::Derived(feature) => feature.bin(key),
        }
    }

    /// Returns its place among the coordinates: features of the state in order, then derived ones.
    pub(super) fn place(&self) -> usize {
        self.at
    }
}

impl Coordinates {
    /// Returns those of an environment.
    pub fn new(schema: &Schema, derived: &DerivedFeatures) -> Self {
        let features = schema.state().iter().cloned().map(Source::State);
        let derived = derived.iter().cloned().map(Source::Derived);
        let all: Vec<Coordinate> = features
            .chain(derived)
            .enumerate()
            .map(|(at, source)| Coordinate { at, source })
            .collect();

        let names = all.iter().map(|one| one.name().clone());
        let by_name = names.zip(0..).collect();
        Self {
            all,
            by_name,
            features: schema.state().len(),
        }
    }

    /// Returns all of them, features of the state first.
    pub fn all(&self) -> &[Coordinate] {
        &self.all
    }

    /// Returns the features of the state.
    pub fn features(&self) -> &[Coordinate] {
        &self.all[..self.features]
    }

    /// Returns the coordinate of that name.
    pub fn find(&self, name: &str) -> Option<&Coordinate> {
        self.by_name.get(name).map(|at| &self.all[*at])
    }

    /// Says that there is none of that name, behind so many other faults.
    pub(super) fn unknown(&self, name: &str, faults: usize) -> String {
        let known: Vec<&str> = self.all.iter().map(|one| one.name().as_str()).collect();
        format!(
            "unknown feature {name:?}{}",
            hint_after(faults, name, &known)
        )
    }
}
