//! Joint distributions of two agents' actions, and how they and visits are drawn.

use rand::RngExt;
use rand_distr::{Binomial, Distribution, Gamma};
use rand_pcg::Pcg64;

use nudge_core::information::Table;

/// Draws from the symmetric Dirichlet distribution.
pub(super) fn dirichlet(concentration: f64, letters: usize, rng: &mut Pcg64) -> Vec<f64> {
    let gamma = Gamma::new(concentration, 1.0).expect("a positive concentration");
    let draws: Vec<f64> = (0..letters).map(|_| gamma.sample(rng)).collect();
    let sum: f64 = draws.iter().sum();
    draws.into_iter().map(|draw| draw / sum).collect()
}

/// Returns (1 - share) a + share b.
pub(super) fn mixed(a: &[f64], b: &[f64], share: f64) -> Vec<f64> {
    a.iter()
        .zip(b)
        .map(|(a, b)| (1.0 - share) * a + share * b)
        .collect()
}

/// A response of its own to one action, and how strongly the other is drawn to it.
#[derive(Debug, Clone)]
pub(super) struct Pull {
    pub action: usize,
    pub share: f64,
    pub response: Vec<f64>,
}

/// Draws responses to so many of the ego's actions.
pub(super) fn pulls(rows: usize, columns: usize, drawn: usize, rng: &mut Pcg64) -> Vec<Pull> {
    let mut actions: Vec<usize> = (0..rows).collect();
    shuffle(&mut actions, rng);
    let mut pull = |action: &usize| {
        let share = rng.random_range(0.5..1.0);
        Pull {
            action: *action,
            share,
            response: dirichlet(0.1, columns, rng),
        }
    };
    actions[..drawn].iter().map(&mut pull).collect()
}

/// Returns rows that are all alike, but for those that are drawn to a response of their own.
pub(super) fn pulled(rows: usize, shared: &[f64], pulls: &[Pull]) -> Vec<Vec<f64>> {
    let mut rows = vec![shared.to_vec(); rows];
    for Pull {
        action,
        share,
        response,
    } in pulls
    {
        rows[*action] = mixed(shared, response, *share);
    }
    rows
}

pub(super) fn joint(policy: &[f64], rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
    policy
        .iter()
        .zip(rows)
        .map(|(p, row)| row.iter().map(|q| p * q).collect())
        .collect()
}

pub(super) fn margins(joint: &[Vec<f64>]) -> (Vec<f64>, Vec<f64>) {
    let columns = (0..joint[0].len())
        .map(|column| joint.iter().map(|row| row[column]).sum())
        .collect();
    (joint.iter().map(|row| row.iter().sum()).collect(), columns)
}

pub(super) fn product_of_margins(cells: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let (rows, columns) = margins(cells);
    joint(&rows, &vec![columns; rows.len()])
}

/// Returns the mutual information of a joint distribution, I = sum_ij p_ij ln(p_ij / (p_i p_j)), in
/// nats.
pub fn information(joint: &[Vec<f64>]) -> f64 {
    let (rows, columns) = margins(joint);
    let cells = joint
        .iter()
        .zip(&rows)
        .flat_map(|(cells, r)| cells.iter().zip(&columns).map(move |(p, c)| (*p, r * c)));
    cells
        .filter(|(p, _)| *p > 0.0)
        .map(|(p, independent)| p * (p / independent).ln())
        .sum::<f64>()
        .max(0.0)
}

/// Draws visits: pairs of actions.
pub(super) fn draw(joint: &[Vec<f64>], visits: usize, rng: &mut Pcg64) -> Vec<(u64, u64)> {
    let columns = joint[0].len();
    let mut reached = 0.0;
    let cumulative: Vec<f64> = joint
        .iter()
        .flatten()
        .map(|p| {
            reached += p;
            reached
        })
        .collect();

    let mut visit = || {
        let point = rng.random::<f64>() * reached;
        let at = cumulative
            .partition_point(|end| *end <= point)
            .min(cumulative.len() - 1);
        ((at / columns) as u64, (at % columns) as u64)
    };
    (0..visits).map(|_| visit()).collect()
}

/// Draws the counts of visits, a binomial draw a cell.
pub(super) fn multinomial(joint: &[Vec<f64>], visits: usize, rng: &mut Pcg64) -> Table {
    let (mut left, mut unspent) = (visits as u64, 1.0);
    let mut counts = Vec::new();
    for (i, row) in joint.iter().enumerate() {
        for (j, p) in row.iter().enumerate() {
            let share = if unspent > 0.0 {
                (p / unspent).clamp(0.0, 1.0)
            } else {
                0.0
            };
            let n = Binomial::new(left, share)
                .expect("a share within 0 to 1")
                .sample(rng);
            counts.push((i as u64, j as u64, n));
            left -= n;
            unspent -= p;
        }
    }
    Table::from_counts(counts)
}

/// Returns cells in proportion to p e^(a z), of the same sum.
pub(super) fn tilted(joint: &[Vec<f64>], noise: &[f64], a: f64) -> Vec<Vec<f64>> {
    let columns = joint[0].len();
    let mut cells = joint.to_vec();
    for (i, row) in cells.iter_mut().enumerate() {
        row.iter_mut()
            .zip(&noise[i * columns..])
            .for_each(|(p, z)| *p *= (a * z).exp());
    }
    let sum: f64 = cells.iter().flatten().sum();
    cells.iter_mut().flatten().for_each(|p| *p /= sum);
    cells
}

/// Shuffles by Fisher and Yates.
pub(super) fn shuffle<T>(items: &mut [T], rng: &mut Pcg64) {
    for last in (1..items.len()).rev() {
        items.swap(last, rng.random_range(0..=last));
    }
}
