//! What the whole of a fit, a prior and its posteriors promise.

use std::sync::LazyLock;

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use statrs::function::gamma::ln_gamma;

use super::moments::tests::Dense;
use super::parameters::{
    DEVIANT_CONCENTRATIONS, DEVIANT_GRID, DEVIANT_SLABS, FIXED, FIXED_GRID, HABITS,
    NULL_CONCENTRATIONS, NULL_GRID, NULLS, SLABS, concentration,
};
use super::side::StateMargins;
use super::*;
use crate::domain::{Dependence, Rule, RuleKind, Verdict};
use crate::information::samples::grid;
use crate::information::{Alphabet, Table, expected_if_independent, plug_in};

const SIX: Alphabet = Alphabet {
    rows: 6,
    columns: 6,
};
const BASES: [[u64; 6]; 2] = [[9, 31, 4, 20, 1, 35], [50, 3, 0, 20, 9, 18]];

fn cold_fit() -> Fit {
    Fit {
        bases: BASES.map(|counts| Base::new(&counts)),
        ..Fit::cold(SIX)
    }
}

/// Each is made once: what is believed of states never seen is sampled.
static COLD: LazyLock<Prior> = LazyLock::new(|| Prior::new(&cold_fit()));
static COLD_EXCHANGED: LazyLock<Prior> = LazyLock::new(|| Prior::new(&exchanged(&cold_fit())));
static UNEVEN: LazyLock<Prior> = LazyLock::new(|| Prior::new(&uneven()));
static UNEVEN_EXCHANGED: LazyLock<Prior> = LazyLock::new(|| Prior::new(&exchanged(&uneven())));
static ALIKE: LazyLock<Prior> = LazyLock::new(|| {
    Prior::new(&Fit {
        bases: [Base::new(&[7; 6]), Base::new(&BASES[1])],
        ..Fit::cold(SIX)
    })
});

fn cold() -> &'static Prior {
    &COLD
}

/// A prior with every weight its own.
fn uneven() -> Fit {
    let weights = |from: usize, count: usize, of: usize| {
        let total = (of * (of + 1) / 2) as f64;
        (from + 1..=from + count)
            .map(|at| at as f64 / total)
            .collect::<Vec<f64>>()
    };
    let side = |at: usize| SideParameters {
        nulls: weights(0, NULLS, NULLS),
        slabs: weights(at * SLABS, SLABS, 2 * SLABS),
        habit: Some(2.0 + at as f64),
        habit_in_segments: Some(20.0 - at as f64),
        segments: weights(0, HABITS, HABITS),
    };
    let parameters = Parameters {
        dependent: 0.137,
        sides: [side(0), side(1)],
        families: [0.5, 0.2, 0.3],
    };
    Fit {
        bases: BASES.map(|counts| Base::new(&counts)),
        parameters,
        states: 7,
        ..Fit::cold(SIX)
    }
}

/// The same fit with the order of the variables exchanged.
fn exchanged(fit: &Fit) -> Fit {
    let Fit {
        alphabet: Alphabet { rows, columns },
        bases: [first, second],
        parameters,
        states,
    } = fit.clone();
    let [a, b] = parameters.sides;
    let parameters = Parameters {
        sides: [b, a],
        ..parameters
    };
    Fit {
        alphabet: Alphabet {
            rows: columns,
            columns: rows,
        },
        bases: [second, first],
        parameters,
        states,
    }
}

fn posterior_of(prior: &Prior, table: &Table) -> Posterior {
    prior.posterior(prior.habits(), std::slice::from_ref(table))
}

/// What is believed of a table at half a nat, where the environment's habits are those of the fit.
fn believed(prior: &Prior, table: &Table) -> Believed {
    Believed::new(
        posterior_of(prior, table).beliefs(0.5),
        prior.unseen().beliefs(0.5),
        std::slice::from_ref(table),
    )
}

fn verdict(prior: &Prior, table: &Table) -> Verdict {
    decide(
        &Rule {
            kind: RuleKind::Evidence,
            ..Rule::default()
        },
        table.total(),
        0.0,
        Some(&believed(prior, table)),
    )
}

/// A prior fitted to these tables.
fn fitted(alphabet: Alphabet, tables: &[Table]) -> Prior {
    Prior::new(&fit(alphabet, tables))
}

fn fit(alphabet: Alphabet, tables: &[Table]) -> Fit {
    let mut uses = Uses::new(alphabet);
    tables
        .iter()
        .for_each(|table| uses.add(std::slice::from_ref(table)));
    let mut fitter = Fitter::new(alphabet, &uses);
    tables
        .iter()
        .for_each(|table| fitter.add(std::slice::from_ref(table)));
    fitter.fit()
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
    Table::from_counts((0..36).map(|cell| {
        (
            cell / 6,
            cell % 6,
            each * if cell % 7 == 0 { 15 } else { 7 },
        )
    }))
}

#[test]
fn what_cannot_tell_leaves_the_prior_exactly() {
    let prior = &*UNEVEN;

    let row = grid(&[&[0; 6], &[900, 3, 0, 0, 1, 0]]);
    let column = grid(&[&[0, 5], &[0, 7], &[0, 1]]);
    for slices in [
        vec![],
        vec![Table::default()],
        vec![row.clone()],
        vec![column.clone()],
        vec![row, column],
    ] {
        assert_eq!(prior.posterior(prior.habits(), &slices).dependent(), 0.137);
        assert_eq!(prior.dependent(&slices), 0.137);
    }
    assert_eq!(prior.unseen().dependent(), 0.137);
}

