//! Grassberger's estimator of 2003: mutual information from entropies with each count corrected for
//! its own bias.

use std::f64::consts::LN_2;

use statrs::function::gamma::digamma;

use super::margins_and_cells;
use crate::information::counts_of_counts::sum;
use crate::information::table::Table;

/// Returns the mutual information by Grassberger's entropies of rows, columns and cells, in nats
/// (Grassberger 2003, "Entropy estimates from insufficient samplings", eq. 30; not his form of
/// 1988, which other tools have under his name).
///
/// H = ln N - sum n G(n) / N over what was seen,
///
/// G(n) = psi(n) + (-1)^n / 2 (psi((n + 1) / 2) - psi(n / 2)).
///
/// In words: rare counts claim less than their logarithm. The bias of each entropy is small at some
/// visits per letter; that of their difference is not, below about as many visits as cells.
///
/// May be negative. 0 at N = 0; with one row or column it is the correction of a certainty,
/// ln N - G(N), which is not 0 but fades as 1 / N.
pub fn grassberger_2003(table: &Table) -> f64 {
    if table.total() == 0 {
        return 0.0;
    }
    let total = table.total() as f64;
    let [rows, columns, cells] =
        margins_and_cells(table).map(|counts| sum(&counts, |n| n as f64 / total * g(n)));
    total.ln() - rows - columns + cells
}

/// G(n) for n >= 1. It is constant from each even number to the next odd one, and there
/// psi(n / 2 + 1/2) + ln 2: the sum of 2 / (2k + 1) that Grassberger gives as the recurrence of G.
fn g(n: u64) -> f64 {
    digamma((n / 2) as f64 + 0.5) + LN_2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn g_is_what_the_paper_defines() {
        for n in 1..200_u64 {
            let x = n as f64;
            let sign = if n % 2 == 0 { 1.0 } else { -1.0 };
            let defined = digamma(x) + sign / 2.0 * (digamma((x + 1.0) / 2.0) - digamma(x / 2.0));

            assert!(
                (g(n) - defined).abs() < 1e-14,
                "{n}: {} instead of {defined}",
                g(n)
            );
        }
    }
}
