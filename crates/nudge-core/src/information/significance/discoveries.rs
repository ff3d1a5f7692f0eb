//! Multiple testing by the false discovery rate: which of many states to call influenced, so that
//! few of those called are called wrongly. Neither rule asks how strong an influence is.

/// Returns which tests to reject at a false discovery rate of `alpha`: of those rejected, at most
/// that share is expected to be wrong (Benjamini & Hochberg 1995): all with p at most p_(k), for
/// the largest k with p_(k) <= alpha k / m.
///
/// Leave out beforehand the states that cannot pass, whose [`smallest_p`](super::smallest_p) is
/// above `alpha`: they count in m and make the others harder to see. What is left out must not
/// depend on the p-values.
///
/// Holds for independent tests, and for those that tend to err together (Benjamini & Yekutieli
/// 2001).
pub fn benjamini_hochberg(p_values: &[f64], alpha: f64) -> Vec<bool> {
    let share = alpha / p_values.len() as f64;
    let mut ascending = p_values.to_vec();
    ascending.sort_unstable_by(f64::total_cmp);

    let passing = ascending
        .iter()
        .zip(1_u32..)
        .filter(|&(&p, k)| p <= share * f64::from(k))
        .last();

    p_values
        .iter()
        .map(|&p| passing.is_some_and(|(&threshold, _)| p <= threshold))
        .collect()
}

/// Returns the q-value of each test (Storey 2002, with all hypotheses taken for true): the smallest
/// false discovery rate at which [`benjamini_hochberg`] rejects it, min over p_(k) >= p of
/// m p_(k) / k, in \[0, 1\].
pub fn q_values(p_values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p_values.len()).collect();
    order.sort_by(|a, b| p_values[*b].total_cmp(&p_values[*a]));

    let all = p_values.len() as f64;
    let mut q_values = vec![1.0; p_values.len()];
    let (mut smallest, mut k) = (1.0_f64, all);
    for at in order {
        smallest = smallest.min(all * p_values[at] / k);
        q_values[at] = smallest;
        k -= 1.0;
    }
    q_values
}

/// What 1 - P may be off by: at a level of .05, P = .95 is to be chosen.
const ROUNDING: f64 = 1e-12;

/// Returns which states to call at a Bayesian false discovery rate of `level`: the most whose mean
/// probability of having no influence is at most that, the likeliest first, given each one's
/// probability of having some (Newton, Noueiry, Sarkar & Ahlquist
/// 2004).
///
/// Of those chosen, at most a share `level` is expected to be wrong, if the probabilities can be
/// believed. Equal probabilities are chosen or left together, so that the order of the states does
/// not matter.
pub fn bayesian_fdr(p_dependent: &[f64], level: f64) -> Vec<bool> {
    let mut descending = p_dependent.to_vec();
    descending.sort_unstable_by(|a, b| b.total_cmp(a));

    let mut threshold = f64::INFINITY;
    let (mut chosen, mut wrong) = (0.0, 0.0);

    for equal in descending.chunk_by(|a, b| a == b) {
        chosen += equal.len() as f64;
        wrong += equal.len() as f64 * (1.0 - equal[0]);
        if wrong <= (level + ROUNDING) * chosen {
            threshold = equal[0];
        }
    }

    p_dependent.iter().map(|&p| p >= threshold).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn rejects_the_four_of_the_original_example() {
        // Benjamini & Hochberg 1995, section 3.1: 15 hypotheses, of which .05 rejects the first
        // four.
        let p_values = [
            0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262,
            0.5719, 0.6528, 0.7590, 1.0,
        ];

        let rejected = benjamini_hochberg(&p_values, 0.05);

        assert_eq!(rejected.iter().filter(|rejected| **rejected).count(), 4);
        assert!(rejected[..4].iter().all(|rejected| *rejected));
    }

    #[test]
    fn a_later_p_value_carries_the_earlier_ones() {
        assert_eq!(
            benjamini_hochberg(&[0.05, 0.04, 0.9], 0.08),
            [true, true, false]
        );
        assert!(benjamini_hochberg(&[], 0.05).is_empty());
    }

    #[test]
    fn chooses_while_the_mean_doubt_is_small_enough() {
        // Mean doubts of the likeliest 1, 2, 3, 4: .01, .015, .043, .158.
        assert_eq!(
            bayesian_fdr(&[0.5, 0.99, 0.9, 0.98], 0.05),
            [false, true, true, true]
        );
        assert_eq!(bayesian_fdr(&[0.95], 0.05), [true]);
        assert_eq!(bayesian_fdr(&[0.94], 0.05), [false]);
    }

    #[test]
    fn equals_are_chosen_or_left_together() {
        assert_eq!(bayesian_fdr(&[0.9, 1.0, 0.9], 0.05), [false, true, false]);
        assert_eq!(bayesian_fdr(&[0.9, 1.0, 1.0, 0.9], 0.05), [true; 4]);
    }

    proptest! {
        #[test]
        fn a_q_value_is_the_rate_from_which_a_test_passes(p_values in prop::collection::vec(0.0..1.0_f64, 0..9)) {
            let q_values = q_values(&p_values);
            for (at, q) in q_values.iter().enumerate() {
                prop_assert!((p_values[at] - 1e-12..=1.0).contains(q));
                prop_assert!(benjamini_hochberg(&p_values, q + 1e-9)[at]);
                prop_assert!(!benjamini_hochberg(&p_values, q - 1e-9)[at] || *q == 1.0);
            }
        }

        #[test]
        fn order_does_not_matter(
            (one, other) in prop::collection::vec(0..=20_u32, 0..20).prop_flat_map(|v| (Just(v.clone()), Just(v).prop_shuffle())),
        ) {
            for rule in [benjamini_hochberg, |p: &[f64], level| bayesian_fdr(p, level)] {
                let chosen = |values: &[u32]| {
                    let shares: Vec<f64> = values.iter().map(|&value| f64::from(value) / 20.0).collect();
                    let mut chosen: Vec<_> = values.iter().copied().zip(rule(&shares, 0.1)).collect();
                    chosen.sort_unstable();
                    chosen
                };
                prop_assert_eq!(chosen(&one), chosen(&other));
            }
        }
    }
}
