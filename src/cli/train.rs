//! `nudge train`: a network for a pair of agents, trained by the service and judged beside its
//! baselines.

use std::fmt::Display;
use std::time::{Duration, Instant};

use clap::Args;

use super::model::{all, shown};
use super::progress::Progress;
use super::server::Server;
use super::signals::Signals;
use super::{Failure, card};
use crate::api::proto::{self, JobState};
use crate::client::{ClientError, Connection, patiently, patiently_telling};
use crate::domain::{ModelId, ModelKind, Training, Weighting};

/// How often the service is asked how far it is: often at first, for a short training, then less
/// and less.
const OFTEN: Duration = Duration::from_millis(100);
const SELDOM: Duration = Duration::from_secs(1);

/// In a pipe a line is told where there is something new, and after so long in any case.
const QUIET: Duration = Duration::from_secs(30);

/// Train a network that answers where counts do not decide
#[derive(Debug, Args)]
#[command(
    long_about = "Train a network that answers where counts do not decide, and show how it did on states that it did not learn from.\n\n\
    The service trains it from the counts. It is made active by itself where it beats every baseline, and with --activate anyway. Ctrl-C ends the \
    training.\n\n\
    Example:\n  nudge train hallway\n  \
    nudge train hallway --ego robot --other human --kind direct --members 5 --seed 7\n  \
    nudge train hallway --lag 3\n  \
    nudge train hallway --epochs 50 --activate --json"
)]
pub(super) struct Train {
    /// Name of the environment
    environment: String,
    /// Agent whose influence is learned; the first one unless given
    #[arg(long, value_name = "AGENT")]
    ego: Option<String>,
    /// Agent that may be influenced; the second one unless given
    #[arg(long, value_name = "AGENT")]
    other: Option<String>,
    /// Steps after which the other's action is observed, as the environment declares them; 0, the
    /// same tick, unless given
    #[arg(
        long,
        value_name = "STEPS",
        allow_negative_numbers = true,
        default_value_t = 0,
        hide_default_value = true
    )]
    lag: i32,
    /// What is predicted: joint (what both agents do) or direct (whether mutual information is
    /// above the threshold); joint unless given
    #[arg(long, value_name = "KIND")]
    kind: Option<ModelKind>,
    #[arg(long, value_name = "NUMBER", help = usual("Units of the hidden layer", Training::default().width))]
    width: Option<u64>,
    #[arg(long, value_name = "NUMBER", help = usual("Networks that are trained and averaged", Training::default().members))]
    members: Option<u64>,
    #[arg(long, value_name = "NUMBER", help = usual("Parts that the states are cut into; each member is stopped and judged by one that it does not learn from", Training::default().folds))]
    folds: Option<u64>,
    #[arg(long, value_name = "NUMBER", help = usual("The most passes over the states", Training::default().epochs))]
    epochs: Option<u64>,
    /// How much a state counts: visits (as often as it was seen) or states (once); visits unless
    /// given
    #[arg(long, value_name = "WEIGHTING")]
    weighting: Option<Weighting>,
    #[arg(long, value_name = "NUMBER", help = usual("Where all randomness comes from", Training::default().seed))]
    seed: Option<u64>,
    /// Make it active even where it does not beat its baselines
    #[arg(long)]
    activate: bool,
    /// Print JSON, as REST answers it
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

/// Returns the help of a flag whose default is the service's.
fn usual(what: &str, default: impl Display) -> String {
    format!("{what}; {default} unless given")
}

impl Train {
    pub(super) async fn run(self) -> Result<(), Failure> {
        let connection = self.server.connect().await?;
        let signals = Signals::install()?;
        let before = all(&connection, &self.environment).await?.models;
        let request = self.request();
        let response = connection
            .models()
            .train_model(request.clone())
            .await?
            .into_inner();
        let asked = response.job.unwrap_or_default();
        let wanted = Wanted {
            ego: asked.ego,
            other: asked.other,
            lag: asked.lag,
            kind: request.kind,
            seed: request.seed(),
            before,
        };

        let job = Watched {
            wanted: Some(wanted),
            ..Watched::new(&connection, &self.environment, asked.id)
        };
        let version = outcome(job.end(&signals).await?)?;
        shown(&job.environment, job.model(version).await?, self.json)
    }

