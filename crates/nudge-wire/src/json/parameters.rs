//! The parameters of a query string, with their faults.

use nudge_core::domain::draft::{NamedValues, ValueDraft};
use nudge_core::domain::{hint, is_near};
use nudge_core::error::{Fault, Problem, pointer};

/// The parameters of a query string, taken one by one: what is left at the end is unknown.
#[derive(Debug, Default)]
pub struct Parameters {
    left: Vec<(String, String)>,
    /// The names that were asked for.
    known: Vec<String>,
    faults: Vec<Fault>,
}

impl Parameters {
    /// Makes parameters of decoded pairs.
    pub fn new(pairs: Vec<(String, String)>) -> Self {
        Self {
            left: pairs,
            ..Self::default()
        }
    }

    /// Returns `value` unless a parameter was faulty, or was not taken.
    pub fn finish<T>(mut self, value: T) -> Result<T, Problem> {
        let unknown = |(name, _): &(String, String)| {
            Fault::new(
                pointer(name),
                format!("unknown parameter{}", self.hint(name)),
            )
        };

        let unknown: Vec<Fault> = self.left.iter().map(unknown).collect();
        self.faults.extend(unknown);

        if self.faults.is_empty() {
            Ok(value)
        } else {
            Err(Problem::invalid("query", self.faults))
        }
    }

    /// Returns what is added to an unknown parameter: which were meant, those that there are, or
    /// that there are none.
    fn hint(&self, name: &str) -> String {
        if self.known.is_empty() {
            return "; there is none on this path".to_owned();
        }

        // Of a family, the member that was meant: `state.held` for `stat.held`.
        let (family, member) = name.split_once('.').unwrap_or_default();
        let known = self
            .known
            .iter()
            .filter_map(|known| match known.strip_suffix('.') {
                Some(prefix) => is_near(family, prefix).then(|| format!("{prefix}.{member}")),
                None => Some(known.clone()),
            });

        hint(name, known.collect::<Vec<_>>().iter().map(String::as_str))
    }

    /// Notes parameters that belong to bodies of another type only.
    pub(super) fn misplaced(&mut self, name: &str, why: &str) {
        if !self.take(name).is_empty() {
            self.fault(name, why);
        }
    }

    pub(super) fn take(&mut self, name: &str) -> Vec<String> {
        self.known.push(name.to_owned());
        self.left
            .extract_if(.., |(found, _)| found == name)
            .map(|(_, value)| value)
            .collect()
    }

    /// Takes the value of a parameter that is given once at most; an empty one counts as absent.
    pub(super) fn text(&mut self, name: &str) -> Option<String> {
        let mut values = self.take(name);
        if values.len() > 1 {
            self.fault(name, format!("given {} times, expected once", values.len()));
        }
        values.pop().filter(|value| !value.is_empty())
    }

    /// Takes the values of a parameter that may be repeated, or joined by commas.
    pub(super) fn list(&mut self, name: &str) -> Vec<String> {
        let values = self.take(name);
        values
            .iter()
            .flat_map(|value| value.split(','))
            .filter(|part| !part.is_empty())
            .map(Into::into)
            .collect()
    }

    /// Takes a number; `expected` says which are.
    pub(super) fn number<T: std::str::FromStr>(&mut self, name: &str, expected: &str) -> Option<T> {
        let text = self.text(name)?;
        let number = text.parse().ok();
        if number.is_none() {
            self.fault(name, format!("got {text:?}, expected {expected}"));
        }
        number
    }

    /// Takes a count.
    pub(super) fn whole(&mut self, name: &str) -> Option<u64> {
        self.number(name, "a whole number, at least 0")
    }

    /// Takes the numbers of a parameter that may be repeated, or joined by commas.
    pub(super) fn numbers<T: std::str::FromStr>(&mut self, name: &str, expected: &str) -> Vec<T> {
        let mut numbers = Vec::new();
        for text in self.list(name) {
            match text.parse() {
                Ok(number) => numbers.push(number),
                Err(_) => self.fault(name, format!("got {text:?}, expected {expected}")),
            }
        }
        numbers
    }

    /// Takes every parameter whose name begins with `prefix`, without it.
    pub(super) fn under(&mut self, prefix: &str) -> NamedValues {
        let texts = self.texts_under(prefix).into_iter();
        texts
            .map(|(name, value)| (name, ValueDraft::Text(value)))
            .collect()
    }

    /// Takes the same as they are written.
    pub(super) fn texts_under(&mut self, prefix: &str) -> Vec<(String, String)> {
        self.known.push(prefix.to_owned());
        let under = self
            .left
            .extract_if(.., |(name, _)| name.starts_with(prefix));
        under
            .map(|(name, value)| (name[prefix.len()..].to_owned(), value))
            .collect()
    }

    /// Notes that a parameter without a value is needed, unless its value was faulty.
    pub(super) fn required<T>(&mut self, name: &str, value: Option<T>) -> Option<T> {
        let told = self
            .faults
            .iter()
            .any(|fault| fault.pointer == pointer(name));
        if value.is_none() && !told {
            self.fault(name, "missing");
        }
        value
    }

    /// Notes a fault of a parameter.
    pub(super) fn fault(&mut self, name: &str, detail: impl Into<String>) {
        self.faults.push(Fault::new(pointer(name), detail));
    }
}
