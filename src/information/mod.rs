//! Mathematics of tables.

#[cfg(test)]
mod samples;
mod table;

pub use table::{LARGEST_TOTAL, Occupied, Table};
