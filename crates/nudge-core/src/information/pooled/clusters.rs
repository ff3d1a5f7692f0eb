//! Ratios of sums over clusters, and their robust standard deviation: how much the whole would
//! differ were other clusters drawn (a linearised, cluster-robust variance).

use std::collections::BTreeMap;

/// A numerator and a denominator.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Ratio {
    pub above: f64,
    pub below: f64,
}

impl Ratio {
    pub fn add(&mut self, other: Self) {
        self.above += other.above;
        self.below += other.below;
    }

    /// Returns the quotient; 0 where nothing is below.
    pub fn value(self) -> f64 {
        if self.below > 0.0 {
            self.above / self.below
        } else {
            0.0
        }
    }
}

/// Sums over clusters whose parts come together, one cluster after the other: there may be millions.
#[derive(Debug, Clone, Default)]
pub(super) struct Consecutive {
    last: Option<u64>,
    open: Ratio,
    clusters: u64,
    /// Of the clusters before: sum y^2, sum x y, sum x^2.
    squares: [f64; 3],
}

impl Consecutive {
    pub fn add(&mut self, cluster: u64, part: Ratio) {
        if self.last != Some(cluster) {
            self.squares = self.closed();
            self.open = Ratio::default();
            self.last = Some(cluster);
            self.clusters += 1;
        }
        self.open.add(part);
    }

    /// Returns how many clusters there are.
    pub fn len(&self) -> u64 {
        self.clusters
    }

    /// Returns sqrt(sum_c (y_c - theta x_c)^2) / sum x of a ratio theta = sum y / sum x.
    pub fn deviation(&self, whole: Ratio) -> f64 {
        let (theta, [above, both, below]) = (whole.value(), self.closed());
        let squares = above - 2.0 * theta * both + theta * theta * below;
        squares.max(0.0).sqrt() / whole.below
    }

    fn closed(&self) -> [f64; 3] {
        let Ratio { above, below } = self.open;
        let [y, xy, x] = self.squares;
        [y + above * above, xy + above * below, x + below * below]
    }
}

/// The sums of each cluster.
#[derive(Debug, Clone, Default)]
pub(super) struct Clusters(BTreeMap<u64, Ratio>);

impl Clusters {
    pub fn add(&mut self, cluster: u64, part: Ratio) {
        self.0.entry(cluster).or_default().add(part);
    }

    /// Returns how many clusters there are.
    pub fn len(&self) -> u64 {
        self.0.len() as u64
    }

    /// Returns sqrt(sum_c (y_c - theta x_c)^2) / sum x of a ratio theta = sum y / sum x.
    pub fn deviation(&self, whole: Ratio) -> f64 {
        let theta = whole.value();
        let residual = |part: &Ratio| part.above - theta * part.below;
        let squares: f64 = self.0.values().map(|part| residual(part).powi(2)).sum();
        squares.sqrt() / whole.below
    }

    /// Returns how many clusters have anything below.
    pub fn informative(&self) -> usize {
        self.0.values().filter(|part| part.below > 0.0).count()
    }

    /// Returns the number of equal clusters that would weigh as unevenly: 1 / sum u_c^2, u_c the
    /// shares of what is below (Kish 1965).
    pub fn effective(&self, whole: Ratio) -> f64 {
        let share = |part: &Ratio| part.below / whole.below;
        let squares: f64 = self.0.values().map(|part| share(part).powi(2)).sum();
        1.0 / squares
    }
}
