//! What counts can support: from figures to a verdict, by a rule. Pure; nothing here counts, reads or asks a network.

use crate::domain::{Basis, Rule, RuleKind, Verdict};

/// Returns the verdict of a rule on a state with these visits and this plug-in mutual information in nats.
///
/// The paper's rule: plug-in above the threshold where visits suffice. The evidence rule needs a prior fitted over all states; until there is one it
/// decides nothing.
pub fn decide(rule: &Rule, visits: u64, plug_in: f64) -> Verdict {
    match rule.kind {
        RuleKind::Evidence => Verdict::Undecided,
        RuleKind::Paper if visits == 0 || visits < rule.min_visits => Verdict::Undecided,
        RuleKind::Paper if plug_in > rule.threshold_nats() => Verdict::Influences,
        RuleKind::Paper => Verdict::NoInfluence,
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

    #[test]
    fn the_paper_decides_where_visits_suffice() {
        let rule = Rule::default();
        assert_eq!(decide(&rule, 7, 9.0), Verdict::Undecided);
        assert_eq!(decide(&rule, 8, 0.51), Verdict::Influences);
        assert_eq!(decide(&rule, 8, 0.5), Verdict::NoInfluence);
    }

    #[test]
    fn a_threshold_in_bits_is_compared_in_bits() {
        let rule = Rule { unit: Unit::Bits, ..Rule::default() };
        assert_eq!(decide(&rule, 8, 0.4), Verdict::Influences);
        assert_eq!(decide(&rule, 8, 0.3), Verdict::NoInfluence);
    }

    #[test]
    fn nothing_seen_decides_nothing() {
        let rule = Rule { min_visits: 0, threshold: 0.0, ..Rule::default() };
        assert_eq!(decide(&rule, 0, 0.0), Verdict::Undecided);
        assert_eq!(basis(0), Basis::Prior);
    }

    #[test]
    fn the_evidence_rule_waits_for_its_prior() {
        let rule = Rule { kind: RuleKind::Evidence, ..Rule::default() };
        assert_eq!(decide(&rule, 1_000, 2.0), Verdict::Undecided);
    }
}
