//! Asking over REST as plainly as possible, and how long the slowest answers take.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;

use super::{quantile, report};

/// Asks over a kept connection, as plainly as possible: the client should cost little. Returns the
/// body.
pub async fn get(stream: &mut (impl AsyncRead + AsyncWrite + Unpin), path: &str) -> Vec<u8> {
    get_with(stream, path, "").await
}

/// Asks as [`get`] does, with further lines of the head, each of which ends.
pub async fn get_with(
    stream: &mut (impl AsyncRead + AsyncWrite + Unpin),
    path: &str,
    lines: &str,
) -> Vec<u8> {
    let request = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\n{lines}\r\n");
    stream.write_all(request.as_bytes()).await.expect("sent");
    stream.flush().await.expect("sent");
    let mut answer = Vec::with_capacity(4_096);
    loop {
        stream.read_buf(&mut answer).await.expect("answered");
        let Some(end) = answer.windows(4).position(|four| four == b"\r\n\r\n") else {
            continue;
        };
        let head = String::from_utf8_lossy(&answer[..end]).to_ascii_lowercase();
        assert!(
            head.starts_with("http/1.1 200"),
            "{head} {}",
            String::from_utf8_lossy(&answer[end..])
        );
        let length = head
            .split("content-length: ")
            .nth(1)
            .and_then(|rest| rest.lines().next()?.parse::<usize>().ok());
        let length = length.expect("a length");
        if answer.len() >= end + 4 + length {
            return answer.split_off(end + 4);
        }
    }
}

/// Asks once, and returns the whole answer, head and body, whatever its status.
pub async fn get_text(address: SocketAddr, path: &str) -> String {
    let mut stream = TcpStream::connect(address).await.expect("listening");
    let request = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await.expect("answered");
    answer
}

/// Returns how long each of 2,000 questions took, asked one after the other.
pub async fn latencies(address: SocketAddr, path: &str) -> Vec<Duration> {
    let mut stream = TcpStream::connect(address).await.expect("listening");
    stream.set_nodelay(true).expect("a socket");
    let mut latencies = Vec::new();
    for _ in 0..2_000 {
        let started = Instant::now();
        get(&mut stream, path).await;
        latencies.push(started.elapsed());
    }
    latencies
}

/// Prints the slowest hundredth of questions while something goes on beside the same while
/// something else does, or nothing.
pub fn report_tail(
    when: &str,
    mut during: Vec<Duration>,
    yardstick: &str,
    mut beside: Vec<Duration>,
    target: &str,
) {
    let micros = |latencies: &mut Vec<Duration>, q| quantile(latencies, q).as_secs_f64() * 1e6;
    println!(
        "one question, p50: {:.0} us {when}, {:.0} us {yardstick}",
        micros(&mut during, 0.5),
        micros(&mut beside, 0.5)
    );
    let (during, beside) = (micros(&mut during, 0.99), micros(&mut beside, 0.99));
    report(
        &format!("one question, p99 {when}"),
        during,
        &format!("p99 {yardstick}"),
        beside,
        "us",
        target,
    );
}
