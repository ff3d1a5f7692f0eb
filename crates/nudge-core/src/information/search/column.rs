//! One coordinate of the states of a search, and the conditions that it allows.

use std::collections::BTreeMap;
use std::ops::Range;

use super::rule::Condition;
use super::states::{Axis, States};
use super::sum::FEWEST_VISITS;

/// Intervals begin and end at so many bins at most: at those that part the visits evenly, where
/// more have any.
const MOST_STEPS: usize = 16;
/// The most values that conditions name of a coordinate without an order: those with most visits.
const MOST_VALUES: usize = 48;

/// One coordinate, with its bins numbered anew by small codes.
#[derive(Debug)]
pub(super) struct Column {
    axis: usize,
    /// The bins of each code that conditions may name, rising.
    runs: Vec<Range<u32>>,
    /// Of how many bins, where they have an order.
    ordered: Option<u32>,
    /// Whether there is a code more, for all other bins.
    has_others: bool,
}

/// Codes from the first to the last.
pub(super) type Codes = [u8; 2];

impl Column {
    /// Returns the columns of states that allow a condition.
    pub fn all(states: &States) -> Vec<Self> {
        let axes = states.axes().iter().enumerate();
        let all = axes.map(|(at, axis)| Self::new(at, *axis, states));
        all.filter(|column| column.conditions() > 0).collect()
    }

    fn new(at: usize, axis: Axis, states: &States) -> Self {
        let mut visits = BTreeMap::new();
        for (bin, sum) in states.bins(at).iter().zip(states.sums()) {
            *visits.entry(*bin).or_insert(0) += sum.visits;
        }
        match axis {
            Axis::Ordered(bins) => Self::ordered(at, bins, &visits),
            Axis::Unordered => Self::unordered(at, &visits),
        }
    }

    fn ordered(axis: usize, bins: u32, visits: &BTreeMap<u32, u64>) -> Self {
        // Bins that only the other half saw have a place too.
        let weight = |visits: &u64| *visits as f64 + 1.0;
        let all: f64 = visits.values().map(weight).sum();
        let is_fine = visits.len() <= MOST_STEPS;
        let mut runs: Vec<Range<u32>> = Vec::new();
        let (mut before, mut last) = (0.0, None);
        for (bin, visits) in visits {
            let step = Some((before / all * MOST_STEPS as f64) as u64);
            match runs.last_mut() {
                Some(run) if !is_fine && last == step => run.end = bin + 1,
                _ => runs.push(*bin..bin + 1),
            }
            (before, last) = (before + weight(visits), step);
        }
        Self {
            axis,
            runs,
            ordered: Some(bins),
            has_others: false,
        }
    }

    fn unordered(axis: usize, visits: &BTreeMap<u32, u64>) -> Self {
        let mut named: Vec<(u32, u64)> =
            visits.iter().map(|(bin, visits)| (*bin, *visits)).collect();
        named.retain(|(_, visits)| *visits >= FEWEST_VISITS);
        named.sort_by_key(|(bin, visits)| (std::cmp::Reverse(*visits), *bin));
        named.truncate(MOST_VALUES);
        let has_others = named.len() < visits.len();

        let mut bins: Vec<u32> = named.into_iter().map(|(bin, _)| bin).collect();
        bins.sort_unstable();
        let runs = bins.into_iter().map(|bin| bin..bin + 1).collect();
        Self {
            axis,
            runs,
            ordered: None,
            has_others,
        }
    }

    /// Returns which coordinate it is.
    pub fn axis(&self) -> usize {
        self.axis
    }

    /// Returns how many codes there are.
    pub fn width(&self) -> usize {
        self.runs.len() + usize::from(self.has_others)
    }

    /// Returns how many conditions there are that leave a code out.
    pub fn conditions(&self) -> u64 {
        let named = self.runs.len() as u64;
        match self.ordered {
            Some(_) => (named * (named + 1) / 2).saturating_sub(1),
            None if named == 1 && !self.has_others => 0,
            None => named,
        }
    }

    /// Returns the last code that a condition may have which begins at this one.
    #[inline]
    pub fn last(&self, first: usize) -> usize {
        match self.ordered {
            Some(_) => self.runs.len() - 1,
            None => first,
        }
    }

    /// Returns how many codes conditions may begin at.
    pub fn named(&self) -> usize {
        self.runs.len()
    }

    /// Returns whether a condition is none, since it leaves no code out.
    #[inline]
    pub fn is_free(&self, [first, last]: Codes) -> bool {
        usize::from(last - first) + 1 == self.width()
    }

    /// Returns the code of each state.
    pub fn codes(&self, states: &States) -> Vec<u8> {
        states
            .bins(self.axis)
            .iter()
            .map(|bin| self.code(*bin))
            .collect()
    }

    fn code(&self, bin: u32) -> u8 {
        let at = self.runs.partition_point(|run| run.end <= bin);
        let is_named =
            self.ordered.is_some() || self.runs.get(at).is_some_and(|run| run.start == bin);
        if is_named {
            at as u8
        } else {
            self.runs.len() as u8
        }
    }

    /// Returns what codes from one to another mean; an interval that begins or ends with the
    /// outermost bin that was seen has no end there.
    pub fn condition(&self, [first, last]: Codes) -> Condition {
        let [first, last] = [first, last].map(usize::from);
        let mut bins = self.runs[first].start..self.runs[last].end;
        if let Some(all) = self.ordered {
            bins.start = if first == 0 { 0 } else { bins.start };
            bins.end = if last + 1 == self.runs.len() {
                all
            } else {
                bins.end
            };
        }
        Condition {
            axis: self.axis,
            bins,
        }
    }
}
