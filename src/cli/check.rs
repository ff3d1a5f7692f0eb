//! `nudge check`: whether a database is sound: its totals match its cells, SQLite finds nothing
//! wrong, and everything can be read.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use serde_json::json;

use super::config::{Config, database};
use super::{Failure, output};
use crate::domain::{EnvironmentId, Model, UnreadableEnvironment};
use crate::error::Problem;
use crate::model::Networks;
use crate::priors::PriorRegistry;
use crate::store::{Audit, Options, SqliteStore, Store, StoreError};

/// Audit a database, changing nothing
#[derive(Debug, Args)]
#[command(
    long_about = "Audit a database, changing nothing. A service may have it open.\n\n\
    Compares the totals that were kept with every commit with the sums of the cells: a bit that flipped in a count shows here, where SQLite's own \
    integrity check may see nothing. Runs that check too, which sees the rest: pages, indices, types and constraints. Ends with exit code 1 where \
    something is wrong or cannot be read, and 2 where there is no database to look at.\n\n\
    Example:\n  nudge check --data ./nudge-data"
)]
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
        let path = database(&self.data);
        if !path.exists() {
            return Err(Failure::usage(format!(
                "no database at {}: name its directory with --data",
                path.display()
            )));
        }

        let found = match SqliteStore::inspect(&path, Options::default()).await {
            Ok(store) => Found::in_store(Arc::new(store)).await?,
            // So damaged that nothing can be read is damage too.
            Err(StoreError::Damaged(why)) => Found {
                integrity: vec![why],
                ..Found::default()
            },
            Err(error) => return Err(Failure::usage(error)),
        };

        if self.json {
            output::print_json(&report(&found))?
        } else {
            found.audits.iter().try_for_each(tell)?;
            found
                .integrity
                .iter()
                .try_for_each(|line| output::print(&format!("database: DAMAGED, {line}")))?;
            found
                .environments
                .iter()
                .try_for_each(|environment| tell_unreadable(environment))?;
            found.networks.iter().try_for_each(tell_network)?;
            let lines = [&found.receipts, &found.rows, &found.fits];
            lines
                .into_iter()
                .flatten()
                .try_for_each(|line| output::print(line))?
        }
        found.verdict()
    }
}

/// What was found in a database.
#[derive(Default)]
struct Found {
    audits: Vec<Audit>,
    /// What SQLite finds wrong with it.
    integrity: Vec<String>,
    /// Those that cannot be read.
    environments: Vec<Arc<UnreadableEnvironment>>,
    /// Likewise.
    networks: Vec<UnreadableNetwork>,
    /// Likewise, in words.
    fits: Vec<String>,
    /// What is wrong with the numbers and receipts of batches.
    receipts: Vec<String>,
    /// Which other rows are not as they were written.
    rows: Vec<String>,
}

/// A network that cannot be read.
struct UnreadableNetwork {
    environment: String,
    version: u64,
    why: String,
}

impl Found {
    async fn in_store(store: Arc<SqliteStore>) -> Result<Self, Failure> {
        let integrity = store.integrity().await.map_err(Failure::usage)?;
        let audits = store.audit().await.map_err(Failure::usage)?;

        // Tables of fits and of networks came later than those of counts.
        let networks = match store.has_table("models").await.map_err(Failure::usage)? {
            true => unreadable_networks(store.clone()).await,
            false => Ok(Vec::new()),
        };
        let networks = match networks {
            Err(_) if !integrity.is_empty() => Vec::new(),
            networks => networks.map_err(|problem| Failure::usage(problem.to_string()))?,
        };
        let receipts = in_each(&store, async |id| store.receipts(id).await).await?;
        let rows = in_each(&store, async |id| store.damaged_rows(id).await).await?;
        let fits = if store.has_table("fits").await.map_err(Failure::usage)? {
            fits(&store).await
        } else {
            Vec::new()
        };

        let environments = store.unreadable();
        store.close().await;

        Ok(Self {
            audits,
            integrity,
            environments,
            networks,
            fits,
            receipts,
            rows,
        })
    }

    fn verdict(&self) -> Result<(), Failure> {
        let unsound = self.audits.iter().filter(|audit| !audit.is_sound()).count();
        let mut faults = Vec::new();
        if !self.integrity.is_empty() {
            faults.push("the database is damaged".to_owned());
        }
        if unsound > 0 {
            faults.push(format!(
                "{unsound} of {} environments do not match their cells",
                self.audits.len()
            ));
        }
        if !self.receipts.is_empty() {
            faults.push(format!(
                "{} receipts or numbers of batches are not as they were written",
                self.receipts.len()
            ));
        }
        if !self.rows.is_empty() {
            faults.push(format!(
                "{} other rows are not as they were written",
                self.rows.len()
            ));
        }
        let unread = [
            (self.environments.len(), "environments"),
            (self.networks.len(), "networks"),
            (self.fits.len(), "fits"),
        ];

        let unread: Vec<String> = unread
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}"))
            .collect();

