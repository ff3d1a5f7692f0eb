//! The OpenAPI document: every route, what it takes and how it refuses.

use serde_json::Value;
use utoipa::OpenApi;

use super::routes::routes;
use crate::api::json;
use crate::serve::access::Wanted;

/// Returns the document.
pub fn document() -> Value {
    let document = Document::openapi().merge_from(routes().into_openapi());
    let mut document = serde_json::to_value(document).expect("descriptions become JSON");
    document["components"]["securitySchemes"] = serde_json::json!({ SCHEME: {
        "type": "http",
        "scheme": "bearer",
        "description": "A key that the service lets in, with one of the scopes that the operation names. Where the service runs without keys, none is needed.",
    }});
    let paths = document["paths"].as_object_mut().expect("paths").iter_mut();
    let operations = paths.flat_map(|(path, operations)| {
        let operations = operations.as_object_mut().expect("operations").iter_mut();
        operations.map(move |(method, operation)| {
            (format!("{} {path}", method.to_uppercase()), operation)
        })
    });

    for (route, operation) in operations {
        operation["security"] = security(&route);
        operation["parameters"]
            .as_array_mut()
            .into_iter()
            .flatten()
            .for_each(refine);
        if let Some(contents) = operation
            .pointer_mut("/requestBody/content")
            .and_then(Value::as_object_mut)
        {
            // A body may be absent, which is not null.
            contents
                .values_mut()
                .for_each(|content| present(&mut content["schema"]));
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
    let scopes = Wanted::of_route(route)
        .and_then(Wanted::scopes)
        .unwrap_or_default();
    scopes
        .iter()
        .map(|scope| serde_json::json!({ SCHEME: [scope.as_str()] }))
        .collect()
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
        properties.retain(|property, _| {
            property == kind || KINDS.iter().all(|(other, _)| property != other)
        });
        present(&mut properties[kind]);
        feature["required"] = serde_json::json!(["name", kind]);
        feature["description"] = format!("One named coordinate that is {kind}.").into();
        schemas[name] = feature;
    }
}

/// Says of a parameter what is so of all: nothing is null in a path or a query, where an empty
/// value counts as absent; and what names look like.
fn refine(parameter: &mut Value) {
    const NAME: &str = "^[a-z0-9][a-z0-9._-]{0,62}$";
    const STATE: &str = r"^state\.[a-z0-9][a-z0-9._-]{0,62}$";
    const REGION: &str = r"^region\.[a-z0-9][a-z0-9._-]{0,62}$";
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
        "region" => schema["propertyNames"] = serde_json::json!({ "pattern": REGION }),
        _ => {}
    }
}

/// Leaves null out of what a schema allows.
fn present(schema: &mut Value) {
    if let Some(types) = schema.get("type").and_then(Value::as_array) {
        schema["type"] = types
            .iter()
            .find(|kind| *kind != "null")
            .cloned()
            .expect("a type");
    }
    let choices = schema.get("oneOf").and_then(Value::as_array);
    let choice = choices.and_then(|choices| {
        choices
            .iter()
            .find(|choice| choice.get("$ref").is_some())
            .cloned()
    });

    if let Some(choice) = choice {
        *schema = choice;
    }
}

