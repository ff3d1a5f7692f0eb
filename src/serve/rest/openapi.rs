//! The OpenAPI document: every route, what it takes and how it refuses.

use std::collections::BTreeMap;

use utoipa::openapi::response::Response;
use utoipa::openapi::{ContentBuilder, Ref, RefOr, ResponseBuilder};
use utoipa::{IntoParams, IntoResponses, OpenApi};

use super::{environments, graph, influence, learning, models, states, summary, transitions};
use crate::api::json;

/// Returns the document.
pub fn document() -> utoipa::openapi::OpenApi {
    Document::openapi()
}

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Nudge",
        description = "Tells when one agent's action influences another's: in this state, how strongly, how sure, and which actions do it.\n\n\
            Every information figure stands beside its unit and beside its mean under independence: at few visits plug-in mutual information is \
            mostly bias. At lag 0 an answer states dependence given the state; that it runs from ego to other is the caller's assumption.",
        license(name = "MIT", identifier = "MIT"),
    ),
    paths(
        environments::list_environments,
        environments::apply_environment,
        environments::get_environment,
        environments::update_rule,
        environments::delete_environment,
        transitions::write_transitions,
        transitions::get_producer,
        influence::get_influence,
        influence::batch_get_influence,
        states::list_states,
        states::get_state,
        summary::summarize,
        graph::get_graph,
        learning::explore,
        learning::fit_prior,
        models::train_model,
        models::list_models,
        models::get_model,
        models::delete_model,
        models::activate_model,
        models::roll_back_model,
        models::export_model,
        models::import_model,
    ),
    components(schemas(json::Problem, json::Fault)),
    tags(
        (name = "environments", description = "Named worlds: what their states and agents are, and the rule that decides"),
        (name = "transitions", description = "What was seen, each counted exactly once"),
        (name = "influence", description = "In this state, does the ego's action influence the other's?"),
        (name = "states", description = "Where is influence highest, and what was counted there?"),
        (name = "summary", description = "What all states say together"),
        (name = "models", description = "Networks that answer where counts do not decide"),
    ),
)]
struct Document;

/// Whose influence on whom, from which counts, by which rule.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct PairParameters {
    /// The agent whose influence is asked about; the first by default.
    ego: Option<String>,
    /// The agent that may be influenced; the second by default.
    other: Option<String>,
    /// Agents whose actions are held fixed, repeated or joined by commas.
    given: Option<Vec<String>>,
    /// The segments to count, repeated or joined by commas; all by default. A segment whose label holds a comma can be asked for in a body only.
    segments: Option<Vec<String>>,
    /// What is compared within each segment alone: `auto` (the default) tests of independence only, `segments` the plug-in and its mean under
    /// independence too, `pooled` nothing.
    #[param(example = "auto")]
    within: Option<String>,
    /// The unit of the figures, `nats` or `bits`; the rule's by default.
    unit: Option<String>,
    /// `evidence` or `paper`; the environment's by default.
    #[param(rename = "rule.kind")]
    rule_kind: Option<String>,
    /// Mutual information above which there is influence, in `rule.unit`, else in the unit of the environment's rule.
    #[param(rename = "rule.threshold")]
    rule_threshold: Option<f64>,
    /// The threshold as a share of the most that the pair can have, at least 0 and below 1. Instead of `rule.threshold`.
    #[param(rename = "rule.share")]
    rule_share: Option<f64>,
    /// `nats` or `bits`. Given without a threshold, it converts the threshold.
    #[param(rename = "rule.unit")]
    rule_unit: Option<String>,
    /// Visits below which the paper's rule stays undecided.
    #[param(rename = "rule.min_visits")]
    rule_min_visits: Option<u64>,
    /// Probability from which the evidence rule decides, above 0.5 and below 1.
    #[param(rename = "rule.confidence")]
    rule_confidence: Option<f64>,
}

/// One state, and how much is wanted about it.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct StateParameters {
    /// The state by values: a parameter `state.NAME` a feature, its number in the feature's unit or its label. Instead of `key`.
    #[param(style = Form, explode, value_type = BTreeMap<String, String>, example = json!({"state.distance": "1.2", "state.held": "onion"}), required = false)]
    state: Option<BTreeMap<String, String>>,
    /// The state by key: bin numbers joined by dots. Instead of values.
    #[param(example = "3.0.7")]
    key: Option<String>,
    /// Further estimators of mutual information, repeated or joined by commas, instead of the environment's: `excess`, `miller_madow`,
    /// `chao_shen`, `james_stein`, `grassberger_2003`, `nsb`, `dirichlet`, `adjusted`, `uniform_policy`.
    estimators: Option<Vec<String>>,
    /// `verdict`, `figures` or `full` (the default).
    view: Option<String>,
    /// Wants the test of independence: `auto` to follow `within`, or `pooled`, or `within_segments` to permute within each segment only.
    significance: Option<String>,
    /// Wants to know how many more visits a verdict would take.
    visits_to_decide: Option<bool>,
}