        if !unread.is_empty() {
            faults.push(format!("{} cannot be read", unread.join(" and ")));
        }

        if faults.is_empty() {
            Ok(())
        } else {
            Err(Failure::refused(faults.join("; ")))
        }
    }
}

/// Looks for something in every environment. What cannot be read at all, the audit has told.
async fn in_each(
    store: &SqliteStore,
    look: impl AsyncFn(EnvironmentId) -> Result<Vec<String>, StoreError>,
) -> Result<Vec<String>, Failure> {
    let mut found = Vec::new();
    for environment in store.environments() {
        match look(environment.id).await {
            Ok(faults) => found.extend(
                faults
                    .iter()
                    .map(|fault| format!("{}: DAMAGED, {fault}", environment.name)),
            ),
            Err(StoreError::Damaged(_)) => {}
            Err(error) => return Err(Failure::usage(error)),
        }
    }
    Ok(found)
}

/// Looks at the fits of every environment: those that are damaged, not those of an older form,
/// which are made again.
async fn fits(store: &Arc<SqliteStore>) -> Vec<String> {
    let unread = PriorRegistry::new(store.clone())
        .unreadable()
        .await
        .into_iter()
        .filter(|unread| !unread.is_older());
    unread
        .map(|unread| {
            format!(
                "{}, fit of {}: CANNOT BE READ, {}",
                unread.environment, unread.pair, unread.why
            )
        })
        .collect()
}

async fn unreadable_networks(store: Arc<dyn Store>) -> Result<Vec<UnreadableNetwork>, Problem> {
    let registry = Networks::new(store.clone(), PriorRegistry::new(store.clone()));
    let mut networks = Vec::new();
    for environment in store.environments() {
        let listed = registry.list(&environment).await?;
        let unread = |model: Model| {
            let why = model.card.err()?;
            Some(UnreadableNetwork {
                environment: environment.name.to_string(),
                version: model.version,
                why,
            })
        };
        networks.extend(listed.models.into_iter().filter_map(unread));
    }

    Ok(networks)
}

fn tell(audit: &Audit) -> Result<(), Failure> {
    let [transitions, states, cells] = audit.kept;
    let figures = format!("{transitions} transitions, {states} states, {cells} cells");
    if let Some(why) = &audit.unreadable {
        return output::print(&format!(
            "{}: UNSOUND, cannot be read: {why}",
            audit.environment
        ));
    }

    if audit.is_sound() {
        return output::print(&format!("{}: sound ({figures})", audit.environment));
    }

    let [transitions, states, cells] = audit.found;
    let found = format!("{transitions} transitions, {states} states, {cells} cells");

    output::print(&format!(
        "{}: UNSOUND, kept {figures}, found {found}",
        audit.environment
    ))
}

fn tell_unreadable(environment: &UnreadableEnvironment) -> Result<(), Failure> {
    output::print(&format!(
        "{}: CANNOT BE READ, {}",
        environment.name, environment.why
    ))
}

fn tell_network(network: &UnreadableNetwork) -> Result<(), Failure> {
    let UnreadableNetwork {
        environment,
        version,
        why,
    } = network;
    output::print(&format!(
        "{environment}, network version {version}: CANNOT BE READ, {why}"
    ))
}

fn audit_json(audit: &Audit) -> serde_json::Value {
    match &audit.unreadable {
        Some(why) => {
            json!({ "environment": audit.environment.as_str(), "sound": false, "unreadable": why })
        }
        None => json!({
            "environment": audit.environment.as_str(),
            "sound": audit.is_sound(),
            "kept": figures_json(audit.kept),
            "found": figures_json(audit.found),
        }),
    }
}

fn figures_json([transitions, states, cells]: [u64; 3]) -> serde_json::Value {
    json!({"transitions": transitions, "states": states, "cells": cells})
}

fn report(found: &Found) -> serde_json::Value {
    let environments: Vec<_> = found.audits.iter().map(audit_json).collect();
    let mut report = json!({ "sound": found.verdict().is_ok(), "environments": environments, "integrity": found.integrity });

    let environment = |one: &Arc<UnreadableEnvironment>| json!({"name": one.name, "uid": one.uid.0, "unreadable": one.why});
    if !found.environments.is_empty() {
        report["unreadable"] = found.environments.iter().map(environment).collect();
    }

    let network = |one: &UnreadableNetwork| json!({"environment": one.environment, "version": one.version, "unreadable": one.why});
    if !found.networks.is_empty() {
        report["unreadable_networks"] = found.networks.iter().map(network).collect();
    }

    for (name, lines) in [
        ("unreadable_fits", &found.fits),
        ("receipts", &found.receipts),
        ("rows", &found.rows),
    ] {
        if !lines.is_empty() {
            report[name] = json!(lines);
        }
    }

    report
}
