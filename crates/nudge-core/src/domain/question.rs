//! A question about influence, checked against its environment.

use std::str::FromStr;

use super::draft::{PairDraft, QuestionDraft, StatesDraft};
use super::{
    Environment, Estimator, Estimators, Label, Pair, Policy, Rule, Schema, StateKey, Unit,
    WrittenRule,
};
use crate::error::{Fault, Problem};

/// The most states of one question.
pub const MOST_STATES: usize = 10_000;

/// The most states of a question that asks for tests of independence.
const MOST_TESTED: usize = 1_000;

/// The most states of a question that asks how many more visits a verdict would take.
const MOST_FORESEEN: usize = 100;

/// How much of an answer is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// State key, visits, verdict and basis.
    Verdict,
    /// All but the figures of each ego action.
    Figures,
    /// Everything.
    Full,
}

/// Stratification by segment: what is compared within each segment alone, since trials, or pairs of
/// players, may differ in their habits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Within {
    /// Tests are within segments; plug-in mutual information and its mean under independence are of
    /// the pooled table.
    #[default]
    Auto,
    /// Tests are within segments, and so are those figures: their means over segments, weighted by
    /// visits.
    Segments,
    /// Nothing is: segments are added up before anything is computed.
    Pooled,
}

impl Within {
    /// Every value, in the order in which they are told.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Segments, Self::Pooled];

    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Segments => "segments",
            Self::Pooled => "pooled",
        }
    }

    /// Returns what a test of independence may exchange for what.
    pub fn exchange(self) -> Exchange {
        match self {
            Self::Auto | Self::Segments => Exchange::WithinSegments,
            Self::Pooled => Exchange::Pooled,
        }
    }
}

impl FromStr for Within {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("got {text:?}, expected auto, segments or pooled");
        Self::ALL
            .into_iter()
            .find(|within| within.as_str() == text)
            .ok_or_else(wrong)
    }
}

/// What may be exchanged for what in a permutation test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exchange {
    /// All transitions of a state.
    Pooled,
    /// Those of the same segment only.
    WithinSegments,
}

/// The test of independence that is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Permutations {
    /// The one of the question's scope.
    Auto,
    /// One that exchanges all transitions of a state.
    Pooled,
    /// One that exchanges those of the same segment only.
    WithinSegments,
}

impl Permutations {
    /// Every value, in the order in which they are told.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Pooled, Self::WithinSegments];

    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Pooled => "pooled",
            Self::WithinSegments => "within_segments",
        }
    }

    /// Returns what may be exchanged for what in a question of that scope.
    pub fn exchange(self, within: Within) -> Exchange {
        match self {
            Self::Auto => within.exchange(),
            Self::Pooled => Exchange::Pooled,
            Self::WithinSegments => Exchange::WithinSegments,
        }
    }
}

impl FromStr for Permutations {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("got {text:?}, expected auto, pooled or within_segments");
        Self::ALL
            .into_iter()
            .find(|permutations| permutations.as_str() == text)
            .ok_or_else(wrong)
    }
}

impl View {
    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Verdict => "verdict",
            Self::Figures => "figures",
            Self::Full => "full",
        }
    }
}

impl FromStr for View {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = [Self::Verdict, Self::Figures, Self::Full];
        let wrong = || format!("got {text:?}, expected verdict, figures or full");
        known
            .into_iter()
            .find(|view| view.as_str() == text)
            .ok_or_else(wrong)
    }
}

/// What every question has in common: the pair, the counts it rests on and the rule.
#[derive(Debug, Clone, PartialEq)]
pub struct Scope {
    /// Whose influence on whom.
    pub pair: Pair,
    /// The segments to count, each once and in order; all if `None`.
    pub segments: Option<Vec<Label>>,
    /// What is compared within each of them alone.
    pub within: Within,
    /// Whose habits weigh the ego's actions.
    pub policy: Policy,
    /// The rule that decides, for this pair.
    pub rule: Rule,
    /// The same as it was written, for any pair.
    pub written: WrittenRule,
    /// The unit of the answer's figures.
    pub unit: Unit,
}

