//! Options of a connection: with which key it asks, and whom it trusts.

use nudge_core::domain::Secret;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Request, Status};

use crate::handshake::ClientTls;

/// What every call goes over: the channel, with the key on each request.
pub type Wire = InterceptedService<Channel, Bearer>;

/// What a connection is opened with.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Sent as `authorization: Bearer KEY` on each request.
    pub key: Option<Secret>,
    /// How the service is known over TLS.
    pub tls: ClientTls,
}

impl Options {
    /// Asks with a key, as `authorization: Bearer KEY` on each request.
    pub fn key(mut self, key: Secret) -> Self {
        self.key = Some(key);
        self
    }

    /// Knows the service over TLS by these certificates.
    pub fn tls(mut self, tls: ClientTls) -> Self {
        self.tls = tls;
        self
    }

    pub(crate) fn bearer(&self) -> Bearer {
        Bearer(self.key.as_ref().map(authorization))
    }
}

/// Returns the header that shows a key.
fn authorization(key: &Secret) -> MetadataValue<Ascii> {
    let value = MetadataValue::try_from(format!("Bearer {}", key.reveal()));
    let mut value = value.expect("a key is of the alphabet of tokens");
    // Nothing shows it, and HTTP/2 keeps it out of its tables.
    value.set_sensitive(true);
    value
}

/// An interceptor that puts a key (bearer token) on each request, where there is one.
#[derive(Debug, Clone)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request
                .metadata_mut()
                .insert("authorization", value.clone());
        }
        Ok(request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_goes_along_and_is_not_shown() {
        let key = Secret::of_random(std::array::from_fn(|at| 0xa0 + at as u8));
        let options = Options::default().key(key.clone());
        let mut bearer = options.bearer();
        let request = bearer.call(Request::new(())).expect("let through");
        let value = request.metadata().get("authorization").expect("there");
        assert_eq!(
            value.to_str().expect("text"),
            format!("Bearer {}", key.reveal())
        );
        for shown in [
            format!("{options:?}"),
            format!("{bearer:?}"),
            format!("{request:?}"),
        ] {
            assert!(!shown.contains(&key.reveal()[6..20]), "{shown}");
        }
        let none = Options::default()
            .bearer()
            .call(Request::new(()))
            .expect("let through");
        assert!(none.metadata().get("authorization").is_none());
    }
}
