//! Regions: partial descriptions of states.

use nudge_core::domain::draft::{ConditionDraft, RangeDraft, RegionDraft, ValueDraft};

use crate::proto;
use crate::proto::condition::Bins;
use crate::proto::condition_value::Kind;

impl From<proto::Region> for RegionDraft {
    fn from(region: proto::Region) -> Self {
        let condition = |condition: proto::Condition| {
            let bins = condition.bins.map(Into::into);
            // What is not said is an empty list, which is refused.
            let bins = bins.unwrap_or_else(|| ConditionDraft::AnyOf(Vec::new()));
            (condition.feature, bins)
        };
        Self(region.conditions.into_iter().map(condition).collect())
    }
}

impl From<Bins> for ConditionDraft {
    fn from(bins: Bins) -> Self {
        match bins {
            Bins::Values(values) => {
                let mut values: Vec<ValueDraft> =
                    values.values.into_iter().map(Into::into).collect();
                match values.len() {
                    1 => Self::One(values.remove(0)),
                    _ => Self::AnyOf(values),
                }
            }
            Bins::Range(proto::ValueRange { from, to, below }) => {
                let [from, to, below] = [from, to, below].map(|end| end.map(ValueDraft::Number));
                Self::Between(RangeDraft { from, to, below })
            }
            Bins::Numbers(bins) => {
                let numbers = bins.numbers.into_iter().map(f64::from);
                Self::Bins(numbers.map(ValueDraft::Number).collect())
            }
        }
    }
}

impl From<proto::ConditionValue> for ValueDraft {
    fn from(value: proto::ConditionValue) -> Self {
        match value.kind {
            Some(Kind::Number(number)) => Self::Number(number),
            Some(Kind::Text(text)) => Self::Text(text),
            None => Self::Other("nothing".into()),
        }
    }
}

impl From<RegionDraft> for proto::Region {
    fn from(draft: RegionDraft) -> Self {
        let condition = |(feature, draft): (String, ConditionDraft)| proto::Condition {
            feature,
            bins: Some(draft.into()),
        };
        Self {
            conditions: draft.0.into_iter().map(condition).collect(),
        }
    }
}

impl From<ConditionDraft> for Bins {
    /// Takes ends of ranges and numbers of bins that are numbers, as those of a
    /// [`Region`](nudge_core::domain::Region) are.
    fn from(draft: ConditionDraft) -> Self {
        let values = |values: Vec<ValueDraft>| {
            let values = values.into_iter().map(Into::into).collect();
            Self::Values(proto::ConditionValues { values })
        };
        match draft {
            ConditionDraft::One(value) => values(vec![value]),
            ConditionDraft::AnyOf(several) => values(several),
            ConditionDraft::Between(RangeDraft { from, to, below }) => {
                let [from, to, below] = [from, to, below].map(|end| Some(number(&end?)));
                Self::Range(proto::ValueRange { from, to, below })
            }
            ConditionDraft::Bins(bins) => {
                let numbers = bins.iter().map(|bin| whole(number(bin)));
                Self::Numbers(proto::BinNumbers {
                    numbers: numbers.collect(),
                })
            }
        }
    }
}

impl From<ValueDraft> for proto::ConditionValue {
    fn from(draft: ValueDraft) -> Self {
        let kind = match draft {
            ValueDraft::Number(number) => Kind::Number(number),
            ValueDraft::Truth(truth) => Kind::Text(truth.to_string()),
            ValueDraft::Text(text) | ValueDraft::Digits(text) | ValueDraft::Other(text) => {
                Kind::Text(text)
            }
        };
        Self { kind: Some(kind) }
    }
}

/// Returns a number, however it is written; what is none is not a number, which a service refuses.
fn number(draft: &ValueDraft) -> f64 {
    match draft {
        ValueDraft::Number(number) => *number,
        ValueDraft::Text(text) | ValueDraft::Digits(text) => text.parse().unwrap_or(f64::NAN),
        ValueDraft::Truth(_) | ValueDraft::Other(_) => f64::NAN,
    }
}

/// Returns the number of a bin; what is none is beyond all bins, which a service refuses.
fn whole(number: f64) -> u32 {
    let whole = number as u32;
    if f64::from(whole) == number {
        whole
    } else {
        u32::MAX
    }
}
