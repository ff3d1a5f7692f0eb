//! `EnvironmentService`.

use tonic::{Request, Response, Status};

use super::{Face, call};
use crate::api::proto::environment_service_server::EnvironmentService;
use crate::api::proto::{
    ApplyEnvironmentRequest, ApplyEnvironmentResponse, DeleteEnvironmentRequest,
    DeleteEnvironmentResponse, Environment, GetEnvironmentRequest, GetEnvironmentResponse,
    ListEnvironmentsRequest, ListEnvironmentsResponse, UpdateEnvironmentRequest,
    UpdateEnvironmentResponse, UpdateRuleRequest, UpdateRuleResponse,
};
use crate::domain::draft::ChangeDraft;
use crate::work::beside;
use crate::{api, domain};

/// Returns an environment as it can be sent.
fn sendable(environment: &domain::Environment) -> Environment {
    let mut sendable = environment.into();
    lighten(&mut sendable);
    sendable
}

/// Leaves out a description that is larger than a message, as one may be that was made before
/// descriptions had a limit.
fn lighten(environment: &mut Environment) {
    if !api::fits_on_a_page(environment) {
        environment.schema = None;
    }
}

#[tonic::async_trait]
impl EnvironmentService for Face {
    async fn apply_environment(
        &self,
        request: Request<ApplyEnvironmentRequest>,
    ) -> Result<Response<ApplyEnvironmentResponse>, Status> {
        let face = self.asked(&request);
        call("ApplyEnvironment", async {
            let (name, description) =
                beside(move || request.into_inner().into_description()).await?;
            let (environment, created) = face.app.environments.apply(&name, description).await?;
            let environment = beside(move || sendable(&environment)).await?;
            Ok(ApplyEnvironmentResponse {
                environment: Some(environment),
                created,
            })
        })
        .await
    }

    async fn get_environment(
        &self,
        request: Request<GetEnvironmentRequest>,
    ) -> Result<Response<GetEnvironmentResponse>, Status> {
        let face = self.asked(&request);
        call("GetEnvironment", async {
            let environment = face.app.environments.find(&request.into_inner().name)?;
            Ok(GetEnvironmentResponse {
                environment: Some(beside(move || sendable(&environment)).await?),
            })
        })
        .await
    }

    async fn list_environments(
        &self,
        request: Request<ListEnvironmentsRequest>,
    ) -> Result<Response<ListEnvironmentsResponse>, Status> {
        let face = self.asked(&request);
        call("ListEnvironments", async {
            let ListEnvironmentsRequest {
                page_size,
                page_token,
            } = request.into_inner();
            let token = Some(page_token.as_str()).filter(|token| !token.is_empty());
            let page = face.app.environments.list(u64::from(page_size), token)?;
            beside(move || {
                let mut page = ListEnvironmentsResponse::from(page);
                page.environments.iter_mut().for_each(lighten);
                page
            })
            .await
        })
        .await
    }

    async fn update_environment(
        &self,
        request: Request<UpdateEnvironmentRequest>,
    ) -> Result<Response<UpdateEnvironmentResponse>, Status> {
        let face = self.asked(&request);
        call("UpdateEnvironment", async {
            let (name, change) = request.into_inner().into_change();
            let environment = face.app.environments.update(&name, &change).await?;
            Ok(UpdateEnvironmentResponse {
                environment: Some(beside(move || sendable(&environment)).await?),
            })
        })
        .await
    }

    async fn update_rule(
        &self,
        request: Request<UpdateRuleRequest>,
    ) -> Result<Response<UpdateRuleResponse>, Status> {
        let face = self.asked(&request);
        call("UpdateRule", async {
            let UpdateRuleRequest { name, rule } = request.into_inner();
            let change = ChangeDraft {
                rule: rule.map(Into::into),
                ..ChangeDraft::default()
            };
            let environment = face.app.environments.update(&name, &change).await?;
            Ok(UpdateRuleResponse {
                environment: Some(beside(move || sendable(&environment)).await?),
            })
        })
        .await
    }

    async fn delete_environment(
        &self,
        request: Request<DeleteEnvironmentRequest>,
    ) -> Result<Response<DeleteEnvironmentResponse>, Status> {
        let face = self.asked(&request);
        call("DeleteEnvironment", async {
            face.app
                .environments
                .delete(&request.into_inner().name)
                .await?;
            Ok(DeleteEnvironmentResponse {})
        })
        .await
    }
}
