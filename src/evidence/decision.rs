//! Verdicts: figures and a rule in, a word out.

use crate::domain::{Basis, Dependence, Rule, RuleKind, Verdict};

/// How far counts must have moved the odds for a decision to be theirs and not the prior's.
const EARNED: f64 = 3.0;
/// From this probability dependence is established, and from the same of independence it is excluded.
const CERTAIN: f64 = 0.95;

/// A probability as it is now, and as it was before anything was counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Belief {
    /// By the counts and the prior.
    pub now: f64,
    /// By the prior alone: [`Prior::unseen`](super::Prior::unseen).
    pub unseen: f64,
}

/// Returns the verdict of a rule on a state with these visits, this plug-in mutual information in nats, and this belief in MI > threshold.
///
/// The paper's rule: plug-in above the threshold where visits suffice. The evidence rule: the belief or its complement at least the rule's
/// confidence, and its odds moved by the counts to at least three times, or at most a third, of what they were: else a prior alone would call every
/// rarely seen state free of influence. Without a belief, and without visits, nothing is decided.
pub fn decide(rule: &Rule, visits: u64, plug_in: f64, above: Option<Belief>) -> Verdict {
    match rule.kind {
        _ if visits == 0 => Verdict::Undecided,
        RuleKind::Paper if visits < rule.min_visits => Verdict::Undecided,
        RuleKind::Paper if plug_in > rule.threshold_nats() => Verdict::Influences,
        RuleKind::Paper => Verdict::NoInfluence,
        RuleKind::Evidence => match above.and_then(|belief| belief.earned(rule.confidence)) {
            Some(true) => Verdict::Influences,
            Some(false) => Verdict::NoInfluence,
            None => Verdict::Undecided,
        },
    }
}

/// Returns whether there is dependence at all, however weak, by a belief in it: at least 0.95 or at most 0.05, its odds moved by a factor of three.
pub fn dependence(dependent: Belief) -> Dependence {
    match dependent.earned(CERTAIN) {
        Some(true) => Dependence::Established,
        Some(false) => Dependence::Excluded,
        None => Dependence::Open,
    }
}

impl Belief {
    /// Returns what is decided, where the probability is high or low enough and the counts brought it there.
    fn earned(self, confidence: f64) -> Option<bool> {
        let odds = |p: f64| p / (1.0 - p);
        let (now, unseen) = (odds(self.now), odds(self.unseen));
        if self.now >= confidence && now >= EARNED * unseen {
            return Some(true);
        }
        (1.0 - self.now >= confidence && EARNED * now <= unseen).then_some(false)
    }
}

/// Returns what a verdict on a state with these visits rests on.
pub fn basis(visits: u64) -> Basis {
    if visits == 0 { Basis::Prior } else { Basis::Counts(visits) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Unit;

    fn paper(rule: Rule, visits: u64, plug_in: f64) -> Verdict {
        decide(&Rule { kind: RuleKind::Paper, ..rule }, visits, plug_in, None)
    }

    fn evidence(visits: u64, unseen: f64, now: f64) -> Verdict {
        let rule = Rule { kind: RuleKind::Evidence, ..Rule::default() };
        decide(&rule, visits, 9.0, Some(Belief { now, unseen }))
    }

    #[test]
    fn the_paper_decides_where_visits_suffice() {
        assert_eq!(paper(Rule::default(), 7, 9.0), Verdict::Undecided);
        assert_eq!(paper(Rule::default(), 8, 0.51), Verdict::Influences);
        assert_eq!(paper(Rule::default(), 8, 0.5), Verdict::NoInfluence);
    }

    #[test]
    fn a_threshold_in_bits_is_compared_in_bits() {
        let rule = Rule { unit: Unit::Bits, ..Rule::default() };
        assert_eq!(paper(rule, 8, 0.4), Verdict::Influences);
        assert_eq!(paper(rule, 8, 0.3), Verdict::NoInfluence);
    }

    #[test]
    fn nothing_seen_decides_nothing() {
        let rule = Rule { min_visits: 0, threshold: 0.0, ..Rule::default() };
        assert_eq!(paper(rule, 0, 0.0), Verdict::Undecided);
        assert_eq!(evidence(0, 0.5, 0.99), Verdict::Undecided);
        assert_eq!(basis(0), Basis::Prior);
    }

    #[test]
    fn evidence_decides_where_it_is_sure() {
        assert_eq!(evidence(1, 0.3, 0.8), Verdict::Influences);
        assert_eq!(evidence(1, 0.3, 0.79), Verdict::Undecided);
        assert_eq!(evidence(1, 0.5, 0.19), Verdict::NoInfluence);
        assert_eq!(evidence(1, 0.0, 0.0), Verdict::NoInfluence);
    }

    #[test]
    fn what_the_prior_knew_is_no_verdict() {
        // Odds of 1/99 are a third of 3/99, to which the prior amounts; 2/99 would not do.
        assert_eq!(evidence(1, 3.0 / 102.0, 0.01), Verdict::NoInfluence);
        assert_eq!(evidence(1, 2.0 / 101.0, 0.01), Verdict::Undecided);
        assert_eq!(evidence(1, 0.9, 0.95), Verdict::Undecided);
    }

    #[test]
    fn without_a_belief_evidence_is_not_weighed() {
        let rule = Rule { kind: RuleKind::Evidence, ..Rule::default() };
        assert_eq!(decide(&rule, 1_000, 2.0, None), Verdict::Undecided);
    }

    #[test]
    fn dependence_is_a_question_of_its_own() {
        let told = |now| dependence(Belief { now, unseen: 0.3 });
        assert_eq!([0.95, 0.05, 0.5].map(told), [Dependence::Established, Dependence::Excluded, Dependence::Open]);
    }
}
