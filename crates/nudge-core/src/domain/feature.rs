//! Features and their discretisation: named coordinates of a state or of an action, and the bins
//! that their values fall into.

use std::fmt;
use std::sync::Arc;

use super::{Angle, Label, LabelSet, Name};

/// One named coordinate with a discretiser.
#[derive(Debug, Clone, PartialEq)]
pub struct Feature {
    /// Unique among the features and agents of its environment.
    pub name: Name,
    /// The unit of its values, for people.
    pub unit: Option<Label>,
    /// How values become bins.
    pub kind: FeatureKind,
}

/// The discretiser of a feature: how its values become bins. Made only by
/// [`super::Schema::try_from`], so every variant is within its limits.
#[derive(Debug, Clone, PartialEq)]
pub enum FeatureKind {
    /// Bin = number of edges <= value; strictly increasing finite edges, so k edges make k + 1
    /// bins.
    Continuous(Arc<[f32]>),
    /// That many equal bins of an angle, the first centred on 0.
    Circular(u32, Angle),
    /// Whole numbers from the first to the second, a bin each.
    Integer(i32, i32),
    /// One bin a label, in this order. Among values by position a value is the label's index.
    Categorical(LabelSet),
}

/// A value that has no bin: what it was and what was expected.
#[derive(Debug, Clone, Copy)]
pub struct BinError<'a> {
    value: f32,
    kind: &'a FeatureKind,
}

impl FeatureKind {
    /// Returns the number of bins, at least 1.
    pub fn bins(&self) -> u32 {
        match self {
            Self::Continuous(edges) => edges.len() as u32 + 1,
            Self::Circular(bins, _) => *bins,
            Self::Integer(min, max) => max.abs_diff(*min) + 1,
            Self::Categorical(labels) => labels.len() as u32,
        }
    }

    /// Returns the word for it.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Continuous(_) => "continuous",
            Self::Circular(..) => "circular",
            Self::Integer(..) => "integer",
            Self::Categorical(_) => "categorical",
        }
    }

    /// Returns the bin of `value`; NaN, infinities and values outside an alphabet are misfits.
    #[inline]
    pub fn bin(&self, value: f32) -> Result<u32, BinError<'_>> {
        let error = BinError { value, kind: self };
        if !value.is_finite() {
            return Err(error);
        }

        match self {
            Self::Continuous(edges) => Ok(edges_at_or_below(edges, value)),
            Self::Circular(bins, angle) => Ok(angle.sector(*bins, value)),
            Self::Integer(min, max) => whole(value, *min, *max).ok_or(error),
            Self::Categorical(labels) => whole(value, 0, labels.len() as i32 - 1).ok_or(error),
        }
    }

    /// Returns the bins of several values, as [`FeatureKind::bin`] does of one; [`MISFIT`] of a
    /// value that has none. Loops without branches, for the compiler to vectorise.
    #[inline]
    pub(super) fn bins_of<const LANES: usize>(&self, values: &[f32; LANES]) -> [u32; LANES] {
        let mut bins = match self {
            Self::Continuous(edges) if edges.len() <= SHORT => {
                let mut bins = [0; LANES];
                for edge in edges.iter() {
                    (0..LANES).for_each(|lane| bins[lane] += u32::from(*edge <= values[lane]));
                }
                bins
            }
            Self::Integer(min, max) => whole_of(values, *min, *max),
            Self::Categorical(labels) => whole_of(values, 0, labels.len() as i32 - 1),
            _ => values.map(|value| self.bin(value).unwrap_or(MISFIT)),
        };

        for lane in 0..LANES {
            bins[lane] = if values[lane].is_finite() {
                bins[lane]
            } else {
                MISFIT
            };
        }
        bins
    }

    /// Returns what people call a bin: a label, a number, an interval `[0.5, 1)` or the centre of a
    /// sector.
    pub fn bin_label(&self, bin: u32) -> String {
        match self {
            Self::Continuous(edges) => interval(edges, bin as usize),
            Self::Circular(bins, angle) => angle.sector_label(*bins, bin),
            Self::Integer(min, _) => (i64::from(*min) + i64::from(bin)).to_string(),
            Self::Categorical(labels) => labels[bin as usize].to_string(),
        }
    }

    /// Returns the bin that people call so; `None` where there is none.
    pub fn bin_of_label(&self, label: &str) -> Option<u32> {
        let bin = match self {
            Self::Categorical(labels) => labels.position(label)?,
            // An interval says where it begins, but for the first.
            Self::Continuous(_) if label.starts_with('<') || label == "any" => 0,
            Self::Continuous(_) => {
                let low = label.trim_start_matches(['[', '>', '=', ' ']);
                self.bin(low.split(',').next()?.parse().ok()?).ok()?
            }
            Self::Circular(..) | Self::Integer(..) => self.bin(label.parse().ok()?).ok()?,
        };
        (self.bin_label(bin) == label).then_some(bin)
    }

    /// Returns what a value must be, for error messages.
    pub fn expected(&self) -> String {
        match self {
            Self::Continuous(_) => "a finite number".into(),
            Self::Circular(_, angle) => format!("a finite angle in {}", angle.as_str()),
            Self::Integer(min, max) => format!("a whole number from {min} to {max}"),
            Self::Categorical(labels) if labels.takes_indices() => {
                format!(
                    "one of {}, or an index from 0 to {}",
                    listed(labels),
                    labels.len() - 1
                )
            }
            Self::Categorical(labels) => format!("one of {}", listed(labels)),
        }
    }
}

