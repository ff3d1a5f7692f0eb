//! The OpenAPI document: every route, what it takes and how it refuses.

use std::collections::BTreeMap;

use serde_json::Value;
use utoipa::openapi::response::Response;
use utoipa::openapi::schema::{Object, Type};
use utoipa::openapi::{ContentBuilder, Header, HeaderBuilder, Ref, RefOr, ResponseBuilder};
use utoipa::{IntoParams, IntoResponses, OpenApi};

use super::{environments, graph, influence, learning, models, states, summary, transitions};
use crate::api::json;
use crate::serve::access::Wanted;

/// Returns the document.
pub fn document() -> Value {
    let mut document = serde_json::to_value(Document::openapi()).expect("descriptions become JSON");
    document["components"]["securitySchemes"] = serde_json::json!({ SCHEME: {
        "type": "http",
        "scheme": "bearer",
        "description": "A key that the service lets in, with one of the scopes that the operation names. Where the service runs without keys, none is needed.",
    }});
    let paths = document["paths"].as_object_mut().expect("paths").iter_mut();
    let operations = paths.flat_map(|(path, operations)| {
        let operations = operations.as_object_mut().expect("operations").iter_mut();
        operations.map(move |(method, operation)| (format!("{} {path}", method.to_uppercase()), operation))
    });
    for (route, operation) in operations {
        operation["security"] = security(&route);
        operation["parameters"].as_array_mut().into_iter().flatten().for_each(refine);
        if let Some(contents) = operation.pointer_mut("/requestBody/content").and_then(Value::as_object_mut) {
            // A body may be absent, which is not null.
            contents.values_mut().for_each(|content| present(&mut content["schema"]));
        }
    }
    one_kind_each(&mut document["components"]["schemas"]);
    bound(&mut document);
    document
}

/// The name of the way to show a key.
const SCHEME: &str = "key";

/// Says which scopes an operation wants: one of them, each an alternative of its own.
fn security(route: &str) -> Value {
    let scopes = Wanted::of_route(route).and_then(Wanted::scopes).unwrap_or_default();
    scopes.iter().map(|scope| serde_json::json!({ SCHEME: [scope.as_str()] })).collect()
}

/// Says of features that they have exactly one kind: a schema a kind, of which `Feature` is one.
fn one_kind_each(schemas: &mut Value) {
    const KINDS: [(&str, &str); 4] = [
        ("continuous", "ContinuousFeature"),
        ("circular", "CircularFeature"),
        ("integer", "IntegerFeature"),
        ("categorical", "CategoricalFeature"),
    ];
    let any = schemas["Feature"].clone();
    schemas["Feature"] = serde_json::json!({
        "description": any["description"],
        "oneOf": KINDS.map(|(_, name)| serde_json::json!({ "$ref": format!("#/components/schemas/{name}") })),
    });
    for (kind, name) in KINDS {
        let mut feature = any.clone();
        let properties = feature["properties"].as_object_mut().expect("properties");
        properties.retain(|property, _| property == kind || KINDS.iter().all(|(other, _)| property != other));
        present(&mut properties[kind]);
        feature["required"] = serde_json::json!(["name", kind]);
        feature["description"] = format!("One named coordinate that is {kind}.").into();
        schemas[name] = feature;
    }
}

/// Says of a parameter what is so of all: nothing is null in a path or a query, where an empty value counts as absent; and what names look like.
fn refine(parameter: &mut Value) {
    const NAME: &str = "^[a-z0-9][a-z0-9._-]{0,62}$";
    const STATE: &str = r"^state\.[a-z0-9][a-z0-9._-]{0,62}$";
    const PRODUCER: &str = "^[A-Za-z0-9][A-Za-z0-9._:@-]{0,127}$";
    if parameter["in"] == "query" {
        parameter["allowEmptyValue"] = true.into();
    }
    let name = parameter["name"].as_str().unwrap_or_default().to_owned();
    let schema = &mut parameter["schema"];
    present(schema);
    match name.as_str() {
        "environment" | "ego" | "other" => schema["pattern"] = NAME.into(),
        "producer" => schema["pattern"] = PRODUCER.into(),
        "given" => schema["items"]["pattern"] = NAME.into(),
        "state" => schema["propertyNames"] = serde_json::json!({ "pattern": STATE }),
        _ => {}
    }
}

/// Leaves null out of what a schema allows.
fn present(schema: &mut Value) {
    if let Some(types) = schema.get("type").and_then(Value::as_array) {
        schema["type"] = types.iter().find(|kind| *kind != "null").cloned().expect("a type");
    }
    let choices = schema.get("oneOf").and_then(Value::as_array);
    let choice = choices.and_then(|choices| choices.iter().find(|choice| choice.get("$ref").is_some()).cloned());
    if let Some(choice) = choice {
        *schema = choice;
    }
}

