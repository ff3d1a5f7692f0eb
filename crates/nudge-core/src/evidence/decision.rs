//! Decision rules: posterior probabilities and a rule in, a verdict out.

use crate::domain::{Basis, Dependence, Rule, RuleKind, Verdict};
use crate::information::Table;

/// How far counts must have moved the odds for a decision to be theirs and not the prior's.
const EARNED: f64 = 3.0;
/// From this probability dependence is established, and from the same of independence it is
/// excluded.
pub(super) const CERTAIN: f64 = 0.95;
/// The probability outside a 99.9 % interval, at each end: what is more certain than this is
/// settled, however certain it was before.
const SETTLED: f64 = 0.0005;
/// Observations below which nothing is earned, and up to which only moved odds are.
const FEWEST: u64 = 3;
const FEW: u64 = 4;

/// The posterior probabilities of one state, at a threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beliefs {
    /// P(MI > 0).
    pub dependent: f64,
    /// P(MI > threshold).
    pub above: f64,
    /// P(MI > threshold | MI > 0).
    pub above_if_dependent: f64,
}

/// Posterior beside prior probabilities of a state: what is believed of it, what was believed
/// before anything was counted, and how much was counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Believed {
    /// By the counts and the prior.
    pub now: Beliefs,
    /// By the prior alone: of [`Prior::unseen`](super::Prior::unseen).
    pub unseen: Beliefs,
    /// Independent observations: visits, or entries where stays are no decisions.
    pub observations: u64,
    /// Whether they can tell dependence from independence: there are three or more, and not in one
    /// row or column alone.
    pub tells: bool,
}

impl Believed {
    /// Compares what is believed of a state by these slices with what is believed of one never
    /// seen.
    pub fn new(now: Beliefs, unseen: Beliefs, slices: &[Table]) -> Self {
        let observations = slices.iter().map(Table::total).sum();
        let tells = observations >= FEWEST && !slices.iter().all(Table::is_line);
        Self {
            now,
            unseen,
            observations,
            tells,
        }
    }

    /// Compares how probable any dependence is by these slices with how probable it is in a state
    /// never seen.
    pub fn of_dependence(now: f64, unseen: f64, slices: &[Table]) -> Self {
        let any = |dependent: f64| Beliefs {
            dependent,
            above: dependent,
            above_if_dependent: 1.0,
        };
        Self::new(any(now), any(unseen), slices)
    }

    /// Returns whether mutual information is above the threshold, where that is probable enough and
    /// earned.
    fn decided(&self, confidence: f64) -> Option<bool> {
        let Self { now, unseen, .. } = self;
        let many = self.observations > FEW;

        if !self.tells {
            return None;
        }

        if now.above >= confidence
            && (rose(unseen.above, now.above) || (many && now.above >= 1.0 - SETTLED))
        {
            return Some(true);
        }

        let [weak, weak_before] = [now.above_if_dependent, unseen.above_if_dependent];
        let is_weak = 1.0 - weak >= confidence && fell(weak_before, weak);
        let is_earned = fell(unseen.above, now.above) || (many && (is_weak || weak <= SETTLED));
        (1.0 - now.above >= confidence && is_earned).then_some(false)
    }
}

/// Returns the verdict of a rule on a state with these visits, this plug-in mutual information in
/// nats, and what is believed of it.
///
/// The paper's rule: plug-in above the threshold where visits suffice. The evidence rule:
/// MI > threshold, or its opposite, is at least as probable as the rule's confidence, and the
/// counts have earned it: else a prior alone would call every rarely seen state free of influence.
/// Counts earn a verdict
///
/// * where they moved the odds of MI > threshold to at least three times, or at most a third, of
///   what they were;
/// * if there were more than four observations, also where they did so with the odds given
///   dependence (`no_influence`), or where all but one in two thousand of what is believed lies on
///   one side of the threshold (the other side of a 99.9 % interval): else certain counts would
///   decide nothing where the prior is as certain.
///
/// A table of one occupied row or column earns nothing, nor do two observations. Without a belief,
/// and without visits, nothing is decided.
pub fn decide(rule: &Rule, visits: u64, plug_in: f64, believed: Option<&Believed>) -> Verdict {
    match rule.kind {
        _ if visits == 0 => Verdict::Undecided,
        RuleKind::Paper if visits < rule.min_visits => Verdict::Undecided,
        RuleKind::Paper if plug_in > rule.threshold_nats() => Verdict::Influences,
        RuleKind::Paper => Verdict::NoInfluence,
        RuleKind::Evidence => match believed.and_then(|believed| believed.decided(rule.confidence))
        {
            Some(true) => Verdict::Influences,
            Some(false) => Verdict::NoInfluence,
            None => Verdict::Undecided,
        },
    }
}

