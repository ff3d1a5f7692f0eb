//! Keys that are withdrawn or narrowed while a request is under way: before its body is whole,
//! before it says hello, before it is answered.

use std::convert::Infallible;
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::channel::mpsc;
use http::Request;
use http_body_util::{BodyExt, StreamBody};
use hyper::body::Frame;
use nudge::api::proto;
use tokio::net::TcpStream;
use tonic::Code;

use super::wire::{Answer, framed, message};
use super::{Guarded, bearer, key, keys};
use crate::support::exchange::exchange;
use crate::support::{hello, reason};

/// How soon a change acts.
const SOON: Duration = Duration::from_secs(1);

/// A body that is sent a piece at a time.
type Slow = StreamBody<mpsc::UnboundedReceiver<Result<Frame<Bytes>, Infallible>>>;

/// A request and its body.
struct Sent {
    method: &'static str,
    path: &'static str,
    media: &'static str,
    body: Vec<u8>,
}

impl Sent {
    fn rest(method: &'static str, path: &'static str, body: &str) -> Self {
        Self {
            method,
            path,
            media: "application/json",
            body: body.into(),
        }
    }

    fn grpc(path: &'static str, media: &'static str) -> Self {
        Self {
            method: "POST",
            path,
            media,
            body: framed(message(path, "lane")),
        }
    }

    fn is_grpc(&self) -> bool {
        self.media.starts_with("application/grpc")
    }

    /// Sends half of it, waits for what is to happen meanwhile, and sends the rest.
    async fn send(&self, guarded: &Guarded, key: &[u8], meanwhile: impl AsyncFnOnce()) -> Answer {
        let (body, pieces) = mpsc::unbounded();
        let request = Request::builder()
            .method(self.method)
            .uri(guarded.app.url(self.path));
        let request = request
            .header("content-type", self.media)
            .header("authorization", key);
        let request = request.header("host", guarded.app.address.to_string());
        let request = request.body(StreamBody::new(pieces)).expect("a request");
        let stream = TcpStream::connect(guarded.app.address)
            .await
            .expect("it listens");
        let answer = tokio::spawn(exchange::<_, Slow>(
            stream,
            request,
            self.media == "application/grpc",
        ));

        let (first, rest) = self.body.split_at(self.body.len() / 2);
        let send = |piece: &[u8]| {
            drop(body.unbounded_send(Ok(Frame::data(Bytes::copy_from_slice(piece)))))
        };
        send(first);
        // Long enough for the headers to be looked at.
        tokio::time::sleep(Duration::from_millis(200)).await;
        assert!(
            !answer.is_finished(),
            "{} {} waits for the rest",
            self.method,
            self.path
        );
        meanwhile().await;
        send(rest);
        body.close_channel();

        let (parts, body) = answer.await.expect("answered").into_parts();
        let body = body.collect().await.expect("whole");
        let mut headers = parts.headers;
        headers.extend(body.trailers().cloned().unwrap_or_default());
        let text = String::from_utf8_lossy(&body.to_bytes()).into_owned();
        Answer::from_parts(self.is_grpc(), parts.status.as_u16(), headers, text)
    }
}

fn requests() -> Vec<Sent> {
    const BATCH: &str = r#"{"producer": "p", "sequence": 1, "transitions": []}"#;
    let delete = "/nudge.v1.EnvironmentService/DeleteEnvironment";
    vec![
        Sent::rest("POST", "/v1/environments/lane/transitions", BATCH),
        Sent::rest(
            "PATCH",
            "/v1/environments/lane",
            r#"{"rule": {"min_visits": 7}}"#,
        ),
        Sent::rest(
            "PUT",
            "/v1/environments/lane",
            r#"{"rule": {"min_visits": 7}}"#,
        ),
        Sent::rest(
            "POST",
            "/v1/environments/lane/influence",
            r#"{"states": [{"distance": 0.6, "held": "dish"}]}"#,
        ),
        Sent::grpc(delete, "application/grpc"),
        Sent::grpc(delete, "application/grpc-web+proto"),
        Sent::grpc("/nudge.v1.IngestService/Write", "application/grpc"),
        Sent::grpc(
            "/nudge.v1.EnvironmentService/UpdateRule",
            "application/grpc",
        ),
    ]
}

#[tokio::test]
async fn a_body_that_is_slower_than_its_key_does_nothing() {
    for sent in requests() {
        let (key, line) = key("game read,ingest,train,admin");
        let digest = key.digest();
        for (change, status, told) in [
            (String::new(), 401, "UNAUTHENTICATED"),
            (
                format!("other {digest} read,ingest,train,admin"),
                401,
                "UNAUTHENTICATED",
            ),
            (
                format!("game {digest} read,ingest,train,admin environments=kitchen"),
                403,
                "ENVIRONMENT_FORBIDDEN",
            ),
        ] {
            let guarded = Guarded::start(&[&line]).await;
            let before = guarded
                .app
                .app
                .environments
                .find("lane")
                .expect("there")
                .rule
                .clone();
            let answer = sent
                .send(&guarded, &bearer(&key), async || {
                    guarded.ring.replace(keys(&[&change]))
                })
                .await;
            let case = format!(
                "{} {} as {}, {change:?}: {answer:?}",
                sent.method, sent.path, sent.media
            );
            assert_eq!(
                (answer.status, answer.reason.as_str()),
                (status, told),
                "{case}"
            );

            let environment = guarded.app.app.environments.find("lane").expect(&case);
            assert_eq!(environment.rule, before, "{case}");
            let producer = "p".parse().expect("an id");
            let committed = guarded
                .app
                .app
                .ingest
                .committed(&environment, &producer)
                .await
                .expect("read");
            assert_eq!(committed.get(), 0, "{case}");
        }
    }
}

