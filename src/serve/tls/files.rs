//! The files of TLS, and what they make together: a chain of certificates with the key that fits
//! it, and the authorities of clients.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use rustls::server::WebPkiClientVerifier;
use rustls::{InconsistentKeys, ServerConfig};

use crate::telemetry;
use crate::tls::{Pem, TlsError, Validity, provider};

/// HTTP/2 first, as everybody who can speaks it.
const PROTOCOLS: [&[u8]; 2] = [b"h2", b"http/1.1"];

/// The files of TLS, by their paths.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsFiles {
    /// The certificate of the service, and those between it and its authority.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
    /// The certificates of authorities, one of which every client has a certificate of; without
    /// them clients need none.
    pub client_authorities: Option<PathBuf>,
}

/// What the files held at one moment.
pub(super) struct Contents {
    certificate: Pem,
    key: Pem,
    client_authorities: Option<Pem>,
}

/// The certificate chain, key and authorities that a handshake needs.
pub(super) struct Certified {
    pub config: Arc<ServerConfig>,
    /// The digest of the authorities of clients.
    pub authorities: blake3::Hash,
    validity: Validity,
}

impl Contents {
    pub(super) fn read_files(files: &TlsFiles) -> Result<Self, TlsError> {
        let authorities = files.client_authorities.as_ref();
        Ok(Self {
            certificate: Pem::read_file("--tls-cert", &files.certificate)?,
            key: Pem::read_file("--tls-key", &files.key)?,
            client_authorities: authorities
                .map(|path| Pem::read_file("--tls-client-ca", path))
                .transpose()?,
        })
    }

    /// Returns a digest of everything, by which a change is known.
    pub(super) fn digest(&self) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        for pem in [
            Some(&self.certificate),
            Some(&self.key),
            self.client_authorities.as_ref(),
        ]
        .into_iter()
        .flatten()
        {
            hasher
                .update(&(pem.bytes().len() as u64).to_le_bytes())
                .update(pem.bytes());
        }
        hasher.finalize()
    }

    pub(super) fn certified(&self) -> Result<Certified, TlsError> {
        let chain = self.certificate.certificates()?;
        let validity = Validity::of_certificate(&chain[0]);
        let validity = validity.ok_or_else(|| {
            self.certificate
                .fault("is damaged, expected a certificate of X.509")
        })?;
        let config =
            ServerConfig::builder_with_provider(provider()).with_safe_default_protocol_versions();
        let config = config.map_err(|error| self.certificate.fault(error.to_string()))?;

        let config = match &self.client_authorities {
            None => config.with_no_client_auth(),
            Some(pem) => {
                let authorities = Arc::new(pem.authorities()?);
                let verifier =
                    WebPkiClientVerifier::builder_with_provider(authorities, provider()).build();
                config.with_client_cert_verifier(
                    verifier.map_err(|error| pem.fault(error.to_string()))?,
                )
            }
        };
        let mut config = config
            .with_single_cert(chain, self.key.key()?)
            .map_err(|error| self.rejection(&error))?;
        config.alpn_protocols = PROTOCOLS.map(<[u8]>::to_vec).into();
        let authorities = blake3::hash(self.client_authorities.as_ref().map_or(&[], Pem::bytes));
        Ok(Certified {
            config: Arc::new(config),
            authorities,
            validity,
        })
    }

    /// Returns which file rustls does not take, and why.
    fn rejection(&self, error: &rustls::Error) -> TlsError {
        match error {
            rustls::Error::InconsistentKeys(InconsistentKeys::KeyMismatch) => {
                let path = self.certificate.path();
                self.key.fault(format!("does not fit the certificate of --tls-cert {path:?}, expected its private key"))
            }
            rustls::Error::InvalidCertificate(_) => self.certificate.fault(format!("cannot be used ({error})")),
            _ => self.key.fault(format!(
                "cannot be used ({error}), expected an RSA key of 2048 to 4096 bits, an ECDSA key on P-256 or P-384, or an Ed25519 key"
            )),
        }
    }
}

impl Certified {
    /// Tells in the metrics, and where something is odd in the log, how long the certificate is
    /// valid.
    pub(super) fn tell(&self) {
        let now = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |since| since.as_secs() as i64);
        let Validity { begins, ends } = self.validity;
        telemetry::certificate_expires(ends);

        if ends < now {
            tracing::warn!(
                expired_days_ago = (now - ends) / 86_400,
                "the certificate has expired: clients refuse it"
            );
        } else if now < begins {
            tracing::warn!(
                valid_in_days = (begins - now) / 86_400,
                "the certificate is not valid yet: clients refuse it"
            );
        }
    }
}