/// Returns whether there is dependence at all, however weak: its posterior probability is at least
/// 0.95 or at most 0.05, and the counts have earned it as they earn a verdict.
pub fn dependence(believed: &Believed) -> Dependence {
    let Believed {
        now,
        unseen,
        observations,
        tells,
    } = believed;

    let is_settled = |p: f64| *observations > FEW && p >= 1.0 - SETTLED;
    let [is, was] = [now.dependent, unseen.dependent];

    if *tells && is >= CERTAIN && (rose(was, is) || is_settled(is)) {
        return Dependence::Established;
    }

    let is_excluded = *tells && 1.0 - is >= CERTAIN && (fell(was, is) || is_settled(1.0 - is));
    if is_excluded {
        Dependence::Excluded
    } else {
        Dependence::Open
    }
}

/// Returns whether what is believed with some agents held fixed explains a dependence that was
/// established without: the counts moved its odds to a third, or less, of what they were. That it
/// be excluded is not asked for: where nearly all states depend, few counts could.
pub fn is_explained(believed: &Believed) -> bool {
    let Believed {
        now, unseen, tells, ..
    } = believed;
    *tells && fell(unseen.dependent, now.dependent)
}

/// Returns whether what is believed with some agents held fixed establishes a dependence that was
/// not without, where the largest of so many was taken: the more sets of agents are looked at, the
/// more one must stand out (Bonferroni's correction, of odds).
pub fn is_opened(believed: &Believed, sets: u64) -> bool {
    let Believed {
        now, unseen, tells, ..
    } = believed;
    let sets = sets.max(1) as f64;
    *tells
        && odds(now.dependent) >= sets * odds(CERTAIN)
        && odds(now.dependent) >= sets * EARNED * odds(unseen.dependent)
}

fn odds(p: f64) -> f64 {
    p / (1.0 - p)
}

/// Returns whether the odds are at least three times what they were.
fn rose(before: f64, now: f64) -> bool {
    odds(now) >= EARNED * odds(before)
}

/// Returns whether the odds are at most a third of what they were.
fn fell(before: f64, now: f64) -> bool {
    EARNED * odds(now) <= odds(before)
}

