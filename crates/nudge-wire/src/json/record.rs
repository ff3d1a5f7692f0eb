//! One transition from its text. Every fault is found, and none of them is more than the record's
//! own.

use std::collections::HashSet;

use nudge_core::domain::draft::ActionDraft;
use nudge_core::domain::{Entry, Record, Schema, SlotValues, Undecodable};
use nudge_core::error::{Fault, pointer};

use super::decode::not_finite;
use super::loose::{Loose, named_values};

/// Decodes one transition, or returns the place of its first fault and what is wrong with it,
/// briefly, because receipts are kept.
pub(super) fn record(schema: &Schema, text: &[u8]) -> Result<Record, Undecodable> {
    let fields = fields(text).map_err(joined)?;
    let track = track_of(fields.track.as_ref());
    let told = track.clone().ok().flatten();
    decoded(schema, fields, track)
        .map_err(|faults| Undecodable::from(joined(faults)).of_track(told))
}

fn fields(text: &[u8]) -> Result<Fields, Vec<Fault>> {
    let value = Loose::parse(text).map_err(|error| vec![not_json(text, &error)])?;
    let Loose::Object(members) = value else {
        return Err(vec![Fault::new(
            "",
            format!("got {value}, expected an object of state and actions"),
        )]);
    };

    let mut fields = Fields::default();
    members
        .into_iter()
        .for_each(|(name, value)| fields.take(name, value));
    Ok(fields)
}

fn decoded(
    schema: &Schema,
    fields: Fields,
    track: Result<Option<u64>, Vec<Fault>>,
) -> Result<Record, Vec<Fault>> {
    let Fields {
        state,
        actions,
        outcomes,
        entry,
        count,
        mut faults,
        ..
    } = fields;
    let state = keep(
        object("/state", state).and_then(|members| state_values(schema, members)),
        &mut faults,
    );
    let actions = keep(
        object("/actions", actions).and_then(|members| {
            slots("/actions", members, |written| schema.action_values(written))
        }),
        &mut faults,
    );
    let outcomes = keep(outcome_values(schema, outcomes), &mut faults);
    let entry = keep(entry_of(entry), &mut faults);
    let count = keep(count_of(count), &mut faults);
    let track = keep(track, &mut faults);

    match (state, actions, outcomes, entry, count, track) {
        (Some(state), Some(actions), Some(outcomes), Some(entry), Some(count), Some(track))
            if faults.is_empty() =>
        {
            Ok(Record {
                state,
                actions: actions.values,
                actions_present: actions.present,
                outcomes: outcomes.values,
                outcomes_present: outcomes.present,
                entry,
                count,
                track,
            })
        }
        _ => Err(faults),
    }
}

fn not_json(text: &[u8], error: &serde_json::Error) -> Fault {
    not_finite(text, error).unwrap_or_else(|| Fault::new("", format!("not JSON: {error}")))
}

/// The members of a transition, each at most once.
#[derive(Default)]
struct Fields {
    state: Option<Loose>,
    actions: Option<Loose>,
    outcomes: Option<Loose>,
    entry: Option<Loose>,
    count: Option<Loose>,
    track: Option<Loose>,
    faults: Vec<Fault>,
}

impl Fields {
    fn take(&mut self, name: String, value: Loose) {
        let field = match name.as_str() {
            "state" => &mut self.state,
            "actions" => &mut self.actions,
            "outcomes" => &mut self.outcomes,
            "entry" => &mut self.entry,
            "count" => &mut self.count,
            "track" => &mut self.track,
            _ => {
                let detail =
                    "unknown field, expected state, actions, outcomes, entry, count or track";
                return self.faults.push(Fault::new(pointer(&name), detail));
            }
        };
        if field.replace(value).is_some() {
            self.faults
                .push(Fault::new(pointer(&name), "given twice, expected once"));
        }
    }
}

/// Returns the value, or `None` after adding its faults to the rest.
fn keep<T>(checked: Result<T, Vec<Fault>>, faults: &mut Vec<Fault>) -> Option<T> {
    checked.map_err(|more| faults.extend(more)).ok()
}

