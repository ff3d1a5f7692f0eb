//! Socket addresses, host names and origins on the command line.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

/// Reads an address to listen on.
pub(super) fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| {
        format!("got {text:?}, expected an IP address and a port such as 127.0.0.1:8080")
    })
}

/// Reads a name of a host: without scheme, port or path.
pub(super) fn host(text: &str) -> Result<String, String> {
    let is_host = !text.is_empty()
        && text.bytes().all(|byte| is_host_byte(byte) || byte == b'*')
        && !has_port(text);

    is_host.then(|| text.to_owned()).ok_or_else(|| {
        format!("got {text:?}, expected a name without scheme and port such as nudge.example.org or *.example.org")
    })
}

/// Reads an origin: scheme, host and perhaps a port, or `*` for any. It is kept as browsers write
/// it (RFC 6454, section 6.2): in small letters, and without the port that its scheme implies.
pub(super) fn origin(text: &str) -> Result<String, String> {
    let plain = text.strip_suffix('/').unwrap_or(text);
    let is_origin = plain.split_once("://").is_some_and(|(scheme, host)| {
        is_scheme(scheme) && !host.is_empty() && host.bytes().all(is_host_byte)
    });

    (is_origin || text == "*").then(|| as_browsers_write(plain)).ok_or_else(|| {
        format!("got {text:?}, expected a scheme, a host and perhaps a port such as https://example.org, or *")
    })
}

fn as_browsers_write(origin: &str) -> String {
    let small = origin.to_ascii_lowercase();
    let implied = match small.split_once("://") {
        Some(("https", _)) => ":443",
        Some(("http", _)) => ":80",
        _ => return small,
    };
    small.strip_suffix(implied).unwrap_or(&small).to_owned()
}

/// Returns an address that a client on this machine can reach.
pub(super) fn reachable(address: SocketAddr) -> SocketAddr {
    match address.ip() {
        ip if ip.is_unspecified() => {
            SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), address.port())
        }
        _ => address,
    }
}

/// Tells whether a port stands behind a name; an address of IPv6 has colons of its own.
fn has_port(text: &str) -> bool {
    text.rsplit_once(':')
        .is_some_and(|(name, port)| !name.contains(':') && port.parse::<u16>().is_ok())
}

fn is_scheme(text: &str) -> bool {
    text.starts_with(|first: char| first.is_ascii_alphabetic())
        && text
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || b"+-.".contains(&byte))
}

fn is_host_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || b"-._:[]".contains(&byte)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_has_a_scheme_and_no_path() {
        for (text, kept) in [
            ("https://example.org", "https://example.org"),
            ("http://localhost:3000", "http://localhost:3000"),
            ("https://[::1]:8443/", "https://[::1]:8443"),
            ("tauri://localhost", "tauri://localhost"),
            ("HTTPS://A.example:443", "https://a.example"),
            ("http://a.example:80/", "http://a.example"),
            ("http://a.example:443", "http://a.example:443"),
            ("https://a.example:8443", "https://a.example:8443"),
            ("app://a:443", "app://a:443"),
            ("*", "*"),
        ] {
            assert_eq!(origin(text).as_deref(), Ok(kept), "{text}");
        }
        for wrong in [
            "",
            "example.org",
            "https://",
            "://x",
            "https://example.org/path",
            "https://*.example.org",
            "null",
            " ",
        ] {
            let told = origin(wrong).expect_err(wrong);
            assert!(
                told.starts_with(&format!("got {wrong:?}, expected a scheme, a host")),
                "{told}"
            );
        }
    }
}
