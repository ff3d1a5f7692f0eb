//! Every test that needs a service, a database or the whole source tree, in one binary.

#![allow(missing_docs)]

mod architecture;
mod faces;
mod golden_tables;
mod ingest;
mod kill;
mod operations;
mod sqlite_store;
mod store_contract;
mod support;
mod uncertain_commit;
