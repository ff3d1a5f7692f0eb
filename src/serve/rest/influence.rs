//! Influence (mutual information) in one state or several.

use axum::response::Response;

use super::extract::{Asked, Json, Path, Plain, Query};
use super::json_answer::json_answer;
use super::parameters::{
    FigureParameters, PairParameters, RuleParameters, SegmentParameters, StateParameters,
};
use super::refusals::Refusals;
use crate::api::{fitting, json, proto};
use crate::app::App;
use crate::domain::Question;
use crate::domain::draft::QuestionDraft;
use crate::serve::costs::STATE_BYTES;
use crate::serve::status::Failure;
use crate::work::aside;

type Answered = Result<Response, Failure>;

/// Returns the answers for up to 10,000 states, in order.
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

/// Returns the answer for one state, for a command line and for people.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/influence",
    tag = "influence",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        PairParameters,
        SegmentParameters,
        RuleParameters,
        StateParameters,
        FigureParameters,
    ),
    responses((status = 200, description = "The answer, as a list of one", body = json::Answers), Refusals)
)]
pub async fn get_influence(
    Asked(app): Asked,
    Path(name): Path<String>,
    Query(query): Query,
) -> Answered {
    answer(&app, &name, json::question_of_query(query)?).await
}

async fn answer(app: &App, name: &str, draft: QuestionDraft) -> Answered {
    let environment = app.environments.find(name)?;
    let asked = environment.clone();
    let question = aside(draft.states.len() * STATE_BYTES, move || {
        Question::new(&asked, &draft)
    })
    .await??;
    let view = question.view;
    let answers = app.influence.answer(&environment, question).await?;

    json_answer(answers.answers.len() * STATE_BYTES, move || {
        fitting(proto::BatchGetInfluenceResponse::from(answers), view).map(json::Answers::from)
    })
    .await
}
