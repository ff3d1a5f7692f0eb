//! What Bayes factors promise: reference values, sampling, and what speaks for or against.

use rand::SeedableRng;
use rand_distr::{Distribution, Gamma};
use rand_pcg::Pcg64;

use super::*;
use crate::information::samples::grid;

const COIN: Alphabet = Alphabet {
    rows: 2,
    columns: 2,
};
const COPIES: [f64; 4] = [0.95, 0.05, 0.05, 0.95];
const IGNORES: [f64; 4] = [0.5; 4];

/// Twenty states in which the other copies, as expected or not, and as many in which it throws
/// a coin.
fn found(expected: [&[f64]; 2]) -> (f64, f64) {
    let copied = Table::from_counts([(0, 0, 3), (1, 1, 3)]);
    let thrown = Table::from_counts([(0, 0, 2), (0, 1, 1), (1, 0, 1), (1, 1, 2)]);
    let state = |at: usize| ExpectedResponse {
        share: 1.0,
        table: if at < 20 { &copied } else { &thrown },
        ego: &[0.5, 0.5],
        response: expected[usize::from(at >= 20)],
    };
    let states: Vec<ExpectedState<'_>> = (0..40).map(|at| vec![state(at)]).collect();
    let factors = bayes_factors(&states, COIN, &Base::new(&[100, 100]), 0.3);
    (factors[0], factors[39])
}

#[test]
fn what_was_expected_and_happened_speaks_for_itself() {
    let (copied, thrown) = found([&COPIES, &IGNORES]);
    assert!(copied > 5.0 && thrown < 1.5, "{copied} {thrown}");
}

#[test]
fn what_was_expected_and_did_not_happen_speaks_against_it() {
    let (copied, thrown) = found([&COPIES, &COPIES]);
    assert!(copied > 5.0 && thrown < 0.5, "{copied} {thrown}");
}

/// Draws the rows and the policy of a state and returns how often mutual information is above
/// the threshold.
fn sampled(counts: &Counts, ego: &[f64], rows: &[f64], k: f64, question: Question) -> f64 {
    const DRAWS: usize = 1_000;
    let mut random = Pcg64::seed_from_u64(7);
    let mut dirichlet = |parameters: Vec<f64>| {
        let gammas = parameters
            .into_iter()
            .map(|a| Gamma::new(a, 1.0).expect("above 0").sample(&mut random));
        let drawn: Vec<f64> = gammas.map(|x: f64| x.max(1e-300)).collect();
        let sum: f64 = drawn.iter().sum();
        drawn.into_iter().map(|x| x / sum).collect::<Vec<f64>>()
    };
    let columns = question.alphabet.columns as usize;
    let is_above = |_: &usize| {
        let p = dirichlet(
            ego.iter()
                .zip(&counts.rows)
                .map(|(p, r)| r + question.kappa * p)
                .collect(),
        );
        let row = |i: usize| {
            (0..columns)
                .map(|j| counts.cells[i * columns + j] + k * rows[i * columns + j])
                .collect()
        };
        let drawn: Vec<Vec<f64>> = (0..ego.len()).map(|i| dirichlet(row(i))).collect();
        let q = |j: usize| p.iter().zip(&drawn).map(|(p, row)| p * row[j]).sum::<f64>();
        let q: Vec<f64> = (0..columns).map(q).collect();
        let divergence = |row: &Vec<f64>| {
            row.iter()
                .zip(&q)
                .map(|(rho, q)| rho * (rho / q).ln())
                .sum::<f64>()
        };
        p.iter()
            .zip(&drawn)
            .map(|(p, row)| p * divergence(row))
            .sum::<f64>()
            > question.threshold
    };
    (0..DRAWS).filter(is_above).count() as f64 / DRAWS as f64
}

/// Responses of which each row has half of its mass on a letter of its own.
fn leaning(rows: usize, columns: usize) -> Vec<f64> {
    let share = |at: usize| {
        0.5 / columns as f64
            + if at % columns == (at / columns) % columns {
                0.5
            } else {
                0.0
            }
    };
    (0..rows * columns).map(share).collect()
}

/// Draws of which each is the ego's turn, and copied or not.
fn played(alphabet: Alphabet, visits: u64, copied_of_four: u64) -> Table {
    let other = |n: u64| {
        if n % 4 < copied_of_four {
            n % alphabet.rows
        } else {
            7 * n + n / 5
        }
    };
    Table::from_counts((0..visits).map(|n| (n % alphabet.rows, other(n) % alphabet.columns, 1)))
}

