//! Effective degrees of freedom of mutual information's second-order variance: how freely a table's
//! responses vary.
//!
//! Where rows are alike, mutual information is a sum of squares, and its variance is 2 d^2 / f: d
//! is its mean beyond the information of the mean responses, f the number of squares that vary by
//! themselves. There are two ways to count them:
//!
//! * by what varies: rows as (sum w)^2 / sum w^2, w_i = p_i (1 - p_i) / (A_i + 1); letters as (sum
//!   x)^2 / sum x^2 (1 + 3 / a) - 1 with a = A q_j and x = a / (a + 1), since a letter that is
//!   expected less than once varies little, and by leaps (the kurtosis of its Beta distribution is
//!   6 / a);
//! * by what is used: (1 / sum p^2 - 1) (1 / sum q^2 - 1), which is too few where counts are many.
//!
//! Against exact sampling in thirteen worlds (2 x 2 to 25 x 25, one visit to thousands) the sum of
//! the first and three times the second gives standard deviations within a tenth on the average of
//! any number of visits; the smaller of the two is for what has to be on the safe side.

/// The fewest letters that are taken to vary by themselves, besides the one that makes up the rest.
const FEWEST_LETTERS: f64 = 0.3;

/// How much more freely responses vary than what is used says, where little is counted.
const USED: f64 = 3.0;

/// The sums that degrees of freedom are counted from: rows first, then letters.
#[derive(Clone, Copy, Default)]
pub(super) struct Freedom {
    /// sum w, sum w^2, sum w (A + 1).
    rows: [f64; 3],
    /// sum x, sum x^2 (1 + 3 / a).
    letters: [f64; 2],
    /// sum p^2.
    policy: f64,
    /// sum q^2.
    marginal: f64,
}

impl Freedom {
    /// Adds a row with the probability p and the concentration A.
    pub fn add_row(&mut self, p: f64, a: f64) {
        let w = p * (1.0 - p) / (a + 1.0);
        self.add_rows(w, w * w, p * p, a);
    }

    /// Adds rows that are alike in their concentration, by sum p and sum p^2.
    pub fn add_alike(&mut self, p: f64, squared: f64, a: f64) {
        self.add_rows(
            (p - squared) / (a + 1.0),
            squared / ((a + 1.0) * (a + 1.0)),
            squared,
            a,
        );
    }

    fn add_rows(&mut self, w: f64, square: f64, policy: f64, a: f64) {
        self.rows
            .iter_mut()
            .zip([w, square, w * (a + 1.0)])
            .for_each(|(sum, term)| *sum += term);
        self.policy += policy;
    }

    /// Adds so many letters that have the probability q each. Rows come before.
    pub fn add_letters(&mut self, q: f64, letters: f64) {
        let [w, _, weighted] = self.rows;
        let a = if w > 0.0 { q * weighted / w } else { q };
        let x = a / (a + 1.0);
        self.letters[0] += letters * x;
        // (a + 3) / (a + 1) = 3 - 2 x.
        self.letters[1] += letters * x * (3.0 - 2.0 * x);
        self.marginal += letters * q * q;
    }

    fn varying(&self) -> f64 {
        let ([w, square, _], [x, spread]) = (self.rows, self.letters);
        if square == 0.0 || spread == 0.0 {
            0.0
        } else {
            w * w / square * (x * x / spread - 1.0).max(FEWEST_LETTERS)
        }
    }

    fn used(&self) -> f64 {
        if self.policy == 0.0 || self.marginal == 0.0 {
            0.0
        } else {
            (1.0 / self.policy - 1.0) * (1.0 / self.marginal - 1.0)
        }
    }

    /// Returns the second-order variance of an excess d, and a wider one for what has to be on the
    /// safe side; none where nothing can vary.
    pub fn variances(&self, excess: f64) -> [f64; 2] {
        let (varying, used) = (self.varying(), self.used());
        let variance = |freedom: f64| {
            if freedom > 0.0 {
                2.0 * excess * excess / freedom
            } else {
                0.0
            }
        };
        [variance(varying + USED * used), variance(varying.min(used))]
    }
}