#[test]
fn dependence_and_strength_are_two_answers() {
    let prior = cold();
    let told = |table: &Table| {
        (
            dependence(&believed(prior, table)),
            posterior_of(prior, table).above(0.5) > 0.5,
        )
    };
    assert_eq!(told(&copied(20)), (Dependence::Established, true));
    assert_eq!(told(&leaning(10)), (Dependence::Established, false));
    assert_eq!(told(&coins(5_000)), (Dependence::Excluded, false));
    assert_eq!(told(&grid(&[&[2, 1], &[1, 2]])), (Dependence::Open, false));
}

#[test]
fn one_letter_leaves_nothing_to_depend() {
    for (rows, columns) in [(1, 6), (6, 1), (1, 1)] {
        let prior = Prior::new(&Fit::cold(Alphabet { rows, columns }));
        let posterior = posterior_of(
            &prior,
            &Table::from_counts((0..rows).map(|row| (row, 0, 40))),
        );

        assert_eq!(
            [
                posterior.dependent(),
                posterior.mean(),
                posterior.above(0.0),
                posterior.above(0.5)
            ],
            [0.0; 4]
        );
        assert_eq!(posterior.interval(), [0.0; 2]);
    }
}

/// The definition, letter by letter.
fn ln_dm(counts: &[f64], parameters: &[f64]) -> f64 {
    let (n, a): (f64, f64) = (counts.iter().sum(), parameters.iter().sum());
    let terms = counts
        .iter()
        .zip(parameters)
        .map(|(n, a)| ln_gamma(n + a) - ln_gamma(*a));
    ln_gamma(a) - ln_gamma(a + n) + terms.sum::<f64>()
}

fn dense(table: &Table) -> Vec<Vec<f64>> {
    let mut rows = vec![vec![0.0; 6]; 6];
    for cell in table.cells() {
        let labels = (
            table.row_labels()[cell.row as usize],
            table.column_labels()[cell.column as usize],
        );
        rows[labels.0 as usize][labels.1 as usize] = cell.n as f64;
    }
    rows
}

/// The base of a slab in a table of a side whose responder has this base.
fn base_of(slab: usize, rows: &[Vec<f64>], base: &Base) -> Vec<f64> {
    let g = base.shares();
    let total: f64 = rows.iter().flatten().sum();
    let column = |j: usize| rows.iter().map(|row| row[j]).sum::<f64>();
    match slab {
        0..FIXED_GRID => g.to_vec(),
        FIXED_GRID..FIXED => vec![1.0 / 6.0; 6],
        _ => (0..6).map(|j| (column(j) + g[j]) / (total + 1.0)).collect(),
    }
}

fn scaled(base: &[f64], by: f64) -> Vec<f64> {
    base.iter().map(|share| share * by).collect()
}

fn ln_sum(logarithms: impl Iterator<Item = f64>) -> f64 {
    logarithms.map(f64::exp).sum::<f64>().ln()
}

/// sum w l over the slabs of a side, relative to the null, as it is defined: without tables,
/// grouping or shortcuts.
fn defined_side(parameters: &SideParameters, base: &Base, rows: &[Vec<f64>]) -> f64 {
    let shared = |counts: &[f64]| -> f64 {
        let component = |b: usize| {
            let base = base_of(if b < NULL_GRID { 0 } else { FIXED_GRID }, rows, base);
            parameters.nulls[b].ln()
                + ln_dm(counts, &scaled(&base, NULL_CONCENTRATIONS[b % NULL_GRID]))
        };
        ln_sum((0..NULLS).map(component))
    };
    let sums: Vec<f64> = rows.iter().map(|row| row.iter().sum()).collect();
    let columns: Vec<f64> = (0..6)
        .map(|j| rows.iter().map(|row| row[j]).sum())
        .collect();
    let most = sums.iter().copied().fold(0.0, f64::max);
    let anchor = (sums.iter().sum::<f64>() - most < 3.0)
        .then(|| sums.iter().position(|r| *r == most))
        .flatten();
    let null = shared(&columns);
    let without = |row: usize| {
        columns
            .iter()
            .zip(&rows[row])
            .map(|(c, n)| c - n)
            .collect::<Vec<f64>>()
    };
    let own_row = |slab: usize| {
        let base = base_of(slab, rows, base);
        let others = rows
            .iter()
            .enumerate()
            .filter(|(row, _)| Some(*row) != anchor);
        let evidence = others.map(|(_, row)| {
            let relative: f64 = row.iter().zip(&base).map(|(n, share)| n * share.ln()).sum();
            ln_dm(row, &scaled(&base, concentration(slab)))
                - if slab < FIXED { 0.0 } else { relative }
        });
        let start = if slab < FIXED {
            anchor.map_or(0.0, |row| shared(&rows[row])) - null
        } else {
            let k = concentration(slab);
            let told = |(row, r): (usize, &f64)| {
                if Some(row) == anchor {
                    *r
                } else {
                    r * (k + 1.0) / (r + k)
                }
            };
            let free: f64 = columns.iter().map(|c| c / (c + 4.0)).sum();
            let told: f64 = sums.iter().enumerate().map(told).sum();
            0.5 * (free - 1.0).max(0.0) * (sums.iter().sum::<f64>() / told).ln()
        };
        start + evidence.sum::<f64>()
    };
    let deviant = |deviant: usize| {
        let base = base_of(
            if deviant < DEVIANT_GRID {
                0
            } else {
                FIXED_GRID
            },
            rows,
            base,
        );
        let parameters = scaled(&base, DEVIANT_CONCENTRATIONS[deviant % DEVIANT_GRID]);
        let row = |row: usize| match anchor {
            Some(anchor) if anchor == row => ln_dm(&without(row), &parameters) + shared(&rows[row]),
            _ => ln_dm(&rows[row], &parameters) + shared(&without(row)),
        };
        ln_sum((0..6).map(|at| row(at) - null)) - 6_f64.ln()
    };
    let slab = |slab: usize| {
        let ln = if DEVIANT_SLABS.contains(&slab) {
            deviant(slab - DEVIANT_SLABS.start)
        } else {
            own_row(slab)
        };
        parameters.slabs[slab].ln() + ln
    };
    (0..SLABS).map(slab).map(f64::exp).sum()
}

