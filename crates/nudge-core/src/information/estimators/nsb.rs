//! The NSB estimator (Nemenman, Shafee & Bialek): the posterior mean under a prior that favours no
//! entropy.

use statrs::function::gamma::digamma;

use super::margins_and_cells;
use crate::information::alphabet::Alphabet;
use crate::information::alphabet_sizes::AlphabetSizes;
use crate::information::counts_of_counts::{CountOfCounts, sum};
use crate::information::table::Table;
use crate::special_functions::{entropy_growth, ln_beta};

/// Returns the mutual information by the entropies of Nemenman, Shafee & Bialek of rows, columns
/// and cells, in nats (2002, "Entropy and inference, revisited").
///
/// S(rows) + S(columns) - S(cells), each the posterior mean of the entropy of K letters, K from the
/// alphabet, where the shares are Dirichlet with the same concentration b for each letter, and b is
/// weighted so that all mean entropies from 0 to ln K are equally likely beforehand:
///
/// weight(b) = (K psi'(K b + 1) - psi'(b + 1))
/// Gamma(K b) / Gamma(N + K b) prod_i Gamma(n_i + b) / Gamma(b).
///
/// In words: the best of the classical estimators at few visits. It still answers a number where
/// the honest answer is "probably none": it does not know that most states have no influence.
///
/// May be negative, since the three entropies have priors apart. 0 at N = 0 and for an alphabet of
/// one letter.
pub fn nsb(table: &Table, alphabet: Alphabet) -> f64 {
    if table.total() == 0 {
        return 0.0;
    }
    let sizes = AlphabetSizes::new(table, alphabet);
    let [rows, columns, cells] = margins_and_cells(table);
    let entropy = |counts, letters| Posterior::new(counts, table.total(), letters).mean_entropy();
    entropy(&rows, sizes.rows) + entropy(&columns, sizes.columns) - entropy(&cells, sizes.cells)
}

/// What the counts of N visits say about the distribution that made them.
struct Posterior<'a> {
    counts: &'a [CountOfCounts],
    seen: f64,
    total: f64,
    letters: f64,
}

/// Weights below e^-42 of the largest, 6e-19, are left out.
const NEGLIGIBLE: f64 = -42.0;

impl<'a> Posterior<'a> {
    fn new(counts: &'a [CountOfCounts], total: u64, letters: f64) -> Self {
        let seen = counts.iter().map(|count| count.times).sum();
        Self {
            counts,
            seen,
            total: total as f64,
            letters,
        }
    }

    /// Returns the mean of [`entropy`](Self::entropy) over u = ln b, by the trapezoid rule.
    ///
    /// The weight is analytic and falls off exponentially on both sides, where the rule converges
    /// exponentially too: a step of half the width of the narrowest peak leaves less than rounding
    /// does. No peak is narrower than that of as many letters as were seen, each known exactly.
    fn mean_entropy(&self) -> f64 {
        if self.letters == 1.0 {
            return 0.0;
        }

        let step = 0.5 / (1.0 + self.seen / 2.0).sqrt();
        let start = self.near_the_peak();
        let mut mean = Mean::default();

        for step in [step, -step] {
            let mut before = f64::NEG_INFINITY;
            for at in u32::from(step < 0.0).. {
                let u = start + f64::from(at) * step;
                let log_weight = self.log_weight(u);
                mean.add(log_weight, self.entropy(u));

                let rises = log_weight >= before;
                // Said so that a weight that is no number would end it as well.
                if !(rises || log_weight > mean.largest + NEGLIGIBLE) {
                    break;
                }
                before = log_weight;
            }
        }

        mean.sum / mean.weights
    }

    /// Returns the u with the largest weight among those a unit apart. Beyond the ends the weight
    /// only falls: below b = 1 / K as b, above b = N as 1 / b.
    fn near_the_peak(&self) -> f64 {
        let (lowest, highest) = (
            -self.letters.ln().ceil() as i32 - 2,
            self.total.ln().ceil() as i32 + 2,
        );
        let weighed = (lowest..=highest).map(|u| (f64::from(u), self.log_weight(f64::from(u))));
        weighed
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .expect("lowest is below highest")
            .0
    }

    /// Returns the logarithm of the posterior weight of u = ln b, but for a constant: with beta
    /// functions, the gamma functions of the weight are B(N, K b) / prod_i B(n_i, b) times what b
    /// does not change.
    fn log_weight(&self, u: f64) -> f64 {
        let b = u.exp();
        let evidence =
            ln_beta(self.total, self.letters * b) - sum(self.counts, |n| ln_beta(n as f64, b));
        entropy_growth(b, self.letters).ln() + evidence
    }

    /// Returns the posterior mean entropy at a given concentration (Wolpert & Wolf 1995).
    fn entropy(&self, u: f64) -> f64 {
        let b = u.exp();
        let whole = self.total + self.letters * b;
        let most = digamma(whole + 1.0);
        let surprise = |x: f64| x / whole * (most - digamma(x + 1.0));
        (self.letters - self.seen) * surprise(b) + sum(self.counts, |n| surprise(n as f64 + b))
    }
}

/// A weighted mean whose weights come as logarithms of any size.
struct Mean {
    largest: f64,
    weights: f64,
    sum: f64,
}

impl Default for Mean {
    fn default() -> Self {
        Self {
            largest: f64::NEG_INFINITY,
            weights: 0.0,
            sum: 0.0,
        }
    }
}

impl Mean {
    fn add(&mut self, log_weight: f64, value: f64) {
        if log_weight > self.largest {
            let shrink = (self.largest - log_weight).exp();
            self.weights *= shrink;
            self.sum *= shrink;
            self.largest = log_weight;
        }
        let weight = (log_weight - self.largest).exp();
        self.weights += weight;
        self.sum += weight * value;
    }
}
