//! What moments are: their formulas cell by cell, closed forms, and limits that need no formula of
//! ours.

use statrs::function::gamma::digamma;

use super::super::base::Groups;
use super::*;
use crate::information::plug_in;
use crate::information::samples::grid;

/// Of sums of a few dozen terms.
const ROUNDING: f64 = 1e-11;

fn assert_close(told: f64, expected: f64, what: &str) {
    assert!(
        (told - expected).abs() <= ROUNDING * expected.abs().max(1.0),
        "{what}: {told} instead of {expected}"
    );
}

fn assert_moments(told: Moments, expected: [f64; 3], what: &str) {
    let told = [told.mean, told.variance, told.wide];
    for ((told, expected), figure) in told
        .into_iter()
        .zip(expected)
        .zip(["mean", "narrow", "wide"])
    {
        assert_close(told, expected, &format!("{figure} of {what}"));
    }
}

/// A slice under a slab, every row and every letter by itself.
pub struct Dense<'a> {
    /// n_ij.
    pub counts: &'a [Vec<f64>],
    /// k and m.
    pub concentration: f64,
    pub base: &'a [f64],
    /// kappa and h.
    pub habit: f64,
    pub habits: &'a [f64],
}

impl Dense<'_> {
    /// Returns mean, variance and the wider one as they are defined.
    pub fn moments(&self) -> [f64; 3] {
        let k = self.concentration;
        let visits: Vec<f64> = self.counts.iter().map(|row| row.iter().sum()).collect();
        let weight = visits.iter().sum::<f64>() + self.habit;
        let p: Vec<f64> = visits
            .iter()
            .zip(self.habits)
            .map(|(r, h)| (r + self.habit * h) / weight)
            .collect();
        let parameters = |row: &Vec<f64>| -> Vec<f64> {
            row.iter().zip(self.base).map(|(n, m)| n + k * m).collect()
        };
        let a: Vec<Vec<f64>> = self.counts.iter().map(parameters).collect();

        let mut freedom = Freedom::default();
        let mut unvisited = [0.0; 2];
        for (p, r) in p.iter().zip(&visits) {
            if *r > 0.0 {
                freedom.add_row(*p, r + k);
            } else {
                unvisited = [unvisited[0] + p, unvisited[1] + p * p];
            }
        }
        freedom.add_alike(unvisited[0], unvisited[1], k);

        defined(&p, &a, weight, freedom)
    }
}

/// Mean, variance and the wider one of rows with the mean policy p, of concentration S, and the
/// Dirichlet parameters a_ij; `freedom` has their rows.
fn defined(p: &[f64], a: &[Vec<f64>], weight: f64, mut freedom: Freedom) -> [f64; 3] {
    let rows = 0..p.len();
    let square = |i: usize| p[i] * p[i] + p[i] * (1.0 - p[i]) / (weight + 1.0);
    let sums: Vec<f64> = a.iter().map(|row| row.iter().sum()).collect();
    let rho = |i: usize, j: usize| a[i][j] / sums[i];
    let q: Vec<f64> = (0..a[0].len())
        .map(|j| rows.clone().map(|i| p[i] * rho(i, j)).sum())
        .collect();

    let (mut mean, mut variance, mut first, mut second) = (0.0, 0.0, 0.0, 0.0);
    for i in rows.clone() {
        let entropy = digamma(sums[i] + 1.0)
            - a[i].iter().map(|a| a * digamma(a + 1.0)).sum::<f64>() / sums[i];
        let over = |power| {
            let term = |(j, q): (usize, &f64)| rho(i, j) * (rho(i, j) / q).ln().powi(power);
            q.iter().enumerate().map(term).sum::<f64>()
        };
        let (along, along_squared) = (over(1), over(2));

        mean -= p[i] * entropy;
        variance += square(i) * (along_squared - along * along) / (sums[i] + 1.0);
        first += p[i] * along;
        second += p[i] * along * along;
    }

    for (j, q) in q.iter().enumerate() {
        let of_row = |i: usize| square(i) * rho(i, j) * (1.0 - rho(i, j)) / (sums[i] + 1.0);
        let squares: f64 = rows.clone().map(|i| p[i] * rho(i, j) * rho(i, j)).sum();
        let v = rows.clone().map(of_row).sum::<f64>() + (squares - q * q) / (weight + 1.0);
        let sharpness = q * (1.0 - q) / v - 1.0;

        mean -= q * (digamma(q * sharpness + 1.0) - digamma(sharpness + 1.0));
        freedom.add_letters(*q, 1.0);
    }

    let spread = variance + (second - first * first) / (weight + 1.0);
    let [narrow, wide] = freedom.variances(mean - first);
    [mean, spread + narrow, spread + wide]
}

