//! One request over a connection that is there already, by whatever it goes.

use http::{Request, Response};
use hyper::body::{Body, Incoming};
use hyper_util::rt::{TokioExecutor, TokioIo};
use tokio::io::{AsyncRead, AsyncWrite};

/// Asks over HTTP/2, or over HTTP/1.1.
pub async fn exchange<S, B>(stream: S, request: Request<B>, is_http2: bool) -> Response<Incoming>
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    B: Body<Data: Send, Error: std::error::Error + Send + Sync> + Unpin + Send + 'static,
{
    let stream = TokioIo::new(stream);
    if is_http2 {
        let (mut sender, connection) =
            hyper::client::conn::http2::handshake(TokioExecutor::new(), stream)
                .await
                .expect("HTTP/2");
        tokio::spawn(connection);
        return sender.send_request(request).await.expect("answered");
    }
    let (mut sender, connection) = hyper::client::conn::http1::handshake(stream)
        .await
        .expect("HTTP/1");
    tokio::spawn(connection);
    sender.send_request(request).await.expect("answered")
}
