//! `nudge model`: networks of a service.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::asking::asked;
use super::output::{cannot_read, cannot_write, count, print, print_json, to_json};
use super::server::Server;
use super::{Failure, card};
use crate::api::{json as dto, proto};
use crate::client::Connection;
use crate::domain::ModelId;

/// List, show, switch, move and delete trained networks
#[derive(Debug, Subcommand)]
#[command(
    long_about = "List, show, switch, move and delete trained networks.\n\n\
    A training makes a version. The active version of a pair of agents answers where counts do not decide.\n\n\
    Example:\n  nudge model list hallway\n  nudge model activate hallway 3"
)]
pub(super) enum Model {
    /// List versions and trainings
    #[command(
        long_about = "List every version, and the trainings that were asked for since the service started.\n\n\
        Example:\n  nudge model list hallway --json"
    )]
    List(List),
    /// Show what a version says of itself, or how far a training is
    #[command(
        long_about = "Show what a version says of itself beside every baseline, or how far a training is.\n\n\
        Example:\n  nudge model show hallway 3\n  nudge model show hallway job-2"
    )]
    Show(Show),
    /// Make a version the one that answers
    #[command(
        long_about = "Make a version the one that answers for its pair of agents, whether it beats its baselines or not.\n\n\
        Example:\n  nudge model activate hallway 3"
    )]
    Activate(Version),
    /// Take a version back
    #[command(
        long_about = "Take a version back: the one of its pair that was active before answers again, or none.\n\n\
        Example:\n  nudge model rollback hallway 3"
    )]
    Rollback(Version),
    /// Delete a version that is not active, or end a training
    #[command(
        long_about = "Delete a version that is not active, for ever, or end a training.\n\n\
        Example:\n  nudge model delete hallway 2\n  nudge model delete hallway job-2"
    )]
    Delete(Delete),
    /// Write a version to a file
    #[command(
        long_about = "Write a version to a safetensors file: its weights in PyTorch's layout, with what it says of itself.\n\n\
        Example:\n  nudge model export hallway 3 --out hallway.safetensors"
    )]
    Export(Export),
    /// Keep a network that was trained elsewhere
    #[command(
        long_about = "Keep a network that was trained elsewhere: a safetensors file as `nudge model export` writes it. It says of every \
        state what it said there, is judged by the counts of this environment, and not made active. A file of another tool is calibrated here.\n\n\
        Example:\n  nudge model import hallway hallway.safetensors"
    )]
    Import(Import),
}

#[derive(Debug, Args)]
pub(super) struct List {
    /// Name of the environment
    environment: String,
    /// Print JSON, as REST answers it
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

#[derive(Debug, Args)]
pub(super) struct Show {
    /// Name of the environment
    environment: String,
    /// Number of a version, or a job such as job-2
    #[arg(value_name = "VERSION|JOB")]
    model: ModelId,
    /// Print JSON, as REST answers it
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

#[derive(Debug, Args)]
pub(super) struct Version {
    /// Name of the environment
    environment: String,
    /// Number of the version
    version: u64,
    /// Print JSON, as REST answers it
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

#[derive(Debug, Args)]
pub(super) struct Delete {
    /// Name of the environment
    environment: String,
    /// Number of a version, or a job such as job-2
    #[arg(value_name = "VERSION|JOB")]
    model: ModelId,
    #[command(flatten)]
    server: Server,
}

#[derive(Debug, Args)]
pub(super) struct Export {
    /// Name of the environment
    environment: String,
    /// Number of the version
    version: u64,
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    server: Server,
}

#[derive(Debug, Args)]
pub(super) struct Import {
    /// Name of the environment
    environment: String,
    /// File to read
    file: PathBuf,
    /// Print JSON, as REST answers it
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

impl Model {
    pub(super) async fn run(self) -> Result<(), Failure> {
        match self {
            Self::List(command) => command.run().await,
            Self::Show(command) => command.run().await,
            Self::Activate(command) => command.activate().await,
            Self::Rollback(command) => command.roll_back().await,
            Self::Delete(command) => command.run().await,
            Self::Export(command) => command.run().await,
            Self::Import(command) => command.run().await,
        }
    }
}

impl List {
    async fn run(self) -> Result<(), Failure> {
        let Self {
            environment,
            json,
            server,
        } = self;

        let response = all(&server.connect().await?, &environment).await?;
        if json {
            let mut told = to_json(dto::Models::from(response));
            // It is all of them.
            told.as_object_mut()
                .map(|page| page.remove("next_page_token"));
            return print_json(&told);
        }

        print(&card::list(&environment, &response))
    }
}

/// Returns every version and every job, as one page.
pub(super) async fn all(
    connection: &Connection,
    environment: &str,
) -> Result<proto::ListModelsResponse, Failure> {
    let mut all = proto::ListModelsResponse::default();
    loop {
        let page_token = std::mem::take(&mut all.next_page_token);
        let request = proto::ListModelsRequest {
            environment: environment.to_owned(),
            page_size: 0,
            page_token,
        };
        let ask = || {
            let (mut client, request) = (connection.models(), request.clone());
            async move { client.list_models(request).await }
        };
        let page = asked(ask).await?;
        all.models.extend(page.models);
        all.jobs.extend(page.jobs);
        all.next_page_token = page.next_page_token;
        if all.next_page_token.is_empty() {
            return Ok(all);
        }
    }
}

impl Show {
    async fn run(self) -> Result<(), Failure> {
        match self.model {
            ModelId::Version(version) => self.version(version).await,
            ModelId::Job(id) => self.job(id).await,
        }
    }

