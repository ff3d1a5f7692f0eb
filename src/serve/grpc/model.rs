//! `ModelService`.

use tonic::{Request, Response, Status};

use super::{Face, call};
use crate::api::proto::model_service_server::ModelService;
use crate::api::proto::{
    ActivateModelRequest, ActivateModelResponse, CancelJobRequest, CancelJobResponse,
    DeleteModelRequest, DeleteModelResponse, ExportModelRequest, ExportModelResponse,
    GetJobRequest, GetJobResponse, GetModelRequest, GetModelResponse, ImportModelRequest,
    ImportModelResponse, ListModelsRequest, ListModelsResponse, RollBackModelRequest,
    RollBackModelResponse, TrainModelRequest, TrainModelResponse,
};
use crate::api::{fitting_file, grpc};
use crate::domain::ModelId;

#[tonic::async_trait]
impl ModelService for Face {
    async fn train_model(
        &self,
        request: Request<TrainModelRequest>,
    ) -> Result<Response<TrainModelResponse>, Status> {
        let face = self.asked(&request);
        call("TrainModel", async {
            let (environment, draft) = grpc::training(request.into_inner());
            let environment = face.app.environments.find(&environment)?;
            Ok(TrainModelResponse {
                job: Some(face.app.networks.train(&environment, &draft).await?.into()),
            })
        })
        .await
    }

    async fn list_models(
        &self,
        request: Request<ListModelsRequest>,
    ) -> Result<Response<ListModelsResponse>, Status> {
        let face = self.asked(&request);
        call("ListModels", async {
            let ListModelsRequest {
                environment,
                page_size,
                page_token,
            } = request.into_inner();
            let environment = face.app.environments.find(&environment)?;
            let token = Some(page_token.as_str()).filter(|token| !token.is_empty());
            Ok(face
                .app
                .networks
                .page(&environment, u64::from(page_size), token)
                .await?
                .into())
        })
        .await
    }

    async fn get_model(
        &self,
        request: Request<GetModelRequest>,
    ) -> Result<Response<GetModelResponse>, Status> {
        let face = self.asked(&request);
        call("GetModel", async {
            let GetModelRequest {
                environment,
                version,
            } = request.into_inner();
            let environment = face.app.environments.find(&environment)?;
            Ok(GetModelResponse {
                model: Some(face.app.networks.get(&environment, version).await?.into()),
            })
        })
        .await
    }

    async fn get_job(
        &self,
        request: Request<GetJobRequest>,
    ) -> Result<Response<GetJobResponse>, Status> {
        let face = self.asked(&request);
        call("GetJob", async {
            let GetJobRequest { environment, id } = request.into_inner();
            let environment = face.app.environments.find(&environment)?;
            Ok(GetJobResponse {
                job: Some(face.app.networks.job(&environment, id)?.into()),
            })
        })
        .await
    }

    async fn activate_model(
        &self,
        request: Request<ActivateModelRequest>,
    ) -> Result<Response<ActivateModelResponse>, Status> {
        let face = self.asked(&request);
        call("ActivateModel", async {
            let ActivateModelRequest {
                environment,
                version,
            } = request.into_inner();
            let environment = face.app.environments.find(&environment)?;
            Ok(ActivateModelResponse {
                model: Some(
                    face.app
                        .networks
                        .activate(&environment, version)
                        .await?
                        .into(),
                ),
            })
        })
        .await
    }

    async fn roll_back_model(
        &self,
        request: Request<RollBackModelRequest>,
    ) -> Result<Response<RollBackModelResponse>, Status> {
        let face = self.asked(&request);
        call("RollBackModel", async {
            let RollBackModelRequest {
                environment,
                version,
            } = request.into_inner();
            let environment = face.app.environments.find(&environment)?;
            let active = face.app.networks.roll_back(&environment, version).await?;
            Ok(RollBackModelResponse {
                active: active.map(Into::into),
            })
        })
        .await
    }

    async fn delete_model(
        &self,
        request: Request<DeleteModelRequest>,
    ) -> Result<Response<DeleteModelResponse>, Status> {
        let face = self.asked(&request);
        call("DeleteModel", async {
            let DeleteModelRequest {
                environment,
                version,
            } = request.into_inner();
            let environment = face.app.environments.find(&environment)?;
            face.app
                .networks
                .delete(&environment, ModelId::Version(version))
                .await?;
            Ok(DeleteModelResponse {})
        })
        .await
    }

    async fn cancel_job(
        &self,
        request: Request<CancelJobRequest>,
    ) -> Result<Response<CancelJobResponse>, Status> {
        let face = self.asked(&request);
        call("CancelJob", async {
            let CancelJobRequest { environment, id } = request.into_inner();
            let environment = face.app.environments.find(&environment)?;
            face.app
                .networks
                .delete(&environment, ModelId::Job(id))
                .await?;
            Ok(CancelJobResponse {})
        })
        .await
    }

    async fn export_model(
        &self,
        request: Request<ExportModelRequest>,
    ) -> Result<Response<ExportModelResponse>, Status> {
        let face = self.asked(&request);
        call("ExportModel", async {
            let ExportModelRequest {
                environment,
                version,
            } = request.into_inner();
            let found = face.app.environments.find(&environment)?;
            let file = face.app.networks.export(&found, version).await?;
            let instead = format!("GET /v1/environments/{environment}/models/{version}/weights");
            fitting_file(ExportModelResponse { file }, &instead)
        })
        .await
    }

    async fn import_model(
        &self,
        request: Request<ImportModelRequest>,
    ) -> Result<Response<ImportModelResponse>, Status> {
        let face = self.asked(&request);
        call("ImportModel", async {
            let request = request.into_inner();
            let environment = face.app.environments.find(&request.environment)?;
            let instead = format!(
                "POST /v1/environments/{}/models/import",
                request.environment
            );
            let ImportModelRequest { file, .. } = fitting_file(request, &instead)?;
            Ok(ImportModelResponse {
                model: Some(face.app.networks.import(&environment, file).await?.into()),
            })
        })
        .await
    }
}
