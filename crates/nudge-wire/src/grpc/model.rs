//! Networks: requests for a training, and what networks say of themselves.

use nudge_core::domain::draft::TrainingDraft;
use nudge_core::domain::{
    Calibration, Card, Job, JobState, Model, ModelKind, Models, Reliability, Score, Training,
    Weighting,
};

use crate::{present, proto};

/// Decodes a request for a training. A number that its enum does not know becomes a word that the
/// domain does not know, so that it is told with the other faults.
pub fn training(request: proto::TrainModelRequest) -> (String, TrainingDraft) {
    let draft = TrainingDraft {
        kind: match proto::ModelKind::try_from(request.kind) {
            Ok(proto::ModelKind::Unspecified) => None,
            Ok(proto::ModelKind::Joint) => Some(ModelKind::Joint.as_str().into()),
            Ok(proto::ModelKind::Direct) => Some(ModelKind::Direct.as_str().into()),
            Err(_) => Some(request.kind.to_string()),
        },
        weighting: match proto::Weighting::try_from(request.weighting) {
            Ok(proto::Weighting::Unspecified) => None,
            Ok(proto::Weighting::Visits) => Some(Weighting::Visits.as_str().into()),
            Ok(proto::Weighting::States) => Some(Weighting::States.as_str().into()),
            Err(_) => Some(request.weighting.to_string()),
        },
        ego: present(request.ego),
        other: present(request.other),
        lag: request.lag.into(),
        width: request.width,
        members: request.members,
        folds: request.folds,
        epochs: request.epochs,
        seed: request.seed,
        activate: request.activate,
    };
    (request.environment, draft)
}

impl From<Models> for proto::ListModelsResponse {
    fn from(models: Models) -> Self {
        Self {
            models: models.models.into_iter().map(Into::into).collect(),
            jobs: models.jobs.into_iter().map(Into::into).collect(),
            next_page_token: models.next_page_token.unwrap_or_default(),
        }
    }
}

impl From<Model> for proto::Model {
    fn from(model: Model) -> Self {
        let Model {
            version,
            ego,
            other,
            lag,
            active,
            stale,
            card,
        } = model;
        let (card, unreadable) = match card {
            Ok(card) => (Some(card.into()), None),
            Err(why) => (None, Some(why)),
        };
        Self {
            version,
            ego,
            other,
            lag,
            active,
            stale,
            card,
            unreadable,
        }
    }
}

impl From<Job> for proto::Job {
    fn from(job: Job) -> Self {
        let Job {
            id,
            ego,
            other,
            lag,
            state,
            progress,
            message,
            version,
            ahead,
            seconds_left,
        } = job;
        let state = proto::JobState::from(state).into();
        Self {
            id,
            ego,
            other,
            lag,
            state,
            progress,
            message,
            version,
            ahead,
            seconds_left,
        }
    }
}

impl From<JobState> for proto::JobState {
    fn from(state: JobState) -> Self {
        match state {
            JobState::Queued => Self::Queued,
            JobState::Running => Self::Running,
            JobState::Done => Self::Done,
            JobState::Failed => Self::Failed,
            JobState::Cancelled => Self::Cancelled,
        }
    }
}

impl From<ModelKind> for proto::ModelKind {
    fn from(kind: ModelKind) -> Self {
        match kind {
            ModelKind::Joint => Self::Joint,
            ModelKind::Direct => Self::Direct,
        }
    }
}

impl From<Weighting> for proto::Weighting {
    fn from(weighting: Weighting) -> Self {
        match weighting {
            Weighting::Visits => Self::Visits,
            Weighting::States => Self::States,
        }
    }
}

impl From<Card> for proto::Card {
    fn from(card: Card) -> Self {
        let Calibration { intercept, slope } = card.calibration;
        Self {
            training: Some(card.training.into()),
            imported: card.imported,
            schema_hash: card.schema_hash,
            threshold: card.threshold,
            revision: card.revision,
            fit: Some(card.fit.into()),
            states: card.states,
            visits: card.visits,
            inputs: card.inputs,
            split: card.split,
            epochs: card.epochs,
            dropout: card.dropout,
            judged_states: card.judged_states,
            positive_share: card.positive_share,
            calibration: Some(proto::Calibration { intercept, slope }),
            base_rate: card.base_rate,
            score: Some(card.score.into()),
            baselines: card.baselines.into_iter().map(Into::into).collect(),
            reliability: card.reliability.into_iter().map(Into::into).collect(),
            not_better_than: card.not_better_than,
        }
    }
}

impl From<Training> for proto::Training {
    fn from(training: Training) -> Self {
        Self {
            kind: proto::ModelKind::from(training.kind).into(),
            width: training.width as u64,
            members: training.members as u64,
            folds: training.folds as u64,
            epochs: training.epochs as u64,
            weighting: proto::Weighting::from(training.weighting).into(),
            seed: training.seed,
        }
    }
}

impl From<Score> for proto::Score {
    fn from(score: Score) -> Self {
        let Score {
            name,
            log_likelihood,
            auroc,
            precision,
            recall,
            f1,
            brier,
        } = score;
        Self {
            name,
            log_likelihood,
            auroc,
            precision,
            recall,
            f1,
            brier,
        }
    }
}

impl From<Reliability> for proto::Reliability {
    fn from(tenth: Reliability) -> Self {
        let Reliability {
            from,
            states,
            predicted,
            observed,
        } = tenth;
        Self {
            from,
            states,
            predicted,
            observed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_absent_stays_absent() {
        let request = proto::TrainModelRequest {
            environment: "hallway".into(),
            ..Default::default()
        };
        assert_eq!(
            training(request),
            ("hallway".into(), TrainingDraft::default())
        );
    }

    #[test]
    fn numbers_that_no_enum_knows_are_left_to_the_domain() {
        let draft = training(proto::TrainModelRequest {
            kind: 7,
            weighting: -1,
            ..Default::default()
        })
        .1;
        assert_eq!(
            (draft.kind.as_deref(), draft.weighting.as_deref()),
            (Some("7"), Some("-1"))
        );
    }
}