impl fmt::Display for BinError<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { value, kind } = self;
        match kind {
            // Whoever wrote a label has its index by now, so this value is an index by position.
            FeatureKind::Categorical(labels) if !labels.takes_indices() => {
                write!(
                    f,
                    "got {value}, expected an index from 0 to {} of {}",
                    labels.len() - 1,
                    listed(labels)
                )
            }
            _ => write!(f, "got {value}, expected {}", kind.expected()),
        }
    }
}

/// Returns the first labels, joined by commas.
fn listed(labels: &[Label]) -> String {
    const TOLD: usize = 12;
    let told: Vec<&str> = labels.iter().take(TOLD).map(Label::as_str).collect();
    let more = if labels.len() > TOLD { ", ..." } else { "" };
    format!("{}{more}", told.join(", "))
}

/// Returns how many letters the alphabet of some features has.
pub(super) fn letters(features: &[Feature]) -> u64 {
    let bins = features.iter().map(|feature| feature.kind.bins());
    bins.map(u64::from).product()
}

/// Returns the labels of the features of a letter joined by "/".
pub(super) fn letter_label(features: &[Feature], index: u64) -> String {
    let mut rest = index;
    let mut labels = Vec::with_capacity(features.len());
    for feature in features.iter().rev() {
        let bins = u64::from(feature.kind.bins());
        labels.push(feature.kind.bin_label((rest % bins) as u32));
        rest /= bins;
    }
    labels.reverse();
    labels.join("/")
}

/// The most edges that are compared one by one, which is faster than a search there.
const SHORT: usize = 16;

/// The bin of a value that has none; no feature has so many.
pub(super) const MISFIT: u32 = u32::MAX;

/// Counts without branching while the list is short.
#[inline]
fn edges_at_or_below(edges: &[f32], value: f32) -> u32 {
    if edges.len() <= SHORT {
        edges.iter().map(|&edge| u32::from(edge <= value)).sum()
    } else {
        edges.partition_point(|&edge| edge <= value) as u32
    }
}

#[inline]
fn whole(value: f32, min: i32, max: i32) -> Option<u32> {
    // The cast saturates, and whole numbers within +-2^24 survive it both ways: a comparison
    // instead of a call to `trunc`.
    let number = value as i32;
    let within = number >= min && number <= max && number as f32 == value;
    within.then(|| (number - min) as u32)
}

#[inline]
fn whole_of<const LANES: usize>(values: &[f32; LANES], min: i32, max: i32) -> [u32; LANES] {
    values.map(|value| whole(value, min, max).unwrap_or(MISFIT))
}

