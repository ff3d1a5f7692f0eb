//! Between JSON and the domain: requests become drafts, which the domain checks; answers are made
//! of proto messages, so that a gRPC answer and a REST answer are the same JSON.
//!
//! The doc comments here are the descriptions of the OpenAPI document. Nothing here knows HTTP.

mod answer;
mod card;
mod decode;
mod description;
mod environment;
mod evidence;
mod exploration;
mod graph;
mod labels;
mod loose;
mod model;
mod overview;
mod parameters;
mod prediction;
mod problem;
mod profile;
mod query;
mod question;
mod receipt;
mod record;
mod region;
mod region_search;
mod rule;
mod transitions;
mod whole;
mod words;

pub use answer::{
    ActionFigures, Answer, Answers, Basis, MutualInformation, Strata, Stratified, verdict,
};
pub use card::{Calibration, Card, Reliability, Score, Training, model_kind, weighting};
pub use decode::decode;
pub use description::{
    Agent, Categorical, Circular, Continuous, DerivedFeature, Description, EnvironmentChange,
    Feature, Integer, Outcome, description_of_text,
};
pub use environment::{Environment, EnvironmentPage, UnreadableEnvironment};
pub use evidence::{Fit, Fits, FittedPrior, Probability, Segmentation, Significance, dependence};
pub use exploration::{Exploration, Trial};
pub use graph::{Edge, Graph, edge_kind};
pub use labels::{Bin, Labels, State, Variable};
pub use model::{
    Job, Model, ModelOrJob, Models, RolledBack, TrainingRequest, job_state, model_id, model_version,
};
pub use overview::{
    Cell, Counts, DependenceCounts, Discoveries, HistogramBin, StateFigures, StatePage, Summary,
    Thresholds, VerdictCounts,
};
pub use parameters::Parameters;
pub use prediction::{ModelAction, ModelFigures};
pub use problem::{Fault, Problem};
pub use profile::{Profile, ProfilePoint, ProfileQuestion};
pub use query::{
    exploration, fit, graph, head_of_query, listing, no_head, page, profile, question_of_query,
    region_search, summary,
};
pub use question::{NamedState, Question};
pub use receipt::{Producer, Receipt, Rejection};
pub use region::Region;
pub use region_search::{FoundRegion, RegionSearch, RegionSearchQuestion};
pub use rule::Rule;
pub use transitions::{
    Action, FeatureValue, Head, Incoming, Transition, Transitions, batch_of_json, batch_of_lines,
};
pub use whole::{perhaps_whole, wholes};
pub use words::{DiscoveryMethod, Estimator, Permutations, RuleKind, Unit, Verdict, View, Within};
