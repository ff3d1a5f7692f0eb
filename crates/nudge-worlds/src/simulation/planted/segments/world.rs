//! Kinds of stratified worlds: how visits, habits and dependence are laid over segments.

use nudge_core::information::Alphabet;

/// The share of a dominant segment.
pub(super) const DOMINANT: f64 = 0.9;

/// Where sizes fall, each segment has so much of the one before.
const FALLING: f64 = 0.5;

/// How a state's visits are shared out between its segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sizes {
    /// All alike.
    Equal,
    /// Each half of the one before.
    Falling,
    /// The first has nine visits in ten, the others share the rest.
    Dominated,
}

/// Whose habits differ between the segments of a state. Each that does is drawn afresh from Dir(1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Differ {
    /// Nobody's: segments do not matter.
    Neither,
    /// The ego's.
    Ego,
    /// The other's.
    Other,
    /// Both agents'.
    Both,
    /// Both agents': what is likely in one segment is unlikely in the next.
    Opposite,
    /// Both agents', slowly, from one segment to the next.
    Drift,
}

/// In which segments of a dependent state the other responds to the ego. Where it does, two of the
/// ego's actions or more each draw it from its habit towards a response of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dependence {
    /// In none of any state.
    Nowhere,
    /// In all of them, by the same responses.
    Shared,
    /// In a single one, any of them; there, each of the ego's actions has a response of its own
    /// (Dir(0.1)), for a weaker dependence is lost among the visits of the other segments.
    InOne,
    /// In all of them, by responses that differ from segment to segment.
    Differing,
}

/// A kind of world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct World {
    /// Its name.
    pub name: &'static str,
    /// How many actions either agent has.
    pub alphabet: Alphabet,
    /// How many segments a state is seen in.
    pub segments: usize,
    /// How its visits are shared out between them.
    pub sizes: Sizes,
    /// Whose habits differ.
    pub differ: Differ,
    /// Where the other responds to the ego.
    pub dependence: Dependence,
}

impl World {
    /// Returns the expected share of each segment in a state's visits.
    pub fn weights(&self) -> Vec<f64> {
        let rest = (1.0 - DOMINANT) / (self.segments - 1).max(1) as f64;
        let size = |segment: usize| match self.sizes {
            Sizes::Equal => 1.0,
            Sizes::Falling => FALLING.powi(segment as i32),
            Sizes::Dominated => {
                if segment == 0 {
                    DOMINANT
                } else {
                    rest
                }
            }
        };

        let sum: f64 = (0..self.segments).map(size).sum();
        (0..self.segments)
            .map(|segment| size(segment) / sum)
            .collect()
    }
}
