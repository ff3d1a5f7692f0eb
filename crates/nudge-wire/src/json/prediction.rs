//! Predictions of a network for one state.

use serde::Serialize;
use utoipa::ToSchema;

use super::model_kind;
use super::words;
use crate::proto;

/// What a network says of a state.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ModelFigures {
    /// Its version.
    pub version: u64,
    /// What it predicts: `joint` or `direct`.
    #[schema(example = "joint", value_type = words::ModelKind)]
    pub kind: &'static str,
    /// P(MI > threshold), the mean of its members; null at another threshold than the one that it
    /// was trained for.
    pub probability: Option<f64>,
    /// Mutual information in the answer's unit, the mean of its members; null for a direct network.
    pub mutual_information: Option<f64>,
    /// Whether its members say the same at their own threshold, each on its own side of one half.
    pub agrees: bool,
    /// Names of the features whose bin in this state no state of its training had: where there is
    /// one, it gives no verdict. Absent where there is none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub out_of_range: Vec<String>,
    /// One an ego action, in index order; a joint network in the view `full` only.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub by_action: Vec<ModelAction>,
}

/// What a network says of one ego action.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ModelAction {
    /// Its label.
    pub action: String,
    /// Its index.
    pub index: u64,
    /// How probable it is in this state.
    pub probability: f64,
    /// KL(p(other given this action) from p(other)), in the answer's unit.
    pub divergence: f64,
    /// Probability of each of the other's actions after it, in index order.
    pub response: Vec<f64>,
}

impl From<proto::ModelFigures> for ModelFigures {
    fn from(figures: proto::ModelFigures) -> Self {
        Self {
            version: figures.version,
            kind: model_kind(figures.kind),
            probability: figures.probability,
            mutual_information: figures.mutual_information,
            agrees: figures.agrees,
            out_of_range: figures.out_of_range,
            by_action: figures.by_action.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::ModelAction> for ModelAction {
    fn from(figures: proto::ModelAction) -> Self {
        let proto::ModelAction {
            action,
            index,
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_a_network_cannot_tell_is_null() {
        let network = proto::ModelFigures {
            version: 3,
            kind: proto::ModelKind::Joint.into(),
            probability: Some(0.75),
            mutual_information: Some(0.5),
            agrees: true,
            out_of_range: Vec::new(),
            by_action: Vec::new(),
        };
        let told = |figures: proto::ModelFigures| {
            serde_json::to_value(ModelFigures::from(figures)).expect("JSON")
        };
        let expected = json!({"version": 3, "kind": "joint", "probability": 0.75, "mutual_information": 0.5, "agrees": true});
        assert_eq!(told(network.clone()), expected);
        let direct = proto::ModelFigures {
            kind: proto::ModelKind::Direct.into(),
            probability: None,
            mutual_information: None,
            ..network.clone()
        };
        let expected = json!({"version": 3, "kind": "direct", "probability": null, "mutual_information": null, "agrees": true});
        assert_eq!(told(direct), expected);
        let action = proto::ModelAction {
            action: "go".into(),
            index: 1,
            probability: 0.25,
            divergence: 0.125,
            response: vec![0.5, 0.5],
        };
        let outside = told(proto::ModelFigures {
            out_of_range: vec!["lane".into()],
            ..network.clone()
        });
        assert_eq!(outside["out_of_range"], json!(["lane"]));
        let full = told(proto::ModelFigures {
            by_action: vec![action],
            ..network
        });
        let expected = json!([
            {"action": "go", "index": 1, "probability": 0.25, "divergence": 0.125, "response": [0.5, 0.5]},
        ]);
        assert_eq!(full["by_action"], expected);
    }
}
