//! What Nudge talks about: types that cannot be wrong, and the rules that make them so. Nothing
//! here does I/O.
//!
//! The words, used alike in proto, SQL, REST, logs and code:
//!
//! * An **environment** is one named world: a [`Schema`] (its state's **features** and its
//!   **agents**), which never changes, and a [`WrittenRule`], which may; for one pair of agents it
//!   is a [`Rule`].
//! * **Derived features** ([`DerivedFeatures`]) follow from a state's bins, and may change too. A
//!   [`Region`] is the states that match a partial description in both; a [`Grain`] says which are
//!   kept apart.
//! * A **state** is a tuple of feature values; discretised, a tuple of bins, whose [`StateKey`] is
//!   `3.0.7`.
//! * A **joint action** is one action index per agent, as one number, the first agent most
//!   significant.
//! * An **outcome** is a variable observed some steps (its **lag**) after the joint action: an
//!   agent's later action, or another value.
//! * A **transition** is (state, joint action), seen once or `count` times; `entry` says whether it
//!   entered its state. Some agents may be absent from it, and any outcome may be missing.
//! * A **cell** is (state, **segment**, joint action) with its [`Tally`]: visits `n` and `entries`.
//!   Each outcome has a [`Family`] of cells of its own, (state, segment, joint action, value).
//!   Summed over states and segments for each action of each agent, cells are [`ActionTotals`].
//!
//! Input passes through stages, each a type: drafts and [`Records`] (decoded), [`Schema`],
//! [`Question`] and [`Increment`] (valid), [`Receipt`] (committed) and [`Answer`].

pub mod draft;

mod agent;
mod angle;
mod answer;
mod asker;
mod batch;
mod bin_set;
mod checked;
mod coordinate;
mod counts;
mod derived;
mod environment;
mod estimator;
mod family;
mod feature;
mod fit;
mod grain;
mod halves;
mod hash;
mod key;
mod label_set;
mod mixed_radix;
mod model;
mod name;
mod named;
mod near;
mod outcome;
mod overview;
mod pair;
mod policy;
mod presence;
mod principal;
mod profile;
mod question;
mod rank;
mod records;
mod region;
mod region_answer;
mod region_question;
mod region_search;
mod rule;
mod schema;
mod secret;
mod training;
mod values;

pub use agent::Agent;
pub use angle::Angle;
pub use answer::{
    ActionFigures, Answer, Answers, Basis, Bin, Dependence, Evidence, Figures, Holds, Independence,
    Interval, Labels, Probability, Segmentation, Significance, Variable, Verdict,
};
pub use asker::Asker;
pub use batch::{Acknowledged, Batch, Receipt, Sequence};
pub use checked::shortest;
pub use coordinate::{Coordinate, Coordinates};
pub use counts::{ActionTotals, Cell, Counts, Increment, MOST_ACTIONS, SegmentId, States, Tally};
pub use derived::{DerivedFeature, DerivedFeatures};
pub use draft::{RuleDraft, SchemaDraft};
pub use environment::{
    Change, Environment, EnvironmentId, EnvironmentPage, Uid, UnreadableEnvironment,
};
pub use estimator::{Estimator, Estimators};
pub use family::Family;
pub use feature::{BinError, Feature, FeatureKind};
pub use fit::FitId;
pub use grain::{CoarseKey, Grain};
pub use halves::{Half, Halves};
pub use hash::SchemaHash;
pub use key::StateKey;
pub use label_set::LabelSet;
pub use mixed_radix::{Numbers, SlotNumber, SlotNumbers};
pub use model::{
    Baseline, Calibration, Card, Job, JobState, Model, ModelAction, ModelFigures, ModelId,
    ModelKind, Models, Reliability, Score, Training, Weighting, is_same_threshold,
};
pub use name::{Label, Name, ProducerId};
pub use named::SlotValues;
pub use near::{hint, is_near, meant};
pub use outcome::{MOST_LAG, Outcome};
pub use overview::{
    Discoveries, Discovery, DiscoveryMethod, Edge, EdgeKind, Exploration, FittedPrior, Graph,
    HistogramBin, LabelledCell, StateFigures, StatePage, StateView, Suggestion, Summary, page_size,
};
pub use pair::Pair;
pub use policy::Policy;
pub use presence::Presence;
pub use principal::{KeyScope, Pattern, Principal, Scopes};
pub use profile::{Profile, ProfilePoint, ProfileQuestion};
pub use question::{Exchange, MOST_STATES, Permutations, Question, Scope, View, Within};
pub use rank::MOST_RANKED;
pub use records::{
    Collecting, Digest, Entry, Record, Records, Rejection, Undecodable, Widths, Worded,
};
pub use region::{MOST_REGIONS, Region};
pub use region_answer::{AtGrain, RegionAnswer, RegionAnswers, RegionFigures};
pub use region_question::{Asked, RegionQuestion};
pub use region_search::{FoundRegion, RegionSearch, RegionSearchQuestion, left_out};
pub use rule::{Rule, RuleKind, Threshold, Unit, WrittenRule};
pub use schema::Schema;
pub use secret::{KeyDigest, Secret};
pub use values::Values;