/// P(dependent) as it is defined.
fn defined(fit: &Fit, table: &Table) -> f64 {
    let [rows, columns] = [dense(table), dense(&table.transposed())];
    let [first, second] = &fit.parameters.sides;
    let slabs =
        defined_side(first, &fit.bases[1], &rows) + defined_side(second, &fit.bases[0], &columns);
    let dependent = fit.parameters.dependent * slabs;
    dependent / (dependent + 1.0 - fit.parameters.dependent)
}

/// Mean and variance of mutual information under one slab of the first side as they are defined,
/// cell by cell.
fn defined_moments(fit: &Fit, slab: usize, table: &Table) -> [f64; 3] {
    let rows = dense(table);
    let habits = fit.bases[0].counts();
    let used: u64 = habits.iter().sum();
    let habits: Vec<f64> = habits.iter().map(|n| *n as f64 / used as f64).collect();
    let slice = Dense {
        counts: &rows,
        concentration: concentration(slab),
        base: &base_of(slab, &rows, &fit.bases[1]),
        habit: fit.parameters.sides[0].habit.unwrap_or(3.0),
        habits: &habits,
    };
    slice.moments()
}

fn counts(most: u64) -> impl Strategy<Value = Vec<(u64, u64, u64)>> {
    let n = prop_oneof![4 => 0..4_u64, 1 => 0..most];
    prop::collection::vec((0..6_u64, 0..6_u64, n), 0..30)
}

/// Of logarithms summed in different orders.
const ROUNDING: f64 = 1e-9;

proptest! {
    // Each case has a prior of its own.
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn beliefs_are_probabilities_and_information_is_bounded(
        counts in counts(2_000_000_000), columns in 6..40_u64, rows in 6..400_u64, given in 0..3_usize,
    ) {
        let alphabet = Alphabet { rows, columns };
        let prior = Prior::new(&Fit::cold(alphabet));
        let slices = [vec![Table::from_counts(counts)], vec![coins(1); given]].concat();
        let largest = (rows.min(columns) as f64).ln();

        let posterior = prior.posterior(prior.habits(), &slices);

        let above = [0.0, 1e-6, 0.01, 0.1, 0.5, 1.0, largest].map(|t| posterior.above(t));
        prop_assert!(above.iter().all(|p| (0.0..=1.0).contains(p)) && above.is_sorted_by(|a, b| a >= b), "{above:?}");
        prop_assert_eq!(above[0], posterior.dependent());
        let [low, high] = posterior.interval();
        prop_assert!(0.0 <= low && low <= high && high <= largest, "{low} {high}");
        prop_assert!((0.0..=largest).contains(&posterior.mean()));
    }
}

proptest! {
    #[test]
    fn dependence_is_as_defined(counts in counts(40)) {
        let table = Table::from_counts(counts);
        prop_assume!(table.rows().len() > 1 && table.columns().len() > 1);

        let expected = defined(&uneven(), &table);

        prop_assert!((UNEVEN.dependent(&[table]) - expected).abs() < ROUNDING);
    }

    #[test]
    fn moments_are_as_defined(counts in counts(400), slab in 0..DEVIANT_SLABS.start) {
        let table = Table::from_counts(counts);
        let expected = defined_moments(&uneven(), slab, &table);

        let prior = &*UNEVEN;
        let deviants = prior.sides[0].add_bayes_factors(
            &table,
            &mut [0.0; SLABS],
            &mut StateMargins::none(false),
        );
        let slice = prior.sides[0].slice(&table, &deviants, prior.habits().driver(0));
        let moments = prior.sides[0].moments(slab, &slice);

        let told = [moments.mean, moments.variance, moments.wide];
        prop_assert!(told.iter().zip(expected).all(|(told, expected)| (told - expected).abs() < 1e-8), "{told:?} {expected:?}");
    }

    #[test]
    fn a_slice_stands_for_others_that_are_equal(
        counts in counts(40), slab in 0..DEVIANT_SLABS.start, times in 1..4_usize,
    ) {
        let prior = &*UNEVEN;
        let tables = [Table::from_counts(counts), coins(2)];
        let slice = |table| [0, 1].map(|side| prior.sides[side].part(table, prior.habits().driver(0)));

        let together = [slice(&tables[0]).map(|one| one.for_all(times)), slice(&tables[1])];
        let apart: Vec<_> = (0..times).map(|_| &tables[0]).chain([&tables[1]]).map(slice).collect();

        let told = |slices| {
            let moments = prior.moments(0, slab, slices);
            [moments.mean, moments.variance, moments.wide]
        };
        let (together, apart) = (told(&together[..]), told(&apart[..]));
        prop_assert!(together.iter().zip(apart).all(|(together, apart)| (together - apart).abs() < ROUNDING), "{together:?} {apart:?}");
    }

    #[test]
    fn the_order_of_the_variables_changes_no_bit(counts in counts(40)) {
        let table = Table::from_counts(counts);
        let [prior, turned] = [&*UNEVEN, &*UNEVEN_EXCHANGED];

        prop_assert_eq!(prior.unseen().above(0.3), turned.unseen().above(0.3));
        let told = |posterior: &Posterior| {
            let [low, high] = posterior.interval();
            [posterior.dependent(), posterior.above(0.1), posterior.above(0.5), posterior.mean(), low, high]
        };
        prop_assert_eq!(told(&posterior_of(prior, &table)), told(&posterior_of(turned, &table.transposed())));
    }

    #[test]
    fn the_names_of_rows_do_not_matter(counts in counts(40), shift in 1..6_u64) {
        let turned = Table::from_counts(counts.iter().map(|(row, column, n)| ((row + shift) % 6, *column, *n)));
        let table = Table::from_counts(counts);
        // Of equally visited rows the first is the anchor.
        prop_assume!(table.total() > 12);

        prop_assert!((ALIKE.dependent(&[table]) - ALIKE.dependent(&[turned])).abs() < ROUNDING);
    }
}

