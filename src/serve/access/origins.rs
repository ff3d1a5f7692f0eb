//! Origins: whose pages may make a browser change something (cross-site request forgery). Reading
//! is for `cors` to allow.

use axum::extract::Request;
use http::uri::Authority;
use http::{HeaderValue, Method, Uri, header};

use super::denials::shortened;
use super::hosts::{Hosts, asked_for};
use super::wanted::is_grpc_path;
use crate::error::{ErrorKind, Problem};

/// The allow-list of origins whose pages may call.
pub struct Origins {
    allowed: Vec<String>,
    speaks_tls: bool,
    /// By these names a proxy may be asked for, which ends TLS before a port of plain text.
    proxied: Hosts,
}

impl Origins {
    /// Makes the origins beside the service's own; `*` stands for any.
    pub fn new(allowed: &[String], speaks_tls: bool, hosts: &[String]) -> Self {
        let allowed = allowed
            .iter()
            .map(|origin| origin.trim_end_matches('/').to_ascii_lowercase())
            .collect();
        Self {
            allowed,
            speaks_tls,
            proxied: Hosts::new(None, hosts),
        }
    }

    /// Refuses what may change something and comes from the page of another origin, whatever its
    /// body is.
    pub fn admit(&self, request: &Request) -> Result<(), Problem> {
        let is_call = is_grpc_path(request.uri().path()) && request.method() != Method::OPTIONS;
        if is_safe(request.method()) && !is_call {
            return Ok(());
        }

        let mut origins = request.headers().get_all(header::ORIGIN).iter().peekable();
        let names_none = origins.peek().is_none();
        if let Some(foreign) = origins.find(|origin| !self.has(origin, request)) {
            return Err(refused(&format!(
                "origin {:?}",
                shortened(foreign.as_bytes())
            )));
        }

        let mut sites = request.headers().get_all("sec-fetch-site").iter();
        match names_none && sites.any(is_foreign) {
            true => Err(refused("a page of another origin")),
            false => Ok(()),
        }
    }

    /// Returns whether a page of that scheme and host can be the service's own. Before a port of
    /// plain text there may be a proxy that ends TLS, which has a name: one of `--hosts`.
    fn has_scheme(&self, scheme: &str, host: &str) -> bool {
        match (scheme, self.speaks_tls) {
            ("https", false) => self.proxied.is_given(host),
            (scheme, speaks_tls) => (scheme == "https") == speaks_tls,
        }
    }

    fn has(&self, origin: &HeaderValue, request: &Request) -> bool {
        let Ok(origin) = origin.to_str() else {
            return false;
        };

        let Some((scheme, authority)) = parts(origin) else {
            return false;
        };

        let is_own = || {
            let hosts = asked_for(request);
            let is_same = |host: &Result<Authority, String>| {
                host.as_ref()
                    .is_ok_and(|host| is_same(&scheme, &authority, host))
            };
            self.has_scheme(&scheme, authority.host())
                && !hosts.is_empty()
                && hosts.iter().all(is_same)
        };

        self.allowed
            .iter()
            .any(|allowed| allowed == "*" || allowed.eq_ignore_ascii_case(origin))
            || is_own()
    }
}

/// Returns whether `Sec-Fetch-Site` tells of a page of another origin, `cross-site` or `same-site`.
/// Browsers send it once and in small letters.
fn is_foreign(site: &HeaderValue) -> bool {
    let site = site.as_bytes().trim_ascii();
    !site.eq_ignore_ascii_case(b"same-origin") && !site.eq_ignore_ascii_case(b"none")
}

/// Returns whether a method changes nothing, as HTTP defines it.
fn is_safe(method: &Method) -> bool {
    [Method::GET, Method::HEAD, Method::OPTIONS].contains(method)
}

/// Returns scheme and authority of an origin, in which no user is named. `null` is none: whoever
/// hides where it comes from is not let in.
fn parts(origin: &str) -> Option<(String, Authority)> {
    let parts = origin.parse::<Uri>().ok()?.into_parts();
    let scheme = parts
        .scheme
        .filter(|scheme| ["http", "https"].contains(&scheme.as_str()))?;
    let authority = parts
        .authority
        .filter(|authority| !authority.as_str().contains('@'))?;
    Some((scheme.to_string(), authority))
}

fn is_same(scheme: &str, origin: &Authority, host: &Authority) -> bool {
    let usual = if scheme == "https" { 443 } else { 80 };
    let port = |authority: &Authority| authority.port_u16().unwrap_or(usual);
    origin.host().eq_ignore_ascii_case(host.host()) && port(origin) == port(host)
}

