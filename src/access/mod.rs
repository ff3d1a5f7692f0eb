//! Access keys (API keys, bearer tokens): what proves that somebody is a
//! [`Principal`](crate::domain::Principal).
//!
//! | room | for |
//! |---|---|
//! | `secret` | a key itself, which nothing shows |
//! | `file` | files of keys, as they are read |
//! | `keys` | the keys file: a line a key, found by its digest |
//! | `line` | one line of it |
//! | `rate` | how often a key may ask |
//! | `shown` | what is told of texts in which a key may stand by mistake |
//! | `bearer` | the `Authorization` header |
//!
//! Nothing here listens, waits or knows a face. A key is never kept: a file has digests only.

mod bearer;
mod file;
mod keys;
mod line;
mod rate;
mod secret;
mod shown;

pub use bearer::{Malformed, bearer};
pub use file::read_text;
pub use keys::{Key, Keys, KeysError};
pub use line::Line;
pub use rate::Rate;
pub use secret::{KeyDigest, Secret};
pub use shown::{has_key, redacted};