    fn request(&self) -> proto::TrainModelRequest {
        proto::TrainModelRequest {
            environment: self.environment.clone(),
            ego: self.ego.clone().unwrap_or_default(),
            other: self.other.clone().unwrap_or_default(),
            lag: self.lag,
            kind: self
                .kind
                .map_or(proto::ModelKind::Unspecified, Into::into)
                .into(),
            width: self.width,
            members: self.members,
            folds: self.folds,
            epochs: self.epochs,
            weighting: self
                .weighting
                .map_or(proto::Weighting::Unspecified, Into::into)
                .into(),
            seed: self.seed,
            activate: self.activate,
        }
    }
}

/// Returns the version that came out of a job.
fn outcome(job: proto::Job) -> Result<u64, Failure> {
    let name = ModelId::Job(job.id);
    match (job.state(), job.version) {
        (JobState::Done, Some(version)) => Ok(version),
        (JobState::Cancelled, _) => Err(Failure::refused(format!(
            "{name} was cancelled: {}",
            job.message
        ))),
        _ => Err(Failure::refused(format!("{name} failed: {}", job.message))),
    }
}

/// What is said beside the bar, which tells the share itself.
fn part(job: &proto::Job) -> String {
    match job.seconds_left {
        // Where the terminal ends before the sentence, how many wait is said.
        _ if job.ahead > 0 => format!("{} ahead: {}", job.ahead, job.message),
        Some(seconds) => format!("about {} left: {}", card::about(seconds), job.message),
        None => job.message.clone(),
    }
}

/// What is new enough for a line in a pipe: another state, one fewer in front, another step, a
/// tenth more.
#[derive(PartialEq)]
struct Stage {
    state: i32,
    ahead: u64,
    step: Option<String>,
    tenths: u64,
}

impl Stage {
    fn of_job(job: &proto::Job) -> Self {
        // What a job that waits says is how far the one in front of it is.
        let step = Some(job.message.clone()).filter(|_| job.state() != JobState::Queued);
        Self {
            state: job.state,
            ahead: job.ahead,
            step,
            tenths: (10.0 * job.progress) as u64,
        }
    }
}

/// What was asked for, by which a version that came out of it is told from others'.
struct Wanted {
    ego: String,
    other: String,
    lag: u32,
    kind: i32,
    seed: u64,
    /// The versions that there were already.
    before: Vec<proto::Model>,
}

impl Wanted {
    /// Returns those versions that may have come out of the training: later ones of the same
    /// agents, lag, kind and seed.
    fn kept_of(&self, models: &[proto::Model]) -> Vec<u64> {
        let is_new = |model: &&proto::Model| {
            self.before
                .iter()
                .all(|before| before.version != model.version)
        };
        models
            .iter()
            .filter(is_new)
            .filter(|model| self.is_met_by(model))
            .map(|model| model.version)
            .collect()
    }

    fn is_met_by(&self, model: &proto::Model) -> bool {
        let card = model.card.as_ref().filter(|card| !card.imported);
        let Some(training) = card.and_then(|card| card.training) else {
            return false;
        };

        // What is not said is joint.
        let kind = if self.kind == 0 {
            proto::ModelKind::Joint.into()
        } else {
            self.kind
        };

        (
            &model.ego,
            &model.other,
            model.lag,
            training.kind,
            training.seed,
        ) == (&self.ego, &self.other, self.lag, kind, self.seed)
    }
}

/// Says what became of a job that the service does not know any more, since jobs do not outlive it.
fn lost(id: u64, environment: &str, kept: &[u64]) -> String {
    let name = ModelId::Job(id);
    let lost = format!(
        "{name} of `{environment}` is not known any more: the service was started anew meanwhile"
    );
    match kept {
        [] => {
            format!("{lost}, and no version that may be of it was kept; ask for the training again")
        }
        [.., last] => {
            let of = "of the same agents, kind and seed";
            format!(
                "{lost}; version {last}, {of}, was kept since: nudge model show {environment} {last}"
            )
        }
    }
}

/// A training that is waited for.
pub(super) struct Watched {
    connection: Connection,
    environment: String,
    id: u64,
    wanted: Option<Wanted>,
}

impl Watched {
    pub(super) fn new(connection: &Connection, environment: &str, id: u64) -> Self {
        Self {
            connection: connection.clone(),
            environment: environment.to_owned(),
            id,
            wanted: None,
        }
    }

