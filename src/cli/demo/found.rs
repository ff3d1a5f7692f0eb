//! What the demo tells at the end: how much was counted, and where agents depend on each other.

use crate::api::json::{dependence, verdict};
use crate::api::proto;
use crate::cli::Failure;
use crate::cli::output::{Table, count, figure, print};
use crate::cli::progress::Progress;
use crate::cli::train::Watched;
use crate::client::{Connection, patiently};

/// States told of each environment.
const TOLD: u32 = 3;

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
    states: Vec<[String; 10]>,
}

impl Found {
    /// Adds what was found in an environment.
    pub(super) fn add(&mut self, seen: Seen) {
        if seen.best.dependent > self.best.dependent {
            self.best = seen.best;
        }
        self.summaries.push(seen.summary);
        self.states.extend(seen.states);
    }

    /// Prints what was counted and the most dependent states of each environment, if there is any.
    pub(super) fn tell(&self) -> Result<(), Failure> {
        if self.summaries.is_empty() {
            return Ok(());
        }

        let mut summaries = Table::new(&[
            "environment",
            "transitions",
            "states",
            "influence",
            "some dependence",
            "discoveries at 5 %",
        ]);

        let mut states = Table::new(&[
            "environment",
            "state",
            "visits",
            "plug-in",
            "if independent",
            "posterior mean",
            "P(dependent)",
            "dependence",
            "verdict",
            "paper's rule",
        ]);

        self.summaries
            .iter()
            .for_each(|row| summaries.row(row.clone()));
        self.states.iter().for_each(|row| states.row(row.clone()));
        print(&format!("\n{}", summaries.render("")))?;
        print(&format!(
            "\nwhere two agents most probably depend on each other (information in nats)\n{}",
            states.render("")
        ))?;

        print(
            "\n\"influence\": mutual information is probably above 0.5 nats. \"some dependence\": there is any at all, however weak. Plug-in mutual \
             information,\nthe paper's figure, is mostly bias at few visits: it stands beside what it would be if the agents were independent.",
        )
    }
}

/// What was found in one environment.
pub(super) struct Seen {
    best: Best,
    summary: [String; 6],
    states: Vec<[String; 10]>,
}

/// Looks at all that is counted of an environment.
pub(super) async fn look(connection: &Connection, environment: &str) -> Result<Seen, Failure> {
    let scope = scope(environment);
    settle(connection, &scope).await?;
    let summary = summary_row(environment, &summary(connection, &scope).await?);
    let mut seen = Seen {
        best: Best::default(),
        summary,
        states: Vec::new(),
    };

    for state in most_dependent(connection, environment).await? {
        let key = state.state.clone().unwrap_or_default().key;
        let dependent = state
            .probability
            .map_or(0.0, |probability| probability.dependent);
        if dependent > seen.best.dependent {
            seen.best = Best {
                environment: environment.to_owned(),
                key: key.clone(),
                dependent,
            };
        }
        let paper = by_paper(connection, environment, &key).await?;
        seen.states.push(state_row(environment, key, &state, paper));
    }

    Ok(seen)
}

/// A question at a lag.
pub(super) struct Later {
    pub environment: &'static str,
    pub ego: &'static str,
    pub other: &'static str,
    pub lag: i32,
}

/// Prints what is found at a lag, in a line.
pub(super) async fn tell_later(connection: &Connection, later: &Later) -> Result<(), Failure> {
    let Later {
        environment,
        ego,
        other,
        lag,
    } = *later;
    let scope = proto::Scope {
        ego: ego.into(),
        other: other.into(),
        lag,
        ..scope(environment)
    };
    settle(connection, &scope).await?;
    let summary = summary(connection, &scope).await?;
    let established = summary.dependence.unwrap_or_default().established;
    let [established, states] = [established, summary.states].map(count);
    print(&format!(
        "\n{lag} steps later {ego} has some influence on {other} in {established} of {states} states of {environment}, given what {other} did a step before"
    ))
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
) -> Result<Vec<proto::StateFigures>, Failure> {
    let request = proto::ListStatesRequest {
        scope: Some(scope(environment)),
        order_by: "p_dependent desc".into(),
        page_size: TOLD,
        ..Default::default()
    };
    let ask = || {
        let (mut client, request) = (connection.influence(), request.clone());
        async move { client.list_states(request).await }
    };
    Ok(patiently(ask).await?.states)
}

/// Returns what the paper's rule says of a state.
async fn by_paper(
    connection: &Connection,
    environment: &str,
    key: &str,
) -> Result<&'static str, Failure> {
    let rule = proto::Rule {
        kind: Some("paper".into()),
        ..Default::default()
    };
    let request = proto::GetInfluenceRequest {
        scope: Some(proto::Scope {
            rule: Some(rule),
            ..scope(environment)
        }),
        state: Some(proto::get_influence_request::State::Key(key.into())),
        view: proto::View::Verdict.into(),
        ..Default::default()
    };

    let answer = connection
        .influence()
        .get_influence(request)
        .await?
        .into_inner()
        .answer
        .unwrap_or_default();

    Ok(verdict(answer.verdict))
}

fn scope(environment: &str) -> proto::Scope {
    proto::Scope {
        environment: environment.into(),
        ..Default::default()
    }
}

fn summary_row(environment: &str, summary: &proto::SummarizeResponse) -> [String; 6] {
    [
        environment.to_owned(),
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

fn state_row(
    environment: &str,
    key: String,
    state: &proto::StateFigures,
    paper: &str,
) -> [String; 10] {
    [
        environment.to_owned(),
        key,
        count(state.visits),
        figure(state.plug_in),
        figure(state.expected_if_independent),
        state.posterior_mean.map_or("-".into(), figure),
        state
            .probability
            .map_or("-".into(), |probability| figure(probability.dependent)),
        dependence(state.dependence).unwrap_or("-").to_owned(),
        verdict(state.verdict).to_owned(),
        paper.to_owned(),
    ]
}
