//! The figures by which decisions are judged.

use super::decision::{Decision, is_strong};
use super::world::Case;
use crate::domain::{Dependence, Verdict};
use crate::experiments::findings;
use crate::experiments::measures::{Hits, auc, frequency, mean, rmse};

/// By what a decision is judged. Where it speaks of influence, it is mutual information above half a nat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// How well its score tells states where influence was planted from others: area under the ROC curve.
    AucPlanted,
    /// The same for states in which more than half a nat was planted.
    AucStrong,
    /// F1 of calling mutual information above half a nat.
    F1,
    /// Root mean squared error of its estimate of mutual information, in nats.
    Rmse,
    /// How often its 90 % interval holds the truth.
    Coverage,
    /// The same among states with influence.
    CoverageDependent,
    /// At the verdict: the share of `influences` that is right.
    Precision,
    /// At the verdict: the share of states with influence that is called.
    Recall,
    /// At the verdict: the share of states that stay undecided.
    Undecided,
    /// The share of states called `influences`.
    Called,
    /// The share of states called `influences` that have none.
    FalselyCalled,
    /// The mean probability of any dependence.
    MeanProbability,
    /// The share of states whose dependence is established.
    Established,
    /// The share of states whose dependence is established although they have none.
    FalselyEstablished,
    /// The share of independent states with a p-value of 0.05 or less.
    FalseAlarms,
}

/// The figures of some decisions; `None` where one is not defined.
pub type Measured = findings::Measured<Decision, Figure>;

/// The level at which p-values raise an alarm.
const LEVEL: f64 = 0.05;

impl Figure {
    /// Every figure, in the order in which they are told.
    pub const ALL: [Self; 15] = [
        Self::AucPlanted,
        Self::AucStrong,
        Self::F1,
        Self::Rmse,
        Self::Coverage,
        Self::CoverageDependent,
        Self::Precision,
        Self::Recall,
        Self::Undecided,
        Self::Called,
        Self::FalselyCalled,
        Self::MeanProbability,
        Self::Established,
        Self::FalselyEstablished,
        Self::FalseAlarms,
    ];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::AucPlanted => "AUC MI > 0",
            Self::AucStrong => "AUC MI > 0.5",
            Self::F1 => "F1 MI > 0.5",
            Self::Rmse => "RMSE of MI",
            Self::Coverage => "coverage",
            Self::CoverageDependent => "coverage, dependent",
            Self::Precision => "precision",
            Self::Recall => "recall",
            Self::Undecided => "undecided",
            Self::Called => "called",
            Self::FalselyCalled => "falsely called",
            Self::MeanProbability => "mean P(dependent)",
            Self::Established => "established",
            Self::FalselyEstablished => "falsely established",
            Self::FalseAlarms => "p <= 0.05 if independent",
        }
    }

    /// Measures a decision; `None` where this says nothing of it.
    fn of(self, decision: Decision, cases: &[Case]) -> Option<f64> {
        let verdicts = || each(cases, |case| Some((decision.verdict(case)?, is_strong(case.information))));
        let called = || Some(verdicts()?.into_iter().map(|(verdict, strong)| (verdict == Verdict::Influences, strong)));
        let evidence = || each(cases, Case::evidence).filter(|_| decision == Decision::SpikeAndSlab);
        let covered = |wanted: fn(&Case) -> bool| {
            let holds = |(case, [lower, upper]): (&Case, [f64; 2])| (lower..=upper).contains(&case.information);
            let intervals = cases.iter().zip(evidence()?.into_iter().map(|evidence| evidence.interval));
            frequency(intervals.filter(|(case, _)| wanted(case)).map(holds))
        };
        let established = || {
            let established = evidence()?.into_iter().map(|told| told.dependence == Dependence::Established);
            Some(established.zip(cases.iter().map(Case::is_dependent)))
        };
        match self {
            Self::AucPlanted => auc(&each(cases, |case| Some((decision.score(case)?, case.planted)))?),
            Self::AucStrong => {
                auc(&each(cases, |case| Some((decision.score_strong(case)?, is_strong(case.planted_information))))?)
            }
            Self::F1 => Hits::of(each(cases, |case| Some((decision.calls(case)?, is_strong(case.information))))?).f1(),
            Self::Rmse => rmse(each(cases, |case| Some((decision.estimate(case)?, case.information)))?),
            Self::Coverage => covered(|_| true),
            Self::CoverageDependent => covered(Case::is_dependent),
            Self::Precision => Hits::of(called()?).precision(),
            Self::Recall => Hits::of(called()?).recall(),
            Self::Undecided => frequency(verdicts()?.into_iter().map(|(verdict, _)| verdict == Verdict::Undecided)),
            Self::Called => frequency(called()?.map(|(called, _)| called)),
            Self::FalselyCalled => frequency(called()?.map(|(called, strong)| called && !strong)),
            Self::MeanProbability => mean(evidence()?.into_iter().map(|evidence| evidence.probability.dependent)),
            Self::Established => frequency(established()?.map(|(established, _)| established)),
            Self::FalselyEstablished => frequency(established()?.map(|(established, so)| established && !so)),
            Self::FalseAlarms => {
                let independent = cases.iter().filter(|case| !case.is_dependent());
                let p_values = independent.map(Case::p_value).collect::<Option<Vec<f64>>>();
                frequency(p_values.filter(|_| decision == Decision::Permutation)?.into_iter().map(|p| p <= LEVEL))
            }
        }
    }
}

/// Measures decisions by every figure.
pub fn measure(decisions: &[Decision], cases: &[Case]) -> Measured {
    let figures = |decision: &Decision| Figure::ALL.map(|figure| (*decision, figure, figure.of(*decision, cases)));
    decisions.iter().flat_map(figures).collect()
}

/// Returns something of each case, if every case has it.
fn each<T>(cases: &[Case], something: impl FnMut(&Case) -> Option<T>) -> Option<Vec<T>> {
    cases.iter().map(something).collect()
}
