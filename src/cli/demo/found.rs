//! What the demo tells of states by themselves: how many there are, and in which of them agents most
//! probably depend on each other.

use super::names::short;
use crate::api::json::verdict;
use crate::api::proto;
use crate::cli::Failure;
use crate::cli::output::{Table, count, figure, figure_or_dash, print};
use crate::cli::progress::Progress;
use crate::cli::train::Watched;
use crate::client::{Connection, patiently};

/// The columns of what is printed.
const WIDTH: usize = 80;

/// A state worth a look: its environment and its key.
#[derive(Default)]
pub(super) struct Best {
    pub environment: String,
    pub key: String,
    dependent: f64,
}

/// What was found so far, environment by environment.
#[derive(Default)]
pub(super) struct Found {
    /// The most dependent state of all.
    pub best: Best,
    summaries: Vec<[String; 6]>,
    states: Vec<State>,
}

/// A state by its figures and by what people call it.
struct State {
    figures: [String; 7],
    labels: Vec<String>,
}

impl Found {
    /// Adds what was found in an environment.
    pub(super) fn add(&mut self, seen: Seen) {
        if seen.best.dependent > self.best.dependent {
            self.best = seen.best;
        }
        self.summaries.push(seen.summary);
        self.states.extend(seen.state);
    }

    /// Prints what was counted and the most dependent state of each environment, if there is any.
    pub(super) fn tell(&self) -> Result<(), Failure> {
        if self.summaries.is_empty() {
            return Ok(());
        }

        let mut summaries = Table::new(&[
            "environment",
            "transitions",
            "states",
            "influence",
            "dependence",
            "discoveries",
        ]);
        self.summaries
            .iter()
            .for_each(|row| summaries.row(row.clone()));
        print(&format!(
            "\neach state by itself, in the same tick: how many there are\n\n{}",
            summaries.render("")
        ))?;

        print(&format!(
            "\nthe state of each where the two most probably depend on each other\n\n{}",
            rendered(&self.states)
        ))?;

        print(
            "\ninfluence: mutual information is probably above 0.5 nats; dependence: there is\n\
             any at all, however weak; discoveries: at a false discovery rate of 5 %.\n\
             plug-in, the paper's figure, is mostly bias at few visits: chance is what it\n\
             would be were the two independent, mean what the counts support.",
        )
    }
}

/// Returns states as text: a row of figures each, and below it the state.
fn rendered(states: &[State]) -> String {
    let mut table = Table::new(&[
        "environment",
        "visits",
        "plug-in",
        "chance",
        "mean",
        "P(dependent)",
        "verdict",
    ]);
    for state in states {
        table.row(state.figures.clone());
    }

    let table = table.render("");
    let mut rows = table.lines();
    let title = format!("{}\n", rows.next().unwrap_or_default());
    let told = rows
        .zip(states)
        .map(|(row, state)| format!("{row}\n{}", wrapped(&state.labels)));
    title + &told.collect::<String>()
}

/// Returns words in indented lines that are no wider than what is printed.
fn wrapped(words: &[String]) -> String {
    const INDENT: &str = "    ";
    let mut lines: Vec<String> = Vec::new();
    for word in words {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= WIDTH => {
                line.push_str(&format!(" {word}"));
            }
            _ => lines.push(format!("{INDENT}{word}")),
        }
    }
    lines.iter().map(|line| format!("{line}\n")).collect()
}

/// What was found in one environment.
pub(super) struct Seen {
    best: Best,
    summary: [String; 6],
    state: Option<State>,
}

/// Looks at all that is counted of an environment.
pub(super) async fn look(connection: &Connection, environment: &str) -> Result<Seen, Failure> {
    let scope = scope(environment);
    settle(connection, &scope).await?;
    let summary = summary_row(environment, &summary(connection, &scope).await?);
    let state = most_dependent(connection, environment).await?;
    let best = state.as_ref().map_or(Best::default(), |state| Best {
        environment: environment.to_owned(),
        key: state.state.clone().unwrap_or_default().key,
        dependent: state
            .probability
            .map_or(0.0, |probability| probability.dependent),
    });
    Ok(Seen {
        best,
        summary,
        state: state.map(|state| told(environment, &state)),
    })
}

