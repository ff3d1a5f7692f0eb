//! The labels of a categorical feature, and which of them a number or a text names.
//!
//! Labels come first, by their very characters. A label whose text reads as a number is that
//! number: JSON 1 is the label "1", wherever it stands in the list. Only where no label reads as a
//! number is a number an index from 0, so that it cannot mean two things.

use std::ops::Deref;
use std::sync::Arc;

use super::Label;

/// From here on a double does not tell neighbouring whole numbers apart, so a number is no name of
/// anything.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// Labels in the order of their bins. Cloning is cheap.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelSet {
    labels: Arc<[Label]>,
    /// What labels read as, with their positions, in order of number; empty where none reads as a
    /// number.
    numbers: Arc<[(f64, u32)]>,
}

impl LabelSet {
    /// Returns the position of the label that is this very text.
    pub fn position(&self, text: &str) -> Option<u32> {
        self.labels
            .iter()
            .position(|label| label.as_str() == text)
            .map(|i| i as u32)
    }

    /// Returns whether a number is an index: where no label reads as a number.
    pub fn takes_indices(&self) -> bool {
        self.numbers.is_empty()
    }

    /// Returns the position of the label that reads as this number; of several the one that is
    /// written as short as can be, `1` and not `1.0`.
    pub fn position_of_number(&self, number: f64) -> Option<u32> {
        // Whole numbers as large as that come as text, digit by digit.
        let is_meant =
            |at: &u32| number.abs() < EXACT || !is_whole(self.labels[*at as usize].as_str());

        let from = self.numbers.partition_point(|(read, _)| *read < number);
        let equal = self.numbers[from..]
            .iter()
            .take_while(|(read, _)| *read == number);

        match equal
            .map(|(_, at)| *at)
            .filter(is_meant)
            .collect::<Vec<_>>()
            .as_slice()
        {
            [only] => Some(*only),
            several => several
                .iter()
                .copied()
                .find(|at| self.labels[*at as usize].as_str() == number.to_string()),
        }
    }

    /// Returns the positions of two labels that are the same number as JSON writes numbers, `1` and
    /// `1.0`: as text they are two, as numbers one.
    pub fn alike(&self) -> Option<(usize, usize)> {
        let text = |at: u32| self.labels[at as usize].as_str();
        let plain: Vec<&(f64, u32)> = self
            .numbers
            .iter()
            .filter(|(_, at)| is_plain_number(text(*at)))
            .collect();

        let are_one = |pair: &&[&(f64, u32)]| {
            let [(a, first), (b, second)] = [pair[0], pair[1]];
            a == b && !(is_whole(text(*first)) && is_whole(text(*second)))
        };

        let pair = plain.windows(2).find(are_one)?;
        let [a, b] = [pair[0].1 as usize, pair[1].1 as usize];
        Some((a.min(b), a.max(b)))
    }
}

impl FromIterator<Label> for LabelSet {
    fn from_iter<I: IntoIterator<Item = Label>>(labels: I) -> Self {
        let labels: Arc<[Label]> = labels.into_iter().collect();
        let read = |(at, label): (usize, &Label)| Some((reads_as(label.as_str())?, at as u32));
        let mut numbers: Vec<(f64, u32)> = labels.iter().enumerate().filter_map(read).collect();
        numbers.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        Self {
            labels,
            numbers: numbers.into(),
        }
    }
}

impl Deref for LabelSet {
    type Target = [Label];

    fn deref(&self) -> &[Label] {
        &self.labels
    }
}

/// Returns the number that a label reads as. Space around it does not count, and `nan` and `inf`
/// are words.
fn reads_as(label: &str) -> Option<f64> {
    // Adding zero turns -0.0 into 0.0, which `total_cmp` tells apart.
    label
        .trim()
        .parse()
        .ok()
        .filter(|number: &f64| number.is_finite())
        .map(|number| number + 0.0)
}