    async fn version(self, version: u64) -> Result<(), Failure> {
        let Self {
            environment,
            json,
            server,
            ..
        } = self;

        let request = proto::GetModelRequest {
            environment: environment.clone(),
            version,
        };
        let connection = server.connect().await?;
        let ask = || {
            let (mut client, request) = (connection.models(), request.clone());
            async move { client.get_model(request).await }
        };
        let response = asked(ask).await?;
        shown(&environment, response.model.unwrap_or_default(), json)
    }

    async fn job(self, id: u64) -> Result<(), Failure> {
        let request = proto::GetJobRequest {
            environment: self.environment,
            id,
        };
        let connection = self.server.connect().await?;
        let ask = || {
            let (mut client, request) = (connection.models(), request.clone());
            async move { client.get_job(request).await }
        };
        let response = asked(ask).await?;
        let job = response.job.unwrap_or_default();
        if self.json {
            return print_json(&to_json(dto::Job::from(job)));
        }

        print(&card::job_line(&job))
    }
}

impl Version {
    async fn activate(self) -> Result<(), Failure> {
        let Self {
            environment,
            version,
            json,
            server,
        } = self;

        let request = proto::ActivateModelRequest {
            environment: environment.clone(),
            version,
        };
        let response = server
            .connect()
            .await?
            .models()
            .activate_model(request)
            .await?
            .into_inner();
        let model = response.model.unwrap_or_default();
        if json {
            return print_json(&to_json(dto::Model::from(model)));
        }

        print(&answers_now(&environment, &model))
    }

    async fn roll_back(self) -> Result<(), Failure> {
        let Self {
            environment,
            version,
            json,
            server,
        } = self;

        let request = proto::RollBackModelRequest {
            environment: environment.clone(),
            version,
        };
        let response = server
            .connect()
            .await?
            .models()
            .roll_back_model(request)
            .await?
            .into_inner();

        if json {
            return print_json(&to_json(dto::RolledBack::from(response)));
        }

        let now = match &response.active {
            Some(model) => answers_now(&environment, model),
            None => "no version answers for its pair now".into(),
        };

        print(&format!(
            "version {version} of `{environment}` is taken back; {now}"
        ))
    }
}

impl Delete {
    async fn run(self) -> Result<(), Failure> {
        let Self {
            environment,
            model,
            server,
        } = self;
        let mut client = server.connect().await?.models();
        match model {
            ModelId::Version(version) => {
                client
                    .delete_model(proto::DeleteModelRequest {
                        environment: environment.clone(),
                        version,
                    })
                    .await?;
                print(&format!("version {version} of `{environment}` deleted"))
            }
            ModelId::Job(id) => {
                client
                    .cancel_job(proto::CancelJobRequest {
                        environment: environment.clone(),
                        id,
                    })
                    .await?;
                print(&format!("{model} of `{environment}` cancelled"))
            }
        }
    }
}

impl Export {
    async fn run(self) -> Result<(), Failure> {
        let Self {
            environment,
            version,
            out,
            server,
        } = self;

        let request = proto::ExportModelRequest {
            environment: environment.clone(),
            version,
        };
        let connection = server.connect().await?;
        let ask = || {
            let (mut client, request) = (connection.models(), request.clone());
            async move { client.export_model(request).await }
        };
        let file = asked(ask).await?.file;
        std::fs::write(&out, &file).map_err(|error| cannot_write(&out, &error))?;
        let (bytes, out) = (count(file.len() as u64), out.display());

        print(&format!(
            "version {version} of `{environment}`: {bytes} bytes in {out}"
        ))
    }
}

impl Import {
    async fn run(self) -> Result<(), Failure> {
        let Self {
            environment,
            file,
            json,
            server,
        } = self;

        // Read first, so that a wrong name is told whether a service is there or not.
        let bytes = std::fs::read(&file).map_err(|error| cannot_read(&file, &error))?;
        let request = proto::ImportModelRequest {
            environment: environment.clone(),
            file: bytes,
        };
        let response = server
            .connect()
            .await?
            .models()
            .import_model(request)
            .await?
            .into_inner();

        shown(&environment, response.model.unwrap_or_default(), json)
    }
}

/// Prints what a version says of itself.
pub(super) fn shown(environment: &str, model: proto::Model, json: bool) -> Result<(), Failure> {
    if json {
        return print_json(&to_json(dto::Model::from(model)));
    }
    print(&card::render(environment, &model))
}

fn answers_now(environment: &str, model: &proto::Model) -> String {
    let proto::Model {
        version,
        ego,
        other,
        lag,
        ..
    } = model;
    let other = card::later(other, *lag);
    format!("version {version} of `{environment}` answers for {ego} on {other} now")
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Only {
        #[command(subcommand)]
        model: Model,
    }

    fn parsed(arguments: &[&str]) -> Result<Model, clap::Error> {
        Only::try_parse_from(["nudge"].iter().chain(arguments)).map(|only| only.model)
    }

    #[test]
    fn versions_and_jobs_are_told_apart() {
        let Ok(Model::Show(show)) = parsed(&["show", "hallway", "job-2"]) else {
            panic!("well formed")
        };
        assert_eq!(show.model, ModelId::Job(2));
        let Ok(Model::Delete(delete)) = parsed(&["delete", "hallway", "2"]) else {
            panic!("well formed")
        };
        assert_eq!(delete.model, ModelId::Version(2));
    }

    #[test]
    fn a_typo_is_told_with_what_was_expected() {
        let told = parsed(&["show", "hallway", "three"])
            .expect_err("wrong")
            .to_string();
        assert!(
            told.contains("got \"three\", expected the number of a version, or job-"),
            "{told}"
        );
        assert!(parsed(&["activate", "hallway", "job-2"]).is_err());
        assert!(
            parsed(&["export", "hallway", "2"]).is_err(),
            "a file is needed"
        );
    }
}
