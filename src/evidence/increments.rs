//! Logarithms of rising factorials, tabulated: the cells of nearly every table are small integers.

use super::gamma::{ln_gamma, ln_rising};

/// Counts tabulated for one letter, and at most for all letters together.
const DEEPEST: u64 = 256;
const MOST: u64 = 2_048;

/// Returns up to which count something is tabulated for each of this many letters.
pub(super) fn depth(letters: usize) -> u64 {
    (MOST / letters.max(1) as u64).clamp(4, DEEPEST)
}

/// ln Gamma(k m_j + n) - ln Gamma(k m_j) for L concentrations k and every letter j of a base m.
pub(super) struct Increments<const L: usize> {
    concentrations: [f64; L],
    shares: Vec<f64>,
    depth: u64,
    /// By letter, then by count.
    values: Vec<[f64; L]>,
}

impl<const L: usize> Increments<L> {
    /// Tabulates for a base with these shares.
    pub fn new(concentrations: [f64; L], shares: &[f64]) -> Self {
        let depth = depth(shares.len());
        let column = |share: &f64| {
            let starts = concentrations.map(|k| (k * share, ln_gamma(k * share)));
            // Of many, differences of ln Gamma are quicker, and as good at these sizes.
            (0..depth).map(move |n| {
                starts.map(|(a, start)| if n < 16 { ln_rising(a, n) } else { ln_gamma(a + n as f64) - start })
            })
        };
        let values = shares.iter().flat_map(column).collect();
        Self { concentrations, shares: shares.to_vec(), depth, values }
    }

    /// Adds the increments of a letter that was counted n times to sums, one for each concentration.
    pub fn add_to(&self, sums: &mut [f64; L], letter: usize, n: u64) {
        self.look_up(letter, n, |increments| add(sums, increments));
    }

    /// Takes the increments of a letter that was counted n times out of sums.
    pub fn take_from(&self, sums: &mut [f64; L], letter: usize, n: u64) {
        self.look_up(letter, n, |increments| sums.iter_mut().zip(increments).for_each(|(sum, by)| *sum -= by));
    }

    #[inline]
    fn look_up(&self, letter: usize, n: u64, found: impl FnOnce(&[f64; L])) {
        if n < self.depth {
            found(&self.values[letter * self.depth as usize + n as usize]);
        } else {
            found(&self.concentrations.map(|k| ln_rising(k * self.shares[letter], n)));
        }
    }
}

/// Returns the entries on the environment's base, and those on the uniform one.
pub(super) fn bases<const L: usize>(sums: &mut [f64]) -> [&mut [f64; L]; 2] {
    let (base, uniform) = sums.split_at_mut(L);
    [base, uniform].map(|half| half.try_into().expect("two bases have the same concentrations"))
}

/// Adds `by` to `sums`, entry by entry.
pub(super) fn add<const L: usize>(sums: &mut [f64; L], by: &[f64; L]) {
    for (sum, by) in sums.iter_mut().zip(by) {
        *sum += by;
    }
}
