//! The `nudge` binary.

fn main() {}
