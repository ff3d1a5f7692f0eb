//! Every test that needs a service, a database, the binary or the whole source tree, in one binary.

#![allow(missing_docs)]

mod architecture;
mod bounded;
mod cli;
mod client;
mod connections;
mod damage;
mod descriptions;
mod evidence;
mod experiments;
mod faces;
mod fake;
mod faults;
mod golden;
mod graphs;
mod grpc_errors;
mod inference;
mod ingest;
mod kill;
mod locking;
mod metrics;
mod models;
mod networks;
mod newcomers;
mod old_databases;
mod operations;
mod planted;
mod proxy;
mod quotas;
mod readiness;
mod receipts;
mod removal;
mod rules;
mod segments;
mod server;
mod simulate;
mod sqlite_store;
mod start;
mod store_contract;
mod store_model;
mod support;
mod tls;
mod uncertain_commit;
mod unreadable;
mod values;
