//! The posterior predictive distribution of a state: the probability of each pair of actions at its
//! next visit.

use super::deviants::Deviants;
use super::habits::Habits;
use super::likelihood::columns;
use super::parameters::{
    DEVIANT_CONCENTRATIONS, DEVIANT_GRID, DEVIANT_SLABS, FIXED, FIXED_GRID, NULL_CONCENTRATIONS,
    NULL_GRID, NULLS, concentration,
};
use super::prior::Prior;
use super::readings::Reading;
use super::side::Side;
use super::weights::Weights;
use crate::information::Table;

/// The probability of an action that is not in use.
const RAREST: f64 = 1e-12;

/// Components of less weight change nothing.
const NEGLIGIBLE: f64 = 1e-4;

impl Prior {
    /// Returns the probability of each joint action at the next visit of a slice, averaged over
    /// what is believed: the driver's actions of a side first.
    pub(super) fn predicted(
        &self,
        side: usize,
        habits: &Habits,
        weights: &Weights,
        reading: &Reading<'_>,
        deviants: &[Deviants; 2],
    ) -> Vec<f64> {
        let policies = self.mean_policies(habits, reading);
        let responses = self.both_responses(weights, reading, deviants, &policies);
        self.mixed(side, weights.dependent, reading, &policies, &responses)
    }

    /// Returns the same with the actions of either side first.
    pub(super) fn predicted_both_ways(
        &self,
        habits: &Habits,
        weights: &Weights,
        reading: &Reading<'_>,
        deviants: &[Deviants; 2],
    ) -> [Vec<f64>; 2] {
        let policies = self.mean_policies(habits, reading);
        let responses = self.both_responses(weights, reading, deviants, &policies);
        [0, 1].map(|side| self.mixed(side, weights.dependent, reading, &policies, &responses))
    }

    /// Returns the policies of both drivers. An action that is not in use has next to no
    /// probability, but responses in proportion to it.
    fn mean_policies(&self, habits: &Habits, reading: &Reading<'_>) -> [Vec<f64>; 2] {
        [0, 1].map(|side| {
            let mut policy = self.mean_policy(side, habits, &reading[side]);
            policy.iter_mut().for_each(|p| *p = p.max(RAREST));
            policy
        })
    }

    fn both_responses(
        &self,
        weights: &Weights,
        reading: &Reading<'_>,
        deviants: &[Deviants; 2],
        policies: &[Vec<f64>; 2],
    ) -> [Vec<f64>; 2] {
        [0, 1].map(|side| {
            let rows: Vec<(usize, f64)> = (0..policies[side].len())
                .map(|label| (label, 1.0))
                .collect();
            self.sides[side].responses(&weights.slabs[side], &reading[side], &deviants[side], &rows)
        })
    }

    /// Mixes independence with the slabs of both sides, whose responses are given; the driver's
    /// actions of a side first.
    fn mixed(
        &self,
        side: usize,
        p_dependent: f64,
        reading: &Reading<'_>,
        policies: &[Vec<f64>; 2],
        responses: &[Vec<f64>; 2],
    ) -> Vec<f64> {
        let [drivers, responders] = [1 - side, side].map(|side| self.sides[side].letters());
        let [own, other] = [&responses[side], &responses[1 - side]];
        let shared = self.sides[side].shared(&reading[side]);

        let cell = |at: usize| {
            let (driver, responder) = (at / responders, at % responders);
            let independent = policies[side][driver] * shared[responder];
            let responding = policies[1 - side][responder] * other[responder * drivers + driver];
            let dependent = policies[side][driver] * own[at] + responding;
            (1.0 - p_dependent) * independent + p_dependent * dependent
        };

        (0..drivers * responders).map(cell).collect()
    }

    /// Returns the posterior mean of the policy of a side's driver.
    pub(super) fn mean_policy(&self, side: usize, habits: &Habits, table: &Table) -> Vec<f64> {
        let policy = self.sides[side].policy(table, habits.driver(side));
        (0..habits.driver(side).shares.len() as u64)
            .map(|label| policy.probability(label, table.row_sum(label)))
            .collect()
    }
}

impl Side {
    /// Returns how many letters the responder has.
    pub fn letters(&self) -> usize {
        self.likelihood.base.shares().len()
    }

    /// Returns the probabilities of the null's components, were a table independent.
    pub fn null_weights(&self, table: &Table) -> [f64; NULLS] {
        self.nulls
            .given(&self.likelihood.shared(columns(table), table.total()))
            .components
    }

    /// Returns m_j of a component of the null.
    pub fn null_share(&self, null: usize, letter: usize) -> f64 {
        if null < NULL_GRID {
            self.likelihood.base.shares()[letter]
        } else {
            1.0 / self.letters() as f64
        }
    }

    /// Returns m_j of a slab of one deviating row.
    pub fn deviant_share(&self, deviant: usize, letter: usize) -> f64 {
        if deviant < DEVIANT_GRID {
            self.likelihood.base.shares()[letter]
        } else {
            1.0 / self.letters() as f64
        }
    }

    /// Returns the base of a slab on which every row has its own response.
    pub fn slab_base(&self, slab: usize, table: &Table) -> Vec<f64> {
        match slab {
            0..FIXED_GRID => self.likelihood.base.shares().to_vec(),
            FIXED_GRID..FIXED => vec![1.0 / self.letters() as f64; self.letters()],
            _ => self.marginal(table),
        }
    }

