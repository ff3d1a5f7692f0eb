//! An environment as the store keeps it.

use std::fmt;
use std::sync::Arc;

use super::{Coordinates, DerivedFeatures, Name, Pair, Rule, Schema, WrittenRule};

/// The store's number of an environment; never used twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EnvironmentId(pub i64);

/// What tells an environment from an earlier one of the same name. Given by the server, never
/// reused.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Uid(pub String);

impl fmt::Display for Uid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// One named world.
#[derive(Debug, Clone, PartialEq)]
pub struct Environment {
    /// The store's number of it.
    pub id: EnvironmentId,
    /// The server's name of it for ever.
    pub uid: Uid,
    /// The name that people use.
    pub name: Name,
    /// Its state and agents, which never change.
    pub schema: Schema,
    /// Its derived features, which may.
    pub derived: DerivedFeatures,
    /// Its decision rule, which may.
    pub rule: WrittenRule,
}

/// What is to be changed of an environment; what is absent is kept.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Change {
    /// Its derived features.
    pub derived: Option<DerivedFeatures>,
    /// Its decision rule.
    pub rule: Option<WrittenRule>,
}

impl From<WrittenRule> for Change {
    fn from(rule: WrittenRule) -> Self {
        Self {
            rule: Some(rule),
            ..Self::default()
        }
    }
}

impl Environment {
    /// Returns the coordinates that its states are described by.
    pub fn coordinates(&self) -> Coordinates {
        Coordinates::new(&self.schema, &self.derived)
    }

    /// Makes one that the store has no number for yet, without derived features and by the default
    /// rule.
    pub fn new(uid: Uid, name: Name, schema: Schema) -> Self {
        Self {
            id: EnvironmentId(0),
            uid,
            name,
            schema,
            derived: DerivedFeatures::default(),
            rule: WrittenRule::default(),
        }
    }

    /// Returns this environment with a change.
    pub fn with(&self, change: &Change) -> Self {
        let derived = change.derived.as_ref().unwrap_or(&self.derived);
        Self {
            derived: derived.clone(),
            rule: change.rule.clone().unwrap_or_else(|| self.rule.clone()),
            ..self.clone()
        }
    }

    /// Returns its rule for one pair of agents.
    pub fn rule_of(&self, pair: &Pair) -> Rule {
        self.rule.resolved(pair.alphabet(&self.schema))
    }
}

/// An environment whose description or rule cannot be read: nothing can be asked of it or counted
/// in it, but it can be listed and deleted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnreadableEnvironment {
    /// The store's number of it.
    pub id: EnvironmentId,
    /// The server's name of it for ever.
    pub uid: Uid,
    /// The name that people use.
    pub name: String,
    /// What cannot be read, and why.
    pub why: String,
}

/// A page of environments.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvironmentPage {
    /// In order of name.
    pub environments: Vec<Arc<Environment>>,
    /// Those that cannot be read, in order of name; all of them on the first page.
    pub unreadable: Vec<Arc<UnreadableEnvironment>>,
    /// Asks for the next page; `None` on the last.
    pub next_page_token: Option<String>,
}
