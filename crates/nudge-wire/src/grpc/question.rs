//! Decodes requests for influence, rankings, summaries, graphs and exploration to drafts of questions.

use nudge_core::domain::Verdict;
use nudge_core::domain::draft::{
    DiscoveryDraft, ExplorationDraft, ListingDraft, PairDraft, PolicyDraft, QuestionDraft,
    StatesDraft, SummaryDraft,
};
use nudge_core::error::{Fault, Problem};

use crate::{present, proto};

/// Decodes the common part of a question: the environment's name, and the rest.
pub fn scope(scope: Option<proto::Scope>) -> Result<(String, PairDraft), Problem> {
    let scope = scope.unwrap_or_default();
    let pair = PairDraft {
        ego: present(scope.ego),
        other: present(scope.other),
        lag: scope.lag.into(),
        given: scope.given,
        segments: scope.segments,
        within: within(scope.within)?,
        policy: scope.policy.and_then(policy),
        rule: scope.rule.unwrap_or_default().into(),
        unit: present(scope.unit),
    };
    Ok((scope.environment, pair))
}

/// Decodes a question about one state.
pub fn question(request: proto::GetInfluenceRequest) -> Result<(String, QuestionDraft), Problem> {
    use proto::get_influence_request::State;
    let (environment, pair) = scope(request.scope)?;
    let states = match request.state {
        Some(State::Values(state)) => StatesDraft::Positional(vec![state.values]),
        Some(State::Key(key)) => StatesDraft::Keys(vec![key]),
        Some(State::Region(region)) => StatesDraft::Region(region.into()),
        None => StatesDraft::default(),
    };

    let (view, significance) = (view(request.view)?, permutations(request.significance)?);
    let (estimators, visits_to_decide) = (request.estimators, request.visits_to_decide);

    Ok((
        environment,
        QuestionDraft {
            pair,
            states,
            features: request.features,
            estimators,
            view,
            significance,
            visits_to_decide,
        },
    ))
}

/// Decodes a question about several states.
pub fn batch_question(
    request: proto::BatchGetInfluenceRequest,
) -> Result<(String, QuestionDraft), Problem> {
    let (environment, pair) = scope(request.scope)?;
    let states = states(request.states, request.keys, request.regions)?;
    let (view, significance) = (view(request.view)?, permutations(request.significance)?);
    let (estimators, visits_to_decide) = (request.estimators, request.visits_to_decide);

    Ok((
        environment,
        QuestionDraft {
            pair,
            states,
            features: request.features,
            estimators,
            view,
            significance,
            visits_to_decide,
        },
    ))
}

/// Decodes what a question is about, of which one list alone may be given.
fn states(
    states: Vec<proto::StateValues>,
    keys: Vec<String>,
    regions: Vec<proto::Region>,
) -> Result<StatesDraft, Problem> {
    match (states.is_empty(), keys.is_empty(), regions.is_empty()) {
        (_, true, true) => Ok(StatesDraft::Positional(
            states.into_iter().map(|state| state.values).collect(),
        )),
        (true, false, true) => Ok(StatesDraft::Keys(keys)),
        (true, true, false) => Ok(StatesDraft::Regions(
            regions.into_iter().map(Into::into).collect(),
        )),
        (_, false, true) => Err(another("/keys", "states")),
        (false, ..) => Err(another("/regions", "states")),
        (true, ..) => Err(another("/regions", "keys")),
    }
}

fn another(pointer: &str, given: &str) -> Problem {
    let detail = format!("got {given} too, expected one of them");
    Problem::invalid("question", vec![Fault::new(pointer, detail)])
}