/// A question about influence in some states.
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    /// The pair, the counts and the rule.
    pub scope: Scope,
    /// The states, in the order of the answers.
    pub states: Vec<StateKey>,
    /// Further estimators: the ones named, else the environment's.
    pub estimators: Estimators,
    /// How much is wanted of each answer.
    pub view: View,
    /// Whether the test of independence is wanted, and how it permutes.
    pub significance: Option<Permutations>,
    /// Whether it is wanted how many more visits a verdict would take.
    pub visits_to_decide: bool,
}

impl Question {
    /// Checks a question and lists every fault.
    pub fn new(environment: &Environment, draft: &QuestionDraft) -> Result<Self, Problem> {
        let mut faults = Vec::new();
        let scope = keep(Scope::check(environment, &draft.pair), &mut faults);
        let states = keep(states(&environment.schema, &draft.states), &mut faults);
        let estimators: Vec<Estimator> = parse_all(&draft.estimators, "/estimators", &mut faults);
        let view = parse(draft.view.as_deref(), "/view", &mut faults);

        let asked = draft.states.len();
        let mut few = |wanted: bool, most: usize, pointer: &str| {
            if wanted && asked > most {
                let detail =
                    format!("got {asked} states, expected at most {most} where this is asked for");
                faults.push(Fault::new(pointer, detail));
            }
        };
        few(draft.significance.is_some(), MOST_TESTED, "/significance");
        few(draft.visits_to_decide, MOST_FORESEEN, "/visits_to_decide");
        if !draft.features.is_empty() {
            let detail = "got some for states, expected none: a grain is a region's";
            faults.push(Fault::new("/features", detail));
        }

        let significance = parse(draft.significance.as_deref(), "/significance", &mut faults);
        let (Some(scope), Some(states), true) = (scope, states, faults.is_empty()) else {
            return Err(Problem::invalid("question", faults));
        };

        let estimators = if estimators.is_empty() {
            scope.rule.estimators
        } else {
            estimators.into_iter().collect()
        };

        let view = view.unwrap_or(if states.len() == 1 {
            View::Full
        } else {
            View::Figures
        });

        Ok(Self {
            scope,
            states,
            estimators,
            view,
            significance,
            visits_to_decide: draft.visits_to_decide,
        })
    }
}

impl Scope {
    /// Checks the common part of a question.
    pub fn new(environment: &Environment, draft: &PairDraft) -> Result<Self, Problem> {
        Self::check(environment, draft).map_err(|faults| Problem::invalid("question", faults))
    }

    /// Returns the same for another pair.
    pub fn of_pair(&self, schema: &Schema, pair: Pair) -> Self {
        Self {
            rule: self.written.resolved(pair.alphabet(schema)),
            pair,
            ..self.clone()
        }
    }

    /// Returns which share of the largest mutual information of the pair the threshold is; `None`
    /// where one of the two has a single action.
    pub fn share(&self, schema: &Schema) -> Option<f64> {
        self.written.share(self.pair.alphabet(schema))
    }

    /// Checks the same, and lists every fault.
    pub(super) fn check(environment: &Environment, draft: &PairDraft) -> Result<Self, Vec<Fault>> {
        let mut faults = Vec::new();
        let pair = keep(Pair::named(&environment.schema, draft), &mut faults);
        let mut segments: Vec<Label> = parse_all(&draft.segments, "/segments", &mut faults);
        segments.sort_unstable();
        segments.dedup();
        let within = parse(draft.within.as_deref(), "/within", &mut faults).unwrap_or_default();
        let policy = draft.policy.as_ref().map(Policy::checked).transpose();
        let policy = keep(policy, &mut faults).flatten();

        let under_rule = |found: Vec<Fault>| {
            found
                .into_iter()
                .map(|fault| fault.under("/rule"))
                .collect()
        };
        let merged = environment
            .rule
            .merged(&draft.rule)
            .and_then(|rule| within_reach(rule, environment, &pair, draft));
        let rule = keep(merged.map_err(under_rule), &mut faults);

        let unit = draft.unit.as_deref().map(Unit::from_str).transpose();
        if let Err(detail) = &unit {
            faults.push(Fault::new("/unit", detail.clone()));
        }

        match (pair, rule, unit) {
            (Some(pair), Some(rule), Ok(unit)) if faults.is_empty() => {
                let policy = policy.unwrap_or_else(|| Policy::unless_exploring(&rule.exploration));
                let segments = (!draft.segments.is_empty()).then_some(segments);
                let unit = unit.unwrap_or(rule.unit);
                Ok(Self {
                    rule: rule.resolved(pair.alphabet(&environment.schema)),
                    written: rule,
                    pair,
                    segments,
                    within,
                    policy,
                    unit,
                })
            }
            _ => Err(faults),
        }
    }
}

