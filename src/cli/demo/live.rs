//! A live view of what the service counts and finds while it is played into: redrawn in place on a
//! terminal, plain lines in a pipe.

use std::collections::HashMap;
use std::convert::Infallible;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::names::short;
use crate::api::proto;
use crate::cli::Failure;
use crate::cli::output::{Table, count, print};
use crate::client::{Connection, patiently};
use crate::error::ErrorKind;

/// From one look to the next, on a terminal and in a pipe.
const TERMINAL: Duration = Duration::from_millis(500);
const PIPE: Duration = Duration::from_secs(1);

/// Looks at environments while others play into them.
pub(super) struct Live {
    connection: Connection,
    environments: Vec<String>,
    seen: HashMap<String, Seen>,
    bar: Option<ProgressBar>,
}

/// An environment at the last look.
struct Seen {
    at: Instant,
    transitions: u64,
}

/// An environment at a look.
struct Line {
    environment: String,
    /// Since the look before.
    per_second: f64,
    summary: proto::SummarizeResponse,
}

impl Live {
    /// Looks at these environments for the first time, and says nothing yet.
    pub(super) async fn begin(
        connection: &Connection,
        environments: Vec<String>,
    ) -> Result<Self, Failure> {
        let bar = std::io::stdout().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stdout());
            bar.with_style(
                ProgressStyle::with_template("{msg}")
                    .unwrap_or_else(|_| ProgressStyle::default_bar()),
            )
        });

        let mut live = Self {
            connection: connection.clone(),
            environments,
            seen: HashMap::new(),
            bar,
        };
        live.look().await?;
        Ok(live)
    }

    /// Looks and tells until it is dropped.
    pub(super) async fn run(&mut self) -> Result<Infallible, Failure> {
        loop {
            tokio::time::sleep(if self.bar.is_some() { TERMINAL } else { PIPE }).await;
            self.tell().await?;
        }
    }

    /// Looks and tells once.
    pub(super) async fn tell(&mut self) -> Result<(), Failure> {
        let lines = self.look().await?;
        match &self.bar {
            Some(bar) => bar.set_message(table(&lines)),
            None => {
                let moved = lines.iter().filter(|line| line.per_second > 0.0);
                let told: String = moved.map(plain).collect();
                if !told.is_empty() {
                    print(&told)?;
                }
            }
        }
        Ok(())
    }

    /// Takes the drawing away.
    pub(super) fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }

    async fn look(&mut self) -> Result<Vec<Line>, Failure> {
        let mut lines = Vec::new();
        for environment in &self.environments {
            let scope = proto::Scope {
                environment: environment.clone(),
                ..Default::default()
            };
            let request = proto::SummarizeRequest {
                scope: Some(scope),
                omit_segments: true,
                ..Default::default()
            };
            let ask = || {
                let (mut client, request) = (self.connection.influence(), request.clone());
                async move { client.summarize(request).await }
            };
            let summary = match patiently(ask).await {
                Ok(summary) => summary,
                // It is made when its first player comes.
                Err(error) if error.kind() == ErrorKind::NotFound => {
                    proto::SummarizeResponse::default()
                }
                Err(error) => return Err(error.into()),
            };
            let now = Seen {
                at: Instant::now(),
                transitions: summary.transitions,
            };
            let before = self.seen.insert(environment.clone(), now);
            let per_second = before.map_or(0.0, |before| {
                summary.transitions.saturating_sub(before.transitions) as f64
                    / before.at.elapsed().as_secs_f64()
            });
            lines.push(Line {
                environment: environment.clone(),
                per_second,
                summary,
            });
        }
        Ok(lines)
    }
}

fn table(lines: &[Line]) -> String {
    let mut table = Table::new(&[
        "environment",
        "transitions",
        "a second",
        "states",
        "influence",
        "dependence",
    ]);
    for line in lines {
        let Line {
            environment,
            per_second,
            summary,
        } = line;
        table.row([
            short(environment).to_owned(),
            count(summary.transitions),
            count(*per_second as u64),
            count(summary.states),
            influences(summary),
            established(summary),
        ]);
    }
    table.render("")
}

fn plain(line: &Line) -> String {
    let Line {
        environment,
        per_second,
        summary,
    } = line;
    format!(
        "{}: {} transitions, {} a second, {} states, influence in {}, dependence in {}\n",
        short(environment),
        count(summary.transitions),
        count(*per_second as u64),
        count(summary.states),
        influences(summary),
        established(summary),
    )
}

fn influences(summary: &proto::SummarizeResponse) -> String {
    found(
        summary,
        summary.verdicts.map_or(0, |verdicts| verdicts.influences),
    )
}

fn established(summary: &proto::SummarizeResponse) -> String {
    found(
        summary,
        summary
            .dependence
            .map_or(0, |dependence| dependence.established),
    )
}

/// Returns how many states were found, once a prior was fitted: before that, it is too early to
/// tell.
fn found(summary: &proto::SummarizeResponse, states: u64) -> String {
    if summary.fit.unwrap_or_default().version == 0 {
        "-".into()
    } else {
        count(states)
    }
}
