//! PEM files (RFC 7468), read once and then parsed, so that what was compared with an earlier
//! reading is what is used.

use std::path::{Path, PathBuf};

use rustls::RootCertStore;
use rustls::pki_types::pem::{self, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};

/// The largest file that is read: a bundle of all public authorities is a quarter of it.
const MOST_BYTES: u64 = 1 << 20;

/// A file that a flag names, cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{flag} {path:?}: {why}")]
pub struct TlsError {
    flag: &'static str,
    path: PathBuf,
    why: String,
}

/// A PEM file as it was at one moment.
pub struct Pem {
    flag: &'static str,
    path: PathBuf,
    bytes: Vec<u8>,
}

impl Pem {
    /// Reads the file that a flag names.
    pub fn read_file(flag: &'static str, path: &Path) -> Result<Self, TlsError> {
        let failed = |why: String| TlsError {
            flag,
            path: path.into(),
            why,
        };
        let unreadable = |error: std::io::Error| {
            failed(format!("cannot be read ({error}), expected a PEM file"))
        };

        let about = std::fs::metadata(path).map_err(unreadable)?;
        // A pipe or a device would be waited for.
        if !about.is_file() || about.len() > MOST_BYTES {
            return Err(failed(format!(
                "expected a PEM file of at most {} KiB",
                MOST_BYTES >> 10
            )));
        }

        let bytes = std::fs::read(path).map_err(unreadable)?;
        Ok(Self {
            flag,
            path: path.into(),
            bytes,
        })
    }

    /// Returns where it was read.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns what was read.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns an error about the file.
    pub fn fault(&self, why: impl Into<String>) -> TlsError {
        TlsError {
            flag: self.flag,
            path: self.path.clone(),
            why: why.into(),
        }
    }

    /// Returns the certificates, the first of which is the owner's.
    pub fn certificates(&self) -> Result<Vec<CertificateDer<'static>>, TlsError> {
        let read: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&self.bytes).collect();
        let certificates = read.map_err(|error| {
            self.fault(format!(
                "is damaged ({}), expected PEM certificates",
                damage(&error)
            ))
        })?;
        match certificates.is_empty() {
            true => Err(self.fault(format!(
                "expected PEM certificates (BEGIN CERTIFICATE), found {}",
                self.found()
            ))),
            false => Ok(certificates),
        }
    }

    /// Returns the private key.
    pub fn key(&self) -> Result<PrivateKeyDer<'static>, TlsError> {
        if self.is_encrypted() {
            let why = "the key is encrypted, and nobody is asked for a passphrase: expected an unencrypted PEM key, such \
                as `openssl pkey -in KEY -out PLAIN` writes";
            return Err(self.fault(why));
        }
        PrivateKeyDer::from_pem_slice(&self.bytes).map_err(|error| match error {
            pem::Error::NoItemsFound => self.fault(format!(
                "expected a PEM private key (BEGIN PRIVATE KEY), found {}",
                self.found()
            )),
            error => self.fault(format!(
                "is damaged ({}), expected a PEM private key",
                damage(&error)
            )),
        })
    }

    /// Returns the certificates as those of authorities, which are trusted to sign others.
    pub fn authorities(&self) -> Result<RootCertStore, TlsError> {
        let mut authorities = RootCertStore::empty();
        for certificate in self.certificates()? {
            let added = authorities.add(certificate);
            added.map_err(|error| {
                self.fault(format!("holds no certificate of an authority ({error})"))
            })?;
        }
        Ok(authorities)
    }

    fn is_encrypted(&self) -> bool {
        self.labels().any(|label| label == "ENCRYPTED PRIVATE KEY")
            || self
                .lines()
                .any(|line| line.starts_with("Proc-Type:") && line.ends_with("ENCRYPTED"))
    }

    /// Tells what else the file holds; labels of PEM are no secret where they are of a known kind.
    fn found(&self) -> &'static str {
        let has = |of: &str| self.labels().any(|label| label.ends_with(of));
        match () {
            () if self.bytes.is_empty() => "an empty file",
            () if has("PRIVATE KEY") => "a private key",
            () if has("CERTIFICATE REQUEST") => "a certificate request",
            () if has("CERTIFICATE") => "a certificate",
            () if self.labels().next().is_some() => "PEM of another kind",
            () => "no PEM",
        }
    }

    fn labels(&self) -> impl Iterator<Item = &str> {
        self.lines()
            .filter_map(|line| line.strip_prefix("-----BEGIN ")?.strip_suffix("-----"))
    }

    fn lines(&self) -> impl Iterator<Item = &str> {
        self.bytes
            .split(|byte| *byte == b'\n')
            .filter_map(|line| std::str::from_utf8(line).ok())
            .map(str::trim)
    }
}

/// Tells what is wrong with PEM, and nothing of what is in it.
fn damage(error: &pem::Error) -> &'static str {
    match error {
        pem::Error::MissingSectionEnd { .. } => "there is a BEGIN without its END",
        pem::Error::IllegalSectionStart { .. } => "a line with BEGIN is cut",
        pem::Error::Base64Decode(_) => "there is something else than base 64 between BEGIN and END",
        _ => "it is no PEM",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pem(text: &str) -> Pem {
        Pem {
            flag: "--tls-key",
            path: "k.pem".into(),
            bytes: text.into(),
        }
    }

    fn block(label: &str, inside: &str) -> String {
        format!("-----BEGIN {label}-----\n{inside}\n-----END {label}-----\n")
    }

    #[test]
    fn what_cannot_be_used_is_told_by_flag_path_and_expectation() {
        let legacy = block(
            "RSA PRIVATE KEY",
            "Proc-Type: 4,ENCRYPTED\nDEK-Info: AES-128-CBC,00\n\nAAAA",
        );
        let cases = [
            (
                String::new(),
                "expected a PEM private key (BEGIN PRIVATE KEY), found an empty file",
            ),
            ("secret".into(), "found no PEM"),
            (block("CERTIFICATE", "AAAA"), "found a certificate"),
            (
                block("CERTIFICATE REQUEST", "AAAA"),
                "found a certificate request",
            ),
            (block("DH PARAMETERS", "AAAA"), "found PEM of another kind"),
            (
                block("ENCRYPTED PRIVATE KEY", "AAAA"),
                "the key is encrypted",
            ),
            (legacy, "the key is encrypted"),
            ("-----BEGIN PRIVATE KEY-----\nsecret".into(), "is damaged"),
            (block("PRIVATE KEY", "?secret?"), "is damaged"),
        ];
        for (text, why) in cases {
            let error = pem(&text).key().expect_err("no key").to_string();
            assert!(
                error.starts_with("--tls-key \"k.pem\": ") && error.contains(why),
                "{error}"
            );
            assert!(!error.contains("secret") && !error.contains('['), "{error}");
        }
        let error = pem(&block("PRIVATE KEY", "AAAA"))
            .certificates()
            .expect_err("no certificate")
            .to_string();
        assert!(
            error.ends_with("expected PEM certificates (BEGIN CERTIFICATE), found a private key"),
            "{error}"
        );
        assert!(
            pem(&block("CERTIFICATE", "AAAA")).authorities().is_err(),
            "no DER in it"
        );
    }

    #[test]
    fn only_small_files_are_read() {
        for path in ["/no/such/file", "/dev/zero", "/"] {
            let error = Pem::read_file("--ca", Path::new(path))
                .err()
                .expect("refused")
                .to_string();
            assert!(
                error.starts_with(&format!("--ca {path:?}: "))
                    && error.contains("expected a PEM file"),
                "{error}"
            );
        }
    }
}
