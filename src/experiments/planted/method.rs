//! Methods to decide from the counts of a state, estimators and tests beside each other.

use super::case::Case;
use crate::domain::{Estimator, Rule, Verdict};

/// A method to decide from the counts of a state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Plug-in mutual information.
    PlugIn,
    /// The paper's rule: the same where a state was seen at least eight times.
    PapersFilter,
    /// Plug-in less its mean under independence.
    Excess,
    /// Nemenman, Shafee & Bialek's estimator, the best classical one.
    Nsb,
    /// The p-value of a permutation test of independence.
    Permutation,
    /// The default rule: independence weighed against dependence, by a prior fitted over all
    /// states.
    SpikeAndSlab,
}

impl Method {
    /// Every method, in the order in which they are told.
    pub const ALL: [Self; 6] = [
        Self::PlugIn,
        Self::PapersFilter,
        Self::Excess,
        Self::Nsb,
        Self::Permutation,
        Self::SpikeAndSlab,
    ];

    /// Those that end in a verdict.
    pub const WITH_VERDICT: [Self; 2] = [Self::PapersFilter, Self::SpikeAndSlab];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::PlugIn => "plug-in",
            Self::PapersFilter => "plug-in, N >= 8",
            Self::Excess => "excess",
            Self::Nsb => "NSB",
            Self::Permutation => "permutation",
            Self::SpikeAndSlab => "spike and slab",
        }
    }

    /// Returns what it ranks states by when asked for any influence: the more, the larger.
    pub(super) fn score(self, case: &Case) -> Option<f64> {
        let figures = case.figures()?;
        match self {
            Self::PlugIn => Some(figures.plug_in),
            Self::PapersFilter => None,
            Self::Excess => case.estimate(Estimator::Excess),
            Self::Nsb => case.estimate(Estimator::Nsb),
            Self::Permutation => case.p_value().map(|p| -p),
            Self::SpikeAndSlab => case
                .evidence()
                .map(|evidence| evidence.probability.dependent),
        }
    }

    /// Returns what it ranks states by when asked for strong influence.
    pub(super) fn score_strong(self, case: &Case) -> Option<f64> {
        match self {
            Self::SpikeAndSlab => case
                .evidence()
                .map(|evidence| evidence.probability.above_threshold),
            _ => self.score(case),
        }
    }

    /// Returns its estimate of mutual information, in nats. Some may be negative, which everybody
    /// who knows what they estimate reads as none.
    pub(super) fn estimate(self, case: &Case) -> Option<f64> {
        match self {
            Self::PlugIn | Self::Excess | Self::Nsb => self.score(case).map(|score| score.max(0.0)),
            Self::SpikeAndSlab => case.evidence().map(|evidence| evidence.posterior_mean),
            Self::PapersFilter | Self::Permutation => None,
        }
    }

    /// Returns whether it calls mutual information above the threshold if it must say yes or no.
    pub(super) fn calls(self, case: &Case) -> Option<bool> {
        match self {
            Self::PapersFilter => Some(case.paper == Verdict::Influences),
            Self::SpikeAndSlab => case
                .evidence()
                .map(|evidence| evidence.probability.above_threshold > 0.5),
            _ => self.estimate(case).map(is_strong),
        }
    }

    /// Returns its verdict.
    pub(super) fn verdict(self, case: &Case) -> Option<Verdict> {
        match self {
            Self::PapersFilter => Some(case.paper),
            Self::SpikeAndSlab => Some(case.answer.verdict),
            _ => None,
        }
    }
}

/// Returns whether mutual information, in nats, is what the default rule calls influence.
pub(super) fn is_strong(information: f64) -> bool {
    information > Rule::default().threshold_nats()
}
