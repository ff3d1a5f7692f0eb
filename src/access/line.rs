//! A line of the keys file: `NAME DIGEST SCOPES [environments=PATTERNS] [rate=RATE]`.

use std::fmt;
use std::str::FromStr;

use super::shown::harmless;
use super::{KeyDigest, Rate};
use crate::domain::{KeyScope, Name, Pattern, Scopes};

/// One key as its line says it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// Whose it is. Several lines may have one name, while a key is replaced by another.
    pub name: Name,
    /// Which it is.
    pub digest: KeyDigest,
    /// What it is for.
    pub scopes: Scopes,
    /// The environments that it is for; `None` for all.
    pub environments: Option<Vec<Pattern>>,
    /// How often it may ask; `None` for as often as it likes.
    pub rate: Option<Rate>,
}

impl FromStr for Line {
    /// Every fault: the field, its value where it cannot be a key, and what was expected.
    type Err = Vec<String>;

    fn from_str(text: &str) -> Result<Self, Vec<String>> {
        let mut faults = Vec::new();
        let mut fields = text.split_whitespace();
        let mut field = |name: &str| {
            fields
                .next()
                .ok_or_else(|| format!("{name}: missing, expected NAME DIGEST SCOPES"))
        };

        let name = field("name")
            .and_then(name)
            .map_err(|fault| faults.push(fault));
        let digest =
            field("digest").and_then(|text| text.parse().map_err(|why| format!("digest: {why}")));
        let digest: Result<KeyDigest, ()> = digest.map_err(|fault| faults.push(fault));
        let scopes = field("scopes")
            .and_then(scopes)
            .map_err(|fault| faults.push(fault));
        let mut options = Options::default();
        for field in fields {
            if let Err(fault) = options.take(field) {
                faults.push(fault);
            }
        }

        match (name, digest, scopes) {
            (Ok(name), Ok(digest), Ok(scopes)) if faults.is_empty() => Ok(Self {
                name,
                digest,
                scopes,
                environments: options.environments,
                rate: options.rate,
            }),
            _ => Err(faults),
        }
    }
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} {}", self.name, self.digest, self.scopes)?;
        if let Some(patterns) = &self.environments {
            let patterns = patterns
                .iter()
                .map(Pattern::as_str)
                .collect::<Vec<_>>()
                .join(",");
            write!(f, " environments={patterns}")?;
        }
        self.rate
            .iter()
            .try_for_each(|rate| write!(f, " rate={rate}"))
    }
}

/// What may stand behind the three fields.
#[derive(Default)]
struct Options {
    environments: Option<Vec<Pattern>>,
    rate: Option<Rate>,
}

impl Options {
    fn take(&mut self, field: &str) -> Result<(), String> {
        let unknown = || {
            format!(
                "option: got {}, expected environments=PATTERNS or rate=RATE",
                harmless(field)
            )
        };

        let (name, value) = field.split_once('=').ok_or_else(unknown)?;
        let is_given = match name {
            "environments" => self.environments.replace(patterns(value)?).is_some(),
            "rate" => self.rate.replace(rate(value)?).is_some(),
            _ => return Err(unknown()),
        };

        if is_given {
            Err(format!("{name}: given twice, expected once"))
        } else {
            Ok(())
        }
    }
}

fn name(text: &str) -> Result<Name, String> {
    text.parse()
        .map_err(|_| format!("name: got {}, expected {}", harmless(text), Name::EXPECTED))
}

fn scopes(text: &str) -> Result<Scopes, String> {
    text.split(',').map(scope).collect()
}

fn scope(word: &str) -> Result<KeyScope, String> {
    let expected = "expected read, ingest, train and admin, joined by commas";
    word.parse()
        .map_err(|_| format!("scopes: got {}, {expected}", harmless(word)))
}

fn patterns(text: &str) -> Result<Vec<Pattern>, String> {
    let expected = "expected names joined by commas, where `*` stands for any characters";
    let pattern = |text: &str| {
        text.parse::<Pattern>()
            .map_err(|_| format!("environments: got {}, {expected}", harmless(text)))
    };
    text.split(',').map(pattern).collect()
}

fn rate(text: &str) -> Result<Rate, String> {
    let expected = "expected a number a second, minute or hour such as 50/s, 600/m or 1000/h";
    text.parse()
        .map_err(|_| format!("rate: got {}, {expected}", harmless(text)))
}
