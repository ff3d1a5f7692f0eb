//! From what was written of one coordinate to its bins, and back to the canonical description.

use std::ops::Range;

use super::Condition;
use crate::domain::bin_set::BinSet;
use crate::domain::checked::shortest;
use crate::domain::draft::{ConditionDraft, RangeDraft, ValueDraft};
use crate::domain::named::{number, value, written};
use crate::domain::{Coordinate, FeatureKind};
use crate::error::Fault;

impl Condition {
    /// Returns the condition that a draft means, or its faults within the draft.
    pub(super) fn checked(
        coordinate: &Coordinate,
        draft: &ConditionDraft,
    ) -> Result<Self, Vec<Fault>> {
        Ok(Self {
            bins: bins(coordinate.kind(), draft)?,
            coordinate: coordinate.clone(),
        })
    }

    /// Returns whether it leaves no bin out.
    pub(super) fn is_free(&self) -> bool {
        self.bins.is_all(self.coordinate.kind().bins())
    }

    pub(super) fn draft(&self) -> (String, ConditionDraft) {
        let draft = draft(self.coordinate.kind(), &self.bins);
        (self.coordinate.name().to_string(), draft)
    }
}

fn bins(kind: &FeatureKind, draft: &ConditionDraft) -> Result<BinSet, Vec<Fault>> {
    match draft {
        ConditionDraft::One(value) => {
            let bin = bin_of_value(kind, value);
            bin.map(|bin| BinSet::of_bins([bin]))
                .map_err(|detail| vec![Fault::new("", detail)])
        }
        ConditionDraft::AnyOf(values) => any_of("", values, |value| bin_of_value(kind, value)),
        ConditionDraft::Bins(bins) => any_of("/bins", bins, |bin| bin_of_number(kind, bin)),
        ConditionDraft::Between(range) => {
            between(kind, range).map(|run| BinSet::of_runs(vec![run]))
        }
    }
}

fn any_of(
    pointer: &str,
    values: &[ValueDraft],
    bin: impl Fn(&ValueDraft) -> Result<u32, String>,
) -> Result<BinSet, Vec<Fault>> {
    let (mut bins, mut faults) = (Vec::new(), Vec::new());
    for (i, value) in values.iter().enumerate() {
        match bin(value) {
            Ok(bin) => bins.push(bin),
            Err(detail) => faults.push(Fault::new(format!("{pointer}/{i}"), detail)),
        }
    }
    if values.is_empty() {
        faults.push(Fault::new(
            pointer,
            "got an empty list, expected one or more",
        ));
    }
    match faults.is_empty() {
        true => Ok(BinSet::of_bins(bins)),
        false => Err(faults),
    }
}

/// Returns the bin that a value lies in, as it does in a state, or that is called so.
fn bin_of_value(kind: &FeatureKind, draft: &ValueDraft) -> Result<u32, String> {
    if let ValueDraft::Text(text) = draft
        && let Some(bin) = kind.bin_of_label(text)
    {
        return Ok(bin);
    }
    let value = value(kind, draft)?;
    kind.bin(value).map_err(|error| error.to_string())
}

fn bin_of_number(kind: &FeatureKind, draft: &ValueDraft) -> Result<u32, String> {
    let last = kind.bins() - 1;
    whole(draft, 0, i64::from(last))
        .map(|bin| bin as u32)
        .ok_or_else(|| format!("got {}, expected a bin from 0 to {last}", written(draft)))
}

fn whole(draft: &ValueDraft, least: i64, most: i64) -> Option<i64> {
    let number = number(draft).filter(|number| number.fract() == 0.0)?;
    // The cast saturates, and no limit is as far out.
    Some(number as i64).filter(|whole| (least..=most).contains(whole))
}

/// One end of a range.
#[derive(Clone, Copy)]
enum End {
    From,
    To,
    Below,
}

impl End {
    fn as_str(self) -> &'static str {
        match self {
            Self::From => "from",
            Self::To => "to",
            Self::Below => "below",
        }
    }
}

/// Returns the bins of a range: from the bin at `from` on, up to the one at `to` or before the one
/// at `below`.
fn between(kind: &FeatureKind, range: &RangeDraft) -> Result<Range<u32>, Vec<Fault>> {
    let RangeDraft { from, to, below } = range;
    let upper = match (to, below) {
        (Some(_), Some(_)) => {
            let detail = "got both to and below, expected one of them";
            return Err(vec![Fault::new("/below", detail)]);
        }
        (Some(to), None) => Some((End::To, to)),
        (None, below) => below.as_ref().map(|below| (End::Below, below)),
    };
    if from.is_none() && upper.is_none() {
        let detail = "got an object without any, expected from, to, below or bins";
        return Err(vec![Fault::new("", detail)]);
    }
    let scale = Scale::of(kind).map_err(|detail| vec![Fault::new("", detail)])?;

    let ends = [from.as_ref().map(|from| (End::From, from)), upper];
    let mut faults = Vec::new();
    let [start, end] = ends.map(|end| {
        let (end, draft) = end?;
        scale
            .place(end, draft)
            .map_err(|detail| faults.push(Fault::new(format!("/{}", end.as_str()), detail)))
            .ok()
    });
    if !faults.is_empty() {
        return Err(faults);
    }

    let run = start.unwrap_or(0)..end.unwrap_or(kind.bins());
    match (run.is_empty(), upper) {
        (true, Some((end, draft))) => Err(vec![behind(end, draft, from.as_ref())]),
        _ => Ok(run),
    }
}

