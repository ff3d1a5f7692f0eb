//! Reading of key files: regular ones, and not large.

use std::fs::{File, Metadata, OpenOptions};
use std::io::Read;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// The largest file that is read: a hundred thousand keys.
const MOST_BYTES: u64 = 16 << 20;

/// Reads a file whole. A pipe or a device is refused, for one that nobody writes to would be waited
/// for for ever.
pub fn read_text(path: &Path) -> Result<String, String> {
    let (mut file, about) = open(path)?;
    if about.len() > MOST_BYTES {
        return Err(format!(
            "it has {} bytes, expected at most {} MiB",
            about.len(),
            MOST_BYTES >> 20
        ));
    }

    let mut text = String::new();
    file.read_to_string(&mut text)
        .map_err(|error| match error.kind() {
            std::io::ErrorKind::InvalidData => "it is not UTF-8".to_owned(),
            _ => error.to_string(),
        })?;

    Ok(text)
}

/// Opens a regular file, without waiting for whoever may write to a pipe.
fn open(path: &Path) -> Result<(File, Metadata), String> {
    let flags = rustix::fs::OFlags::NONBLOCK.bits() as i32;
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(flags)
        .open(path)
        .map_err(|error| error.to_string())?;
    let about = file.metadata().map_err(|error| error.to_string())?;

    if about.is_file() {
        Ok((file, about))
    } else {
        Err("it is no regular file, expected one".to_owned())
    }
}
