//! x ln x of the small integers: nearly every table asked about is small, and looking up is quicker
//! than a logarithm.

use std::sync::LazyLock;

/// The largest integer tabulated. The 8 kB up to it fit in a first-level cache.
pub(super) const LARGEST: u64 = 1_000;

static VALUES: LazyLock<Vec<f64>> = LazyLock::new(|| (0..=LARGEST).map(x_ln_x).collect());

/// Returns x ln x in nats at the index x, for x = 0 to [`LARGEST`].
pub(super) fn tabulated() -> &'static [f64] {
    &VALUES
}

/// Returns x ln x in nats, looked up as far as it is tabulated.
pub(super) fn at(x: u64) -> f64 {
    if x <= LARGEST {
        VALUES[x as usize]
    } else {
        x_ln_x(x)
    }
}

/// 0 ln 0 = 0, the limit from above.
fn x_ln_x(x: u64) -> f64 {
    if x == 0 {
        0.0
    } else {
        x as f64 * (x as f64).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_and_certainty_have_no_surprise() {
        assert_eq!(tabulated()[..2], [0.0, 0.0]);
    }

    #[test]
    fn reaches_the_largest() {
        assert_eq!(tabulated()[LARGEST as usize], 1_000.0 * 1_000_f64.ln());
        assert_eq!(at(LARGEST), tabulated()[LARGEST as usize]);
        assert_eq!(at(LARGEST + 1), 1_001.0 * 1_001_f64.ln());
    }
}
