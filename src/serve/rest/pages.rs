//! What a browser is shown: the first page, and the documentation of the REST face with its OpenAPI
//! document.

use axum::Router;
use axum::middleware::map_response;
use axum::response::{Html, IntoResponse, Response};
use axum::routing::get;
use http::{HeaderMap, HeaderName, HeaderValue, Uri, header};
use serde_json::json;
use utoipa_swagger_ui::{Config, SwaggerUi};

use super::accept::preferred;
use super::openapi;

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Scripts and whatever else a page takes come from here, or not at all; Swagger UI writes styles
/// and pictures into its page.
const POLICY: &str = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; object-src 'none'; base-uri 'none'; \
    form-action 'self'; frame-ancestors 'none'";

/// What browsers are told about every page: what it may load, that a type means what it says, and
/// that nobody may frame it.
const GUARDS: [(HeaderName, HeaderValue); 4] = [
    (
        header::CONTENT_SECURITY_POLICY,
        HeaderValue::from_static(POLICY),
    ),
    (
        header::X_CONTENT_TYPE_OPTIONS,
        HeaderValue::from_static("nosniff"),
    ),
    (header::X_FRAME_OPTIONS, HeaderValue::from_static("DENY")),
    (
        header::REFERRER_POLICY,
        HeaderValue::from_static("no-referrer"),
    ),
];

/// Returns the pages.
pub fn router() -> Router {
    // The documentation would otherwise ask a validator on the internet.
    let config = Config::default().validator_url("none");
    let documentation: Router = SwaggerUi::new("/docs")
        .external_url_unchecked("/openapi.json", openapi::document())
        .config(config)
        .into();
    documentation
        .route("/", get(first))
        .layer(map_response(guard))
}

async fn guard(mut response: Response) -> Response {
    response.headers_mut().extend(GUARDS);
    response
}

/// Says what this is and where to go on: to browsers as a page, to others as JSON.
async fn first(uri: Uri, headers: HeaderMap) -> Response {
    let vary = [(header::VARY, "accept")];
    if wants_page(&headers) {
        let page = include_str!("page.html").replace("{version}", VERSION);
        return (
            vary,
            Html(page.replace("{origin}", &origin(&uri, &headers))),
        )
            .into_response();
    }

    let told = json!({
        "name": "nudge",
        "version": VERSION,
        "docs": "/docs/",
        "openapi": "/openapi.json",
        "live": "/livez",
        "ready": "/readyz",
        "metrics": "/metrics",
        "environments": "/v1/environments",
        "inference": "/v2",
    });

    (vary, axum::Json(told)).into_response()
}

/// Tells whether a page is more welcome than JSON, as browsers say it; who accepts neither gets
/// JSON.
fn wants_page(headers: &HeaderMap) -> bool {
    preferred(headers, &["application/json", "text/html"]) == Ok(1)
}

/// Returns where the service is as its caller knows it, where that is nothing but a host and a
/// port.
fn origin(uri: &Uri, headers: &HeaderMap) -> String {
    let host = headers
        .get(header::HOST)
        .and_then(|host| host.to_str().ok());
    let host = uri.authority().map(|authority| authority.as_str()).or(host);

    let plain = host.filter(|host| is_plain(host));
    format!("http://{}", plain.unwrap_or("127.0.0.1:8080"))
}

/// Returns whether that is nothing but a host and a port.
fn is_plain(host: &str) -> bool {
    !host.is_empty()
        && host
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || b".-:[]".contains(&byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_for_those_who_ask_for_one() {
        let accepts = |text: &'static str| {
            wants_page(&HeaderMap::from_iter([(
                header::ACCEPT,
                HeaderValue::from_static(text),
            )]))
        };
        assert!(accepts(
            "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"
        ));
        assert!(accepts("application/json;q=0.4, Text/HTML;q=0.5"));
        for other in [
            "*/*",
            "application/json",
            "text/html5",
            "",
            "text/html;q=0",
            "application/json, text/html;q=0.5",
            "text/html;q=0, */*",
            "image/png",
        ] {
            assert!(!accepts(other), "{other}");
        }
        assert!(!wants_page(&HeaderMap::new()));
    }

    #[test]
    fn commands_name_the_service_as_its_caller_does() {
        let of = |host: &'static str| {
            let headers = HeaderMap::from_iter([(header::HOST, HeaderValue::from_static(host))]);
            origin(&Uri::from_static("/"), &headers)
        };
        assert_eq!(of("nudge.example:81"), "http://nudge.example:81");
        assert_eq!(of("[::1]:8080"), "http://[::1]:8080");
        for strange in ["", "a<script>", "a'b", "a b", "a&b"] {
            assert_eq!(of(strange), "http://127.0.0.1:8080", "{strange}");
        }
        assert_eq!(
            origin(&Uri::from_static("http://over.http2:1/"), &HeaderMap::new()),
            "http://over.http2:1"
        );
    }
}
