//! Packed cells that are kept on disk: with a form in front and a checksum behind.
//!
//! ```text
//! kept    form (1)   cells   CRC-32 of name, form and cells, little-endian
//! ```
//!
//! The checksum is over the name of what is kept too, so that what stands in another's place is
//! found.

use super::cells::Spoiled;

/// The form that is written, and read.
const FORM: u8 = 1;
const CHECKSUM: usize = 4;

/// What a blob is called: its environment, and its number there.
pub type Name = [i64; 2];

/// Returns the bytes before the cells.
pub fn begin() -> Vec<u8> {
    vec![FORM]
}

/// Ends what [`begin`] began.
pub fn end(name: Name, mut bytes: Vec<u8>) -> Vec<u8> {
    let checksum = checksum(name, &bytes);
    bytes.extend(checksum);
    bytes
}

/// Returns the cells of what is kept, where its checksum holds.
pub fn cells(name: Name, bytes: &[u8]) -> Result<&[u8], Spoiled> {
    let (content, checksum) = bytes.split_last_chunk::<CHECKSUM>().ok_or(Spoiled)?;
    match content {
        [FORM, cells @ ..] if self::checksum(name, content) == *checksum => Ok(cells),
        _ => Err(Spoiled),
    }
}

fn checksum(name: Name, bytes: &[u8]) -> [u8; CHECKSUM] {
    let mut hasher = crc32fast::Hasher::new();
    name.iter()
        .for_each(|part| hasher.update(&part.to_le_bytes()));
    hasher.update(bytes);
    hasher.finalize().to_le_bytes()
}
