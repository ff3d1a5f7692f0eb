//! Measures on small examples, and the laws they keep.

use proptest::collection::vec;
use proptest::prelude::*;

use super::*;

/// Sums of up to a hundred terms in another order.
const ROUNDING: f64 = 1e-12;

#[test]
fn auc_counts_pairs_in_order_and_ties_half() {
    assert_eq!(
        auc(&[(0.1, false), (0.4, true), (0.35, false), (0.8, true)]),
        Some(1.0)
    );
    // scikit-learn 1.7, roc_auc_score([0, 0, 1, 1], [0.1, 0.4, 0.35, 0.8])
    assert_eq!(
        auc(&[(0.1, false), (0.4, false), (0.35, true), (0.8, true)]),
        Some(0.75)
    );
    // Of four pairs one is in order and two are tied.
    assert_eq!(
        auc(&[(1.0, true), (2.0, true), (1.0, false), (2.0, false)]),
        Some(0.5)
    );
    assert_eq!(auc(&[(1.0, true), (2.0, true)]), None);
    assert_eq!(auc(&[]), None);
}

#[test]
fn hits_are_shares_of_what_was_called_and_of_what_is_so() {
    let hits = Hits::of_decisions([
        (true, true),
        (true, true),
        (true, false),
        (false, true),
        (false, false),
        (true, true),
    ]);
    assert_eq!(
        hits,
        Hits {
            right: 3,
            wrong: 1,
            missed: 1
        }
    );
    assert_eq!(
        (hits.precision(), hits.recall(), hits.f1()),
        (Some(0.75), Some(0.75), Some(0.75))
    );
    let silent = Hits::of_decisions([(false, true)]);
    assert_eq!(
        (silent.precision(), silent.recall(), silent.f1()),
        (None, Some(0.0), Some(0.0))
    );
    let nothing_there = Hits::of_decisions([(true, false)]);
    assert_eq!(
        (
            nothing_there.precision(),
            nothing_there.recall(),
            nothing_there.f1()
        ),
        (Some(0.0), None, None)
    );
}

#[test]
fn a_spread_is_over_seeds() {
    let spread = Spread::of_values(&[1.0, 2.0, 3.0, 6.0]).expect("four");
    assert_eq!((spread.mean, spread.seeds), (3.0, 4));
    assert!((spread.sd.expect("more than one") - (14.0_f64 / 3.0).sqrt()).abs() < ROUNDING);
    assert_eq!(
        Spread::of_values(&[2.5]),
        Some(Spread {
            mean: 2.5,
            sd: None,
            seeds: 1
        })
    );
    assert_eq!(Spread::of_values(&[]), None);
}

#[test]
fn errors_are_squared_before_they_are_averaged() {
    assert_eq!(
        rmse([(1.0, 4.0), (2.0, -3.0), (0.0, 0.0)]),
        Some((34.0_f64 / 3.0).sqrt())
    );
    assert_eq!(rmse([]), None);
    assert_eq!(frequency([true, false, false, true]), Some(0.5));
}

/// Few different scores, so that ties are common.
fn scored() -> impl Strategy<Value = Vec<(f64, bool)>> {
    vec(((0..8).prop_map(f64::from), any::<bool>()), 0..40)
}

proptest! {
    #[test]
    fn auc_is_what_comparing_every_pair_gives(scored in scored()) {
        let of = |wanted| scored.iter().filter(move |(_, with)| *with == wanted).map(|(score, _)| *score);
        let won = |with: f64, without: f64| if with == without { 0.5 } else { f64::from(u8::from(with > without)) };
        let pairs = of(true).flat_map(|with| of(false).map(move |without| won(with, without)));
        match (auc(&scored), mean(pairs)) {
            (Some(by_ranks), Some(by_pairs)) => prop_assert!((by_ranks - by_pairs).abs() < ROUNDING),
            neither => prop_assert_eq!(neither, (None, None)),
        }
    }

    #[test]
    fn scores_turned_around_turn_the_area_around(scored in scored()) {
        let turned: Vec<(f64, bool)> = scored.iter().map(|(score, with)| (-score, *with)).collect();
        if let (Some(area), Some(turned)) = (auc(&scored), auc(&turned)) {
            prop_assert!((area + turned - 1.0).abs() < ROUNDING);
        }
    }

    #[test]
    fn f1_lies_between_precision_and_recall(decisions in vec(any::<(bool, bool)>(), 1..40)) {
        let hits = Hits::of_decisions(decisions);
        if let (Some(precision), Some(recall), Some(f1)) = (hits.precision(), hits.recall(), hits.f1()) {
            prop_assert!(f1 >= precision.min(recall) - ROUNDING && f1 <= precision.max(recall) + ROUNDING);
        }
    }
}
