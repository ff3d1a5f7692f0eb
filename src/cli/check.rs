//! `nudge check`: whether a database's totals match its cells.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use serde_json::json;

use super::{Failure, output};
use crate::config::Config;
use crate::domain::{Model, UnreadableEnvironment};
use crate::model::Networks;
use crate::priors::Fits;
use crate::store::{Audit, Options, SqliteStore, Store, StoreError};

/// Audit a database that no service has open
#[derive(Debug, Args)]
#[command(long_about = "Audit a database that no service has open.\n\n\
    Compares the totals that were kept with every commit with the sums of the cells: a bit that flipped in a count shows here, where SQLite's own \
    integrity check may see nothing. Ends with exit code 1 where they differ, and where an environment or a \
    network cannot be read.\n\n\
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
        let store: Arc<dyn Store> = Arc::new(SqliteStore::open(&path, Options::default()).await.map_err(unopened)?);
        let found = Found::of(&store).await;
        store.close().await;
        let found = found?;
        if self.json {
            output::print_json(&report(&found))?
        } else {
            found.audits.iter().try_for_each(tell)?;
            found.environments.iter().try_for_each(|environment| tell_unreadable(environment))?;
            found.networks.iter().try_for_each(tell_network)?
        }
        found.verdict()
    }
}

/// What was found in a database.
struct Found {
    audits: Vec<Audit>,
    /// Those that cannot be read.
    environments: Vec<Arc<UnreadableEnvironment>>,
    /// Likewise.
    networks: Vec<UnreadableNetwork>,
}

/// A network that cannot be read.
struct UnreadableNetwork {
    environment: String,
    version: u64,
    why: String,
}

impl Found {
    async fn of(store: &Arc<dyn Store>) -> Result<Self, Failure> {
        let audits = store.audit().await.map_err(unopened)?;
        let registry = Networks::new(store.clone(), Fits::new(store.clone()));
        let mut networks = Vec::new();
        for environment in store.environments() {
            let listed = registry.list(&environment).await.map_err(|problem| Failure::usage(problem.to_string()))?;
            let unread = |model: Model| {
                let why = model.card.err()?;
                Some(UnreadableNetwork { environment: environment.name.to_string(), version: model.version, why })
            };
            networks.extend(listed.models.into_iter().filter_map(unread));
        }
        Ok(Self { audits, environments: store.unreadable(), networks })
    }

    fn verdict(&self) -> Result<(), Failure> {
        let unsound = self.audits.iter().filter(|audit| !audit.is_sound()).count();
        match (unsound, self.environments.len(), self.networks.len()) {
            (0, 0, 0) => Ok(()),
            (0, 0, networks) => Err(Failure::refused(format!("{networks} networks cannot be read"))),
            (0, unread, 0) => Err(Failure::refused(format!("{unread} environments cannot be read"))),
            (0, unread, networks) => {
                Err(Failure::refused(format!("{unread} environments and {networks} networks cannot be read")))
            }
            (unsound, ..) => {
                let all = self.audits.len();
                Err(Failure::refused(format!("{unsound} of {all} environments do not match their cells")))
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

fn tell_network(network: &UnreadableNetwork) -> Result<(), Failure> {
    let UnreadableNetwork { environment, version, why } = network;
    output::print(&format!("{environment}, network version {version}: CANNOT BE READ, {why}"))
}

fn report(found: &Found) -> serde_json::Value {
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
    let mut report = json!({ "environments": found.audits.iter().map(one).collect::<Vec<_>>() });
    let environment =
        |one: &Arc<UnreadableEnvironment>| json!({"name": one.name, "uid": one.uid.0, "unreadable": one.why});
    if !found.environments.is_empty() {
        report["unreadable"] = found.environments.iter().map(environment).collect();
    }
    let network = |one: &UnreadableNetwork| json!({"environment": one.environment, "version": one.version, "unreadable": one.why});
    if !found.networks.is_empty() {
        report["unreadable_networks"] = found.networks.iter().map(network).collect();
    }
    report
}
