//! A batch as it was decoded: columns of values, the same whichever face it came through.
//!
//! Nothing here has been compared with bins yet. Rows and JSON become columns too, so there is one
//! thing to digest and one thing to validate.

use super::{Label, Values};

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
    /// One a record, or empty where none says.
    pub entries: Vec<Entry>,
    /// How often each record was observed, or empty for once each.
    pub counts: Vec<u64>,
    /// The records that could not be decoded, by index; their values above are zeros.
    pub undecodable: Vec<Rejection>,
}

/// One record of a batch, as rows and JSON give it.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// One value a state feature.
    pub state: Vec<f32>,
    /// One value an action feature.
    pub actions: Vec<f32>,
    /// Whether the step entered its state.
    pub entry: Entry,
    /// How often it was observed.
    pub count: u64,
}

impl Records {
    /// Collects records of these widths; a record that could not be decoded keeps its place.
    pub fn collect(
        widths: Widths,
        records: impl ExactSizeIterator<Item = Result<Record, (String, String)>>,
    ) -> Self {
        let mut all = Self {
            len: records.len(),
            ..Self::default()
        };
        let (mut states, mut actions) = (
            Vec::with_capacity(records.len() * widths.state),
            Vec::with_capacity(records.len() * widths.actions),
        );

        for (index, record) in records.enumerate() {
            let record = record
                .and_then(|record| widths.check(record))
                .unwrap_or_else(|(field, reason)| {
                    all.undecodable.push(Rejection {
                        index: index as u32,
                        field,
                        reason,
                    });
                    widths.blank()
                });

            states.extend(&record.state);
            actions.extend(&record.actions);
            all.entries.push(record.entry);
            all.counts.push(record.count);
        }
        (all.states, all.actions) = (states.into(), actions.into());
        all.normalised()
    }

    /// Returns these records in the one form that equal content has, whichever form it came in:
    /// -0.0 is 0.0, and a column that only holds its default is empty.
    pub fn normalised(mut self) -> Self {
        self.states = self.states.normalised();
        self.actions = self.actions.normalised();

        if self.entries.iter().all(|entry| *entry == Entry::Unknown) {
            self.entries.clear();
        }
        if self.counts.iter().all(|count| *count == 1) {
            self.counts.clear();
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
        hasher
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

/// How many values a record of an environment has.
#[derive(Debug, Clone, Copy)]
pub struct Widths {
    /// State features.
    pub state: usize,
    /// Action features of all agents.
    pub actions: usize,
}

impl Widths {
    /// Returns the widths of a schema's records.
    pub fn of_schema(schema: &super::Schema) -> Self {
        Self {
            state: schema.state().len(),
            actions: schema.action_width(),
        }
    }

    fn blank(self) -> Record {
        Record {
            state: vec![0.0; self.state],
            actions: vec![0.0; self.actions],
            entry: Entry::Unknown,
            count: 1,
        }
    }

    fn check(self, record: Record) -> Result<Record, (String, String)> {
        let wrong = |field: &str, got: usize, expected: usize| {
            Err((
                field.to_owned(),
                format!("got {got} values, expected {expected}"),
            ))
        };

        if record.state.len() != self.state {
            return wrong("/state", record.state.len(), self.state);
        }
        if record.actions.len() != self.actions {
            return wrong("/actions", record.actions.len(), self.actions);
        }
        Ok(record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn batch(reason: &str, value: f32) -> Records {
        let bad = Err(("/state/x".to_owned(), reason.to_owned()));
        let good = Ok(Record {
            state: vec![value],
            actions: vec![0.0, 1.0],
            entry: Entry::Unknown,
            count: 1,
        });
        Records::collect(
            Widths {
                state: 1,
                actions: 2,
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
            state: state.into(),
            actions: actions.into(),
            entry,
            count,
        };
        let rows = [
            Ok(record([0.1, -0.0], [0.0, 2.0], Entry::Entered, 1)),
            Ok(record([0.7, 1.0], [1.0, 0.0], Entry::Stayed, 3)),
        ];
        let widths = Widths {
            state: 2,
            actions: 2,
        };
        let by_rows = Records::collect(widths, rows.into_iter());

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
            undecodable: Vec::new(),
        };
        for records in [by_rows, by_bytes.normalised()] {
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
}
