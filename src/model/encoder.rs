//! Feature encoding, from a state to the numbers that a network takes: one-hot, cyclic,
//! standardised.
//!
//! Only bins are counted, so only bins can be learned from: a value becomes its bin first, here as
//! everywhere, and a bin stands for one number.
//!
//! | feature | inputs |
//! |---|---|
//! | categorical | one-hot: one a label, 1 for the state's, 0 for the others |
//! | circular | sine and cosine of the sector's centre |
//! | integer | its value, standardised |
//! | continuous | the middle of its bin, standardised |
//!
//! Mean and standard deviation are those of the states that a network was trained on, by how often
//! they were seen.

use std::f64::consts::TAU;

use ndarray::{Array2, ArrayViewMut1, Axis};

use crate::domain::{Feature, FeatureKind, Schema, StateKey};

/// The most numbers that a state may become.
pub const MOST_INPUTS: usize = 4_096;

/// How the numbers of a feature are moved and scaled; absent where a feature needs neither.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// What is taken away.
    pub mean: f64,
    /// What the rest is divided by, above 0.
    pub deviation: f64,
}

/// Encodes the states of one schema.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoder {
    features: Vec<Encoded>,
    width: usize,
}

#[derive(Debug, Clone, PartialEq)]
struct Encoded {
    kind: FeatureKind,
    scale: Option<Scale>,
    /// Where its inputs begin.
    from: usize,
}

impl Encoder {
    /// Makes the encoder of states that were seen so often.
    pub fn fitted<'a>(
        schema: &Schema,
        seen: impl Iterator<Item = (&'a StateKey, f64)> + Clone,
    ) -> Self {
        let scale = |(at, feature): (usize, &Feature)| {
            is_number(&feature.kind).then(|| {
                Scale::standardising(
                    seen.clone()
                        .map(|(key, times)| (representative(&feature.kind, key.bins()[at]), times)),
                )
            })
        };
        Self::new(
            schema,
            schema.state().iter().enumerate().map(scale).collect(),
        )
    }

    /// Makes an encoder with these scales, one a feature, which its numbers have and nothing else
    /// has; `None` if they do not fit.
    pub fn with_scales(schema: &Schema, scales: Vec<Option<Scale>>) -> Option<Self> {
        let sound = |scale: &Scale| {
            scale.mean.is_finite() && scale.deviation.is_finite() && scale.deviation > 0.0
        };
        let fits = |(feature, scale): (&Feature, &Option<Scale>)| match scale {
            Some(scale) => is_number(&feature.kind) && sound(scale),
            None => !is_number(&feature.kind),
        };

        let features = schema.state();
        let all = scales.len() == features.len() && features.iter().zip(&scales).all(fits);
        all.then(|| Self::new(schema, scales))
    }

    fn new(schema: &Schema, scales: Vec<Option<Scale>>) -> Self {
        let mut width = 0;
        let encoded = |(feature, scale): (&Feature, Option<Scale>)| {
            let from = width;
            width += inputs(&feature.kind);
            Encoded {
                kind: feature.kind.clone(),
                scale,
                from,
            }
        };
        let features = schema.state().iter().zip(scales).map(encoded).collect();
        Self { features, width }
    }

    /// Returns how many numbers a state becomes.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the scale of each feature.
    pub fn scales(&self) -> Vec<Option<Scale>> {
        self.features.iter().map(|feature| feature.scale).collect()
    }

    /// Encodes states: `[states, width]`.
    pub fn encode<'a>(&self, states: impl ExactSizeIterator<Item = &'a StateKey>) -> Array2<f32> {
        let mut encoded = Array2::zeros((states.len(), self.width));
        encoded
            .axis_iter_mut(Axis(0))
            .zip(states)
            .for_each(|(row, key)| self.encode_one(key, row));
        encoded
    }

    fn encode_one(&self, key: &StateKey, mut row: ArrayViewMut1<'_, f32>) {
        for (feature, bin) in self.features.iter().zip(key.bins()) {
            let from = feature.from;
            match &feature.kind {
                FeatureKind::Categorical(_) => row[from + *bin as usize] = 1.0,
                FeatureKind::Circular(bins, _) => {
                    let (sine, cosine) = (TAU * f64::from(*bin) / f64::from(*bins)).sin_cos();
                    row[from] = sine as f32;
                    row[from + 1] = cosine as f32;
                }
                kind => {
                    row[from] = feature
                        .scale
                        .map_or(0.0, |scale| scale.apply(representative(kind, *bin)))
                        as f32
                }
            }
        }
    }
}

/// Returns how many numbers a state of a schema becomes.
pub fn width(schema: &Schema) -> usize {
    schema
        .state()
        .iter()
        .map(|feature| inputs(&feature.kind))
        .sum()
}

