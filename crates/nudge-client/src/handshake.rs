//! TLS towards a service: whom the client trusts, how it proves who it is, and what went wrong in
//! words for people.
//!
//! tonic's own TLS would do for all but two things: to trust one certificate for itself, as a probe
//! beside the service does, and to say what to do about an error.

use std::error::Error;
use std::io;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};

use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioIo;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{WebPkiSupportedAlgorithms, verify_tls12_signature, verify_tls13_signature};
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::{
    AlertDescription, CertificateError, ClientConfig, DigitallySignedStruct, InvalidMessage,
    RootCertStore, SignatureScheme,
};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_rustls::TlsConnector;
use tonic::transport::Uri;
use tower::{BoxError, Service, ServiceExt, service_fn};

use crate::tls::{Pem, TlsError, provider};

/// What a service with TLS tells HTTP/2 without (`nudge::serve::tls`).
const SPEAKS_TLS: &[u8] = b"this port speaks TLS";

/// How an address without TLS begins.
pub(crate) const PLAIN: &str = "http://";

/// What gRPC is spoken over.
const HTTP2: &[u8] = b"h2";

/// How a client knows its service over TLS, and how it proves who it is.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ClientTls {
    /// Who is trusted.
    pub trust: Trust,
    /// The certificate of the client and its private key, in PEM, for services that want one.
    pub identity: Option<(PathBuf, PathBuf)>,
}

/// The trust anchors: which certificates of a service are trusted.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Trust {
    /// Those for its name of the authorities that this machine trusts.
    #[default]
    System,
    /// Those for its name of the authorities in a PEM file, and of no others.
    Authorities(PathBuf),
    /// The first certificate in a PEM file, whatever name it is for: for probes on the machine of
    /// the service.
    Exactly(PathBuf),
    /// Any: whoever answers is believed. For tests.
    Anybody,
}

impl ClientTls {
    /// Tells whether plain text is out of the question.
    pub(crate) fn is_set(&self) -> bool {
        matches!(self.trust, Trust::Authorities(_)) || self.identity.is_some()
    }

    /// Reads the files.
    fn config(&self) -> Result<ClientConfig, TlsError> {
        let config =
            ClientConfig::builder_with_provider(provider()).with_safe_default_protocol_versions();
        // The provider speaks both versions.
        let config = config.expect("TLS 1.2 and 1.3 are there");

        let config = match &self.trust {
            Trust::System => config.with_root_certificates(system()),
            Trust::Authorities(path) => {
                config.with_root_certificates(Pem::read_file("--ca", path)?.authorities()?)
            }
            Trust::Exactly(path) => {
                let pinned = Pem::read_file("--tls-cert", path)?
                    .certificates()?
                    .into_iter()
                    .next();
                config
                    .dangerous()
                    .with_custom_certificate_verifier(Unnamed::new(pinned))
            }
            Trust::Anybody => config
                .dangerous()
                .with_custom_certificate_verifier(Unnamed::new(None)),
        };

        let mut config = match &self.identity {
            None => config.with_no_client_auth(),
            Some((certificate, key)) => {
                let (certificate, key) = (
                    Pem::read_file("--cert", certificate)?,
                    Pem::read_file("--cert-key", key)?,
                );
                let with_identity =
                    config.with_client_auth_cert(certificate.certificates()?, key.key()?);
                with_identity.map_err(|error| {
                    key.fault(format!(
                        "does not go with the certificate of --cert {:?} ({error})",
                        certificate.path()
                    ))
                })?
            }
        };

        config.alpn_protocols = vec![HTTP2.into()];
        Ok(config)
    }

    /// Returns what connects to an address, over TLS to `https://`, and notes what services say
    /// when they end a connection.
    pub(crate) fn connector(
        &self,
        address: &str,
        heard: Heard,
    ) -> Result<
        impl Service<Uri, Response = Io, Error = BoxError, Future: Send> + Send + 'static,
        TlsError,
    > {
        let is_plain = address.starts_with(PLAIN);
        // The authorities of the machine are a hundred files, which nobody reads for nothing.
        let tls = if is_plain {
            None
        } else {
            Some(TlsConnector::from(Arc::new(self.config()?)))
        };

        let mut http = HttpConnector::new();
        http.enforce_http(false);
        http.set_nodelay(true);

        Ok(service_fn(move |uri: Uri| {
            connect(http.clone(), tls.clone(), uri, heard.clone())
        }))
    }
}

/// What is written and read.
type Io = TokioIo<Listening>;

/// A stream of either kind.
trait ByteStream: AsyncRead + AsyncWrite + Unpin + Send {}

impl<S: AsyncRead + AsyncWrite + Unpin + Send> ByteStream for S {}

async fn connect(
    http: HttpConnector,
    tls: Option<TlsConnector>,
    uri: Uri,
    heard: Heard,
) -> Result<Io, BoxError> {
    let Some(tls) = tls else {
        let stream = http.oneshot(uri).await?.into_inner();
        return Ok(TokioIo::new(Listening::new(stream, heard)));
    };

    let host = uri
        .host()
        .unwrap_or_default()
        .trim_matches(['[', ']'])
        .to_owned();
    let name = ServerName::try_from(host.clone())
        .map_err(|_| Untrusted(format!("{host:?} is no name of a host")))?;

    let stream = http.oneshot(uri).await?.into_inner();
    let stream = tls
        .connect(name, stream)
        .await
        .map_err(|error| Untrusted(explained(&error)))?;

    if stream.get_ref().1.alpn_protocol() != Some(HTTP2) {
        return Err(
            Untrusted("it does not offer HTTP/2 (ALPN h2), which gRPC needs".into()).into(),
        );
    }
    Ok(TokioIo::new(Listening::new(stream, heard)))
}

