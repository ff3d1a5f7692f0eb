//! A question about regions, each of which is asked about as one.

use super::draft::{QuestionDraft, StatesDraft};
use super::question::{Scope, View, keep, parse};
use super::{Coordinates, Environment, Grain, MOST_REGIONS, Question, Region};
use crate::error::{Fault, Problem};

/// A question about influence in some regions.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionQuestion {
    /// The pair, the counts and the rule.
    pub scope: Scope,
    /// The regions, in the order of the answers.
    pub regions: Vec<Region>,
    /// What of a state is kept; `None` for all of it.
    pub grain: Option<Grain>,
    /// How much is wanted of each answer.
    pub view: View,
}

/// A question about states, or about regions.
#[derive(Debug, Clone, PartialEq)]
pub enum Asked {
    /// Each state by itself.
    States(Question),
    /// Each region as one.
    Regions(RegionQuestion),
}

impl Asked {
    /// Checks a question and lists every fault.
    pub fn new(environment: &Environment, draft: &QuestionDraft) -> Result<Self, Problem> {
        match draft.states {
            StatesDraft::Regions(_) | StatesDraft::Region(_) => {
                RegionQuestion::new(environment, draft).map(Self::Regions)
            }
            _ => Question::new(environment, draft).map(Self::States),
        }
    }

    /// Returns how much is wanted of each answer.
    pub fn view(&self) -> View {
        match self {
            Self::States(question) => question.view,
            Self::Regions(question) => question.view,
        }
    }
}

impl RegionQuestion {
    /// Checks a question and lists every fault.
    pub fn new(environment: &Environment, draft: &QuestionDraft) -> Result<Self, Problem> {
        let (coordinates, mut faults) = (environment.coordinates(), Vec::new());
        let scope = keep(Scope::check(environment, &draft.pair), &mut faults);
        let regions = keep(regions(&draft.states, &coordinates), &mut faults);
        let grain = keep(grain(&draft.features, &coordinates), &mut faults);
        let view = parse(draft.view.as_deref(), "/view", &mut faults);
        faults.extend(of_states_alone(draft));

        let (Some(scope), Some(regions), Some(grain), true) =
            (scope, regions, grain, faults.is_empty())
        else {
            return Err(Problem::invalid("question", faults));
        };
        let view = view.unwrap_or(match regions.len() {
            1 => View::Full,
            _ => View::Figures,
        });
        Ok(Self {
            scope,
            regions,
            grain,
            view,
        })
    }
}

/// Returns the grain of these features; `None` where it leaves nothing out.
fn grain(features: &[String], coordinates: &Coordinates) -> Result<Option<Grain>, Vec<Fault>> {
    if features.is_empty() {
        return Ok(None);
    }
    let grain = Grain::checked(features, coordinates)?;
    Ok(Some(grain).filter(|grain| !grain.left_out().is_empty()))
}

fn regions(draft: &StatesDraft, coordinates: &Coordinates) -> Result<Vec<Region>, Vec<Fault>> {
    let below = |faults: Vec<Fault>| faults.into_iter().map(|fault| fault.under("/region"));
    match draft {
        StatesDraft::Region(draft) => Region::checked(draft, coordinates)
            .map(|region| vec![region])
            .map_err(|faults| below(faults).collect()),
        StatesDraft::Regions(drafts) if drafts.is_empty() => Err(vec![none()]),
        StatesDraft::Regions(drafts) => Region::several(drafts, coordinates),
        _ => Err(vec![none()]),
    }
}

fn none() -> Fault {
    Fault::new(
        "/regions",
        format!("got none, expected 1 to {MOST_REGIONS}"),
    )
}

/// Returns a fault for each thing that can be asked of states alone.
fn of_states_alone(draft: &QuestionDraft) -> impl Iterator<Item = Fault> {
    let tells = "a region's answer tells both pooled p-values in any case";
    let asked = [
        (
            !draft.estimators.is_empty(),
            "/estimators",
            "a region's answer tells the excess, and a size with its intervals",
        ),
        (draft.significance.is_some(), "/significance", tells),
        (
            draft.visits_to_decide,
            "/visits_to_decide",
            "that is asked of states alone",
        ),
    ];
    let faults = asked.into_iter().filter(|(is_asked, ..)| *is_asked);
    faults.map(|(_, pointer, why)| Fault::new(pointer, format!("expected none for regions: {why}")))
}
