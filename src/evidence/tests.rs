//! What the whole of a fit, a prior and its posteriors promise.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use statrs::function::gamma::{digamma, ln_gamma};

use super::parameters::{FIXED, NULL_CONCENTRATIONS, NULL_GRID, NULLS, SLAB_CONCENTRATIONS, SLAB_GRID, SLABS};
use super::*;
use crate::domain::{Dependence, Rule, RuleKind};
use crate::information::{Alphabet, Table};

const SIX: Alphabet = Alphabet { rows: 6, columns: 6 };
const BASE: [u64; 6] = [50, 3, 0, 20, 9, 18];

fn grid(counts: &[&[u64]]) -> Table {
    let cells = counts.iter().zip(0..).flat_map(|(row, i)| row.iter().zip(0..).map(move |(&n, j)| (i, j, n)));
    Table::from_counts(cells)
}

fn cold() -> Prior {
    Prior::new(&Fit::cold(SIX, Base::new(&BASE)))
}

/// A prior with every weight its own.
fn uneven() -> Fit {
    let weights = |count: usize| {
        let total = (count * (count + 1) / 2) as f64;
        (1..=count).map(|at| at as f64 / total).collect::<Vec<f64>>()
    };
    let parameters = Parameters { dependent: 0.137, nulls: weights(NULLS), slabs: weights(SLABS) };
    Fit { alphabet: SIX, base: Base::new(&BASE), parameters, states: 7 }
}

fn of(prior: &Prior, table: &Table) -> Posterior {
    prior.posterior(std::slice::from_ref(table))
}

/// The ego's action decides the other's, or does nothing.
fn copied(each: u64) -> Table {
    Table::from_counts((0..6).map(|action| (action, action, each)))
}

fn coins(each: u64) -> Table {
    Table::from_counts((0..36).map(|cell| (cell / 6, cell % 6, each)))
}

/// Each of the ego's actions makes one of the other's about twice as likely.
fn leaning(each: u64) -> Table {
    Table::from_counts((0..36).map(|cell| (cell / 6, cell % 6, each * if cell % 7 == 0 { 15 } else { 7 })))
}

#[test]
fn what_cannot_tell_leaves_the_prior_exactly() {
    let prior = Prior::new(&uneven());

    let row = grid(&[&[0; 6], &[900, 3, 0, 0, 1, 0]]);
    let column = grid(&[&[0, 5], &[0, 7], &[0, 1]]);
    for slices in [vec![], vec![Table::default()], vec![row.clone()], vec![column.clone()], vec![row, column]] {
        assert_eq!(prior.posterior(&slices).dependent(), 0.137);
        assert_eq!(prior.dependent(&slices), 0.137);
    }
    assert_eq!(prior.posterior(&[]), *prior.unseen());
}

#[test]
fn dependence_and_strength_are_two_answers() {
    let prior = cold();
    let told = |table: &Table| {
        let now = of(&prior, table);
        let unseen = prior.unseen();
        let dependence = dependence(Belief { now: now.dependent(), unseen: unseen.dependent() });
        (dependence, now.above(0.5) > 0.5)
    };
    assert_eq!(told(&copied(20)), (Dependence::Established, true));
    assert_eq!(told(&leaning(10)), (Dependence::Established, false));
    assert_eq!(told(&coins(50)), (Dependence::Excluded, false));
    assert_eq!(told(&grid(&[&[2, 1], &[1, 2]])), (Dependence::Open, false));
}

#[test]
fn one_letter_leaves_nothing_to_depend() {
    for (rows, columns) in [(1, 6), (6, 1), (1, 1)] {
        let fit = Fit::cold(Alphabet { rows, columns }, Base::new(&vec![3; columns as usize]));
        let prior = Prior::new(&fit);
        let posterior = of(&prior, &Table::from_counts((0..rows).map(|row| (row, 0, 40))));

        assert_eq!([posterior.dependent(), posterior.mean(), posterior.above(0.0), posterior.above(0.5)], [0.0; 4]);
        assert_eq!(posterior.interval(), [0.0; 2]);
    }
}

/// The definition, letter by letter.
fn ln_dm(counts: &[f64], parameters: &[f64]) -> f64 {
    let (n, a): (f64, f64) = (counts.iter().sum(), parameters.iter().sum());
    let terms = counts.iter().zip(parameters).map(|(n, a)| ln_gamma(n + a) - ln_gamma(*a));
    ln_gamma(a) - ln_gamma(a + n) + terms.sum::<f64>()
}

