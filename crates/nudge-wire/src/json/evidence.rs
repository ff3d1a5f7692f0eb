//! Posterior probabilities, tests of independence, segments (strata) and fitted priors (empirical
//! Bayes), as answers and overviews tell them.

use serde::Serialize;
use utoipa::ToSchema;

use super::words;
use crate::proto;

/// Probabilities given the counts and the fitted prior.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Probability {
    /// P(MI > 0): that there is any dependence at all.
    #[schema(minimum = 0, maximum = 1)]
    pub dependent: f64,
    /// P(MI > threshold).
    #[schema(minimum = 0, maximum = 1)]
    pub above_threshold: f64,
}

/// A test of independence at the margins that were seen.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Significance {
    /// The probability of a plug-in at least as large, were the agents independent.
    #[schema(minimum = 0, maximum = 1)]
    pub p_value: f64,
    /// `exact`, `permutation` or `g_test`.
    #[schema(value_type = words::TestMethod)]
    pub method: String,
}

/// How counts are divided into segments. Transitions without a segment count as one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, ToSchema)]
pub struct Segmentation {
    /// How many segments have visits, of those asked for.
    pub count: u64,
    /// P(habits differ by segment); null where the evidence does not tell.
    pub differ: Option<f64>,
}

/// Which fit of the prior was used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, ToSchema)]
pub struct Fit {
    /// 0 for the prior that nothing was fitted to, then 1, 2, ...
    pub version: u64,
    /// How many transitions the environment had when it was made.
    pub revision: u64,
}

/// The fits that were made.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Fits {
    /// One a pair.
    pub fits: Vec<FittedPrior>,
}

/// The prior of one pair of agents, which serves both directions; at a lag one of them.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FittedPrior {
    /// The earlier agent in the environment's order; at a lag the ego.
    pub earlier: String,
    /// The later agent; at a lag the other, which may be an outcome with values.
    pub later: String,
    /// Steps between the two actions; absent for the same tick.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lag: Option<u32>,
    /// Agents whose actions are held fixed.
    pub given: Vec<String>,
    /// Its version and revision.
    pub fit: Fit,
    /// States that it was fitted to: those that can tell dependence from independence.
    pub states: u64,
    /// The share of states that depend.
    pub dependent_share: f64,
}

/// Returns the lower and the upper end of an interval.
pub(super) fn interval(interval: proto::Interval) -> [f64; 2] {
    [interval.lower, interval.upper]
}

/// Returns the word for a dependence; `None` where nothing is known of it.
pub fn dependence(number: i32) -> Option<&'static str> {
    match proto::Dependence::try_from(number) {
        Ok(proto::Dependence::Established) => Some("established"),
        Ok(proto::Dependence::Excluded) => Some("excluded"),
        Ok(proto::Dependence::Open) => Some("open"),
        Ok(proto::Dependence::Unspecified) | Err(_) => None,
    }
}

impl From<proto::Probability> for Probability {
    fn from(probability: proto::Probability) -> Self {
        let proto::Probability {
            dependent,
            above_threshold,
        } = probability;
        Self {
            dependent,
            above_threshold,
        }
    }
}

impl From<proto::Significance> for Significance {
    fn from(significance: proto::Significance) -> Self {
        let proto::Significance { p_value, method } = significance;
        Self { p_value, method }
    }
}

impl From<proto::Segmentation> for Segmentation {
    fn from(segmentation: proto::Segmentation) -> Self {
        let proto::Segmentation { count, differ } = segmentation;
        Self { count, differ }
    }
}

impl From<proto::Fit> for Fit {
    fn from(fit: proto::Fit) -> Self {
        let proto::Fit { version, revision } = fit;
        Self { version, revision }
    }
}

impl From<proto::FitPriorResponse> for Fits {
    fn from(response: proto::FitPriorResponse) -> Self {
        Self {
            fits: response.fits.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::FittedPrior> for FittedPrior {
    fn from(prior: proto::FittedPrior) -> Self {
        Self {
            earlier: prior.earlier,
            later: prior.later,
            lag: Some(prior.lag).filter(|lag| *lag > 0),
            given: prior.given,
            fit: prior.fit.map(Into::into).unwrap_or_default(),
            states: prior.states,
            dependent_share: prior.dependent_share,
        }
    }
}