/// Returns the moments of a table of counts under the slab of concentration k on this base.
fn told(counts: &[&[u64]], k: f64, base: &[f64], habit: f64, habits: &[f64]) -> Moments {
    let table = grid(counts);
    let usage = Usage::of_shares(habits.to_vec());
    let deviants = Deviants::none();
    let slice = Slice::new(
        &table,
        &deviants,
        Policy::new(table.total(), &usage, Some(habit)),
        Groups::new(base).without(table.column_labels()),
    );

    let letter = |label: &u64| Letter {
        share: base[*label as usize],
        empty: Term::new(k * base[*label as usize]),
    };
    let columns: Vec<Letter> = table.column_labels().iter().map(letter).collect();
    let slab = Slab {
        concentration: k,
        columns: &columns,
        psi: base.iter().map(|m| Term::new(k * m).psi).sum(),
        rest: &slice.rest,
    };

    moments(
        &slice,
        &slab,
        |r| Concentration::new(r as f64 + k),
        |at, n| Term::new(n as f64 + k * columns[at].share),
    )
}

/// Tables with rows and columns that were not visited, with nothing else, and without any.
#[test]
fn moments_are_sums_over_cells() {
    let tables: [[[u64; 4]; 3]; 5] = [
        [[3, 0, 1, 0], [0; 4], [1, 0, 5, 0]],
        [[0; 4], [0, 0, 0, 2], [0; 4]],
        [[0; 4]; 3],
        [[7, 1, 2, 4], [0, 3, 0, 30], [2, 2, 9, 1]],
        [[4_000, 3, 0, 70], [12, 0, 0, 5], [0; 4]],
    ];
    // Two letters that are alike; a row that is not in use, be it visited or not.
    let bases = [[0.3, 0.1, 0.5, 0.1], [0.25; 4]];
    let policies = [(2.5, [0.5, 0.2, 0.3]), (0.7, [0.0, 0.5, 0.5])];

    for table in tables {
        let rows: Vec<&[u64]> = table.iter().map(|row| &row[..]).collect();
        let counts = table.map(|row| row.map(|n| n as f64).to_vec());

        for (base, (habit, habits)) in bases.iter().zip(&policies) {
            for concentration in [0.1, 1.7, 40.0] {
                let expected = Dense {
                    counts: &counts,
                    concentration,
                    base,
                    habit: *habit,
                    habits,
                };
                assert_moments(
                    told(&rows, concentration, base, *habit, habits),
                    expected.moments(),
                    &format!("{table:?} at {concentration}"),
                );
            }
        }
    }
}

#[test]
fn two_rows_are_a_table_of_two_rows() {
    let usage = Usage::of_shares(vec![0.25; 4]);
    let policy = Policy::new(3, &usage, Some(1.5));
    // The others' parameters and the deviating row's; two letters are alike.
    let a = [[2.3, 0.4], [0.6, 3.1], [0.2, 0.15]];
    let column = |(a, letters): ([f64; 2], f64)| Pair {
        a,
        terms: a.map(Term::new),
        letters,
    };
    let columns: Vec<Pair> = a.into_iter().zip([1.0, 1.0, 2.0]).map(column).collect();

    for p in [0.125, 0.5, 0.9] {
        let rows = [0, 1].map(|row| vec![a[0][row], a[1][row], a[2][row], a[2][row]]);
        let mut freedom = Freedom::default();
        freedom.add_row(p, rows[1].iter().sum());

        assert_moments(
            two_rows(p, &policy, &columns),
            defined(&[1.0 - p, p], &rows, 4.5, freedom),
            &format!("a row of {p}"),
        );
    }
}

/// Two rows as probable, each with any response as likely as another: a row has half a nat on the
/// average, and the marginal, whose density is a triangle, 5/6 - ln 2 / 3. Its Beta distribution is
/// not quite a triangle.
#[test]
fn two_flat_rows_have_a_third_of_what_a_coin_lacks() {
    const OFF_THE_TRIANGLE: f64 = 1e-3;
    let flat = told(&[], 2.0, &[0.5; 2], 1e9, &[0.5; 2]);

    let expected = (1.0 - 2_f64.ln()) / 3.0;

    assert!(
        (flat.mean - expected).abs() < OFF_THE_TRIANGLE,
        "{} instead of {expected}",
        flat.mean
    );
}

/// Of many visits the prior is forgotten: the mean is the plug-in estimate, and the variance that
/// of the logarithm over N, by the delta method.
#[test]
fn many_visits_tell_what_they_say() {
    const FORGOTTEN: f64 = 1e-5;
    let counts: [&[u64]; 2] = [&[3_000_000, 1_000_000], &[2_000_000, 4_000_000]];
    let table = grid(&counts);

    let many = told(&counts, 1.5, &[0.8, 0.2], 2.0, &[0.6, 0.4]);

    let (p, q) = ([0.4, 0.6], [0.5, 0.5]);
    let joint = [[0.3, 0.1], [0.2, 0.4]];
    let moment = |power: i32| -> f64 {
        let cells = [(0, 0), (0, 1), (1, 0), (1, 1)];
        let term = |(i, j): (usize, usize)| {
            let joint: f64 = joint[i][j];
            joint * (joint / (p[i] * q[j])).ln().powi(power)
        };
        cells.into_iter().map(term).sum()
    };
    let variance = (moment(2) - moment(1).powi(2)) / 1e7;

    assert!((many.mean - plug_in(&table)).abs() < FORGOTTEN);
    for told in [many.variance, many.wide] {
        assert!(
            (told / variance - 1.0).abs() < FORGOTTEN,
            "{told} instead of {variance}"
        );
    }
}