fn dense(table: &Table) -> Vec<Vec<f64>> {
    let mut rows = vec![vec![0.0; 6]; 6];
    for cell in table.cells() {
        let labels = (table.row_labels()[cell.row as usize], table.column_labels()[cell.column as usize]);
        rows[labels.0 as usize][labels.1 as usize] = cell.n as f64;
    }
    rows
}

/// The base of a slab in a table.
fn base_of(slab: usize, rows: &[Vec<f64>]) -> Vec<f64> {
    let g: Vec<f64> = BASE.iter().map(|n| (*n as f64 + 0.5) / 103.0).collect();
    let total: f64 = rows.iter().flatten().sum();
    let column = |j: usize| rows.iter().map(|row| row[j]).sum::<f64>();
    match slab {
        0..SLAB_GRID => g,
        SLAB_GRID..FIXED => vec![1.0 / 6.0; 6],
        _ => (0..6).map(|j| (column(j) + g[j]) / (total + 1.0)).collect(),
    }
}

fn scaled(base: &[f64], by: f64) -> Vec<f64> {
    base.iter().map(|share| share * by).collect()
}

/// P(dependent) as it is defined, without tables, grouping or shortcuts.
fn defined(fit: &Fit, table: &Table) -> f64 {
    let rows = dense(table);
    let shared = |counts: &[f64]| -> f64 {
        let component = |b: usize| {
            let base = base_of(if b < NULL_GRID { 0 } else { SLAB_GRID }, &rows);
            fit.parameters.nulls[b] * ln_dm(counts, &scaled(&base, NULL_CONCENTRATIONS[b % NULL_GRID])).exp()
        };
        (0..NULLS).map(component).sum::<f64>().ln()
    };
    let sums: Vec<f64> = rows.iter().map(|row| row.iter().sum()).collect();
    let columns: Vec<f64> = (0..6).map(|j| rows.iter().map(|row| row[j]).sum()).collect();
    let most = sums.iter().copied().fold(0.0, f64::max);
    let anchor = (sums.iter().sum::<f64>() - most < 3.0).then(|| sums.iter().position(|r| *r == most)).flatten();
    let null = shared(&columns);
    let slab = |slab: usize| {
        let base = base_of(slab, &rows);
        let others = rows.iter().enumerate().filter(|(row, _)| Some(*row) != anchor);
        let evidence = others.map(|(_, row)| {
            let relative: f64 = row.iter().zip(&base).map(|(n, share)| n * share.ln()).sum();
            ln_dm(row, &scaled(&base, SLAB_CONCENTRATIONS[slab % SLAB_GRID]))
                - if slab < FIXED { 0.0 } else { relative }
        });
        let start = if slab < FIXED { anchor.map_or(0.0, |row| shared(&rows[row])) } else { null };
        fit.parameters.slabs[slab] * (start + evidence.sum::<f64>()).exp()
    };
    let dependent = fit.parameters.dependent * (0..SLABS).map(slab).sum::<f64>();
    dependent / (dependent + (1.0 - fit.parameters.dependent) * null.exp())
}

/// Mean and variance of mutual information under one slab as they are defined, cell by cell.
fn defined_moments(slab: usize, table: &Table) -> (f64, f64) {
    let rows = dense(table);
    let k = SLAB_CONCENTRATIONS[slab % SLAB_GRID];
    let base = base_of(slab, &rows);
    let total: f64 = rows.iter().flatten().sum();
    let policy: Vec<f64> = rows.iter().map(|row| (row.iter().sum::<f64>() + 0.5) / (total + 3.0)).collect();
    let a: Vec<Vec<f64>> = rows.iter().map(|row| row.iter().zip(&base).map(|(n, m)| n + k * m).collect()).collect();
    let sums: Vec<f64> = a.iter().map(|row| row.iter().sum()).collect();
    let rho = |i: usize, j: usize| a[i][j] / sums[i];
    let q: Vec<f64> = (0..6).map(|j| (0..6).map(|i| policy[i] * rho(i, j)).sum()).collect();
    let (mut mean, mut variance, mut first, mut second) = (0.0, 0.0, 0.0, 0.0);
    for i in 0..6 {
        let entropy = digamma(sums[i] + 1.0) - a[i].iter().map(|a| a * digamma(a + 1.0)).sum::<f64>() / sums[i];
        let l = |j: usize| (rho(i, j) / q[j]).ln();
        let along: f64 = (0..6).map(|j| rho(i, j) * l(j)).sum();
        let square: f64 = (0..6).map(|j| rho(i, j) * l(j) * l(j)).sum();
        let p = policy[i];
        let curvature: f64 = (0..6).map(|j| rho(i, j) * (1.0 - rho(i, j)) / q[j]).sum();
        mean -= p * entropy + 0.5 * p * p * curvature / (sums[i] + 1.0);
        variance += p * p * (square - along * along) / (sums[i] + 1.0);
        first += p * along;
        second += p * along * along;
    }
    mean -= q.iter().map(|q| q * q.ln()).sum::<f64>();
    (mean, variance + (second - first * first) / (total + 4.0))
}

