//! What TLS needs on either side of a connection: X.509 certificates and private keys in PEM files,
//! and the cryptography provider.
//!
//! Nothing here opens a connection. An error names the flag, the path and what was expected, never
//! a content: files are mixed up, and one of them is a secret.

mod pem;
mod validity;

use std::sync::Arc;

use rustls::crypto::CryptoProvider;

pub use pem::{Pem, TlsError};
pub use validity::Validity;

/// Returns the provider of cryptography: ring, which builds in seconds with a C compiler alone.
pub fn provider() -> Arc<CryptoProvider> {
    Arc::new(rustls::crypto::ring::default_provider())
}
