//! Deadlines of calls, as their callers set them, or as all have them. Streams have none.

use std::time::Duration;

use axum::extract::Request;
use axum::middleware::Next;
use axum::response::Response;
use http::HeaderMap;

use crate::error::{Fault, Problem};
use crate::serve::costs::ALLOWED;
use crate::serve::status::{self, Asked, too_late};
use crate::work::deadline::{self, Deadline};

/// Nobody is waited for longer, whatever it says.
const MOST: Duration = Duration::from_secs(10 * 60);

/// Answers each call within its time, or says that there was no answer: what it began is dropped.
pub async fn in_time(request: Request, next: Next) -> Response {
    let path = request.uri().path();
    if is_stream(path) {
        return next.run(request).await;
    }

    let method = path.rsplit('/').next().unwrap_or_default().to_owned();
    let asked = asked(&method);
    let allowed = match allowed(request.headers()) {
        Ok(allowed) => allowed,
        Err(problem) => return status::grpc(problem).into_http(),
    };
    let answer = deadline::within(Deadline::after(allowed), next.run(request)).await;
    answer.unwrap_or_else(|| status::grpc(too_late(asked, allowed)).into_http())
}

fn is_stream(path: &str) -> bool {
    path == "/nudge.v1.IngestService/Ingest" || path.starts_with("/grpc.")
}

/// Returns what a call asks for.
fn asked(method: &str) -> Asked {
    const CHANGES: [&str; 10] = [
        "ApplyEnvironment",
        "UpdateEnvironment",
        "UpdateRule",
        "DeleteEnvironment",
        "TrainModel",
        "ActivateModel",
        "RollBackModel",
        "DeleteModel",
        "CancelJob",
        "ImportModel",
    ];
    match method {
        "Write" => Asked::Batch,
        _ if CHANGES.contains(&method) => Asked::Change,
        _ => Asked::Question,
    }
}

/// Returns how long a call may take. What is no timeout is refused: to take it for none would let a
/// caller who is in a hurry wait.
fn allowed(headers: &HeaderMap) -> Result<Duration, Problem> {
    let mut said = headers.get_all("grpc-timeout").iter();
    let Some(first) = said.next() else {
        return Ok(ALLOWED);
    };

    if said.next().is_some() {
        return Err(no_timeout("several"));
    }

    let read = first.to_str().ok().and_then(timeout);
    let text = || String::from_utf8_lossy(first.as_bytes()).into_owned();

    read.map(|said| said.min(MOST))
        .ok_or_else(|| no_timeout(&format!("{:?}", text())))
}

fn no_timeout(got: &str) -> Problem {
    let expected = "expected one to eight digits and a unit of H, M, S, m, u or n";
    let fault = Fault::new("grpc-timeout", format!("got {got}, {expected}"));
    Problem::invalid("call", vec![fault])
}

/// Reads a timeout as gRPC writes it: at most eight digits and a unit.
fn timeout(text: &str) -> Option<Duration> {
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    let is_number =
        (1..=8).contains(&digits.len()) && digits.bytes().all(|byte| byte.is_ascii_digit());
    let number: u64 = digits.parse().ok().filter(|_| is_number)?;

    Some(match unit {
        "H" => Duration::from_secs(number * 60 * 60),
        "M" => Duration::from_secs(number * 60),
        "S" => Duration::from_secs(number),
        "m" => Duration::from_millis(number),
        "u" => Duration::from_micros(number),
        "n" => Duration::from_nanos(number),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::ErrorKind;

    #[test]
    fn timeouts_are_read_as_grpc_writes_them() {
        let units = ["3H", "3M", "3S", "3m", "3u", "3n", "00000003S"];
        let seconds = [10_800.0, 180.0, 3.0, 0.003, 0.000_003, 0.000_000_003, 3.0];
        assert_eq!(
            units.map(|text| timeout(text).expect(text).as_secs_f64()),
            seconds
        );
        assert_eq!(
            timeout("99999999H"),
            Some(Duration::from_secs(99_999_999 * 3_600))
        );
        for wrong in [
            "",
            "S",
            "3",
            "3s",
            "+3S",
            "-3S",
            "3.5S",
            " 3S",
            "123456789S",
            "3\u{b5}",
            "\u{b5}",
        ] {
            assert_eq!(timeout(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn a_caller_may_wait_shorter_or_longer_but_not_for_ever() {
        let said = |text: &str| {
            allowed(&HeaderMap::from_iter([(
                "grpc-timeout".parse().expect("a name"),
                text.parse().expect("a value"),
            )]))
        };
        let [zero, second, minutes] = [0, 1, 120].map(Duration::from_secs);
        assert_eq!(
            ["0n", "00000000H", "1S", "2M", "99999999H"].map(said),
            [zero, zero, second, minutes, MOST].map(Ok)
        );
        assert_eq!(allowed(&HeaderMap::new()), Ok(ALLOWED));
    }

    #[test]
    fn what_is_no_timeout_is_refused_in_words() {
        let headers = |values: &[&[u8]]| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append(
                    "grpc-timeout",
                    http::HeaderValue::from_bytes(value).expect("a value"),
                );
            }
            headers
        };
        for wrong in [
            &b"soon"[..],
            b"",
            b"S",
            b"1",
            b"-1S",
            b"1.5S",
            b"1s",
            b"123456789S",
            b"\xff",
        ] {
            let problem = allowed(&headers(&[wrong])).expect_err("no timeout");
            assert_eq!(
                (problem.kind, problem.faults[0].pointer.as_str()),
                (ErrorKind::Invalid, "grpc-timeout")
            );
        }
        let problem = allowed(&headers(&[b"1S", b"2S"])).expect_err("two timeouts");
        let expected = "got several, expected one to eight digits and a unit of H, M, S, m, u or n";
        assert_eq!(problem.faults[0].detail, expected);
    }
}
