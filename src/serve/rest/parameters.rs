//! The parameters of query strings, as the OpenAPI document describes them. They are read
//! elsewhere: `api::json::Parameters`.

use std::collections::BTreeMap;

use utoipa::IntoParams;

use crate::api::json;

/// Whose influence on whom.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct PairParameters {
    /// The agent whose influence is asked about; the first by default.
    ego: Option<String>,
    /// The agent that may be influenced; the second by default. Or an outcome with values.
    other: Option<String>,
    /// How many steps later the other's action is observed, one of the lags that are declared for
    /// it; 0, the default, for the same tick. The other's own action one step before, as far as that
    /// is declared, is held fixed too. An outcome with values has a lag of its own.
    #[param(minimum = 0, maximum = 64, example = 3)]
    lag: Option<i64>,
    /// Agents whose actions are held fixed, repeated or joined by commas.
    given: Option<Vec<String>>,
}

/// From which counts, and in which unit.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct SegmentParameters {
    /// The segments to count, repeated or joined by commas; all by default. A segment whose label
    /// holds a comma can be asked for in a body only.
    segments: Option<Vec<String>>,
    /// What is compared within each segment alone: `auto` (the default) tests of independence only,
    /// `segments` the plug-in and its mean under independence too, `pooled` nothing.
    #[param(example = "auto")]
    within: Option<json::Within>,
    /// The unit of the figures, `nats` or `bits`; the rule's by default.
    unit: Option<json::Unit>,
}

/// Whose habits weigh the ego's actions.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct PolicyParameters {
    /// Whose habits weigh the ego's actions: `observed` (the default) or `uniform`, every action in use
    /// alike. Responses are by all visits.
    #[param(pattern = "^(observed|uniform)$")]
    policy: Option<String>,
    /// Segments whose habits weigh the ego's actions, repeated or joined by commas, instead of
    /// `policy`.
    #[param(rename = "policy.segments")]
    policy_segments: Option<Vec<String>>,
}

/// The parts of the rule that differ from the environment's.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct RuleParameters {
    /// `evidence` or `paper`; the environment's by default.
    #[param(rename = "rule.kind")]
    rule_kind: Option<json::RuleKind>,
    /// Mutual information above which there is influence, in `rule.unit`, else in the unit of the
    /// environment's rule.
    #[param(rename = "rule.threshold", minimum = 0)]
    rule_threshold: Option<f64>,
    /// The threshold as a share of the most that the pair can have, at least 0 and below 1. Instead
    /// of `rule.threshold`.
    #[param(rename = "rule.share", minimum = 0, exclusive_maximum = 1)]
    rule_share: Option<f64>,
    /// `nats` or `bits`. Given without a threshold, it converts the threshold.
    #[param(rename = "rule.unit")]
    rule_unit: Option<json::Unit>,
    /// Visits below which the paper's rule stays undecided.
    #[param(rename = "rule.min_visits", maximum = 9_223_372_036_854_775_807_i64)]
    rule_min_visits: Option<u64>,
    /// Probability from which the evidence rule decides, above 0.5 and below 1.
    #[param(
        rename = "rule.confidence",
        exclusive_minimum = 0.5,
        exclusive_maximum = 1
    )]
    rule_confidence: Option<f64>,
}

/// One state.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct StateParameters {
    /// The state by values: a parameter `state.NAME` a feature, its number in the feature's unit or
    /// its label. Instead of `key`.
    #[param(style = Form, explode, value_type = BTreeMap<String, String>, example = json!({"state.distance": "1.2", "state.held": "onion"}), required = false)]
    state: Option<BTreeMap<String, String>>,
    /// The state by key: bin numbers joined by dots. Instead of values.
    #[param(example = "3.0.7", pattern = r"^[0-9]+(\.[0-9]+)*$")]
    key: Option<String>,
}

/// One region, instead of a state.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct RegionParameters {
    /// All states of a region, asked about as one: a parameter `region.NAME` a condition on a feature
    /// of the state or a derived one, `1`, `onion,dish`, `1..2` or `#0,#1` for bins by number; or
    /// `region={}` for all states. Instead of a state.
    #[param(style = Form, explode, value_type = BTreeMap<String, String>, example = json!({"region.distance": "1..2", "region.held": "onion,dish"}), required = false)]
    region: Option<BTreeMap<String, String>>,
    /// The grain of the region: features that are kept, repeated or joined by commas; all by default.
    features: Option<Vec<String>>,
}

/// How much is wanted about a state.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct FigureParameters {
    /// Further estimators of mutual information, repeated or joined by commas, instead of the
    /// environment's: `excess`, `miller_madow`, `chao_shen`, `james_stein`, `grassberger_2003`,
    /// `nsb`, `dirichlet`, `adjusted`, `uniform_policy`.
    estimators: Option<Vec<json::Estimator>>,
    /// `verdict`, `figures` or `full` (the default).
    view: Option<json::View>,
    /// Wants the test of independence: `auto` to follow `within`, or `pooled`, or `within_segments`
    /// to permute within each segment only.
    significance: Option<json::Permutations>,
    /// Wants to know how many more visits a verdict would take.
    visits_to_decide: Option<bool>,
}

