//! A batch as it was decoded: columns of values, the same whichever face it came through.
//!
//! Nothing here has been compared with bins yet. Rows and JSON become columns too, so there is one
//! thing to digest and one thing to validate.

use std::sync::Arc;

use super::{Label, Presence, Values};

/// Whether a step entered its state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum Entry {
    /// The sender does not say.
    #[default]
    Unknown = 0,
    /// A stay goes on.
    Stayed = 1,
    /// This step entered the state.
    Entered = 2,
}

impl From<Option<bool>> for Entry {
    fn from(flag: Option<bool>) -> Self {
        match flag {
            None => Self::Unknown,
            Some(false) => Self::Stayed,
            Some(true) => Self::Entered,
        }
    }
}

/// A record that was not counted, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejection {
    /// Its position in the batch, from 0.
    pub index: u32,
    /// The field at fault as a JSON pointer into the record, `/state/distance`.
    pub field: String,
    /// The value that was found and what was expected.
    pub reason: String,
}

/// The content of one batch, decoded and not yet validated.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Records {
    /// How many records there are.
    pub len: usize,
    /// State values, record after record, one a state feature.
    pub states: Values,
    /// Action values, record after record, one an action feature.
    pub actions: Values,
    /// Which agents acted: a slot an agent, record after record. The values of one that did not are
    /// zeros.
    pub actions_present: Presence,
    /// Outcome values, record after record, one a feature of an outcome; empty where none was
    /// observed.
    pub outcomes: Values,
    /// Which outcomes were observed, where any was: a slot an outcome, record after record. The
    /// values of one that was not are zeros.
    pub outcomes_present: Presence,
    /// One a record, or empty where none says.
    pub entries: Vec<Entry>,
    /// How often each record was observed, or empty for once each.
    pub counts: Vec<u64>,
    /// The track that each record is a step of, if it is told; empty where none is.
    pub tracks: Vec<Option<u64>>,
    /// The records that could not be decoded, by index; their values above are zeros.
    pub undecodable: Vec<Rejection>,
}

/// One record of a batch, as rows and JSON give it.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// One value a state feature.
    pub state: Vec<f32>,
    /// One value an action feature; those of an agent that did not act are not looked at.
    pub actions: Vec<f32>,
    /// Which agents acted, a flag each; empty where all did.
    pub actions_present: Vec<bool>,
    /// One value a feature of an outcome; those of one that was not observed are not looked at.
    /// Empty where none was.
    pub outcomes: Vec<f32>,
    /// Which outcomes were observed, a flag each; empty where all were, or none has a value.
    pub outcomes_present: Vec<bool>,
    /// Whether the step entered its state.
    pub entry: Entry,
    /// How often it was observed.
    pub count: u64,
    /// The track that it is a step of, by a number of the sender's own: then the service decides
    /// whether it is an entry, where `entry` does not say.
    pub track: Option<u64>,
}

/// A record that could not be decoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Undecodable {
    /// The field at fault as a JSON pointer into the record.
    pub field: String,
    /// The value that was found and what was expected.
    pub reason: String,
    /// The track that it is a step of, as far as that could be decoded.
    pub track: Option<u64>,
}

impl Undecodable {
    /// Returns the same as a step of a track.
    pub fn of_track(self, track: Option<u64>) -> Self {
        Self { track, ..self }
    }
}

impl From<(String, String)> for Undecodable {
    fn from((field, reason): (String, String)) -> Self {
        Self {
            field,
            reason,
            track: None,
        }
    }
}

impl Record {
    /// Makes a record of what all agents did, observed once; nothing is said of its entry, and no
    /// outcome was observed.
    pub fn new(state: Vec<f32>, actions: Vec<f32>) -> Self {
        Self {
            state,
            actions,
            actions_present: Vec::new(),
            outcomes: Vec::new(),
            outcomes_present: Vec::new(),
            entry: Entry::Unknown,
            count: 1,
            track: None,
        }
    }
}

impl Records {
    /// Returns how many outcomes of the schema there may be beside each record: none of them where
    /// nothing was observed.
    pub fn observed(&self, schema: &super::Schema) -> usize {
        if self.outcomes.is_empty() {
            0
        } else {
            schema.outcomes().len()
        }
    }

