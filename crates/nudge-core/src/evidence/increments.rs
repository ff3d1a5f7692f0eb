//! Logarithms of rising factorials, tabulated: the cells of nearly every table are small integers.

use crate::special_functions::{ln_gamma, ln_rising};

/// Counts tabulated for one letter, and at most for all letters together.
const DEEPEST: u64 = 256;
const MOST: u64 = 2_048;

/// Returns up to which count something is tabulated for each of this many letters.
pub(super) fn depth(letters: usize) -> u64 {
    (MOST / letters.max(1) as u64).clamp(4, DEEPEST)
}

/// ln Gamma(a_j + n) - ln Gamma(a_j) for every letter j, of which each of L components has its own
/// a_j.
pub(super) struct Increments<const L: usize> {
    parameters: Vec<[f64; L]>,
    depth: u64,
    /// By letter, then by count.
    values: Vec<[f64; L]>,
}

impl<const L: usize> Increments<L> {
    /// Tabulates for these parameters, by letter.
    pub fn new(parameters: Vec<[f64; L]>) -> Self {
        let depth = depth(parameters.len());
        let column = |parameters: &[f64; L]| {
            let starts = parameters.map(|a| (a, ln_gamma(a)));
            // Of many, differences of ln Gamma are quicker, and as good at these sizes.
            (0..depth).map(move |n| {
                starts.map(|(a, start)| {
                    if n < 16 {
                        ln_rising(a, n)
                    } else {
                        ln_gamma(a + n as f64) - start
                    }
                })
            })
        };

        let values = parameters.iter().flat_map(column).collect();
        Self {
            parameters,
            depth,
            values,
        }
    }

    /// Returns a_j of a letter for each component.
    pub fn parameters(&self, letter: usize) -> &[f64; L] {
        &self.parameters[letter]
    }

    /// Adds the increments of a letter that was counted n times to sums, one for each component.
    pub fn add_to(&self, sums: &mut [f64; L], letter: usize, n: u64) {
        self.look_up(letter, n, |increments| add(sums, increments));
    }

    /// Takes the increments of a letter that was counted n times out of sums.
    pub fn take_from(&self, sums: &mut [f64; L], letter: usize, n: u64) {
        self.look_up(letter, n, |increments| {
            sums.iter_mut()
                .zip(increments)
                .for_each(|(sum, by)| *sum -= by)
        });
    }

    #[inline]
    fn look_up(&self, letter: usize, n: u64, found: impl FnOnce(&[f64; L])) {
        if n < self.depth {
            found(&self.values[letter * self.depth as usize + n as usize]);
        } else {
            found(&self.parameters[letter].map(|a| ln_rising(a, n)));
        }
    }
}

/// Adds `by` to `sums`, entry by entry.
pub(super) fn add<const L: usize>(sums: &mut [f64; L], by: &[f64; L]) {
    for (sum, by) in sums.iter_mut().zip(by) {
        *sum += by;
    }
}
