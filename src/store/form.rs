//! Versions of stored forms: which shape a text has that is kept for years, and why one cannot be
//! read.
//!
//! What is kept as text (schemas, rules, receipts, fits, cards) is a JSON object of a type of its
//! own beside the room that keeps it, never of a type that something else needs too: those change.
//! Its member `form` says the version of its shape. Builds before there were versions wrote none:
//! such a text is version 1 for ever.
//!
//! * A version that was written by a build that landed is read for ever, or is recognised and made
//!   again.
//! * A change that builds before it would misread gets the next version. A member that may be
//!   missing needs none.
//! * Each change adds a database to `tests/fixtures`, which every later build has to open.
//!
//! Not for what stands outside such a text: tables have migrations, a file of weights names its own
//! format.

use std::num::NonZeroU32;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Why a stored text cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unreadable {
    /// It says what builds of its time understood by it, which this one does not.
    #[error("it has form {0} of an older build, which this one does not use any more")]
    Older(u32),
    /// A newer build wrote it.
    #[error("it has form {found} of a newer build, and this one reads up to {newest}")]
    Newer {
        /// Its version.
        found: u32,
        /// The last version that this build knows.
        newest: u32,
    },
    /// It is not what it says it is.
    #[error("it is not as it was written: {0}")]
    Spoiled(String),
}

impl Unreadable {
    /// Makes the error of a text whose content contradicts itself or what it belongs to.
    pub fn spoiled(why: impl ToString) -> Self {
        Self::Spoiled(why.to_string())
    }
}

#[derive(Serialize)]
struct Written<'a, T> {
    form: u32,
    #[serde(flatten)]
    content: &'a T,
}

#[derive(Deserialize)]
struct Version {
    form: Option<NonZeroU32>,
}

/// Writes a content under its version.
pub fn write(version: u32, content: &impl Serialize) -> String {
    write_plain(&Written {
        form: version,
        content,
    })
}

/// Writes a content of version 1 without saying so, as builds did before there were versions: for
/// texts that must be short.
pub fn write_plain(content: &impl Serialize) -> String {
    serde_json::to_string(content).expect("texts, numbers and lists of them can always be written")
}

/// Returns the version of a text.
pub fn version(text: &str) -> Result<u32, Unreadable> {
    Ok(read_content::<Version>(text)?
        .form
        .map_or(1, NonZeroU32::get))
}

/// Reads the content of a text whose version is known.
pub fn read_content<T: DeserializeOwned>(text: &str) -> Result<T, Unreadable> {
    serde_json::from_str(text).map_err(Unreadable::spoiled)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Content {
        n: u64,
        share: f64,
        words: Vec<String>,
    }

    #[test]
    fn a_text_says_its_version_beside_its_content() {
        let content = Content {
            n: u64::MAX,
            share: 0.1 + 0.2,
            words: vec!["form".into()],
        };
        let text = write(7, &content);
        assert!(
            text.starts_with(r#"{"form":7,"n":18446744073709551615,"#),
            "{text}"
        );
        assert_eq!((version(&text), read_content(&text)), (Ok(7), Ok(content)));
    }

    #[test]
    fn a_text_without_a_version_is_the_first() {
        let text = write_plain(&Content {
            n: 1,
            share: 0.5,
            words: Vec::new(),
        });
        assert!(!text.contains("form"), "{text}");
        assert_eq!(version(&text), Ok(1));
        assert_eq!(version(r#"{"form":null}"#), Ok(1));
    }

    #[test]
    fn what_is_no_version_is_told() {
        for text in [
            "",
            "[]",
            "null",
            "{",
            r#"{"form":0}"#,
            r#"{"form":-1}"#,
            r#"{"form":1.5}"#,
            r#"{"form":"1"}"#,
        ] {
            assert!(
                matches!(version(text), Err(Unreadable::Spoiled(_))),
                "{text}"
            );
        }
        let told = Unreadable::Newer {
            found: 3,
            newest: 2,
        }
        .to_string();
        assert_eq!(
            told,
            "it has form 3 of a newer build, and this one reads up to 2"
        );
    }
}
