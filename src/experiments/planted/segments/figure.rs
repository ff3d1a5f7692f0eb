//! Metrics of ways to treat segments: false discovery rates, power (recall) and coverage.

use super::{FDR, Said};
use crate::domain::Dependence;
use crate::experiments::measures::frequency;
use crate::information::{bayesian_fdr, benjamini_hochberg};

/// A metric of a way to treat segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// States whose dependence is established.
    Established,
    /// The share of independent states whose dependence is established.
    EstablishedIfIndependent,
    /// The share of states whose dependence is established that have none: what is false among what
    /// is called.
    FalselyEstablished,
    /// The share of dependent states whose dependence is established.
    Recall,
    /// The share of dependent states whose dependence is excluded.
    ExcludedIfDependent,
    /// How often the 90 % interval of a dependent state holds the truth.
    Covered,
    /// States listed at a Bayesian false discovery rate of 0.05.
    Listed,
    /// The share of these that are independent; 0 of none.
    FalselyListed,
    /// States listed by Benjamini and Hochberg at 0.05, from p-values within segments.
    ListedByP,
    /// The share of these that are independent; 0 of none.
    FalselyListedByP,
}

/// One state: the ground truth, and what is said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    /// The mutual information within segments, in nats.
    pub information: f64,
    /// What the evidence says.
    pub said: Said,
    /// The p-value of independence within segments, where it could be small.
    pub p_value: Option<f64>,
}

impl Case {
    fn is_dependent(&self) -> bool {
        self.information > 0.0
    }

    fn is_told(&self, dependence: Dependence) -> bool {
        self.said.dependence == dependence
    }

    fn is_established(&self) -> bool {
        self.is_told(Dependence::Established)
    }

    fn is_covered(&self) -> bool {
        let [lower, upper] = self.said.interval;
        (lower..=upper).contains(&self.information)
    }
}

impl Figure {
    /// Every figure, in the order in which they are told.
    pub const ALL: [Self; 10] = [
        Self::Established,
        Self::EstablishedIfIndependent,
        Self::FalselyEstablished,
        Self::Recall,
        Self::ExcludedIfDependent,
        Self::Covered,
        Self::Listed,
        Self::FalselyListed,
        Self::ListedByP,
        Self::FalselyListedByP,
    ];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Established => "established",
            Self::EstablishedIfIndependent => "established if independent",
            Self::FalselyEstablished => "false among established",
            Self::Recall => "recall",
            Self::ExcludedIfDependent => "excluded if dependent",
            Self::Covered => "coverage, dependent",
            Self::Listed => "listed, bayes",
            Self::FalselyListed => "false among listed, bayes",
            Self::ListedByP => "listed, bh",
            Self::FalselyListedByP => "false among listed, bh",
        }
    }

    fn measured(self, cases: &[Case]) -> Option<f64> {
        let share = |among: fn(&Case) -> bool, so: fn(&Case) -> bool| {
            frequency(cases.iter().filter(|case| among(case)).map(so))
        };
        match self {
            Self::Established => {
                Some(cases.iter().filter(|case| case.is_established()).count() as f64)
            }
            Self::EstablishedIfIndependent => {
                share(|case| !case.is_dependent(), Case::is_established)
            }
            Self::FalselyEstablished => share(Case::is_established, |case| !case.is_dependent()),
            Self::Recall => share(Case::is_dependent, Case::is_established),
            Self::ExcludedIfDependent => share(Case::is_dependent, |case| {
                case.is_told(Dependence::Excluded)
            }),
            Self::Covered => share(Case::is_dependent, Case::is_covered),
            Self::Listed => Some(listed(cases).len() as f64),
            Self::FalselyListed => Some(falsely(&listed(cases))),
            Self::ListedByP => Some(listed_by_p(cases).len() as f64),
            Self::FalselyListedByP => Some(falsely(&listed_by_p(cases))),
        }
    }
}

/// Measures every figure; `None` where one is not defined.
pub fn measure(cases: &[Case]) -> Vec<(Figure, Option<f64>)> {
    Figure::ALL
        .map(|figure| (figure, figure.measured(cases)))
        .to_vec()
}

/// Returns the states on the list that is made of the probabilities of dependence.
fn listed(cases: &[Case]) -> Vec<&Case> {
    let dependent: Vec<f64> = cases.iter().map(|case| case.said.dependent).collect();
    chosen(cases, bayesian_fdr(&dependent, FDR))
}

/// Returns the states on the list that is made of the p-values.
fn listed_by_p(cases: &[Case]) -> Vec<&Case> {
    let (testable, p_values): (Vec<&Case>, Vec<f64>) = cases
        .iter()
        .filter_map(|case| Some((case, case.p_value?)))
        .unzip();
    chosen(testable, benjamini_hochberg(&p_values, FDR))
}

fn chosen<'a>(cases: impl IntoIterator<Item = &'a Case>, chosen: Vec<bool>) -> Vec<&'a Case> {
    cases
        .into_iter()
        .zip(chosen)
        .filter(|(_, chosen)| *chosen)
        .map(|(case, _)| case)
        .collect()
}

/// Returns the share of a list that is independent.
fn falsely(listed: &[&Case]) -> f64 {
    frequency(listed.iter().map(|case| !case.is_dependent())).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A state with the interval 0.1 to 0.3.
    fn case(
        information: f64,
        dependent: f64,
        dependence: Dependence,
        p_value: Option<f64>,
    ) -> Case {
        Case {
            information,
            said: Said {
                dependent,
                interval: [0.1, 0.3],
                dependence,
            },
            p_value,
        }
    }

    fn figures(cases: &[Case]) -> [Option<f64>; 10] {
        Figure::ALL.map(|figure| figure.measured(cases))
    }

    #[test]
    fn figures_are_shares_of_the_states_that_they_speak_of() {
        let cases = [
            case(0.2, 0.99, Dependence::Established, Some(0.001)),
            case(0.4, 0.98, Dependence::Established, Some(0.002)),
            case(0.2, 0.50, Dependence::Open, Some(0.900)),
            case(0.2, 0.01, Dependence::Excluded, None),
            case(0.0, 0.97, Dependence::Established, Some(0.003)),
            case(0.0, 0.02, Dependence::Excluded, None),
        ];
        let third = Some(1.0 / 3.0);
        let expected = [
            Some(3.0),
            Some(0.5),
            third,
            Some(0.5),
            Some(0.25),
            Some(0.75),
            Some(3.0),
            third,
            Some(3.0),
            third,
        ];
        assert_eq!(figures(&cases), expected);
    }

    #[test]
    fn what_nothing_can_be_said_of_is_not_defined() {
        let open = case(0.0, 0.1, Dependence::Open, None);
        let zero = Some(0.0);
        assert_eq!(
            figures(&[open]),
            [zero, zero, None, None, None, None, zero, zero, zero, zero]
        );
    }
}
