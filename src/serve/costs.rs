//! What calls cost on either face: how long one may take (its deadline), and about how large an
//! answer is.

use std::time::Duration;

/// How long a call may take, unless its caller says otherwise (gRPC's `grpc-timeout`). Streams take
/// as long as they want.
pub const ALLOWED: Duration = Duration::from_secs(30);

/// About what is told of a state, in bytes.
pub const STATE_BYTES: usize = 1_024;
