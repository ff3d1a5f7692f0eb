//! Regions as they are written on a command line: `distance=1..2`, `player_1.held=onion,dish`, a
//! word a condition.

use crate::domain::draft::{ConditionDraft, RangeDraft, RegionDraft, ValueDraft};
use crate::error::{Fault, pointer};

const EXPECTED: &str = "expected FEATURE=VALUE, =VALUE,VALUE, =FIRST..LAST or =#BIN,#BIN, with \"...\" around a value that has such characters";

impl RegionDraft {
    /// Reads words, each a condition, or returns the faults of those that are none.
    ///
    /// A value is a label or a number; `1..2` goes from the first to the last, and an end may be
    /// left out; `#0` is a bin by its number. What stands between double quotes is a value as it
    /// is: labels may have commas.
    pub fn of_words<S: AsRef<str>>(words: &[S]) -> Result<Self, Vec<Fault>> {
        let (mut conditions, mut faults) = (Vec::with_capacity(words.len()), Vec::new());
        for word in words.iter().map(AsRef::as_ref) {
            match word.split_once('=') {
                None => faults.push(Fault::new("", wrong(word))),
                Some((name, values)) => match condition(values) {
                    Some(condition) => conditions.push((name.to_owned(), condition)),
                    None => faults.push(Fault::new(pointer(name), wrong(values))),
                },
            }
        }
        match faults.is_empty() {
            true => Ok(Self(conditions)),
            false => Err(faults),
        }
    }
}

fn wrong(got: &str) -> String {
    format!("got {got:?}, {EXPECTED}")
}

/// A part of a list.
enum Part<'a> {
    Quoted(&'a str),
    Plain(&'a str),
}

fn condition(text: &str) -> Option<ConditionDraft> {
    let parts = parts(text)?;
    if let [Part::Plain(only)] = parts.as_slice()
        && let Some((from, to)) = only.split_once("..")
    {
        return range(from, to);
    }

    let bins: Option<Vec<ValueDraft>> = parts.iter().map(bin).collect();
    if let Some(bins) = bins {
        return Some(ConditionDraft::Bins(bins));
    }
    let mut values: Vec<ValueDraft> = parts.iter().map(value).collect::<Option<_>>()?;
    Some(match values.len() {
        1 => ConditionDraft::One(values.remove(0)),
        _ => ConditionDraft::AnyOf(values),
    })
}

fn range(from: &str, to: &str) -> Option<ConditionDraft> {
    let end = |text: &str| (!text.is_empty()).then(|| ValueDraft::Text(text.to_owned()));
    let (from, to) = (end(from), end(to));
    (from.is_some() || to.is_some()).then_some(ConditionDraft::Between(RangeDraft {
        from,
        to,
        below: None,
    }))
}

fn bin(part: &Part<'_>) -> Option<ValueDraft> {
    match part {
        Part::Plain(text) => text
            .strip_prefix('#')
            .map(|bin| ValueDraft::Text(bin.to_owned())),
        Part::Quoted(_) => None,
    }
}

fn value(part: &Part<'_>) -> Option<ValueDraft> {
    match part {
        // Bins and values are not told apart in a list of both.
        Part::Plain(text) if text.starts_with('#') => None,
        Part::Plain(text) | Part::Quoted(text) => Some(ValueDraft::Text((*text).to_owned())),
    }
}

/// Returns what stands between commas that are not within quotes; `None` where a part is empty or
/// a quote does not end it.
fn parts(text: &str) -> Option<Vec<Part<'_>>> {
    let (mut parts, mut rest) = (Vec::new(), text);
    loop {
        let (part, behind) = match rest.strip_prefix('"') {
            Some(quoted) => {
                let (inside, behind) = quoted.split_once('"')?;
                (Part::Quoted(inside), behind)
            }
            None => {
                let end = rest.find(',').unwrap_or(rest.len());
                let (plain, behind) = rest.split_at(end);
                if plain.is_empty() {
                    return None;
                }
                (Part::Plain(plain), behind)
            }
        };
        parts.push(part);
        match behind.strip_prefix(',') {
            Some(next) => rest = next,
            None => return behind.is_empty().then_some(parts),
        }
    }
}