fn counts(most: u64) -> impl Strategy<Value = Vec<(u64, u64, u64)>> {
    let n = prop_oneof![4 => 0..4_u64, 1 => 0..most];
    prop::collection::vec((0..6_u64, 0..6_u64, n), 0..30)
}

/// Of logarithms summed in different orders.
const ROUNDING: f64 = 1e-9;

proptest! {
    #[test]
    fn dependence_is_as_defined(counts in counts(40)) {
        let table = Table::from_counts(counts);
        prop_assume!(table.rows().len() > 1 && table.columns().len() > 1);

        let expected = defined(&uneven(), &table);

        prop_assert!((Prior::new(&uneven()).dependent(&[table]) - expected).abs() < ROUNDING);
    }

    #[test]
    fn moments_are_as_defined(counts in counts(400), slab in 0..SLABS) {
        let table = Table::from_counts(counts);
        let (mean, variance) = defined_moments(slab, &table);

        let moments = cold().slice_moments(slab, &table);

        prop_assert!((moments.mean - mean).abs() < ROUNDING && (moments.variance - variance).abs() < ROUNDING);
    }

    #[test]
    fn beliefs_are_probabilities_and_information_is_bounded(
        counts in counts(2_000_000_000), columns in 6..40_u64, rows in 6..4_000_u64, given in 0..3_usize,
    ) {
        let alphabet = Alphabet { rows, columns };
        let prior = Prior::new(&Fit::cold(alphabet, Base::new(&vec![1; columns as usize])));
        let slices = [vec![Table::from_counts(counts)], vec![coins(1); given]].concat();
        let largest = (rows.min(columns) as f64).ln();

        let posterior = prior.posterior(&slices);

        let above = [0.0, 1e-6, 0.01, 0.1, 0.5, 1.0, largest].map(|t| posterior.above(t));
        prop_assert!(above.iter().all(|p| (0.0..=1.0).contains(p)) && above.is_sorted_by(|a, b| a >= b), "{above:?}");
        prop_assert_eq!(above[0], posterior.dependent());
        let [low, high] = posterior.interval();
        prop_assert!(0.0 <= low && low <= high && high <= largest, "{low} {high}");
        prop_assert!((0.0..=largest).contains(&posterior.mean()));
    }

    #[test]
    fn the_names_of_rows_do_not_matter(counts in counts(40), shift in 1..6_u64) {
        let turned = Table::from_counts(counts.iter().map(|(row, column, n)| ((row + shift) % 6, *column, *n)));
        let table = Table::from_counts(counts);
        // Of equally visited rows the first is the anchor.
        prop_assume!(table.total() > 12);

        prop_assert!((cold().dependent(&[table]) - cold().dependent(&[turned])).abs() < ROUNDING);
    }
}

#[test]
fn an_interval_holds_nine_tenths_of_the_belief() {
    let prior = cold();
    let posterior = of(&prior, &leaning(3));
    let [low, high] = posterior.interval();

    assert!(posterior.dependent() > 0.99 && low > 0.0 && high < 6_f64.ln());
    let outside = [posterior.above(low) - 0.95, posterior.above(high) - 0.05];
    assert!(outside.iter().all(|error| error.abs() < 1e-4), "{outside:?}");
    // While independence is likely enough, nothing above 0 is ruled out from below.
    assert_eq!(of(&prior, &coins(1)).interval()[0], 0.0);
}

#[test]
fn near_independence_at_a_billion_visits_stays_finite() {
    let posterior = of(&cold(), &coins(30_000_000));

    assert!(posterior.dependent() < 1e-6 && posterior.mean() < 1e-6 && posterior.interval()[1] < 1e-6);
}

