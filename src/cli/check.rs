//! `nudge check`: whether a database's totals match its cells.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use serde_json::json;

use super::{Failure, output};
use crate::config::Config;
use crate::domain::UnreadableEnvironment;
use crate::store::{Audit, Options, SqliteStore, Store, StoreError};

/// Audit a database that no service has open
#[derive(Debug, Args)]
#[command(long_about = "Audit a database that no service has open.\n\n\
    Compares the totals that were kept with every commit with the sums of the cells: a bit that flipped in a count shows here, where SQLite's own \
    integrity check may see nothing. Ends with exit code 1 where they differ, and where an environment cannot be read.\n\n\
    Example:\n  nudge check --data ./nudge-data")]
pub struct Check {
    /// The directory of the database.
    #[arg(long, env = "NUDGE_DATA", value_name = "DIR", default_value_os_t = Config::default().data)]
    data: PathBuf,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
}

impl Check {
    /// Audits every environment.
    pub async fn run(self) -> Result<(), Failure> {
        let path = Config { data: self.data, ..Config::default() }.database();
        if !path.exists() {
            return Err(Failure::usage(format!("no database at {}: name its directory with --data", path.display())));
        }
        let store = SqliteStore::open(&path, Options::default()).await.map_err(unopened)?;
        let audits = store.audit().await.map_err(unopened);
        let unreadable = store.unreadable();
        store.close().await;
        let audits = audits?;
        if self.json {
            output::print_json(&report(&audits, &unreadable))?
        } else {
            audits.iter().try_for_each(tell)?;
            unreadable.iter().try_for_each(|environment| tell_unreadable(environment))?
        }
        let unsound = audits.iter().filter(|audit| !audit.is_sound()).count();
        match (unsound, unreadable.len()) {
            (0, 0) => Ok(()),
            (0, unread) => Err(Failure::refused(format!("{unread} environments cannot be read"))),
            (unsound, _) => {
                Err(Failure::refused(format!("{unsound} of {} environments do not match their cells", audits.len())))
            }
        }
    }
}

fn unopened(error: StoreError) -> Failure {
    Failure::usage(error.to_string())
}

fn tell(audit: &Audit) -> Result<(), Failure> {
    let [transitions, states, cells] = audit.kept;
    let figures = format!("{transitions} transitions, {states} states, {cells} cells");
    if audit.is_sound() {
        return output::print(&format!("{}: sound ({figures})", audit.environment));
    }
    let [transitions, states, cells] = audit.found;
    let found = format!("{transitions} transitions, {states} states, {cells} cells");
    output::print(&format!("{}: UNSOUND, kept {figures}, found {found}", audit.environment))
}

fn tell_unreadable(environment: &UnreadableEnvironment) -> Result<(), Failure> {
    output::print(&format!("{}: CANNOT BE READ, {}", environment.name, environment.why))
}

fn report(audits: &[Audit], unreadable: &[Arc<UnreadableEnvironment>]) -> serde_json::Value {
    let figures =
        |[transitions, states, cells]: [u64; 3]| json!({"transitions": transitions, "states": states, "cells": cells});
    let one = |audit: &Audit| {
        json!({
            "environment": audit.environment.as_str(),
            "sound": audit.is_sound(),
            "kept": figures(audit.kept),
            "found": figures(audit.found),
        })
    };
    let environments: Vec<_> = audits.iter().map(one).collect();
    if unreadable.is_empty() {
        return json!({ "environments": environments });
    }
    let unread = |environment: &Arc<UnreadableEnvironment>| json!({"name": environment.name, "uid": environment.uid.0, "unreadable": environment.why});
    json!({ "environments": environments, "unreadable": unreadable.iter().map(unread).collect::<Vec<_>>() })
}
