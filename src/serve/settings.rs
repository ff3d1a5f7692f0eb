//! Settings of the faces: what may be set, and where they are reached.

use std::net::IpAddr;

use super::access::Keyring;
use super::connections::limits::Limits;

/// Settings of the faces.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// The origins whose pages may call from a browser, `https://example.org`; `*` for any. None by
    /// default.
    pub cors_origins: Vec<String>,
    /// Who is let in; everybody where it is absent.
    pub keys: Option<Keyring>,
    /// Names, beside loopback names and the address that is listened on, by which the service may
    /// be asked for: `nudge.example.org`, `*.example.org`.
    pub hosts: Vec<String>,
    /// What connections may take.
    pub limits: Limits,
}

/// An endpoint: the address at which the service is reached.
#[derive(Debug, Clone, Copy, Default)]
pub struct Endpoint {
    /// The address that is listened on, if any is.
    pub ip: Option<IpAddr>,
    /// Whether the port speaks TLS.
    pub speaks_tls: bool,
}