#[test]
fn slices_add_up_and_reveal_what_the_pool_hides() {
    // The other's action is the exclusive or of the ego's and of the agent's that is held fixed.
    let slices = [grid(&[&[12, 0], &[0, 12]]), grid(&[&[0, 12], &[12, 0]])];
    let prior = cold();

    assert!(of(&prior, &grid(&[&[12, 12], &[12, 12]])).dependent() < 0.2);
    let given = prior.posterior(&slices);
    assert!(given.dependent() > 0.999 && given.above(0.4) > 0.9);
    // An empty slice weighs nothing.
    let more = prior.posterior(&[slices.to_vec(), vec![Table::default()]].concat());
    assert_eq!(more, given);
}

#[test]
fn a_fit_finds_how_much_influence_there_is() {
    let fit = |tables: Vec<Table>| {
        let mut fitter = Fitter::new(SIX, Base::new(&[100; 6]));
        tables.iter().for_each(|table| fitter.add(std::slice::from_ref(table)));
        fitter.fit()
    };
    let silent = Table::from_counts([(0, 3, 40)]);

    let none = fit([vec![coins(2); 50], vec![silent.clone(); 1_000]].concat());
    let half = fit([vec![coins(2); 50], vec![copied(12); 50]].concat());

    assert_eq!((none.states, half.states), (50, 100));
    let shares = [&none, &half].map(|fit| fit.parameters.dependent);
    assert!(shares[0] < 0.1 && (shares[1] - 0.5).abs() < 0.05, "{shares:?}");
    assert_eq!(fit(vec![silent]).parameters, Parameters::cold());
    for weights in [&half.parameters.nulls, &half.parameters.slabs] {
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }
    assert_eq!(half, fit([vec![coins(2); 50], vec![copied(12); 50]].concat()));
}

#[test]
fn a_single_independent_state_is_not_called_dependent() {
    let table = Table::from_counts((0..12).map(|cell| (cell / 4, cell % 4, 1 + cell % 2)));
    let mut fitter = Fitter::new(SIX, Base::new(&[6; 6]));
    fitter.add(std::slice::from_ref(&table));

    assert!(of(&Prior::new(&fitter.fit()), &table).dependent() < 0.3);
}

#[test]
fn parts_of_a_fit_make_it_again() {
    let fit = uneven();
    let again = Fit { base: Base::new(fit.base.counts()), ..fit.clone() };

    assert_eq!(of(&Prior::new(&again), &copied(2)), of(&Prior::new(&fit), &copied(2)));
}

#[test]
fn large_alphabets_are_as_quick_as_what_was_seen_of_them() {
    let alphabet = Alphabet { rows: 1 << 40, columns: MOST_LETTERS };
    let prior = Prior::new(&Fit::cold(alphabet, Base::new(&vec![1; MOST_LETTERS as usize])));
    let table = Table::from_counts((0..40).map(|at| (at << 34, 100 * at, 3)));

    let posterior = of(&prior, &table);

    assert!(posterior.dependent() > 0.99 && posterior.mean() > 0.5);
}