    /// Collects records of these widths; a record that could not be decoded keeps its place.
    pub fn collect(
        widths: Widths,
        records: impl ExactSizeIterator<Item = Result<Record, Undecodable>>,
    ) -> Self {
        let mut all = Collecting::new(widths.clone(), records.len());
        for record in records {
            match record.and_then(|record| widths.check(record)) {
                Ok(record) => all.push(&record),
                Err(undecodable) => all.push_undecodable(undecodable),
            }
        }
        all.finish()
    }

    /// Returns these records in the one form that equal content has, whichever form it came in:
    /// -0.0 is 0.0, what is missing is 0, and a column that only holds its default is empty.
    pub fn normalised(mut self, widths: &Widths) -> Self {
        self.actions = cleared(self.actions, &self.actions_present, &widths.agents);
        self.states = self.states.normalised();
        self.actions = self.actions.normalised();

        if self.outcomes_present.is_none() || self.outcomes.is_empty() {
            (self.outcomes, self.outcomes_present) = (Values::default(), Presence::default());
        }
        self.outcomes = cleared(self.outcomes, &self.outcomes_present, &widths.outcomes);
        self.outcomes = self.outcomes.normalised();

        if self.entries.iter().all(|entry| *entry == Entry::Unknown) {
            self.entries.clear();
        }
        if self.counts.iter().all(|count| *count == 1) {
            self.counts.clear();
        }
        if self.tracks.iter().all(Option::is_none) {
            self.tracks.clear();
        }
        self
    }

    /// Returns the digest of this content under a segment: BLAKE3, the same on every face. Of a
    /// record that could not be decoded it says that there was one; what is said of it is no
    /// content, for the words change from build to build.
    pub fn digest(&self, segment: Option<&Label>) -> Digest {
        let mut hasher = self.values_hasher(segment);
        for rejection in &self.undecodable {
            hasher.update(&rejection.index.to_le_bytes());
        }
        Digest(*hasher.finalize().as_bytes())
    }

    /// Returns what makes the digests of builds that took words for content; `None` where every
    /// record could be decoded, for then they are the same.
    pub fn worded(&self, segment: Option<&Label>) -> Option<Worded> {
        let undecodable = self.undecodable.clone();
        (!undecodable.is_empty()).then(|| Worded {
            values: self.values_hasher(segment),
            undecodable,
        })
    }

    /// Returns nine bytes a track: a hasher takes them together many times as fast as one by one.
    fn bytes_of_tracks(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(9 * self.tracks.len());
        for track in &self.tracks {
            bytes.push(u8::from(track.is_some()));
            bytes.extend(track.unwrap_or(0).to_le_bytes());
        }
        bytes
    }

    fn values_hasher(&self, segment: Option<&Label>) -> blake3::Hasher {
        let mut hasher = blake3::Hasher::new();
        let segment = segment.map_or("", Label::as_str);
        for size in [
            segment.len(),
            self.len,
            self.states.len(),
            self.actions.len(),
            self.entries.len(),
            self.counts.len(),
        ] {
            hasher.update(&(size as u64).to_le_bytes());
        }

        hasher.update(segment.as_bytes());
        hasher.update(self.states.le_bytes());
        hasher.update(self.actions.le_bytes());
        hasher.update(
            &self
                .entries
                .iter()
                .map(|entry| *entry as u8)
                .collect::<Vec<u8>>(),
        );
        hasher.update(bytemuck::cast_slice(&self.counts));

        // Nothing where every agent acted, nothing was observed and no track is told: so it was when
        // all records were like that.
        let later = [
            self.actions_present.bits(),
            self.outcomes.le_bytes(),
            self.outcomes_present.bits(),
        ];
        let are_told = !self.tracks.is_empty();
        if are_told || later.iter().any(|column| !column.is_empty()) {
            for column in later {
                hasher.update(&(column.len() as u64).to_le_bytes());
                hasher.update(column);
            }
        }
        hasher.update(&self.bytes_of_tracks());
        hasher
    }
}

