//! Everything on a listening socket: REST, gRPC, gRPC-Web, the inference protocol and operations on
//! one port.
//!
//! Handlers decode, ask a room of [`App`](crate::app::App), and encode. An `if` about the problem
//! rather than the protocol belongs further in.

pub mod access;
pub mod connections;
pub mod listen;
pub mod tls;

mod cors;
mod costs;
mod doors;
mod figures;
mod grpc;
mod inference;
mod operations;
mod requests;
mod rest;
mod routes;
mod running;
mod settings;
mod status;

pub use running::{Running, Starting};
pub use settings::Settings;
