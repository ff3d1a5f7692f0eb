//! A case: the ground truth of one state beside its answer.

use crate::domain::{Answer, Estimator, Evidence, Figures, Verdict};

/// One state: what was planted, what is true, and what was answered.
pub struct Case {
    /// Whether influence was planted.
    pub planted: bool,
    /// The mutual information that was planted, in nats.
    pub planted_information: f64,
    /// The mutual information that is there, in nats: none after shuffling.
    pub information: f64,
    /// The answer by the default rule.
    pub answer: Answer,
    /// The verdict by the paper's rule.
    pub paper: Verdict,
}

impl Case {
    /// Returns whether there is influence to be found: none after shuffling.
    pub fn is_dependent(&self) -> bool {
        self.planted && self.information > 0.0
    }

    /// Returns the figures of the answer.
    pub fn figures(&self) -> Option<&Figures> {
        self.answer.figures.as_deref()
    }

    /// Returns what the evidence says.
    pub fn evidence(&self) -> Option<Evidence> {
        self.figures()?.evidence
    }

    /// Returns the p-value of the test of independence, where it was asked for.
    pub fn p_value(&self) -> Option<f64> {
        Some(self.figures()?.significance?.p_value)
    }

    /// Returns an estimate of mutual information in nats, where it was asked for.
    pub fn estimate(&self, estimator: Estimator) -> Option<f64> {
        let estimates = &self.figures()?.estimates;
        estimates
            .iter()
            .find(|(name, _)| *name == estimator.as_str())
            .map(|(_, estimate)| *estimate)
    }
}
