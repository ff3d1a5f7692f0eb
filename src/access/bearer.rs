//! The `Authorization` header: `Bearer KEY` (RFC 6750, RFC 9110), once.

use crate::domain::Secret;

/// Why a header is no bearer token. None of its text is in here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// There is more than one.
    #[error("there are several authorization headers, expected one")]
    Several,
    /// Another scheme, or none.
    #[error("the authorization header is of another scheme, expected `Bearer KEY`")]
    Scheme,
    /// Nothing after the scheme, or characters that no key has.
    #[error("the authorization header has no key of letters, digits and -._~+/ after `Bearer`")]
    Key,
    /// Longer than any key.
    #[error("the authorization header is longer than any key")]
    TooLong,
}

/// Returns the key in these `Authorization` headers; `None` where there are no headers.
pub fn bearer<'a>(
    mut headers: impl Iterator<Item = &'a [u8]>,
) -> Result<Option<&'a [u8]>, Malformed> {
    const SCHEME: &[u8] = b"bearer";
    let Some(header) = headers.next() else {
        return Ok(None);
    };

    if headers.next().is_some() {
        return Err(Malformed::Several);
    }

    // The name of a scheme is written in any case.
    let (scheme, rest) = header
        .split_at_checked(SCHEME.len())
        .ok_or(Malformed::Scheme)?;
    if !scheme.eq_ignore_ascii_case(SCHEME) || rest.first().is_some_and(|byte| *byte != b' ') {
        return Err(Malformed::Scheme);
    }

    let key = rest.trim_ascii();

    match key.len() {
        longer if longer > Secret::LONGEST => Err(Malformed::TooLong),
        _ if !Secret::is_token(key) => Err(Malformed::Key),
        _ => Ok(Some(key)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(header: &[u8]) -> Result<Option<&[u8]>, Malformed> {
        bearer([header].into_iter())
    }

    #[test]
    fn a_key_comes_once_and_after_its_scheme() {
        assert_eq!(bearer([].into_iter()), Ok(None));
        for good in [
            &b"Bearer a.b-c"[..],
            b"bearer a.b-c",
            b"BEARER   a.b-c ",
            b"Bearer a.b-c",
        ] {
            assert_eq!(one(good), Ok(Some(&b"a.b-c"[..])));
        }
        assert_eq!(one(b"Bearer YQ=="), Ok(Some(&b"YQ=="[..])));
        assert_eq!(
            bearer([&b"Bearer a"[..], b"Bearer a"].into_iter()),
            Err(Malformed::Several)
        );
        for other in [
            &b""[..],
            b"Basic YTpi",
            b"Bear",
            b"Bearera",
            b"Bearer\ta",
            b"a",
        ] {
            assert_eq!(one(other), Err(Malformed::Scheme), "{other:?}");
        }
        for none in [
            &b"Bearer"[..],
            b"Bearer ",
            b"Bearer a b",
            b"Bearer a,b",
            b"Bearer =",
            "Bearer é".as_bytes(),
        ] {
            assert_eq!(one(none), Err(Malformed::Key), "{none:?}");
        }
        assert_eq!(
            one(format!("Bearer {}", "a".repeat(1 << 20)).as_bytes()),
            Err(Malformed::TooLong)
        );
    }
}
