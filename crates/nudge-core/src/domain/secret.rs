//! Secrets: a key as its holder has it, and the digest of it that is kept.

use std::fmt;

/// An access key (API key, bearer token). Nothing shows it but [`Secret::reveal`].
#[derive(Clone, PartialEq, Eq)]
pub struct Secret(String);

/// The BLAKE3 digest of a key. Equality takes the same time wherever two differ.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct KeyDigest(blake3::Hash);

impl Secret {
    /// What every key that is made here begins with, so that scanners for leaked secrets know one.
    pub const PREFIX: &str = "nudge_";

    /// The longest key that is compared with anything.
    pub const LONGEST: usize = 512;

    /// Makes a key of 256 bits, which whoever calls has from a source of randomness that is fit for
    /// secrets.
    pub fn of_random(bytes: [u8; 32]) -> Self {
        let digits = blake3::Hash::from(bytes).to_hex();
        Self(format!("{}{digits}", Self::PREFIX))
    }

    /// Returns whether bytes are of the alphabet of bearer tokens, `token68` of RFC 9110.
    pub fn is_token(bytes: &[u8]) -> bool {
        let end = bytes
            .iter()
            .rposition(|byte| *byte != b'=')
            .map_or(0, |at| at + 1);
        let is_known = |byte: &u8| byte.is_ascii_alphanumeric() || b"-._~+/".contains(byte);
        end > 0 && bytes[..end].iter().all(is_known)
    }

    /// Returns the key, for the one place that needs it.
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// Returns what is kept of it.
    pub fn digest(&self) -> KeyDigest {
        KeyDigest::of_key(self.0.as_bytes())
    }
}

impl std::str::FromStr for Secret {
    type Err = String;

    /// Takes what can be sent as a bearer token (RFC 6750). What is wrong is told without the text.
    fn from_str(text: &str) -> Result<Self, String> {
        let is_key =
            !text.is_empty() && text.len() <= Self::LONGEST && Self::is_token(text.as_bytes());
        let expected = "expected a key as `nudge key new` prints it, in one line";
        is_key
            .then(|| Self(text.into()))
            .ok_or_else(|| format!("got {} bytes that are no key, {expected}", text.len()))
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
    }
}

impl KeyDigest {
    /// Returns the digest of a key.
    pub fn of_key(key: &[u8]) -> Self {
        Self(blake3::hash(key))
    }
}

impl std::str::FromStr for KeyDigest {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // Whatever stands here by mistake may be a key, and errors go to the log.
        let told = || {
            format!(
                "got {} (not shown), expected the BLAKE3 digest of a key in 64 of 0-9 and a-f",
                shown(text)
            )
        };
        let is_lower = text.len() == 64 && !text.bytes().any(|byte| byte.is_ascii_uppercase());
        is_lower
            .then(|| blake3::Hash::from_hex(text).ok())
            .flatten()
            .map(Self)
            .ok_or_else(told)
    }
}

impl fmt::Display for KeyDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.to_hex())
    }
}

impl fmt::Debug for KeyDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "KeyDigest({}..)", &self.0.to_hex()[..8])
    }
}

fn shown(text: &str) -> String {
    match text.starts_with(Secret::PREFIX) {
        true => "a key itself".into(),
        false => format!("{} characters", text.chars().count()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_has_256_bits_and_shows_none_of_them() {
        let [one, other] = [[7; 32], [8; 32]].map(Secret::of_random);
        assert!(one != other && one.digest() != other.digest());
        assert_eq!(one.reveal().len(), Secret::PREFIX.len() + 64);
        assert_eq!(one.reveal().parse::<Secret>(), Ok(one.clone()));
        assert_eq!(format!("{one:?}"), "Secret(..)");
        assert_eq!(
            one.digest().to_string().parse::<KeyDigest>(),
            Ok(one.digest())
        );
    }

    #[test]
    fn errors_do_not_tell_what_may_be_a_key() {
        let key = Secret::of_random(std::array::from_fn(|at| 0xa0 + at as u8));
        let digest = key
            .reveal()
            .parse::<KeyDigest>()
            .expect_err("a key is no digest");
        let secret = format!("{} ", key.reveal())
            .parse::<Secret>()
            .expect_err("a space");
        for told in [digest, secret] {
            assert!(!told.contains(&key.reveal()[6..20]), "{told}");
        }
        for wrong in ["", "ab", &"g".repeat(64), &"A".repeat(64), &"0".repeat(65)] {
            assert!(wrong.parse::<KeyDigest>().is_err(), "{wrong}");
        }
    }
}
