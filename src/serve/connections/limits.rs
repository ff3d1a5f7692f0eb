//! Limits on connections: how many there are, how long each may take over what, and how many bytes
//! their unfinished messages hold.

use std::time::Duration;

/// Limits of connections: timeouts, and what they may take of the service.
#[derive(Debug, Clone)]
pub struct Limits {
    /// The most connections. When there are as many, the one that waited longest without a request
    /// makes room for a new one.
    pub connections: usize,
    /// The most connections beyond these, which may ask what operators ask and nothing else: taken
    /// when nobody can make room.
    pub guests: usize,
    /// From the accept, or from the first byte of a later request, to the end of a request's
    /// headers.
    pub head: Duration,
    /// How long a connection stays open without a request.
    pub idle: Duration,
    /// How long a body may bring no byte, and how long an answer may wait for its reader.
    pub stalled: Duration,
    /// From the beginning of a message to its end.
    pub message: Duration,
    /// How long what is left of a refused body is read and dropped, so that its sender comes to
    /// read the refusal.
    pub unwanted: Duration,
    /// The age at which a connection is asked to leave, give or take a tenth; never if it is zero.
    pub age: Duration,
    /// How long a connection that was asked to leave may take to finish its requests.
    pub grace: Duration,
    /// How long connections may take to end once the service drains.
    pub drain: Duration,
    /// The most bytes of unfinished messages, over all connections.
    pub unfinished_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 4_096,
            guests: 16,
            head: Duration::from_secs(10),
            idle: Duration::from_secs(30),
            stalled: Duration::from_secs(20),
            message: Duration::from_secs(30),
            unwanted: Duration::from_secs(10),
            age: Duration::from_secs(3_600),
            grace: Duration::from_secs(30),
            drain: Duration::from_secs(6),
            unfinished_bytes: 64 << 20,
        }
    }
}
