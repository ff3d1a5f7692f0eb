//! Gauges, collected at the time of a scrape: of what exists now, so that figures of deleted
//! environments go with them.

use std::collections::HashMap;
use std::time::Instant;

use crate::app::App;
use crate::domain::{Environment, EnvironmentId};
use crate::ingest;
use crate::store::{Held, Quotas, Totals};
use crate::telemetry::{OfEnvironment, Standing};

/// Looks at every room, after those checks of readiness.
pub async fn standing(app: &App, checks: Vec<(&'static str, bool)>) -> Standing {
    let [queued, running] = app.networks.at_work();
    let lanes = [
        ("questions", &app.work.questions),
        ("passes", &app.work.passes),
        ("fits", &app.work.fits),
    ];
    Standing {
        checks,
        queued: app.ingest.queued(),
        lanes: lanes
            .into_iter()
            .map(|(lane, gate)| (lane, gate.busy(), gate.waiting()))
            .collect(),
        jobs: vec![("queued", queued), ("running", running)],
        read_only: app.store.read_only().len(),
        // What cannot be read now is absent, which a monitor tells from 0.
        database: app.store.bytes().await.ok(),
        disk: app.store.disk().await.ok(),
        most_environments: app.store.quotas().environments,
        environments: environments(app).await,
    }
}

async fn environments(app: &App) -> Vec<OfEnvironment> {
    let environments = app.store.environments();
    let ids: Vec<EnvironmentId> = environments
        .iter()
        .map(|environment| environment.id)
        .collect();
    let held: HashMap<EnvironmentId, Held> = app
        .store
        .held()
        .await
        .unwrap_or_default()
        .into_iter()
        .collect();

    let (figures, quotas, now) = (app.ingest.figures(&ids), app.store.quotas(), Instant::now());
    let told = environments
        .iter()
        .zip(figures)
        .map(|(environment, figures)| {
            let held = held.get(&environment.id).copied().unwrap_or_default();
            let fit = app.fits.oldest(environment.id, now);
            OfEnvironment {
                fit_behind: fit
                    .map(|(revision, _)| held.totals.transitions.saturating_sub(revision)),
                fit_age: fit
                    .and_then(|(_, made)| made)
                    .map(|made| now.saturating_duration_since(made)),
                ..of_environment(environment, figures, held, quotas)
            }
        });

    told.collect()
}

fn of_environment(
    environment: &Environment,
    figures: ingest::Figures,
    held: Held,
    quotas: Quotas,
) -> OfEnvironment {
    let ingest::Figures {
        accepted,
        rejected,
        duplicates,
        unverified,
        last,
    } = figures;

    let Held {
        totals:
            Totals {
                transitions,
                states,
                cells,
                segments,
                producers,
                ..
            },
        models,
        active,
    } = held;

    let quotas = vec![
        ("cells", cells, quotas.cells),
        ("segments", segments, quotas.segments),
        ("producers", producers, quotas.producers),
        ("models", models, quotas.models),
    ];

    OfEnvironment {
        name: environment.name.to_string(),
        accepted,
        rejected,
        duplicates,
        unverified,
        last_batch: last,
        transitions,
        states,
        cells,
        quotas,
        models,
        active,
        ..OfEnvironment::default()
    }
}
