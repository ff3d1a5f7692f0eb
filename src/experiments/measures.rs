//! Measures of scores, decisions, estimates and intervals where the truth is known (AUROC, F1,
//! RMSE). What is not defined is `None`, never a number.

/// Returns the area under the ROC curve: the probability that a state with the property scores
/// higher than one without, ties counted half.
///
/// By ranks, (sum of the ranks of those with it - P (P + 1)/2) / (P Q), tied scores sharing their
/// mean rank (Mann & Whitney 1947; Hanley & McNeil 1982). `None` unless there are both.
pub fn auc(scored: &[(f64, bool)]) -> Option<f64> {
    let mut scored = scored.to_vec();
    scored.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut below, mut ranks) = (0, 0.0);

    for tied in scored.chunk_by(|a, b| a.0 == b.0) {
        let mean_rank = below as f64 + (tied.len() + 1) as f64 / 2.0;
        ranks += mean_rank * tied.iter().filter(|(_, with)| *with).count() as f64;
        below += tied.len();
    }

    let with = scored.iter().filter(|(_, with)| *with).count() as f64;
    let without = scored.len() as f64 - with;
    share(ranks - with * (with + 1.0) / 2.0, with * without)
}

/// A confusion matrix without its true negatives: how often decisions were right.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Hits {
    /// Called, and so it is.
    pub right: u64,
    /// Called, and it is not so.
    pub wrong: u64,
    /// Not called, although it is so.
    pub missed: u64,
}

impl Hits {
    /// Counts pairs of what was called and what is true.
    pub fn of_decisions(decisions: impl IntoIterator<Item = (bool, bool)>) -> Self {
        decisions
            .into_iter()
            .fold(Self::default(), |mut hits, decision| {
                match decision {
                    (true, true) => hits.right += 1,
                    (true, false) => hits.wrong += 1,
                    (false, true) => hits.missed += 1,
                    (false, false) => {}
                }
                hits
            })
    }

    /// Returns the share of calls that are right; `None` without calls.
    pub fn precision(self) -> Option<f64> {
        share(self.right as f64, (self.right + self.wrong) as f64)
    }

    /// Returns the share of what is so that was called; `None` where nothing is.
    pub fn recall(self) -> Option<f64> {
        share(self.right as f64, (self.right + self.missed) as f64)
    }

    /// Returns the harmonic mean of precision and recall, 0 without a right call; `None` where
    /// nothing is so.
    pub fn f1(self) -> Option<f64> {
        self.recall()?;
        share(
            2.0 * self.right as f64,
            (2 * self.right + self.wrong + self.missed) as f64,
        )
    }
}

/// Returns the mean; `None` of nothing.
pub fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values
        .into_iter()
        .fold((0.0, 0.0), |(sum, n), value| (sum + value, n + 1.0));
    share(sum, n)
}

/// Returns how often something is so; `None` of nothing.
pub fn frequency(those: impl IntoIterator<Item = bool>) -> Option<f64> {
    mean(those.into_iter().map(|so| f64::from(u8::from(so))))
}

/// Returns the root of the mean squared difference between estimates and truths; `None` of nothing.
pub fn rmse(pairs: impl IntoIterator<Item = (f64, f64)>) -> Option<f64> {
    mean(
        pairs
            .into_iter()
            .map(|(estimate, truth)| (estimate - truth).powi(2)),
    )
    .map(f64::sqrt)
}

/// Mean and standard deviation of a figure over seeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Its mean.
    pub mean: f64,
    /// Its standard deviation from one seed to the next, over n - 1; `None` of a single seed.
    pub sd: Option<f64>,
    /// The seeds for which it is defined.
    pub seeds: usize,
}

impl Spread {
    /// Returns the spread of the values; `None` of nothing.
    pub fn of_values(values: &[f64]) -> Option<Self> {
        let center = mean(values.iter().copied())?;
        let squares: f64 = values.iter().map(|value| (value - center).powi(2)).sum();
        let sd = share(squares, values.len() as f64 - 1.0).map(f64::sqrt);
        Some(Self {
            mean: center,
            sd,
            seeds: values.len(),
        })
    }
}

fn share(part: f64, whole: f64) -> Option<f64> {
    (whole > 0.0).then(|| part / whole)
}

#[cfg(test)]
mod tests;