fn refused(who: &str) -> Problem {
    let message = format!(
        "{who} may not change anything here: expected the service's own, or one that --cors-origins names"
    );
    Problem::new(ErrorKind::Forbidden, "ORIGIN_NOT_ALLOWED", message)
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn admits(method: &str, headers: &[(&str, &str)]) -> bool {
        admits_with(
            &Origins::new(&["https://game.example".into()], false, &[]),
            method,
            headers,
        )
    }

    fn admits_with(origins: &Origins, method: &str, headers: &[(&str, &str)]) -> bool {
        let request = Request::builder()
            .method(method)
            .uri("/v1/environments/lane")
            .header(header::HOST, "localhost:8080");
        let request = headers.iter().fold(request, |request, (name, value)| {
            request.header(*name, *value)
        });
        origins
            .admit(&request.body(Body::empty()).expect("a request"))
            .is_ok()
    }

    #[test]
    fn only_pages_of_its_own_and_of_allowed_origins_change_something() {
        for method in ["POST", "PUT", "PATCH", "DELETE"] {
            assert!(admits(method, &[]), "no browser");
            for own in [
                "http://localhost:8080",
                "HTTP://LOCALHOST:8080",
                "https://game.example",
            ] {
                assert!(admits(method, &[("origin", own)]), "{own}");
            }
            assert!(admits(
                method,
                &[
                    ("origin", "https://game.example"),
                    ("sec-fetch-site", "cross-site")
                ]
            ));
            assert!(
                admits(method, &[("sec-fetch-site", "same-origin")])
                    && admits(method, &[("sec-fetch-site", "none")])
            );
            for foreign in [
                "null",
                "http://localhost:3000",
                "https://localhost:8080",
                "http://user@localhost:8080",
                "http://user:word@localhost:8080",
                "http://localhost",
                "https://evil.example",
                "http://game.example",
                "",
                "é",
                "file://",
            ] {
                assert!(!admits(method, &[("origin", foreign)]), "{foreign}");
            }
            assert!(!admits(
                method,
                &[("origin", "http://localhost:8080"), ("origin", "null")]
            ));
            assert!(
                !admits(method, &[("sec-fetch-site", "cross-site")])
                    && !admits(method, &[("sec-fetch-site", "same-site")])
            );
            for foreign in ["CROSS-SITE", "Same-Site", " cross-site "] {
                assert!(!admits(method, &[("sec-fetch-site", foreign)]), "{foreign}");
            }
            for several in [["same-origin", "cross-site"], ["cross-site", "none"]] {
                let headers = several.map(|site| ("sec-fetch-site", site));
                assert!(!admits(method, &headers), "{several:?}");
            }
        }
        assert!(
            admits(
                "GET",
                &[
                    ("origin", "https://evil.example"),
                    ("sec-fetch-site", "cross-site")
                ]
            ),
            "it changes nothing"
        );
    }

    #[test]
    fn the_scheme_of_a_page_is_the_one_that_is_spoken() {
        let own = |origins: &Origins, origin| admits_with(origins, "POST", &[("origin", origin)]);
        let (plain, tls) = (Origins::new(&[], false, &[]), Origins::new(&[], true, &[]));
        assert!(own(&plain, "http://localhost:8080") && !own(&plain, "https://localhost:8080"));
        assert!(!own(&tls, "http://localhost:8080") && own(&tls, "https://localhost:8080"));
        // Behind a proxy, which goes by a name that is given.
        let behind = Origins::new(&[], false, &["nudge.example".into()]);
        let by_name = |origin: &str| {
            let request = Request::post("/v1/x")
                .header(header::HOST, "nudge.example")
                .header(header::ORIGIN, origin);
            behind
                .admit(&request.body(Body::empty()).expect("a request"))
                .is_ok()
        };
        assert!(
            by_name("https://nudge.example")
                && by_name("http://nudge.example")
                && !by_name("https://localhost")
        );
        assert!(
            !own(&behind, "https://localhost:8080"),
            "no proxy goes by it"
        );
    }

    #[test]
    fn a_call_is_no_reading_whatever_its_method() {
        let origins = Origins::new(&[], false, &[]);
        let request = Request::get("/nudge.v1.EnvironmentService/DeleteEnvironment")
            .header(header::HOST, "localhost");
        let request = request
            .header(header::ORIGIN, "https://evil.example")
            .body(Body::empty())
            .expect("a request");
        assert!(origins.admit(&request).is_err());
    }

    #[test]
    fn a_port_may_be_left_out_where_it_is_the_usual_one() {
        let same = |scheme, origin: &str, host: &str| {
            is_same(
                scheme,
                &origin.parse().expect("an authority"),
                &host.parse().expect("an authority"),
            )
        };
        assert!(
            same("http", "a", "a:80") && same("https", "a", "a") && same("https", "A:443", "a")
        );
        assert!(!same("http", "a", "a:443") && !same("http", "a", "b"));
    }
}