/// Returns a column with zeros in the slots that have no value, each as wide as its own; copies only
/// where there is one.
fn cleared(values: Values, present: &Presence, slots: &[usize]) -> Values {
    if present.is_all() {
        return values;
    }
    let widths = slots.iter().cycle().enumerate();
    let values: Vec<f32> = widths
        .scan(0, |first, (slot, width)| {
            let begin = std::mem::replace(first, *first + width);
            (begin < values.len()).then(|| {
                let has = present.has(slot);
                let slot = values.at(begin, *width);
                slot.map(move |value| if has { value } else { 0.0 })
            })
        })
        .flatten()
        .collect();
    values.into()
}

/// Columns in the making, record after record.
#[derive(Debug)]
pub struct Collecting {
    widths: Widths,
    states: Vec<f32>,
    actions: Vec<f32>,
    actions_present: Flags,
    outcomes: Vec<f32>,
    outcomes_present: Flags,
    entries: Vec<Entry>,
    counts: Vec<u64>,
    /// None as long as no record tells its track.
    tracks: Vec<Option<u64>>,
    undecodable: Vec<Rejection>,
}

impl Collecting {
    /// Begins with room for so many records of these widths.
    pub fn new(widths: Widths, records: usize) -> Self {
        Self {
            states: Vec::with_capacity(records * widths.state),
            actions: Vec::with_capacity(records * widths.actions),
            actions_present: Flags::default(),
            outcomes: Vec::with_capacity(records * widths.outcome_values()),
            outcomes_present: Flags::default(),
            entries: Vec::with_capacity(records),
            counts: Vec::with_capacity(records),
            tracks: Vec::new(),
            undecodable: Vec::new(),
            widths,
        }
    }

    /// Returns how many records there are.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Returns whether there are none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Adds a record of these widths.
    pub fn push(&mut self, record: &Record) {
        let (agents, outcomes) = (self.widths.agents.len(), self.widths.outcomes.len());
        self.states.extend(&record.state);
        self.actions.extend(&record.actions);
        self.actions_present
            .push(&record.actions_present, true, agents);

        let is_observed = !record.outcomes.is_empty();
        self.outcomes.extend(&record.outcomes);
        if !is_observed {
            let values = self.outcomes.len() + self.widths.outcome_values();
            self.outcomes.resize(values, 0.0);
        }
        let flags = if is_observed {
            &*record.outcomes_present
        } else {
            &[]
        };
        self.outcomes_present.push(flags, is_observed, outcomes);

        if record.track.is_some() || !self.tracks.is_empty() {
            self.tracks.resize(self.len(), None);
            self.tracks.push(record.track);
        }
        self.entries.push(record.entry);
        self.counts.push(record.count);
    }

    /// Keeps the place of a record that could not be decoded.
    fn push_undecodable(&mut self, undecodable: Undecodable) {
        let Undecodable {
            field,
            reason,
            track,
        } = undecodable;
        self.undecodable.push(Rejection {
            index: self.len() as u32,
            field,
            reason,
        });
        let blank = Record::new(vec![0.0; self.widths.state], vec![0.0; self.widths.actions]);
        self.push(&Record { track, ..blank });
    }

    /// Returns the records, in the one form that equal content has.
    pub fn finish(self) -> Records {
        let records = Records {
            len: self.entries.len(),
            states: self.states.into(),
            actions: self.actions.into(),
            actions_present: self.actions_present.packed(),
            outcomes: self.outcomes.into(),
            outcomes_present: self.outcomes_present.packed(),
            entries: self.entries,
            counts: self.counts,
            tracks: self.tracks,
            undecodable: self.undecodable,
        };
        records.normalised(&self.widths)
    }
}

/// Flags in the making; none is kept as long as all of them are set.
#[derive(Debug, Default)]
struct Flags {
    kept: Vec<bool>,
    len: usize,
}

impl Flags {
    /// Adds the flags of some slots, all of the usual value where none is given.
    fn push(&mut self, given: &[bool], usual: bool, slots: usize) {
        let are_set = given.is_empty() && usual;
        if !are_set || !self.kept.is_empty() {
            self.kept.resize(self.len, true);
            self.kept.extend(given);
            self.kept.resize(self.len + slots, usual);
        }
        self.len += slots;
    }

    fn packed(self) -> Presence {
        Presence::of(self.kept)
    }
}

