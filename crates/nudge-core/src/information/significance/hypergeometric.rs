//! Hypergeometric variates: random draws from an urn, however many balls there are.

use rand::{Rng, RngExt};

use crate::special_functions::ln_pochhammer;

/// To this many balls are drawn one by one.
const ONE_BY_ONE: u64 = 24;

/// Draws `drawn` balls from an urn of `total`, `marked` of them marked, and returns how many marked
/// ones came out.
pub(in crate::information) fn draw(
    random: &mut impl Rng,
    marked: u64,
    drawn: u64,
    total: u64,
) -> u64 {
    // Exchanging drawn with undrawn, marked with unmarked, and marked with drawn leaves a quarter
    // of all urns.
    if drawn > total - drawn {
        return marked - draw(random, marked, total - drawn, total);
    }
    if marked > total - marked {
        return drawn - draw(random, total - marked, drawn, total);
    }

    let (few, many) = if drawn < marked {
        (drawn, marked)
    } else {
        (marked, drawn)
    };

    if few <= ONE_BY_ONE {
        one_by_one(random, many, few, total)
    } else {
        at_once(random, many, few, total)
    }
}

fn one_by_one(random: &mut impl Rng, marked: u64, drawn: u64, total: u64) -> u64 {
    let mut marked_left = marked;
    for total_left in (0..drawn).map(|gone| total - gone) {
        marked_left -= u64::from(random.random_range(0..total_left) < marked_left);
    }
    marked - marked_left
}

/// Ratio of uniforms with the table mountain hat of Stadlober (1990, "The ratio of uniforms
/// approach for generating discrete random variates"): its width is 2 sqrt(2/e)
/// sqrt(variance + 1/2) + 3 - 2 sqrt(3/e) about the mean.
fn at_once(random: &mut impl Rng, marked: u64, drawn: u64, total: u64) -> u64 {
    let urn = Urn::new(marked, drawn, total);
    let e = std::f64::consts::E;
    let width = 2.0 * (2.0 / e).sqrt() * (urn.variance + 0.5).sqrt() + 3.0 - 2.0 * (3.0 / e).sqrt();

    loop {
        let height = 1.0 - random.random::<f64>();
        let at = urn.mean + 0.5 + width * (random.random::<f64>() - 0.5) / height;
        if at >= 0.0 && at < drawn as f64 + 1.0 {
            let n = (at as u64).min(drawn);
            if 2.0 * height.ln() <= urn.log_ratio_to_mode(n) {
                return n;
            }
        }
    }
}

/// An urn, no more than half of it marked and no more than half of it drawn.
struct Urn {
    marked: u64,
    drawn: u64,
    /// How many unmarked balls stay in the urn where no marked one is drawn.
    spare: u64,
    mean: f64,
    variance: f64,
    mode: u64,
}

impl Urn {
    fn new(marked: u64, drawn: u64, total: u64) -> Self {
        let (share, all) = (marked as f64 / total as f64, total as f64);
        let mean = drawn as f64 * share;
        let variance = mean * (1.0 - share) * ((all - drawn as f64) / (all - 1.0));
        let mode = u128::from(marked + 1) * u128::from(drawn + 1) / (u128::from(total) + 2);

        Self {
            marked,
            drawn,
            spare: total - marked - drawn,
            mean,
            variance,
            mode: mode as u64,
        }
    }

    /// Returns ln(p(n) / p(mode)).
    fn log_ratio_to_mode(&self, n: u64) -> f64 {
        if n < self.mode {
            -self.log_ratio(n, self.mode)
        } else {
            self.log_ratio(self.mode, n)
        }
    }

    /// Returns ln(p(high) / p(low)), p(n) in proportion to 1 / (n! (m - n)! (d - n)! (spare + n)!).
    fn log_ratio(&self, low: u64, high: u64) -> f64 {
        let steps = (high - low) as f64;
        let fallen = |from: u64| ln_pochhammer((from - high + 1) as f64, steps);
        let risen = |from: u64| ln_pochhammer((from + low + 1) as f64, steps);
        fallen(self.marked) + fallen(self.drawn) - risen(0) - risen(self.spare)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    const DRAWS: u64 = 20_000;

    /// Chi-square over the values expected at least five times, the rest together, in standard
    /// deviations.
    fn excess(marked: u64, drawn: u64, total: u64) -> f64 {
        let mut random = Pcg64::seed_from_u64(marked + drawn + total);
        let mut seen = vec![0.0; drawn.min(marked) as usize + 1];
        for _ in 0..DRAWS {
            seen[draw(&mut random, marked, drawn, total) as usize] += 1.0;
        }
        let (mut square, mut cells, mut rest) = (0.0, 0.0, (DRAWS as f64, DRAWS as f64));
        for (n, seen) in (0..).zip(seen) {
            let expected = DRAWS as f64 * probability(n, marked, drawn, total);
            if expected >= 5.0 {
                square += (seen - expected) * (seen - expected) / expected;
                cells += 1.0;
                rest = (rest.0 - seen, rest.1 - expected);
            }
        }
        square += (rest.0 - rest.1) * (rest.0 - rest.1) / rest.1.max(1.0);
        (square - cells) / (2.0 * cells).sqrt()
    }

    fn probability(n: u64, marked: u64, drawn: u64, total: u64) -> f64 {
        if n > marked || n > drawn || drawn - n > total - marked {
            return 0.0;
        }
        let choose = |of: u64, n: u64| {
            (1..=n)
                .map(|k| ((of - n + k) as f64 / k as f64).ln())
                .sum::<f64>()
        };
        (choose(marked, n) + choose(total - marked, drawn - n) - choose(total, drawn)).exp()
    }

    #[test]
    fn draws_as_often_as_each_number_should_come() {
        let one_by_one = [(3, 2, 7), (24, 500, 900), (10, 10, 11), (5, 995, 1_000)];
        let at_once = [
            (25, 25, 50),
            (30, 40, 1_000),
            (500, 500, 1_000),
            (700, 60, 900),
            (2_000, 3_000, 100_000),
        ];
        for (marked, drawn, total) in one_by_one.into_iter().chain(at_once) {
            let excess = excess(marked, drawn, total);

            assert!(
                excess.abs() < 4.0,
                "{drawn} of {total}, {marked} marked: {excess} standard deviations"
            );
        }
    }

    #[test]
    fn an_urn_without_choice_gives_what_it_has() {
        let mut random = Pcg64::seed_from_u64(1);
        for (marked, drawn, total, out) in [
            (0, 5, 9, 0),
            (9, 5, 9, 5),
            (4, 9, 9, 4),
            (4, 0, 9, 0),
            (0, 0, 0, 0),
        ] {
            assert_eq!(draw(&mut random, marked, drawn, total), out);
        }
    }

    #[test]
    fn the_largest_urns_keep_their_mean_and_spread() {
        let (total, draws) = (1_u64 << 62, 2_000);
        let urn = Urn::new(total / 4, total / 8, total);
        let mut random = Pcg64::seed_from_u64(2);
        let deviation =
            |random: &mut Pcg64| draw(random, total / 4, total / 8, total) as f64 - urn.mean;
        let (sum, squares) = (0..draws).fold((0.0, 0.0), |(sum, squares), _| {
            let deviation = deviation(&mut random) / urn.variance.sqrt();
            (sum + deviation, squares + deviation * deviation)
        });

        assert!((sum / f64::from(draws)).abs() < 4.0 / f64::from(draws).sqrt());
        assert!((squares / f64::from(draws) - 1.0).abs() < 4.0 * (2.0 / f64::from(draws)).sqrt());
    }
}
