//! Answers about influence: estimates of mutual information, their uncertainty, and the verdict.

use std::collections::BTreeMap;

use serde::Serialize;
use utoipa::ToSchema;

use super::evidence::{dependence, interval};
use super::profile::ends;
use super::{
    Fit, Labels, ModelFigures, Probability, Region, Segmentation, Significance, State, words,
};
use crate::{present, proto};

/// The answers to one question, with what indices in them stand for.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Answers {
    /// What indices stand for.
    pub labels: Labels,
    /// How many steps later the other is observed; 0 for the same tick.
    pub lag: u32,
    /// One a state, or a region, in the order asked.
    pub answers: Vec<Answer>,
}

/// The answer for one state, or for all states of one region together: then there is no `state`.
/// Fields from `unit` on are absent in the view `verdict`.
///
/// Every information figure is in `unit`. At lag 0 it states dependence given the state; that it
/// runs from ego to other is the caller's assumption.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Answer {
    /// The state; absent for a region.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<State>,
    /// The region in its canonical form, where one was asked about.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Object>)]
    pub region: Option<Region>,
    /// The same in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "distance 1 to 2, held onion or dish")]
    pub region_in_words: Option<String>,
    /// How often it was seen, in the segments asked for.
    pub visits: u64,
    /// How often it was entered; absent unless every transition carried the flag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub entries: Option<u64>,
    /// `influences`, `no_influence` or `undecided`.
    #[schema(example = "undecided", value_type = words::Verdict)]
    pub verdict: &'static str,
    /// What the verdict rests on.
    pub basis: Basis,
    /// The unit of every information figure, `nats` or `bits`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<words::Unit>)]
    pub unit: Option<String>,
    /// The threshold used, in that unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
    /// The same as a share of ln min(R, K), the most that two agents with R and K actions can have;
    /// absent where that is 0: then every verdict is `undecided`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub share: Option<f64>,
    /// The kind of rule that decided, `evidence` or `paper`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<words::RuleKind>)]
    pub rule: Option<String>,
    /// Mutual information of ego action and other action in this state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mutual_information: Option<MutualInformation>,
    /// What the evidence rests on: `entries`, or `assumed` where visits are taken for independent
    /// draws.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<words::Independence>)]
    pub independence: Option<String>,
    /// What the figures of a region are stratified by.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub strata: Option<Strata>,
    /// Of a region: how probable at least as large an excess is under independence within the strata.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub p_value: Option<f64>,
    /// The same of a test that looks for one pattern shared by all strata; absent where none could be
    /// seen. Where actions are held, or some are rare, it finds too much.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub p_value_same_pattern: Option<f64>,
    /// Whether there is any dependence at all, however weak: `established`, `excluded` or `open`;
    /// absent where the alphabets are too large for evidence, as are `probability` and the
    /// posterior mean.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "open", value_type = Option<words::Dependence>)]
    pub dependence: Option<&'static str>,
    /// Probabilities given the counts. Of a region, `dependent` is `dependent_share` and
    /// `above_threshold` that of mean mutual information.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probability: Option<Probability>,
    /// Of a region: the expected share of visits in dependent states, given the counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub dependent_share: Option<f64>,
    /// The segments that the counts come from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub segmentation: Option<Segmentation>,
    /// The test of independence, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub significance: Option<Significance>,
    /// What the reader should know before believing the figures, a sentence each: where pooled and
    /// stratified tests of independence disagree. Absent where there is nothing to warn of.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// Where it was asked for: the smallest of 1, 2, 5, ..., 10,000 further visits after which 4 of
    /// 5 possible futures have a verdict; null where none does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub visits_to_decide: Option<Option<u64>>,
    /// One an ego action, in index order; view `full` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by_action: Option<Vec<ActionFigures>>,
    /// The features that were left out by `features` of the question.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
    /// What the active network says of this state; null where none is active, absent for a region.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<Option<ModelFigures>>,
    /// How many steps later the other is observed; 0 for the same tick.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lag: Option<u32>,
    /// Whether the figures tell a direction, from ego to other: false at lag 0, true at every other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub directed: Option<bool>,
    /// For how many steps on average the two agents go on with an action in this state; at a lag, in
    /// the view `full` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub holds: Option<Holds>,
    /// The fit of the prior that the evidence rests on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fit: Option<Fit>,
    /// How many transitions of the environment the answer stands on. Of a region, at least so many: those
    /// that were counted while its states were passed over may be in it or not; and where that takes
    /// long, it is told as it was made last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub revision: Option<u64>,
}