/// A batch with records that could not be decoded, as builds up to a8c9617 digested it: with what
/// they said of them.
#[derive(Debug, Clone)]
pub struct Worded {
    values: blake3::Hasher,
    undecodable: Vec<Rejection>,
}

impl Worded {
    /// Returns the digest in the words of the first receipt; beyond those that were told, in
    /// today's.
    pub fn digest(&self, told: &[Rejection]) -> Digest {
        let mut hasher = self.values.clone();
        for own in &self.undecodable {
            let rejection = told
                .iter()
                .find(|first| first.index == own.index)
                .unwrap_or(own);

            hasher.update(&rejection.index.to_le_bytes());
            for text in [&rejection.field, &rejection.reason] {
                hasher
                    .update(&(text.len() as u64).to_le_bytes())
                    .update(text.as_bytes());
            }
        }
        Digest(*hasher.finalize().as_bytes())
    }
}

/// BLAKE3 of a batch's content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Digest(pub [u8; 32]);

/// How many values a record of an environment has. Cloning is cheap.
#[derive(Debug, Clone, Default)]
pub struct Widths {
    /// State features.
    pub state: usize,
    /// Action features of all agents.
    pub actions: usize,
    /// Action features of each agent.
    pub agents: Arc<[usize]>,
    /// Features of each outcome.
    pub outcomes: Arc<[usize]>,
}

impl Widths {
    /// Returns the widths of a schema's records.
    pub fn of_schema(schema: &super::Schema) -> Self {
        let agents = schema.agents().iter().map(|agent| agent.action.len());
        let outcomes = schema.outcomes().iter().map(|outcome| outcome.value.len());
        Self {
            state: schema.state().len(),
            actions: schema.action_width(),
            agents: agents.collect(),
            outcomes: outcomes.collect(),
        }
    }

    /// Returns how many features all outcomes have.
    pub fn outcome_values(&self) -> usize {
        self.outcomes.iter().sum()
    }

    /// Returns a record that has these widths, or its first fault.
    pub fn check(&self, record: Record) -> Result<Record, Undecodable> {
        let fits = self.fits(&record);
        fits.map_err(|fault| Undecodable::from(fault).of_track(record.track))?;
        Ok(record)
    }

    fn fits(&self, record: &Record) -> Result<(), (String, String)> {
        let (agents, outcomes) = (self.agents.len(), self.outcomes.len());
        for (field, got, expected) in [
            ("/state", record.state.len(), self.state),
            ("/actions", record.actions.len(), self.actions),
        ] {
            wide(field, "values", got, expected)?;
        }
        // Those that may be left out.
        for (field, what, got, expected) in [
            (
                "/actions_present",
                "flags",
                record.actions_present.len(),
                agents,
            ),
            (
                "/outcomes",
                "values",
                record.outcomes.len(),
                self.outcome_values(),
            ),
            (
                "/outcomes_present",
                "flags",
                record.outcomes_present.len(),
                outcomes,
            ),
        ] {
            if got != 0 {
                wide(field, what, got, expected)?;
            }
        }
        Ok(())
    }
}

