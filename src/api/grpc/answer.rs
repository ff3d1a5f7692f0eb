//! Answers.

use crate::api::proto;
use crate::domain::{
    ActionFigures, Answer, Answers, Basis, Bin, Figures, Labels, StateKey, StatePage, StateView, Summary, Variable,
    Verdict,
};

impl From<Answers> for proto::BatchGetInfluenceResponse {
    fn from(answers: Answers) -> Self {
        let labels = Some(answers.labels.into());
        Self { labels, answers: answers.answers.into_iter().map(Into::into).collect() }
    }
}

impl From<Answers> for proto::GetInfluenceResponse {
    fn from(answers: Answers) -> Self {
        let labels = Some(answers.labels.into());
        Self { labels, answer: answers.answers.into_iter().next().map(Into::into) }
    }
}

impl From<Labels> for proto::Labels {
    fn from(labels: Labels) -> Self {
        let variable = |variable: Variable| proto::Variable { name: variable.name, actions: variable.actions };
        Self {
            ego: Some(variable(labels.ego)),
            other: Some(variable(labels.other)),
            given: labels.given.into_iter().map(variable).collect(),
        }
    }
}

impl From<Answer> for proto::Answer {
    fn from(answer: Answer) -> Self {
        let base = Self {
            state: Some(state(&answer.key, Vec::new())),
            visits: answer.visits,
            verdict: proto::Verdict::from(answer.verdict).into(),
            basis: proto::Basis::from(answer.basis).into(),
            ..Self::default()
        };
        let by_action = answer.by_action.into_iter().flatten().map(Into::into).collect();
        match answer.figures {
            None => base,
            Some(figures) => with_figures(Self { by_action, ..base }, &answer.key, *figures),
        }
    }
}

fn with_figures(base: proto::Answer, key: &StateKey, figures: Figures) -> proto::Answer {
    let mutual_information = proto::MutualInformation {
        plug_in: figures.plug_in,
        expected_if_independent: figures.expected_if_independent,
        expected_method: figures.expected_method.into(),
        estimates: figures.estimates.into_iter().map(|(name, value)| (name.into(), value)).collect(),
    };
    proto::Answer {
        state: Some(state(key, figures.bins)),
        entries: figures.entries,
        unit: figures.unit.as_str().into(),
        threshold: Some(figures.threshold),
        rule: figures.rule.as_str().into(),
        mutual_information: Some(mutual_information),
        lag: Some(0),
        directed: Some(false),
        revision: Some(figures.revision),
        ..base
    }
}

fn state(key: &StateKey, bins: Vec<Bin>) -> proto::State {
    let bin = |bin: Bin| proto::Bin { feature: bin.feature, bin: bin.bin, label: bin.label };
    proto::State { key: key.to_string(), bins: bins.into_iter().map(bin).collect() }
}

impl From<ActionFigures> for proto::ActionFigures {
    fn from(figures: ActionFigures) -> Self {
        let ActionFigures { index, action, visits, plug_in_divergence, response } = figures;
        Self { action, index, visits, plug_in_divergence, response: response.unwrap_or_default() }
    }
}

impl From<Verdict> for proto::Verdict {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Influences => Self::Influences,
            Verdict::NoInfluence => Self::NoInfluence,
            Verdict::Undecided => Self::Undecided,
        }
    }
}

impl From<Basis> for proto::Basis {
    fn from(basis: Basis) -> Self {
        match basis {
            Basis::Counts(_) => Self::Counts,
            Basis::Prior => Self::Prior,
        }
    }
}

impl From<StateView> for proto::GetStateResponse {
    fn from(view: StateView) -> Self {
        let cell = |cell: crate::domain::LabelledCell| proto::Cell {
            segment: cell.segment.map(|label| label.to_string()).unwrap_or_default(),
            actions: cell.actions,
            labels: cell.labels,
            n: cell.tally.n,
            entries: cell.tally.entries,
        };
        Self {
            state: Some(state(&view.key, view.bins)),
            visits: view.total.n,
            entries: view.total.entries,
            cells: view.cells.into_iter().map(cell).collect(),
            revision: view.revision,
        }
    }
}

impl From<StatePage> for proto::ListStatesResponse {
    fn from(page: StatePage) -> Self {
        let figures = |figures: crate::domain::StateFigures| proto::StateFigures {
            state: Some(state(&figures.key, figures.bins)),
            visits: figures.visits,
            plug_in: figures.plug_in,
            expected_if_independent: figures.expected_if_independent,
            verdict: proto::Verdict::from(figures.verdict).into(),
        };
        Self {
            states: page.states.into_iter().map(figures).collect(),
            next_page_token: page.next_page_token.unwrap_or_default(),
            as_of: page.as_of,
            unit: page.unit.as_str().into(),
        }
    }
}

impl From<Summary> for proto::SummarizeResponse {
    fn from(summary: Summary) -> Self {
        let [influences, no_influence, undecided] = summary.verdicts;
        let bin = |bin: crate::domain::HistogramBin| proto::HistogramBin {
            from: bin.from,
            to: bin.to,
            plug_in: bin.plug_in,
            expected_if_independent: bin.expected_if_independent,
        };
        Self {
            transitions: summary.transitions,
            states: summary.states,
            segments: summary.segments.iter().map(ToString::to_string).collect(),
            min_visits: summary.min_visits,
            share_of_visits_with_enough_data: summary.share_of_visits_with_enough_data,
            verdicts: Some(proto::VerdictCounts { influences, no_influence, undecided }),
            histogram: summary.histogram.into_iter().map(bin).collect(),
            as_of: summary.as_of,
            unit: summary.unit.as_str().into(),
            threshold: summary.threshold,
        }
    }
}