/// Which states, in which order.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct ListingParameters {
    /// `visits` (the default), `plug_in`, `posterior_mean` or `p_dependent`, then `desc` (the default) or `asc`.
    #[param(example = "visits desc")]
    order_by: Option<String>,
    /// Leaves out states with fewer visits.
    min_visits: Option<u64>,
    /// Leaves out states with another verdict: `influences`, `no_influence` or `undecided`.
    verdict: Option<String>,
    /// The most to return, 1 to 1,000; 100 by default.
    page_size: Option<u32>,
    /// The `next_page_token` of the page before.
    page_token: Option<String>,
}

/// Which states are discoveries.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct DiscoveryParameters {
    /// The false discovery rate that is accepted, above 0 and below 1: pages then hold discoveries only, and the summary counts them.
    #[param(example = 0.05)]
    fdr: Option<f64>,
    /// `bayes` (the default), by the probability of dependence, or `bh`, Benjamini and Hochberg's procedure on tests of independence.
    method: Option<String>,
}

/// What a summary leaves out.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct SummaryParameters {
    /// Whether the names of the segments are left out, of which there may be thousands; false by default.
    #[param(example = true)]
    omit_segments: Option<bool>,
}

/// Which state, from which counts, by which rule.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct GraphParameters {
    /// The state by values: a parameter `state.NAME` a feature. Instead of `key`.
    #[param(style = Form, explode, value_type = BTreeMap<String, String>, example = json!({"state.distance": "1.2"}), required = false)]
    state: Option<BTreeMap<String, String>>,
    /// The state by key: bin numbers joined by dots. Instead of values.
    #[param(example = "3.0.7")]
    key: Option<String>,
    /// The segments to count, repeated or joined by commas; all by default.
    segments: Option<Vec<String>>,
    /// What is compared within each segment alone: `auto` (the default) tests of independence only, `segments` the plug-in and its mean under
    /// independence too, `pooled` nothing.
    #[param(example = "auto")]
    within: Option<String>,
    /// The unit of the figures, `nats` or `bits`; the rule's by default.
    unit: Option<String>,
}

/// What to try, and how much of it.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct ExplorationParameters {
    /// Leaves out states with fewer visits.
    min_visits: Option<u64>,
    /// The most to return, 1 to 1,000; 100 by default.
    limit: Option<u32>,
}

/// How every route refuses: with a problem.
pub struct Refusals;

impl IntoResponses for Refusals {
    fn responses() -> BTreeMap<String, RefOr<Response>> {
        const REFUSALS: [(&str, &str); 7] = [
            ("400", "The input is wrong; its faults are listed"),
            ("404", "The thing named does not exist"),
            ("409", "The request contradicts what is stored, or a sequence is ahead"),
            ("413", "The body, the batch or the answer is too large"),
            ("415", "The body is of another type"),
            ("500", "A defect; the cause is in the log"),
            ("503", "Not now, or no answer in time: where there is a `Retry-After`, ask again after it"),
        ];
        REFUSALS.into_iter().map(|(status, description)| (status.to_owned(), refusal(description))).collect()
    }
}

fn refusal(description: &str) -> RefOr<Response> {
    let problem = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
    ResponseBuilder::new().description(description).content("application/problem+json", problem).build().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_route_is_described_with_its_problems() {
        let document = serde_json::to_value(document()).expect("JSON");
        assert!(document["openapi"].as_str().expect("a version").starts_with("3.1"));
        assert_eq!(document["info"]["version"], env!("CARGO_PKG_VERSION"));
        assert_eq!(document["info"]["license"]["identifier"], "MIT");
        let paths = document["paths"].as_object().expect("paths");
        let operations: Vec<_> =
            paths.values().flat_map(|path| path.as_object().expect("operations").values()).collect();
        assert_eq!(operations.len(), 23);
        for operation in operations {
            let refused = &operation["responses"]["400"]["content"]["application/problem+json"]["schema"]["$ref"];
            assert_eq!(refused, "#/components/schemas/Problem");
        }
    }

    #[test]
    fn every_reference_leads_somewhere() {
        let document = serde_json::to_value(document()).expect("JSON");
        let text = document.to_string();
        for reference in text.split("\"#/components/schemas/").skip(1) {
            let name = reference.split('"').next().expect("a name");
            assert!(document["components"]["schemas"].get(name).is_some(), "{name}");
        }
    }
}
