//! Conditional mutual information given the segment, as a share of the pooled one, where all
//! segments share their responses.

use super::habits::Usage;
use super::prior::Prior;
use super::readings::Readings;
use super::weights::Weights;
use crate::information::Table;

/// Differences of habits that are less probable change nothing; nor do slabs of one side that weigh
/// less.
const NEGLIGIBLE: f64 = 0.01;
/// The most cells of all parts together for which shares of mutual information are found.
const MOST_CELLS: usize = 1_000_000;

impl Prior {
    /// Returns by which factor mutual information within segments is smaller than that of the
    /// pooled table, where all segments share their responses.
    pub(super) fn within(
        &self,
        side: usize,
        weights: &Weights,
        readings: &Readings<'_>,
        usages: &[Usage; 2],
    ) -> f64 {
        let ([whole], Some(segments)) = (&readings.wholes[..], &weights.segments) else {
            return 1.0;
        };
        let (whole, parts, policy) = (&whole[side], &readings.parts, &usages[side].shares);
        let letters = self.sides[side].letters();
        // The driver of a side responds on the other.
        let differ = segments.differ[1 - side] > NEGLIGIBLE
            && weights.slabs[side].iter().sum::<f64>() > NEGLIGIBLE;
        if !differ || policy.len() * letters * parts.number() > MOST_CELLS {
            return 1.0;
        }

        let rows = rows(whole, policy.len());
        let responses = self.sides[side].responses(
            &weights.slabs[side],
            whole,
            &weights.deviants[0][side],
            &rows,
        );
        let responses = Responses::new(&responses, letters);
        let all = responses.mixed(&policy_of(whole, policy));
        let mut mixture = all.clone();
        let mut information = |visits: u64, labels: &[u64], counts: &[u64]| {
            let of_part = self.sides[side].part_policy(visits, &usages[side]);
            mixture.set(of_part.habitual(), &all);
            for (label, r) in labels.iter().zip(counts) {
                let Ok(row) = whole.row_labels().binary_search(label) else {
                    continue;
                };
                mixture.add(*r as f64 / of_part.weight, &responses.0[row]);
            }
            visits as f64 * mixture.information()
        };

        let several = parts.several.iter().map(|part| &part[side]);
        let several: f64 = several
            .map(|part| information(part.total(), part.row_labels(), part.rows()))
            .sum();
        let single = parts.single.drivers(side);
        let single: f64 = single
            .map(|(label, n)| n * information(1, &[label as u64], &[1]))
            .sum();
        let (within, pooled) = ((several + single) / parts.visits(), all.information());
        if pooled > 0.0 {
            (within / pooled).clamp(0.0, 1.0)
        } else {
            1.0
        }
    }
}

/// Returns the visited rows of a table, and one for all others, by label and number: these answer
/// alike.
fn rows(table: &Table, letters: usize) -> Vec<(usize, f64)> {
    let labels = table.row_labels();
    let unvisited = (0..letters).find(|label| labels.get(*label) != Some(&(*label as u64)));
    let others = unvisited.map(|label| (label, (letters - labels.len()) as f64));
    labels
        .iter()
        .map(|label| (*label as usize, 1.0))
        .chain(others)
        .collect()
}

/// Returns the probabilities of these rows, given that of each letter.
fn policy_of(table: &Table, policy: &[f64]) -> Vec<f64> {
    let visited = table
        .row_labels()
        .iter()
        .map(|label| policy[*label as usize]);
    let others = (1.0 - visited.clone().sum::<f64>()).max(0.0);
    visited.chain([others]).collect()
}

/// Responses rho_i of rows, and sum_j rho_ij ln rho_ij.
struct Responses(Vec<(Vec<f64>, f64)>);

impl Responses {
    /// Makes them of so many letters each, rows first, up to a factor.
    fn new(responses: &[f64], letters: usize) -> Self {
        let row = |cells: &[f64]| {
            let total = cells.iter().sum::<f64>().max(f64::MIN_POSITIVE);
            let rho: Vec<f64> = cells.iter().map(|cell| cell / total).collect();
            let ordered = rho.iter().map(|rho| x_ln_x(*rho)).sum();
            (rho, ordered)
        };
        Self(responses.chunks(letters).map(row).collect())
    }

    /// Mixes them by the probabilities of the rows.
    fn mixed(&self, policy: &[f64]) -> Mixture {
        let letters = self.0.first().map_or(0, |(rho, _)| rho.len());
        let mut mixture = Mixture {
            marginal: vec![0.0; letters],
            ordered: 0.0,
        };

        policy
            .iter()
            .zip(&self.0)
            .for_each(|(p, response)| mixture.add(*p, response));

        mixture
    }
}

/// A mixture of responses: q_j = sum_i p_i rho_ij, and sum_i p_i sum_j rho_ij ln rho_ij.
#[derive(Clone)]
struct Mixture {
    marginal: Vec<f64>,
    ordered: f64,
}

impl Mixture {
    /// Becomes so much of another one.
    fn set(&mut self, share: f64, other: &Self) {
        self.ordered = share * other.ordered;
        self.marginal
            .iter_mut()
            .zip(&other.marginal)
            .for_each(|(q, other)| *q = share * other);
    }

    /// Adds so much of a response.
    fn add(&mut self, p: f64, (rho, ordered): &(Vec<f64>, f64)) {
        self.ordered += p * ordered;
        self.marginal
            .iter_mut()
            .zip(rho)
            .for_each(|(q, rho)| *q += p * rho);
    }

    /// Returns the mutual information of rows and letters, if the probabilities of the rows sum to
    /// 1.
    fn information(&self) -> f64 {
        (self.ordered - self.marginal.iter().map(|q| x_ln_x(*q)).sum::<f64>()).max(0.0)
    }
}

fn x_ln_x(x: f64) -> f64 {
    if x > 0.0 { x * x.ln() } else { 0.0 }
}
