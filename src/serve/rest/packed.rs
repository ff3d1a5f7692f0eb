//! Decompression of bodies that were packed by their senders (`Content-Encoding`): read to the last
//! byte, or refused.

use std::io::{self, Read};

use bytes::Bytes;
use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use http::{HeaderMap, header};

use crate::error::{Fault, Problem};
use crate::serve::connections::memory::Charge;
use crate::serve::status::Failure;

/// Bytes that are unpacked before they are charged.
const PIECE: usize = 64 << 10;

/// The content encoding (compression) of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packing {
    /// RFC 1952, of any number of members.
    Gzip,
    /// RFC 1950.
    Deflate,
}

impl Packing {
    /// Returns how the body of these headers is packed, if it is.
    pub fn from_headers(headers: &HeaderMap) -> Result<Option<Self>, Failure> {
        let mut found = headers
            .get_all(header::CONTENT_ENCODING)
            .iter()
            .map(|value| value.to_str().unwrap_or("?"));
        let (first, second) = (found.next().unwrap_or_default(), found.next());
        match (first.trim().to_ascii_lowercase().as_str(), second) {
            ("" | "identity", None) => Ok(None),
            ("gzip" | "x-gzip", None) => Ok(Some(Self::Gzip)),
            ("deflate", None) => Ok(Some(Self::Deflate)),
            (_, second) => Err(Failure::of_encoding(second.unwrap_or(first))),
        }
    }

    /// Unpacks a body, up to so many bytes, which are charged as they come: a few that were sent
    /// may unpack to very many.
    pub fn unpack(
        self,
        packed: &[u8],
        most: usize,
        charge: Option<&Charge>,
    ) -> Result<Bytes, Failure> {
        let mut rest = packed;
        let unpacked = match self {
            Self::Gzip => unpacked(MultiGzDecoder::new(&mut rest), most, charge),
            Self::Deflate => unpacked(ZlibDecoder::new(&mut rest), most, charge),
        }?;
        if rest.is_empty() {
            Ok(unpacked)
        } else {
            Err(unreadable("there are bytes behind its end"))
        }
    }
}

fn unpacked(mut reader: impl Read, most: usize, charge: Option<&Charge>) -> Result<Bytes, Failure> {
    let mut unpacked = Vec::new();
    loop {
        let before = unpacked.len();
        let mut piece = (&mut reader).take(PIECE as u64);
        piece
            .read_to_end(&mut unpacked)
            .map_err(|error: io::Error| unreadable(&error.to_string()))?;
        let more = unpacked.len() - before;
        if more == 0 {
            return Ok(unpacked.into());
        }
        if let Some(charge) = charge {
            charge.grow(more)?;
        }
        if unpacked.len() > most {
            return Err(Failure::of_size(most));
        }
    }
}

fn unreadable(why: &str) -> Failure {
    Problem::invalid(
        "body",
        vec![Fault::new("", format!("it cannot be read: {why}"))],
    )
    .into()
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::{GzEncoder, ZlibEncoder};

    use super::*;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(bytes).expect("memory");
        encoder.finish().expect("memory")
    }

    fn deflate(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(bytes).expect("memory");
        encoder.finish().expect("memory")
    }

    fn unpacked(packing: Packing, packed: &[u8]) -> Option<Vec<u8>> {
        packing.unpack(packed, 1 << 20, None).ok().map(Into::into)
    }

    #[test]
    fn every_member_is_read() {
        let members = [
            gzip(b"one\n"),
            gzip(b""),
            gzip(&vec![b'x'; 200_000]),
            gzip(b"\nlast\n"),
        ];
        let expected = [b"one\n", &vec![b'x'; 200_000][..], b"\nlast\n"].concat();
        assert_eq!(unpacked(Packing::Gzip, &members.concat()), Some(expected));
        assert_eq!(
            unpacked(Packing::Deflate, &deflate(b"one")),
            Some(b"one".to_vec())
        );
    }

    #[test]
    fn what_is_not_read_to_its_last_byte_is_refused() {
        let (gzipped, deflated) = (gzip(b"one\n"), deflate(b"one\n"));
        let with = |packed: &[u8], more: &[u8]| [packed, more].concat();
        for torn in [
            &gzipped[..gzipped.len() - 1],
            &with(&gzipped, b"more"),
            &with(&gzipped, &gzipped[..12]),
            b"{}",
            b"",
        ] {
            assert_eq!(unpacked(Packing::Gzip, torn), None, "{torn:?}");
        }
        for torn in [
            &deflated[..deflated.len() - 1],
            &with(&deflated, b"more"),
            &with(&deflated, &deflated),
            b"{}",
        ] {
            assert_eq!(unpacked(Packing::Deflate, torn), None, "{torn:?}");
        }
        assert_eq!(
            unpacked(Packing::Gzip, &gzip(&vec![0; (1 << 20) + 1])),
            None,
            "a bomb"
        );
    }

    #[test]
    fn packings_are_named_in_any_case_and_alone() {
        let of = |names: &[&str]| {
            let mut headers = HeaderMap::new();
            for name in names {
                headers.append(header::CONTENT_ENCODING, name.parse().expect("a value"));
            }
            Packing::from_headers(&headers).ok()
        };
        assert_eq!(of(&["GZIP"]), Some(Some(Packing::Gzip)));
        assert_eq!(of(&["Deflate"]), Some(Some(Packing::Deflate)));
        assert_eq!([of(&[]), of(&["identity"])], [Some(None); 2]);
        assert_eq!(
            [of(&["br"]), of(&["gzip, gzip"]), of(&["gzip", "gzip"])],
            [None; 3]
        );
    }
}
