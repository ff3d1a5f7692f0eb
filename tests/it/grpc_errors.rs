//! Errors of the gRPC face: they fit into headers, and always have a reason, whoever made them.

use std::io::Write;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use nudge::api::proto;
use nudge::api::proto::influence_service_client::InfluenceServiceClient;
use reqwest::header::HeaderMap;
use serde_json::json;
use tonic::codec::CompressionEncoding;
use tonic::{Code, Status};
use tonic_types::StatusExt;

use crate::support::{TestApp, lane_schema};

const LIST: &str = "/nudge.v1.EnvironmentService/ListEnvironments";

/// Posts one message as gRPC-Web, whose errors without a message come in headers, and returns its
/// status.
async fn post(app: &TestApp, path: &str, encoding: Option<&str>, message: &[u8]) -> Status {
    let length = u32::try_from(message.len()).expect("short").to_be_bytes();
    let body = [&[u8::from(encoding.is_some())], &length[..], message].concat();
    let request = reqwest::Client::new()
        .post(app.url(path))
        .header("content-type", "application/grpc-web")
        .body(body);
    let request = match encoding {
        Some(encoding) => request.header("grpc-encoding", encoding),
        None => request,
    };
    let response = request.send().await.expect("answered");
    assert_eq!(response.status().as_u16(), 200, "{path}");
    let headers: HeaderMap = response.headers().clone();
    assert!(
        headers["content-type"]
            .to_str()
            .expect("text")
            .starts_with("application/grpc-web"),
        "{headers:?}"
    );
    Status::from_header_map(&headers).unwrap_or_else(|| Status::ok(""))
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::best());
    packed.write_all(bytes).expect("memory");
    packed.finish().expect("memory")
}

fn deflate(bytes: &[u8]) -> Vec<u8> {
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::best());
    packed.write_all(bytes).expect("memory");
    packed.finish().expect("memory")
}

#[tokio::test]
async fn what_the_machinery_refuses_has_a_reason_too() {
    let app = TestApp::start().await;
    let large = vec![0; 5 << 20];
    let garbage = [0xff; 3];
    let cases = [
        (
            LIST,
            None,
            garbage.to_vec(),
            Code::InvalidArgument,
            "UNDECODABLE",
        ),
        (
            LIST,
            None,
            large.clone(),
            Code::OutOfRange,
            "MESSAGE_TOO_LARGE",
        ),
        (
            LIST,
            Some("gzip"),
            gzip(&large),
            Code::OutOfRange,
            "MESSAGE_TOO_LARGE",
        ),
        (
            LIST,
            Some("gzip"),
            garbage.to_vec(),
            Code::InvalidArgument,
            "UNDECODABLE",
        ),
        (
            LIST,
            Some("zstd"),
            garbage.to_vec(),
            Code::Unimplemented,
            "UNSUPPORTED_MEDIA_TYPE",
        ),
        (
            "/nudge.v1.EnvironmentService/Nothing",
            None,
            Vec::new(),
            Code::Unimplemented,
            "PATH_NOT_FOUND",
        ),
        (
            "/nudge.v1.NothingService/Nothing",
            None,
            Vec::new(),
            Code::Unimplemented,
            "PATH_NOT_FOUND",
        ),
        (
            "/v2/nothing",
            None,
            Vec::new(),
            Code::Unimplemented,
            "PATH_NOT_FOUND",
        ),
        (
            "/grpc.health.v1.Health/Check",
            None,
            b"\x0a\x01x".to_vec(),
            Code::NotFound,
            "NOT_FOUND",
        ),
    ];
    for (path, encoding, message, code, reason) in cases {
        let status = post(&app, path, encoding, &message).await;
        let info = status
            .get_details_error_info()
            .unwrap_or_else(|| panic!("{path} {encoding:?}: {status:?}"));
        assert_eq!(
            (status.code(), info.reason.as_str(), info.domain.as_str()),
            (code, reason, "nudge"),
            "{status:?}"
        );
        assert!(!status.message().is_empty(), "{path} {encoding:?}");
    }
}

#[tokio::test]
async fn packed_messages_are_read() {
    let app = TestApp::start().await;
    app.lane().await;
    assert_eq!(
        post(&app, LIST, Some("gzip"), &gzip(b"")).await.code(),
        Code::Ok
    );
    assert_eq!(
        post(&app, LIST, Some("deflate"), &deflate(b""))
            .await
            .code(),
        Code::Ok
    );
    for encoding in [CompressionEncoding::Gzip, CompressionEncoding::Deflate] {
        let mut packing = app
            .environments()
            .await
            .send_compressed(encoding)
            .accept_compressed(encoding);
        let request = proto::ApplyEnvironmentRequest {
            name: "packed".into(),
            schema: Some(lane_schema()),
            rule: None,
            derived: None,
        };
        packing.apply_environment(request).await.expect("read");
    }
}

#[tokio::test]
async fn of_many_faults_ten_are_told_and_the_number_of_the_rest() {
    let app = TestApp::start().await;
    app.lane().await;
    let keys: Vec<String> = (0..100)
        .map(|i| format!("{}.{i}", "9".repeat(i * 100)))
        .collect();
    let scope = proto::Scope {
        environment: "lane".into(),
        ..Default::default()
    };
    let request = proto::BatchGetInfluenceRequest {
        scope: Some(scope),
        keys: keys.clone(),
        ..Default::default()
    };

    // A client that takes no more headers than others do.
    let endpoint = tonic::transport::Endpoint::from_shared(app.url("")).expect("an address");
    let channel = endpoint
        .http2_max_header_list_size(8 << 10)
        .connect()
        .await
        .expect("it listens");
    let refused = InfluenceServiceClient::new(channel)
        .batch_get_influence(request)
        .await
        .expect_err("wrong");
    assert_eq!(refused.code(), Code::InvalidArgument, "{refused:?}");
    let told = refused
        .get_details_bad_request()
        .expect("violations")
        .field_violations
        .len();
    let info = refused.get_details_error_info().expect("a reason");
    let more: usize = info.metadata["more_faults"].parse().expect("a number");
    assert!((1..=10).contains(&told));
    assert_eq!(told + more, 100);

    // REST tells them in a body, all of them.
    let (status, problem) = app
        .rest(
            "POST",
            "/v1/environments/lane/influence",
            Some(&json!({ "keys": keys })),
        )
        .await;
    assert_eq!(
        (status, problem["errors"].as_array().map(Vec::len)),
        (400, Some(100))
    );
}
