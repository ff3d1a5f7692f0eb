//! From when to when an X.509 certificate is valid, read from its DER: the path to
//! `tbsCertificate.validity` and no further (RFC 5280, section 4.1).

/// The tags on the path.
const SEQUENCE: u8 = 0x30;
const VERSION: u8 = 0xa0;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;

/// The validity of a certificate, in seconds since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Validity {
    /// It is not valid before.
    pub begins: i64,
    /// It is not valid after.
    pub ends: i64,
}

impl Validity {
    /// Reads that of a certificate in DER; none where it is no certificate.
    pub fn of_certificate(certificate: &[u8]) -> Option<Self> {
        let (certificate, _) = expect(SEQUENCE, certificate)?;
        let (fields, _) = expect(SEQUENCE, certificate)?;
        let fields = expect(VERSION, fields).map_or(fields, |(_, rest)| rest);

        // The serial number, the algorithm of the signature, and the issuer.
        let fields =
            (0..3).try_fold(fields, |fields, _| element(fields).map(|(_, _, rest)| rest))?;
        let (validity, _) = expect(SEQUENCE, fields)?;
        let (begins, rest) = time(validity)?;
        let (ends, _) = time(rest)?;
        Some(Self { begins, ends })
    }
}

fn expect(tag: u8, bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    element(bytes)
        .filter(|(found, ..)| *found == tag)
        .map(|(_, content, rest)| (content, rest))
}

/// Splits the first element of DER: its tag, its content, and what follows it.
fn element(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&tag, bytes) = bytes.split_first()?;
    let (&first, bytes) = bytes.split_first()?;
    let (length, bytes) = match first {
        0..=0x7f => (usize::from(first), bytes),
        // The number of bytes that hold the length.
        0x81..=0x84 => {
            let (length, rest) = bytes.split_at_checked(usize::from(first & 0x7f))?;
            (
                length
                    .iter()
                    .fold(0, |sum, byte| sum << 8 | usize::from(*byte)),
                rest,
            )
        }
        _ => return None,
    };

    let (content, rest) = bytes.split_at_checked(length)?;

    Some((tag, content, rest))
}

/// Reads `YYMMDDHHMMSSZ` or `YYYYMMDDHHMMSSZ`.
fn time(bytes: &[u8]) -> Option<(i64, &[u8])> {
    let (tag, text, rest) = element(bytes)?;
    let digits = std::str::from_utf8(text).ok()?.strip_suffix('Z')?;
    let (year, digits) = match tag {
        UTC_TIME => {
            let (year, digits) = digits.split_at_checked(2)?;
            let year: i64 = year.parse().ok()?;
            (
                if year < 50 {
                    2_000 + year
                } else {
                    1_900 + year
                },
                digits,
            )
        }
        GENERALIZED_TIME => {
            let (year, digits) = digits.split_at_checked(4)?;
            (year.parse().ok()?, digits)
        }
        _ => return None,
    };

    let part = |at: usize| digits.get(2 * at..2 * at + 2)?.parse::<i64>().ok();
    let (month, day) = (part(0).filter(|month| (1..=12).contains(month))?, part(1)?);
    let seconds = part(2)? * 3_600 + part(3)? * 60 + part(4)?;
    Some((days(year, month, day) * 86_400 + seconds, rest))
}

/// Returns the days since 1970 of a date of the Gregorian calendar. The year begins in March, so
/// that the day which comes and goes is its last.
fn days(year: i64, month: i64, day: i64) -> i64 {
    let year = if month < 3 { year - 1 } else { year };
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    365 * year + year / 4 - year / 100 + year / 400 + of_year - 719_468
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Made by cryptography 50.0.2 (pyca), self-signed by keys on P-256: from 2024-02-29 to
    /// 2026-11-30, and from 1970-01-01 to 2100-03-01. From 2050 on, years have four digits.
    const UTC_TIMES: &[u8] = include_bytes!("certificates/utc-times.der");
    const GENERALIZED_TIME: &[u8] = include_bytes!("certificates/generalized-time.der");

    #[test]
    fn both_ends_are_read_in_either_form() {
        // Seconds by `date -u -d 2026-11-30 +%s`.
        assert_eq!(
            Validity::of_certificate(UTC_TIMES),
            Some(Validity {
                begins: 1_709_164_800,
                ends: 1_795_996_800
            })
        );
        assert_eq!(
            Validity::of_certificate(GENERALIZED_TIME),
            Some(Validity {
                begins: 0,
                ends: 4_107_542_400
            })
        );
    }

    #[test]
    fn what_is_no_certificate_has_none() {
        let der = UTC_TIMES;
        for end in 0..der.len() {
            // The path ends before the certificate does, but lengths are of the whole.
            assert_eq!(Validity::of_certificate(&der[..end]), None, "{end}");
        }
        for bytes in [
            &b""[..],
            b"\x30",
            b"\x30\x85\0\0\0\0\0",
            b"\x30\x84\xff\xff\xff\xff",
            &[0x30; 64],
        ] {
            assert_eq!(Validity::of_certificate(bytes), None, "{bytes:?}");
        }
    }
}
