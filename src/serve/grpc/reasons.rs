//! Reasons of errors: a status that the gRPC machinery made by itself gets the details that ours
//! have.

use axum::body::Body;
use axum::extract::Request;
use axum::middleware::Next;
use axum::response::Response;
use http::HeaderMap;
use http_body::Frame;
use http_body_util::BodyExt;
use tonic::{Code, Status};

use crate::serve::status;

/// Gives every error a reason, whether it stands in headers or in trailers.
pub async fn give(request: Request, next: Next) -> Response {
    let (mut parts, body) = next.run(request).await.into_parts();
    complete(&mut parts.headers);
    let body = body.map_frame(|frame| match frame.into_trailers() {
        Ok(mut trailers) => {
            complete(&mut trailers);
            Frame::trailers(trailers)
        }
        Err(frame) => frame,
    });

    Response::from_parts(parts, Body::new(body))
}

fn complete(headers: &mut HeaderMap) {
    let status = Status::from_header_map(headers);
    let Some(bare) =
        status.filter(|status| status.code() != Code::Ok && status.details().is_empty())
    else {
        return;
    };
    // Others stay, such as which encodings are taken.
    status::of_grpc(&bare)
        .add_header(headers)
        .expect("its message is percent-encoded and its details are base64");
}