#[test]
fn an_interval_holds_nine_tenths_of_the_belief() {
    let prior = cold();
    let posterior = posterior_of(prior, &leaning(3));
    let [low, high] = posterior.interval();

    assert!(posterior.dependent() > 0.99 && low > 0.0 && high < 6_f64.ln());
    assert!(
        posterior.above(low) >= 0.95 && posterior.above(high) <= 0.05,
        "{low} {high}"
    );
    // While independence is likely enough, nothing above 0 is ruled out from below.
    assert_eq!(posterior_of(prior, &coins(1)).interval()[0], 0.0);
}

#[test]
fn near_independence_at_a_billion_visits_stays_finite() {
    let posterior = posterior_of(cold(), &coins(30_000_000));

    assert!(
        posterior.dependent() < 1e-6 && posterior.mean() < 1e-6 && posterior.interval()[1] < 1e-5
    );
}

#[test]
fn slices_add_up_and_reveal_what_the_pool_hides() {
    // The other's action is the exclusive or of the ego's and of the agent's that is held fixed.
    let slices = [grid(&[&[12, 0], &[0, 12]]), grid(&[&[0, 12], &[12, 0]])];
    let prior = cold();

    assert!(posterior_of(prior, &grid(&[&[12, 12], &[12, 12]])).dependent() < 0.2);
    let given = prior.posterior(prior.habits(), &slices);
    assert!(given.dependent() > 0.999 && given.above(0.4) > 0.9);
    // An empty slice weighs nothing.
    let more = prior.posterior(
        prior.habits(),
        &[slices.to_vec(), vec![Table::default()]].concat(),
    );
    assert_eq!(more, given);
}

#[test]
fn a_fit_finds_how_much_influence_there_is() {
    let fit = |tables: Vec<Table>| fit(SIX, &tables);
    let silent = Table::from_counts([(0, 3, 40)]);

    let none = fit([vec![coins(2); 50], vec![silent.clone(); 1_000]].concat());
    let half = fit([vec![coins(2); 50], vec![copied(12); 50]].concat());

    assert_eq!((none.states, half.states), (50, 100));
    let shares = [&none, &half].map(|fit| fit.parameters.dependent);
    assert!(
        shares[0] < 0.1 && (shares[1] - 0.5).abs() < 0.05,
        "{shares:?}"
    );
    let cold = fit(vec![silent.clone(), grid(&[&[1, 1], &[1, 0]])]).parameters;
    assert_eq!(
        (cold.dependent, &cold.sides[1].slabs),
        (0.3, &Parameters::cold().sides[1].slabs)
    );
    let [first, second] = &half.parameters.sides;
    for weights in [
        first.nulls.clone(),
        second.nulls.clone(),
        [first.slabs.clone(), second.slabs.clone()].concat(),
    ] {
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }
    assert_eq!(
        half,
        fit([vec![coins(2); 50], vec![copied(12); 50]].concat())
    );
}

#[test]
fn a_single_independent_state_is_not_called_dependent() {
    let table = Table::from_counts((0..12).map(|cell| (cell / 4, cell % 4, 1 + cell % 2)));

    assert!(posterior_of(&fitted(SIX, std::slice::from_ref(&table)), &table).dependent() < 0.3);
}

#[test]
fn parts_of_a_fit_make_it_again() {
    let fit = uneven();
    let again = Fit {
        bases: fit.bases.clone().map(|base| Base::new(base.counts())),
        ..fit.clone()
    };

    assert_eq!(
        posterior_of(&Prior::new(&again), &copied(2)),
        posterior_of(&Prior::new(&fit), &copied(2))
    );
}

#[test]
fn large_alphabets_are_as_quick_as_what_was_seen_of_them() {
    let alphabet = Alphabet {
        rows: MOST_LETTERS,
        columns: MOST_LETTERS,
    };
    let prior = Prior::new(&Fit::cold(alphabet));
    let table = Table::from_counts((0..40).map(|at| (at << 6, 100 * at, 3)));

    let posterior = posterior_of(&prior, &table);

    assert!(posterior.dependent() > 0.99 && posterior.mean() > 0.5);
}

fn by_action(slices: &[Table], ego: Ego) -> Vec<ActionPosterior> {
    let prior = cold();
    prior.by_action(prior.habits(), slices, ego)
}