/// A letter that is as likely anywhere has 1/4 of a nat, the integral of -q ln q.
#[test]
fn a_letter_has_the_entropy_of_its_beta_distribution() {
    let entropy = |mean, variance| Share { mean, variance }.entropy();

    assert_close(entropy(0.5, 1.0 / 12.0), 0.25, "any share");
    // Beta(2, 1), whose density is 2 q.
    assert_close(entropy(2.0 / 3.0, 1.0 / 18.0), 2.0 / 9.0, "a rising share");
    assert_close(entropy(0.2, 0.0), 0.2 * 5_f64.ln(), "a known share");
    // No share in between has a larger variance.
    let most = 0.3 * 0.7;
    for variance in [most, 2.0 * most] {
        assert!(entropy(0.3, variance) < 1e-5, "one or the other");
    }
    for certain in [0.0, 1.0] {
        assert_eq!(entropy(certain, 0.0), 0.0, "{certain}");
    }
}

#[test]
fn one_letter_tells_nothing() {
    let one = told(&[&[3], &[40]], 0.1, &[1.0], 2.0, &[0.3, 0.7]);
    assert_moments(one, [0.0; 3], "one letter");
}

/// By the Dirichlet distribution with parameters 1/2, 2 + 1/4, 5 + 1/4 and 0 of the fourth, which
/// is not in use: E p^2 = a (a + 1) / S (S + 1).
#[test]
fn a_policy_is_a_dirichlet_distribution() {
    let usage = Usage::of_shares(vec![0.5, 0.25, 0.25, 0.0]);
    let table = grid(&[&[0, 0], &[2, 0], &[1, 4]]);
    let policy = Policy::new(table.total(), &usage, Some(1.0));

    assert_eq!(policy.parameters(&table), [0.5, 2.25, 5.25, 0.0]);
    assert_eq!(policy.probability(1, 2), 2.25 / 8.0);
    assert_eq!(policy.habitual(), 1.0 / 8.0);
    assert_close(
        policy.square(2.25 / 8.0),
        2.25 * 3.25 / (8.0 * 9.0),
        "square",
    );
    // Half a visit for each of three letters in use.
    assert_eq!(Policy::new(7, &usage, None).weight, 8.5);
}

#[test]
fn rows_in_use_that_were_not_visited_are_told_together() {
    let usage = Usage::of_shares(vec![0.5, 0.25, 0.125, 0.125, 0.0]);
    let unvisited = |counts: &[&[u64]]| {
        let table = grid(counts);
        Policy::new(table.total(), &usage, Some(2.0)).unvisited(&table)
    };

    // The last two in use, with 2 / 8 each of a total of 6 + 2 visits.
    let two = unvisited(&[&[3], &[3]]);
    let p = 0.25 / 8.0;
    assert_eq!((two.rows, two.p), (2.0, 2.0 * p));
    assert_close(two.squared, 2.0 * p * p, "squares");
    assert_close(two.square, 2.0 * 0.25 * 1.25 / (8.0 * 9.0), "E p^2");

    let all = unvisited(&[]);
    assert_eq!((all.rows, all.p), (4.0, 1.0));

    // One that was visited though it is not in use stands for none of them.
    let one = unvisited(&[&[1], &[1], &[1], &[0], &[3]]);
    assert_eq!((one.rows, one.p), (1.0, p));

    let none = unvisited(&[&[3], &[1], &[1], &[1]]);
    assert_eq!((none.rows, none.p, none.square), (0.0, 0.0, 0.0));
}

/// The mean over parts, and by the law of total variance what they have within and between them.
#[test]
fn moments_of_a_mixture_obey_the_law_of_total_variance() {
    let part = |mean, variance, wide| Moments {
        mean,
        variance,
        wide,
    };
    let parts = [(1.0, part(1.0, 2.0, 3.0)), (3.0, part(5.0, 4.0, 8.0))];

    // (1 (2 + 3^2) + 3 (4 + 1^2)) / 4, and (1 (3 + 3^2) + 3 (8 + 1^2)) / 4.
    assert_moments(Moments::mixed(&parts), [4.0, 6.5, 9.75], "a mixture");
}

#[test]
fn moments_are_scaled_and_doubted() {
    let moments = Moments {
        mean: 3.0,
        variance: 5.0,
        wide: 7.0,
    };

    assert_moments(moments.scaled(4.0), [12.0, 80.0, 112.0], "four times");
    // 3 / 2 more of the standard deviation, in squares.
    assert_moments(moments.doubted(0.5), [3.0, 7.25, 9.25], "half in doubt");
}
