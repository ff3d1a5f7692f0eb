//! Principals: who asks, and what they are authorized to do. How somebody proves to be one is for
//! `access` and `serve`.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use super::Name;
use crate::error::{ErrorKind, Problem};

/// What a key may be for. No scope implies another: a key has those that its line names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum KeyScope {
    /// To ask: questions, lists, metrics, predictions.
    Read,
    /// To send transitions.
    Ingest,
    /// To fit priors, and to train, import, switch and take back networks.
    Train,
    /// To make, change and delete environments, and to delete networks.
    Admin,
}

impl KeyScope {
    /// Every scope.
    pub const ALL: [Self; 4] = [Self::Read, Self::Ingest, Self::Train, Self::Admin];

    /// Returns its word.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Ingest => "ingest",
            Self::Train => "train",
            Self::Admin => "admin",
        }
    }

    const fn bit(self) -> u8 {
        1 << self as u8
    }
}

impl FromStr for KeyScope {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|scope| scope.as_str() == text);
        found.ok_or_else(|| format!("got {text:?}, expected read, ingest, train or admin"))
    }
}

/// A set of scopes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Scopes(u8);

impl Scopes {
    /// Every scope.
    pub const ALL: Self = Self::new(&KeyScope::ALL);

    /// Makes the set of these scopes.
    pub const fn new(scopes: &[KeyScope]) -> Self {
        let (mut bits, mut i) = (0, 0);
        while i < scopes.len() {
            bits |= scopes[i].bit();
            i += 1;
        }
        Self(bits)
    }

    /// Returns whether one of these is among those.
    pub const fn meets(self, others: Self) -> bool {
        self.0 & others.0 != 0
    }

    /// Returns the scopes in their order.
    pub fn iter(self) -> impl Iterator<Item = KeyScope> {
        KeyScope::ALL
            .into_iter()
            .filter(move |scope| self.0 & scope.bit() != 0)
    }

    /// Returns the scopes as a sentence names them: "read or ingest".
    pub fn one_of(self) -> String {
        self.iter()
            .map(KeyScope::as_str)
            .collect::<Vec<_>>()
            .join(" or ")
    }
}

impl FromIterator<KeyScope> for Scopes {
    fn from_iter<I: IntoIterator<Item = KeyScope>>(scopes: I) -> Self {
        scopes
            .into_iter()
            .fold(Self::default(), |set, scope| Self(set.0 | scope.bit()))
    }
}

impl fmt::Display for Scopes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            &self
                .iter()
                .map(KeyScope::as_str)
                .collect::<Vec<_>>()
                .join(","),
        )
    }
}

/// A glob over names: `*` stands for any characters, everything else for itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern(Arc<str>);

impl Pattern {
    /// The longest pattern, as of a name. No key is as short, so that none can stand here by
    /// mistake.
    const LONGEST: usize = 63;

    /// Returns whether a text is of the pattern.
    pub fn matches(&self, text: &str) -> bool {
        let Some((first, rest)) = self.0.split_once('*') else {
            return *self.0 == *text;
        };
        let Some(mut text) = text.strip_prefix(first) else {
            return false;
        };

        let (middle, last) = rest.rsplit_once('*').unwrap_or(("", rest));
        // The earliest place of each part leaves the most room for those behind it.
        for part in middle.split('*') {
            let Some(at) = text.find(part) else {
                return false;
            };
            text = &text[at + part.len()..];
        }
        text.ends_with(last)
    }

    /// Returns the pattern as it was written.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for Pattern {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let is_known = |byte: u8| {
            byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"._-*".contains(&byte)
        };
        let is_pattern = (1..=Self::LONGEST).contains(&text.len()) && text.bytes().all(is_known);
        let expected = "expected names of environments of a-z, 0-9, '.', '_' and '-', where `*` stands for any characters";
        is_pattern
            .then(|| Self(text.into()))
            .ok_or_else(|| format!("got {text:?}, {expected}"))
    }
}

/// Somebody who asks, and what they may do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Principal {
    name: Option<Name>,
    scopes: Scopes,
    /// The environments that there are for them; `None` for all.
    environments: Option<Vec<Pattern>>,
}

impl Principal {
    /// Makes the principal of a key of that name; without patterns every environment is theirs.
    pub fn named(name: Name, scopes: Scopes, environments: Option<Vec<Pattern>>) -> Self {
        Self {
            name: Some(name),
            scopes,
            environments,
        }
    }

    /// Makes the one who asks where nobody needs a key: they may do everything, and have no name.
    pub fn anonymous() -> Self {
        Self {
            name: None,
            scopes: Scopes::ALL,
            environments: None,
        }
    }

    /// Makes one who may do nothing.
    pub fn nobody() -> Self {
        Self {
            name: None,
            scopes: Scopes::default(),
            environments: Some(Vec::new()),
        }
    }

    /// Returns the name, which producers belong to.
    pub fn name(&self) -> Option<&Name> {
        self.name.as_ref()
    }

    /// Returns whether every environment is theirs.
    pub fn is_everywhere(&self) -> bool {
        self.environments.is_none()
    }

    /// Returns whether an environment of that name is theirs, should there be one.
    pub fn may_see(&self, environment: &str) -> bool {
        let is_theirs =
            |patterns: &Vec<Pattern>| patterns.iter().any(|pattern| pattern.matches(environment));
        self.environments.as_ref().is_none_or(is_theirs)
    }

