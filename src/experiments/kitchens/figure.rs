//! Metrics of methods (AUROC, F1, Brier score): a state counts as often as the test games are in
//! it.

use std::iter::repeat_n;

use super::Method;
use super::method::Said;
use super::trial::{Trial, Truth};
use crate::domain::Verdict;
use crate::experiments::findings;
use crate::experiments::measures::{Hits, auc, frequency, mean};

/// A metric of a method.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// How well its probability tells influence from none: area under the ROC curve.
    Auroc,
    /// F1 of calling what has a probability of one half or more.
    F1,
    /// F1 of the verdict `influences`.
    F1AtVerdict,
    /// The share of time steps whose verdict stays open.
    Undecided,
    /// Mean squared difference between probability and truth.
    Brier,
    /// How many states have a probability of one half or more.
    Called,
}

/// The figures of the methods; `None` where one is not defined.
pub type Measured = findings::Measured<Method, Figure>;

/// From this probability a state is called.
const CALLED: f64 = 0.5;

impl Figure {
    /// Every figure, in the order in which they are told.
    pub const ALL: [Self; 6] = [
        Self::Auroc,
        Self::F1,
        Self::F1AtVerdict,
        Self::Undecided,
        Self::Brier,
        Self::Called,
    ];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Auroc => "AUROC",
            Self::F1 => "F1 P >= 0.5",
            Self::F1AtVerdict => "F1 verdict",
            Self::Undecided => "undecided",
            Self::Brier => "Brier",
            Self::Called => "states called",
        }
    }

    fn measured(self, truths: &[Truth], said: &[Said]) -> Option<f64> {
        let states = || truths.iter().zip(said);
        let steps =
            || states().flat_map(|(truth, said)| repeat_n((said, truth.is_strong), truth.steps));
        let called = |said: &Said| said.probability >= CALLED;

        match self {
            Self::Auroc => auc(&steps()
                .map(|(said, strong)| (said.probability, strong))
                .collect::<Vec<_>>()),
            Self::F1 => {
                Hits::of_decisions(steps().map(|(said, strong)| (called(said), strong))).f1()
            }
            Self::F1AtVerdict => Hits::of_decisions(
                steps().map(|(said, strong)| (said.verdict == Verdict::Influences, strong)),
            )
            .f1(),
            Self::Undecided => {
                frequency(steps().map(|(said, _)| said.verdict == Verdict::Undecided))
            }
            Self::Brier => mean(
                steps()
                    .map(|(said, strong)| (said.probability - f64::from(u8::from(strong))).powi(2)),
            ),
            Self::Called => Some(said.iter().filter(|said| called(said)).count() as f64),
        }
    }
}

/// Measures every method by every figure.
pub fn measure(trial: &Trial) -> Measured {
    let figures = |(method, said): &(Method, Vec<Said>)| {
        Figure::ALL.map(|figure| (*method, figure, figure.measured(&trial.truths, said)))
    };
    trial.said.iter().flat_map(figures).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_counts_as_often_as_the_games_are_in_it() {
        let truth = |steps, is_strong| Truth { steps, is_strong };
        let truths = [
            truth(3, true),
            truth(1, true),
            truth(4, false),
            truth(2, false),
        ];
        let said = [0.9, 0.4, 0.6, 0.1].map(Said::by);
        let figure = |figure: Figure| figure.measured(&truths, &said).expect("defined");
        // Of 24 pairs of steps one in four is in the wrong order for the step at .4 alone:
        // 3 x 6 + 1 x 2 are in the right one.
        assert_eq!(figure(Figure::Auroc), 20.0 / 24.0);
        assert_eq!(figure(Figure::F1), 2.0 * 3.0 / (2.0 * 3.0 + 4.0 + 1.0));
        assert_eq!(figure(Figure::F1AtVerdict), 2.0 * 3.0 / (2.0 * 3.0 + 1.0));
        assert_eq!(
            (figure(Figure::Undecided), figure(Figure::Called)),
            (0.5, 2.0)
        );
        assert!(
            (figure(Figure::Brier) - (3.0 * 0.01 + 0.36 + 4.0 * 0.36 + 2.0 * 0.01) / 10.0).abs()
                < 1e-12
        );
    }
}
