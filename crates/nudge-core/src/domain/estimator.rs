//! Estimators of mutual information beside the plug-in, told on request.

use std::str::FromStr;

/// An estimator of mutual information beside the plug-in. What each is good for stands in
/// [`crate::information`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Estimator {
    /// Plug-in less its mean under independence.
    Excess,
    /// Plug-in less Miller and Madow's first-order bias.
    MillerMadow,
    /// By coverage, for alphabets that were not seen whole (2003).
    ChaoShen,
    /// The table shrunk to the uniform one (Hausser & Strimmer 2009).
    JamesStein,
    /// By corrected logarithms of the counts (2003).
    Grassberger2003,
    /// Nemenman, Shafee & Bialek's posterior mean (2002).
    Nsb,
    /// The posterior mean under a Dirichlet prior of weight one (Hutter & Zaffalon 2005).
    Dirichlet,
    /// Excess as a share of the largest there could be (Vinh, Epps & Bailey 2010).
    Adjusted,
    /// What it would be had the ego chosen uniformly among its actions.
    UniformPolicy,
}

impl Estimator {
    /// Every estimator, in the order in which they are told.
    pub const ALL: [Self; 9] = [
        Self::Excess,
        Self::MillerMadow,
        Self::ChaoShen,
        Self::JamesStein,
        Self::Grassberger2003,
        Self::Nsb,
        Self::Dirichlet,
        Self::Adjusted,
        Self::UniformPolicy,
    ];

    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Excess => "excess",
            Self::MillerMadow => "miller_madow",
            Self::ChaoShen => "chao_shen",
            Self::JamesStein => "james_stein",
            Self::Grassberger2003 => "grassberger_2003",
            Self::Nsb => "nsb",
            Self::Dirichlet => "dirichlet",
            Self::Adjusted => "adjusted",
            Self::UniformPolicy => "uniform_policy",
        }
    }
}

impl FromStr for Estimator {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = || Self::ALL.map(Self::as_str).join(", ");
        let found = Self::ALL
            .into_iter()
            .find(|estimator| estimator.as_str() == text);
        found.ok_or_else(|| format!("unknown estimator {text:?}, expected one of {}", known()))
    }
}

/// A set of estimators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Estimators(u16);

impl Estimators {
    /// Returns whether there is none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns them, in the order of [`Estimator::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Estimator> {
        Estimator::ALL
            .into_iter()
            .filter(move |estimator| self.0 & bit(*estimator) != 0)
    }
}

impl FromIterator<Estimator> for Estimators {
    fn from_iter<I: IntoIterator<Item = Estimator>>(estimators: I) -> Self {
        Self(
            estimators
                .into_iter()
                .fold(0, |set, estimator| set | bit(estimator)),
        )
    }
}

fn bit(estimator: Estimator) -> u16 {
    1 << estimator as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_reads_back() {
        for estimator in Estimator::ALL {
            assert_eq!(estimator.as_str().parse(), Ok(estimator));
        }
        assert!(
            "nsbb"
                .parse::<Estimator>()
                .expect_err("a typo")
                .contains("grassberger_2003, nsb, dirichlet")
        );
    }

    #[test]
    fn a_set_has_each_once_and_in_order() {
        let set: Estimators = [Estimator::Nsb, Estimator::Excess, Estimator::Nsb]
            .into_iter()
            .collect();
        assert_eq!(
            set.iter().collect::<Vec<_>>(),
            [Estimator::Excess, Estimator::Nsb]
        );
        assert!(Estimators::default().is_empty() && !set.is_empty());
    }
}