fn object(at: &str, value: Option<Loose>) -> Result<Vec<(String, Loose)>, Vec<Fault>> {
    match value {
        Some(Loose::Object(members)) => Ok(members),
        Some(other) => Err(vec![Fault::new(
            at,
            format!("got {other}, expected an object"),
        )]),
        None => Err(vec![Fault::new(at, "missing, expected an object")]),
    }
}

fn state_values(schema: &Schema, members: Vec<(String, Loose)>) -> Result<Vec<f32>, Vec<Fault>> {
    schema
        .state_values(&named_values(members))
        .map_err(|faults| under("/state", faults))
}

/// What is not observed may be left out, all of it too.
fn outcome_values(schema: &Schema, value: Option<Loose>) -> Result<SlotValues, Vec<Fault>> {
    match value {
        None | Some(Loose::Null) => Ok(SlotValues::default()),
        some => {
            let members = object("/outcomes", some)?;
            slots("/outcomes", members, |written| {
                schema.outcome_values(written)
            })
        }
    }
}

/// Reads the actions of agents or the values of outcomes, each given once.
fn slots(
    at: &str,
    members: Vec<(String, Loose)>,
    read: impl Fn(&[(String, ActionDraft)]) -> Result<SlotValues, Vec<Fault>>,
) -> Result<SlotValues, Vec<Fault>> {
    let mut seen = HashSet::new();
    let doubled = members
        .iter()
        .filter(|(name, _)| !seen.insert(name.as_str()));
    let mut faults: Vec<Fault> = doubled
        .map(|(name, _)| Fault::new(pointer(name), "given twice, expected once"))
        .collect();
    let written: Vec<_> = members
        .into_iter()
        .map(|(name, value)| (name, value.into_action()))
        .collect();
    let values = keep(read(&written), &mut faults);

    values
        .filter(|_| faults.is_empty())
        .ok_or_else(|| under(at, faults))
}

fn under(prefix: &str, faults: Vec<Fault>) -> Vec<Fault> {
    faults
        .into_iter()
        .map(|fault| fault.under(prefix))
        .collect()
}

fn entry_of(value: Option<Loose>) -> Result<Entry, Vec<Fault>> {
    match value {
        None | Some(Loose::Null) => Ok(Entry::Unknown),
        Some(Loose::Bool(flag)) => Ok(Entry::from(Some(flag))),
        Some(other) => Err(vec![Fault::new(
            "/entry",
            format!("got {other}, expected true or false"),
        )]),
    }
}

fn count_of(value: Option<Loose>) -> Result<u64, Vec<Fault>> {
    Ok(whole_of("/count", value.as_ref(), 1)?.unwrap_or(1))
}

fn track_of(value: Option<&Loose>) -> Result<Option<u64>, Vec<Fault>> {
    whole_of("/track", value, 0)
}

fn whole_of(at: &str, value: Option<&Loose>, least: u64) -> Result<Option<u64>, Vec<Fault>> {
    /// Above it, f64 does not tell neighbouring whole numbers apart.
    const LARGEST_EXACT: f64 = 9_007_199_254_740_992.0;
    match value {
        None | Some(Loose::Null) => Ok(None),
        Some(Loose::Whole(number)) if *number >= least => Ok(Some(*number)),
        // JSON knows no integers: some writers say 2.0.
        Some(Loose::Number(number))
            if number.fract() == 0.0 && (least as f64..=LARGEST_EXACT).contains(number) =>
        {
            Ok(Some(*number as u64))
        }
        Some(other) => Err(vec![Fault::new(
            at,
            format!("got {other}, expected a whole number, at least {least}"),
        )]),
    }
}

/// Joins the faults of one record: the pointer of the first, and what is wrong.
fn joined(faults: Vec<Fault>) -> (String, String) {
    const TOLD: usize = 4;

    let pointer = faults.first().map(|first| brief(&first.pointer));
    let first = faults.first().map(|first| brief(&first.detail));
    let others = faults
        .iter()
        .take(TOLD)
        .skip(1)
        .map(|fault| brief(&fault.to_string()));
    let more = (faults.len() > TOLD).then(|| format!("and {} more", faults.len() - TOLD));

    let parts: Vec<String> = first.into_iter().chain(others).chain(more).collect();
    (pointer.unwrap_or_default(), parts.join("; "))
}

fn brief(text: &str) -> String {
    const LONGEST: usize = 200;
    text.chars().take(LONGEST).collect()
}