/// Mean holds, in steps: one for each change of action, by the counts. An action that is chosen again
/// is held, so that who draws one of R at random has R/(R - 1). Where the ego holds its actions, what is
/// true of one lag is true of those beside it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Holds {
    /// The ego's, by its action one step later; null where that is not declared, and where no change
    /// was seen.
    #[schema(minimum = 1)]
    pub ego: Option<f64>,
    /// The other's, by its action one step before that which is asked about; null where that is not
    /// declared, where no change was seen, and for an outcome with values.
    #[schema(minimum = 1)]
    pub other: Option<f64>,
}

impl From<proto::Holds> for Holds {
    fn from(holds: proto::Holds) -> Self {
        let proto::Holds { ego, other } = holds;
        Self { ego, other }
    }
}

/// What a verdict rests on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Basis {
    /// `counts`, `model` (a network's prediction) or `prior` (nothing seen, and no model is
    /// active).
    #[schema(example = "counts", value_type = words::BasisKind)]
    pub kind: &'static str,
    /// The visits it rests on, where it is `counts`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub visits: Option<u64>,
    /// The version of the network it rests on, where it is `model`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<u64>,
}

/// Mutual information of ego action and other action in a state, in the answer's unit.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MutualInformation {
    /// Plug-in, at least 0; 0 at no visits. At few visits most of it is bias: compare
    /// `expected_if_independent`.
    #[schema(minimum = 0)]
    pub plug_in: f64,
    /// The mean of plug-in under independence at these margins.
    pub expected_if_independent: f64,
    /// `hypergeometric` (exact), `asymptotic` (above 1,000 visits) or, under a policy that was not
    /// seen, `permutation`.
    #[schema(value_type = words::NullMethod)]
    pub expected_method: String,
    /// The mean given the counts and the fitted prior, at least 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub posterior_mean: Option<f64>,
    /// Where it lies with a probability of 90 %: the lower and the upper end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interval: Option<[f64; 2]>,
    /// Further estimators that were asked for, by name; these may be negative.
    pub estimates: BTreeMap<String, f64>,
    /// What follows is told of regions alone. Plug-in less its mean under independence. It may be
    /// negative, and is no measure of strength.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub excess: Option<f64>,
    /// Where it lies with a probability of about 95 % under independence: lower and upper end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub null: Option<[f64; 2]>,
    /// Half of Pearson's phi-squared behind the counts, which is the mutual information where that is
    /// weak; may be negative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<f64>,
    /// Where it lies on these segments, with a probability of 95 %.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_interval: Option<[f64; 2]>,
    /// Where it lies on new segments like these, with a probability of 95 %; absent below three
    /// segments.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_interval_new_segments: Option<[f64; 2]>,
    /// The share of draws that `size` stands on: below .5 it is a lower bound, above .8 it is
    /// somewhat too large.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub share: Option<f64>,
    /// Where `features` of the question left some out: the figures with nothing left out, stratified
    /// by these too. Where only the merged ones are large, the cause is in what was left out. Verdict,
    /// probabilities and posterior mean are of these.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stratified: Option<Stratified>,
}

/// What the figures of a region are stratified by: state, actions held fixed, and segment unless
/// `within` is `pooled`. Actions are compared within strata alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Strata {
    /// States with draws; where `features` were named, coarse ones.
    pub states: u64,
    /// Strata with draws.
    pub strata: u64,
    /// Draws: entries where every transition carried the flag, else visits.
    pub draws: u64,
    /// The draws that the size stands on.
    #[schema(minimum = 0)]
    pub effective_visits: f64,
}

