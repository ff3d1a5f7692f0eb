//! `inference.GRPCInferenceService`: the Open Inference Protocol.

use tonic::{Request, Response, Status};

use super::{Face, call};
use crate::api::inference::grpc;
use crate::api::inference_proto::grpc_inference_service_server::GrpcInferenceService;
use crate::api::inference_proto::{
    ModelInferRequest, ModelInferResponse, ModelMetadataRequest, ModelMetadataResponse,
    ModelReadyRequest, ModelReadyResponse, ServerLiveRequest, ServerLiveResponse,
    ServerMetadataRequest, ServerMetadataResponse, ServerReadyRequest, ServerReadyResponse,
};
use crate::serve::inference::served::{self, ModelName, Served};
use crate::serve::operations;

#[tonic::async_trait]
impl GrpcInferenceService for Face {
    async fn server_live(
        &self,
        _: Request<ServerLiveRequest>,
    ) -> Result<Response<ServerLiveResponse>, Status> {
        call("ServerLive", async {
            Ok(ServerLiveResponse { live: true })
        })
        .await
    }

    async fn server_ready(
        &self,
        _: Request<ServerReadyRequest>,
    ) -> Result<Response<ServerReadyResponse>, Status> {
        call("ServerReady", async {
            Ok(ServerReadyResponse {
                ready: operations::ready(&self.app).await.is_ok(),
            })
        })
        .await
    }

    async fn model_ready(
        &self,
        request: Request<ModelReadyRequest>,
    ) -> Result<Response<ModelReadyResponse>, Status> {
        let face = self.asked(&request);
        call("ModelReady", async {
            let ModelReadyRequest { name, version } = request.into_inner();
            let name = ModelName {
                model: &name,
                version: &version,
            };
            let ready = served::is_known(&face.app, name).await?
                && operations::ready(&face.app).await.is_ok();
            Ok(ModelReadyResponse { ready })
        })
        .await
    }

    async fn server_metadata(
        &self,
        _: Request<ServerMetadataRequest>,
    ) -> Result<Response<ServerMetadataResponse>, Status> {
        call("ServerMetadata", async { Ok(grpc::server()) }).await
    }

    async fn model_metadata(
        &self,
        request: Request<ModelMetadataRequest>,
    ) -> Result<Response<ModelMetadataResponse>, Status> {
        let face = self.asked(&request);
        call("ModelMetadata", async {
            let ModelMetadataRequest { name, version } = request.into_inner();
            let served = Served::find(
                &face.app,
                ModelName {
                    model: &name,
                    version: &version,
                },
            )
            .await?;
            Ok(served.metadata(&face.app).await?.into())
        })
        .await
    }

    async fn model_infer(
        &self,
        request: Request<ModelInferRequest>,
    ) -> Result<Response<ModelInferResponse>, Status> {
        let face = self.asked(&request);
        call("ModelInfer", async {
            let mut message = request.into_inner();
            let (model, version) = (
                std::mem::take(&mut message.model_name),
                std::mem::take(&mut message.model_version),
            );
            let request = grpc::request(message)?;
            Ok(served::infer(
                &face.app,
                ModelName {
                    model: &model,
                    version: &version,
                },
                request,
            )
            .await?
            .into())
        })
        .await
    }
}
