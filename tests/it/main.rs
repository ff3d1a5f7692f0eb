//! Tests of whole rooms and of the service as a whole: one binary, a module a subject.

mod sqlite_store;
mod store_contract;
mod store_model;
mod support;
