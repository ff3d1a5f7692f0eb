//! Content negotiation: which of several media types a caller prefers, by its `Accept` header (RFC
//! 9110, 12.5.1), and that an answer is sent however its bytes are wanted.

use axum::extract::Request;
use http::{HeaderMap, HeaderValue, header};

use crate::serve::status::Failure;

/// Letters of a header that an error repeats.
const TOLD: usize = 100;

/// Returns the position of the type that is preferred. Where several are as welcome, the first one
/// is taken, or a later one that is named while the first is only not excluded. Without the header
/// all are.
pub fn preferred(headers: &HeaderMap, offered: &[&str]) -> Result<usize, Failure> {
    let accepted: Vec<&str> = headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .collect();
    let accepted = accepted.join(",");
    if accepted.trim().is_empty() {
        return Ok(0);
    }

    let mut best = Welcome::default();
    let mut taken = None;
    for (at, media) in offered.iter().enumerate() {
        let welcome = Welcome::of_media_type(&accepted, media);
        let is_better = welcome > best || (welcome == best && welcome.is_named());
        if welcome.quality > 0 && is_better {
            (best, taken) = (welcome, Some(at));
        }
    }

    taken.ok_or_else(|| {
        Failure::of_accept(
            &accepted.chars().take(TOLD).collect::<String>(),
            &offered.join(" or "),
        )
    })
}

/// Lets every answer be sent as it is, where no other way is welcome: a server may ignore that
/// nothing is (RFC 9110, 12.5.3), and what was done by the time must not be answered as if it were
/// refused.
pub fn any_encoding(mut request: Request) -> Request {
    if !request.headers().contains_key(header::ACCEPT_ENCODING) {
        return request;
    }
    let headers = request.headers_mut();
    let asked = headers
        .get_all(header::ACCEPT_ENCODING)
        .iter()
        .filter_map(|value| value.to_str().ok());
    let left: Vec<&str> = asked
        .flat_map(|list| list.split(','))
        .filter(|coding| !excludes_identity(coding))
        .collect();
    match HeaderValue::from_str(&left.join(",")) {
        Ok(left) if !left.is_empty() => {
            headers.insert(header::ACCEPT_ENCODING, left);
        }
        _ => {
            headers.remove(header::ACCEPT_ENCODING);
        }
    }
    request
}

fn excludes_identity(coding: &str) -> bool {
    let (name, weight) = coding.split_once(';').unwrap_or((coding, ""));
    let weight = weight
        .trim()
        .strip_prefix("q=")
        .or_else(|| weight.trim().strip_prefix("Q="));
    let is_excluded = weight.and_then(|weight| weight.parse::<f32>().ok()) == Some(0.0);
    is_excluded && ["identity", "*"].contains(&name.trim().to_ascii_lowercase().as_str())
}

/// How welcome a media type is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Welcome {
    /// The weight `q`, in thousandths.
    quality: u32,
    /// How exactly the range names it that says so: 3 is itself, 2 its kind, 1 anything.
    exactness: u8,
}

impl Welcome {
    /// Returns what the most exact range says of a type.
    fn of_media_type(accepted: &str, media: &str) -> Self {
        let ranges = accepted.split(',').filter_map(|range| {
            let mut parts = range.split(';').map(str::trim);
            let exactness = exactness(&parts.next()?.to_ascii_lowercase(), media)?;
            let weight =
                parts.find_map(|part| part.strip_prefix("q=").or_else(|| part.strip_prefix("Q=")));
            // Whoever writes no number means to be answered.
            let quality = weight
                .and_then(|weight| weight.parse::<f32>().ok())
                .unwrap_or(1.0);
            Some(Self {
                quality: (quality.clamp(0.0, 1.0) * 1_000.0) as u32,
                exactness,
            })
        });
        ranges
            .max_by_key(|welcome| welcome.exactness)
            .unwrap_or_default()
    }

    fn is_named(self) -> bool {
        self.exactness == 3
    }
}

fn exactness(range: &str, media: &str) -> Option<u8> {
    match range.strip_suffix("/*") {
        _ if range == media => Some(3),
        Some("*") => Some(1),
        Some(kind) if media.split('/').next() == Some(kind) => Some(2),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFFERED: [&str; 2] = ["application/json", "text/vnd.graphviz"];

    fn taken(accept: &[&'static str]) -> Option<usize> {
        let mut headers = HeaderMap::new();
        for value in accept {
            headers.append(header::ACCEPT, value.parse().expect("a header"));
        }
        preferred(&headers, &OFFERED).ok()
    }

    #[test]
    fn the_most_welcome_is_taken() {
        let cases: [(&[&str], Option<usize>); 18] = [
            (&[], Some(0)),
            (&[""], Some(0)),
            (&["*/*"], Some(0)),
            (&["application/*"], Some(0)),
            (&["text/*"], Some(1)),
            (&["text/vnd.graphviz"], Some(1)),
            (&["Text/Vnd.Graphviz; charset=utf-8"], Some(1)),
            (&["text/vnd.graphviz, */*"], Some(1)),
            (&["text/vnd.graphviz", "application/json"], Some(1)),
            (&["application/json, text/vnd.graphviz;q=0.5"], Some(0)),
            (
                &["application/json;q=0.1, text/vnd.graphviz;q=0.5"],
                Some(1),
            ),
            (&["*/*, application/json;q=0"], Some(1)),
            (&["text/html, application/xhtml+xml, */*;q=0.8"], Some(0)),
            (&["image/svg+xml"], None),
            (&["image/*, text/html"], None),
            (&["application/json;q=0"], None),
            (&["*/*;q=0"], None),
            (&["nonsense"], None),
        ];
        for (accept, expected) in cases {
            assert_eq!(taken(accept), expected, "{accept:?}");
        }
    }
}