/// Bounds whole numbers by what holds them: the description of a `u64` would otherwise say that it is signed.
fn bound(value: &mut Value) {
    match value {
        Value::Array(values) => values.iter_mut().for_each(bound),
        Value::Object(members) => {
            let whole = match members.get("format").and_then(Value::as_str) {
                Some("int64") => Some(("uint64", u64::MAX)),
                Some("int32") => Some(("uint32", u32::MAX.into())),
                _ => None,
            };
            let is_unsigned = members.get("minimum").and_then(Value::as_i64).is_some_and(|least| least >= 0);
            if let Some((format, most)) = whole.filter(|_| is_unsigned) {
                members.insert("format".to_owned(), format.into());
                members.entry("maximum").or_insert(most.into());
            }
            members.values_mut().for_each(bound);
        }
        _ => {}
    }
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
    servers((url = "/", description = "The service that tells this document")),
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
    within: Option<json::Within>,
    /// The unit of the figures, `nats` or `bits`; the rule's by default.
    unit: Option<json::Unit>,
}

/// The parts of the rule that differ from the environment's.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct RuleParameters {
    /// `evidence` or `paper`; the environment's by default.
    #[param(rename = "rule.kind")]
    rule_kind: Option<json::RuleKind>,
    /// Mutual information above which there is influence, in `rule.unit`, else in the unit of the environment's rule.
    #[param(rename = "rule.threshold", minimum = 0)]
    rule_threshold: Option<f64>,
    /// The threshold as a share of the most that the pair can have, at least 0 and below 1. Instead of `rule.threshold`.
    #[param(rename = "rule.share", minimum = 0, exclusive_maximum = 1)]
    rule_share: Option<f64>,
    /// `nats` or `bits`. Given without a threshold, it converts the threshold.
    #[param(rename = "rule.unit")]
    rule_unit: Option<json::Unit>,
    /// Visits below which the paper's rule stays undecided.
    #[param(rename = "rule.min_visits", maximum = 9_223_372_036_854_775_807_i64)]
    rule_min_visits: Option<u64>,
    /// Probability from which the evidence rule decides, above 0.5 and below 1.
    #[param(rename = "rule.confidence", exclusive_minimum = 0.5, exclusive_maximum = 1)]
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
    #[param(example = "3.0.7", pattern = r"^[0-9]+(\.[0-9]+)*$")]
    key: Option<String>,
    /// Further estimators of mutual information, repeated or joined by commas, instead of the environment's: `excess`, `miller_madow`,
    /// `chao_shen`, `james_stein`, `grassberger_2003`, `nsb`, `dirichlet`, `adjusted`, `uniform_policy`.
    estimators: Option<Vec<json::Estimator>>,
    /// `verdict`, `figures` or `full` (the default).
    view: Option<json::View>,
    /// Wants the test of independence: `auto` to follow `within`, or `pooled`, or `within_segments` to permute within each segment only.
    significance: Option<json::Permutations>,
    /// Wants to know how many more visits a verdict would take.
    visits_to_decide: Option<bool>,
}

