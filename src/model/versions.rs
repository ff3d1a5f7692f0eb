//! The registry's door: versions are listed, made active, rolled back, exported and deleted, and
//! the jobs beside them.

use tracing::instrument;

use super::Networks;
use crate::domain::{Environment, Job, Model, ModelId, Models, page_size};
use crate::error::{Fault, Problem};

impl Networks {
    /// Returns every version, and the jobs asked for since the service started.
    pub async fn list(&self, environment: &Environment) -> Result<Models, Problem> {
        let (models, jobs) = (
            self.registry.list(environment).await?,
            self.jobs.of_environment(environment.id),
        );

        Ok(Models {
            models,
            jobs,
            next_page_token: None,
        })
    }

    /// Returns a page of versions, with the jobs on the first; a size of 0 takes the largest.
    pub async fn page(
        &self,
        environment: &Environment,
        asked: u64,
        page_token: Option<&str>,
    ) -> Result<Models, Problem> {
        let size = page_size(if asked == 0 { 1_000 } else { asked })?;
        let after = page_token.map(place).transpose()?;
        let page = self
            .registry
            .page(environment, after.unwrap_or(0), size)
            .await?;

        let last = page
            .items
            .last()
            .filter(|_| page.has_more)
            .map(|model| model.version.to_string());

        let jobs = if after.is_none() {
            self.jobs.of_environment(environment.id)
        } else {
            Vec::new()
        };

        Ok(Models {
            models: page.items,
            jobs,
            next_page_token: last,
        })
    }

    /// Returns one version.
    pub async fn get(&self, environment: &Environment, version: u64) -> Result<Model, Problem> {
        self.registry.get(environment, version).await
    }

    /// Returns a job.
    pub fn job(&self, environment: &Environment, id: u64) -> Result<Job, Problem> {
        self.jobs.get(environment.id, id)
    }

    /// Returns a job once it is over.
    pub async fn finished(&self, environment: &Environment, id: u64) -> Result<Job, Problem> {
        self.jobs.finished(environment.id, id).await
    }

    /// Makes a version the one that answers for its pair. Refused where it cannot answer by the
    /// environment's rule.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn activate(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Model, Problem> {
        let model = self.registry.activate(environment, version).await?;
        tracing::info!(environment = %environment.name, version, "a network was made active");
        Ok(model)
    }

    /// Takes a version back: the one that was active before answers again, or none. Returns that
    /// one.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn roll_back(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Option<Model>, Problem> {
        let instead = self.registry.roll_back(environment, version).await?;

        let active = instead.as_ref().map(|model| model.version);
        tracing::info!(environment = %environment.name, version, active, "a network was taken back");
        Ok(instead)
    }

    /// Removes a version that is not active, or ends a job.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn delete(&self, environment: &Environment, id: ModelId) -> Result<(), Problem> {
        match id {
            ModelId::Version(version) => {
                self.registry.delete(environment, version).await?;
                tracing::info!(environment = %environment.name, version, "a network was deleted");
            }
            ModelId::Job(job) => {
                self.jobs.end(environment.id, job)?;
                tracing::info!(environment = %environment.name, job, "a training was told to end");
            }
        }
        Ok(())
    }

    /// Returns a version as a safetensors file: its weights in PyTorch's layout, with its card.
    pub async fn export(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Vec<u8>, Problem> {
        self.registry.export(environment, version).await
    }

    /// Says in the log which versions cannot be read, and why.
    pub async fn tell_unreadable(&self) {
        for environment in self.store.environments() {
            // Listing looks at each version, and tells.
            if let Err(problem) = self.registry.list(&environment).await {
                tracing::warn!(%problem, environment = %environment.name, "the networks could not be looked at");
            }
        }
    }
}

/// Reads a page's token: the version that it comes after.
fn place(token: &str) -> Result<u64, Problem> {
    let version = token
        .parse()
        .ok()
        .filter(|version: &u64| version.to_string() == token);
    let fault = || {
        Fault::new(
            "/page_token",
            format!("got {token:?}, expected the `next_page_token` of a page"),
        )
    };

    version.ok_or_else(|| Problem::invalid("page", vec![fault()]))
}
