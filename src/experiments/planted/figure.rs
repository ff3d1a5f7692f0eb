//! Metrics of methods: errors of estimates, F1, AUROC and coverage of credible intervals.

use super::case::Case;
use super::method::{Method, is_strong};
use crate::domain::{Dependence, Rule, Verdict};
use crate::experiments::findings;
use crate::experiments::measures::{Hits, auc, frequency, mean, rmse};

/// A metric of a method. Where it speaks of influence, it is mutual information above half
/// a nat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// How well its score tells states where influence was planted from others: area under the ROC
    /// curve.
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
    /// The share of dependent states whose dependence is excluded.
    ExcludedIfDependent,
    /// The share of independent states whose dependence is established.
    EstablishedIfIndependent,
    /// At the verdict: the share of states that are decided, of those seen 10,000 times and not
    /// near the threshold.
    DecidedByMany,
    /// At the verdict: the share of these that are decided wrongly.
    WrongByMany,
    /// At the verdict: the share of states that stay undecided, of those seen once or twice.
    UndecidedByFew,
}

/// The figures of some methods; `None` where one is not defined.
pub type Measured = findings::Measured<Method, Figure>;

/// The level at which p-values raise an alarm.
const LEVEL: f64 = 0.05;

/// So many visits settle a verdict, unless mutual information lies so near the threshold, in nats.
const MANY: u64 = 10_000;
const NEAR: f64 = 0.03;

/// So few visits settle nothing.
const FEW: u64 = 2;

impl Figure {
    /// The figures of the usual worlds, in the order in which they are told.
    pub const USUAL: [Self; 15] = [
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

    /// The figures of hard worlds, in the order in which they are told.
    pub const HARD: [Self; 12] = [
        Self::AucPlanted,
        Self::Rmse,
        Self::Coverage,
        Self::CoverageDependent,
        Self::ExcludedIfDependent,
        Self::EstablishedIfIndependent,
        Self::Called,
        Self::Precision,
        Self::Undecided,
        Self::DecidedByMany,
        Self::WrongByMany,
        Self::UndecidedByFew,
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
            Self::ExcludedIfDependent => "excluded if dependent",
            Self::EstablishedIfIndependent => "established if independent",
            Self::DecidedByMany => "decided, N >= 10,000",
            Self::WrongByMany => "wrong, N >= 10,000",
            Self::UndecidedByFew => "undecided, N <= 2",
        }
    }

    /// Measures a method; `None` where this says nothing of it.
    fn measured(self, method: Method, cases: &[Case]) -> Option<f64> {
        let verdicts = || {
            each(cases, |case| {
                Some((method.verdict(case)?, is_strong(case.information)))
            })
        };

        let called = || {
            Some(
                verdicts()?
                    .into_iter()
                    .map(|(verdict, strong)| (verdict == Verdict::Influences, strong)),
            )
        };

        let evidence = || each(cases, Case::evidence).filter(|_| method == Method::SpikeAndSlab);
        let covered = |wanted: fn(&Case) -> bool| {
            let holds = |(case, [lower, upper]): (&Case, [f64; 2])| {
                (lower..=upper).contains(&case.information)
            };
            let intervals = cases
                .iter()
                .zip(evidence()?.into_iter().map(|evidence| evidence.interval));
            frequency(intervals.filter(|(case, _)| wanted(case)).map(holds))
        };

        let established = || {
            let established = evidence()?
                .into_iter()
                .map(|told| told.dependence == Dependence::Established);
            Some(established.zip(cases.iter().map(Case::is_dependent)))
        };

        let told = |dependence: Dependence, wanted: fn(&Case) -> bool| {
            let told = cases
                .iter()
                .zip(evidence()?)
                .filter(|(case, _)| wanted(case));
            frequency(told.map(|(_, evidence)| evidence.dependence == dependence))
        };

        let judged = |wanted: fn(&Case) -> bool, so: fn(Verdict, bool) -> bool| {
            let judged = cases
                .iter()
                .zip(verdicts()?)
                .filter(|(case, _)| wanted(case));
            frequency(judged.map(|(_, (verdict, strong))| so(verdict, strong)))
        };

        match self {
            Self::AucPlanted => auc(&each(cases, |case| {
                Some((method.score(case)?, case.planted))
            })?),
            Self::AucStrong => auc(&each(cases, |case| {
                Some((
                    method.score_strong(case)?,
                    is_strong(case.planted_information),
                ))
            })?),
            Self::F1 => Hits::of_decisions(each(cases, |case| {
                Some((method.calls(case)?, is_strong(case.information)))
            })?)
            .f1(),
            Self::Rmse => rmse(each(cases, |case| {
                Some((method.estimate(case)?, case.information))
            })?),
            Self::Coverage => covered(|_| true),
            Self::CoverageDependent => covered(Case::is_dependent),
            Self::Precision => Hits::of_decisions(called()?).precision(),
            Self::Recall => Hits::of_decisions(called()?).recall(),
            Self::Undecided => frequency(
                verdicts()?
                    .into_iter()
                    .map(|(verdict, _)| verdict == Verdict::Undecided),
            ),
            Self::Called => frequency(called()?.map(|(called, _)| called)),
            Self::FalselyCalled => frequency(called()?.map(|(called, strong)| called && !strong)),
            Self::MeanProbability => mean(
                evidence()?
                    .into_iter()
                    .map(|evidence| evidence.probability.dependent),
            ),
            Self::Established => frequency(established()?.map(|(established, _)| established)),
            Self::FalselyEstablished => {
                frequency(established()?.map(|(established, so)| established && !so))
            }
            Self::FalseAlarms => {
                let independent = cases.iter().filter(|case| !case.is_dependent());
                let p_values = independent.map(Case::p_value).collect::<Option<Vec<f64>>>();
                frequency(
                    p_values
                        .filter(|_| method == Method::Permutation)?
                        .into_iter()
                        .map(|p| p <= LEVEL),
                )
            }
            Self::ExcludedIfDependent => told(Dependence::Excluded, Case::is_dependent),
            Self::EstablishedIfIndependent => {
                told(Dependence::Established, |case| !case.is_dependent())
            }
            Self::DecidedByMany => judged(is_settled, |verdict, _| verdict != Verdict::Undecided),
            Self::WrongByMany => judged(is_settled, is_wrong),
            Self::UndecidedByFew => judged(
                |case| case.answer.visits <= FEW,
                |verdict, _| verdict == Verdict::Undecided,
            ),
        }
    }
}

/// Measures methods by figures.
pub fn measure(methods: &[Method], figures: &[Figure], cases: &[Case]) -> Measured {
    let pairs = methods
        .iter()
        .flat_map(|method| figures.iter().map(|figure| (*method, *figure)));
    pairs
        .map(|(method, figure)| (method, figure, figure.measured(method, cases)))
        .collect()
}

/// Returns whether a state was seen so often, with mutual information so far from the threshold,
/// that its verdict is settled.
fn is_settled(case: &Case) -> bool {
    case.answer.visits >= MANY && (case.information - Rule::default().threshold_nats()).abs() > NEAR
}

/// Returns whether a verdict is the opposite of what is true; being undecided is not wrong.
fn is_wrong(verdict: Verdict, strong: bool) -> bool {
    match verdict {
        Verdict::Influences => !strong,
        Verdict::NoInfluence => strong,
        Verdict::Undecided => false,
    }
}

/// Returns something of each case, if every case has it.
fn each<T>(cases: &[Case], something: impl FnMut(&Case) -> Option<T>) -> Option<Vec<T>> {
    cases.iter().map(something).collect()
}