fn interval(edges: &[f32], bin: usize) -> String {
    match (bin.checked_sub(1).map(|low| edges[low]), edges.get(bin)) {
        (None, None) => "any".into(),
        (None, Some(high)) => format!("< {high}"),
        (Some(low), None) => format!(">= {low}"),
        (Some(low), Some(high)) => format!("[{low}, {high})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn continuous(edges: &[f32]) -> FeatureKind {
        FeatureKind::Continuous(edges.into())
    }

    #[test]
    fn a_value_on_an_edge_belongs_above_it() {
        let kind = continuous(&[0.5, 0.7, 1.0]);
        let bins: Vec<u32> = [0.4, 0.5, 0.7, 0.69999, 1.0, -0.0, 9.0]
            .map(|v| kind.bin(v).expect("finite"))
            .to_vec();
        assert_eq!(bins, [0, 1, 2, 1, 3, 0, 3]);
    }

    #[test]
    fn long_and_short_edge_lists_agree() {
        let edges: Vec<f32> = (0..40).map(|i| i as f32 * 0.5).collect();
        for step in -4..100 {
            let value = step as f32 * 0.25;
            let counted = edges.iter().filter(|&&e| e <= value).count() as u32;
            assert_eq!(continuous(&edges).bin(value).expect("finite"), counted);
        }
    }

    #[test]
    fn integers_refuse_fractions_and_what_lies_outside() {
        let kind = FeatureKind::Integer(-2, 3);
        assert_eq!(kind.bin(-2.0).expect("within"), 0);
        assert_eq!(kind.bin(-0.0).expect("within"), 2);
        for bad in [1.5, 4.0, -3.0, f32::NAN, f32::INFINITY, 16_777_217.0] {
            assert!(kind.bin(bad).is_err(), "{bad}");
        }
        assert_eq!(
            kind.bin(9.0).expect_err("outside").to_string(),
            "got 9, expected a whole number from -2 to 3"
        );
    }

    #[test]
    fn bins_are_named_for_people() {
        let kind = continuous(&[0.5, 1.0]);
        assert_eq!(
            [0, 1, 2].map(|bin| kind.bin_label(bin)),
            ["< 0.5", "[0.5, 1)", ">= 1"]
        );
        assert_eq!(
            FeatureKind::Circular(4, Angle::Radians).bin_label(3),
            "-1.571"
        );
        assert_eq!(FeatureKind::Integer(-2, 3).bin_label(0), "-2");
        assert_eq!(continuous(&[]).bin_label(0), "any");
    }

    #[test]
    fn bins_are_found_by_their_names() {
        let labels = ["a", "left [1, 2)"].map(|text| text.parse::<Label>().expect("valid"));
        for kind in [
            continuous(&[]),
            continuous(&[1e-7, 3e20]),
            continuous(&[-0.5, 0.1, 0.7, 16_777_216.0]),
            FeatureKind::Circular(7, Angle::Degrees),
            FeatureKind::Circular(8, Angle::Radians),
            FeatureKind::Integer(-2, 3),
            FeatureKind::Categorical(labels.into_iter().collect()),
        ] {
            for bin in 0..kind.bins() {
                assert_eq!(
                    kind.bin_of_label(&kind.bin_label(bin)),
                    Some(bin),
                    "{kind:?}"
                );
            }
            for none in ["", "<", "[", "< 9", "[0.1, 0.8)", "02", "b", "0.12"] {
                assert_eq!(kind.bin_of_label(none), None, "{kind:?} {none}");
            }
        }
    }
    #[test]
    fn an_index_is_expected_where_labels_read_as_numbers_and_positions_count() {
        let kind = FeatureKind::Categorical(
            ["1", "2"]
                .map(|label| label.parse::<Label>().expect("valid"))
                .into_iter()
                .collect(),
        );
        assert_eq!(kind.expected(), "one of 1, 2");
        assert_eq!(
            kind.bin(2.0).expect_err("two labels").to_string(),
            "got 2, expected an index from 0 to 1 of 1, 2"
        );
    }
}
