//! Retries: a question is asked again while the service is away (back-off) or still makes the
//! answer, as long apart as it wants it (`RetryInfo`).

use std::time::Duration;

use tokio::time::Instant;
use tonic::{Response, Status};
use tonic_types::StatusExt;

use crate::ClientError;
use crate::backoff::Backoff;
use crate::error::{is_transient, words_of};

/// How long a question is asked again while nobody answers it.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// How long it is asked again while the service says that it is still making the answer.
const LONG_PATIENCE: Duration = Duration::from_secs(30 * 60);

/// The longest time until the next attempt that a service may ask for.
const LONGEST_ADVICE: Duration = Duration::from_secs(10);

/// Asks until the service answers, which may be away for a moment: as patiently as a producer that
/// sends. Where it is still making the answer, it is asked for much longer.
pub async fn patiently<T, F>(ask: impl FnMut() -> F) -> Result<T, ClientError>
where
    F: Future<Output = Result<Response<T>, Status>>,
{
    patiently_telling(ask, |_| ()).await
}

/// Asks as [`patiently`], and tells before each further attempt why there was no answer: how far
/// the service is with it.
pub async fn patiently_telling<T, F>(
    mut ask: impl FnMut() -> F,
    mut tell: impl FnMut(&str),
) -> Result<T, ClientError>
where
    F: Future<Output = Result<Response<T>, Status>>,
{
    let asking = Instant::now();
    let mut backoff = Backoff::since(asking);
    loop {
        let status = match ask().await {
            Ok(response) => return Ok(response.into_inner()),
            Err(status) => status,
        };

        let goes_on = if is_still_working(&status) {
            backoff = Backoff::since(Instant::now());
            asking.elapsed() < LONG_PATIENCE
        } else {
            is_transient(&status) && backoff.elapsed(Instant::now()) < PATIENCE
        };
        if !goes_on {
            return Err(status.into());
        }

        tell(&unanswered_because(&status));
        let wait = backoff.next_delay(words_of(&status));
        tokio::time::sleep(wait.max(advised(&status).unwrap_or_default())).await;
    }
}

/// Returns why there was no answer: what the service says, or that it says nothing.
fn unanswered_because(status: &Status) -> String {
    match status.get_details_error_info() {
        Some(_) => words_of(status),
        None => format!("the service does not answer ({})", words_of(status)),
    }
}

/// Returns after how long the service wants to be asked again; what it says is bounded, so that
/// nobody waits for ever.
pub(crate) fn advised(status: &Status) -> Option<Duration> {
    let advised = status.get_details_retry_info()?.retry_delay?;
    Some(advised.min(LONGEST_ADVICE))
}

/// Returns whether the service goes on making what was asked for.
fn is_still_working(status: &Status) -> bool {
    status
        .get_details_error_info()
        .is_some_and(|info| info.reason == "STILL_WORKING")
}

#[cfg(test)]
mod tests {
    use tonic::Code;

    use super::*;

    type Answer = Result<Response<u64>, Status>;

    fn unavailable(reason: &str, message: &str) -> Answer {
        let mut details = tonic_types::ErrorDetails::with_error_info(reason, "nudge", []);
        details.set_retry_info(Some(Duration::from_secs(1)));
        Err(Status::with_error_details(
            Code::Unavailable,
            message,
            details,
        ))
    }

    /// Asks a service that answers by the number of the attempt, and returns what came out, what
    /// was told, and how often it was asked.
    async fn asked(answer: impl Fn(u64) -> Answer) -> (Result<u64, ClientError>, Vec<String>, u64) {
        let (mut times, mut told) = (0, Vec::new());
        let ask = || {
            times += 1;
            std::future::ready(answer(times))
        };
        let answer = patiently_telling(ask, |why| told.push(why.to_owned())).await;
        (answer, told, times)
    }

    #[tokio::test(start_paused = true)]
    async fn an_answer_that_is_still_made_is_asked_for_again() {
        let far = |times| format!("the ranking is still being made: {times} of 3 states measured");
        let began = Instant::now();
        let answer = |times| match times {
            3 => Ok(Response::new(7)),
            _ => unavailable("STILL_WORKING", &far(times)),
        };
        assert_eq!(asked(answer).await, (Ok(7), vec![far(1), far(2)], 3));
        assert_eq!(
            began.elapsed(),
            Duration::from_secs(2),
            "as long apart as the service wants it"
        );
    }

    #[tokio::test(start_paused = true)]
    async fn it_is_not_asked_for_ever() {
        let began = Instant::now();
        let (answer, ..) = asked(|_| unavailable("STILL_WORKING", "0 of 3 states measured")).await;
        let ClientError::Refused(refusal) = answer.expect_err("it was never answered") else {
            panic!("not refused")
        };
        assert_eq!(
            (refusal.reason.as_str(), refusal.message.as_str()),
            ("STILL_WORKING", "0 of 3 states measured")
        );
        assert!(
            (LONG_PATIENCE..LONG_PATIENCE + LONGEST_ADVICE).contains(&began.elapsed()),
            "{:?}",
            began.elapsed()
        );

        let began = Instant::now();
        asked(|_| unavailable("DRAINING", "the service is stopping"))
            .await
            .0
            .expect_err("it never came back");
        assert!(
            (PATIENCE..PATIENCE + LONGEST_ADVICE).contains(&began.elapsed()),
            "{:?}",
            began.elapsed()
        );
        let lost = |times| {
            if times == 2 {
                Ok(Response::new(7))
            } else {
                Err(Status::unavailable("tcp connect error"))
            }
        };
        let told = vec!["the service does not answer (tcp connect error)".to_owned()];
        assert_eq!(asked(lost).await, (Ok(7), told, 2));
        let (_, told, times) = asked(|_| Err(Status::not_found("no"))).await;
        assert_eq!((told.len(), times), (0, 1), "a refusal is for good");
    }
}