/// Bounds whole numbers by what holds them: the description of a `u64` would otherwise say that it
/// is signed.
fn bound(value: &mut Value) {
    match value {
        Value::Array(values) => values.iter_mut().for_each(bound),
        Value::Object(members) => {
            let whole = match members.get("format").and_then(Value::as_str) {
                Some("int64") => Some(("uint64", u64::MAX)),
                Some("int32") => Some(("uint32", u32::MAX.into())),
                _ => None,
            };
            let is_unsigned = members
                .get("minimum")
                .and_then(Value::as_i64)
                .is_some_and(|least| least >= 0);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_route_is_described_with_its_problems() {
        let document = document();
        assert!(
            document["openapi"]
                .as_str()
                .expect("a version")
                .starts_with("3.1")
        );
        assert_eq!(document["info"]["version"], env!("CARGO_PKG_VERSION"));
        assert_eq!(document["info"]["license"]["identifier"], "MIT");
        let paths = document["paths"].as_object().expect("paths");
        let operations: Vec<_> = paths
            .values()
            .flat_map(|path| path.as_object().expect("operations").values())
            .collect();
        assert_eq!(operations.len(), 27);
        for operation in operations {
            for status in [
                "400", "401", "403", "404", "405", "409", "413", "415", "429", "500", "503",
            ] {
                let refused = &operation["responses"][status]["content"]["application/problem+json"]
                    ["schema"]["$ref"];
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
            assert!(
                document["components"]["schemas"].get(name).is_some(),
                "{name}"
            );
        }
    }

    #[test]
    fn a_feature_has_exactly_one_kind() {
        let document = document();
        let schemas = &document["components"]["schemas"];
        let names = [
            "ContinuousFeature",
            "CircularFeature",
            "IntegerFeature",
            "CategoricalFeature",
        ];
        let choices = schemas["Feature"]["oneOf"]
            .as_array()
            .expect("choices")
            .iter();
        assert!(
            choices.map(|choice| choice["$ref"].as_str()).eq(names
                .map(|name| Some(format!("#/components/schemas/{name}")))
                .iter()
                .map(Option::as_deref))
        );
        for name in names {
            let kind = name.strip_suffix("Feature").expect("a kind");
            let member = kind.to_lowercase();
            assert_eq!(
                schemas[name]["required"],
                serde_json::json!(["name", member])
            );
            let properties = schemas[name]["properties"].as_object().expect("properties");
            assert_eq!(
                properties.keys().count(),
                3,
                "name, unit and its kind: {properties:?}"
            );
            assert_eq!(
                properties[&member]["$ref"],
                format!("#/components/schemas/{kind}")
            );
            assert_eq!(schemas[name]["additionalProperties"], false, "{name}");
        }
    }

    #[test]
    fn every_body_that_is_taken_knows_all_its_members() {
        let document = document();
        let mut seen: Vec<String> = Vec::new();
        let mut left: Vec<Value> = document["paths"]
            .as_object()
            .expect("paths")
            .values()
            .cloned()
            .collect();
        left = left
            .iter()
            .flat_map(|path| path.as_object().expect("operations").values())
            .cloned()
            .collect();
        left = left
            .iter()
            .map(|operation| operation["requestBody"].clone())
            .collect();
        while let Some(value) = left.pop() {
            let reference = value["$ref"]
                .as_str()
                .and_then(|to| to.strip_prefix("#/components/schemas/"));
            if let Some(name) = reference.filter(|name| !seen.iter().any(|seen| seen == name)) {
                seen.push(name.to_owned());
                left.push(document["components"]["schemas"][name].clone());
            }
            if value["properties"].is_object() {
                assert_eq!(value["additionalProperties"], false, "{value}");
            }
            left.extend(
                value
                    .as_object()
                    .into_iter()
                    .flat_map(|members| members.values())
                    .cloned(),
            );
            left.extend(value.as_array().into_iter().flatten().cloned());
        }
        for expected in [
            "Transition",
            "Transitions",
            "Question",
            "Rule",
            "EnvironmentChange",
            "TrainingRequest",
            "Description",
        ] {
            assert!(
                seen.iter().any(|seen| seen == expected),
                "{expected} is not among {seen:?}"
            );
        }
    }

    const SEGMENT: &str =
        "/paths/~1v1~1environments~1{environment}~1transitions/post/parameters/3/schema";

    #[test]
    fn words_and_bounds_and_patterns_are_told() {
        let document = document();
        let at = |pointer: &str| {
            document
                .pointer(pointer)
                .unwrap_or_else(|| panic!("{pointer}"))
                .clone()
        };
        assert_eq!(
            at("/components/schemas/Unit/enum"),
            serde_json::json!(["nats", "bits"])
        );
        assert_eq!(
            at("/components/schemas/Rule/properties/unit/oneOf/0/$ref"),
            "#/components/schemas/Unit"
        );
        assert_eq!(
            at("/components/schemas/Receipt/properties/accepted/maximum"),
            u64::MAX
        );
        assert_eq!(
            at("/components/schemas/Receipt/properties/accepted/format"),
            "uint64"
        );
        assert_eq!(
            at("/components/schemas/Integer/properties/min/minimum"),
            -16_777_216
        );
        assert_eq!(
            at("/components/schemas/IntegerFeature/properties/name/pattern"),
            "^[a-z0-9][a-z0-9._-]{0,62}$"
        );

        assert_eq!(
            at("/components/schemas/Transition/properties/count/maximum"),
            i64::MAX
        );
        assert_eq!(
            at("/components/schemas/Transition/additionalProperties"),
            false
        );
        for segment in [
            at("/components/schemas/Transitions/properties/segment"),
            at(SEGMENT),
        ] {
            assert_eq!(
                (&segment["minLength"], &segment["maxLength"]),
                (&Value::Null, &64.into()),
                "empty is none"
            );
        }
        let epochs = at("/components/schemas/TrainingRequest/properties/epochs/description");
        let default = format!("{} by default", crate::domain::Training::default().epochs);
        assert!(
            epochs.as_str().expect("text").contains(&default),
            "{epochs}"
        );

        let paths = document["paths"].as_object().expect("paths").values();
        let operations = paths.flat_map(|path| path.as_object().expect("operations").values());
        let parameters = operations
            .flat_map(|operation| operation["parameters"].as_array().expect("some"))
            .cloned();
        for parameter in parameters.filter(|parameter| parameter["in"] == "path") {
            assert!(parameter["schema"]["pattern"].is_string(), "{parameter}");
        }
    }
}