/// Refuses a threshold that was given with the question and that the pair cannot reach.
fn within_reach(
    rule: WrittenRule,
    environment: &Environment,
    pair: &Option<Pair>,
    draft: &PairDraft,
) -> Result<WrittenRule, Vec<Fault>> {
    if let (Some(pair), Some(_)) = (pair, draft.rule.threshold) {
        rule.within_reach(pair.alphabet(&environment.schema))
            .map_err(|fault| vec![fault])?;
    }
    Ok(rule)
}

/// Returns the value, or `None` after adding its faults to the rest.
pub(super) fn keep<T>(checked: Result<T, Vec<Fault>>, faults: &mut Vec<Fault>) -> Option<T> {
    checked.map_err(|more| faults.extend(more)).ok()
}

pub(super) fn parse<T: FromStr<Err = String>>(
    text: Option<&str>,
    pointer: &str,
    faults: &mut Vec<Fault>,
) -> Option<T> {
    text?
        .parse()
        .map_err(|detail: String| faults.push(Fault::new(pointer, detail)))
        .ok()
}

fn parse_all<T: FromStr<Err = String>>(
    texts: &[String],
    pointer: &str,
    faults: &mut Vec<Fault>,
) -> Vec<T> {
    let parse = |(i, text): (usize, &String)| {
        text.parse()
            .map_err(|detail| faults.push(Fault::new(format!("{pointer}/{i}"), detail)))
            .ok()
    };
    texts.iter().enumerate().filter_map(parse).collect()
}

fn states(schema: &Schema, draft: &StatesDraft) -> Result<Vec<StateKey>, Vec<Fault>> {
    match draft {
        StatesDraft::Positional(states) => {
            each(states, "/states", |values| schema.key_of_values(values))
        }
        StatesDraft::Named(states) => each(states, "/states", |named| {
            schema.key_of_values(&schema.state_values(named)?)
        }),
        StatesDraft::Keys(keys) => each(keys, "/keys", |text| {
            schema
                .key_of_text(text)
                .map_err(|detail| vec![Fault::new("", detail)])
        }),
        StatesDraft::Regions(_) => Err(regions("/regions")),
        StatesDraft::Region(_) => Err(regions("/region")),
    }
}

fn regions(pointer: &str) -> Vec<Fault> {
    vec![Fault::new(pointer, "got regions, expected states or keys")]
}

fn each<T>(
    drafts: &[T],
    pointer: &str,
    key: impl Fn(&T) -> Result<StateKey, Vec<Fault>>,
) -> Result<Vec<StateKey>, Vec<Fault>> {
    if drafts.is_empty() {
        // Not every face can tell which of the two lists was meant.
        return Err(vec![Fault::new(
            "/states",
            format!("got none, expected 1 to {MOST_STATES} states or keys, or regions"),
        )]);
    }
    if drafts.len() > MOST_STATES {
        return Err(vec![Fault::new(
            pointer,
            format!("got {}, expected 1 to {MOST_STATES}", drafts.len()),
        )]);
    }

    let mut faults = Vec::new();
    let mut keys = Vec::with_capacity(drafts.len());
    for (i, draft) in drafts.iter().enumerate() {
        match key(draft) {
            Ok(key) => keys.push(key),
            Err(found) => faults.extend(
                found
                    .into_iter()
                    .map(|fault| fault.under(&format!("{pointer}/{i}"))),
            ),
        }
    }

    if faults.is_empty() {
        Ok(keys)
    } else {
        Err(faults)
    }
}