    /// Refuses whoever has none of these scopes.
    pub fn authorize(&self, wanted: Scopes) -> Result<(), Problem> {
        if self.scopes.meets(wanted) {
            return Ok(());
        }

        let (who, scopes) = (self.title(), self.scopes);
        let message = format!(
            "{who} has the scopes [{scopes}], and this wants {}",
            wanted.one_of()
        );

        Err(Problem::new(ErrorKind::Forbidden, "SCOPE_MISSING", message)
            .with("scope", wanted.one_of()))
    }

    /// Refuses an environment that is not theirs, whether it exists or not.
    pub fn admit_to(&self, environment: &str) -> Result<(), Problem> {
        if self.may_see(environment) {
            return Ok(());
        }

        let patterns = self
            .environments
            .iter()
            .flatten()
            .map(Pattern::as_str)
            .collect::<Vec<_>>()
            .join(", ");
        let message = format!(
            "{} is not for environment `{environment}`, but for [{patterns}]",
            self.title()
        );

        Err(Problem::new(
            ErrorKind::Forbidden,
            "ENVIRONMENT_FORBIDDEN",
            message,
        ))
    }

    /// Refuses whoever asks for the whole service and may see a part of it.
    pub fn admit_everywhere(&self) -> Result<(), Problem> {
        if self.is_everywhere() {
            return Ok(());
        }

        let message = format!(
            "{} is for some environments, and this tells of all",
            self.title()
        );

        Err(Problem::new(
            ErrorKind::Forbidden,
            "ENVIRONMENT_FORBIDDEN",
            message,
        ))
    }

    /// Returns what the principal is called in a refusal.
    fn title(&self) -> String {
        self.name
            .as_ref()
            .map_or_else(|| "nobody".into(), |name| format!("key `{name}`"))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pattern(text: &str) -> Pattern {
        text.parse().expect("a pattern")
    }

    #[test]
    fn patterns_match_whole_names() {
        for (glob, yes, no) in [
            (
                "hallway",
                &["hallway"][..],
                &["hallway2", "a-hallway", ""][..],
            ),
            (
                "hallway*",
                &["hallway", "hallway-7"],
                &["hall", "a-hallway"],
            ),
            ("*-test", &["a-test", "-test"], &["a-tests", "test"]),
            (
                "a*b*c",
                &["abc", "a-b-c", "abbc", "abcbc"],
                &["ac", "ab", "acb", "bc"],
            ),
            ("a*a", &["aa", "aba"], &["a"]),
            ("*", &["", "a"], &[]),
            ("**", &["", "a"], &[]),
        ] {
            yes.iter()
                .for_each(|name| assert!(pattern(glob).matches(name), "{glob} {name}"));
            no.iter()
                .for_each(|name| assert!(!pattern(glob).matches(name), "{glob} {name}"));
        }
        for wrong in ["", "Hall", "a b", "a?", "[ab]", "é", &"a".repeat(64)] {
            assert!(wrong.parse::<Pattern>().is_err(), "{wrong}");
        }
    }

    /// A matcher that tries everything.
    fn tried(glob: &[u8], text: &[u8]) -> bool {
        match glob.split_first() {
            None => text.is_empty(),
            Some((b'*', rest)) => (0..=text.len()).any(|at| tried(rest, &text[at..])),
            Some((first, rest)) => text.first() == Some(first) && tried(rest, &text[1..]),
        }
    }

    proptest! {
        #[test]
        fn patterns_match_what_trying_everything_finds(glob in "[ab*]{1,8}", text in "[ab]{0,8}") {
            prop_assert_eq!(pattern(&glob).matches(&text), tried(glob.as_bytes(), text.as_bytes()));
        }
    }

    #[test]
    fn no_scope_implies_another() {
        for scope in KeyScope::ALL {
            let principal =
                Principal::named("k".parse().expect("a name"), Scopes::new(&[scope]), None);
            for wanted in KeyScope::ALL {
                assert_eq!(
                    principal.authorize(Scopes::new(&[wanted])).is_ok(),
                    scope == wanted
                );
            }
            assert!(principal.authorize(Scopes::ALL).is_ok());
            assert_eq!(scope.as_str().parse(), Ok(scope));
            Principal::anonymous()
                .authorize(Scopes::new(&[scope]))
                .expect("everything");
            Principal::nobody()
                .authorize(Scopes::new(&[scope]))
                .expect_err("nothing");
        }
    }

    #[test]
    fn an_environment_is_refused_by_its_name_alone() {
        let theirs = Some(vec![pattern("hall*"), pattern("lane")]);
        let principal = Principal::named("k".parse().expect("a name"), Scopes::ALL, theirs);
        assert!(
            ["hallway", "lane"]
                .iter()
                .all(|name| principal.admit_to(name).is_ok())
        );
        let refused = principal.admit_to("kitchen").expect_err("another's");
        assert_eq!(
            (refused.kind, refused.reason),
            (ErrorKind::Forbidden, "ENVIRONMENT_FORBIDDEN")
        );
        assert!(principal.admit_everywhere().is_err() && !Principal::nobody().may_see("lane"));
    }
}
