//! Mathematics of tables.
