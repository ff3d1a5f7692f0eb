//! Names, labels and producer ids: text that has been checked once.

use std::borrow::Borrow;
use std::fmt;
use std::sync::Arc;

/// Declares a cheap-to-clone text type whose only constructor checks it.
macro_rules! checked_text {
    ($(#[$doc:meta])* $name:ident, $check:path, $expected:expr) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(Arc<str>);

        impl $name {
            /// What a valid text looks like, for error messages.
            pub const EXPECTED: &'static str = $expected;

            /// Returns the text.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl std::str::FromStr for $name {
            type Err = String;

            fn from_str(text: &str) -> Result<Self, String> {
                if $check(text) { Ok(Self(text.into())) } else { Err(format!("{text:?} is not {}", Self::EXPECTED)) }
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }

        impl Borrow<str> for $name {
            fn borrow(&self) -> &str {
                &self.0
            }
        }
    };
}

checked_text!(
    /// The name of an environment, a feature or an agent.
    Name,
    is_name,
    "a name of 1 to 63 of a-z, 0-9, '.', '_' and '-', beginning with a letter or a digit"
);
checked_text!(
    /// A label of a categorical feature, a unit or a segment.
    Label,
    is_label,
    "a label of 1 to 64 printable characters"
);
checked_text!(
    /// Who sends batches. Chosen by the sender, and the same after it restarts.
    ProducerId,
    is_producer,
    "a producer id of 1 to 128 of A-Z, a-z, 0-9, '.', '_', ':', '@' and '-', beginning with a letter or a digit"
);

fn is_name(text: &str) -> bool {
    let inner = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b"._-".contains(&b);
    text.len() <= 63
        && text.bytes().all(inner)
        && text
            .bytes()
            .next()
            .is_some_and(|b| b.is_ascii_alphanumeric())
}

fn is_label(text: &str) -> bool {
    (1..=64).contains(&text.chars().count()) && text.chars().all(is_printable)
}

fn is_producer(text: &str) -> bool {
    let inner = |b: u8| b.is_ascii_alphanumeric() || b"._:@-".contains(&b);
    text.len() <= 128
        && text.bytes().all(inner)
        && text
            .bytes()
            .next()
            .is_some_and(|b| b.is_ascii_alphanumeric())
}

/// Asks the standard library's own table of printable characters, which it uses to decide what to
/// escape. The letter in front keeps combining marks, which are printable after a letter, from
/// being escaped.
fn is_printable(c: char) -> bool {
    matches!(c, '\\' | '"' | '\'') || format!("a{c}").escape_debug().count() == 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_lower_case_and_short() {
        for good in [
            "hallway",
            "7up",
            "counter_circuit",
            "a.b-c",
            &"x".repeat(63),
        ] {
            assert!(good.parse::<Name>().is_ok(), "{good}");
        }
        for bad in [
            "",
            "Hallway",
            "../etc",
            "a/b",
            ".a",
            "-a",
            "é",
            "a b",
            "a\0",
            &"x".repeat(64),
        ] {
            assert!(bad.parse::<Name>().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn labels_are_printable_unicode() {
        for good in [
            "north",
            "näher",
            "左",
            "e\u{301}",
            "it's \"so\" \\",
            "🤖",
            &"é".repeat(64),
        ] {
            assert!(good.parse::<Label>().is_ok(), "{good:?}");
        }
        for bad in [
            "",
            "a\nb",
            "a\0",
            "\u{200f}north",
            "\u{feff}",
            "a\u{a0}b",
            &"é".repeat(65),
        ] {
            assert!(bad.parse::<Label>().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn producers_may_look_like_hosts() {
        assert!("game-7@eu.example:1".parse::<ProducerId>().is_ok());
        assert!("a/../b".parse::<ProducerId>().is_err());
    }
}