    /// Shows how far it is until it is over, or ends it when a signal comes.
    async fn end(&self, signals: &Signals) -> Result<proto::Job, Failure> {
        let progress = Progress::of_share();
        let ended = tokio::select! {
            job = self.over(&progress) => job,
            () = signals.next() => Err(self.cancel(signals).await),
        };
        progress.finish();
        ended
    }

    /// Shows how far it is until it is over.
    pub(super) async fn over(&self, progress: &Progress) -> Result<proto::Job, Failure> {
        let mut told = None;
        let mut wait = OFTEN;
        loop {
            let job = self.job(progress).await?;
            progress.part(&part(&job));
            progress.at_share(job.progress);
            let stage = Stage::of_job(&job);
            if told
                .as_ref()
                .is_none_or(|(last, at): &(Stage, Instant)| *last != stage || at.elapsed() >= QUIET)
            {
                progress.line(&card::job_line(&job));
                told = Some((stage, Instant::now()));
            }
            match job.state() {
                JobState::Queued | JobState::Running => tokio::time::sleep(wait).await,
                _ => return Ok(job),
            }
            wait = (2 * wait).min(SELDOM);
        }
    }

    /// Ends the training; another signal says not to wait for that.
    async fn cancel(&self, signals: &Signals) -> Failure {
        let name = ModelId::Job(self.id);
        let request = proto::CancelJobRequest {
            environment: self.environment.clone(),
            id: self.id,
        };
        let mut client = self.connection.models();

        tokio::select! {
            answer = client.cancel_job(request) => match answer {
                Ok(_) => Failure::interrupted(format!("{name} of `{}` cancelled", self.environment)),
                Err(status) => self.failed(status.into()).await,
            },
            () = signals.next() => Failure::interrupted(format!("{name} of `{}` may go on", self.environment)),
        }
    }

    /// Asks how far it is, and says so where the service is away for a moment.
    async fn job(&self, progress: &Progress) -> Result<proto::Job, Failure> {
        let ask = || {
            let request = proto::GetJobRequest {
                environment: self.environment.clone(),
                id: self.id,
            };
            let mut client = self.connection.models();
            async move { client.get_job(request).await }
        };

        let mut last = String::new();
        let tell = |why: &str| {
            progress.part(why);
            if last != why {
                progress.line(&format!("{why}; asking again"));
                last = why.to_owned();
            }
        };

        match patiently_telling(ask, tell).await {
            Ok(told) => Ok(told.job.unwrap_or_default()),
            Err(error) => Err(self.failed(error).await),
        }
    }

    /// Says why nothing more can be said of the job: of one that is not known any more, what came
    /// of it.
    async fn failed(&self, error: ClientError) -> Failure {
        let is_lost =
            matches!(&error, ClientError::Refused(refusal) if refusal.reason == "JOB_NOT_FOUND");
        let (true, Some(wanted)) = (is_lost, &self.wanted) else {
            return error.into();
        };
        match all(&self.connection, &self.environment).await {
            Ok(now) => Failure::refused(lost(
                self.id,
                &self.environment,
                &wanted.kept_of(&now.models),
            )),
            Err(failure) => failure,
        }
    }

