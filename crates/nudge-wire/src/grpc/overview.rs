//! Encodes contingency tables of one state, rankings, summaries, discoveries (multiple testing),
//! expected information gain and fitted priors (empirical Bayes).

use nudge_core::domain::{
    Discoveries, DiscoveryMethod, Exploration, FittedPrior, HistogramBin, LabelledCell,
    StateFigures, StatePage, StateView, Suggestion, Summary, Unit,
};

use super::answer::{dependence, state_of_key, version};
use crate::proto;

impl From<StateView> for proto::GetStateResponse {
    fn from(view: StateView) -> Self {
        Self {
            state: Some(state_of_key(&view.key, view.bins)),
            visits: view.total.n,
            entries: view.total.entries,
            cells: view.cells.into_iter().map(Into::into).collect(),
            revision: view.revision,
        }
    }
}

impl From<LabelledCell> for proto::Cell {
    fn from(cell: LabelledCell) -> Self {
        Self {
            segment: cell
                .segment
                .map(|label| label.to_string())
                .unwrap_or_default(),
            actions: cell.actions,
            labels: cell.labels,
            n: cell.tally.n,
            entries: cell.tally.entries,
        }
    }
}

impl From<StateFigures> for proto::StateFigures {
    fn from(figures: StateFigures) -> Self {
        Self {
            state: Some(state_of_key(&figures.key, figures.bins)),
            visits: figures.visits,
            plug_in: figures.plug_in,
            expected_if_independent: figures.expected_if_independent,
            verdict: proto::Verdict::from(figures.verdict).into(),
            basis: proto::Basis::from(figures.basis).into(),
            basis_version: version(figures.basis),
            posterior_mean: figures.evidence.map(|evidence| evidence.posterior_mean),
            probability: figures.evidence.map(|evidence| evidence.probability.into()),
            dependence: dependence(figures.evidence),
            p_value: figures.p_value,
        }
    }
}

impl From<StatePage> for proto::ListStatesResponse {
    fn from(page: StatePage) -> Self {
        Self {
            labels: Some(page.labels.into()),
            lag: page.lag,
            states: page.states.into_iter().map(Into::into).collect(),
            next_page_token: page.next_page_token.unwrap_or_default(),
            as_of: page.as_of,
            fit: Some(page.fit.into()),
            unit: page.unit.as_str().into(),
        }
    }
}

impl From<Summary> for proto::SummarizeResponse {
    fn from(summary: Summary) -> Self {
        let [influences, no_influence, undecided] = summary.verdicts;
        let [established, excluded, open] = summary.dependence;
        Self {
            labels: Some(summary.labels.into()),
            lag: summary.lag,
            transitions: summary.transitions,
            states: summary.states,
            segments: summary.segments.iter().map(ToString::to_string).collect(),
            min_visits: summary.min_visits,
            share_of_visits_with_enough_data: summary.share_of_visits_with_enough_data,
            verdicts: Some(proto::VerdictCounts {
                influences,
                no_influence,
                undecided,
            }),
            histogram: summary.histogram.into_iter().map(Into::into).collect(),
            as_of: summary.as_of,
            unit: summary.unit.as_str().into(),
            threshold: summary.threshold,
            thresholds: Some(proto::ThresholdFigures {
                nats: summary.threshold_nats,
                bits: Unit::Bits.from_nats(summary.threshold_nats),
                share: summary.threshold_share,
            }),
            dependence: Some(proto::DependenceCounts {
                established,
                excluded,
                open,
            }),
            fit: Some(summary.fit.into()),
            dependent_share: summary.dependent_share,
            discoveries: summary.discoveries.map(Into::into),
            segmentation: Some(summary.segmentation.into()),
            pooled: Some(summary.pooled.into()),
            habits_differ: summary.habits_differ,
            warnings: summary.warnings,
        }
    }
}

impl From<HistogramBin> for proto::HistogramBin {
    fn from(bin: HistogramBin) -> Self {
        Self {
            from: bin.from,
            to: bin.to,
            plug_in: bin.plug_in,
            expected_if_independent: bin.expected_if_independent,
            posterior_mean: bin.posterior_mean,
        }
    }
}

impl From<Discoveries> for proto::Discoveries {
    fn from(found: Discoveries) -> Self {
        let method = match found.discovery.method {
            DiscoveryMethod::Bayes => proto::DiscoveryMethod::Bayes,
            DiscoveryMethod::Bh => proto::DiscoveryMethod::Bh,
        };
        Self {
            fdr: found.discovery.fdr,
            method: method.into(),
            states: found.states,
            testable: found.testable,
        }
    }
}

impl From<Exploration> for proto::ExploreResponse {
    fn from(exploration: Exploration) -> Self {
        Self {
            labels: Some(exploration.labels.into()),
            lag: exploration.lag,
            trials: exploration.trials.into_iter().map(Into::into).collect(),
            considered: exploration.considered,
            as_of: exploration.as_of,
            fit: Some(exploration.fit.into()),
        }
    }
}

impl From<Suggestion> for proto::Trial {
    fn from(trial: Suggestion) -> Self {
        Self {
            state: Some(state_of_key(&trial.key, trial.bins)),
            visits: trial.visits,
            action: trial.action,
            index: trial.index,
            action_visits: trial.action_visits,
            information_gain: trial.information_gain,
            above_threshold: trial.above_threshold,
        }
    }
}

impl From<Vec<FittedPrior>> for proto::FitPriorResponse {
    fn from(fits: Vec<FittedPrior>) -> Self {
        Self {
            fits: fits.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<FittedPrior> for proto::FittedPrior {
    fn from(prior: FittedPrior) -> Self {
        Self {
            earlier: prior.earlier,
            later: prior.later,
            lag: prior.lag,
            given: prior.given,
            fit: Some(prior.fit.into()),
            states: prior.states,
            dependent_share: prior.dependent_share,
        }
    }
}
