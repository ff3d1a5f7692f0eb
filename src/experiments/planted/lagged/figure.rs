//! Metrics of lagged questions: what is called, what is significant, and where the profile peaks.

use crate::experiments::findings::Measured;
use crate::experiments::measures::frequency;
use crate::information::{Table, conditional, excess};
use crate::simulation::planted::lagged::Asked;

/// P(dependent) from which a state is called.
const CALLED: f64 = 0.95;

/// The level of tests.
const LEVEL: f64 = 0.05;

/// A metric of a question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// The share of near states that are called dependent.
    Called,
    /// The share of the other states that are.
    CalledFar,
    /// The share of all states that are.
    CalledOfAll,
    /// The share of all states with a p-value of .05 or less.
    Significant,
    /// The same, had every entry of a state been counted as a draw.
    SignificantIfEntered,
    /// The plug-in beyond its mean under independence in the near states, in nats a draw.
    Excess,
    /// Whether that is the largest of all lags but 0.
    Peak,
}

/// One state, by what is said of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    /// Whether the follower copies there.
    pub is_near: bool,
    /// P(dependent).
    pub dependent: f64,
    /// Of independence, given the other's own action.
    pub p_value: f64,
    /// The same on every entry, where it was asked for.
    pub p_value_entered: Option<f64>,
    /// The plug-in beyond its mean under independence, in nats a draw.
    pub excess: f64,
}

impl Case {
    fn is_called(&self) -> bool {
        self.dependent >= CALLED
    }
}

/// Returns conditional mutual information beyond its mean under independence.
pub(super) fn excess_of(tables: &[Table]) -> f64 {
    conditional(tables, excess)
}

impl Figure {
    /// Every figure, in the order in which they are told.
    pub const ALL: [Self; 7] = [
        Self::Called,
        Self::CalledFar,
        Self::CalledOfAll,
        Self::Significant,
        Self::SignificantIfEntered,
        Self::Excess,
        Self::Peak,
    ];

    /// Returns its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Called => "called, near",
            Self::CalledFar => "called, far",
            Self::CalledOfAll => "called",
            Self::Significant => "p <= .05",
            Self::SignificantIfEntered => "p <= .05, every entry",
            Self::Excess => "excess, near",
            Self::Peak => "peak",
        }
    }

    fn measured(self, cases: &[Case], largest: f64) -> Option<f64> {
        let share = |among: fn(&Case) -> bool| {
            frequency(cases.iter().filter(|case| among(case)).map(Case::is_called))
        };
        match self {
            Self::Called => share(|case| case.is_near),
            Self::CalledFar => share(|case| !case.is_near),
            Self::CalledOfAll => share(|_| true),
            Self::Significant => frequency(cases.iter().map(|case| case.p_value <= LEVEL)),
            Self::SignificantIfEntered => {
                let p_values = cases.iter().filter_map(|case| case.p_value_entered);
                frequency(p_values.map(|p| p <= LEVEL))
            }
            Self::Excess => Some(near(cases)),
            Self::Peak => Some(f64::from(near(cases) >= largest)),
        }
    }
}

/// Returns the excess of the near states together, all of which have as many draws.
fn near(cases: &[Case]) -> f64 {
    let near: Vec<f64> = cases
        .iter()
        .filter(|case| case.is_near)
        .map(|case| case.excess)
        .collect();
    near.iter().sum::<f64>() / near.len().max(1) as f64
}

/// Measures every figure of every question; `None` where one is not defined.
pub(super) fn measure(asked: &[Asked], cases: &[Vec<Case>]) -> Measured<Asked, Figure> {
    let lagged = |ego| {
        let of_ego = asked.iter().zip(cases);
        of_ego.filter(move |(asked, _)| asked.ego == ego && asked.lag > 0)
    };
    let largest = [0, 1].map(|ego| {
        let excesses = lagged(ego).map(|(_, cases)| near(cases));
        excesses.fold(f64::NEG_INFINITY, f64::max)
    });

    let of = |(asked, cases): (&Asked, &Vec<Case>)| {
        let (asked, largest) = (*asked, largest[asked.ego]);
        Figure::ALL
            .map(|figure| {
                let is_defined = figure != Figure::Peak || asked.lag > 0;
                let value = is_defined.then(|| figure.measured(cases, largest));
                (asked, figure, value.flatten())
            })
            .to_vec()
    };
    asked.iter().zip(cases).flat_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(is_near: bool, dependent: f64, p_value: f64, excess: f64) -> Case {
        Case {
            is_near,
            dependent,
            p_value,
            p_value_entered: Some(0.01),
            excess,
        }
    }

    #[test]
    fn figures_are_shares_of_the_states_that_they_speak_of() {
        let asked = [0, 1, 2].map(|lag| Asked { ego: 0, lag });
        let cases = [
            vec![case(true, 0.99, 0.01, 0.9), case(false, 0.2, 0.3, 0.1)],
            vec![case(true, 0.95, 0.05, 0.3), case(false, 0.96, 0.2, 0.5)],
            vec![case(true, 0.94, 0.06, 0.2), case(false, 0.1, 0.9, 0.0)],
        ];
        let measured = measure(&asked, &cases);
        let of = |lag: usize| {
            let figures = measured.iter().filter(|(asked, ..)| asked.lag == lag);
            figures.map(|(.., value)| *value).collect::<Vec<_>>()
        };
        let some = |values: [f64; 7]| values.map(Some).to_vec();
        assert_eq!(of(1), some([1.0, 1.0, 1.0, 0.5, 1.0, 0.3, 1.0]));
        assert_eq!(of(2), some([0.0, 0.0, 0.0, 0.0, 1.0, 0.2, 0.0]));
        let no_peak = [1.0, 0.0, 0.5, 0.5, 1.0, 0.9].map(Some);
        assert_eq!(
            of(0),
            [&no_peak[..], &[None]].concat(),
            "lag 0 has no direction"
        );
    }
}