fn wide(field: &str, what: &str, got: usize, expected: usize) -> Result<(), (String, String)> {
    if got == expected {
        return Ok(());
    }
    let reason = format!("got {got} {what}, expected {expected}");
    Err((field.to_owned(), reason))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn batch(reason: &str, value: f32) -> Records {
        let bad = Err(("/state/x".to_owned(), reason.to_owned()).into());
        let good = Ok(Record::new(vec![value], vec![0.0, 1.0]));
        Records::collect(
            Widths {
                state: 1,
                actions: 2,
                ..Widths::default()
            },
            [good, bad].into_iter(),
        )
    }

    #[test]
    fn a_digest_is_that_of_every_build_and_form() {
        // By Python's blake3 1.0 of the numbers of bytes and values, and the columns, as little
        // endian: what builds kept that had vectors of floats.
        let kept = "f839bc83b01dfbeedcfa1e7b57591526082190f28dbbefde936df40fd01c960d";
        let segment = "trial-3".parse().expect("a label");
        let record = |state: [f32; 2], actions: [f32; 2], entry, count| Record {
            entry,
            count,
            ..Record::new(state.into(), actions.into())
        };
        let rows = [
            Ok(record([0.1, -0.0], [0.0, 2.0], Entry::Entered, 1)),
            Ok(record([0.7, 1.0], [1.0, 0.0], Entry::Stayed, 3)),
        ];
        let widths = Widths {
            state: 2,
            actions: 2,
            ..Widths::default()
        };
        let by_rows = Records::collect(widths.clone(), rows.into_iter());

        let bytes = |values: [f32; 4]| {
            values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect()
        };
        let by_bytes = Records {
            len: 2,
            states: Values::from_le(bytes([0.1, 0.0, 0.7, 1.0])).expect("whole"),
            actions: Values::from_le(bytes([-0.0, 2.0, 1.0, 0.0])).expect("whole"),
            entries: vec![Entry::Entered, Entry::Stayed],
            counts: vec![1, 3],
            ..Records::default()
        };
        for records in [by_rows, by_bytes.normalised(&widths)] {
            let Digest(digest) = records.digest(Some(&segment));
            assert_eq!(blake3::Hash::from(digest).to_hex().as_str(), kept);
        }
    }

    #[test]
    fn words_are_no_content_and_values_are() {
        assert_eq!(
            batch("before", 0.5).digest(None),
            batch("after", 0.5).digest(None)
        );
        assert_ne!(
            batch("before", 0.5).digest(None),
            batch("before", 0.75).digest(None)
        );
        let good = Records {
            undecodable: Vec::new(),
            ..batch("before", 0.5)
        };
        assert_ne!(batch("before", 0.5).digest(None), good.digest(None));
        assert!(good.worded(None).is_none());
    }

    #[test]
    fn a_digest_with_words_is_found_by_those_of_the_first_receipt() {
        let first = batch("before", 0.5);
        let kept = first.worded(None).expect("undecodable").digest(&[]);
        let again = |value| batch("after", value).worded(None).expect("undecodable");
        assert_eq!(again(0.5).digest(&first.undecodable), kept);
        assert_ne!(again(0.5).digest(&[]), kept, "nothing was told");
        assert_ne!(
            again(0.75).digest(&first.undecodable),
            kept,
            "another value"
        );
    }

    fn three_slots() -> Widths {
        Widths {
            state: 1,
            actions: 3,
            agents: [2, 1].into(),
            outcomes: [1, 2].into(),
        }
    }

    #[test]
    fn what_is_missing_is_zero_and_equal_content_has_one_form() {
        let by_rows = |actions: [f32; 3], outcomes: &[f32], observed: &[bool]| {
            let acted = Record::new(vec![0.5], vec![1.0, 2.0, 3.0]);
            let absent = Record {
                actions_present: vec![false, true],
                outcomes: outcomes.to_vec(),
                outcomes_present: observed.to_vec(),
                ..Record::new(vec![0.5], actions.to_vec())
            };
            Records::collect(three_slots(), [Ok(acted), Ok(absent)].into_iter())
        };
        let one = by_rows([9.0, -0.0, 3.0], &[7.0, 8.0, f32::NAN], &[true, false]);
        let same = by_rows([0.0, 0.0, 3.0], &[7.0, 0.0, 0.0], &[true, false]);
        assert_eq!(one, same);
        assert_eq!(one.digest(None), same.digest(None));

        let values = |values: &Values| values.iter().collect::<Vec<_>>();
        assert_eq!(values(&one.actions), [1.0, 2.0, 3.0, 0.0, 0.0, 3.0]);
        assert_eq!(values(&one.outcomes), [0.0, 0.0, 0.0, 7.0, 0.0, 0.0]);
        let flags = |present: &Presence| (0..4).map(|at| present.has(at)).collect::<Vec<_>>();
        assert_eq!(flags(&one.actions_present), [true, true, false, true]);
        assert_eq!(flags(&one.outcomes_present), [false, false, true, false]);

        // Each of these is another content.
        let unknown = by_rows([0.0, 0.0, 3.0], &[], &[]);
        assert!(unknown.outcomes.is_empty() && unknown.outcomes_present.is_all());
        assert_eq!(unknown, by_rows([0.0, 0.0, 3.0], &[1.0; 3], &[false; 2]));
        let zeros = by_rows([0.0, 0.0, 3.0], &[0.0; 3], &[true, false]);
        let both = by_rows([0.0, 0.0, 3.0], &[7.0, 0.0, 0.0], &[]);
        let contents = [&one, &unknown, &zeros, &both];
        for (at, content) in contents.iter().enumerate() {
            for other in &contents[..at] {
                assert_ne!(content.digest(None), other.digest(None));
            }
        }
    }

    #[test]
    fn tracks_are_content_where_one_is_told() {
        let by_tracks = |tracks: &[Option<u64>]| {
            let record = |track: &Option<u64>| Record {
                track: *track,
                ..Record::new(vec![0.5], vec![1.0, 2.0, 3.0])
            };
            Records::collect(three_slots(), tracks.iter().map(record).map(Ok))
        };
        let none = by_tracks(&[None; 3]);
        assert!(none.tracks.is_empty());
        let columns = Records {
            tracks: vec![None; 3],
            ..none.clone()
        };
        assert_eq!(columns.normalised(&three_slots()), none);

        let late = by_tracks(&[None, None, Some(0)]);
        assert_eq!(late.tracks, [None, None, Some(0)]);
        let narrow = Record {
            track: Some(0),
            ..Record::new(Vec::new(), Vec::new())
        };
        let narrow = Records::collect(three_slots(), [Ok(narrow)].into_iter());
        assert_eq!(
            (narrow.undecodable.len(), narrow.tracks),
            (1, vec![Some(0)])
        );
        let early = by_tracks(&[Some(0), None, None]);
        assert_eq!(early.tracks, [Some(0), None, None]);

        let observed = Records {
            outcomes: vec![0.0; 9].into(),
            ..late.clone()
        };
        let others = [
            [Some(0); 3],
            [Some(0), Some(0), Some(1)],
            [Some(u64::MAX); 3],
        ];
        let contents: Vec<Records> = [none, late, early, observed]
            .into_iter()
            .chain(others.map(|tracks| by_tracks(&tracks)))
            .collect();
        for (at, content) in contents.iter().enumerate() {
            for other in &contents[..at] {
                assert_ne!(content.digest(None), other.digest(None));
            }
        }
    }

    #[test]
    fn what_all_records_have_needs_no_flags() {
        let records = (0..20).map(|_| Record {
            outcomes: vec![1.0, 2.0, 3.0],
            ..Record::new(vec![0.5], vec![1.0, 2.0, 3.0])
        });
        let flagged = records.clone().map(|record| Record {
            actions_present: vec![true; 2],
            outcomes_present: vec![true; 2],
            ..record
        });
        let [plain, flagged] = [records.collect::<Vec<_>>(), flagged.collect()]
            .map(|records| Records::collect(three_slots(), records.into_iter().map(Ok)));
        assert!(plain.actions_present.is_all() && plain.outcomes_present.is_all());
        assert_eq!((plain.outcomes.len(), &plain), (60, &flagged));
    }

    #[test]
    fn a_record_of_other_widths_is_told() {
        let good = Record::new(vec![0.5], vec![1.0; 3]);
        let told = |record| three_slots().check(record).map_err(|bad| bad.field);
        let wrong = |field: &str| Err(field.to_owned());
        let record = |change: fn(&mut Record)| {
            let mut record = good.clone();
            change(&mut record);
            told(record).map(|_| ())
        };
        assert_eq!(record(|_| ()), Ok(()));
        assert_eq!(record(|r| r.outcomes = vec![0.0; 3]), Ok(()));
        assert_eq!(record(|r| r.state.clear()), wrong("/state"));
        assert_eq!(record(|r| r.actions.clear()), wrong("/actions"));
        assert_eq!(record(|r| r.outcomes = vec![0.0; 2]), wrong("/outcomes"));
        let flags = |r: &mut Record| r.actions_present = vec![true; 3];
        assert_eq!(record(flags), wrong("/actions_present"));
        let flags = |r: &mut Record| r.outcomes_present = vec![true; 3];
        assert_eq!(record(flags), wrong("/outcomes_present"));
    }
}
