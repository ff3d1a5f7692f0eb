//! Validation and discretisation, from decoded records to what they add: every value gets its bin,
//! and every record that has none is rejected.
//!
//! A pure function of the schema, so a batch that is sent again gets the same receipt.

use std::collections::HashMap;

use foldhash::fast::RandomState;

use crate::domain::{
    BinError, Entry, Increment, Label, Receipt, Records, Rejection, Schema, StateKey, Tally, Widths,
};

/// Validates records; returns the increment that they are under a segment, and the receipt.
pub fn validate(
    schema: &Schema,
    segment: Option<Label>,
    records: &Records,
) -> (Increment, Receipt) {
    let mut sum = Sum::new(schema, records.len);
    let mut receipt = Receipt::default();
    let mut undecodable = records.undecodable.iter().peekable();
    for index in 0..records.len {
        let known = undecodable
            .next_if(|rejection| rejection.index as usize == index)
            .cloned();
        match known.map_or_else(|| sum.add(records, index), Err) {
            Ok(()) => receipt.accepted += 1,
            Err(rejection) => reject(&mut receipt, rejection),
        }
    }
    (sum.into_increment(segment), receipt)
}

fn reject(receipt: &mut Receipt, rejection: Rejection) {
    receipt.rejected_count += 1;
    if receipt.rejected.len() < Receipt::MOST_TOLD {
        receipt.rejected.push(rejection);
    }
}

/// States that a batch has room for before it grows.
const USUAL_STATES: usize = 256;

/// The increment so far, with equal states merged.
struct Sum<'a> {
    schema: &'a Schema,
    widths: Widths,
    /// The bins of the record at hand.
    bins: Vec<u32>,
    states: HashMap<StateKey, u32, RandomState>,
    cells: Vec<(u32, u64, Tally)>,
    transitions: u64,
}

impl<'a> Sum<'a> {
    fn new(schema: &'a Schema, records: usize) -> Self {
        Self {
            schema,
            widths: Widths::of_schema(schema),
            bins: Vec::with_capacity(schema.state().len()),
            states: HashMap::with_capacity_and_hasher(
                records.min(USUAL_STATES),
                RandomState::default(),
            ),
            cells: Vec::with_capacity(records),
            transitions: 0,
        }
    }

    fn add(&mut self, records: &Records, index: usize) -> Result<(), Rejection> {
        let state = &records.states[index * self.widths.state..][..self.widths.state];
        let actions = &records.actions[index * self.widths.actions..][..self.widths.actions];
        let n = records.counts.get(index).copied().unwrap_or(1);
        let (Some(()), Some(joint), Some(sum)) = (
            self.discretise(state),
            self.schema.joint_action(actions),
            self.sum_with(n),
        ) else {
            return Err(self.rejection(index, state, actions, n));
        };

        let entries = match records.entries.get(index).copied().unwrap_or_default() {
            Entry::Unknown => None,
            Entry::Stayed => Some(0),
            Entry::Entered => Some(n),
        };

        self.transitions = sum;
        let state = self.state_position();
        self.cells.push((state, joint, Tally { n, entries }));
        Ok(())
    }

    fn discretise(&mut self, values: &[f32]) -> Option<()> {
        self.bins.clear();
        for (feature, value) in self.schema.state().iter().zip(values) {
            self.bins.push(feature.kind.bin(*value).ok()?);
        }
        Some(())
    }

    /// Returns the transitions with `n` more, if `n` is a count and the sum still is one.
    fn sum_with(&self, n: u64) -> Option<u64> {
        self.transitions
            .checked_add(n)
            .filter(|sum| n > 0 && i64::try_from(*sum).is_ok())
    }

    fn state_position(&mut self) -> u32 {
        if let Some(known) = self.states.get(self.bins.as_slice()) {
            return *known;
        }
        let next = self.states.len() as u32;
        self.states.insert(StateKey::new(&self.bins), next);
        next
    }

    /// Tells everything that is wrong with a record: the first fault's field, and all faults in the
    /// reason.
    #[cold]
    fn rejection(&self, index: usize, state: &[f32], actions: &[f32], n: u64) -> Rejection {
        let bin_error = |pointer: String| move |error: BinError<'_>| (pointer, error.to_string());
        let state = self
            .schema
            .state()
            .iter()
            .zip(state)
            .filter_map(|(feature, value)| {
                feature
                    .kind
                    .bin(*value)
                    .err()
                    .map(bin_error(format!("/state/{}", feature.name)))
            });
        let actions =
            self.schema
                .action_features()
                .zip(actions)
                .filter_map(|((agent, feature), value)| {
                    feature.kind.bin(*value).err().map(bin_error(format!(
                        "/actions/{}/{}",
                        agent.name, feature.name
                    )))
                });

        let mut faults: Vec<(String, String)> = state.chain(actions).collect();

        if self.sum_with(n).is_none() {
            let reason = format!(
                "got {n}, expected 1 to 2^63 - 1, together with the counts of the batch before it"
            );
            faults.push(("/count".into(), reason));
        }

        let mut faults = faults.into_iter();
        let (field, first) = faults
            .next()
            .expect("a record is only rejected for a fault");
        let reason = faults.fold(first, |told, (field, reason)| {
            format!("{told}; {field}: {reason}")
        });
        Rejection {
            index: index as u32,
            field,
            reason,
        }
    }