#[test]
fn actions_tell_what_they_do_in_both_directions() {
    // The ego's action 2 draws action 5; under all others the other tosses a coin.
    let table = Table::from_counts((0..6).flat_map(|ego| {
        if ego == 2 {
            vec![(ego, 5, 30)]
        } else {
            vec![(ego, 0, 15), (ego, 1, 15)]
        }
    }));
    let transposed = Table::from_counts((0..6).flat_map(|ego| {
        if ego == 2 {
            vec![(5, ego, 30)]
        } else {
            vec![(0, ego, 15), (1, ego, 15)]
        }
    }));
    for (table, ego) in [(table, Ego::Rows), (transposed, Ego::Columns)] {
        let actions = by_action(&[table], ego);

        let strongest = (0..6).max_by(|a, b| {
            actions[*a]
                .divergence_mean
                .total_cmp(&actions[*b].divergence_mean)
        });
        assert_eq!(strongest, Some(2));
        let [drawn, tossed] = [&actions[2].response, &actions[0].response];
        assert!(drawn[5] > 0.9 && tossed[5] < 0.1, "{drawn:?} {tossed:?}");
        for action in &actions {
            let [low, high] = action.divergence_interval;
            assert!(low <= action.divergence_mean && action.divergence_mean <= high);
            assert!((action.response.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            // What is rare may be rarer than its mean 95 times in a hundred.
            let mut common = action
                .response
                .iter()
                .zip(&action.response_intervals)
                .filter(|(p, _)| **p > 0.1);
            assert!(common.all(|(p, [low, high])| low < p && p < high));
        }
    }
}

#[test]
fn unvisited_actions_are_told_by_the_environment() {
    let actions = by_action(&[], Ego::Rows);

    let base = Base::new(&BASES[1]);
    let most = |shares: &[f64]| (0..6).max_by(|a, b| shares[*a].total_cmp(&shares[*b]));
    assert_eq!(actions.len(), 6);
    for action in actions {
        assert_eq!(most(&action.response), most(base.shares()));
        assert!((action.response.iter().sum::<f64>() - 1.0).abs() < ROUNDING);
        assert_eq!(action.divergence_interval[0], 0.0);
    }
}

#[test]
fn the_next_visit_is_worth_most_where_least_is_known() {
    let table = Table::from_counts(
        (0..5)
            .flat_map(|ego| [(ego, 0, 9), (ego, 1, 9)])
            .chain([(5, 0, 1), (5, 3, 1)]),
    );
    let prior = cold();
    let gains = prior.information_gain(prior.habits(), &[table], Ego::Rows, 0.05);

    assert!(gains.iter().all(|gain| (0.0..=2_f64.ln()).contains(gain)));
    assert!((0..5).all(|ego| gains[ego] < gains[5]), "{gains:?}");
}

/// How many more visits a prior wants, seen from either agent: the same.
fn visits_to_decide(prior: &Prior, table: &Table, rule: &Rule) -> Option<u64> {
    let turned = &*COLD_EXCHANGED;
    let visits =
        prior.visits_to_decide(prior.habits(), std::slice::from_ref(table), Ego::Rows, rule);
    assert_eq!(
        visits,
        turned.visits_to_decide(turned.habits(), &[table.transposed()], Ego::Columns, rule)
    );
    visits
}

#[test]
fn visits_to_decide_grow_with_what_is_asked() {
    let prior = cold();
    let rule = |threshold, confidence| Rule {
        kind: RuleKind::Evidence,
        threshold,
        confidence,
        ..Rule::default()
    };
    let open = grid(&[&[3, 0, 1], &[1, 2, 0]]);

    assert_eq!(
        visits_to_decide(prior, &copied(20), &rule(0.5, 0.8)),
        Some(0)
    );
    let soon = visits_to_decide(prior, &open, &rule(0.1, 0.8))
        .expect("a verdict within ten thousand visits");
    let later = visits_to_decide(prior, &open, &rule(0.1, 0.999))
        .expect("a verdict within ten thousand visits");
    assert!(0 < soon && soon < later, "{soon} {later}");
    // The counts alone choose the futures.
    assert_eq!(visits_to_decide(prior, &open, &rule(0.1, 0.8)), Some(soon));
    // Ten thousand visits do not tell on which side of its own estimate the truth is, where a
    // million did not.
    let known = leaning(10_000);
    let estimate = posterior_of(prior, &known).mean();
    assert_eq!(visits_to_decide(prior, &known, &rule(estimate, 0.99)), None);
}

#[test]
fn the_paper_decides_as_soon_as_visits_suffice() {
    let rule = Rule {
        kind: RuleKind::Paper,
        min_visits: 8,
        ..Rule::default()
    };

    assert_eq!(
        visits_to_decide(cold(), &grid(&[&[2, 1], &[1, 2]]), &rule),
        Some(2)
    );
}

/// Two agents who throw dice of that many sides in every state, so often.
fn dice(sides: u64, states: usize, visits: usize) -> Vec<Table> {
    let mut random = rand_pcg::Pcg64::seed_from_u64(sides);
    let mut throw = || random.random_range(0..sides);
    let mut table = |_| Table::from_counts((0..visits).map(|_| (throw(), throw(), 1)));
    (0..states).map(&mut table).collect()
}

/// Were the null not allowed to resemble its base as closely as the rows of a slab do, slabs would
/// win by that alone, and call nearly all of these dependent.
#[test]
fn two_dice_are_never_called_dependent() {
    for (sides, states, visits) in [
        (2, 100, 30),
        (6, 100, 30),
        (6, 10, 50),
        (9, 100, 50),
        (25, 40, 200),
        (64, 20, 500),
    ] {
        let tables = dice(sides, states, visits);
        let prior = fitted(
            Alphabet {
                rows: sides,
                columns: sides,
            },
            &tables,
        );
        for table in &tables {
            let posterior = posterior_of(&prior, table);
            let [belief, strong] = [posterior.dependent(), posterior.above(0.5)];
            assert!(
                belief < 0.95 && strong < 0.2,
                "{sides} sides: {belief}, {strong}"
            );
        }
    }
}

/// Perfect copying of two actions, told in two of 256 labels: a Taylor term made its entropy
/// negative, and the verdict `no_influence` at .381 nats.
#[test]
fn copying_is_seen_whatever_the_other_could_have_said() {
    for columns in [2, 3, 25, 256] {
        let prior = Prior::new(&Fit::cold(Alphabet { rows: 2, columns }));
        let table = Table::from_counts([(0, 0, 200), (1, columns - 1, 200)]);
        let posterior = posterior_of(&prior, &table);

        let [low, high] = posterior.interval();
        assert!(
            (posterior.mean() - 2_f64.ln()).abs() < 0.02,
            "{columns}: {}",
            posterior.mean()
        );
        assert!(
            low < 2_f64.ln() && high >= 2_f64.ln() - 1e-3,
            "{columns}: {low} {high}"
        );
        assert_eq!(verdict(&prior, &table), Verdict::Influences, "{columns}");
    }
}

/// Twenty labels of which two are used: half a visit for each of the others made 1.92 nats of it,
/// where ln 2 is possible.
#[test]
fn actions_that_nobody_uses_have_no_weight() {
    let prior = Prior::new(&Fit::cold(Alphabet {
        rows: 20,
        columns: 20,
    }));
    let table = Table::from_counts([(3, 7, 2), (3, 9, 2), (5, 7, 2), (5, 9, 2)]);
    let mut uses = [[0; 20], [0; 20]];
    uses[0][3] = 400;
    uses[0][5] = 300;
    uses[1][7] = 500;
    uses[1][9] = 200;
    let habits = Habits::new(&uses[0], &uses[1]);

    let posterior = prior.posterior(&habits, &[table]);

    assert_eq!(habits.largest_information(), 2_f64.ln());
    assert!(
        posterior.mean() < 0.2 && posterior.interval()[1] <= 2_f64.ln(),
        "{}",
        posterior.mean()
    );
    assert_eq!(posterior.above(0.7), 0.0);
}

/// A checkerboard of 25 x 25, seen 62,500 times with p = 2e-76, was excluded with certainty: no
/// slab was weak enough.
#[test]
fn weak_dependence_that_is_certain_is_established() {
    let alphabet = Alphabet {
        rows: 25,
        columns: 25,
    };
    let board = |lean: u64| {
        let n = |cell: u64| {
            if (cell / 25 + cell % 25).is_multiple_of(2) {
                100 + lean
            } else {
                100 - lean
            }
        };
        Table::from_counts((0..625).map(|cell| (cell / 25, cell % 25, n(cell))))
    };
    let prior = Prior::new(&Fit::cold(alphabet));
    let posterior = posterior_of(&prior, &board(15));

    assert_eq!(
        dependence(&believed(&prior, &board(15))),
        Dependence::Established
    );
    let [low, high] = posterior.interval();
    // Half the squared lean, less the bias of (25 - 1)^2 squares.
    let excess = 0.5 * 0.15 * 0.15 - 0.5 * 576.0 / 62_500.0;
    assert!(low <= excess && excess <= high, "{low} {high}");
    assert_ne!(
        dependence(&believed(&prior, &board(0))),
        Dependence::Established
    );
}

/// Five rows are alike and the sixth, which is rare, is not (p = .03 and less): slabs in which
/// every row has its own response took the five for evidence against.
#[test]
fn dependence_in_one_rare_action_is_not_excluded() {
    let rows: Vec<(u64, u64, u64)> = (0..30).map(|cell| (cell / 6, cell % 6, 40)).collect();
    let table = |rare: &[(u64, u64, u64)]| Table::from_counts(rows.iter().chain(rare).copied());
    let prior = cold();

    let same = posterior_of(
        prior,
        &table(&[
            (5, 0, 2),
            (5, 1, 2),
            (5, 2, 2),
            (5, 3, 1),
            (5, 4, 1),
            (5, 5, 2),
        ]),
    )
    .dependent();
    let differs = posterior_of(prior, &table(&[(5, 0, 9), (5, 1, 1)])).dependent();
    assert!(differs > 0.5 && differs > 5.0 * same, "{differs} {same}");
}

/// Odds that cannot move threefold any more left certain counts undecided for ever.
#[test]
fn certain_counts_decide() {
    let tables: Vec<Table> = (0..200)
        .map(|at| {
            let lean = at % 20;
            Table::from_counts([
                (0, 0, 300 + lean),
                (0, 1, 300 - lean),
                (1, 0, 300 - lean),
                (1, 1, 300 + lean),
            ])
        })
        .collect();
    let prior = fitted(
        Alphabet {
            rows: 2,
            columns: 2,
        },
        &tables,
    );

    assert!(
        tables
            .iter()
            .all(|table| verdict(&prior, table) == Verdict::NoInfluence)
    );
    // One or two transitions decide nothing, whatever the prior makes of them.
    let few = [vec![(0, 0, 1)], vec![(0, 0, 1), (1, 1, 1)], vec![(0, 0, 2)]];
    assert!(
        few.into_iter()
            .all(|cells| verdict(&prior, &Table::from_counts(cells)) == Verdict::Undecided)
    );
}

/// Thousands of states of three visits are explained alike by much dependence and by none.
#[test]
fn many_rarely_seen_states_do_not_make_dependence_common() {
    let mut random = rand_pcg::Pcg64::seed_from_u64(3);
    let mut throw = |sides: u64| random.random_range(0..sides);
    let tables: Vec<Table> = (0..3_000)
        .map(|_| Table::from_counts((0..3).map(|_| (throw(6), throw(2) * throw(3), 1))))
        .collect();

    assert!((fit(SIX, &tables).parameters.dependent - 0.3).abs() < 0.01);
}

/// Draws of two agents of whom each mostly takes its first action; the second answers `copied` of
/// the first one's second actions by its own second.
fn skewed(
    [rows, columns]: [u64; 2],
    visits: usize,
    copied: f64,
    random: &mut rand_pcg::Pcg64,
) -> Table {
    let mut mostly = |letters: u64| {
        if random.random_bool(0.95) {
            0
        } else {
            random.random_range(1..letters)
        }
    };
    let pairs: Vec<(u64, u64)> = (0..visits)
        .map(|_| (mostly(rows), mostly(columns)))
        .collect();
    let copies = |(ego, other): (u64, u64)| {
        if ego == 1 && random.random_bool(copied) {
            (1, 1, 1)
        } else {
            (ego, other, 1)
        }
    };
    Table::from_counts(pairs.into_iter().map(copies))
}

/// Between concentrations of 1,000 and a million the null had none, so that slabs told the
/// marginals of alike habits better: all of the noise was established.
#[test]
fn habits_that_are_alike_are_no_dependence() {
    let mut random = rand_pcg::Pcg64::seed_from_u64(11);
    for (letters, visits) in [([2, 25], 20_000), ([3, 64], 2_000), ([6, 6], 20_000)] {
        let copied = [vec![0.5; 4], vec![0.0; 26]].concat();
        let tables: Vec<Table> = copied
            .iter()
            .map(|share| skewed(letters, visits, *share, &mut random))
            .collect();
        let prior = fitted(
            Alphabet {
                rows: letters[0],
                columns: letters[1],
            },
            &tables,
        );

        let established =
            |table: &&Table| dependence(&believed(&prior, table)) == Dependence::Established;
        let found =
            [&tables[..4], &tables[4..]].map(|tables| tables.iter().filter(established).count());
        assert_eq!(found[1], 0, "{letters:?}");
        assert!(found[0] >= 2, "{letters:?}: {}", found[0]);
    }
}

/// Every term of one deviating row underflowed, and a fit of nothing was NaN.
#[test]
fn what_is_certainly_independent_is_told_in_numbers() {
    let mut random = rand_pcg::Pcg64::seed_from_u64(12);
    for (rows, columns) in [(2, 256), (256, 4), (2, 2)] {
        let mut pair = |_| {
            (
                random.random_range(0..rows),
                random.random_range(0..columns),
                1,
            )
        };
        let tables: Vec<Table> = (0..3)
            .map(|_| Table::from_counts((0..20_000).map(&mut pair)))
            .collect();
        let prior = fitted(Alphabet { rows, columns }, &tables);

        let posterior = posterior_of(&prior, &tables[0]);
        assert!(
            posterior.dependent() < 0.5 && posterior.mean() < 1e-3,
            "{rows} x {columns}: {posterior:?}"
        );
        assert!(prior.unseen().mean().is_finite());
    }
}

/// No Dirichlet row copies now and then: hundreds of visits of 25 x 25 were certain of too much.
#[test]
fn what_slabs_cannot_say_is_doubted() {
    let mut random = rand_pcg::Pcg64::seed_from_u64(13);
    let mut pair = |_| {
        let ego = random.random_range(0..25);
        (
            ego,
            if random.random_bool(0.5) {
                ego
            } else {
                random.random_range(0..25)
            },
            1,
        )
    };
    let tables: Vec<Table> = (0..20)
        .map(|_| Table::from_counts((0..500).map(&mut pair)))
        .collect();
    let prior = fitted(
        Alphabet {
            rows: 25,
            columns: 25,
        },
        &tables,
    );

    // 25 cells of (1/2 + 1/50) / 25, the others alike.
    let [same, other] = [0.52, 0.02_f64];
    let truth = same * (25.0 * same).ln() + 24.0 * other * (25.0 * other).ln();
    let covers = |table: &&Table| {
        let [low, high] = posterior_of(&prior, table).interval();
        low <= truth && truth <= high
    };
    assert!(tables.iter().filter(covers).count() >= 18);
}

/// A state's counts in segments: the whole, and its parts.
struct Segmented {
    whole: Table,
    parts: Vec<Table>,
}

impl Segmented {
    fn new(parts: Vec<Table>) -> Self {
        Self {
            whole: Table::sum(&parts),
            parts,
        }
    }

    fn counted(&self) -> Counted<'_> {
        Counted {
            slices: std::slice::from_ref(&self.whole),
            parts: &self.parts,
        }
    }

    fn counted_or_pooled(&self, is_cut: bool) -> Counted<'_> {
        if is_cut {
            self.counted()
        } else {
            self.counted().slices.into()
        }
    }
}

