//! Influence (mutual information) in states, or over all states of a region.

use axum::response::Response;

use super::extract::{self, Json, Path, Plain, Query};
use super::json_answer::json_answer;
use super::parameters::{
    FigureParameters, PairParameters, PolicyParameters, RegionParameters, RuleParameters,
    SegmentParameters, StateParameters,
};
use super::refusals::Refusals;
use crate::api::{fitting, json, proto};
use crate::app::App;
use crate::domain::Asked;
use crate::domain::draft::QuestionDraft;
use crate::serve::costs::STATE_BYTES;
use crate::serve::status::Failure;
use crate::work::aside;

type Answered = Result<Response, Failure>;

/// Returns the answers for up to 10,000 states, or for up to 1,000 regions, in order.
///
/// A region's states are asked about as one (pooled evidence): actions are compared within strata, and
/// what each state has too few visits to tell, all of them together may. Where that takes longer than
/// its caller waits, 503 tells how far it is; it goes on, so that whoever asks again finds it further
/// on.
///
/// A state that is not valid fails the call, and every fault is listed by pointer
/// (`/states/17/distance`); a valid state that was never seen is an answer with 0 visits.
#[utoipa::path(
    post,
    path = "/v1/environments/{environment}/influence",
    tag = "influence",
    params(("environment" = String, Path, description = "The environment's name")),
    request_body = json::Question,
    responses((status = 200, description = "The answers", body = json::Answers), Refusals)
)]
pub async fn batch_get_influence(
    Plain(app): Plain,
    Path(name): Path<String>,
    Json(question): Json<json::Question>,
) -> Answered {
    answer(&app, &name, question.try_into()?).await
}

/// Returns the answer for one state, or for one region, for a command line and for people.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/influence",
    tag = "influence",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        PairParameters,
        SegmentParameters,
        PolicyParameters,
        RuleParameters,
        StateParameters,
        RegionParameters,
        FigureParameters,
    ),
    responses((status = 200, description = "The answer, as a list of one", body = json::Answers), Refusals)
)]
pub async fn get_influence(
    extract::Asked(app): extract::Asked,
    Path(name): Path<String>,
    Query(query): Query,
) -> Answered {
    answer(&app, &name, json::question_of_query(query)?).await
}

async fn answer(app: &App, name: &str, draft: QuestionDraft) -> Answered {
    let environment = app.environments.find(name)?;
    let asked = environment.clone();
    let asked = aside(draft.states.len() * STATE_BYTES, move || {
        Asked::new(&asked, &draft)
    })
    .await??;
    let (view, influence) = (asked.view(), &app.influence);
    let response = match asked {
        Asked::States(question) => influence.answer(&environment, question).await?.into(),
        Asked::Regions(question) => {
            let answers = influence.answer_regions(&environment, question);
            proto::BatchGetInfluenceResponse::from(answers.await?)
        }
    };

    json_answer(response.answers.len() * STATE_BYTES, move || {
        fitting(response, view).map(json::Answers::from)
    })
    .await
}