/// What strata show together.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Stratified {
    /// What they are.
    pub strata: Strata,
    /// Plug-in mutual information within the strata: their mean by draws.
    #[schema(minimum = 0)]
    pub plug_in: f64,
    /// Its mean under independence within them, exact.
    pub expected_if_independent: f64,
    /// `plug_in` less that.
    pub excess: f64,
    /// Where it lies with a probability of about 95 % under independence: lower and upper end.
    pub null: [f64; 2],
    /// How probable at least as large an excess is under independence.
    #[schema(minimum = 0, maximum = 1)]
    pub p_value: f64,
    /// The same of a test that looks for one pattern shared by all strata; absent where none could be
    /// seen.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub p_value_same_pattern: Option<f64>,
    /// Half of Pearson's phi-squared behind the counts; may be negative.
    pub size: f64,
    /// Where it lies on these segments, with a probability of 95 %.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_interval: Option<[f64; 2]>,
    /// Where it lies on new segments like these, with a probability of 95 %; absent below three
    /// segments.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_interval_new_segments: Option<[f64; 2]>,
    /// The share of draws that `size` stands on.
    #[schema(minimum = 0, maximum = 1)]
    pub share: f64,
}

/// What one ego action was seen to do.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ActionFigures {
    /// Its label.
    pub action: String,
    /// Its index.
    pub index: u64,
    /// How often it was seen in this state, or in the region: its draws.
    pub visits: u64,
    /// KL(p(other given this action) from p(other)), its mean given the counts, in the answer's
    /// unit: rank actions by it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub divergence: Option<f64>,
    /// Where that divergence lies with a probability of 90 %: the lower and the upper end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interval: Option<[f64; 2]>,
    /// The same by relative frequencies; null when unvisited. Favours the rarest action.
    pub plug_in_divergence: Option<f64>,
    /// Probability of each of the other's actions after it given the counts, in index order.
    /// Without evidence the relative frequency, null when unvisited.
    pub response: Option<Vec<f64>>,
    /// Where each of these probabilities lies with a probability of 90 %.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub response_intervals: Vec<[f64; 2]>,
    /// Of a region, where `response` is the relative frequencies over all strata: their mean under
    /// independence within each. `plug_in_divergence` is that of the two then.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub response_if_independent: Vec<f64>,
    /// Of a region: the mean of `plug_in_divergence` under independence, to the second order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected_divergence: Option<f64>,
}

/// Returns the word for a verdict.
pub fn verdict(number: i32) -> &'static str {
    match proto::Verdict::try_from(number) {
        Ok(proto::Verdict::Influences) => "influences",
        Ok(proto::Verdict::NoInfluence) => "no_influence",
        Ok(proto::Verdict::Undecided) => "undecided",
        // A newer service may know a word that this client does not.
        Ok(proto::Verdict::Unspecified) | Err(_) => "unknown",
    }
}

/// Decodes what a verdict on a state with these visits rests on.
pub(super) fn basis(number: i32, version: Option<u64>, visits: u64) -> Basis {
    let (kind, visits, version) = match proto::Basis::try_from(number) {
        Ok(proto::Basis::Counts) => ("counts", Some(visits), None),
        Ok(proto::Basis::Model) => ("model", None, version),
        Ok(proto::Basis::Prior) => ("prior", None, None),
        Ok(proto::Basis::Unspecified) | Err(_) => ("unknown", None, None),
    };
    Basis {
        kind,
        visits,
        version,
    }
}

