//! Words: the texts that a member may have, for the OpenAPI document. Each list is made of the
//! words that are told: the domain's own, or those for the enums of proto.

use std::borrow::Cow;

use nudge_core::domain;
use nudge_core::information::{ExpectedMethod, Method as SignificanceMethod};
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use crate::proto;

macro_rules! words {
    ($($(#[doc = $doc:literal])* $name:ident = $words:expr;)*) => {$(
        $(#[doc = $doc])*
        pub struct $name;

        impl PartialSchema for $name {
            fn schema() -> RefOr<Schema> {
                let description = concat!($($doc),*).trim();
                ObjectBuilder::new().schema_type(Type::String).description(Some(description)).enum_values(Some($words)).into()
            }
        }

        impl ToSchema for $name {
            fn name() -> Cow<'static, str> {
                stringify!($name).into()
            }
        }
    )*};
}

words! {
    /// The unit of figures of information.
    Unit = [domain::Unit::Nats, domain::Unit::Bits].map(domain::Unit::as_str);
    /// Which rule decides.
    RuleKind = [domain::RuleKind::Evidence, domain::RuleKind::Paper].map(domain::RuleKind::as_str);
    /// An estimator of mutual information.
    Estimator = domain::Estimator::ALL.map(domain::Estimator::as_str);
    /// What is compared within each segment alone.
    Within = domain::Within::ALL.map(domain::Within::as_str);
    /// How much is told of a state.
    View = [domain::View::Verdict, domain::View::Figures, domain::View::Full].map(domain::View::as_str);
    /// What a test of independence may exchange.
    Permutations = domain::Permutations::ALL.map(domain::Permutations::as_str);
    /// Whether there is influence.
    Verdict = domain::Verdict::ALL.map(domain::Verdict::as_str);
    /// Whether there is any dependence at all.
    Dependence = domain::Dependence::ALL.map(domain::Dependence::as_str);
    /// What a verdict rests on.
    BasisKind = [domain::Basis::Counts(0), domain::Basis::Model(0), domain::Basis::Prior].map(domain::Basis::as_str);
    /// What evidence takes for independent draws.
    Independence = [domain::Independence::Entries, domain::Independence::Assumed].map(domain::Independence::as_str);
    /// How a mean under independence was found.
    NullMethod =
        [ExpectedMethod::Hypergeometric, ExpectedMethod::Asymptotic, ExpectedMethod::Permutation].map(ExpectedMethod::as_str);
    /// How a test of independence was made.
    TestMethod =
        [SignificanceMethod::Exact, SignificanceMethod::Permutation, SignificanceMethod::GTest].map(SignificanceMethod::as_str);
    /// What a pair of agents is beside all others.
    EdgeKind = domain::EdgeKind::ALL.map(domain::EdgeKind::as_str);
    /// What a network predicts.
    ModelKind = [domain::ModelKind::Joint, domain::ModelKind::Direct].map(domain::ModelKind::as_str);
    /// How much a state counts.
    Weighting = [domain::Weighting::Visits, domain::Weighting::States].map(domain::Weighting::as_str);
    /// How far a job is.
    JobState = [
        domain::JobState::Queued,
        domain::JobState::Running,
        domain::JobState::Done,
        domain::JobState::Failed,
        domain::JobState::Cancelled,
    ]
    .map(domain::JobState::as_str);
    /// What became of a batch.
    BatchStatus = BATCH_STATUSES.map(batch_status);
    /// How discoveries are found.
    DiscoveryMethod =
        [domain::DiscoveryMethod::Bayes, domain::DiscoveryMethod::Bh].map(domain::DiscoveryMethod::as_str);
    /// What angles are measured in.
    AngleUnit = [domain::Angle::Radians, domain::Angle::Degrees].map(domain::Angle::as_str);
}

const BATCH_STATUSES: [proto::BatchStatus; 4] = [
    proto::BatchStatus::Applied,
    proto::BatchStatus::Rejected,
    proto::BatchStatus::Duplicate,
    proto::BatchStatus::Unverified,
];

/// Returns the word for what became of a batch.
pub(super) fn batch_status(status: proto::BatchStatus) -> &'static str {
    match status {
        proto::BatchStatus::Applied => "applied",
        proto::BatchStatus::Duplicate => "duplicate",
        proto::BatchStatus::Unverified => "unverified",
        proto::BatchStatus::Rejected => "rejected",
        proto::BatchStatus::Unspecified => "unknown",
    }
}