/// Returns whether JSON tells a number by its very digits: what 64 bits hold.
fn is_whole(text: &str) -> bool {
    text.parse::<u64>().is_ok() || text.parse::<i64>().is_ok()
}

/// Returns whether text is a number as JSON writes it: `01` may be somebody's name.
pub(super) fn is_plain_number(text: &str) -> bool {
    let unsigned = text.strip_prefix('-').unwrap_or(text).as_bytes();
    let leading = match unsigned {
        [b'0', next, ..] => !next.is_ascii_digit(),
        [first, ..] => first.is_ascii_digit(),
        [] => false,
    };
    leading && text.parse::<f64>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(labels: &[&str]) -> LabelSet {
        labels
            .iter()
            .map(|label| label.parse::<Label>().expect("valid"))
            .collect()
    }

    #[test]
    fn a_number_is_the_label_that_reads_as_it() {
        let dice = set(&["1", "2", "3"]);
        assert_eq!(
            [1.0, 2.0, 3.0].map(|n| dice.position_of_number(n)),
            [Some(0), Some(1), Some(2)]
        );
        assert_eq!(
            [0.0, 4.0, 1.5, f64::NAN].map(|n| dice.position_of_number(n)),
            [None; 4]
        );
        let odd = set(&["none", "-0", " 7 ", "1e2", "0.1", "+3", "½"]);
        assert_eq!(
            [0.0, 7.0, 100.0, 0.1, 3.0].map(|n| odd.position_of_number(n)),
            [1, 2, 3, 4, 5].map(Some)
        );
    }

    #[test]
    fn one_label_that_reads_as_a_number_is_enough_to_rule_out_indices() {
        for numbers in [&["none", "1"][..], &["a", " 2 "], &["x", "1e400", "-3.5"]] {
            assert!(!set(numbers).takes_indices(), "{numbers:?}");
        }
        for words in [
            &["north", "south"][..],
            &["1st", "2nd"],
            &["nan", "inf", "true", "null"],
            &["2,1", "3,1"],
            &["１"],
        ] {
            assert!(set(words).takes_indices(), "{words:?}");
        }
    }

    #[test]
    fn of_labels_that_read_alike_the_shortest_is_meant() {
        assert_eq!(set(&["1.0", "01", "1"]).position_of_number(1.0), Some(2));
        assert_eq!(set(&["1.0", "01"]).position_of_number(1.0), None);
        assert_eq!(set(&["1.0", "2"]).position_of_number(1.0), Some(0));
    }

    #[test]
    fn numbers_that_a_double_cannot_hold_name_nothing() {
        let accounts = set(&["76561198000000001", "76561198000000003", "123456789"]);
        assert_eq!(accounts.position_of_number(76_561_198_000_000_001.0), None);
        // As 32-bit floats these two would be one.
        assert_eq!(accounts.position_of_number(123_456_790.0), None);
        assert_eq!(accounts.position_of_number(123_456_789.0), Some(2));
        // These are no whole numbers of 64 bits, so nobody can mean a neighbour.
        let powers = set(&["1e17", "99999999999999999999", "1e300"]);
        assert_eq!(
            [1e17, 1e20, 1e300].map(|n| powers.position_of_number(n)),
            [Some(0), Some(1), Some(2)]
        );
    }

    #[test]
    fn two_labels_that_json_writes_as_one_number_are_alike() {
        for (labels, pair) in [
            (&["1", "1.0"][..], (0, 1)),
            (&["x", "2.50", "7", "2.5"], (1, 3)),
            (&["1e17", "3", "100000000000000000"], (0, 2)),
            (&["99999999999999999999", "99999999999999999998"], (0, 1)),
        ] {
            assert_eq!(set(labels).alike(), Some(pair), "{labels:?}");
        }
        for labels in [
            &["007", "7", " 7 ", "+7"][..],
            &["76561198000000001", "76561198000000003"],
            &["1st", "1"],
            &["nan", "NaN"],
            &["0", "-0"],
        ] {
            assert_eq!(set(labels).alike(), None, "{labels:?}");
        }
    }
}