fn behind(end: End, draft: &ValueDraft, from: Option<&ValueDraft>) -> Fault {
    let from = from.map_or_else(String::new, written);
    let expected = match end {
        End::Below => "more than from",
        End::From | End::To => "at least from",
    };
    let detail = format!(
        "got {}, expected {expected}, which is {from}",
        written(draft)
    );
    Fault::new(format!("/{}", end.as_str()), detail)
}

/// What has an order, so that there are ranges of it.
enum Scale<'a> {
    /// From the first to the second.
    Whole([i64; 2]),
    Edges(&'a [f32]),
}

impl<'a> Scale<'a> {
    fn of(kind: &'a FeatureKind) -> Result<Self, String> {
        let got = match kind {
            FeatureKind::Integer(min, max) => return Ok(Self::Whole([*min, *max].map(i64::from))),
            FeatureKind::Continuous(edges) if !edges.is_empty() => return Ok(Self::Edges(edges)),
            FeatureKind::Continuous(_) => "a feature with a single bin",
            FeatureKind::Categorical(_) => "labels, which have no order",
            FeatureKind::Circular(..) => "angles, which go round",
        };
        Err(format!(
            "got a range of {got}: expected a value, a list of values, or bins"
        ))
    }

    /// Returns the bin that begins at an end; past the last one for an end that is above all.
    fn place(&self, end: End, draft: &ValueDraft) -> Result<u32, String> {
        match self {
            Self::Whole([min, max]) => place_among_whole([*min, *max], end, draft),
            Self::Edges(edges) => place_among_edges(edges, draft),
        }
    }
}

fn place_among_whole([min, max]: [i64; 2], end: End, draft: &ValueDraft) -> Result<u32, String> {
    let (least, most, step) = match end {
        End::From => (min, max, 0),
        End::To => (min, max, 1),
        End::Below => (min + 1, max + 1, 0),
    };
    let expected = || format!("expected a whole number from {least} to {most}");
    whole(draft, least, most)
        .map(|number| (number + step - min) as u32)
        .ok_or_else(|| format!("got {}, {}", written(draft), expected()))
}

/// A value inside a bin would cut it, and what was counted in a bin cannot be told apart.
fn place_among_edges(edges: &[f32], draft: &ValueDraft) -> Result<u32, String> {
    let number = number(draft).filter(|number| number.is_finite());
    let rounded = number.ok_or_else(|| format!("got {}, expected an edge", written(draft)))? as f32;
    let above = edges.partition_point(|edge| *edge < rounded);
    if edges.get(above).is_some_and(|edge| *edge == rounded) {
        return Ok(above as u32 + 1);
    }

    let near = &edges[above.saturating_sub(1)..edges.len().min(above + 1)];
    let near: Vec<String> = near.iter().map(ToString::to_string).collect();
    let (got, near) = (written(draft), near.join(" or "));
    Err(format!("got {got}, inside a bin: expected an edge, {near}"))
}

fn draft(kind: &FeatureKind, bins: &BinSet) -> ConditionDraft {
    match (kind, bins.runs()) {
        (FeatureKind::Circular(..), _) => by_number(bins),
        (FeatureKind::Categorical(labels), _) => one_or_more(bins, |bin| {
            ValueDraft::Text(labels[bin as usize].to_string())
        }),
        (FeatureKind::Integer(min, max), [run]) if run.len() > 1 => {
            let number = |bin: u32| ValueDraft::Number(f64::from(*min) + f64::from(bin));
            let last = max.abs_diff(*min);
            ConditionDraft::Between(RangeDraft {
                from: (run.start > 0).then(|| number(run.start)),
                to: None,
                below: (run.end <= last).then(|| number(run.end)),
            })
        }
        (FeatureKind::Integer(min, _), _) => one_or_more(bins, |bin| {
            ValueDraft::Number(f64::from(*min) + f64::from(bin))
        }),
        (FeatureKind::Continuous(edges), [run]) => {
            let edge = |at: u32| ValueDraft::Number(shortest(edges[at as usize]));
            ConditionDraft::Between(RangeDraft {
                from: run.start.checked_sub(1).map(edge),
                to: None,
                below: (run.end as usize <= edges.len()).then(|| edge(run.end - 1)),
            })
        }
        (FeatureKind::Continuous(_), _) => by_number(bins),
    }
}

fn by_number(bins: &BinSet) -> ConditionDraft {
    let number = |bin| ValueDraft::Number(f64::from(bin));
    ConditionDraft::Bins(bins.bins().map(number).collect())
}

fn one_or_more(bins: &BinSet, value: impl Fn(u32) -> ValueDraft) -> ConditionDraft {
    let mut values: Vec<ValueDraft> = bins.bins().map(value).collect();
    match values.len() {
        1 => ConditionDraft::One(values.remove(0)),
        _ => ConditionDraft::AnyOf(values),
    }
}