    /// Returns mhat_j = (c_j + g_j) / (N + 1).
    fn marginal(&self, table: &Table) -> Vec<f64> {
        let mut counts = self.smoothed(table);
        counts
            .iter_mut()
            .for_each(|count| *count /= table.total() as f64 + 1.0);
        counts
    }

    /// Returns c_j + g_j: the counts of the columns, with one visit more spread as the base is.
    fn smoothed(&self, table: &Table) -> Vec<f64> {
        let mut counts = self.likelihood.base.shares().to_vec();
        add_columns(&mut counts, table, 1.0);
        counts
    }

    /// Returns the response that all rows share, were a table independent.
    fn shared(&self, table: &Table) -> Vec<f64> {
        let mut shared = vec![0.0; self.letters()];
        let mut visited = 0.0;
        for (null, weight) in self.null_weights(table).into_iter().enumerate() {
            let b = NULL_CONCENTRATIONS[null % NULL_GRID];
            let weight = weight / (table.total() as f64 + b);
            visited += weight;
            shared
                .iter_mut()
                .enumerate()
                .for_each(|(letter, sum)| *sum += weight * b * self.null_share(null, letter));
        }

        add_columns(&mut shared, table, visited);
        shared
    }

    /// Returns sum_k w_k rho_ij of these slabs for rows i of these labels, each of which stands for
    /// so many rows that answer alike; rows first.
    pub fn responses(
        &self,
        slabs: &[f64],
        table: &Table,
        deviants: &Deviants,
        rows: &[(usize, f64)],
    ) -> Vec<f64> {
        let mut rows: Vec<Share> = rows
            .iter()
            .map(|(label, times)| Share::new(table, *label, *times))
            .collect();
        let mut responses = vec![0.0; rows.len() * self.letters()];
        for (slab, weight) in slabs
            .iter()
            .enumerate()
            .filter(|(_, weight)| **weight > NEGLIGIBLE)
        {
            match slab.checked_sub(DEVIANT_SLABS.start) {
                Some(deviant) => {
                    self.add_deviants(deviant, *weight, table, deviants, &mut rows, &mut responses)
                }
                None => rows
                    .iter_mut()
                    .for_each(|row| row.add(concentration(slab), base_of(slab), *weight)),
            }
        }

        let marginal = self.marginal(table);
        let bases = [
            self.likelihood.base.shares(),
            &vec![1.0 / self.letters() as f64; self.letters()],
            &marginal,
        ];
        for (row, cells) in rows.iter().zip(responses.chunks_mut(self.letters())) {
            for (share, base) in row.bases.iter().zip(bases) {
                cells
                    .iter_mut()
                    .zip(base)
                    .for_each(|(sum, m)| *sum += share * m);
            }
            add_row(cells, table, row.label, row.visits);
        }
        responses
    }

    /// A row that deviates answers by itself, all others as they do together.
    fn add_deviants(
        &self,
        deviant: usize,
        weight: f64,
        table: &Table,
        deviants: &Deviants,
        rows: &mut [Share],
        responses: &mut [f64],
    ) {
        let (k, letters) = (
            DEVIANT_CONCENTRATIONS[deviant % DEVIANT_GRID],
            self.letters(),
        );
        let (deviating, counts) = (deviants.probable(deviant), self.smoothed(table));

        let mut together = vec![0.0; letters];
        for (row, cells) in rows.iter_mut().zip(responses.chunks_mut(letters)) {
            let own = deviating.probability(table, row.label);
            row.add(k, deviant / DEVIANT_GRID, weight * own);

            // What the others answer where this one deviates.
            let mut rest = counts.clone();
            add_row(&mut rest, table, row.label, -1.0);
            let scale = weight * own / ((table.total() - row.r) as f64 + 1.0);

            for ((sum, cell), count) in together.iter_mut().zip(cells).zip(rest) {
                *sum += row.times * scale * count;
                *cell -= scale * count;
            }
        }

        for cells in responses.chunks_mut(letters) {
            cells
                .iter_mut()
                .zip(&together)
                .for_each(|(cell, shared)| *cell += shared);
        }
    }
}

/// What a row's response is made of, over the slabs: of its visits, each counting as much, and of
/// each base.
struct Share {
    label: usize,
    /// How many rows it stands for.
    times: f64,
    r: u64,
    visits: f64,
    bases: [f64; 3],
}

impl Share {
    fn new(table: &Table, label: usize, times: f64) -> Self {
        Self {
            label,
            times,
            r: table.row_sum(label as u64),
            visits: 0.0,
            bases: [0.0; 3],
        }
    }

    /// Adds the mean response (n_j + k m_j) / (r + k) of a slab of that weight.
    fn add(&mut self, k: f64, base: usize, weight: f64) {
        let each = weight / (self.r as f64 + k);
        self.visits += each;
        self.bases[base] += each * k;
    }
}

/// Returns which base a slab is on whose every row has its own response: the environment's, the
/// uniform one, the state's own marginal.
fn base_of(slab: usize) -> usize {
    (slab / FIXED_GRID).min(2)
}

/// Adds the counts of all columns, times a scale.
pub(super) fn add_columns(counts: &mut [f64], table: &Table, scale: f64) {
    for (label, n) in table.column_labels().iter().zip(table.columns()) {
        counts[*label as usize] += scale * *n as f64;
    }
}

/// Adds the counts of the row of a label, times a scale.
pub(super) fn add_row(counts: &mut [f64], table: &Table, label: usize, scale: f64) {
    let Ok(row) = table.row_labels().binary_search(&(label as u64)) else {
        return;
    };
    for cell in table.row(row) {
        counts[table.column_labels()[cell.column as usize] as usize] += scale * cell.n as f64;
    }
}
