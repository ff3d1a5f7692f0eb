//! `InfluenceService`.

use tonic::{Request, Response, Status};

use super::{Face, call};
use crate::api::proto::influence_service_server::InfluenceService;
use crate::api::proto::{
    BatchGetInfluenceRequest, BatchGetInfluenceResponse, ExploreRequest, ExploreResponse,
    FindRegionsRequest, FindRegionsResponse, FitPriorRequest, FitPriorResponse, GetGraphRequest,
    GetGraphResponse, GetInfluenceRequest, GetInfluenceResponse, GetProfileRequest,
    GetProfileResponse, GetStateRequest, GetStateResponse, ListStatesRequest, ListStatesResponse,
    SummarizeRequest, SummarizeResponse,
};
use crate::api::{fitting, grpc};
use crate::domain::draft::QuestionDraft;
use crate::domain::{Answers, Asked, ProfileQuestion, RegionAnswers, RegionSearchQuestion, View};
use crate::error::Problem;
use crate::serve::costs::STATE_BYTES;
use crate::work::aside;

impl Face {
    /// Answers by states or by regions, in the response of that call.
    async fn answer<T: From<Answers> + From<RegionAnswers>>(
        &self,
        environment: &str,
        draft: QuestionDraft,
    ) -> Result<(T, View), Problem> {
        let environment = self.app.environments.find(environment)?;
        let asked = environment.clone();
        let asked = aside(draft.states.len() * STATE_BYTES, move || {
            Asked::new(&asked, &draft)
        })
        .await??;

        let (view, influence) = (asked.view(), &self.app.influence);
        let response = match asked {
            Asked::States(question) => influence.answer(&environment, question).await?.into(),
            Asked::Regions(question) => influence
                .answer_regions(&environment, question)
                .await?
                .into(),
        };
        Ok((response, view))
    }
}

#[tonic::async_trait]
impl InfluenceService for Face {
    async fn get_influence(
        &self,
        request: Request<GetInfluenceRequest>,
    ) -> Result<Response<GetInfluenceResponse>, Status> {
        let face = self.asked(&request);
        call("GetInfluence", async {
            let (environment, draft) = grpc::question(request.into_inner())?;
            let (answer, view) = face.answer(&environment, draft).await?;
            fitting(answer, view)
        })
        .await
    }

    async fn batch_get_influence(
        &self,
        request: Request<BatchGetInfluenceRequest>,
    ) -> Result<Response<BatchGetInfluenceResponse>, Status> {
        let face = self.asked(&request);
        call("BatchGetInfluence", async {
            let (environment, draft) = grpc::batch_question(request.into_inner())?;
            let (answers, view): (BatchGetInfluenceResponse, _) =
                face.answer(&environment, draft).await?;
            aside(answers.answers.len() * STATE_BYTES, move || {
                fitting(answers, view)
            })
            .await?
        })
        .await
    }

    async fn get_state(
        &self,
        request: Request<GetStateRequest>,
    ) -> Result<Response<GetStateResponse>, Status> {
        let face = self.asked(&request);
        call("GetState", async {
            let GetStateRequest { environment, key } = request.into_inner();
            let environment = face.app.environments.find(&environment)?;
            let view = face.app.influence.state_view(&environment, &key).await?;
            aside(view.cells.len() * STATE_BYTES, move || {
                fitting(view.into(), View::Full)
            })
            .await?
        })
        .await
    }

    async fn list_states(
        &self,
        request: Request<ListStatesRequest>,
    ) -> Result<Response<ListStatesResponse>, Status> {
        let face = self.asked(&request);
        call("ListStates", async {
            let (environment, listing) = grpc::list_states(request.into_inner())?;
            let environment = face.app.environments.find(&environment)?;
            let page = face.app.influence.states(&environment, &listing).await?;
            aside(page.states.len() * STATE_BYTES, move || {
                fitting(page.into(), View::Verdict)
            })
            .await?
        })
        .await
    }

    async fn summarize(
        &self,
        request: Request<SummarizeRequest>,
    ) -> Result<Response<SummarizeResponse>, Status> {
        let face = self.asked(&request);
        call("Summarize", async {
            let (environment, draft) = grpc::summary(request.into_inner())?;
            let environment = face.app.environments.find(&environment)?;
            Ok(face
                .app
                .influence
                .summary(&environment, &draft)
                .await?
                .into())
        })
        .await
    }

    async fn get_profile(
        &self,
        request: Request<GetProfileRequest>,
    ) -> Result<Response<GetProfileResponse>, Status> {
        let face = self.asked(&request);
        call("GetProfile", async {
            let (environment, draft) = grpc::profile(request.into_inner())?;
            let environment = face.app.environments.find(&environment)?;
            let question = ProfileQuestion::new(&environment, &draft)?;
            Ok(face
                .app
                .influence
                .profile(&environment, question)
                .await?
                .into())
        })
        .await
    }

    async fn find_regions(
        &self,
        request: Request<FindRegionsRequest>,
    ) -> Result<Response<FindRegionsResponse>, Status> {
        let face = self.asked(&request);
        call("FindRegions", async {
            let (environment, draft) = grpc::region_search(request.into_inner())?;
            let environment = face.app.environments.find(&environment)?;
            let question = RegionSearchQuestion::new(&environment, &draft)?;
            Ok(face
                .app
                .influence
                .regions(&environment, question)
                .await?
                .into())
        })
        .await
    }

    async fn get_graph(
        &self,
        request: Request<GetGraphRequest>,
    ) -> Result<Response<GetGraphResponse>, Status> {
        let face = self.asked(&request);
        call("GetGraph", async {
            let (environment, draft) = grpc::graph(request.into_inner())?;
            let environment = face.app.environments.find(&environment)?;
            let graph = face.app.influence.graph(&environment, &draft).await?;
            aside(graph.edges.len() * STATE_BYTES, move || {
                fitting(graph.into(), View::Figures)
            })
            .await?
        })
        .await
    }

    async fn explore(
        &self,
        request: Request<ExploreRequest>,
    ) -> Result<Response<ExploreResponse>, Status> {
        let face = self.asked(&request);
        call("Explore", async {
            let (environment, draft) = grpc::exploration(request.into_inner())?;
            let environment = face.app.environments.find(&environment)?;
            let exploration = face.app.influence.explore(&environment, &draft).await?;
            aside(exploration.trials.len() * STATE_BYTES, move || {
                fitting(exploration.into(), View::Verdict)
            })
            .await?
        })
        .await
    }

    async fn fit_prior(
        &self,
        request: Request<FitPriorRequest>,
    ) -> Result<Response<FitPriorResponse>, Status> {
        let face = self.asked(&request);
        call("FitPrior", async {
            let (environment, pair) = grpc::fit(request.into_inner());
            let environment = face.app.environments.find(&environment)?;
            Ok(face
                .app
                .influence
                .fit(&environment, pair.as_ref())
                .await?
                .into())
        })
        .await
    }
}
