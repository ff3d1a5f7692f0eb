//! Access keys (API keys, bearer tokens): what proves that somebody is a
//! [`Principal`](crate::domain::Principal).
//!
//! | room | for |
//! |---|---|
//! | `generate` | new keys |
//! | `file` | files of keys, as they are read |
//! | `keys` | the keys file: a line a key, found by its digest |
//! | `line` | one line of it |
//! | `rate` | how often a key may ask |
//! | `shown` | what is told of texts in which a key may stand by mistake |
//! | `bearer` | the `Authorization` header |
//!
//! A key itself, which nothing shows, is a [`Secret`].
//!
//! Nothing here listens, waits or knows a face. A key is never kept: a file has digests only.

mod bearer;
mod file;
mod generate;
mod keys;
mod line;
mod rate;
mod shown;

pub use crate::domain::{KeyDigest, Secret};
pub use bearer::{Malformed, bearer};
pub use file::read_text;
pub use generate::generate;
pub use keys::{Key, Keys, KeysError};
pub use line::Line;
pub use rate::Rate;
pub use shown::{has_key, redacted};
