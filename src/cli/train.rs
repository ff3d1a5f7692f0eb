//! `nudge train`: a network for a pair of agents, trained by the service and judged beside its baselines.

use std::time::Duration;

use clap::Args;

use super::model::shown;
use super::progress::Progress;
use super::serve::Signals;
use super::server::Server;
use super::{Failure, card};
use crate::api::proto::{self, JobState};
use crate::client::{Connection, patiently};
use crate::domain::{ModelId, ModelKind, Weighting};

/// How often the service is asked how far it is.
const EVERY: Duration = Duration::from_millis(200);

/// Train a network that answers where counts do not decide
#[derive(Debug, Args)]
#[command(
    long_about = "Train a network that answers where counts do not decide, and show how it did on states that it did not learn from.\n\n\
    The service trains it from the counts. It is made active by itself where it beats every baseline, and with --activate anyway. Ctrl-C ends the \
    training.\n\n\
    Example:\n  nudge train hallway\n  \
    nudge train hallway --ego robot --other human --kind direct --members 5 --seed 7\n  \
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
    /// What is predicted: joint (what both agents do) or direct (whether mutual information is above the threshold); joint unless given
    #[arg(long, value_name = "KIND")]
    kind: Option<ModelKind>,
    /// Units of the hidden layer; 64 unless given
    #[arg(long, value_name = "NUMBER")]
    width: Option<u64>,
    /// Networks that are trained and averaged; 3 unless given
    #[arg(long, value_name = "NUMBER")]
    members: Option<u64>,
    /// Parts that the states are cut into; each member is stopped and judged by one that it does not learn from; 5 unless given
    #[arg(long, value_name = "NUMBER")]
    folds: Option<u64>,
    /// The most passes over the states; 140 unless given
    #[arg(long, value_name = "NUMBER")]
    epochs: Option<u64>,
    /// How much a state counts: visits (as often as it was seen) or states (once); visits unless given
    #[arg(long, value_name = "WEIGHTING")]
    weighting: Option<Weighting>,
    /// Where all randomness comes from; 0 unless given
    #[arg(long, value_name = "NUMBER")]
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

impl Train {
    pub(super) async fn run(self) -> Result<(), Failure> {
        let connection = self.server.connect().await?;
        let signals = Signals::install()?;
        let response = connection.models().train_model(self.request()).await?.into_inner();
        let job = Watched { connection, environment: self.environment, id: response.job.unwrap_or_default().id };
        let version = outcome(job.end(&signals).await?)?;
        shown(&job.environment, job.model(version).await?, self.json)
    }

    fn request(&self) -> proto::TrainModelRequest {
        proto::TrainModelRequest {
            environment: self.environment.clone(),
            ego: self.ego.clone().unwrap_or_default(),
            other: self.other.clone().unwrap_or_default(),
            kind: self.kind.map_or(proto::ModelKind::Unspecified, Into::into).into(),
            width: self.width,
            members: self.members,
            folds: self.folds,
            epochs: self.epochs,
            weighting: self.weighting.map_or(proto::Weighting::Unspecified, Into::into).into(),
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
        (JobState::Cancelled, _) => Err(Failure::refused(format!("{name} was cancelled: {}", job.message))),
        _ => Err(Failure::refused(format!("{name} failed: {}", job.message))),
    }
}

/// A training that is waited for.
struct Watched {
    connection: Connection,
    environment: String,
    id: u64,
}

impl Watched {
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

    async fn over(&self, progress: &Progress) -> Result<proto::Job, Failure> {
        let mut told = String::new();
        loop {
            let job = self.job().await?;
            let line = card::job_line(&job);
            progress.part(&job.message);
            progress.at_share(job.progress);
            if told != line {
                progress.line(&line);
                told = line;
            }
            match job.state() {
                JobState::Queued | JobState::Running => tokio::time::sleep(EVERY).await,
                _ => return Ok(job),
            }
        }
    }

    /// Ends the training; another signal says not to wait for that.
    async fn cancel(&self, signals: &Signals) -> Failure {
        let name = ModelId::Job(self.id);
        let request = proto::CancelJobRequest { environment: self.environment.clone(), id: self.id };
        let mut client = self.connection.models();
        tokio::select! {
            answer = client.cancel_job(request) => match answer {
                Ok(_) => Failure::interrupted(format!("{name} of `{}` cancelled", self.environment)),
                Err(status) => status.into(),
            },
            () = signals.next() => Failure::interrupted(format!("{name} of `{}` may go on", self.environment)),
        }
    }

    async fn job(&self) -> Result<proto::Job, Failure> {
        let ask = || {
            let request = proto::GetJobRequest { environment: self.environment.clone(), id: self.id };
            let mut client = self.connection.models();
            async move { client.get_job(request).await }
        };
        Ok(patiently(ask).await?.job.unwrap_or_default())
    }

    async fn model(&self, version: u64) -> Result<proto::Model, Failure> {
        let ask = || {
            let request = proto::GetModelRequest { environment: self.environment.clone(), version };
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
        let expected = proto::TrainModelRequest { environment: "hallway".into(), ..Default::default() };
        assert_eq!(request(&[]).expect("well formed"), expected);
    }

    #[test]
    fn options_are_passed_on_as_given() {
        let options = ["--kind", "direct", "--weighting", "states", "--width", "0", "--seed", "7", "--activate"];
        let request = request(&options).expect("well formed");
        assert_eq!((request.kind(), request.weighting()), (proto::ModelKind::Direct, proto::Weighting::States));
        assert_eq!((request.width, request.seed, request.activate), (Some(0), Some(7), true));
    }

    #[test]
    fn an_unknown_kind_is_told_with_those_there_are() {
        let told = request(&["--kind", "deep"]).expect_err("wrong").to_string();
        assert!(told.contains("got \"deep\", expected joint or direct"), "{told}");
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
        assert_eq!(outcome(job(JobState::Done, Some(7))), Ok(7));
        let failed = Failure::refused("job-3 failed: nothing was counted");
        assert_eq!(outcome(job(JobState::Failed, None)), Err(failed));
        let cancelled = Failure::refused("job-3 was cancelled: nothing was counted");
        assert_eq!(outcome(job(JobState::Cancelled, None)), Err(cancelled));
    }
}