/// States of so many segments, each with habits of its own or not; `response` gives the other's
/// distribution in a segment after an action, given its habit there.
fn in_segments(
    states: usize,
    segments: usize,
    visits: usize,
    differ: bool,
    response: impl Fn(usize, usize, u64, &[f64]) -> Vec<f64>,
) -> Vec<Segmented> {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(11);
    let state = |state: usize| {
        let mut habits = [(); 2].map(|()| {
            (0..6)
                .map(|_| -rng.random::<f64>().ln())
                .collect::<Vec<f64>>()
        });
        let part = |segment: usize| {
            if differ {
                habits = [(); 2].map(|()| (0..6).map(|_| -rng.random::<f64>().ln()).collect());
            }
            let cells = (0..visits).map(|_| {
                let row = drawn(&habits[0], rng.random());
                (
                    row,
                    drawn(&response(state, segment, row, &habits[1]), rng.random()),
                    1,
                )
            });
            Table::from_counts(cells.collect::<Vec<_>>())
        };
        Segmented::new((0..segments).map(part).collect())
    };
    (0..states).map(state).collect()
}

fn drawn(weights: &[f64], point: f64) -> u64 {
    let mut left = point * weights.iter().sum::<f64>();
    let at = weights.iter().position(|weight| {
        left -= weight;
        left < 0.0
    });
    at.unwrap_or(weights.len() - 1) as u64
}