/// Returns what a verdict on a state with these visits rests on.
pub fn basis(visits: u64) -> Basis {
    if visits == 0 {
        Basis::Prior
    } else {
        Basis::Counts(visits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Unit;

    fn paper(rule: Rule, visits: u64, plug_in: f64) -> Verdict {
        decide(
            &Rule {
                kind: RuleKind::Paper,
                ..rule
            },
            visits,
            plug_in,
            None,
        )
    }

    /// By many observations that tell, where dependence is as good as certain before and after.
    fn believed(unseen: f64, now: f64) -> Believed {
        let beliefs = |above| Beliefs {
            dependent: 0.99,
            above,
            above_if_dependent: above,
        };
        Believed {
            now: beliefs(now),
            unseen: beliefs(unseen),
            observations: 1_000,
            tells: true,
        }
    }

    fn evidence(believed: &Believed) -> Verdict {
        let rule = Rule {
            kind: RuleKind::Evidence,
            ..Rule::default()
        };
        decide(&rule, believed.observations, 9.0, Some(believed))
    }

    #[test]
    fn the_paper_decides_where_visits_suffice() {
        assert_eq!(paper(Rule::default(), 7, 9.0), Verdict::Undecided);
        assert_eq!(paper(Rule::default(), 8, 0.51), Verdict::Influences);
        assert_eq!(paper(Rule::default(), 8, 0.5), Verdict::NoInfluence);
    }

    #[test]
    fn a_threshold_in_bits_is_compared_in_bits() {
        let rule = Rule {
            unit: Unit::Bits,
            ..Rule::default()
        };
        assert_eq!(paper(rule, 8, 0.4), Verdict::Influences);
        assert_eq!(paper(rule, 8, 0.3), Verdict::NoInfluence);
    }

    #[test]
    fn nothing_seen_decides_nothing() {
        let rule = Rule {
            min_visits: 0,
            threshold: 0.0,
            ..Rule::default()
        };
        assert_eq!(paper(rule, 0, 0.0), Verdict::Undecided);
        assert_eq!(
            evidence(&Believed {
                observations: 0,
                ..believed(0.5, 0.99)
            }),
            Verdict::Undecided
        );
        assert_eq!([basis(0), basis(3)], [Basis::Prior, Basis::Counts(3)]);
    }

    #[test]
    fn evidence_decides_where_it_is_sure() {
        let told = [(0.3, 0.8), (0.3, 0.79), (0.9, 0.5), (0.5, 0.19), (0.0, 0.0)]
            .map(|(u, now)| evidence(&believed(u, now)));
        assert_eq!(
            told,
            [
                Verdict::Influences,
                Verdict::Undecided,
                Verdict::Undecided,
                Verdict::NoInfluence,
                Verdict::NoInfluence
            ]
        );
    }

    #[test]
    fn what_the_prior_knew_is_no_verdict() {
        // Odds of 1/99 are a third of 3/99, to which the prior amounts; 2/99 would not do.
        assert_eq!(evidence(&believed(3.0 / 102.0, 0.01)), Verdict::NoInfluence);
        assert_eq!(evidence(&believed(2.0 / 101.0, 0.01)), Verdict::Undecided);
        assert_eq!(evidence(&believed(0.9, 0.95)), Verdict::Undecided);
    }

    #[test]
    fn certain_counts_decide_where_the_prior_is_as_certain() {
        let certain = [(1e-9, 1e-10), (1e-9, 0.9e-9), (0.999_9, 0.999_9)];
        let told = certain.map(|(u, now)| evidence(&believed(u, now)));
        assert_eq!(
            told,
            [
                Verdict::NoInfluence,
                Verdict::NoInfluence,
                Verdict::Influences
            ]
        );
        // Four observations do not.
        let few = Believed {
            observations: 4,
            ..believed(1e-9, 0.9e-9)
        };
        assert_eq!(evidence(&few), Verdict::Undecided);
    }

    #[test]
    fn weakness_given_dependence_is_earned_by_itself() {
        // P(MI > t) hardly moved, since dependence became more probable while it became weaker.
        let mut weaker = believed(0.1, 0.09);
        [
            weaker.unseen.above_if_dependent,
            weaker.now.above_if_dependent,
        ] = [0.5, 0.1];
        assert_eq!(evidence(&weaker), Verdict::NoInfluence);
        assert_eq!(
            evidence(&Believed {
                observations: 4,
                ..weaker
            }),
            Verdict::Undecided
        );
    }

    #[test]
    fn weakness_that_is_not_sure_of_itself_earns_nothing() {
        // Its odds fell to a ninth, and one half is no certainty.
        let mut weaker = believed(0.1, 0.09);
        [
            weaker.unseen.above_if_dependent,
            weaker.now.above_if_dependent,
        ] = [0.9, 0.5];
        assert_eq!(evidence(&weaker), Verdict::Undecided);
    }

    #[test]
    fn what_cannot_tell_earns_nothing() {
        let line = Believed {
            tells: false,
            ..believed(0.5, 0.001)
        };
        assert_eq!(
            (evidence(&line), dependence(&line)),
            (Verdict::Undecided, Dependence::Open)
        );
    }

    #[test]
    fn three_visits_off_a_line_can_tell() {
        let tells = |cells: &[(u64, u64, u64)]| {
            let table = Table::from_counts(cells.iter().copied());
            let believed = Believed::of_dependence(0.9, 0.3, &[table]);
            assert_eq!(believed.now.above, 0.9);
            assert_eq!(believed.unseen.dependent, 0.3);
            (believed.observations, believed.tells)
        };
        assert_eq!(tells(&[(0, 0, 1), (1, 1, 1)]), (2, false));
        assert_eq!(tells(&[(0, 0, 2), (1, 1, 1)]), (3, true));
        assert_eq!(tells(&[(0, 0, 2), (0, 1, 7)]), (9, false));
        // Together, slices tell as much as one of them does.
        let slices = [[(0, 0, 2), (0, 1, 2)], [(0, 0, 1), (1, 1, 1)]].map(Table::from_counts);
        assert!(Believed::of_dependence(0.9, 0.3, &slices).tells);
    }

    #[test]
    fn five_observations_settle_what_four_do_not() {
        let certain = |observations| Believed {
            observations,
            ..believed(0.999_9, 0.999_9)
        };
        assert_eq!(
            [4, 5].map(|n| evidence(&certain(n))),
            [Verdict::Undecided, Verdict::Influences]
        );
        let excluded = |observations| {
            let mut believed = Believed {
                observations,
                ..believed(0.5, 0.5)
            };
            [believed.unseen.dependent, believed.now.dependent] = [1e-4, 1e-4];
            dependence(&believed)
        };
        assert_eq!(
            [4, 5].map(excluded),
            [Dependence::Open, Dependence::Excluded]
        );
    }

    #[test]
    fn without_a_belief_evidence_is_not_weighed() {
        let rule = Rule {
            kind: RuleKind::Evidence,
            ..Rule::default()
        };
        assert_eq!(decide(&rule, 1_000, 2.0, None), Verdict::Undecided);
    }

    #[test]
    fn a_third_of_the_odds_explains_and_many_sets_ask_for_more() {
        let told = |unseen, now| Believed {
            observations: 1_000,
            tells: true,
            ..Believed::of_dependence(now, unseen, &[Table::from_counts([(0, 0, 1)])])
        };
        // Odds of 3/7, then 1/7 and a little more.
        let explained = [told(0.3, 0.125), told(0.3, 0.126), told(0.999, 0.9)]
            .map(|believed| is_explained(&believed));
        assert_eq!(explained, [true, false, true]);
        let opened = |unseen, now, sets| is_opened(&told(unseen, now), sets);
        assert_eq!(
            [
                opened(0.3, 0.951, 1),
                opened(0.3, 0.951, 2),
                opened(0.3, 0.966, 2),
                opened(0.3, 0.98, 2)
            ],
            [true, false, false, true]
        );
        assert!(!opened(0.9, 0.96, 1), "the prior knew");
        assert!(!opened(0.3, 0.9, 0), "no set asks for as much as one");
        let line = Believed::of_dependence(0.999, 0.3, &[Table::from_counts([(0, 0, 9)])]);
        assert!(!is_opened(&line, 1) && !is_explained(&Believed::of_dependence(0.01, 0.3, &[])));
    }

    #[test]
    fn dependence_is_a_question_of_its_own() {
        let told = |unseen, now| {
            let mut believed = believed(0.5, 0.5);
            [believed.unseen.dependent, believed.now.dependent] = [unseen, now];
            dependence(&believed)
        };
        let open = [
            told(0.3, 0.5),
            told(0.5, 0.1),
            told(0.9, 0.95),
            told(0.1, 0.05),
        ];
        assert_eq!(open, [Dependence::Open; 4]);
        assert_eq!(
            [told(0.3, 0.95), told(0.3, 0.05)],
            [Dependence::Established, Dependence::Excluded]
        );
        // In an environment where all states depend, or none.
        assert_eq!(
            [told(0.999, 0.999_9), told(1e-3, 4e-4)],
            [Dependence::Established, Dependence::Excluded]
        );
    }
}
