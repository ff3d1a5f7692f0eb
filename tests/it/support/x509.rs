//! X.509 certificates for one test, written in DER (RFC 5280): keys on P-256 that sign with
//! SHA-256. A library for them would bring two dozen packages along.

use std::net::IpAddr;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ring::rand::SystemRandom;
use ring::signature::{ECDSA_P256_SHA256_ASN1_SIGNING, EcdsaKeyPair, KeyPair};

/// An authority of its own.
pub struct Authority {
    name: String,
    key: Key,
    der: Vec<u8>,
}

/// A certificate with its key, both in PEM.
pub struct Certificate {
    pub certificate: String,
    pub key: String,
}

struct Key {
    pkcs8: Vec<u8>,
    pair: EcdsaKeyPair,
}

impl Authority {
    /// Makes an authority of a name, which certifies itself.
    pub fn new(name: &str) -> Self {
        let key = Key::generate();
        let extension = extension(&BASIC_CONSTRAINTS, sequence([tagged(BOOLEAN, vec![0xff])]));
        let body = body(name, name, 2_100, &key, extension);
        let der = key.sign(body);
        let name = name.to_owned();
        Self { name, key, der }
    }

    /// Returns its certificate.
    pub fn der(&self) -> &[u8] {
        &self.der
    }

    /// Returns its certificate in PEM.
    pub fn pem(&self) -> String {
        pem("CERTIFICATE", &self.der)
    }

    /// Certifies a name, `localhost` or an address.
    pub fn certify(&self, name: &str) -> Certificate {
        self.certify_until(name, 2_100)
    }

    /// Certifies a name until the begin of a year.
    pub fn certify_until(&self, name: &str, year: u32) -> Certificate {
        let key = Key::generate();
        let extension = extension(&SUBJECT_ALTERNATIVE_NAME, sequence([general_name(name)]));
        let der = self.key.sign(body(&self.name, name, year, &key, extension));
        Certificate {
            certificate: pem("CERTIFICATE", &der),
            key: pem("PRIVATE KEY", &key.pkcs8),
        }
    }
}

impl Key {
    fn generate() -> Self {
        let (algorithm, random) = (&ECDSA_P256_SHA256_ASN1_SIGNING, SystemRandom::new());
        let pkcs8 = EcdsaKeyPair::generate_pkcs8(algorithm, &random).expect("randomness");
        let pair = EcdsaKeyPair::from_pkcs8(algorithm, pkcs8.as_ref(), &random).expect("a key");
        let pkcs8 = pkcs8.as_ref().to_vec();
        Self { pkcs8, pair }
    }

    /// SubjectPublicKeyInfo.
    fn public(&self) -> Vec<u8> {
        let algorithm = sequence([tagged(OID, EC_PUBLIC_KEY.into()), tagged(OID, P256.into())]);
        sequence([algorithm, bits(self.pair.public_key().as_ref())])
    }

    /// Makes a certificate of what it says.
    fn sign(&self, body: Vec<u8>) -> Vec<u8> {
        let signature = self.pair.sign(&SystemRandom::new(), &body);
        let signature = bits(signature.expect("randomness").as_ref());
        sequence([body, signature_algorithm(), signature])
    }
}

const BOOLEAN: u8 = 0x01;
const INTEGER: u8 = 0x02;
const BIT_STRING: u8 = 0x03;
const OCTET_STRING: u8 = 0x04;
const OID: u8 = 0x06;
const UTF8_STRING: u8 = 0x0c;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;
const SEQUENCE: u8 = 0x30;
const SET: u8 = 0x31;
/// Context-specific, constructed: the version and the extensions.
const VERSION: u8 = 0xa0;
const EXTENSIONS: u8 = 0xa3;
/// Context-specific, in a general name.
const DNS_NAME: u8 = 0x82;
const IP_ADDRESS: u8 = 0x87;

