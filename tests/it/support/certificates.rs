//! Certificates made for one test, and TLS by hand.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nudge::client::{ClientTls, Trust};
use nudge::serve::tls::TlsFiles;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;

pub use super::x509::{Authority, Certificate};

/// Writes the files of a service, and returns where they are.
pub fn write(directory: &Path, certificate: &Certificate, clients: Option<&Authority>) -> TlsFiles {
    let file = |name: &str, text: &str| -> PathBuf {
        let path = directory.join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    TlsFiles {
        certificate: file("tls.crt", &certificate.certificate),
        key: file("tls.key", &certificate.key),
        client_authorities: clients.map(|authority| file("clients.crt", &authority.pem())),
    }
}

/// Returns what a client does that trusts an authority and has a certificate of its own or none.
pub fn client(
    directory: &Path,
    authority: &Authority,
    identity: Option<&Certificate>,
) -> ClientTls {
    let ca = directory.join(format!(
        "ca-{}.crt",
        blake3::hash(authority.pem().as_bytes()).to_hex()
    ));
    std::fs::write(&ca, authority.pem()).expect("written");
    let identity = identity.map(|identity| {
        let name = blake3::hash(identity.key.as_bytes()).to_hex();
        let paths = ["crt", "key"].map(|kind| directory.join(format!("client-{name}.{kind}")));
        std::fs::write(&paths[0], &identity.certificate).expect("written");
        std::fs::write(&paths[1], &identity.key).expect("written");
        let [certificate, key] = paths;
        (certificate, key)
    });
    ClientTls {
        trust: Trust::Authorities(ca),
        identity,
    }
}

/// Returns what rustls needs to speak to a service of that authority, by one protocol of ALPN.
pub fn config(
    authority: &Authority,
    identity: Option<&Certificate>,
    protocol: &str,
) -> Arc<ClientConfig> {
    let mut roots = RootCertStore::empty();
    let der = CertificateDer::from_slice(authority.der());
    roots.add(der).expect("an authority");
    let config = ClientConfig::builder_with_provider(nudge::tls::provider())
        .with_safe_default_protocol_versions();
    let config = config.expect("both versions").with_root_certificates(roots);
    let mut config = match identity {
        None => config.with_no_client_auth(),
        Some(Certificate { certificate, key }) => {
            let chain = vec![CertificateDer::from_pem_slice(certificate.as_bytes()).expect("PEM")];
            let key = PrivateKeyDer::from_pem_slice(key.as_bytes()).expect("PEM");
            config.with_client_auth_cert(chain, key).expect("a pair")
        }
    };
    config.alpn_protocols = vec![protocol.into()];
    Arc::new(config)
}

/// Connects over TLS, to `localhost`.
pub async fn connect(
    address: SocketAddr,
    config: &Arc<ClientConfig>,
) -> std::io::Result<TlsStream<TcpStream>> {
    let stream = TcpStream::connect(address).await?;
    let name = ServerName::try_from("localhost").expect("a name");
    TlsConnector::from(config.clone())
        .connect(name, stream)
        .await
}
