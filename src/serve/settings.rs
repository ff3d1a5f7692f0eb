//! What may be set about the faces.

use std::net::IpAddr;

use super::access::Keyring;
use super::connections::limits::Limits;

/// What may be set about the faces.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// The origins whose pages may call from a browser, `https://example.org`; `*` for any. None by
    /// default.
    pub cors_origins: Vec<String>,
    /// Who is let in; everybody where it is absent.
    pub keys: Option<Keyring>,
    /// The address that is listened on.
    pub listen: Option<IpAddr>,
    /// Names, beside loopback names and the address that is listened on, by which the service may
    /// be asked for: `nudge.example.org`, `*.example.org`.
    pub hosts: Vec<String>,
    /// Whether the port speaks TLS.
    pub speaks_tls: bool,
    /// What connections may take.
    pub limits: Limits,
}