/// Trains a network for an environment, and prints whether it is worth asking.
pub(super) async fn train(connection: &Connection, environment: &str) -> Result<(), Failure> {
    print(&format!(
        "\nmeanwhile a network is trained for {environment}, to answer where counts do not decide ..."
    ))?;
    let request = proto::TrainModelRequest {
        environment: environment.into(),
        ..Default::default()
    };
    let job = connection
        .models()
        .train_model(request)
        .await?
        .into_inner()
        .job
        .unwrap_or_default();

    let progress = Progress::of_share();
    let job = Watched::new(connection, environment, job.id)
        .over(&progress)
        .await;
    progress.finish();
    let job = job?;

    print(&format!(
        "{}: `nudge model show {environment} {}` tells how it was judged",
        job.message,
        job.version()
    ))
}

/// Fits the prior that a question of an environment stands on, and waits until what is told of all
/// its states stands on that fit and on everything counted.
async fn settle(connection: &Connection, scope: &proto::Scope) -> Result<(), Failure> {
    let fit = proto::FitPriorRequest {
        environment: scope.environment.clone(),
        ego: scope.ego.clone(),
        other: scope.other.clone(),
        lag: scope.lag,
        ..Default::default()
    };
    let ask = || {
        let (mut client, fit) = (connection.influence(), fit.clone());
        async move { client.fit_prior(fit).await }
    };
    let fits = patiently(ask).await?.fits;
    let made = fits
        .first()
        .and_then(|fitted| fitted.fit)
        .unwrap_or_default();

    loop {
        let told = summary(connection, scope).await?;
        if told.as_of >= made.revision && told.fit.unwrap_or_default().version >= made.version {
            return Ok(());
        }
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
    }
}

async fn summary(
    connection: &Connection,
    scope: &proto::Scope,
) -> Result<proto::SummarizeResponse, Failure> {
    let discovery = proto::Discovery {
        fdr: Some(0.05),
        ..Default::default()
    };
    let request = proto::SummarizeRequest {
        scope: Some(scope.clone()),
        discovery: Some(discovery),
        omit_segments: true,
    };

    let ask = || {
        let (mut client, request) = (connection.influence(), request.clone());
        async move { client.summarize(request).await }
    };
    Ok(patiently(ask).await?)
}

async fn most_dependent(
    connection: &Connection,
    environment: &str,
) -> Result<Option<proto::StateFigures>, Failure> {
    let request = proto::ListStatesRequest {
        scope: Some(scope(environment)),
        order_by: "p_dependent desc".into(),
        page_size: 1,
        ..Default::default()
    };
    let ask = || {
        let (mut client, request) = (connection.influence(), request.clone());
        async move { client.list_states(request).await }
    };
    Ok(patiently(ask).await?.states.pop())
}

fn scope(environment: &str) -> proto::Scope {
    proto::Scope {
        environment: environment.into(),
        ..Default::default()
    }
}

fn summary_row(environment: &str, summary: &proto::SummarizeResponse) -> [String; 6] {
    [
        short(environment).to_owned(),
        count(summary.transitions),
        count(summary.states),
        count(summary.verdicts.map_or(0, |verdicts| verdicts.influences)),
        count(
            summary
                .dependence
                .map_or(0, |dependence| dependence.established),
        ),
        count(
            summary
                .discoveries
                .map_or(0, |discoveries| discoveries.states),
        ),
    ]
}

fn told(environment: &str, state: &proto::StateFigures) -> State {
    let bins = state.state.clone().unwrap_or_default().bins;
    let label = |bin: proto::Bin| format!("{}={}", bin.feature, bin.label);
    let figures = [
        short(environment).to_owned(),
        count(state.visits),
        figure(state.plug_in),
        figure(state.expected_if_independent),
        figure_or_dash(state.posterior_mean),
        figure_or_dash(state.probability.map(|probability| probability.dependent)),
        verdict(state.verdict).to_owned(),
    ];
    State {
        figures,
        labels: bins.into_iter().map(label).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_are_told_by_their_labels_within_the_width() {
        let words: Vec<String> = (0..9)
            .map(|at| format!("player_{at}.orientation=N"))
            .collect();
        let told = wrapped(&words);
        assert_eq!(told.split_whitespace().collect::<Vec<_>>(), words);
        assert!(told.lines().all(|line| line.chars().count() <= WIDTH));
        assert_eq!(told.lines().count(), 3);
    }
}
