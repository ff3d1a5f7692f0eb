//! Decision rules about regions: what is believed of mean mutual information there, and what the
//! counts say by themselves, in; a verdict out.

use super::decision::{CERTAIN, decide};
use super::region::RegionPosterior;
use crate::domain::{Dependence, Rule, RuleKind, Verdict};
use crate::information::pooled::Pooled;

/// The largest p-value of a test that finds dependence, whatever the rule's confidence.
const FOUND: f64 = 0.01;

/// Returns the verdict of a rule on a region with these visits, by what its strata show together, in
/// nats, and what is believed of mean mutual information there.
///
/// The paper's rule looks at the plug-in of the strata. The evidence rule asks for the posterior
/// probability that it asks for in a state, and that the counts agree by themselves, since over
/// thousands of rarely seen states the prior alone may be certain: that the pooled test finds
/// dependence at .01 (`influences`), or that the size's confidence interval ends below the threshold
/// (`no_influence`), and the further below the smaller the share of draws that the size stands on.
pub fn decide_region(
    rule: &Rule,
    visits: u64,
    pooled: &Pooled,
    posterior: Option<&RegionPosterior>,
) -> Verdict {
    if rule.kind == RuleKind::Paper {
        return decide(rule, visits, pooled.plug_in, None);
    }
    let threshold = rule.threshold_nats();
    let (Some(posterior), Some([_, largest])) = (posterior, pooled.size_interval) else {
        return Verdict::Undecided;
    };

    let above = posterior.above(threshold);
    let lowered = threshold * (2.0 * pooled.share).min(1.0);
    if above >= rule.confidence && pooled.p_value <= FOUND && pooled.excess > 0.0 {
        Verdict::Influences
    } else if 1.0 - above >= rule.confidence && largest < lowered {
        Verdict::NoInfluence
    } else {
        Verdict::Undecided
    }
}

/// Returns whether there is dependence anywhere in a region: some state depends with a probability of
/// at least .95 and the pooled test finds it at .05, or at most one visit in twenty is in a
/// dependent state and the test finds none.
pub fn dependence_in_region(pooled: &Pooled, posterior: &RegionPosterior) -> Dependence {
    let is_found = pooled.p_value <= 1.0 - CERTAIN;
    if pooled.size_interval.is_none() {
        Dependence::Open
    } else if is_found && posterior.any_dependent() >= CERTAIN {
        Dependence::Established
    } else if !is_found && posterior.dependent_share() <= 1.0 - CERTAIN {
        Dependence::Excluded
    } else {
        Dependence::Open
    }
}