#[test]
fn tails_are_those_of_sampled_rows() {
    /// With few draws, where a Beta distribution is too wide for what is nearly certain, and
    /// with some thirty. Sampling errs by .02 or .03 itself.
    const CRUDE: f64 = 0.17;
    const CLOSE: f64 = 0.13;
    for (rows, columns) in [(2, 2), (3, 25), (6, 6), (25, 3)] {
        let alphabet = Alphabet { rows, columns };
        let ego = vec![1.0 / rows as f64; rows as usize];
        let z = leaning(rows as usize, columns as usize);
        for (k, visits, copied, share) in (SLABS.iter().map(|(_, k)| *k).take(3))
            .flat_map(|k| [0, 8, 30, 120].map(|visits| (k, visits)))
            .flat_map(|(k, visits)| [0, 3].map(|copied| (k, visits, copied)))
            .flat_map(|(k, visits, copied)| [0.1, 0.3, 0.6].map(|share| (k, visits, copied, share)))
        {
            let question = Question {
                alphabet,
                threshold: share * alphabet.largest_information(),
                kappa: 16.0,
            };
            let counts = Counts::from_table(&played(alphabet, visits, copied), alphabet);
            let told = tail(moments(&counts, &ego, &z, k, question), question);
            let truth = sampled(&counts, &ego, &z, k, question);
            let tolerance = if visits < 30 { CRUDE } else { CLOSE };
            assert!(
                (told - truth).abs() < tolerance,
                "{rows}x{columns} {k} {visits} {copied} {share}: {told} {truth}"
            );
        }
    }
}

#[test]
fn draws_that_leave_little_room_speak_against_it() {
    // It was expected to copy, and the slabs are sure of it; it does so seldom, as forty draws
    // show.
    let table = Table::from_counts([(0, 0, 12), (0, 1, 8), (1, 0, 8), (1, 1, 12)]);
    let state = || ExpectedResponse {
        share: 1.0,
        table: &table,
        ego: &[0.5, 0.5],
        response: &COPIES,
    };
    let states: Vec<ExpectedState<'_>> = (0..30).map(|_| vec![state()]).collect();
    let factors = bayes_factors(&states, COIN, &Base::new(&[100, 100]), 0.3);
    assert!(factors.iter().all(|factor| *factor < 0.05), "{factors:?}");
}

#[test]
fn policies_that_states_keep_to_are_worth_many_draws() {
    let even = Table::from_counts([(0, 0, 10), (1, 1, 10)]);
    let [one, other] = [0, 1].map(|action| Table::from_counts([(action, 0, 20)]));
    let kappa = |tables: [&Table; 2]| {
        let state = |table| ExpectedResponse {
            share: 1.0,
            table,
            ego: &[0.5, 0.5],
            response: &IGNORES,
        };
        policy_concentration(&[0, 1, 0, 1].map(|at: usize| vec![state(tables[at])]))
    };
    assert!(kappa([&even, &even]) >= 128.0 && kappa([&one, &other]) <= 1.0);
    assert!(policy_concentration(&[]) > 0.0);
}

#[test]
fn a_state_without_draws_says_nothing() {
    let empty = Table::default();
    let state = ExpectedResponse {
        share: 1.0,
        table: &empty,
        ego: &[0.5, 0.5],
        response: &COPIES,
    };
    let factor = bayes_factors(&[vec![state]], COIN, &Base::new(&[1, 1]), 0.3)[0];
    assert!((factor - 1.0).abs() < 1e-9, "{factor}");
}