    fn into_increment(self, segment: Option<Label>) -> Increment {
        let mut states = vec![None; self.states.len()];
        for (key, position) in self.states {
            states[position as usize] = Some(key);
        }

        let states = states
            .into_iter()
            .map(|key| key.expect("positions are dense"))
            .collect();
        Increment {
            segment,
            states,
            cells: self.cells,
            transitions: self.transitions,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Record;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft, SchemaDraft};

    fn schema() -> Schema {
        let feature = |name: &str, kind| FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![kind],
        };
        let labels = |labels: &[&str]| {
            KindDraft::Categorical(labels.iter().map(ToString::to_string).collect())
        };
        let agent = |name: &str, action| AgentDraft {
            name: name.into(),
            action: vec![action],
        };
        let draft = SchemaDraft {
            state: vec![
                feature("x", KindDraft::Continuous(vec![0.5, 1.0])),
                feature("lane", KindDraft::Integer(0, 3)),
            ],
            agents: vec![
                agent("a", feature("go", labels(&["l", "r"]))),
                agent("b", feature("go", labels(&["l", "r", "s"]))),
            ],
        };
        Schema::try_from(&draft).expect("valid")
    }

    fn record(
        state: &[f32],
        actions: &[f32],
        entry: Entry,
        count: u64,
    ) -> Result<Record, (String, String)> {
        Ok(Record {
            state: state.into(),
            actions: actions.into(),
            entry,
            count,
        })
    }

    fn run(records: Vec<Result<Record, (String, String)>>) -> (Increment, Receipt) {
        let schema = schema();
        validate(
            &schema,
            None,
            &Records::collect(Widths::of_schema(&schema), records.into_iter()),
        )
    }

    #[test]
    fn equal_states_are_one() {
        let (increment, receipt) = run(vec![
            record(&[0.7, 1.0], &[1.0, 2.0], Entry::Entered, 1),
            record(&[0.6, 1.0], &[1.0, 2.0], Entry::Stayed, 4),
            record(&[0.6, 1.0], &[0.0, 0.0], Entry::Unknown, 2),
        ]);
        assert_eq!(
            increment
                .states
                .iter()
                .map(ToString::to_string)
                .collect::<Vec<_>>(),
            ["1.1"]
        );
        let tally = |n, entries| Tally { n, entries };
        assert_eq!(
            increment.cells,
            [
                (0, 5, tally(1, Some(1))),
                (0, 5, tally(4, Some(0))),
                (0, 0, tally(2, None))
            ]
        );
        assert_eq!(
            (
                increment.transitions,
                receipt.accepted,
                receipt.rejected_count
            ),
            (7, 3, 0)
        );
    }

    #[test]
    fn a_bad_record_is_rejected_with_all_its_faults_and_the_rest_is_counted() {
        let (increment, receipt) = run(vec![
            record(&[f32::NAN, 1.5], &[0.0, 3.0], Entry::Unknown, 0),
            record(&[0.0, 0.0], &[0.0, 0.0], Entry::Unknown, 1),
            Err(("/state/y".into(), "unknown feature".into())),
            record(&[0.0], &[0.0, 0.0], Entry::Unknown, 1),
        ]);
        assert_eq!(
            (
                increment.transitions,
                receipt.accepted,
                receipt.rejected_count
            ),
            (1, 1, 3)
        );
        let told: Vec<(u32, &str)> = receipt
            .rejected
            .iter()
            .map(|r| (r.index, r.field.as_str()))
            .collect();
        assert_eq!(told, [(0, "/state/x"), (2, "/state/y"), (3, "/state")]);
        let reason = &receipt.rejected[0].reason;
        for part in [
            "got NaN",
            "/state/lane: got 1.5",
            "/actions/b/go: got 3",
            "/count: got 0",
        ] {
            assert!(reason.contains(part), "{part} in {reason}");
        }
    }

    #[test]
    fn counts_never_pass_the_largest_sum() {
        let most = i64::MAX as u64;
        let one = |count| record(&[0.0, 0.0], &[0.0, 0.0], Entry::Unknown, count);
        let (increment, receipt) = run(vec![one(most), one(1), one(u64::MAX)]);
        assert_eq!((increment.transitions, receipt.rejected_count), (most, 2));
    }

    #[test]
    fn only_the_first_hundred_rejections_are_told() {
        let bad = || record(&[f32::INFINITY, 0.0], &[0.0, 0.0], Entry::Unknown, 1);
        let (increment, receipt) = run((0..150).map(|_| bad()).collect());
        assert_eq!(
            (receipt.rejected_count, receipt.rejected.len()),
            (150, Receipt::MOST_TOLD)
        );
        assert_eq!(increment, Increment::default());
    }
}
