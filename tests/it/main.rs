//! Tests of the library from outside.

mod golden_tables;
