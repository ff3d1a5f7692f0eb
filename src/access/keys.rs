//! The keys file, an access control list: who is let in.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::file::read_text;
use super::rate::Meter;
use super::{KeyDigest, Line};
use crate::domain::{Name, Principal};

/// The access control list: every key that is let in.
#[derive(Debug, Default)]
pub struct Keys(Vec<Key>);

/// One key.
#[derive(Debug, Clone)]
pub struct Key {
    digest: KeyDigest,
    principal: Arc<Principal>,
    meter: Option<Arc<Meter>>,
}

/// Why a keys file cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeysError {
    /// It cannot be read.
    #[error("cannot read the keys file {path}: {why}")]
    Unread {
        /// Where it is.
        path: String,
        /// What the system says.
        why: String,
    },
    /// Some of it says nothing: a fault a line.
    #[error("{}", .0.join("\n"))]
    Wrong(Vec<String>),
}

impl Keys {
    /// Reads a file.
    pub fn read_file(path: &Path) -> Result<Self, KeysError> {
        let unread = |why: String| KeysError::Unread {
            path: path.display().to_string(),
            why,
        };

        let text = read_text(path).map_err(unread)?;
        let within = |faults: Vec<String>| {
            faults
                .iter()
                .map(|fault| format!("{}: {fault}", path.display()))
                .collect()
        };

        Self::parse_whole(&text).map_err(|faults| KeysError::Wrong(within(faults)))
    }

    /// Reads the lines of a file, each of which ends: one that does not may be half of what was
    /// meant, and half a line lets in more than the whole.
    pub fn parse_whole(text: &str) -> Result<Self, Vec<String>> {
        let is_whole = text.is_empty() || text.ends_with('\n');
        let unended = || {
            format!(
                "line {}: got no end of the line, expected one: it may be half-written",
                text.lines().count()
            )
        };
        match Self::parse(text) {
            Ok(keys) if is_whole => Ok(keys),
            Ok(_) => Err(vec![unended()]),
            Err(faults) if is_whole => Err(faults),
            Err(faults) => Err(faults.into_iter().chain([unended()]).collect()),
        }
    }

    /// Reads lines; empty ones and those that begin with `#` are passed over. Tells every fault.
    pub fn parse(text: &str) -> Result<Self, Vec<String>> {
        let (mut keys, mut faults) = (Self::default(), Vec::new());
        let mut places: Vec<usize> = Vec::new();
        for (number, line) in (1..).zip(text.lines()) {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let found = line.parse::<Line>().map_err(|faults| {
                faults
                    .into_iter()
                    .map(|fault| format!("line {number}: {fault}"))
            });
            match found {
                Err(found) => faults.extend(found),
                Ok(line) => match keys.0.iter().position(|key| key.digest == line.digest) {
                    Some(at) => faults.push(format!(
                        "line {number}: digest: got that of line {} again, expected one of another key",
                        places[at]
                    )),
                    None => {
                        places.push(number);
                        keys.0.push(Key::from(line));
                    }
                },
            }
        }

        if faults.is_empty() {
            Ok(keys)
        } else {
            Err(faults)
        }
    }

    /// Returns how many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns whether nobody is let in.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the key of that digest. Every one is compared, whole, so that time tells nothing.
    pub fn find(&self, digest: KeyDigest) -> Option<&Key> {
        self.0.iter().fold(None, |found, key| {
            if key.digest == digest {
                Some(key)
            } else {
                found
            }
        })
    }

    /// Goes on with what is used of rates that did not change.
    pub fn going_on_from(mut self, before: &Self) -> Self {
        for key in &mut self.0 {
            let used = before
                .find(key.digest)
                .and_then(|before| before.meter.clone());
            let is_same = |used: &Arc<Meter>| {
                key.meter
                    .as_ref()
                    .is_some_and(|meter| meter.rate() == used.rate())
            };
            if let Some(used) = used.filter(is_same) {
                key.meter = Some(used);
            }
        }
        self
    }
}

impl Key {
    /// Returns which it is.
    pub fn digest(&self) -> KeyDigest {
        self.digest
    }

    /// Returns who has it.
    pub fn principal(&self) -> &Arc<Principal> {
        &self.principal
    }

    /// Returns the name of who has it.
    pub fn name(&self) -> Option<&Name> {
        self.principal.name()
    }

    /// Takes one of its rate, or tells after how long there is one.
    pub fn take(&self) -> Result<(), Duration> {
        self.meter.as_ref().map_or(Ok(()), |meter| meter.take())
    }
}

impl From<Line> for Key {
    fn from(line: Line) -> Self {
        let Line {
            name,
            digest,
            scopes,
            environments,
            rate,
        } = line;
        let principal = Arc::new(Principal::named(name, scopes, environments));
        Self {
            digest,
            principal,
            meter: rate.map(|rate| Arc::new(Meter::new(rate))),
        }
    }
}

#[cfg(test)]
mod tests;