/// Whose profile, from which counts, in which region.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct ProfileParameters {
    /// The agent whose influence is asked about; the first by default.
    ego: Option<String>,
    /// The agent that may be influenced; the second by default. Or an outcome with values.
    other: Option<String>,
    /// Agents whose actions are held fixed, repeated or joined by commas.
    given: Option<Vec<String>>,
    /// The segments to count, repeated or joined by commas; all by default.
    segments: Option<Vec<String>>,
    /// Whether actions are compared within each segment alone: `auto` (the default) and `segments`
    /// say yes, `pooled` no.
    #[param(example = "auto")]
    within: Option<json::Within>,
    /// The unit of the figures, `nats` or `bits`; the rule's by default.
    unit: Option<json::Unit>,
    /// The states that are asked about: a parameter `region.NAME` a condition on a feature of the
    /// state or a derived one, `1`, `onion,dish`, `1..2` or `#0,#1` for bins by number.
    #[param(style = Form, explode, value_type = BTreeMap<String, String>, example = json!({"region.distance": "1..2", "region.held": "onion,dish"}), required = false)]
    region: Option<BTreeMap<String, String>>,
    /// The lags, repeated or joined by commas; 0 and all that are declared for the other by default.
    lags: Option<Vec<i64>>,
}

/// Whose regions, from which counts, within which region.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct RegionSearchParameters {
    /// The agent whose influence is asked about; the first by default.
    ego: Option<String>,
    /// The agent that may be influenced; the second by default. Or an outcome with values.
    other: Option<String>,
    /// How many steps later the other's action is observed; 0, the same tick, by default.
    #[param(minimum = 0, maximum = 64)]
    lag: Option<i64>,
    /// Agents whose actions are held fixed, repeated or joined by commas.
    given: Option<Vec<String>>,
    /// The segments to count, repeated or joined by commas; all by default.
    segments: Option<Vec<String>>,
    /// Whether actions are compared within each segment alone, and segments dealt into halves: `auto`
    /// (the default) and `segments` say yes, `pooled` no.
    #[param(example = "auto")]
    within: Option<json::Within>,
    /// The unit of the figures, `nats` or `bits`; the rule's by default.
    unit: Option<json::Unit>,
    /// The states that are searched: a parameter `region.NAME` a condition on a feature of the state
    /// or a derived one, `1`, `onion,dish`, `1..2` or `#0,#1` for bins by number.
    #[param(style = Form, explode, value_type = BTreeMap<String, String>, example = json!({"region.distance": "1..2", "region.held": "onion,dish"}), required = false)]
    region: Option<BTreeMap<String, String>>,
    /// The most regions that are tested; 10 by default, which 0 means too.
    #[param(minimum = 0, maximum = 10)]
    most: Option<u64>,
    /// The share of false ones among the regions told that is accepted on average; .05 by default.
    #[param(example = 0.05)]
    fdr: Option<f64>,
}

/// Which states, in which order.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct ListingParameters {
    /// `visits` (the default), `plug_in`, `posterior_mean` or `p_dependent`, then `desc` (the
    /// default) or `asc`.
    #[param(
        example = "visits desc",
        pattern = "^(visits|plug_in|posterior_mean|p_dependent)( (asc|desc))?$"
    )]
    order_by: Option<String>,
    /// Leaves out states with fewer visits.
    min_visits: Option<u64>,
    /// Leaves out states with another verdict: `influences`, `no_influence` or `undecided`.
    verdict: Option<json::Verdict>,
    /// The most to return, 1 to 1,000; 100 by default, which 0 means too.
    #[param(minimum = 0, maximum = 1_000)]
    page_size: Option<u32>,
    /// The `next_page_token` of the page before.
    page_token: Option<String>,
}

/// Which states are discoveries.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct DiscoveryParameters {
    /// The false discovery rate that is accepted, above 0 and below 1: pages then hold discoveries
    /// only, and the summary counts them.
    #[param(example = 0.05, exclusive_minimum = 0, exclusive_maximum = 1)]
    fdr: Option<f64>,
    /// `bayes` (the default), by the probability of dependence, or `bh`, Benjamini and Hochberg's
    /// procedure on tests of independence.
    method: Option<json::DiscoveryMethod>,
}

/// What a summary leaves out.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct SummaryParameters {
    /// Whether the names of the segments are left out, of which there may be thousands; false by
    /// default.
    #[param(example = true)]
    omit_segments: Option<bool>,
}

/// What to try, and how much of it.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct ExplorationParameters {
    /// Leaves out states with fewer visits.
    min_visits: Option<u64>,
    /// The most to return, 1 to 1,000; 100 by default, which 0 means too.
    #[param(minimum = 0, maximum = 1_000)]
    limit: Option<u32>,
}