/// Which states, in which order.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code)]
pub struct ListingParameters {
    /// `visits` (the default), `plug_in`, `posterior_mean` or `p_dependent`, then `desc` (the default) or `asc`.
    #[param(example = "visits desc", pattern = "^(visits|plug_in|posterior_mean|p_dependent)( (asc|desc))?$")]
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
    /// The false discovery rate that is accepted, above 0 and below 1: pages then hold discoveries only, and the summary counts them.
    #[param(example = 0.05, exclusive_minimum = 0, exclusive_maximum = 1)]
    fdr: Option<f64>,
    /// `bayes` (the default), by the probability of dependence, or `bh`, Benjamini and Hochberg's procedure on tests of independence.
    method: Option<json::DiscoveryMethod>,
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
    #[param(example = "3.0.7", pattern = r"^[0-9]+(\.[0-9]+)*$")]
    key: Option<String>,
    /// The segments to count, repeated or joined by commas; all by default.
    segments: Option<Vec<String>>,
    /// What is compared within each segment alone: `auto` (the default) tests of independence only, `segments` the plug-in and its mean under
    /// independence too, `pooled` nothing.
    #[param(example = "auto")]
    within: Option<json::Within>,
    /// The unit of the figures, `nats` or `bits`; the rule's by default.
    unit: Option<json::Unit>,
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

/// How every route refuses: with a problem.
pub struct Refusals;

impl IntoResponses for Refusals {
    fn responses() -> BTreeMap<String, RefOr<Response>> {
        const REFUSALS: [(&str, &str); 11] = [
            ("400", "The input is wrong; its faults are listed"),
            ("401", "There is no key, or none that is let in"),
            (
                "403",
                "The key has not the scope, or is not for the environment or the producer; or a page of another origin asks, or for another host",
            ),
            ("404", "The thing named does not exist"),
            ("405", "The path does not take the method; `Allow` names those that it takes"),
            ("409", "The request contradicts what is stored, or a sequence is ahead"),
            ("413", "The body, the batch or the answer is too large"),
            ("415", "The body is of another type"),
            (
                "429",
                "A quota of the service is used up: remove something, or have the quota raised; or the rate of the key is: ask again after `Retry-After`",
            ),
            ("500", "A defect; the cause is in the log"),
            ("503", "Not now, or no answer in time: where there is a `Retry-After`, ask again after it"),
        ];
        REFUSALS.into_iter().map(|(status, description)| (status.to_owned(), refusal(status, description))).collect()
    }
}

fn refusal(status: &str, description: &str) -> RefOr<Response> {
    let problem = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
    let response = ResponseBuilder::new().description(description).content("application/problem+json", problem);
    match status {
        "405" => response.header("Allow", told("The methods that the path takes, joined by commas", Type::String)),
        "401" => response.header("WWW-Authenticate", told("How to show a key: `Bearer`", Type::String)),
        "429" | "503" => {
            response.header("Retry-After", told("After how many seconds the same may be sent again", Type::Integer))
        }
        _ => response,
    }
    .build()
    .into()
}

fn told(description: &str, kind: Type) -> Header {
    let schema = Object::builder().schema_type(kind);
    HeaderBuilder::new().schema(Some(schema.build())).description(Some(description)).build()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_route_is_described_with_its_problems() {
        let document = document();
        assert!(document["openapi"].as_str().expect("a version").starts_with("3.1"));
        assert_eq!(document["info"]["version"], env!("CARGO_PKG_VERSION"));
        assert_eq!(document["info"]["license"]["identifier"], "MIT");
        let paths = document["paths"].as_object().expect("paths");
        let operations: Vec<_> =
            paths.values().flat_map(|path| path.as_object().expect("operations").values()).collect();
        assert_eq!(operations.len(), 23);
        for operation in operations {
            for status in ["400", "401", "403", "404", "405", "409", "413", "415", "429", "500", "503"] {
                let refused = &operation["responses"][status]["content"]["application/problem+json"]["schema"]["$ref"];
                assert_eq!(refused, "#/components/schemas/Problem", "{status}");
            }
        }
        assert_eq!(document["servers"][0]["url"], "/");
    }

    #[test]
    fn every_reference_leads_somewhere() {
        let document = document();
        let text = document.to_string();
        for reference in text.split("\"#/components/schemas/").skip(1) {
            let name = reference.split('"').next().expect("a name");
            assert!(document["components"]["schemas"].get(name).is_some(), "{name}");
        }
    }

    #[test]
    fn a_feature_has_exactly_one_kind() {
        let document = document();
        let schemas = &document["components"]["schemas"];
        let names = ["ContinuousFeature", "CircularFeature", "IntegerFeature", "CategoricalFeature"];
        let choices = schemas["Feature"]["oneOf"].as_array().expect("choices").iter();
        assert!(
            choices
                .map(|choice| choice["$ref"].as_str())
                .eq(names.map(|name| Some(format!("#/components/schemas/{name}"))).iter().map(Option::as_deref))
        );
        for name in names {
            let kind = name.strip_suffix("Feature").expect("a kind");
            let member = kind.to_lowercase();
            assert_eq!(schemas[name]["required"], serde_json::json!(["name", member]));
            let properties = schemas[name]["properties"].as_object().expect("properties");
            assert_eq!(properties.keys().count(), 3, "name, unit and its kind: {properties:?}");
            assert_eq!(properties[&member]["$ref"], format!("#/components/schemas/{kind}"));
            assert_eq!(schemas[name]["additionalProperties"], false, "{name}");
        }
    }

    #[test]
    fn words_and_bounds_and_patterns_are_told() {
        let document = document();
        let at = |pointer: &str| document.pointer(pointer).unwrap_or_else(|| panic!("{pointer}")).clone();
        assert_eq!(at("/components/schemas/Unit/enum"), serde_json::json!(["nats", "bits"]));
        assert_eq!(at("/components/schemas/Rule/properties/unit/oneOf/0/$ref"), "#/components/schemas/Unit");
        assert_eq!(at("/components/schemas/Receipt/properties/accepted/maximum"), u64::MAX);
        assert_eq!(at("/components/schemas/Receipt/properties/accepted/format"), "uint64");
        assert_eq!(at("/components/schemas/Integer/properties/min/minimum"), -16_777_216);
        assert_eq!(at("/components/schemas/IntegerFeature/properties/name/pattern"), "^[a-z0-9][a-z0-9._-]{0,62}$");

        let paths = document["paths"].as_object().expect("paths").values();
        let operations = paths.flat_map(|path| path.as_object().expect("operations").values());
        let parameters = operations.flat_map(|operation| operation["parameters"].as_array().expect("some")).cloned();
        for parameter in parameters.filter(|parameter| parameter["in"] == "path") {
            assert!(parameter["schema"]["pattern"].is_string(), "{parameter}");
        }
    }
}
