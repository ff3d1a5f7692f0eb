//! Scores of probabilistic predictions on held-out states: precision, recall, F1, AUROC, Brier
//! score and reliability.
//!
//! The truth of a state is not known, only its probability y given its counts: a state counts as
//! positive by y and as negative by 1 - y, times its weight. All figures are what they would be on
//! average if truths were drawn from the evidence.

use crate::domain::{Reliability, Score};

/// From this probability a state is called.
const CALLED: f64 = 0.5;

/// A state that is judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judged {
    /// The predicted probability.
    pub predicted: f64,
    /// P(MI > threshold) given its counts.
    pub evidence: f64,
    /// How much it counts.
    pub weight: f64,
}

impl Judged {
    fn positive(&self) -> f64 {
        self.weight * self.evidence
    }

    fn negative(&self) -> f64 {
        self.weight * (1.0 - self.evidence)
    }
}

/// Scores predictions as a binary classifier and as probabilities.
pub fn score(name: &str, judged: &[Judged], log_likelihood: Option<f64>) -> Score {
    let sum = |figure: &dyn Fn(&Judged) -> f64| judged.iter().map(figure).sum::<f64>();
    let called = |of: &dyn Fn(&Judged) -> f64| {
        sum(&|one| {
            if one.predicted >= CALLED {
                of(one)
            } else {
                0.0
            }
        })
    };

    let (hits, calls) = (called(&Judged::positive), called(&|one| one.weight));
    let (positives, total) = (sum(&Judged::positive), sum(&|one| one.weight));
    let squared = |one: &Judged| {
        one.positive() * (1.0 - one.predicted).powi(2) + one.negative() * one.predicted.powi(2)
    };

    Score {
        name: name.to_owned(),
        log_likelihood,
        auroc: auroc(judged),
        precision: ratio(hits, calls),
        recall: ratio(hits, positives),
        f1: ratio(2.0 * hits, calls + positives).unwrap_or(0.0),
        brier: ratio(sum(&squared), total).unwrap_or(0.0),
    }
}

/// Returns the area under the ROC curve: the probability that a positive state is ranked above a
/// negative one, equal ranks counting one half; `None` where all are equal, or there are only
/// positive or only negative ones.
pub fn auroc(judged: &[Judged]) -> Option<f64> {
    let mut ranked = judged.to_vec();
    ranked.sort_by(|a, b| a.predicted.total_cmp(&b.predicted));
    let groups: Vec<&[Judged]> = ranked.chunk_by(|a, b| a.predicted == b.predicted).collect();
    if groups.len() < 2 {
        return None;
    }

    let [mut below, mut pairs, mut positives, mut themselves] = [0.0; 4];
    for group in groups {
        let positive: f64 = group.iter().map(Judged::positive).sum();
        let negative: f64 = group.iter().map(Judged::negative).sum();
        // A state is not ranked against itself.
        let own: f64 = group
            .iter()
            .map(|one| one.positive() * one.negative())
            .sum();

        pairs += positive * (below + 0.5 * negative) - 0.5 * own;
        below += negative;
        positives += positive;
        themselves += own;
    }

    ratio(pairs, positives * below - themselves)
}

/// Returns the reliability diagram: predictions beside the evidence, in tenths.
pub fn reliability(judged: &[Judged]) -> Vec<Reliability> {
    let tenth = |one: &Judged| ((one.predicted * 10.0) as usize).min(9);
    let bin = |at: usize| {
        let inside: Vec<&Judged> = judged.iter().filter(|one| tenth(one) == at).collect();
        let weight: f64 = inside.iter().map(|one| one.weight).sum();
        (weight > 0.0).then(|| Reliability {
            from: at as f64 / 10.0,
            states: inside.len() as u64,
            predicted: inside
                .iter()
                .map(|one| one.weight * one.predicted)
                .sum::<f64>()
                / weight,
            observed: inside.iter().map(|one| one.positive()).sum::<f64>() / weight,
        })
    };
    (0..10).filter_map(bin).collect()
}

fn ratio(part: f64, whole: f64) -> Option<f64> {
    (whole > 0.0).then(|| part / whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(of: &[(f64, f64)]) -> Vec<Judged> {
        of.iter()
            .map(|(predicted, evidence)| Judged {
                predicted: *predicted,
                evidence: *evidence,
                weight: 1.0,
            })
            .collect()
    }

    #[test]
    fn certain_truths_give_the_usual_figures() {
        let score = score(
            "x",
            &judged(&[(0.9, 1.0), (0.6, 0.0), (0.4, 1.0), (0.1, 0.0)]),
            None,
        );
        assert_eq!(
            (score.precision, score.recall, score.f1, score.auroc),
            (Some(0.5), Some(0.5), 0.5, Some(0.75))
        );
        assert!((score.brier - (0.01 + 0.36 + 0.36 + 0.01) / 4.0).abs() < 1e-15);
    }

    #[test]
    fn what_calls_nothing_has_no_precision() {
        let score = score("x", &judged(&[(0.2, 0.5), (0.2, 0.1)]), None);
        assert_eq!(
            (score.precision, score.recall, score.f1, score.auroc),
            (None, Some(0.0), 0.0, None)
        );
    }

    #[test]
    fn weights_count_like_copies() {
        let once = judged(&[(0.9, 0.7), (0.3, 0.2), (0.3, 0.2)]);
        let weighted = [
            once[0],
            Judged {
                weight: 2.0,
                ..once[1]
            },
        ];
        let [once, weighted] = [score("x", &once, None), score("x", &weighted, None)];
        assert!(
            (once.f1 - weighted.f1).abs() < 1e-12 && (once.brier - weighted.brier).abs() < 1e-12
        );
    }

    #[test]
    fn a_state_is_not_ranked_against_itself() {
        // Of the two possible truths that rank anything, both put the positive state first.
        assert_eq!(auroc(&judged(&[(0.9, 0.5), (0.1, 0.0)])), Some(1.0));
    }

    #[test]
    fn reliability_is_told_in_tenths() {
        let curve = reliability(&judged(&[(0.95, 0.9), (1.0, 1.0), (0.0, 0.1)]));
        assert_eq!(
            curve
                .iter()
                .map(|bin| (bin.from, bin.states))
                .collect::<Vec<_>>(),
            [(0.0, 1), (0.9, 2)]
        );
        assert!((curve[1].observed - 0.95).abs() < 1e-15);
    }
}
