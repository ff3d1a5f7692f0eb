//! Stratified permutation tests of independence beside pooled ones, and what it means where they
//! disagree (Simpson's paradox).

use crate::domain::{Evidence, Exchange, Significance};
use crate::information::{self, Table, smallest_p};

/// Permutations of a test of independence: its p-value is known to about a thousandth.
const PERMUTATIONS: u64 = 4_000;

/// The largest p-value of a test that finds dependence.
const FOUND: f64 = 0.01;

/// Probabilities of dependence from which there is some, and up to which there may be none.
const PROBABLE: f64 = 0.95;
const IMPROBABLE: f64 = 0.5;

/// A test with a p-value above this finds none.
const MISSED: f64 = 0.1;

/// The permutation tests of one state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tested {
    pooled: Significance,
    /// Within segments, and whether it disagrees, where there are several.
    stratified: Option<(Significance, Option<Disagreement>)>,
}

impl Tested {
    /// Tests a state by its observations, and where it has several segments, by the same cut by
    /// segment.
    pub fn new(observations: &[Table], strata: Option<&[Table]>, seed: u64) -> Self {
        let pooled = permutation_test(observations, seed);
        let stratified = strata.map(|strata| {
            let stratified = permutation_test(strata, seed);
            (
                stratified,
                Disagreement::between_p_values(
                    pooled.p_value,
                    stratified.p_value,
                    smallest_p(strata),
                ),
            )
        });
        Self { pooled, stratified }
    }

    /// Returns the test that is asked for.
    pub fn significance(&self, exchange: Exchange) -> Significance {
        match (exchange, self.stratified) {
            (Exchange::WithinSegments, Some((stratified, _))) => stratified,
            (Exchange::WithinSegments, None) | (Exchange::Pooled, _) => self.pooled,
        }
    }

    /// Returns a warning where the two disagree.
    pub fn warning(&self) -> Option<String> {
        let (stratified, disagreement) = self.stratified?;
        let [pooled, stratified] =
            [self.pooled, stratified].map(|test| written_p_value(test.p_value));
        Some(format!(
            "pooled p {pooled}, but within segments p {stratified}: {}",
            disagreement?.meaning()
        ))
    }
}

fn permutation_test(strata: &[Table], seed: u64) -> Significance {
    let test = information::p_value(strata, PERMUTATIONS, seed);
    Significance {
        p_value: test.p_value,
        method: test.method.as_str(),
    }
}

/// A pooled and a stratified test of one state disagree: which of the two finds dependence where
/// the other finds none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disagreement {
    /// The pooled one.
    Pooled,
    /// The pooled one, where none within segments could.
    Untestable,
    /// The stratified one.
    Stratified,
}

impl Disagreement {
    const ALL: [Self; 3] = [Self::Pooled, Self::Untestable, Self::Stratified];

    /// Tests a state of several segments both ways, by so many permutations; `None` where the tests
    /// do not disagree.
    pub fn between(
        pooled: &[Table],
        strata: &[Table],
        permutations: u64,
        seed: u64,
    ) -> Option<Self> {
        let p_value = |strata| information::p_value(strata, permutations, seed).p_value;
        // Where no test within segments could find anything, none need be made.
        let smallest = smallest_p(strata);
        let stratified = if smallest > MISSED {
            smallest
        } else {
            p_value(strata)
        };
        Self::between_p_values(p_value(pooled), stratified, smallest)
    }

    /// Compares the p-values of two tests; `smallest` is the smallest that the stratified one could
    /// have.
    fn between_p_values(pooled: f64, stratified: f64, smallest: f64) -> Option<Self> {
        if stratified <= FOUND && pooled > MISSED {
            Some(Self::Stratified)
        } else if pooled <= FOUND && stratified > MISSED {
            Some(if smallest > MISSED {
                Self::Untestable
            } else {
                Self::Pooled
            })
        } else {
            None
        }
    }

    /// Compares what the evidence says of a state with what it would say of the pooled table;
    /// `None` too where there is nothing to compare.
    pub fn in_evidence(evidence: &Evidence) -> Option<Self> {
        let (pooled, told) = (evidence.pooled?, evidence.probability.dependent);
        if pooled >= PROBABLE && told <= IMPROBABLE {
            Some(Self::Pooled)
        } else if pooled <= IMPROBABLE && told >= PROBABLE {
            Some(Self::Stratified)
        } else {
            None
        }
    }

    /// Returns what it may mean.
    fn meaning(self) -> &'static str {
        match self {
            Self::Pooled => "what looks like dependence may be segments whose habits differ",
            Self::Untestable => "each has too few draws to tell dependence from habits that differ",
            Self::Stratified => "segments depend in different ways, which pooling hides",
        }
    }
}

/// Writes a p-value behind its p: `= 0.0312`, `< 0.0001`.
pub fn written_p_value(p_value: f64) -> String {
    if p_value < 1e-4 {
        "< 0.0001".into()
    } else {
        format!("= {p_value:.4}")
    }
}

/// Returns a warning where the evidence says of a state what it would not of the pooled table.
pub fn warning(evidence: &Evidence) -> Option<String> {
    let meaning = Disagreement::in_evidence(evidence)?.meaning();
    let (pooled, told) = (evidence.pooled?, evidence.probability.dependent);
    Some(format!(
        "pooled P(dependent) {pooled:.4}, but {told:.4} where segments are told apart: {meaning}"
    ))
}

