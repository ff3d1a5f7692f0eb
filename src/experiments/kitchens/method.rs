//! Methods to decide about a state that was never counted: networks and baselines beside each
//! other.

use crate::domain::{Answer, Rule, Verdict};

/// A method to decide about a state that was never counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// The network that learns what both agents do.
    Joint,
    /// The network that learns what the evidence says.
    Direct,
    /// What was counted in the state: nothing, which leaves what all states have on average.
    LookUp,
    /// What was counted in the states that share its most telling features.
    BackOff,
    /// Influence everywhere.
    AllPositive,
    /// The joint network of a service that counted the other's actions shuffled within each state.
    Shuffled,
    /// Who knows where the ego is answered.
    Oracle,
}

impl Method {
    /// Every method, in the order in which they are told.
    pub const ALL: [Self; 7] = [
        Self::Joint,
        Self::Direct,
        Self::LookUp,
        Self::BackOff,
        Self::AllPositive,
        Self::Shuffled,
        Self::Oracle,
    ];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Joint => "joint network",
            Self::Direct => "direct network",
            Self::LookUp => "look-up table",
            Self::BackOff => "back-off",
            Self::AllPositive => "all positive",
            Self::Shuffled => "shuffled actions",
            Self::Oracle => "oracle",
        }
    }
}

/// The prediction and verdict of a method for a state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Said {
    /// P(MI > threshold).
    pub probability: f64,
    /// The verdict.
    pub verdict: Verdict,
}

impl Said {
    /// Says what a probability says at the confidence of the default rule.
    pub fn by(probability: f64) -> Self {
        let confidence = Rule::default().confidence;
        let verdict = match probability {
            p if p >= confidence => Verdict::Influences,
            p if 1.0 - p >= confidence => Verdict::NoInfluence,
            _ => Verdict::Undecided,
        };
        Self {
            probability,
            verdict,
        }
    }

    /// Says for certain.
    pub fn certainly(so: bool) -> Self {
        Self::by(f64::from(u8::from(so)))
    }

    /// Returns what an answer says: its network, if one answers, else its evidence.
    pub fn of_answer(answer: &Answer) -> Option<Self> {
        let figures = answer.figures.as_deref()?;
        let probability = match &figures.model {
            Some(model) => model.probability?,
            None => figures.evidence?.probability.above_threshold,
        };
        Some(Self {
            probability,
            verdict: answer.verdict,
        })
    }
}
