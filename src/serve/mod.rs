//! Everything on a listening socket.

pub mod rest;
pub mod status;
