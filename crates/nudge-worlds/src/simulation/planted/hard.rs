//! Worlds unlike the usual three: other alphabets, other habits, other kinds and strengths of
//! dependence, other volumes.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::joint::{dirichlet, information, joint, mixed, pulled, pulls, shuffle, tilted};

/// The action that agents mostly take where they have a habit.
const STAY: usize = 5;

/// Labels of a masked world, and how many of them each agent may use in a state.
const LABELS: usize = 20;
const LEGAL: usize = 3;

/// The mutual information of weakly dependent states, in nats.
const WEAK: [f64; 2] = [0.01, 0.1];

/// How often a copying state copies always.
const ALWAYS: f64 = 0.2;

/// Two actions each: every response is as likely as any other.
pub fn two_by_two(dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let policy = dirichlet(1.0, 2, rng);
    joint(
        &policy,
        &own_or_shared(2, dependent, || dirichlet(1.0, 2, rng)),
    )
}

/// Three actions against twenty-five.
pub fn three_by_twenty_five(dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let policy = dirichlet(1.0, 3, rng);
    joint(
        &policy,
        &own_or_shared(3, dependent, || dirichlet(0.2, 25, rng)),
    )
}

/// Both agents mostly stay: the ego with probability `[0]`, the other with `[1]`, the rest drawn
/// with the concentrations `[2]` and `[3]`.
pub fn stays(
    letters: usize,
    [ego, other, p, q]: [f64; 4],
    dependent: bool,
    rng: &mut Pcg64,
) -> Vec<Vec<f64>> {
    let stay = unit(STAY, letters);
    let policy = mixed(&stay, &dirichlet(p, letters, rng), 1.0 - ego);
    let shared = mixed(&stay, &dirichlet(q, letters, rng), 1.0 - other);
    joint(&policy, &some_rows_drawn(letters, &shared, dependent, rng))
}

/// Only the sixth action does anything, and it is taken three times in a hundred.
pub fn rare(dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let mut policy = dirichlet(2.0, 5, rng);
    policy.iter_mut().for_each(|p| *p *= 0.97);
    policy.push(0.03);
    let mut rows = vec![dirichlet(1.0, 6, rng); 6];
    if dependent {
        rows[5] = dirichlet(0.1, 6, rng);
    }
    joint(&policy, &rows)
}

/// The ego takes its best action nine times in ten, another one otherwise.
pub fn epsilon_greedy(dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let mut policy = vec![0.1 / 5.0; 6];
    policy[rng.random_range(0..6)] = 0.9;
    let shared = dirichlet(0.7, 6, rng);
    joint(&policy, &some_rows_drawn(6, &shared, dependent, rng))
}

/// The other does what the ego does, or (`permuted`) what belongs to it: now and then, mostly, or
/// always.
pub fn copy(letters: usize, permuted: bool, dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let (policy, shared) = (dirichlet(1.0, letters, rng), dirichlet(0.7, letters, rng));
    let always = rng.random_bool(ALWAYS);
    let share = if always {
        1.0
    } else {
        rng.random_range(0.1..0.9)
    };

    let mut answers: Vec<usize> = (0..letters).collect();
    if permuted {
        shuffle(&mut answers, rng);
    }
    let share = if dependent { share } else { 0.0 };
    let rows: Vec<Vec<f64>> = answers
        .into_iter()
        .map(|j| mixed(&shared, &unit(j, letters), share))
        .collect();
    joint(&policy, &rows)
}

/// Every cell is a little likelier or less likely than its margins say.
pub fn weak(letters: usize, dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let (policy, shared) = (dirichlet(1.0, letters, rng), dirichlet(1.0, letters, rng));
    let product = joint(&policy, &vec![shared; letters]);
    if !dependent {
        return product;
    }

    let noise: Vec<f64> = (0..letters * letters)
        .map(|_| StandardNormal.sample(rng))
        .collect();
    let wanted = rng.random_range(WEAK[0].ln()..WEAK[1].ln()).exp();

    let [mut low, mut high] = [0.0, 4.0];
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if information(&tilted(&product, &noise, middle)) < wanted {
            low = middle
        } else {
            high = middle
        }
    }
    tilted(&product, &noise, high)
}

/// Each agent may use three of its twenty labels in a state.
pub fn masked(dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let [egos, others] = [legal(rng), legal(rng)];
    let policy = dirichlet(1.0, LEGAL, rng);
    let rows = own_or_shared(LEGAL, dependent, || dirichlet(1.0, LEGAL, rng));
    let mut cells = vec![vec![0.0; LABELS]; LABELS];
    for (i, ego) in egos.iter().enumerate() {
        for (j, other) in others.iter().enumerate() {
            cells[*ego][*other] = policy[i] * rows[i][j];
        }
    }
    cells
}

/// The habits of one segment, in which nothing depends on anything.
pub fn segment(rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let policy = dirichlet(1.0, 6, rng);
    joint(&policy, &vec![dirichlet(1.0, 6, rng); 6])
}

fn own_or_shared(
    rows: usize,
    dependent: bool,
    mut response: impl FnMut() -> Vec<f64>,
) -> Vec<Vec<f64>> {
    if dependent {
        (0..rows).map(|_| response()).collect()
    } else {
        vec![response(); rows]
    }
}

/// Returns rows that are all alike, of which two or more are drawn towards a response of their own
/// where there is dependence.
pub fn some_rows_drawn(
    letters: usize,
    shared: &[f64],
    dependent: bool,
    rng: &mut Pcg64,
) -> Vec<Vec<f64>> {
    let drawn = if dependent {
        rng.random_range(2..=letters)
    } else {
        0
    };
    pulled(letters, shared, &pulls(letters, letters, drawn, rng))
}

fn legal(rng: &mut Pcg64) -> Vec<usize> {
    let mut labels: Vec<usize> = (0..LABELS).collect();
    shuffle(&mut labels, rng);
    labels.truncate(LEGAL);
    labels
}

fn unit(at: usize, letters: usize) -> Vec<f64> {
    (0..letters)
        .map(|letter| f64::from(u8::from(letter == at)))
        .collect()
}