/// Decodes a question for a page of states.
pub fn list_states(request: proto::ListStatesRequest) -> Result<(String, ListingDraft), Problem> {
    let (environment, pair) = scope(request.scope)?;
    let verdict = match proto::Verdict::try_from(request.verdict) {
        Ok(proto::Verdict::Unspecified) => None,
        Ok(proto::Verdict::Influences) => Some(Verdict::Influences),
        Ok(proto::Verdict::NoInfluence) => Some(Verdict::NoInfluence),
        Ok(proto::Verdict::Undecided) => Some(Verdict::Undecided),
        Err(_) => return Err(unknown("/verdict", request.verdict)),
    };

    let listing = ListingDraft {
        pair,
        order_by: present(request.order_by),
        min_visits: request.min_visits,
        verdict: verdict.map(|verdict| verdict.as_str().into()),
        discovery: discovery(request.discovery)?,
        page_size: u64::from(request.page_size),
        page_token: present(request.page_token),
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

/// Decodes a question for the graph of a state.
pub fn graph(request: proto::GetGraphRequest) -> Result<(String, QuestionDraft), Problem> {
    use proto::get_graph_request::State;
    let within = within(request.within)?;
    let pair = PairDraft {
        lag: request.lag.into(),
        segments: request.segments,
        rule: request.rule.unwrap_or_default().into(),
        unit: present(request.unit),
        within,
        ..PairDraft::default()
    };

    let states = match request.state {
        Some(State::Values(state)) => StatesDraft::Positional(vec![state.values]),
        Some(State::Key(key)) => StatesDraft::Keys(vec![key]),
        None => StatesDraft::default(),
    };

    Ok((
        request.environment,
        QuestionDraft {
            pair,
            states,
            ..QuestionDraft::default()
        },
    ))
}

/// Decodes a question for what to try next.
pub fn exploration(request: proto::ExploreRequest) -> Result<(String, ExplorationDraft), Problem> {
    let (environment, pair) = scope(request.scope)?;
    let draft = ExplorationDraft {
        pair,
        min_visits: request.min_visits,
        limit: u64::from(request.limit),
    };
    Ok((environment, draft))
}

/// Decodes which priors are to be fitted; `None` for those of every pair.
pub fn fit(request: proto::FitPriorRequest) -> (String, Option<PairDraft>) {
    let pair = PairDraft {
        ego: present(request.ego),
        other: present(request.other),
        lag: request.lag.into(),
        given: request.given,
        ..PairDraft::default()
    };
    (
        request.environment,
        Some(pair).filter(|pair| *pair != PairDraft::default()),
    )
}

fn policy(policy: proto::Policy) -> Option<PolicyDraft> {
    use proto::policy::Habits;
    Some(match policy.habits? {
        Habits::Named(word) => PolicyDraft::Word(word),
        Habits::Segments(named) => PolicyDraft::Segments(named.segments),
    })
}

fn within(number: i32) -> Result<Option<String>, Problem> {
    match proto::Within::try_from(number) {
        Ok(proto::Within::Unspecified) => Ok(None),
        Ok(proto::Within::Auto) => Ok(Some("auto".into())),
        Ok(proto::Within::Segments) => Ok(Some("segments".into())),
        Ok(proto::Within::Pooled) => Ok(Some("pooled".into())),
        Err(_) => Err(unknown("/within", number)),
    }
}

fn permutations(number: i32) -> Result<Option<String>, Problem> {
    match proto::Permutations::try_from(number) {
        Ok(proto::Permutations::Unspecified) => Ok(None),
        Ok(proto::Permutations::Auto) => Ok(Some("auto".into())),
        Ok(proto::Permutations::Pooled) => Ok(Some("pooled".into())),
        Ok(proto::Permutations::WithinSegments) => Ok(Some("within_segments".into())),
        Err(_) => Err(unknown("/significance", number)),
    }
}

/// Decodes a question for what all states say together, and the environment's name.
pub fn summary(request: proto::SummarizeRequest) -> Result<(String, SummaryDraft), Problem> {
    let proto::SummarizeRequest {
        scope: asked,
        discovery: wanted,
        omit_segments,
    } = request;
    let (environment, pair) = scope(asked)?;
    Ok((
        environment,
        SummaryDraft {
            pair,
            discovery: discovery(wanted)?,
            omit_segments,
        },
    ))
}

fn discovery(discovery: Option<proto::Discovery>) -> Result<DiscoveryDraft, Problem> {
    let Some(proto::Discovery { fdr, method }) = discovery else {
        return Ok(DiscoveryDraft::default());
    };
    let method = match proto::DiscoveryMethod::try_from(method) {
        Ok(proto::DiscoveryMethod::Unspecified) => None,
        Ok(proto::DiscoveryMethod::Bayes) => Some("bayes".into()),
        Ok(proto::DiscoveryMethod::Bh) => Some("bh".into()),
        Err(_) => return Err(unknown("/method", method)),
    };
    Ok(DiscoveryDraft { fdr, method })
}

fn unknown(pointer: &str, number: i32) -> Problem {
    Problem::invalid(
        "question",
        vec![Fault::new(
            pointer,
            format!("got {number}, expected a number of the enum"),
        )],
    )
}