#[test]
fn actions_tell_what_they_do_in_both_directions() {
    // The ego's action 2 draws action 5; under all others the other tosses a coin.
    let table = Table::from_counts(
        (0..6).flat_map(|ego| if ego == 2 { vec![(ego, 5, 30)] } else { vec![(ego, 0, 15), (ego, 1, 15)] }),
    );
    let transposed = Table::from_counts(
        (0..6).flat_map(|ego| if ego == 2 { vec![(5, ego, 30)] } else { vec![(0, ego, 15), (1, ego, 15)] }),
    );
    for (table, ego) in [(table, Ego::Rows), (transposed, Ego::Columns)] {
        let actions = cold().by_action(&[table], ego);

        let strongest = (0..6).max_by(|a, b| actions[*a].divergence_mean.total_cmp(&actions[*b].divergence_mean));
        assert_eq!(strongest, Some(2));
        assert!(actions[2].response[5] > 0.9 && actions[0].response[5] < 0.1);
        for action in &actions {
            let [low, high] = action.divergence_interval;
            assert!(low <= action.divergence_mean && action.divergence_mean <= high);
            assert!((action.response.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            // What is rare may be rarer than its mean 95 times in a hundred.
            let mut common = action.response.iter().zip(&action.response_intervals).filter(|(p, _)| **p > 0.1);
            assert!(common.all(|(p, [low, high])| low < p && p < high));
        }
    }
}

#[test]
fn unvisited_actions_are_told_by_the_environment() {
    let actions = cold().by_action(&[], Ego::Rows);

    let g = BASE.map(|n| (n as f64 + 0.5) / 103.0);
    let halfway = g.map(|share| 0.5 * share + 0.5 / 6.0);
    assert_eq!(actions.len(), 6);
    for action in actions {
        // Cold, the null's bases are equally likely; the state's own marginal is the environment's.
        let expected = halfway.iter().zip(g).map(|(half, g)| 0.7 * half + 0.3 * (2.0 * half + g) / 3.0);
        assert!(action.response.iter().zip(expected).all(|(p, expected)| (p - expected).abs() < ROUNDING));
        assert_eq!(action.divergence_interval[0], 0.0);
    }
}

#[test]
fn the_next_visit_is_worth_most_where_least_is_known() {
    let table = Table::from_counts((0..5).flat_map(|ego| [(ego, 0, 9), (ego, 1, 9)]).chain([(5, 0, 1), (5, 3, 1)]));
    let gains = cold().information_gain(&[table], Ego::Rows, 0.05);

    assert!(gains.iter().all(|gain| (0.0..=2_f64.ln()).contains(gain)));
    assert!((0..5).all(|ego| gains[ego] < gains[5]), "{gains:?}");
}

#[test]
fn visits_to_decide_grow_with_what_is_asked() {
    let prior = cold();
    let rule = |threshold, confidence| Rule { kind: RuleKind::Evidence, threshold, confidence, ..Rule::default() };
    let open = [grid(&[&[3, 0, 1], &[1, 2, 0]])];

    assert_eq!(prior.visits_to_decide(&[copied(20)], &rule(0.5, 0.8)), Some(0));
    let soon = prior.visits_to_decide(&open, &rule(0.1, 0.8)).expect("a verdict within ten thousand visits");
    let later = prior.visits_to_decide(&open, &rule(0.1, 0.999)).expect("a verdict within ten thousand visits");
    assert!(0 < soon && soon < later, "{soon} {later}");
    // The counts alone choose the futures.
    assert_eq!(prior.visits_to_decide(&open, &rule(0.1, 0.8)), Some(soon));
    // Ten thousand visits do not tell on which side of its own estimate the truth is, where a million did not.
    let known = leaning(10_000);
    let estimate = of(&prior, &known).mean();
    assert_eq!(prior.visits_to_decide(&[known], &rule(estimate, 0.99)), None);
}

#[test]
fn the_paper_decides_as_soon_as_visits_suffice() {
    let rule = Rule { kind: RuleKind::Paper, min_visits: 8, ..Rule::default() };

    assert_eq!(cold().visits_to_decide(&[grid(&[&[2, 1], &[1, 2]])], &rule), Some(2));
}

/// Two agents who throw dice of that many sides in every state, so often.
fn dice(sides: u64, states: usize, visits: usize) -> Vec<Table> {
    let mut random = rand_pcg::Pcg64::seed_from_u64(sides);
    let mut throw = || random.random_range(0..sides);
    let mut table = |_| Table::from_counts((0..visits).map(|_| (throw(), throw(), 1)));
    (0..states).map(&mut table).collect()
}

/// Were the null not allowed to resemble its base as closely as the rows of a slab do, slabs would win by that alone, and call nearly all of these
/// dependent.
#[test]
fn two_dice_are_never_called_dependent() {
    for (sides, states, visits) in [(2, 100, 30), (6, 100, 30), (6, 10, 50), (9, 100, 50), (25, 40, 200), (64, 20, 500)]
    {
        let tables = dice(sides, states, visits);
        let mut counts = vec![0; sides as usize];
        for table in &tables {
            table.column_labels().iter().zip(table.columns()).for_each(|(label, n)| counts[*label as usize] += n);
        }
        let mut fitter = Fitter::new(Alphabet { rows: sides, columns: sides }, Base::new(&counts));
        tables.iter().for_each(|table| fitter.add(std::slice::from_ref(table)));
        let prior = Prior::new(&fitter.fit());
        for table in &tables {
            let posterior = of(&prior, table);
            let [belief, strong] = [posterior.dependent(), posterior.above(0.5)];
            assert!(belief < 0.95 && strong < 0.2, "{sides} sides: {belief}, {strong}");
        }
    }
}
