//! Encodes answers: estimates of mutual information, posterior probabilities, credible intervals,
//! tests of independence and verdicts.

use nudge_core::domain::{
    ActionFigures, Answer, Answers, Basis, Bin, Dependence, Evidence, Figures, FitId, Holds,
    Interval, Labels, ModelAction, ModelFigures, Probability, Segmentation, StateKey, Variable,
    Verdict,
};

use crate::proto;

impl From<Answers> for proto::BatchGetInfluenceResponse {
    fn from(answers: Answers) -> Self {
        Self {
            labels: Some(answers.labels.into()),
            lag: answers.lag,
            answers: answers.answers.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<Answers> for proto::GetInfluenceResponse {
    fn from(answers: Answers) -> Self {
        Self {
            labels: Some(answers.labels.into()),
            lag: answers.lag,
            answer: answers.answers.into_iter().next().map(Into::into),
        }
    }
}

impl From<Labels> for proto::Labels {
    fn from(labels: Labels) -> Self {
        Self {
            ego: Some(labels.ego.into()),
            other: Some(labels.other.into()),
            given: labels.given.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<Variable> for proto::Variable {
    fn from(variable: Variable) -> Self {
        Self {
            name: variable.name,
            actions: variable.actions,
        }
    }
}

impl From<Answer> for proto::Answer {
    fn from(answer: Answer) -> Self {
        let base = Self {
            visits: answer.visits,
            verdict: proto::Verdict::from(answer.verdict).into(),
            basis: proto::Basis::from(answer.basis).into(),
            basis_version: version(answer.basis),
            ..Self::default()
        };
        let by_action = answer
            .by_action
            .into_iter()
            .flatten()
            .map(Into::into)
            .collect();
        match answer.figures {
            None => Self {
                state: Some(state_of_key(&answer.key, Vec::new())),
                ..base
            },
            Some(figures) => with_figures(Self { by_action, ..base }, &answer.key, *figures),
        }
    }
}

fn with_figures(base: proto::Answer, key: &StateKey, figures: Figures) -> proto::Answer {
    let mutual_information = proto::MutualInformation {
        plug_in: figures.plug_in,
        expected_if_independent: figures.expected_if_independent,
        expected_method: figures.expected_method.into(),
        estimates: figures
            .estimates
            .into_iter()
            .map(|(name, value)| (name.into(), value))
            .collect(),
        posterior_mean: figures.evidence.map(|evidence| evidence.posterior_mean),
        interval: figures.evidence.map(|evidence| interval(evidence.interval)),
        ..proto::MutualInformation::default()
    };
    let significance = figures.significance.map(|test| proto::Significance {
        p_value: test.p_value,
        method: test.method.into(),
    });
    proto::Answer {
        state: Some(state_of_key(key, figures.bins)),
        entries: figures.entries,
        unit: figures.unit.as_str().into(),
        threshold: Some(figures.threshold),
        share: figures.share,
        rule: figures.rule.as_str().into(),
        mutual_information: Some(mutual_information),
        lag: Some(figures.lag),
        directed: Some(figures.lag > 0),
        revision: Some(figures.revision),
        independence: figures.independence.as_str().into(),
        dependence: dependence(figures.evidence),
        probability: figures.evidence.map(|evidence| evidence.probability.into()),
        segmentation: Some(figures.segmentation.into()),
        significance,
        warnings: figures.warnings,
        visits_to_decide: figures
            .visits_to_decide
            .map(|visits| proto::VisitsToDecide { visits }),
        holds: figures.holds.map(Into::into),
        fit: Some(figures.fit.into()),
        model: figures.model.map(Into::into),
        ..base
    }
}

/// Encodes which network a verdict rests on.
pub(super) fn version(basis: Basis) -> Option<u64> {
    match basis {
        Basis::Model(version) => Some(version),
        Basis::Counts(_) | Basis::Prior => None,
    }
}

/// Encodes an interval.
pub(super) fn interval([lower, upper]: Interval) -> proto::Interval {
    proto::Interval { lower, upper }
}

/// Encodes the dependence that there is evidence on.
pub(super) fn dependence(evidence: Option<Evidence>) -> i32 {
    let dependence = match evidence.map(|evidence| evidence.dependence) {
        Some(Dependence::Established) => proto::Dependence::Established,
        Some(Dependence::Excluded) => proto::Dependence::Excluded,
        Some(Dependence::Open) => proto::Dependence::Open,
        None => proto::Dependence::Unspecified,
    };
    dependence.into()
}

impl From<Probability> for proto::Probability {
    fn from(probability: Probability) -> Self {
        let Probability {
            dependent,
            above_threshold,
        } = probability;
        Self {
            dependent,
            above_threshold,
        }
    }
}

impl From<Segmentation> for proto::Segmentation {
    fn from(segmentation: Segmentation) -> Self {
        let Segmentation { count, differ } = segmentation;
        Self { count, differ }
    }
}

impl From<Holds> for proto::Holds {
    fn from(holds: Holds) -> Self {
        let Holds { ego, other } = holds;
        Self { ego, other }
    }
}

impl From<FitId> for proto::Fit {
    fn from(fit: FitId) -> Self {
        Self {
            version: fit.version,
            revision: fit.revision,
        }
    }
}

/// Encodes a state by its key.
pub(super) fn state_of_key(key: &StateKey, bins: Vec<Bin>) -> proto::State {
    proto::State {
        key: key.to_string(),
        bins: bins.into_iter().map(Into::into).collect(),
    }
}

impl From<Bin> for proto::Bin {
    fn from(bin: Bin) -> Self {
        Self {
            feature: bin.feature,
            bin: bin.bin,
            label: bin.label,
        }
    }
}

impl From<ActionFigures> for proto::ActionFigures {
    fn from(figures: ActionFigures) -> Self {
        Self {
            action: figures.action,
            index: figures.index,
            visits: figures.visits,
            plug_in_divergence: figures.plug_in_divergence,
            divergence: figures.divergence.map(|(mean, _)| mean),
            divergence_interval: figures.divergence.map(|(_, ends)| interval(ends)),
            response: figures.response.unwrap_or_default(),
            response_intervals: figures
                .response_intervals
                .into_iter()
                .map(interval)
                .collect(),
            response_if_independent: figures.response_if_independent,
            expected_divergence: figures.expected_divergence,
        }
    }
}

impl From<ModelFigures> for proto::ModelFigures {
    fn from(figures: ModelFigures) -> Self {
        let ModelFigures {
            version,
            kind,
            probability,
            mutual_information,
            agrees,
            out_of_range,
            by_action,
        } = figures;
        let kind = proto::ModelKind::from(kind).into();
        let by_action = by_action.into_iter().map(Into::into).collect();

        Self {
            version,
            kind,
            probability,
            mutual_information,
            agrees,
            out_of_range,
            by_action,
        }
    }
}

impl From<ModelAction> for proto::ModelAction {
    fn from(figures: ModelAction) -> Self {
        let ModelAction {
            index,
            action,
            probability,
            divergence,
            response,
        } = figures;
        Self {
            action,
            index,
            probability,
            divergence,
            response,
        }
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
            Basis::Model(_) => Self::Model,
            Basis::Prior => Self::Prior,
        }
    }
}
