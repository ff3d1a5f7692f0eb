//! Tests from outside: the library and the binary as their users meet them.

mod cli;
mod client;
mod fake;
mod proxy;
