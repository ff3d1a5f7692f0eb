//! Pooled and stratified tests of independence, and what it means where they disagree (Simpson's paradox).

use crate::domain::{Exchange, Significance};
use crate::information::{self, Table, smallest_p};

/// Permutations of a test of independence: its p-value is known to about a thousandth.
const PERMUTATIONS: u64 = 4_000;

/// The largest p-value of a test that finds dependence.
const FOUND: f64 = 0.01;

/// A test with a p-value above this finds none.
const MISSED: f64 = 0.1;

/// The tests of one state.
pub struct Tested {
    pooled: Significance,
    /// Within segments, where there are several; else the same test.
    stratified: Option<Significance>,
    disagreement: Option<Disagreement>,
}

impl Tested {
    /// Tests a state by its draws, and where it has several segments, by the same cut by segment.
    pub fn new(draws: &[Table], strata: Option<&[Table]>, seed: u64) -> Self {
        let pooled = test(draws, seed);
        let stratified = strata.map(|strata| test(strata, seed));
        let both = strata.zip(stratified);
        let disagreement = both.and_then(|(strata, test)| Disagreement::of(pooled.p_value, test.p_value, strata));
        Self { pooled, stratified, disagreement }
    }

    /// Returns the test that is asked for, with a warning where the other says something else.
    pub fn told(&self, exchange: Exchange) -> (Significance, Option<String>) {
        let test = match exchange {
            Exchange::Pooled => self.pooled,
            Exchange::WithinSegments => self.stratified.unwrap_or(self.pooled),
        };
        (test, self.disagreement.map(Disagreement::sentence))
    }
}

fn test(slices: &[Table], seed: u64) -> Significance {
    let test = information::p_value(slices, PERMUTATIONS, seed);
    Significance { p_value: test.p_value, method: test.method.as_str() }
}

/// A pooled and a stratified test of one state of which one finds dependence and the other does not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disagreement {
    kind: Kind,
    pooled: f64,
    stratified: f64,
}

/// Which of the two finds it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// The pooled one.
    Pooled,
    /// The pooled one, where none within segments could.
    Untestable,
    /// The stratified one.
    Stratified,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Pooled, Self::Untestable, Self::Stratified];

    /// Compares the p-values of two tests; `smallest` is the smallest that the stratified one could have.
    fn of(pooled: f64, stratified: f64, smallest: impl FnOnce() -> f64) -> Option<Self> {
        if stratified <= FOUND && pooled > MISSED {
            Some(Self::Stratified)
        } else if pooled <= FOUND && stratified > MISSED {
            Some(if smallest() > MISSED { Self::Untestable } else { Self::Pooled })
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

impl Disagreement {
    /// Tests a state of several segments both ways, by so many permutations; `None` where the tests do not disagree.
    pub fn between(pooled: &[Table], strata: &[Table], permutations: u64, seed: u64) -> Option<Self> {
        let p_value = |slices| information::p_value(slices, permutations, seed).p_value;
        Self::of(p_value(pooled), p_value(strata), strata)
    }

    fn of(pooled: f64, stratified: f64, strata: &[Table]) -> Option<Self> {
        let kind = Kind::of(pooled, stratified, || smallest_p(strata))?;
        Some(Self { kind, pooled, stratified })
    }

    fn sentence(self) -> String {
        let (pooled, stratified) = (told(self.pooled), told(self.stratified));
        format!("pooled p {pooled}, but within segments p {stratified}: {}", self.kind.meaning())
    }
}

fn told(p_value: f64) -> String {
    if p_value < 1e-4 { "< 0.0001".into() } else { format!("= {p_value:.4}") }
}

/// How often the tests disagree among the states of an environment.
#[derive(Debug, Default)]
pub struct Disagreements([u64; Kind::ALL.len()]);

impl Disagreements {
    /// Counts a state.
    pub fn add(&mut self, disagreement: Disagreement) {
        self.0[disagreement.kind as usize] += 1;
    }

    /// Returns a sentence for each kind that there is.
    pub fn warnings(&self) -> Vec<String> {
        let counted = Kind::ALL.into_iter().zip(self.0).filter(|(_, states)| *states > 0);
        counted.map(|(kind, states)| sentence(kind, states)).collect()
    }
}

fn sentence(kind: Kind, states: u64) -> String {
    let tests = match kind {
        Kind::Pooled | Kind::Untestable => format!("pooled p <= {FOUND}, but within segments p > {MISSED}"),
        Kind::Stratified => format!("within segments p <= {FOUND}, but pooled p > {MISSED}"),
    };
    let plural = if states == 1 { "" } else { "s" };
    format!("in {states} state{plural} {tests}: {}", kind.meaning())
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

    fn warning(tested: &Tested) -> Option<String> {
        tested.told(Exchange::Pooled).1
    }

    #[test]
    fn segments_with_opposite_habits_depend_only_when_pooled() {
        let tested = tested([[82, 18], [18, 82]], &[[[81, 9], [9, 1]], [[1, 9], [9, 81]]]);
        let (pooled, told) = tested.told(Exchange::Pooled);
        let (within, same) = tested.told(Exchange::WithinSegments);
        assert!(pooled.p_value < 1e-4, "{pooled:?}");
        assert!(within.p_value > 1.0 - 1e-9, "{within:?}");
        assert_eq!(told, same);
        let expected = "pooled p < 0.0001, but within segments p = 1.0000: \
                        what looks like dependence may be segments whose habits differ";
        assert_eq!(told.as_deref(), Some(expected));
    }

    #[test]
    fn segments_that_depend_in_opposite_ways_depend_only_within() {
        let tested = tested([[20, 20], [20, 20]], &[[[20, 0], [0, 20]], [[0, 20], [20, 0]]]);
        let expected = "pooled p = 1.0000, but within segments p < 0.0001: \
                        segments depend in different ways, which pooling hides";
        assert_eq!(warning(&tested).as_deref(), Some(expected));
    }

    #[test]
    fn a_draw_a_segment_tells_nothing() {
        let draws = [[[1, 0], [0, 0]], [[0, 0], [0, 1]]].repeat(10);
        let told = warning(&tested([[10, 0], [0, 10]], &draws)).expect("they disagree");
        assert!(told.ends_with("each has too few draws to tell dependence from habits that differ"), "{told}");
    }

    #[test]
    fn tests_that_agree_need_no_word() {
        assert_eq!(warning(&tested([[40, 0], [0, 40]], &[[[20, 0], [0, 20]], [[20, 0], [0, 20]]])), None);
        assert_eq!(warning(&tested([[20, 20], [20, 20]], &[[[10, 10], [10, 10]], [[10, 10], [10, 10]]])), None);
        let alone = Tested::new(&[table([[40, 0], [0, 40]])], None, 1);
        assert_eq!(alone.told(Exchange::Pooled), alone.told(Exchange::WithinSegments));
    }

    #[test]
    fn an_environment_is_told_how_many_states_disagree() {
        let mut disagreements = Disagreements::default();
        for kind in [Kind::Pooled, Kind::Stratified, Kind::Pooled] {
            disagreements.add(Disagreement { kind, pooled: 0.5, stratified: 0.5 });
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
