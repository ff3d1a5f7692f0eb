//! Tests from outside: the library and the binary as their users meet them.

mod client;
mod fake;
mod proxy;