/// The last word of a service about TLS. In TLS 1.3 it refuses a client after the handshake, and
/// where it speaks TLS it tells those who do not; of either, HTTP/2 may tell no more than that the
/// connection has gone.
#[derive(Debug, Clone, Default)]
pub(crate) struct Heard(Arc<Mutex<Option<String>>>);

impl Heard {
    /// Returns what it said last about TLS, if anything.
    pub(crate) fn last_words(&self) -> Option<String> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    fn note_error(&self, error: &io::Error) {
        if error
            .get_ref()
            .is_some_and(|inner| inner.is::<rustls::Error>())
        {
            self.set(explained(error));
        }
    }

    fn set(&self, words: String) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(words);
    }
}

/// A stream that notes how it failed, and what it said first.
pub(crate) struct Listening {
    stream: Box<dyn ByteStream>,
    heard: Heard,
    is_fresh: bool,
}

impl Listening {
    fn new(stream: impl ByteStream + 'static, heard: Heard) -> Self {
        Self {
            stream: Box::new(stream),
            heard,
            is_fresh: true,
        }
    }

    fn note_first(&mut self, bytes: &[u8]) {
        if std::mem::take(&mut self.is_fresh)
            && bytes
                .windows(SPEAKS_TLS.len())
                .any(|words| words == SPEAKS_TLS)
        {
            self.heard
                .set("it speaks TLS: say https:// instead of http://".into());
        }
    }
}

impl AsyncRead for Listening {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = ready!(Pin::new(&mut self.stream).poll_read(context, buffer));
        self.note_first(&buffer.filled()[before..]);
        Poll::Ready(read.inspect_err(|error| self.heard.note_error(error)))
    }
}

impl AsyncWrite for Listening {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

/// A service that answers, and with which the client does not agree on TLS.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Untrusted(String);

/// Returns what is wrong, where a handshake failed.
pub(crate) fn failed_handshake(error: &(dyn Error + 'static)) -> Option<String> {
    let mut causes = std::iter::successors(Some(error), cause);
    causes
        .find_map(|cause| cause.downcast_ref::<Untrusted>())
        .map(Untrusted::to_string)
}

fn cause<'a>(error: &&'a (dyn Error + 'static)) -> Option<&'a (dyn Error + 'static)> {
    let error: &'a (dyn Error + 'static) = *error;
    error.source()
}

fn explained(error: &io::Error) -> String {
    use rustls::Error as E;
    match error.get_ref().and_then(|inner| inner.downcast_ref::<E>()) {
        Some(E::InvalidCertificate(fault)) => certificate(fault),
        Some(E::InvalidMessage(InvalidMessage::InvalidContentType)) => {
            "it does not speak TLS: say http:// instead of https://".into()
        }
        Some(E::AlertReceived(alert)) => alerted(*alert),
        Some(error) => error.to_string(),
        None => format!("it ended the handshake ({error})"),
    }
}

fn certificate(fault: &CertificateError) -> String {
    match fault {
        CertificateError::UnknownIssuer => {
            "its certificate is of an authority that is not known here; name the authority's with --ca".into()
        }
        CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. } => {
            format!("its certificate is for another name ({fault})")
        }
        CertificateError::Expired | CertificateError::ExpiredContext { .. } => {
            format!("its certificate has expired ({fault})")
        }
        CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
            format!("its certificate is not valid yet ({fault})")
        }
        CertificateError::ApplicationVerificationFailure => "its certificate is not the one of --tls-cert".into(),
        fault => format!("its certificate is not trusted ({fault}); name that of its authority with --ca"),
    }
}

fn alerted(alert: AlertDescription) -> String {
    use AlertDescription as A;
    match alert {
        A::CertificateRequired => {
            "it wants a certificate of the client; name one with --cert and its key with --cert-key"
                .into()
        }
        A::BadCertificate
        | A::UnsupportedCertificate
        | A::CertificateRevoked
        | A::CertificateExpired
        | A::CertificateUnknown
        | A::UnknownCA
        | A::DecryptError
        | A::AccessDenied => {
            format!("it does not accept the certificate of --cert, or wants one ({alert:?})")
        }
        _ => format!("it ended the connection ({alert:?})"),
    }
}

/// Returns the authorities that this machine trusts. One that cannot be read is not trusted, and a
/// handshake says what is missing.
fn system() -> RootCertStore {
    let mut authorities = RootCertStore::empty();
    authorities.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
    authorities
}

/// Trusts one certificate whatever its name is, or any; that the service has its private key is
/// proved all the same.
#[derive(Debug)]
struct Unnamed {
    certificate: Option<CertificateDer<'static>>,
    algorithms: WebPkiSupportedAlgorithms,
}

impl Unnamed {
    fn new(certificate: Option<CertificateDer<'static>>) -> Arc<Self> {
        Arc::new(Self {
            certificate,
            algorithms: provider().signature_verification_algorithms,
        })
    }
}

impl ServerCertVerifier for Unnamed {
    fn verify_server_cert(
        &self,
        certificate: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        match &self.certificate {
            Some(pinned) if pinned != certificate => {
                Err(CertificateError::ApplicationVerificationFailure.into())
            }
            _ => Ok(ServerCertVerified::assertion()),
        }
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls12_signature(message, certificate, signed, &self.algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(message, certificate, signed, &self.algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.algorithms.supported_schemes()
    }
}