/// Returns a warning of each kind for the states of an environment.
pub fn warnings(states: impl Iterator<Item = Evidence> + Clone) -> Vec<String> {
    let kind = |kind: Disagreement| {
        let of_kind = states
            .clone()
            .filter(|evidence| Disagreement::in_evidence(evidence) == Some(kind));
        let (states, meaning) = (of_kind.count(), kind.meaning());
        let plural = if states == 1 { "" } else { "s" };

        let (pooled, told) = match kind {
            Disagreement::Stratified => (format!("<= {IMPROBABLE}"), format!(">= {PROBABLE}")),
            Disagreement::Pooled | Disagreement::Untestable => {
                (format!(">= {PROBABLE}"), format!("<= {IMPROBABLE}"))
            }
        };

        let said =
            format!("pooled P(dependent) {pooled}, but {told} where segments are told apart");
        (states > 0).then(|| format!("in {states} state{plural} {said}: {meaning}"))
    };
    Disagreement::ALL.into_iter().filter_map(kind).collect()
}

/// How often the tests disagree among the states of an environment.
#[derive(Debug, Default)]
pub struct Disagreements([u64; Disagreement::ALL.len()]);

impl Disagreements {
    /// Counts a state.
    pub fn add(&mut self, disagreement: Disagreement) {
        self.0[disagreement as usize] += 1;
    }

    /// Returns a sentence for each kind that there is.
    pub fn warnings(&self) -> Vec<String> {
        let counted = Disagreement::ALL
            .into_iter()
            .zip(self.0)
            .filter(|(_, states)| *states > 0);
        counted
            .map(|(disagreement, states)| sentence(disagreement, states))
            .collect()
    }
}

fn sentence(disagreement: Disagreement, states: u64) -> String {
    let tests = match disagreement {
        Disagreement::Pooled | Disagreement::Untestable => {
            format!("pooled p <= {FOUND}, but within segments p > {MISSED}")
        }
        Disagreement::Stratified => {
            format!("within segments p <= {FOUND}, but pooled p > {MISSED}")
        }
    };
    let plural = if states == 1 { "" } else { "s" };
    format!(
        "in {states} state{plural} {tests}: {}",
        disagreement.meaning()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(counts: [[u64; 2]; 2]) -> Table {
        let cells = [(0, 0), (0, 1), (1, 0), (1, 1)];
        Table::from_counts(cells.map(|(i, j)| (i, j, counts[i as usize][j as usize])))
    }

    fn tested(pooled: [[u64; 2]; 2], strata: &[[[u64; 2]; 2]]) -> Tested {
        let strata: Vec<Table> = strata.iter().copied().map(table).collect();
        Tested::new(&[table(pooled)], Some(&strata), 1)
    }

    #[test]
    fn segments_with_opposite_habits_depend_only_when_pooled() {
        let tested = tested(
            [[82, 18], [18, 82]],
            &[[[81, 9], [9, 1]], [[1, 9], [9, 81]]],
        );
        assert!(
            tested.significance(Exchange::Pooled).p_value < 1e-4,
            "{tested:?}"
        );
        assert!(
            tested.significance(Exchange::WithinSegments).p_value > 1.0 - 1e-9,
            "{tested:?}"
        );
        let expected = "pooled p < 0.0001, but within segments p = 1.0000: \
                        what looks like dependence may be segments whose habits differ";
        assert_eq!(tested.warning().as_deref(), Some(expected));
    }

    #[test]
    fn segments_that_depend_in_opposite_ways_depend_only_within() {
        let tested = tested(
            [[20, 20], [20, 20]],
            &[[[20, 0], [0, 20]], [[0, 20], [20, 0]]],
        );
        let expected = "pooled p = 1.0000, but within segments p < 0.0001: \
                        segments depend in different ways, which pooling hides";
        assert_eq!(tested.warning().as_deref(), Some(expected));
    }

    #[test]
    fn a_draw_a_segment_tells_nothing() {
        let draws = [[[1, 0], [0, 0]], [[0, 0], [0, 1]]].repeat(10);
        let told = tested([[10, 0], [0, 10]], &draws)
            .warning()
            .expect("they disagree");
        assert!(
            told.ends_with("each has too few draws to tell dependence from habits that differ"),
            "{told}"
        );
    }

    #[test]
    fn tests_that_agree_need_no_word() {
        assert_eq!(
            tested(
                [[40, 0], [0, 40]],
                &[[[20, 0], [0, 20]], [[20, 0], [0, 20]]]
            )
            .warning(),
            None
        );
        assert_eq!(
            tested(
                [[20, 20], [20, 20]],
                &[[[10, 10], [10, 10]], [[10, 10], [10, 10]]]
            )
            .warning(),
            None
        );
        let alone = Tested::new(&[table([[40, 0], [0, 40]])], None, 1);
        assert_eq!(
            alone.significance(Exchange::Pooled),
            alone.significance(Exchange::WithinSegments)
        );
    }

    #[test]
    fn an_environment_is_told_how_many_states_disagree() {
        let mut disagreements = Disagreements::default();
        for one in [
            Disagreement::Pooled,
            Disagreement::Stratified,
            Disagreement::Pooled,
        ] {
            disagreements.add(one);
        }
        let expected = [
            "in 2 states pooled p <= 0.01, but within segments p > 0.1: \
             what looks like dependence may be segments whose habits differ",
            "in 1 state within segments p <= 0.01, but pooled p > 0.1: \
             segments depend in different ways, which pooling hides",
        ];
        assert_eq!(disagreements.warnings(), expected);
        assert!(Disagreements::default().warnings().is_empty());
    }
}