/// 1.2.840.10045.2.1, 1.2.840.10045.3.1.7 and 1.2.840.10045.4.3.2 (RFC 5480, 5758).
const EC_PUBLIC_KEY: [u8; 7] = [0x2a, 0x86, 0x48, 0xce, 0x3d, 0x02, 0x01];
const P256: [u8; 8] = [0x2a, 0x86, 0x48, 0xce, 0x3d, 0x03, 0x01, 0x07];
const ECDSA_WITH_SHA256: [u8; 8] = [0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x02];
/// 2.5.4.3, 2.5.29.17 and 2.5.29.19 (RFC 5280).
const COMMON_NAME: [u8; 3] = [0x55, 0x04, 0x03];
const SUBJECT_ALTERNATIVE_NAME: [u8; 3] = [0x55, 0x1d, 0x11];
const BASIC_CONSTRAINTS: [u8; 3] = [0x55, 0x1d, 0x13];

/// TBSCertificate: from 2020 to the begin of a year.
fn body(issuer: &str, subject: &str, until: u32, key: &Key, extension: Vec<u8>) -> Vec<u8> {
    let version_3 = tagged(VERSION, tagged(INTEGER, vec![2]));
    // Positive, and different enough: an issuer gives each number once.
    let mut serial = key.pair.public_key().as_ref()[1..17].to_vec();
    serial[0] = 1;
    sequence([
        version_3,
        tagged(INTEGER, serial),
        signature_algorithm(),
        name(issuer),
        sequence([new_year(2_020), new_year(until)]),
        name(subject),
        key.public(),
        tagged(EXTENSIONS, sequence([extension])),
    ])
}

fn signature_algorithm() -> Vec<u8> {
    sequence([tagged(OID, ECDSA_WITH_SHA256.into())])
}

fn name(name: &str) -> Vec<u8> {
    let attribute = sequence([
        tagged(OID, COMMON_NAME.into()),
        tagged(UTF8_STRING, name.into()),
    ]);
    sequence([tagged(SET, attribute)])
}

/// Years from 2050 on have four digits.
fn new_year(year: u32) -> Vec<u8> {
    match year {
        ..2_050 => tagged(UTC_TIME, format!("{:02}0101000000Z", year % 100).into()),
        _ => tagged(GENERALIZED_TIME, format!("{year}0101000000Z").into()),
    }
}

fn general_name(name: &str) -> Vec<u8> {
    match name.parse() {
        Ok(IpAddr::V4(address)) => tagged(IP_ADDRESS, address.octets().into()),
        Ok(IpAddr::V6(address)) => tagged(IP_ADDRESS, address.octets().into()),
        Err(_) => tagged(DNS_NAME, name.into()),
    }
}

fn extension(id: &[u8], content: Vec<u8>) -> Vec<u8> {
    sequence([tagged(OID, id.into()), tagged(OCTET_STRING, content)])
}

fn bits(bytes: &[u8]) -> Vec<u8> {
    let none_unused = [0];
    tagged(BIT_STRING, [&none_unused, bytes].concat())
}

fn sequence<const N: usize>(parts: [Vec<u8>; N]) -> Vec<u8> {
    tagged(SEQUENCE, parts.concat())
}

fn tagged(tag: u8, content: Vec<u8>) -> Vec<u8> {
    let length = u16::try_from(content.len()).expect("short").to_be_bytes();
    let head: &[u8] = match content.len() {
        ..0x80 => &[tag, length[1]],
        0x80..0x100 => &[tag, 0x81, length[1]],
        _ => &[tag, 0x82, length[0], length[1]],
    };
    [head, &content].concat()
}

fn pem(label: &str, der: &[u8]) -> String {
    let text = STANDARD.encode(der);
    let lines = text.as_bytes().chunks(64).map(String::from_utf8_lossy);
    let lines: Vec<_> = lines.collect();
    format!(
        "-----BEGIN {label}-----\n{}\n-----END {label}-----\n",
        lines.join("\n")
    )
}
