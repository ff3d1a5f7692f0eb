//! The rows of a ranking of all states, kept small: some hundred bytes a state, in columns.

use super::keyed::Keyed;
use super::order::Ranked;
use super::row::Row;
use crate::domain::{Basis, Dependence, Evidence, Interval, Probability, StateKey, Verdict};

/// The rows of a ranking.
#[derive(Debug)]
pub struct Rows {
    kept: Keyed<Kept>,
    /// The version of the network that was asked.
    network: Option<u64>,
}

/// What is kept of a row beside its key, in nats.
#[derive(Debug)]
struct Kept {
    visits: u64,
    plug_in: f64,
    expected: f64,
    probability: Probability,
    posterior_mean: f64,
    interval: Interval,
    by_segment: Option<Box<BySegment>>,
    /// `None` where there is no evidence, and the figures before are none.
    dependence: Option<Dependence>,
    verdict: Verdict,
    /// Whether the verdict is the network's.
    is_predicted: bool,
}

/// What evidence tells where a state was seen in several segments: few were.
#[derive(Debug)]
struct BySegment {
    differ: Option<f64>,
    pooled: Option<f64>,
}

impl Rows {
    /// Begins the rows of a ranking for which that version of a network is asked.
    pub fn new(network: Option<u64>) -> Self {
        Self {
            kept: Keyed::default(),
            network,
        }
    }

    /// Makes room for the rows of so many states of so many features, and no more: millions that
    /// double now and then are twice as large.
    pub fn reserve(&mut self, states: usize, features: usize) {
        self.kept.reserve(states, features);
    }

    /// Adds a row.
    pub fn push(&mut self, row: &Row) {
        self.kept.push(&row.key, Kept::from(row));
    }

    /// Sorts the rows by key.
    pub fn sort(&mut self) {
        self.kept.sort();
    }

    /// Returns how many there are.
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    /// Returns the row at a position.
    pub fn row(&self, at: usize) -> Row {
        let kept = &self.kept.values()[at];
        let predicted = self.network.filter(|_| kept.is_predicted);
        Row {
            key: self.kept.key(at),
            visits: kept.visits,
            plug_in: kept.plug_in,
            expected: kept.expected,
            evidence: kept.evidence(),
            verdict: kept.verdict,
            basis: predicted.map_or(Basis::Counts(kept.visits), Basis::Model),
        }
    }

    /// Returns the key of the row at a position.
    pub fn key(&self, at: usize) -> StateKey {
        self.kept.key(at)
    }

    /// Returns the position of the row of a state.
    pub fn position(&self, key: &StateKey) -> Option<usize> {
        self.kept.position(key)
    }

    /// Returns the verdict on the state at a position.
    pub fn verdict(&self, at: usize) -> Verdict {
        self.kept.values()[at].verdict
    }

    /// Returns how often each state was seen.
    pub fn visits(&self) -> impl Iterator<Item = u64> {
        self.kept.values().iter().map(|kept| kept.visits)
    }

    /// Returns the verdict on each state.
    pub fn verdicts(&self) -> impl Iterator<Item = Verdict> {
        self.kept.values().iter().map(|kept| kept.verdict)
    }

    /// Returns what the counts say of each state, where that is known.
    pub fn evidence(&self) -> impl Iterator<Item = Option<Evidence>> + Clone {
        self.kept.values().iter().map(Kept::evidence)
    }

    /// Returns the plug-in mutual information of each state, and its mean under independence.
    pub fn plug_in(&self) -> impl Iterator<Item = [f64; 2]> {
        let values = self.kept.values().iter();
        values.map(|kept| [kept.plug_in, kept.expected])
    }
}

impl From<&Row> for Kept {
    fn from(row: &Row) -> Self {
        let evidence = row.evidence.as_ref();
        let none = Probability {
            dependent: 0.0,
            above_threshold: 0.0,
        };
        let by_segment = evidence
            .filter(|told| told.differ.is_some() || told.pooled.is_some())
            .map(|Evidence { differ, pooled, .. }| BySegment {
                differ: *differ,
                pooled: *pooled,
            });

        Self {
            visits: row.visits,
            plug_in: row.plug_in,
            expected: row.expected,
            probability: evidence.map_or(none, |told| told.probability),
            posterior_mean: evidence.map_or(0.0, |told| told.posterior_mean),
            interval: evidence.map_or([0.0; 2], |told| told.interval),
            by_segment: by_segment.map(Box::new),
            dependence: evidence.map(|told| told.dependence),
            verdict: row.verdict,
            is_predicted: matches!(row.basis, Basis::Model(_)),
        }
    }
}

impl Kept {
    fn evidence(&self) -> Option<Evidence> {
        let by_segment = self.by_segment.as_deref();
        self.dependence.map(|dependence| Evidence {
            dependence,
            probability: self.probability,
            posterior_mean: self.posterior_mean,
            interval: self.interval,
            differ: by_segment.and_then(|told| told.differ),
            pooled: by_segment.and_then(|told| told.pooled),
        })
    }
}

impl Ranked for Rows {
    fn len(&self) -> usize {
        self.len()
    }

    fn bins(&self, at: usize) -> &[u32] {
        self.kept.bins(at)
    }

    fn visits(&self, at: usize) -> u64 {
        self.kept.values()[at].visits
    }

    fn plug_in(&self, at: usize) -> f64 {
        self.kept.values()[at].plug_in
    }

    fn posterior_mean(&self, at: usize) -> f64 {
        self.kept.values()[at].posterior_mean
    }

    fn dependent(&self, at: usize) -> f64 {
        self.kept.values()[at].probability.dependent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(key: u32, evidence: Option<Evidence>, basis: Basis) -> Row {
        Row {
            key: StateKey::new(&[key, 2]),
            visits: 7,
            plug_in: 0.4,
            expected: 0.3,
            evidence,
            verdict: Verdict::Influences,
            basis,
        }
    }

    fn evidence(differ: Option<f64>) -> Evidence {
        Evidence {
            dependence: Dependence::Open,
            probability: Probability {
                dependent: 0.9,
                above_threshold: 0.8,
            },
            posterior_mean: 0.7,
            interval: [0.1, 0.9],
            differ,
            pooled: differ.map(|differ| 0.5 * differ),
        }
    }

    #[test]
    fn rows_come_back_as_they_were() {
        let by_key = [
            row(0, None, Basis::Counts(7)),
            row(1, Some(evidence(None)), Basis::Model(3)),
            row(2, Some(evidence(Some(0.6))), Basis::Counts(7)),
        ];
        let mut rows = Rows::new(Some(3));
        [1, 2, 0].iter().for_each(|at| rows.push(&by_key[*at]));
        rows.sort();
        let back: Vec<Row> = (0..rows.len()).map(|at| rows.row(at)).collect();
        assert_eq!(back, by_key);
    }

    #[test]
    fn a_row_of_a_million_is_small() {
        assert_eq!(size_of::<Kept>(), 80);
    }
}
