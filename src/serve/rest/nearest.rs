//! Spelling suggestions (edit distance) for a path that is not served: what somebody who mistyped
//! it may have meant.

use crate::domain::{is_near, meant};

/// Longer paths are not compared.
const MOST_BYTES: usize = 512;

/// Returns what is added to "nothing is served under this path": the served paths near it, of these
/// templates.
pub fn hint(path: &str, served: &[String]) -> String {
    if path.len() > MOST_BYTES {
        return String::new();
    }

    let asked: Vec<&str> = path.trim_end_matches('/').split('/').collect();
    let mut near: Vec<String> = served
        .iter()
        .filter_map(|template| filled(template, &asked))
        .collect();
    near.sort();
    near.dedup();
    meant(&near.iter().map(String::as_str).collect::<Vec<_>>())
}

/// Returns a template with the variables as they were asked for, if the rest of it is near.
fn filled(template: &str, asked: &[&str]) -> Option<String> {
    let template: Vec<&str> = template.split('/').collect();
    if template.len() != asked.len() {
        return None;
    }

    let mut filled = Vec::with_capacity(asked.len());
    for (part, asked) in template.into_iter().zip(asked) {
        let is_variable = part.starts_with('{');
        let fills = is_variable && !asked.is_empty();
        let is_meant = fills || part == *asked || is_near(asked, part);
        if !is_meant {
            return None;
        }
        filled.push(if is_variable { asked } else { part });
    }

    Some(filled.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_meant_is_told() {
        let served = [
            "/v1/environments",
            "/v1/environments/{environment}",
            "/v1/environments/{environment}/summary",
            "/v1/environments/{environment}/states",
            "/v1/environments/{environment}/models/{model}",
            "/readyz",
        ];
        let served = served.map(str::to_owned);
        for (path, meant) in [
            (
                "/v1/environments/lane/sumary",
                "/v1/environments/lane/summary",
            ),
            (
                "/v1/environment/lane/Summary",
                "/v1/environments/lane/summary",
            ),
            ("/v1/enviroments", "/v1/environments"),
            ("/v1/environments/", "/v1/environments"),
            (
                "/v1/environments/lane/state",
                "/v1/environments/lane/states",
            ),
            (
                "/v1/environments/lane/model/3",
                "/v1/environments/lane/models/3",
            ),
            ("/ready", "/readyz"),
        ] {
            assert_eq!(
                hint(path, &served),
                format!("; did you mean `{meant}`?"),
                "{path}"
            );
        }
        let long = format!("/v1/environments/{}/sumary", "x".repeat(600));
        for strange in [
            "/",
            "",
            "//",
            "/wp-admin",
            "/v3/nothing",
            "/v1/environments/lane/kitchen",
            &long,
        ] {
            assert_eq!(hint(strange, &served), "", "{strange}");
        }
    }
}