fn fitted_to(states: &[Segmented], is_cut: bool) -> Prior {
    let states: Vec<Counted<'_>> = states
        .iter()
        .map(|state| state.counted_or_pooled(is_cut))
        .collect();
    let mut uses = Uses::new(SIX);
    states.iter().for_each(|state| uses.add(*state));
    let mut fitter = Fitter::new(SIX, &uses);
    states.iter().for_each(|state| fitter.add(*state));
    Prior::new(&fitter.fit())
}

fn established(prior: &Prior, states: &[Segmented], is_cut: bool) -> usize {
    let is_established = |state: &&Segmented| {
        let beliefs = prior
            .posterior(prior.habits(), state.counted_or_pooled(is_cut))
            .beliefs(0.5);
        let believed = Believed::new(
            beliefs,
            prior.unseen().beliefs(0.5),
            std::slice::from_ref(&state.whole),
        );
        dependence(&believed) == Dependence::Established
    };
    states.iter().filter(is_established).count()
}

/// Pooled, a sixth to a third of them are established at P = 1.
#[test]
fn habits_that_differ_by_segment_are_not_dependence() {
    for (segments, visits) in [(2, 75), (8, 20), (50, 3)] {
        let states = in_segments(120, segments, visits, true, |_, _, _, habit| habit.to_vec());
        let prior = fitted_to(&states, true);

        assert!(
            established(&prior, &states, true) <= 1,
            "{segments} segments"
        );
        let differ = prior
            .posterior(prior.habits(), states[0].counted())
            .by_segment()
            .map(|one| one.differ);
        assert!(differ > Some(0.9), "{segments} segments: {differ:?}");
    }
    let states = in_segments(120, 2, 75, true, |_, _, _, habit| habit.to_vec());
    assert!(established(&fitted_to(&states, false), &states, false) >= 12);
}