    async fn model(&self, version: u64) -> Result<proto::Model, Failure> {
        let ask = || {
            let request = proto::GetModelRequest {
                environment: self.environment.clone(),
                version,
            };
            let mut client = self.connection.models();
            async move { client.get_model(request).await }
        };
        Ok(patiently(ask).await?.model.unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Only {
        #[command(flatten)]
        train: Train,
    }

    fn request(arguments: &[&str]) -> Result<proto::TrainModelRequest, clap::Error> {
        let arguments = ["nudge", "hallway"].iter().chain(arguments);
        Only::try_parse_from(arguments).map(|only| only.train.request())
    }

    #[test]
    fn what_is_not_given_is_left_to_the_service() {
        let expected = proto::TrainModelRequest {
            environment: "hallway".into(),
            ..Default::default()
        };
        assert_eq!(request(&[]).expect("well formed"), expected);
    }

    #[test]
    fn options_are_passed_on_as_given() {
        let options = [
            "--kind",
            "direct",
            "--weighting",
            "states",
            "--width",
            "0",
            "--seed",
            "7",
            "--activate",
            "--lag",
            "-3",
        ];
        let request = request(&options).expect("well formed");
        assert_eq!(
            (request.kind(), request.weighting()),
            (proto::ModelKind::Direct, proto::Weighting::States)
        );
        assert_eq!(
            (request.width, request.seed, request.activate, request.lag),
            (Some(0), Some(7), true, -3)
        );
    }

    #[test]
    fn an_unknown_kind_is_told_with_those_there_are() {
        let told = request(&["--kind", "deep"]).expect_err("wrong").to_string();
        assert!(
            told.contains("got \"deep\", expected joint or direct"),
            "{told}"
        );
    }

    #[test]
    fn a_pipe_is_told_what_is_new() {
        let waits = |ahead, message: &str| proto::Job {
            ahead,
            message: message.into(),
            ..job_in(JobState::Queued)
        };
        let runs = |progress| proto::Job {
            progress,
            message: "learns".into(),
            ..job_in(JobState::Running)
        };
        let is_new =
            |one: proto::Job, next: proto::Job| Stage::of_job(&one) != Stage::of_job(&next);
        assert!(!is_new(waits(2, "34 % is done"), waits(2, "35 % is done")));
        assert!(is_new(waits(2, ""), waits(1, "")) && is_new(waits(1, ""), runs(0.0)));
        assert!(!is_new(runs(0.31), runs(0.39)) && is_new(runs(0.39), runs(0.4)));
    }

    #[test]
    fn a_bar_says_how_long_it_takes_once_that_is_known() {
        let runs = |seconds_left| proto::Job {
            progress: 0.25,
            message: "learns".into(),
            seconds_left,
            ..job_in(JobState::Running)
        };
        assert_eq!(part(&runs(None)), "learns");
        assert_eq!(part(&runs(Some(140.0))), "about 2 min left: learns");
        let waits = proto::Job {
            ahead: 2,
            message: "waits for job-1".into(),
            ..job_in(JobState::Queued)
        };
        assert_eq!(part(&waits), "2 ahead: waits for job-1");
    }

    fn job_in(state: JobState) -> proto::Job {
        proto::Job {
            id: 3,
            state: state.into(),
            ..Default::default()
        }
    }

    #[test]
    fn a_lost_job_is_told_with_what_was_kept_of_it() {
        let training = proto::Training {
            kind: proto::ModelKind::Joint.into(),
            seed: 7,
            ..Default::default()
        };
        let model = |version, ego: &str, seed, imported| proto::Model {
            version,
            ego: ego.into(),
            other: "human".into(),
            card: Some(proto::Card {
                training: Some(proto::Training { seed, ..training }),
                imported,
                ..Default::default()
            }),
            ..Default::default()
        };
        let before = vec![model(1, "robot", 7, false)];
        let wanted = Wanted {
            ego: "robot".into(),
            other: "human".into(),
            lag: 0,
            kind: 0,
            seed: 7,
            before: before.clone(),
        };
        let others = [
            model(2, "robot", 8, false),
            model(3, "cook", 7, false),
            model(4, "robot", 7, true),
            proto::Model {
                lag: 3,
                ..model(7, "robot", 7, false)
            },
        ];
        let unreadable = proto::Model {
            card: None,
            ..model(5, "robot", 7, false)
        };
        let strange = [before, others.to_vec(), vec![unreadable]].concat();
        assert_eq!(
            wanted.kept_of(&strange),
            [0; 0],
            "none of them is of this training"
        );
        let kept = wanted.kept_of(&[strange, vec![model(6, "robot", 7, false)]].concat());
        assert_eq!(kept, [6]);
        let direct = Wanted {
            kind: proto::ModelKind::Direct.into(),
            ..wanted
        };
        assert_eq!(direct.kept_of(&[model(6, "robot", 7, false)]), [0; 0]);
        assert!(lost(3, "lane", &kept).ends_with("was kept since: nudge model show lane 6"));
        assert!(lost(3, "lane", &[]).contains("no version that may be of it was kept"));
    }

    #[test]
    fn only_a_version_is_a_success() {
        let job = |state: JobState, version| proto::Job {
            id: 3,
            state: state.into(),
            message: "nothing was counted".into(),
            version,
            ..Default::default()
        };
        assert_eq!(part(&job(JobState::Failed, None)), "nothing was counted");
        assert_eq!(outcome(job(JobState::Done, Some(7))), Ok(7));
        let failed = Failure::refused("job-3 failed: nothing was counted");
        assert_eq!(outcome(job(JobState::Failed, None)), Err(failed));
        let cancelled = Failure::refused("job-3 was cancelled: nothing was counted");
        assert_eq!(outcome(job(JobState::Cancelled, None)), Err(cancelled));
    }
}
