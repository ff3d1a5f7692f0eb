//! Hosts: by which names the service may be asked for. A page whose name is made to mean this
//! machine (DNS rebinding) comes with a name of its own.

use std::net::IpAddr;

use axum::extract::Request;
use http::header;
use http::uri::Authority;

use super::denials::shortened;
use crate::error::{ErrorKind, Problem};

/// The allow-list of host names that a service goes by.
pub struct Hosts {
    listen: Option<IpAddr>,
    /// Lower case; `*.example.org` stands for every name below.
    names: Vec<String>,
}

impl Hosts {
    /// Makes the names of a service that listens there and has these besides.
    pub fn new(listen: Option<IpAddr>, names: &[String]) -> Self {
        Self {
            listen,
            names: names.iter().map(|name| plain(name)).collect(),
        }
    }

    /// Refuses a request for another host. One that names none is from no browser.
    pub fn admit(&self, request: &Request) -> Result<(), Problem> {
        asked_for(request).into_iter().try_for_each(|host| {
            let is_ours = host.as_ref().is_ok_and(|host| self.has(host.host()));
            if is_ours { Ok(()) } else { Err(refused(&host)) }
        })
    }

    /// Returns whether a host is one of the names that were given.
    pub fn is_given(&self, host: &str) -> bool {
        let host = plain(host);
        let name = host.trim_start_matches('[').trim_end_matches(']');
        self.is_named(name) || self.names.contains(&host)
    }

    fn has(&self, host: &str) -> bool {
        let host = plain(host);
        let name = host.trim_start_matches('[').trim_end_matches(']');
        match name.parse::<IpAddr>() {
            Ok(address) => {
                self.is_address(address)
                    || self
                        .names
                        .iter()
                        .any(|known| known == name || *known == host)
            }
            Err(_) => name == "localhost" || name.ends_with(".localhost") || self.is_named(name),
        }
    }

    /// A service that listens on every address of its machine may be asked for by any: a page that
    /// comes by an address has no name that could be made to mean another.
    fn is_address(&self, address: IpAddr) -> bool {
        let is_listened_on = |listen: IpAddr| {
            listen.is_unspecified() || listen.to_canonical() == address.to_canonical()
        };
        address.to_canonical().is_loopback() || self.listen.is_some_and(is_listened_on)
    }

    fn is_named(&self, name: &str) -> bool {
        let is_below = |known: &str, top: &str| {
            name.strip_suffix(top)
                .is_some_and(|below| below.ends_with('.') && below.len() > 1 && !known.is_empty())
        };
        self.names
            .iter()
            .any(|known| match known.strip_prefix("*.") {
                Some(top) => is_below(known, top),
                None => known == "*" || known == name,
            })
    }
}

/// Returns every host that a request asks for: the authority of its URI, which HTTP/2 has, and its
/// header.
pub fn asked_for(request: &Request) -> Vec<Result<Authority, String>> {
    let in_uri = request
        .uri()
        .authority()
        .map(|authority| parse_authority(authority.as_str().as_bytes()));
    let headers = request
        .headers()
        .get_all(header::HOST)
        .iter()
        .map(|host| parse_authority(host.as_bytes()));

    in_uri.into_iter().chain(headers).collect()
}

fn parse_authority(bytes: &[u8]) -> Result<Authority, String> {
    let authority = Authority::try_from(bytes).ok();
    // A user before the name is of another place, and hides the name from whoever reads.
    authority
        .filter(|authority| !authority.as_str().contains('@'))
        .ok_or_else(|| shortened(bytes))
}

/// Lower case, and without the dot that ends a whole name.
fn plain(name: &str) -> String {
    name.strip_suffix('.').unwrap_or(name).to_ascii_lowercase()
}

fn refused(host: &Result<Authority, String>) -> Problem {
    let host = host
        .as_ref()
        .map_or_else(String::clone, |host| shortened(host.as_str().as_bytes()));
    let message = format!(
        "host {host:?} is no name of this service: expected a loopback name, the address that it listens on, or one that --hosts names"
    );
    Problem::new(ErrorKind::Forbidden, "HOST_NOT_ALLOWED", message)
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn admits(hosts: &Hosts, host: &str) -> bool {
        let request = Request::get("/")
            .header(header::HOST, host)
            .body(Body::empty())
            .expect("a request");
        hosts.admit(&request).is_ok()
    }

    #[test]
    fn a_service_goes_by_loopback_names_its_address_and_the_names_it_is_given() {
        let names = ["Nudge.Example.org".to_owned(), "*.lab".into()];
        let hosts = Hosts::new("10.1.2.3".parse().ok(), &names);
        for ours in [
            "localhost",
            "LOCALHOST:80",
            "localhost.",
            "a.localhost:8080",
            "127.0.0.1",
            "127.9.9.9:1",
            "[::1]:8080",
            "10.1.2.3:8080",
            "nudge.example.org",
            "NUDGE.EXAMPLE.ORG.:443",
            "a.lab",
            "b.a.lab:80",
        ] {
            assert!(admits(&hosts, ours), "{ours}");
        }
        for foreign in [
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "10.1.2.4",
            "lab",
            ".lab",
            "alab",
            "nudge.example.org.evil",
            "[::2]",
            "0.0.0.0",
            "",
            "a b",
            "é",
            "128.0.0.1",
        ] {
            assert!(!admits(&hosts, foreign), "{foreign}");
        }
    }

    #[test]
    fn every_host_of_a_request_is_looked_at() {
        let hosts = Hosts::new(None, &[]);
        let both = |uri: &str, host: &str| {
            let request = Request::get(uri)
                .header(header::HOST, "localhost")
                .header(header::HOST, host);
            hosts
                .admit(&request.body(Body::empty()).expect("a request"))
                .is_ok()
        };
        assert!(both("/", "localhost") && both("http://127.0.0.1/", "localhost"));
        assert!(!both("http://user@localhost/", "localhost") && !both("/", "user@localhost"));
        assert!(!both("/", "evil.example") && !both("http://evil.example/", "localhost"));
        assert!(
            hosts.admit(&Request::new(Body::empty())).is_ok(),
            "no browser leaves it out"
        );
    }

    #[test]
    fn who_listens_everywhere_is_asked_for_by_any_address() {
        let hosts = Hosts::new("0.0.0.0".parse().ok(), &[]);
        assert!(
            admits(&hosts, "192.168.1.5:8080")
                && admits(&hosts, "[2001:db8::1]")
                && !admits(&hosts, "evil.example")
        );
    }
}
