//! Questions.

use crate::api::proto;
use crate::domain::Verdict;
use crate::domain::draft::{ListingDraft, PairDraft, QuestionDraft, StatesDraft};
use crate::error::{Fault, Problem};

/// Decodes the common part of a question: the environment's name, and the rest.
pub fn scope(scope: Option<proto::Scope>) -> (String, PairDraft) {
    let scope = scope.unwrap_or_default();
    let pair = PairDraft {
        ego: given(scope.ego),
        other: given(scope.other),
        given: scope.given,
        segments: scope.segments,
        rule: scope.rule.unwrap_or_default().into(),
        unit: given(scope.unit),
    };
    (scope.environment, pair)
}

/// Decodes a question about one state.
pub fn question(request: proto::GetInfluenceRequest) -> Result<(String, QuestionDraft), Problem> {
    use proto::get_influence_request::State;
    let (environment, pair) = scope(request.scope);
    let states = match request.state {
        Some(State::Values(state)) => StatesDraft::Positional(vec![state.values]),
        Some(State::Key(key)) => StatesDraft::Keys(vec![key]),
        None => StatesDraft::default(),
    };
    Ok((environment, QuestionDraft { pair, states, estimators: request.estimators, view: view(request.view)? }))
}

/// Decodes a question about several states.
pub fn batch_question(request: proto::BatchGetInfluenceRequest) -> Result<(String, QuestionDraft), Problem> {
    let (environment, pair) = scope(request.scope);
    let states = match (request.states, request.keys) {
        (states, keys) if keys.is_empty() => {
            StatesDraft::Positional(states.into_iter().map(|state| state.values).collect())
        }
        (states, keys) if states.is_empty() => StatesDraft::Keys(keys),
        _ => {
            return Err(Problem::invalid(
                "question",
                vec![Fault::new("/keys", "got states too, expected one of them")],
            ));
        }
    };
    Ok((environment, QuestionDraft { pair, states, estimators: request.estimators, view: view(request.view)? }))
}

/// Decodes a question for a page of states.
pub fn list_states(request: proto::ListStatesRequest) -> Result<(String, ListingDraft), Problem> {
    let (environment, pair) = scope(request.scope);
    let verdict = match proto::Verdict::try_from(request.verdict) {
        Ok(proto::Verdict::Unspecified) => None,
        Ok(proto::Verdict::Influences) => Some(Verdict::Influences),
        Ok(proto::Verdict::NoInfluence) => Some(Verdict::NoInfluence),
        Ok(proto::Verdict::Undecided) => Some(Verdict::Undecided),
        Err(_) => return Err(unknown("/verdict", request.verdict)),
    };
    let listing = ListingDraft {
        pair,
        order_by: given(request.order_by),
        min_visits: request.min_visits,
        verdict: verdict.map(|verdict| verdict.as_str().into()),
        page_size: u64::from(request.page_size),
        page_token: given(request.page_token),
    };
    Ok((environment, listing))
}

fn view(number: i32) -> Result<Option<String>, Problem> {
    match proto::View::try_from(number) {
        Ok(proto::View::Unspecified) => Ok(None),
        Ok(proto::View::Verdict) => Ok(Some("verdict".into())),
        Ok(proto::View::Figures) => Ok(Some("figures".into())),
        Ok(proto::View::Full) => Ok(Some("full".into())),
        Err(_) => Err(unknown("/view", number)),
    }
}

fn unknown(pointer: &str, number: i32) -> Problem {
    Problem::invalid("question", vec![Fault::new(pointer, format!("got {number}, expected a number of the enum"))])
}

fn given(text: String) -> Option<String> {
    Some(text).filter(|text| !text.is_empty())
}