#[tokio::test]
async fn a_scope_that_is_taken_away_ends_what_wanted_it() {
    for sent in requests() {
        let (key, line) = key("game read,ingest,train,admin");
        let guarded = Guarded::start(&[&line]).await;
        let narrowed = format!("game {} train", key.digest());
        let answer = sent
            .send(&guarded, &bearer(&key), async || {
                guarded.ring.replace(keys(&[&narrowed]))
            })
            .await;
        assert_eq!(
            (answer.status, answer.reason.as_str()),
            (403, "SCOPE_MISSING"),
            "{} {answer:?}",
            sent.path
        );
        guarded
            .app
            .app
            .environments
            .find("lane")
            .expect("still there");
    }
}

#[tokio::test]
async fn a_change_that_leaves_a_key_leaves_its_requests() {
    for sent in requests() {
        let (key, line) = key("game read,ingest,train,admin");
        let (_, other) = super::key("other read");
        let guarded = Guarded::start(&[&line]).await;
        let same = format!("{line} environments=lane,kitchen");
        let answer = sent
            .send(&guarded, &bearer(&key), async || {
                guarded.ring.replace(keys(&[&other, &same]))
            })
            .await;
        assert!(answer.is_let_in(), "{} {answer:?}", sent.path);
    }
}

#[tokio::test]
async fn a_list_shows_what_its_key_may_see_when_it_is_made() {
    let (key, line) = key("game read");
    let guarded = Guarded::start(&[&line]).await;
    let list = Sent {
        method: "POST",
        path: "/nudge.v1.EnvironmentService/ListEnvironments",
        media: "application/grpc",
        // A page of seven.
        body: framed(vec![0x08, 0x07]),
    };
    let narrowed = format!("game {} read environments=kitchen", key.digest());
    let answer = list
        .send(&guarded, &bearer(&key), async || {
            guarded.ring.replace(keys(&[&narrowed]))
        })
        .await;
    assert!(
        answer.is_let_in() && !answer.text.contains("lane"),
        "{answer:?}"
    );
    let answer = list
        .send(&guarded, &bearer(&key), async || {
            guarded.ring.replace(keys(&[]))
        })
        .await;
    assert_eq!(
        (answer.status, answer.reason.as_str()),
        (401, "UNAUTHENTICATED")
    );
}

#[tokio::test]
async fn an_answer_that_takes_longer_than_its_key_is_not_told() {
    for is_narrowed in [false, true] {
        let (key, line) = key("game read");
        let guarded = Guarded::start(&[&line]).await;
        // Whoever asks waits for a turn, which nobody gives back.
        let passes = &guarded.app.app.work.passes;
        let mut turns = Vec::new();
        while turns.len() < passes.workers() {
            turns.push(passes.enter().await.expect("free"));
        }
        let path = "/v1/environments/lane/summary";
        let request = reqwest::Client::new()
            .get(guarded.app.url(path))
            .header("authorization", bearer(&key));
        let asking = tokio::spawn(request.send());
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert!(!asking.is_finished(), "it waits");

        let changed = Instant::now();
        let narrowed = format!("game {} read environments=kitchen", key.digest());
        guarded.ring.replace(if is_narrowed {
            keys(&[&narrowed])
        } else {
            keys(&[])
        });
        let answer = asking.await.expect("it ends").expect("answered");
        assert_eq!(answer.status(), if is_narrowed { 403 } else { 401 });
        assert!(changed.elapsed() < SOON, "{:?}", changed.elapsed());
    }
}

#[tokio::test]
async fn a_stream_without_a_hello_ends_with_its_key() {
    for says_hello in [false, true] {
        let (key, line) = key("game ingest,read");
        let guarded = Guarded::start(&[&line]).await;
        let options = nudge::client::Options::default().key(key.clone());
        let connection =
            nudge::client::Connection::open_with(&guarded.app.address.to_string(), &options).await;
        let mut client = connection.expect("let in").ingest();
        let (messages, sending) = mpsc::unbounded();
        let mut stream = client.ingest(sending).await.expect("opened").into_inner();

        let changed = Instant::now();
        guarded.ring.replace(keys(&[]));
        if says_hello {
            let message = Some(proto::ingest_request::Message::Hello(hello("p")));
            messages
                .unbounded_send(proto::IngestRequest { message })
                .expect("open");
        }
        let end = stream.message().await.expect_err("no welcome");
        assert_eq!(
            (end.code(), reason(&end).as_str()),
            (Code::Unauthenticated, "UNAUTHENTICATED")
        );
        assert!(changed.elapsed() < SOON, "{:?}", changed.elapsed());
    }
}