/// What is asked: counts, the ego's expected policy, the expected responses row by row, how many
/// states are of the kind, and the Bayes factor.
type Kind<'a> = (&'a [&'a [u64]], &'a [f64], &'a [f64], usize, f64);

fn assert_bayes_factors(kinds: &[Kind<'_>], base: &[u64], threshold: f64) {
    /// Relative: continued fractions end at 1e-10.
    const PRECISION: f64 = 1e-8;
    let tables: Vec<Table> = kinds.iter().map(|(counts, ..)| grid(counts)).collect();
    let states: Vec<ExpectedState<'_>> = kinds
        .iter()
        .zip(&tables)
        .flat_map(|(&(_, ego, response, times, _), table)| {
            (0..times).map(move |_| {
                vec![ExpectedResponse {
                    share: 1.0,
                    table,
                    ego,
                    response,
                }]
            })
        })
        .collect();
    let alphabet = Alphabet {
        rows: kinds[0].0.len() as u64,
        columns: base.len() as u64,
    };

    let factors = bayes_factors(&states, alphabet, &Base::new(base), threshold);

    let expected = kinds
        .iter()
        .flat_map(|&(.., times, expected)| std::iter::repeat_n(expected, times));
    for (at, (factor, expected)) in factors.into_iter().zip(expected).enumerate() {
        assert!(
            (factor / expected - 1.0).abs() < PRECISION,
            "state {at}: {factor} instead of {expected}"
        );
    }
}

/// References: tests/golden/bayes_factors.py, mpmath 1.4.1 at 40 digits from the formulas of this
/// module's docs.
#[test]
fn bayes_factors_of_two_by_three_actions_match_the_references() {
    const LEFT_OR_RIGHT: &[f64] = &[0.8, 0.1, 0.1, 0.1, 0.1, 0.8];
    const LEANS: &[f64] = &[0.25, 0.25, 0.5, 0.5, 0.25, 0.25];
    const NEVER: &[f64] = &[1.0, 0.0, 0.0, 0.0, 0.5, 0.5];
    const EVEN: &[f64] = &[0.5, 0.5];
    assert_bayes_factors(
        &[
            (
                &[&[6, 1, 0], &[0, 2, 5]],
                EVEN,
                LEFT_OR_RIGHT,
                7,
                193.815_284_599_9,
            ),
            (
                &[&[3, 2, 3], &[2, 4, 2]],
                EVEN,
                LEFT_OR_RIGHT,
                5,
                1.806_523_648_83e-4,
            ),
            (
                &[&[4, 1, 9], &[1, 0, 2]],
                &[0.75, 0.25],
                LEANS,
                4,
                0.059_554_001_424_82,
            ),
            (&[&[0, 0, 0], &[0, 0, 0]], &[0.75, 0.25], LEANS, 3, 1.0),
            (
                &[&[5, 0, 0], &[0, 0, 6]],
                &[0.25, 0.75],
                NEVER,
                2,
                1_455.603_910_714,
            ),
            (
                &[&[0, 7, 0], &[0, 0, 4]],
                EVEN,
                NEVER,
                1,
                0.003_232_650_973_204,
            ),
        ],
        &[40, 25, 60],
        0.2,
    );
}

/// References: as above. More rows than columns, rows never seen, a state of one observation and
/// one of hundreds.
#[test]
fn bayes_factors_of_three_by_two_actions_match_the_references() {
    const LEANS: &[f64] = &[0.9, 0.1, 0.25, 0.75, 0.1, 0.9];
    const SURE: &[f64] = &[0.9, 0.1, 0.05, 0.95, 0.5, 0.5];
    const FIRST: &[f64] = &[0.5, 0.25, 0.25];
    const LAST: &[f64] = &[0.25, 0.25, 0.5];
    assert_bayes_factors(
        &[
            (
                &[&[8, 0], &[1, 6], &[0, 9]],
                LAST,
                LEANS,
                3,
                32.761_446_052_6,
            ),
            (
                &[&[40, 41], &[22, 18], &[30, 33]],
                FIRST,
                &[0.5; 6],
                6,
                1.832_775_688_061e-11,
            ),
            (
                &[&[9, 1], &[0, 0], &[7, 2]],
                FIRST,
                &[0.75, 0.25, 0.75, 0.25, 0.75, 0.25],
                4,
                0.003_802_947_220_307,
            ),
            (
                &[&[0, 5], &[1, 1], &[6, 0]],
                LAST,
                LEANS,
                2,
                2.874_339_216_757e-5,
            ),
            (
                &[&[1, 0], &[0, 0], &[0, 0]],
                LAST,
                LEANS,
                5,
                1.973_941_704_317,
            ),
            (
                &[&[300, 20], &[4, 90], &[33, 31]],
                &[0.75, 0.125, 0.125],
                SURE,
                1,
                5.370_648_198_793,
            ),
        ],
        &[500, 300],
        0.3,
    );
}

#[test]
fn more_than_is_possible_has_nothing_for_it() {
    let table = grid(&[&[9, 0], &[0, 9]]);
    let state = vec![ExpectedResponse {
        share: 1.0,
        table: &table,
        ego: &[0.5, 0.5],
        response: &COPIES,
    }];
    for threshold in [2_f64.ln(), 1.0] {
        let factors = bayes_factors(
            std::slice::from_ref(&state),
            COIN,
            &Base::new(&[1, 1]),
            threshold,
        );
        assert_eq!(factors, [(-MOST_CERTAIN).exp()]);
    }
}

#[test]
fn a_stratum_that_holds_all_is_the_state() {
    // What is held fixed is expected to be the first, and was: the second has nothing to say.
    let (table, empty) = (grid(&[&[6, 1], &[2, 5]]), Table::default());
    let stratum = |table, share| ExpectedResponse {
        share,
        table,
        ego: &[0.5, 0.5],
        response: &COPIES,
    };
    let factors =
        |states: [ExpectedState<'_>; 2]| bayes_factors(&states, COIN, &Base::new(&[8, 6]), 0.3);
    let alone = || vec![stratum(&table, 1.0)];
    let beside = || vec![stratum(&table, 1.0), stratum(&empty, 0.0)];
    assert_eq!(factors([alone(), alone()]), factors([beside(), beside()]));
}

#[test]
fn dependence_within_strata_speaks_and_what_they_hold_fixed_does_not() {
    // The other repeats what is held fixed, and so does the ego: by itself that looks like a copy.
    let repeated: [Table; 2] = [
        Table::from_counts([(0, 0, 9), (0, 1, 1), (1, 0, 1)]),
        Table::from_counts([(1, 1, 9), (0, 1, 1), (1, 0, 1)]),
    ];
    let copied: [Table; 2] =
        [(); 2].map(|()| Table::from_counts([(0, 0, 5), (1, 1, 5), (0, 1, 1)]));
    let states: Vec<ExpectedState<'_>> = (0..40)
        .map(|at| if at < 20 { &copied } else { &repeated })
        .map(|tables| {
            let stratum = |table| ExpectedResponse {
                share: 0.5,
                table,
                ego: &[0.5, 0.5],
                response: &COPIES,
            };
            tables.iter().map(stratum).collect()
        })
        .collect();
    let factors = bayes_factors(&states, COIN, &Base::new(&[100, 100]), 0.3);
    assert!(factors[0] > 5.0 && factors[39] < 0.5, "{factors:?}");
}

#[test]
fn moments_of_strata_are_those_of_sampled_weights() {
    /// Of 20,000 draws of the weights, whose part is what is new here.
    const CLOSE: f64 = 2e-3;
    let (alphabet, kappa) = (COIN, 4.0);
    let question = Question {
        alphabet,
        threshold: 0.3,
        kappa,
    };
    let tables = [grid(&[&[3, 0], &[0, 3]]), grid(&[&[2, 2], &[2, 2]])];
    let counts = [0, 1].map(|at: usize| Counts::from_table(&tables[at], alphabet));
    let rows = [COPIES.to_vec(), IGNORES.to_vec()];
    let (state, shares): (ExpectedState<'_>, [f64; 2]) = (
        (0..2)
            .map(|at| ExpectedResponse {
                share: [0.25, 0.75][at],
                table: &tables[at],
                ego: &[0.5, 0.5],
                response: &rows[at],
            })
            .collect(),
        [6.0 + kappa * 0.25, 8.0 + kappa * 0.75],
    );
    let told = conditional_moments(&counts, &state, &rows, 3.0, question);

    let each = [0, 1].map(|at: usize| moments(&counts[at], &[0.5, 0.5], &rows[at], 3.0, question));
    let mut random = Pcg64::seed_from_u64(7);
    let mut drawn = || {
        let [a, b] =
            shares.map(|share| Gamma::new(share, 1.0).expect("above 0").sample(&mut random));
        a / (a + b)
    };
    let draws: Vec<f64> = (0..20_000).map(|_| drawn()).collect();
    let mean = |of: &dyn Fn(f64) -> f64| draws.iter().map(|w| of(*w)).sum::<f64>() / 20_000.0;
    let conditional = |w: f64| w * each[0].0 + (1.0 - w) * each[1].0;
    let expected = mean(&conditional);
    let within = mean(&|w| w * w * each[0].1 + (1.0 - w).powi(2) * each[1].1);
    let between = mean(&|w| (conditional(w) - expected).powi(2));
    assert!((told.0 - expected).abs() < CLOSE, "{told:?} {expected}");
    assert!((told.1 - within - between).abs() < CLOSE, "{told:?}");
}
