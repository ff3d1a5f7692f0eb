//! Everything on a listening socket.

pub mod status;
