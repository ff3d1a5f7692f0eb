//! Origins: whose pages may make a browser change something (cross-site request forgery). Reading is for `cors` to allow.

use axum::extract::Request;
use http::uri::Authority;
use http::{HeaderValue, Method, Uri, header};

use super::denials::told;
use super::hosts::asked_for;
use crate::error::{ErrorKind, Problem};

/// The origins whose pages may call.
pub struct Origins(Vec<String>);

impl Origins {
    /// Makes the origins beside the service's own; `*` stands for any.
    pub fn new(allowed: &[String]) -> Self {
        Self(allowed.iter().map(|origin| origin.trim_end_matches('/').to_ascii_lowercase()).collect())
    }

    /// Refuses what may change something and comes from the page of another origin, whatever its body is.
    pub fn admit(&self, request: &Request) -> Result<(), Problem> {
        if is_safe(request.method()) {
            return Ok(());
        }
        let mut origins = request.headers().get_all(header::ORIGIN).iter().peekable();
        let names_none = origins.peek().is_none();
        if let Some(foreign) = origins.find(|origin| !self.has(origin, request)) {
            return Err(refused(&format!("origin {:?}", told(foreign.as_bytes()))));
        }
        let site = request.headers().get("sec-fetch-site").map(HeaderValue::as_bytes);
        match site {
            Some(b"cross-site" | b"same-site") if names_none => Err(refused("a page of another origin")),
            _ => Ok(()),
        }
    }

    fn has(&self, origin: &HeaderValue, request: &Request) -> bool {
        let Ok(origin) = origin.to_str() else { return false };
        let Some((scheme, authority)) = parts(origin) else { return false };
        let is_own = || {
            let hosts = asked_for(request);
            let is_same =
                |host: &Result<Authority, String>| host.as_ref().is_ok_and(|host| is_same(&scheme, &authority, host));
            !hosts.is_empty() && hosts.iter().all(is_same)
        };
        self.0.iter().any(|allowed| allowed == "*" || allowed.eq_ignore_ascii_case(origin)) || is_own()
    }
}

/// Returns whether a method changes nothing, as HTTP defines it.
fn is_safe(method: &Method) -> bool {
    [Method::GET, Method::HEAD, Method::OPTIONS].contains(method)
}

/// Returns scheme and authority of an origin. `null` is none: whoever hides where it comes from is not let in.
fn parts(origin: &str) -> Option<(String, Authority)> {
    let parts = origin.parse::<Uri>().ok()?.into_parts();
    let scheme = parts.scheme.filter(|scheme| ["http", "https"].contains(&scheme.as_str()))?;
    Some((scheme.to_string(), parts.authority?))
}

fn is_same(scheme: &str, origin: &Authority, host: &Authority) -> bool {
    let usual = if scheme == "https" { 443 } else { 80 };
    let port = |authority: &Authority| authority.port_u16().unwrap_or(usual);
    origin.host().eq_ignore_ascii_case(host.host()) && port(origin) == port(host)
}

fn refused(who: &str) -> Problem {
    let message =
        format!("{who} may not change anything here: expected the service's own, or one that --cors-origins names");
    Problem::new(ErrorKind::Forbidden, "ORIGIN_NOT_ALLOWED", message)
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn admits(method: &str, headers: &[(&str, &str)]) -> bool {
        let origins = Origins::new(&["https://game.example".into()]);
        let request =
            Request::builder().method(method).uri("/v1/environments/lane").header(header::HOST, "localhost:8080");
        let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
        origins.admit(&request.body(Body::empty()).expect("a request")).is_ok()
    }

    #[test]
    fn only_pages_of_its_own_and_of_allowed_origins_change_something() {
        for method in ["POST", "PUT", "PATCH", "DELETE"] {
            assert!(admits(method, &[]), "no browser");
            for own in
                ["http://localhost:8080", "HTTP://LOCALHOST:8080", "https://localhost:8080", "https://game.example"]
            {
                assert!(admits(method, &[("origin", own)]), "{own}");
            }
            assert!(admits(method, &[("origin", "https://game.example"), ("sec-fetch-site", "cross-site")]));
            assert!(
                admits(method, &[("sec-fetch-site", "same-origin")]) && admits(method, &[("sec-fetch-site", "none")])
            );
            for foreign in [
                "null",
                "http://localhost:3000",
                "http://localhost",
                "https://evil.example",
                "http://game.example",
                "",
                "é",
                "file://",
            ] {
                assert!(!admits(method, &[("origin", foreign)]), "{foreign}");
            }
            assert!(!admits(method, &[("origin", "http://localhost:8080"), ("origin", "null")]));
            assert!(
                !admits(method, &[("sec-fetch-site", "cross-site")])
                    && !admits(method, &[("sec-fetch-site", "same-site")])
            );
        }
        assert!(
            admits("GET", &[("origin", "https://evil.example"), ("sec-fetch-site", "cross-site")]),
            "it changes nothing"
        );
    }

    #[test]
    fn a_port_may_be_left_out_where_it_is_the_usual_one() {
        let same = |scheme, origin: &str, host: &str| {
            is_same(scheme, &origin.parse().expect("an authority"), &host.parse().expect("an authority"))
        };
        assert!(same("http", "a", "a:80") && same("https", "a", "a") && same("https", "A:443", "a"));
        assert!(!same("http", "a", "a:443") && !same("http", "a", "b"));
    }
}