/// A third of the states have responses of their own to each action, the same in all segments.
fn responds(state: usize, _: usize, row: u64, habit: &[f64]) -> Vec<f64> {
    let own =
        |column: usize| (((state as u64 * 7 + row * 5) as usize + column) % 6 * 3 % 7) as f64 + 0.2;
    if state.is_multiple_of(3) {
        (0..6).map(own).collect()
    } else {
        habit.to_vec()
    }
}

#[test]
fn dependence_that_all_segments_share_is_found_as_pooled() {
    let states = in_segments(90, 6, 20, false, responds);
    let [cut, pooled] =
        [true, false].map(|is_cut| established(&fitted_to(&states, is_cut), &states, is_cut));
    assert!(pooled >= 20 && cut.abs_diff(pooled) <= 1, "{cut} {pooled}");
}

/// Mutual information is that within segments: the ego's habits say which segment it is, and the
/// pooled table what the segments are.
#[test]
fn information_is_within_segments() {
    let states = in_segments(60, 6, 60, true, responds);
    let prior = fitted_to(&states, true);
    let within = |state: &Segmented| {
        let total = state.whole.total() as f64;
        let part = |part: &Table| {
            part.total() as f64 / total * (plug_in(part) - expected_if_independent(part).0)
        };
        state.parts.iter().map(part).sum::<f64>()
    };
    for state in states.iter().step_by(3) {
        let posterior = prior.posterior(prior.habits(), state.counted());
        let (told, excess) = (posterior.mean(), within(state));
        assert!(
            (told - excess).abs() < 0.1 + 0.2 * excess,
            "{told} {excess}"
        );
    }
}

#[test]
fn the_order_of_the_variables_changes_no_bit_of_what_is_cut() {
    let states = in_segments(4, 5, 12, true, responds);
    for state in states {
        let turned = Segmented::new(state.parts.iter().map(Table::transposed).collect());
        let [prior, exchanged] = [&*UNEVEN, &*UNEVEN_EXCHANGED];
        let [one, other] = [(prior, &state), (exchanged, &turned)]
            .map(|(prior, state)| prior.posterior(prior.habits(), state.counted()));
        assert_eq!(
            (one.dependent(), one.mean(), one.interval()),
            (other.dependent(), other.mean(), other.interval())
        );
        assert_eq!(one.by_segment(), other.by_segment());
        assert_eq!(prior.dependent(state.counted()), one.dependent());
    }
}

/// Independent actions in one state of so many slices, by the prior that nothing was fitted to: in
/// this share of visits of a slice the ego's is the slice's own letter, else any.
fn of_independent_slices(letters: u64, slices: u64, visits: u64, share: f64, seed: u64) -> f64 {
    let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
    let slice = |own: u64| {
        let each = (0..visits).map(|_| {
            let mut letter = || random.random_range(0..letters);
            let (any, other) = (letter(), letter());
            let row = if random.random_bool(share) {
                own % letters
            } else {
                any
            };
            (row, other, 1)
        });
        Table::from_counts(each.collect::<Vec<_>>())
    };
    let tables: Vec<Table> = (0..slices).map(slice).collect();
    let base = || Base::new(&vec![1_000; letters as usize]);
    let alphabet = Alphabet {
        rows: letters,
        columns: letters,
    };
    let fit = Fit {
        bases: [base(), base()],
        ..Fit::cold(alphabet)
    };
    Prior::new(&fit).dependent(&tables)
}

#[test]
fn many_slices_of_few_visits_are_no_dependence() {
    for (letters, slices, visits, share) in [
        (3, 243, 8, 0.0),
        (4, 256, 8, 0.0),
        (2, 128, 16, 0.0),
        (6, 216, 5, 0.0),
        (12, 144, 20, 0.0),
        (25, 25, 100, 0.8),
        (64, 64, 200, 0.8),
        (128, 128, 312, 0.8),
    ] {
        for seed in 0..3 {
            let p = of_independent_slices(letters, slices, visits, share, seed);
            assert!(
                p < 0.5,
                "{letters} letters, {slices} slices, {visits} visits: {p}"
            );
        }
    }
}