fn inputs(kind: &FeatureKind) -> usize {
    match kind {
        FeatureKind::Categorical(labels) => labels.len(),
        FeatureKind::Circular(..) => 2,
        FeatureKind::Integer(..) | FeatureKind::Continuous(_) => 1,
    }
}

fn is_number(kind: &FeatureKind) -> bool {
    matches!(kind, FeatureKind::Integer(..) | FeatureKind::Continuous(_))
}

/// Returns the number that a bin stands for: a whole number itself; of two edges their middle;
/// beyond the outermost edge as far as to the middle of the bin before it.
fn representative(kind: &FeatureKind, bin: u32) -> f64 {
    match kind {
        FeatureKind::Integer(min, _) => f64::from(*min) + f64::from(bin),
        FeatureKind::Continuous(edges) => {
            let edge = |at: usize| f64::from(edges[at]);
            match (bin as usize, edges.len()) {
                // One bin, or two: any numbers do, once they are standardised.
                (bin, 0 | 1) => bin as f64,
                (0, _) => edge(0) - 0.5 * (edge(1) - edge(0)),
                (bin, last) if bin == last => {
                    edge(last - 1) + 0.5 * (edge(last - 1) - edge(last - 2))
                }
                (bin, _) => 0.5 * (edge(bin - 1) + edge(bin)),
            }
        }
        FeatureKind::Circular(..) | FeatureKind::Categorical(_) => f64::from(bin),
    }
}

impl Scale {
    /// Standardises numbers that were seen so often. Where all are the same, nothing but their mean
    /// is taken away.
    fn standardising(seen: impl Iterator<Item = (f64, f64)> + Clone) -> Self {
        let times: f64 = seen.clone().map(|(_, times)| times).sum();
        if times == 0.0 {
            return Self {
                mean: 0.0,
                deviation: 1.0,
            };
        }
        let mean = seen.clone().map(|(x, times)| x * times).sum::<f64>() / times;
        let variance = seen
            .map(|(x, times)| (x - mean).powi(2) * times)
            .sum::<f64>()
            / times;
        let deviation = if variance > 0.0 { variance.sqrt() } else { 1.0 };
        Self { mean, deviation }
    }

    /// Standardises a number. Bins far from all that was seen are as far as can be.
    fn apply(self, x: f64) -> f64 {
        const FARTHEST: f64 = 1e3;
        ((x - self.mean) / self.deviation).clamp(-FARTHEST, FARTHEST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

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
            feature(
                "held",
                KindDraft::Categorical(["nothing", "dish"].map(Into::into).to_vec()),
            ),
            feature("bearing", KindDraft::Circular(4, None)),
            feature("lane", KindDraft::Integer(3, 9)),
            feature("distance", KindDraft::Continuous(vec![1.0, 2.0, 4.0])),
        ];
        Schema::try_from(&SchemaDraft {
            state,
            agents: vec![agent("robot"), agent("human")],
            ..SchemaDraft::default()
        })
        .expect("valid")
    }

    #[test]
    fn every_kind_of_feature_has_its_inputs() {
        let schema = schema();
        let keys = [StateKey::new(&[1, 1, 0, 0]), StateKey::new(&[0, 0, 6, 3])];
        let encoder = Encoder::fitted(&schema, keys.iter().map(|key| (key, 1.0)));
        assert_eq!((encoder.width(), width(&schema)), (6, 6));
        let encoded = encoder.encode(keys.iter());
        let expected = [
            [0.0, 1.0, 1.0, 0.0, -1.0, -1.0],
            [1.0, 0.0, 0.0, 1.0, 1.0, 1.0],
        ];
        for (row, expected) in encoded.rows().into_iter().zip(expected) {
            row.iter().zip(expected).for_each(|(found, expected)| {
                assert!((found - expected).abs() < 1e-6, "{encoded}")
            });
        }
    }

    #[test]
    fn bins_stand_for_their_middles() {
        let kind = FeatureKind::Continuous([1.0, 2.0, 4.0].into());
        assert_eq!(
            [0, 1, 2, 3].map(|bin| representative(&kind, bin)),
            [0.5, 1.5, 3.0, 5.0]
        );
        assert_eq!(representative(&FeatureKind::Integer(-3, 3), 2), -1.0);
    }

    #[test]
    fn means_are_weighted_by_visits_and_constants_stay_finite() {
        let schema = schema();
        let keys = [StateKey::new(&[0, 0, 0, 1]), StateKey::new(&[0, 0, 4, 1])];
        let encoder = Encoder::fitted(&schema, keys.iter().zip([3.0, 1.0]));
        let scales = encoder.scales();
        assert_eq!(scales[2].map(|scale| scale.mean), Some(4.0));
        assert_eq!(
            scales[3],
            Some(Scale {
                mean: 1.5,
                deviation: 1.0
            })
        );
        assert_eq!(Encoder::with_scales(&schema, scales), Some(encoder));
        assert_eq!(Encoder::with_scales(&schema, vec![None; 4]), None);
    }
}