impl From<proto::BatchGetInfluenceResponse> for Answers {
    fn from(response: proto::BatchGetInfluenceResponse) -> Self {
        Self {
            labels: response.labels.map(Into::into).unwrap_or_default(),
            lag: response.lag,
            answers: response.answers.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::GetInfluenceResponse> for Answers {
    fn from(response: proto::GetInfluenceResponse) -> Self {
        Self {
            labels: response.labels.map(Into::into).unwrap_or_default(),
            lag: response.lag,
            answers: response.answer.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::Answer> for Answer {
    fn from(answer: proto::Answer) -> Self {
        let basis = basis(answer.basis, answer.basis_version, answer.visits);
        let by_action: Vec<ActionFigures> = answer.by_action.into_iter().map(Into::into).collect();
        // In the view `verdict` nothing is said of a network; otherwise it is said that there is
        // none.
        let model = (answer.mutual_information.is_some() && answer.region.is_none())
            .then(|| answer.model.map(Into::into));

        Self {
            state: answer.state.map(Into::into),
            region: answer.region.map(|region| Region(region.into())),
            region_in_words: present(answer.region_in_words),
            visits: answer.visits,
            entries: answer.entries,
            verdict: verdict(answer.verdict),
            basis,
            unit: present(answer.unit),
            threshold: answer.threshold,
            share: answer.share,
            rule: present(answer.rule),
            mutual_information: answer.mutual_information.map(Into::into),
            // An agent has an action at least, so that nothing means "not asked for".
            by_action: Some(by_action).filter(|figures| !figures.is_empty()),
            independence: present(answer.independence),
            strata: answer.strata.map(Into::into),
            p_value: answer.p_value,
            p_value_same_pattern: answer.p_value_same_pattern,
            dependent_share: answer.dependent_share,
            left_out: answer.left_out,
            dependence: dependence(answer.dependence),
            probability: answer.probability.map(Into::into),
            segmentation: answer.segmentation.map(Into::into),
            significance: answer.significance.map(Into::into),
            warnings: answer.warnings,
            visits_to_decide: answer.visits_to_decide.map(|needed| needed.visits),
            model,
            lag: answer.lag,
            directed: answer.directed,
            holds: answer.holds.map(Into::into),
            fit: answer.fit.map(Into::into),
            revision: answer.revision,
        }
    }
}

impl From<proto::MutualInformation> for MutualInformation {
    fn from(figures: proto::MutualInformation) -> Self {
        Self {
            plug_in: figures.plug_in,
            expected_if_independent: figures.expected_if_independent,
            expected_method: figures.expected_method,
            estimates: figures.estimates.into_iter().collect(),
            posterior_mean: figures.posterior_mean,
            interval: figures.interval.map(interval),
            excess: figures.excess,
            null: figures.null.map(ends),
            size: figures.size,
            size_interval: figures.size_interval.map(ends),
            size_interval_new_segments: figures.size_interval_new_segments.map(ends),
            share: figures.share,
            stratified: figures.stratified.map(Into::into),
        }
    }
}

impl From<proto::Strata> for Strata {
    fn from(strata: proto::Strata) -> Self {
        Self {
            states: strata.states,
            strata: strata.strata,
            draws: strata.draws,
            effective_visits: strata.effective_visits,
        }
    }
}

impl From<proto::Stratified> for Stratified {
    fn from(figures: proto::Stratified) -> Self {
        Self {
            strata: figures.strata.unwrap_or_default().into(),
            plug_in: figures.plug_in,
            expected_if_independent: figures.expected_if_independent,
            excess: figures.excess,
            null: ends(figures.null.unwrap_or_default()),
            p_value: figures.p_value,
            p_value_same_pattern: figures.p_value_same_pattern,
            size: figures.size,
            size_interval: figures.size_interval.map(ends),
            size_interval_new_segments: figures.size_interval_new_segments.map(ends),
            share: figures.share,
        }
    }
}

impl From<proto::ActionFigures> for ActionFigures {
    fn from(figures: proto::ActionFigures) -> Self {
        Self {
            action: figures.action,
            index: figures.index,
            visits: figures.visits,
            divergence: figures.divergence,
            interval: figures.divergence_interval.map(interval),
            plug_in_divergence: figures.plug_in_divergence,
            response: Some(figures.response).filter(|response| !response.is_empty()),
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn verdict_only() -> proto::Answer {
        proto::Answer {
            state: Some(proto::State {
                key: "3.0".into(),
                bins: Vec::new(),
            }),
            visits: 12,
            verdict: proto::Verdict::NoInfluence.into(),
            basis: proto::Basis::Counts.into(),
            ..proto::Answer::default()
        }
    }

    fn with_figures() -> proto::Answer {
        let bin = |feature: &str, bin, label: &str| proto::Bin {
            feature: feature.into(),
            bin,
            label: label.into(),
        };
        proto::Answer {
            state: Some(proto::State {
                key: "3.0".into(),
                bins: vec![bin("z", 3, "[2, 3)"), bin("a", 0, "left")],
            }),
            entries: Some(7),
            unit: "nats".into(),
            threshold: Some(0.5),
            share: Some(0.25),
            rule: "paper".into(),
            mutual_information: Some(proto::MutualInformation {
                plug_in: 0.25,
                expected_if_independent: 0.125,
                expected_method: "hypergeometric".into(),
                estimates: [("excess".to_owned(), 0.125)].into(),
                posterior_mean: Some(0.1),
                interval: Some(proto::Interval {
                    lower: 0.0,
                    upper: 0.4,
                }),
                ..proto::MutualInformation::default()
            }),
            independence: "entries".into(),
            dependence: proto::Dependence::Open.into(),
            probability: Some(proto::Probability {
                dependent: 0.3,
                above_threshold: 0.1,
            }),
            segmentation: Some(proto::Segmentation {
                count: 3,
                differ: None,
            }),
            warnings: vec!["beware".into()],
            visits_to_decide: Some(proto::VisitsToDecide { visits: None }),
            fit: Some(proto::Fit {
                version: 2,
                revision: 90,
            }),
            lag: Some(0),
            directed: Some(false),
            revision: Some(99),
            ..verdict_only()
        }
    }

    fn full() -> proto::Answer {
        let figures = |index, visits, plug_in_divergence, response| proto::ActionFigures {
            action: format!("a{index}"),
            index,
            visits,
            plug_in_divergence,
            response,
            ..proto::ActionFigures::default()
        };
        let by_action = vec![
            figures(0, 12, Some(0.0), vec![0.5, 0.5]),
            figures(1, 0, None, Vec::new()),
        ];
        proto::Answer {
            by_action,
            ..with_figures()
        }
    }

    fn as_json(answer: proto::Answer) -> serde_json::Value {
        serde_json::to_value(Answer::from(answer)).expect("JSON")
    }

    fn as_text(answer: proto::Answer) -> String {
        serde_json::to_string(&Answer::from(answer)).expect("JSON")
    }

    #[test]
    fn the_verdict_view_is_short() {
        let expected = r#"{"state":{"key":"3.0"},"visits":12,"verdict":"no_influence","basis":{"kind":"counts","visits":12}}"#;
        assert_eq!(as_text(verdict_only()), expected);
    }

    #[test]
    fn figures_keep_the_order_of_features() {
        let expected = concat!(
            r#"{"state":{"key":"3.0","bins":{"z":{"bin":3,"label":"[2, 3)"},"a":{"bin":0,"label":"left"}}},"#,
            r#""visits":12,"entries":7,"verdict":"no_influence","basis":{"kind":"counts","visits":12},"#,
            r#""unit":"nats","threshold":0.5,"share":0.25,"rule":"paper","#,
            r#""mutual_information":{"plug_in":0.25,"expected_if_independent":0.125,"#,
            r#""expected_method":"hypergeometric","posterior_mean":0.1,"interval":[0.0,0.4],"#,
            r#""estimates":{"excess":0.125}},"independence":"entries","dependence":"open","#,
            r#""probability":{"dependent":0.3,"above_threshold":0.1},"segmentation":{"count":3,"differ":null},"warnings":["beware"],"visits_to_decide":null,"#,
            r#""model":null,"lag":0,"directed":false,"fit":{"version":2,"revision":90},"revision":99}"#
        );
        assert_eq!(as_text(with_figures()), expected);
    }

    #[test]
    fn an_action_that_was_not_taken_has_no_figures() {
        let answer: serde_json::Value = serde_json::from_str(&as_text(full())).expect("JSON");
        let expected = json!([
            {"action": "a0", "index": 0, "visits": 12, "plug_in_divergence": 0.0, "response": [0.5, 0.5]},
            {"action": "a1", "index": 1, "visits": 0, "plug_in_divergence": null, "response": null},
        ]);
        assert_eq!(answer["by_action"], expected);
    }

    #[test]
    fn a_prior_has_no_visits_and_a_model_has_a_version() {
        let prior = proto::Answer {
            basis: proto::Basis::Prior.into(),
            ..verdict_only()
        };
        assert_eq!(as_json(prior)["basis"], json!({"kind": "prior"}));
        let model = proto::Answer {
            basis: proto::Basis::Model.into(),
            basis_version: Some(3),
            ..verdict_only()
        };
        assert_eq!(
            as_json(model)["basis"],
            json!({"kind": "model", "version": 3})
        );
    }

    #[test]
    fn a_network_has_its_place_beside_the_counts() {
        let model = Some(proto::ModelFigures {
            version: 3,
            ..proto::ModelFigures::default()
        });
        let answer = Answer::from(proto::Answer {
            model,
            ..with_figures()
        });
        assert_eq!(answer.model.flatten().expect("told").version, 3);
        assert_eq!(Answer::from(verdict_only()).model, None);
    }
}
