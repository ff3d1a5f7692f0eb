//! Validation and discretisation, from decoded records to what they add: every value gets its bin,
//! and every record that has none is rejected.
//!
//! Which records are rejected goes by the schema alone, so a batch that is sent again gets the same
//! receipt. Only entries that the sender leaves to the service go by what came before.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use foldhash::fast::RandomState;

use super::tracks::{Step, Tracks};
use crate::domain::{
    Agent, Entry, Feature, Increment, Label, Numbers, Outcome, Receipt, Records, Rejection, Schema,
    SlotNumber, SlotNumbers, StateKey, States, Tally, Values, Widths,
};

/// Validates records; returns the increment that they are under a segment, and the receipt. Their
/// tracks are those of what was validated before, and go on with these records.
pub fn validate(
    schema: &Schema,
    segment: Option<Label>,
    records: &Records,
    tracks: &mut Tracks,
) -> (Increment, Receipt) {
    let mut sum = Sum::new(schema, records, tracks);
    let mut receipt = Receipt::default();
    let mut undecodable = records.undecodable.iter().peekable();
    for first in (0..records.len).step_by(Numbers::LANES) {
        let block = sum.block(first);
        for index in first..records.len.min(first + Numbers::LANES) {
            let known = undecodable
                .next_if(|rejection| rejection.index as usize == index)
                .cloned();
            match known.map_or_else(|| sum.add(&block, index), Err) {
                Ok(()) => receipt.accepted += 1,
                Err(rejection) => {
                    sum.pass_over(index);
                    reject(&mut receipt, rejection);
                }
            }
        }
        sum.add_outcomes(&block);
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

/// The increment so far.
struct Sum<'a> {
    schema: &'a Schema,
    widths: Widths,
    records: &'a Records,
    tracks: &'a mut Tracks,
    /// The states so far, where states are listed; `None` where they are ranked.
    listed: Option<Listed>,
    cells: Vec<(u64, u64, Tally)>,
    /// The cell of each outcome's family beside each of these; no columns where nothing was observed.
    outcomes: Vec<Vec<u64>>,
    /// The records of the block at hand that are counted, by their lanes.
    counted: Vec<usize>,
    transitions: u64,
}

/// What is discretised of some records at once: ranks of their states, where they have some, joint
/// actions, and outcomes.
struct Block {
    first: usize,
    ranks: Option<Numbers>,
    joints: Numbers,
    outcomes: SlotNumbers,
    /// Which records have an outcome without a bin.
    misfits: [bool; Numbers::LANES],
}

impl<'a> Sum<'a> {
    fn new(schema: &'a Schema, records: &'a Records, tracks: &'a mut Tracks) -> Self {
        let listed = || Listed::with_room_for(records.len.min(USUAL_STATES));
        let column = |_| Vec::with_capacity(records.len);
        Self {
            schema,
            widths: Widths::of_schema(schema),
            records,
            tracks,
            listed: (!schema.is_ranked()).then(listed),
            cells: Vec::with_capacity(records.len),
            outcomes: (0..records.observed(schema)).map(column).collect(),
            counted: Vec::with_capacity(Numbers::LANES),
            transitions: 0,
        }
    }

    fn block(&self, first: usize) -> Block {
        let (schema, records) = (self.schema, self.records);
        let is_ranked = self.listed.is_none();
        let outcomes = schema.outcomes_at(&records.outcomes, &records.outcomes_present, first);
        Block {
            first,
            ranks: is_ranked.then(|| schema.ranks_at(&records.states, first)),
            joints: schema.joint_actions_at(&records.actions, &records.actions_present, first),
            misfits: outcomes.misfits(),
            outcomes,
        }
    }

    fn add(&mut self, block: &Block, index: usize) -> Result<(), Rejection> {
        let lane = index - block.first;
        let n = self.records.counts.get(index).copied().unwrap_or(1);
        let (Some(joint), Some(sum)) = (block.joints.get(lane), self.sum_with(n)) else {
            return Err(self.rejection(index, n));
        };
        if self.is_no_step(index, n) || block.misfits[lane] {
            return Err(self.rejection(index, n));
        }
        // Last, for a state is listed only where something of it is counted.
        let Some(state) = self.state(block, index) else {
            return Err(self.rejection(index, n));
        };

        let entries = match self.entry(block, index, state, joint) {
            Entry::Unknown => None,
            Entry::Stayed => Some(0),
            Entry::Entered => Some(n),
        };

        self.transitions = sum;
        let tally = Tally { n, entries };
        self.cells.push((state, joint, tally));
        self.counted.push(lane);
        Ok(())
    }

    /// Adds the cells of outcomes' families of those records of a block that are counted: family
    /// after family, as their cells are found.
    fn add_outcomes(&mut self, block: &Block) {
        if !self.outcomes.is_empty() {
            let found = self.schema.outcome_cells(&block.joints, &block.outcomes);
            for (cells, found) in self.outcomes.iter_mut().zip(&found) {
                let lanes = self.counted.iter();
                cells.extend(lanes.map(|lane| found.get_or_missing(*lane)));
            }
        }
        self.counted.clear();
    }

    /// Returns the number of a record's state: its rank, or its position among those listed.
    fn state(&mut self, block: &Block, index: usize) -> Option<u64> {
        match &block.ranks {
            Some(ranks) => ranks.get(index - block.first),
            None => {
                let values = values_of(&self.records.states, self.widths.state, index);
                self.listed.as_mut()?.position(self.schema, values)
            }
        }
    }

    /// Returns whether a record is an entry: what its sender says, or what its track does.
    fn entry(&mut self, block: &Block, index: usize, state: u64, joint: u64) -> Entry {
        let sent = self.sent(index);
        let Some(track) = self.track(index) else {
            return sent;
        };

        // A position among those listed means something else in the next batch.
        let state = self.listed.as_ref().map_or(state, Listed::hash);
        let step = Step {
            track,
            state,
            joint,
            sent,
        };

        let outcomes = self.schema.outcomes();
        let is_observed_later = |agent| {
            (0..self.outcomes.len()).any(|at| {
                let is_its = outcomes[at].agent == Some(agent);
                is_its && block.outcomes.get(index - block.first, at) != SlotNumber::Missing
            })
        };
        self.tracks.entry(self.schema, &step, is_observed_later)
    }

    /// Tells a record's track that it is not counted.
    fn pass_over(&mut self, index: usize) {
        if let Some(track) = self.track(index) {
            self.tracks.gap(track);
        }
    }

    fn sent(&self, index: usize) -> Entry {
        self.records.entries.get(index).copied().unwrap_or_default()
    }

    fn track(&self, index: usize) -> Option<u64> {
        self.records.tracks.get(index).copied().flatten()
    }

    /// Returns whether a record that was observed so often is to be judged as one step of its track.
    fn is_no_step(&self, index: usize, n: u64) -> bool {
        n != 1 && self.track(index).is_some() && self.sent(index) == Entry::Unknown
    }

    /// Returns the transitions with `n` more, if `n` is a count and the sum still is one.
    fn sum_with(&self, n: u64) -> Option<u64> {
        self.transitions
            .checked_add(n)
            .filter(|sum| n > 0 && i64::try_from(*sum).is_ok())
    }

    /// Tells everything that is wrong with a record: the first fault's field, and all faults in the
    /// reason.
    #[cold]
    fn rejection(&self, index: usize, n: u64) -> Rejection {
        let mut faults = self.misfits_of_state(index);
        faults.extend(self.misfits_of_actions(index));
        faults.extend(self.misfits_of_outcomes(index));

        if self.sum_with(n).is_none() {
            let reason = format!(
                "got {n}, expected 1 to 2^63 - 1, together with the counts of the batch before it"
            );
            faults.push(("/count".into(), reason));
        } else if self.is_no_step(index, n) {
            let reason =
                format!("got {n}, expected 1: it has a track and no entry flag, so it is one step");
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

    fn misfits_of_state(&self, index: usize) -> Vec<(String, String)> {
        let values = values_of(&self.records.states, self.widths.state, index);
        let features = self.schema.state().iter().zip(values);
        features
            .filter_map(|(feature, value)| misfit("/state", feature, value))
            .collect()
    }

    fn misfits_of_actions(&self, index: usize) -> Vec<(String, String)> {
        let present = &self.records.actions_present;
        let agents = self.schema.agents();
        let has = |at: usize| present.has(index * agents.len() + at);
        let absent = |(at, agent): (usize, &Agent)| {
            let is_missed = !has(at) && !agent.may_be_absent;
            is_missed.then(|| {
                let expected = "absent, expected an action: this agent may not be absent";
                (format!("/actions/{}", agent.name), expected.to_owned())
            })
        };
        let mut faults: Vec<_> = agents.iter().enumerate().filter_map(absent).collect();

        let slots = agents
            .iter()
            .map(|agent| (format!("/actions/{}", agent.name), &*agent.action));
        let values = values_of(&self.records.actions, self.widths.actions, index);
        faults.extend(misfits_of_slots(slots, values, has));
        faults
    }

    fn misfits_of_outcomes(&self, index: usize) -> Vec<(String, String)> {
        if self.outcomes.is_empty() {
            return Vec::new();
        }
        let present = &self.records.outcomes_present;
        let outcomes = self.schema.outcomes();
        let slot = |outcome: &'a Outcome| (format!("/outcomes/{}", outcome.name), &*outcome.value);
        let slots = outcomes.iter().map(slot);
        let width = self.widths.outcome_values();
        let values = values_of(&self.records.outcomes, width, index);
        misfits_of_slots(slots, values, |at| present.has(index * outcomes.len() + at))
    }

    fn into_increment(self, segment: Option<Label>) -> Increment {
        Increment {
            segment,
            states: self.listed.map_or(States::Ranked, Listed::into_states),
            cells: self.cells,
            outcomes: self.outcomes,
            transitions: self.transitions,
        }
    }
}

/// Returns what is wrong with the values of slots that have some.
fn misfits_of_slots<'s>(
    slots: impl Iterator<Item = (String, &'s [Feature])>,
    mut values: impl Iterator<Item = f32>,
    has: impl Fn(usize) -> bool,
) -> Vec<(String, String)> {
    let mut faults = Vec::new();
    for (at, (pointer, features)) in slots.enumerate() {
        let values = features.iter().zip(values.by_ref());
        let misfits = values.filter_map(|(feature, value)| misfit(&pointer, feature, value));
        let misfits: Vec<_> = misfits.collect();
        if has(at) {
            faults.extend(misfits);
        }
    }
    faults
}

fn misfit(pointer: &str, feature: &Feature, value: f32) -> Option<(String, String)> {
    let error = feature.kind.bin(value).err()?;
    Some((format!("{pointer}/{}", feature.name), error.to_string()))
}

/// Returns the values of a record.
fn values_of(values: &Values, width: usize, index: usize) -> impl Iterator<Item = f32> {
    values.at(index * width, width)
}

/// The states of a batch that have no ranks, each once, by their positions.
struct Listed {
    positions: HashMap<StateKey, u64, RandomState>,
    /// The bins of the record at hand.
    bins: Vec<u32>,
}

impl Listed {
    fn with_room_for(states: usize) -> Self {
        Self {
            positions: HashMap::with_capacity_and_hasher(states, RandomState::default()),
            bins: Vec::new(),
        }
    }

    /// Returns the position of a state, which is listed where it is new; `None` where a value has
    /// no bin.
    fn position(&mut self, schema: &Schema, values: impl Iterator<Item = f32>) -> Option<u64> {
        self.bins.clear();
        for (feature, value) in schema.state().iter().zip(values) {
            self.bins.push(feature.kind.bin(value).ok()?);
        }

        if let Some(known) = self.positions.get(self.bins.as_slice()) {
            return Some(*known);
        }
        let next = self.positions.len() as u64;
        self.positions.insert(StateKey::new(&self.bins), next);
        Some(next)
    }

    /// Returns what tells the state of the record at hand from others in any batch, but for one pair
    /// in 2^64.
    fn hash(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.bins.hash(&mut hasher);
        hasher.finish()
    }

    fn into_states(self) -> States {
        let mut states: Vec<(StateKey, u64)> = self.positions.into_iter().collect();
        states.sort_unstable_by_key(|(_, position)| *position);
        States::Listed(states.into_iter().map(|(key, _)| key).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft, SchemaDraft};
    use crate::domain::{Record, Undecodable};

    fn schema() -> Schema {
        schema_with(&[])
    }

    /// Returns the same with so many states that they are listed.
    fn wide() -> Schema {
        schema_with(&["x0", "x1", "x2"])
    }

    fn schema_with(wide: &[&str]) -> Schema {
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
            ..AgentDraft::default()
        };
        let draft = SchemaDraft {
            state: [
                feature("x", KindDraft::Continuous(vec![0.5, 1.0])),
                feature("lane", KindDraft::Integer(0, 3)),
            ]
            .into_iter()
            .chain(
                wide.iter()
                    .map(|name| feature(name, KindDraft::Integer(0, 65_535))),
            )
            .collect(),
            agents: vec![
                agent("a", feature("go", labels(&["l", "r"]))),
                agent("b", feature("go", labels(&["l", "r", "s"]))),
            ],
            ..SchemaDraft::default()
        };
        Schema::try_from(&draft).expect("valid")
    }

    fn record(
        state: &[f32],
        actions: &[f32],
        entry: Entry,
        count: u64,
    ) -> Result<Record, Undecodable> {
        Ok(Record {
            entry,
            count,
            ..Record::new(state.into(), actions.into())
        })
    }

    fn run(records: Vec<Result<Record, Undecodable>>) -> (Increment, Receipt) {
        let schema = schema();
        validate(
            &schema,
            None,
            &Records::collect(Widths::of_schema(&schema), records.into_iter()),
            &mut Tracks::default(),
        )
    }

    #[test]
    fn equal_states_have_one_rank() {
        let (increment, receipt) = run(vec![
            record(&[0.7, 1.0], &[1.0, 2.0], Entry::Entered, 1),
            record(&[0.6, 1.0], &[1.0, 2.0], Entry::Stayed, 4),
            record(&[0.6, 1.0], &[0.0, 0.0], Entry::Unknown, 2),
        ]);
        assert_eq!(increment.states, States::Ranked);
        let tally = |n, entries| Tally { n, entries };
        assert_eq!(
            increment.cells,
            [
                (5, 5, tally(1, Some(1))),
                (5, 5, tally(4, Some(0))),
                (5, 0, tally(2, None))
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
            Err(("/state/y".to_owned(), "unknown feature".to_owned()).into()),
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
    fn states_without_ranks_are_listed_once_where_something_of_them_is_counted() {
        let state = |x, last| [x, 1.0, 0.0, 65_535.0, last];
        let bad = record(&state(0.0, 5.0), &[0.0, 3.0], Entry::Unknown, 1);
        let zero = record(&state(0.0, 6.0), &[0.0, 0.0], Entry::Unknown, 0);
        let good = |x, last| record(&state(x, last), &[1.0, 2.0], Entry::Entered, 2);
        let records = vec![bad, good(0.7, 3.0), zero, good(0.0, 4.0), good(0.6, 3.0)];

        let schema = wide();
        let widths = Widths::of_schema(&schema);
        let records = Records::collect(widths, records.into_iter());
        let (increment, receipt) = validate(&schema, None, &records, &mut Tracks::default());

        let listed = increment.states.listed().iter().map(ToString::to_string);
        assert_eq!(
            listed.collect::<Vec<_>>(),
            ["1.1.0.65535.3", "0.1.0.65535.4"]
        );
        let entered = Tally {
            n: 2,
            entries: Some(2),
        };
        assert_eq!(increment.cells, [0, 1, 0].map(|state| (state, 5, entered)));
        let rejected: Vec<u32> = receipt.rejected.iter().map(|one| one.index).collect();
        assert_eq!((rejected, increment.transitions), (vec![0, 2], 6));
    }

    #[test]
    fn ranks_and_lists_name_the_same_states() {
        // More than are discretised at once, and not a multiple of it.
        let values = |i: u32| [(i % 7) as f32 / 4.0, (i % 5) as f32];
        let actions = |i: u32| [(i % 2) as f32, (i % 4) as f32];
        let of = |schema: &Schema, more: &[f32]| {
            let one = |i: u32| {
                record(
                    &[&values(i)[..], more].concat(),
                    &actions(i),
                    Entry::Stayed,
                    1,
                )
            };
            let records: Vec<_> = (0..300).map(one).collect();
            let records = Records::collect(Widths::of_schema(schema), records.into_iter());
            validate(schema, None, &records, &mut Tracks::default())
        };
        let (ranked, listed) = (of(&schema(), &[]), of(&wide(), &[0.0; 3]));

        assert_eq!(ranked.1, listed.1);
        assert!(ranked.1.accepted > 100 && ranked.1.rejected_count > 100);
        let rank = |key: &StateKey| u64::from(key.bins()[0] * 4 + key.bins()[1]);
        let ranks: Vec<u64> = listed.0.states.listed().iter().map(rank).collect();
        let named = listed
            .0
            .cells
            .iter()
            .map(|(at, joint, tally)| (ranks[*at as usize], *joint, *tally));
        assert_eq!(ranked.0.cells, named.collect::<Vec<_>>());
    }

    /// A step of track 7, whose sender does not say whether it is an entry.
    fn step(state: Vec<f32>, actions: [f32; 2]) -> Result<Record, Undecodable> {
        Ok(Record {
            track: Some(7),
            ..Record::new(state, actions.into())
        })
    }

    /// Validates steps that are cut into batches; returns the entries of each that is counted.
    fn entries(schema: &Schema, batches: Vec<Vec<Result<Record, Undecodable>>>) -> Vec<u64> {
        let mut tracks = Tracks::default();
        let mut validated = |records: Vec<_>| {
            let records = Records::collect(Widths::of_schema(schema), records.into_iter());
            let (increment, _) = validate(schema, None, &records, &mut tracks);
            let told = |cell: &(u64, u64, Tally)| cell.2.entries.expect("the service says it");
            increment.cells.iter().map(told).collect::<Vec<_>>()
        };
        batches.into_iter().flat_map(&mut validated).collect()
    }

    #[test]
    fn tracks_go_on_from_batch_to_batch_and_know_states_with_and_without_ranks() {
        for (schema, more) in [(schema(), vec![]), (wide(), vec![0.0, 9.0, 65_535.0])] {
            let at = |x: f32, actions| step([&[x, 1.0], &more[..]].concat(), actions);
            let steps = vec![
                at(0.7, [0.0, 0.0]),
                at(0.6, [1.0, 1.0]),
                at(0.0, [1.0, 1.0]),
                at(0.7, [1.0, 1.0]),
                at(0.0, [1.0, 1.0]),
                at(0.7, [0.0, 1.0]),
                at(2.0, [0.0, 2.0]),
                at(0.0, [0.0, 2.0]),
            ];
            let expected = [1, 0, 1, 1, 0, 0, 1, 1];
            assert_eq!(entries(&schema, vec![steps.clone()]), expected);
            let cut = steps.into_iter().map(|step| vec![step]).collect();
            assert_eq!(entries(&schema, cut), expected);
        }
    }

    #[test]
    fn a_step_that_is_rejected_is_a_gap_in_its_track_however_it_is_rejected() {
        let good = |actions| step(vec![0.7, 1.0], actions);
        let undecodable = |track| {
            let fault = ("/state/x".to_owned(), "unknown feature".to_owned());
            Err(Undecodable::from(fault).of_track(track))
        };
        let misfit = step(vec![f32::NAN, 1.0], [1.0, 1.0]);
        let narrow = step(vec![], [1.0, 1.0]);
        let many = step(vec![0.7, 1.0], [1.0, 1.0]).map(|one| Record { count: 2, ..one });
        let other = misfit.clone().map(|one| Record {
            track: Some(8),
            ..one
        });
        for (bad, expected) in [
            (misfit, 1),
            (narrow, 1),
            (many, 1),
            (undecodable(Some(7)), 1),
            (other, 0),
            (undecodable(None), 0),
        ] {
            // Both have changed their action, so that where it is entered it counts.
            let steps = vec![good([0.0, 0.0]), bad, good([1.0, 1.0])];
            assert_eq!(entries(&schema(), vec![steps]), [1, expected]);
        }
    }

    #[test]
    fn a_step_without_a_flag_is_one_step() {
        let of = |track, entry, count| {
            Ok(Record {
                track,
                entry,
                count,
                ..Record::new(vec![0.7, 1.0], vec![0.0, 0.0])
            })
        };
        let (increment, receipt) = run(vec![
            of(Some(7), Entry::Unknown, 3),
            of(Some(7), Entry::Unknown, 0),
            of(None, Entry::Unknown, 3),
            of(Some(7), Entry::Entered, 3),
            of(Some(7), Entry::Unknown, 1),
        ]);
        let told: Vec<(u32, &str)> = receipt
            .rejected
            .iter()
            .map(|one| (one.index, one.field.as_str()))
            .collect();
        assert_eq!(told, [(0, "/count"), (1, "/count")]);
        assert!(receipt.rejected[0].reason.starts_with("got 3, expected 1:"));
        let entries: Vec<Option<u64>> = increment.cells.iter().map(|cell| cell.2.entries).collect();
        assert_eq!(entries, [None, Some(3), Some(0)]);
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
