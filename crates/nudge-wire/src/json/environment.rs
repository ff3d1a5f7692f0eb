//! Environments as the service keeps them.

use nudge_core::domain::SchemaDraft;
use nudge_core::domain::draft::DerivedDraft;
use serde::Serialize;
use utoipa::ToSchema;

use super::{Agent, DerivedFeature, Feature, Outcome, Rule};
use crate::{present, proto};

/// An environment as the service keeps it. It is a description too: `PUT` takes it as it is.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Environment {
    /// The name that people use.
    #[schema(example = "hallway", pattern = "^[a-z0-9][a-z0-9._-]{0,62}$")]
    pub name: String,
    /// The service's name of it, never reused.
    pub uid: String,
    /// BLAKE3 of state, agents and outcomes, 64 hexadecimal digits.
    #[schema(pattern = "^[0-9a-f]{64}$")]
    pub schema_hash: String,
    /// The coordinates of the state.
    pub state: Vec<Feature>,
    /// The agents.
    pub agents: Vec<Agent>,
    /// What is observed some steps later; absent where there is nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub outcomes: Vec<Outcome>,
    /// The derived features, in order; absent where there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub derived: Vec<DerivedFeature>,
    /// The rule, every part present, and of `threshold` and `share` the one that was given.
    pub rule: Rule,
}

/// A page of environments.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct EnvironmentPage {
    /// In order of name.
    pub environments: Vec<Environment>,
    /// Asks for the next page; null on the last.
    pub next_page_token: Option<String>,
    /// Those whose stored description or rule this build cannot read, in order of name; all of them
    /// on the first page. Absent where there is none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub unreadable: Vec<UnreadableEnvironment>,
}

/// An environment that cannot be read. Every call on it but DELETE is refused with 409 and the
/// reason ENVIRONMENT_UNREADABLE.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct UnreadableEnvironment {
    /// The name that people use.
    #[schema(pattern = "^[a-z0-9][a-z0-9._-]{0,62}$")]
    pub name: String,
    /// The service's name of it, never reused.
    pub uid: String,
    /// In a sentence: what cannot be read, and why.
    pub unreadable: String,
}

impl From<proto::Environment> for Environment {
    fn from(environment: proto::Environment) -> Self {
        let schema = SchemaDraft::from(environment.schema.unwrap_or_default());
        Self {
            name: environment.name,
            uid: environment.uid,
            schema_hash: environment
                .schema_hash
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect(),
            state: schema.state.into_iter().map(Into::into).collect(),
            agents: schema.agents.into_iter().map(Into::into).collect(),
            outcomes: schema.outcomes.into_iter().map(Into::into).collect(),
            derived: environment
                .derived
                .into_iter()
                .map(|feature| DerivedDraft::from(feature).into())
                .collect(),
            rule: environment.rule.unwrap_or_default().into(),
        }
    }
}

impl From<proto::ListEnvironmentsResponse> for EnvironmentPage {
    fn from(page: proto::ListEnvironmentsResponse) -> Self {
        Self {
            environments: page.environments.into_iter().map(Into::into).collect(),
            next_page_token: present(page.next_page_token),
            unreadable: page.unreadable.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::UnreadableEnvironment> for UnreadableEnvironment {
    fn from(environment: proto::UnreadableEnvironment) -> Self {
        let proto::UnreadableEnvironment {
            name,
            uid,
            unreadable,
        } = environment;
        Self {
            name,
            uid,
            unreadable,
        }
    }
}
