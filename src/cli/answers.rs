//! Rendering of answers about influence: what was found, from how much, beside what chance alone
//! would give.

use super::output::{Table, count, figure, figure_or_dash, percent, significant, steps_later};
use crate::api::json::{dependence, model_kind, verdict};
use crate::api::proto;

/// How many of the other's actions are told after each of the ego's.
const RESPONSES_TOLD: usize = 3;

/// Returns answers as text: one in full, several as a table.
pub(super) fn render(environment: &str, response: &proto::BatchGetInfluenceResponse) -> String {
    let labels = response.labels.clone().unwrap_or_default();
    let heading = heading(environment, &labels, response.lag, &response.answers);
    match response.answers.as_slice() {
        [only] if only.mutual_information.is_some() => {
            format!("{heading}\n\n{}", one(only, &labels))
        }
        all => format!(
            "{heading}\n\n{}{}{}",
            several(all),
            warnings(all),
            by_state(all, &labels)
        ),
    }
}

/// Tells a threshold, which as a share or in another unit has digits without end.
fn written_threshold(threshold: f64) -> String {
    significant(threshold, 6)
}

/// Tells what is asked about, and the rule.
pub(super) fn heading(
    environment: &str,
    labels: &proto::Labels,
    lag: u32,
    answers: &[proto::Answer],
) -> String {
    let given: Vec<&str> = labels
        .given
        .iter()
        .map(|variable| variable.name.as_str())
        .collect();
    let given = if given.is_empty() {
        String::new()
    } else {
        format!(" given {}", given.join(", "))
    };

    let (ego, other) = (name_of(&labels.ego), name_of(&labels.other));
    let first = answers
        .first()
        .filter(|answer| answer.mutual_information.is_some());
    let rule = first.map(|answer| {
        let threshold = written_threshold(answer.threshold.unwrap_or_default());
        let share = answer
            .share
            .map(|share| format!(", {} of the most the two can have", percent(share)));
        format!(
            "\n{} rule, threshold {threshold} {}{}",
            answer.rule,
            answer.unit,
            share.unwrap_or_default()
        )
    });

    format!(
        "{environment}: {ego} on {other}{given}, {}{}",
        steps_later(lag),
        rule.unwrap_or_default()
    )
}

fn name_of(variable: &Option<proto::Variable>) -> String {
    variable
        .as_ref()
        .map(|one| one.name.clone())
        .unwrap_or_default()
}

/// Tells one answer in full.
fn one(answer: &proto::Answer, labels: &proto::Labels) -> String {
    let state = answer.state.clone().unwrap_or_default();
    let mut text = format!("state {}\n", state.key);
    for bin in &state.bins {
        text += &format!("  {} = {}\n", bin.feature, bin.label);
    }

    let entries = answer
        .entries
        .map(|entries| format!(", {} entries", count(entries)))
        .unwrap_or_default();
    text += &format!(
        "\n{}, from {}: {} visits{entries}\n",
        verdict(answer.verdict),
        basis(answer),
        count(answer.visits)
    );
    text += &format!("{}\n", evidence(answer));
    text += &information(answer);
    if !answer.by_action.is_empty() {
        text += &format!("\n{}", by_action(answer, labels));
    }
    text + &by_model(answer, labels)
}

/// Tells what the counts support, a line each.
fn evidence(answer: &proto::Answer) -> String {
    let mut lines: Vec<String> = probabilities(answer)
        .zip(answer.probability)
        .map(|(told, probability)| {
            format!("{told}, P(dependent) {}", figure(probability.dependent))
        })
        .into_iter()
        .collect();
    if let Some(test) = &answer.significance {
        lines.push(format!(
            "test of independence: p = {} ({})",
            figure(test.p_value),
            test.method
        ));
    }
    lines.extend(segmentation(answer));
    lines.extend(holds(answer));
    lines.extend(
        answer
            .warnings
            .iter()
            .map(|warning| format!("warning: {warning}")),
    );
    if let Some(model) = &answer.model {
        lines.push(network(model, answer));
    }
    if let Some(needed) = &answer.visits_to_decide {
        lines.push(match needed.visits {
            Some(visits) => format!("about {} more visits would decide", count(visits)),
            None => "no number of visits up to 10,000 is likely to decide".into(),
        });
    }
    lines.iter().map(|line| format!("{line}\n")).collect()
}

/// Tells how probable influence is by the counts, and whether there is any dependence.
pub(super) fn probabilities(answer: &proto::Answer) -> Option<String> {
    let (probability, threshold) = (answer.probability.as_ref()?, answer.threshold?);
    let (threshold, above) = (
        written_threshold(threshold),
        figure(probability.above_threshold),
    );
    let dependence = dependence(answer.dependence).unwrap_or("unknown");
    Some(format!(
        "by the counts P(above {threshold} {}) {above}; dependence {dependence}",
        answer.unit
    ))
}

/// Tells how many segments the counts come from, where there are several.
pub(super) fn segmentation(answer: &proto::Answer) -> Option<String> {
    let proto::Segmentation {
        count: segments,
        differ,
    } = answer.segmentation.filter(|found| found.count > 1)?;
    let differ = differ.map(|differ| format!(", P(habits differ) {}", figure(differ)));
    Some(format!(
        "from {} segments{}",
        count(segments),
        differ.unwrap_or_default()
    ))
}

/// Tells for how many steps the agents go on with an action, where that is known of one.
fn holds(answer: &proto::Answer) -> Option<String> {
    let proto::Holds { ego, other } = answer.holds?;
    let told = [("the ego's", ego), ("the other's", other)];
    let told: Vec<String> = told
        .into_iter()
        .filter_map(|(whose, hold)| Some(format!("{whose} {}", figure(hold?))))
        .collect();
    (!told.is_empty()).then(|| format!("steps that an action is held: {}", told.join(", ")))
}

/// Tells what a network says of a state.
fn network(model: &proto::ModelFigures, answer: &proto::Answer) -> String {
    let (kind, unit) = (model_kind(model.kind), &answer.unit);
    let above = match (model.probability, answer.threshold) {
        (Some(probability), Some(threshold)) => format!(
            "P(above {} {unit}) {}",
            written_threshold(threshold),
            figure(probability)
        ),
        _ => "cannot tell at this threshold".into(),
    };

    let information = model
        .mutual_information
        .map(|mean| format!(", mutual information {} {unit}", figure(mean)));
    let members = if model.agrees { "agree" } else { "disagree" };
    let outside = match model.out_of_range.is_empty() {
        true => String::new(),
        false => format!(
            "; no verdict, for it was trained without such {}",
            model.out_of_range.join(", ")
        ),
    };

    let (version, information) = (model.version, information.unwrap_or_default());
    format!(
        "model, version {version} ({kind}): {above}{information}; its members {members}{outside}"
    )
}

fn information(answer: &proto::Answer) -> String {
    let information = answer.mutual_information.clone().unwrap_or_default();
    let mut table = Table::new(&["mutual information", &answer.unit]);
    let method = &information.expected_method;
    if let (Some(mean), Some(interval)) = (information.posterior_mean, information.interval) {
        table.row(["posterior mean".into(), figure(mean)]);
        table.row(["90 % from".into(), figure(interval.lower)]);
        table.row(["90 % to".into(), figure(interval.upper)]);
    }
    table.row(["plug-in".into(), figure(information.plug_in)]);
    table.row([
        format!("expected if independent ({method})"),
        figure(information.expected_if_independent),
    ]);
    let mut estimates: Vec<_> = information.estimates.into_iter().collect();
    estimates.sort_by(|a, b| a.0.cmp(&b.0));
    for (name, value) in estimates {
        table.row([name, figure(value)]);
    }

    table.render("  ")
}

fn by_action(answer: &proto::Answer, labels: &proto::Labels) -> String {
    let divergence = format!("divergence ({})", answer.unit);
    let mut table = Table::new(&[
        "action",
        "visits",
        &divergence,
        "from",
        "to",
        "plug-in",
        "answered by",
    ]);

    for action in &answer.by_action {
        table.row([
            action.action.clone(),
            count(action.visits),
            figure_or_dash(action.divergence),
            figure_or_dash(action.divergence_interval.map(|interval| interval.lower)),
            figure_or_dash(action.divergence_interval.map(|interval| interval.upper)),
            figure_or_dash(action.plug_in_divergence),
            most_frequent(&action.response, responses(labels)),
        ]);
    }

    table.render("  ")
}

/// Tells what a network expects of the ego's actions; nothing where it was not asked, or predicts
/// no actions.
fn by_model(answer: &proto::Answer, labels: &proto::Labels) -> String {
    let Some(model) = answer
        .model
        .as_ref()
        .filter(|model| !model.by_action.is_empty())
    else {
        return String::new();
    };

    let divergence = format!("divergence ({})", answer.unit);
    let mut table = Table::new(&["action", "P(action)", &divergence, "answered by"]);
    for action in &model.by_action {
        let answered = most_frequent(&action.response, responses(labels));
        table.row([
            action.action.clone(),
            figure(action.probability),
            figure(action.divergence),
            answered,
        ]);
    }

    format!(
        "\nby model, version {}\n{}",
        model.version,
        table.render("  ")
    )
}

/// Returns the labels of the other's actions.
fn responses(labels: &proto::Labels) -> &[String] {
    labels
        .other
        .as_ref()
        .map(|other| other.actions.as_slice())
        .unwrap_or_default()
}

/// Returns the likeliest responses with their shares: `stay 61 %, north 20 %`.
fn most_frequent(shares: &[f64], labels: &[String]) -> String {
    let mut ranked: Vec<(usize, f64)> = shares
        .iter()
        .copied()
        .enumerate()
        .filter(|(_, share)| *share > 0.0)
        .collect();
    ranked.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let told = ranked.iter().take(RESPONSES_TOLD).map(|(index, share)| {
        let label = labels
            .get(*index)
            .cloned()
            .unwrap_or_else(|| format!("#{index}"));
        format!("{label} {:.0} %", share * 100.0)
    });

    told.collect::<Vec<_>>().join(", ")
}

/// Tells several answers a line each.
fn several(answers: &[proto::Answer]) -> String {
    let with_figures = answers
        .iter()
        .any(|answer| answer.mutual_information.is_some());
    let mut titles = vec!["state", "visits", "verdict", "basis"];
    if with_figures {
        titles.extend([
            "P(above)",
            "dependence",
            "posterior mean",
            "plug-in",
            "if independent",
            "unit",
        ]);
    }
    let with_model = answers.iter().any(|answer| answer.model.is_some());
    if with_model {
        titles.push("P(model)");
    }
    let mut table = Table::new(&titles);
    for answer in answers {
        let key = answer.state.clone().unwrap_or_default().key;
        let mut row = vec![
            key,
            count(answer.visits),
            verdict(answer.verdict).into(),
            basis(answer),
        ];
        if with_figures {
            let information = answer.mutual_information.clone().unwrap_or_default();
            let above = answer
                .probability
                .map(|probability| probability.above_threshold);
            row.push(figure_or_dash(above));
            row.push(dependence(answer.dependence).unwrap_or("-").into());
            row.push(figure_or_dash(information.posterior_mean));
            row.extend([information.plug_in, information.expected_if_independent].map(figure));
            row.push(answer.unit.clone());
        }
        if with_model {
            row.push(figure_or_dash(
                answer.model.as_ref().and_then(|model| model.probability),
            ));
        }
        table.row(row);
    }

    table.render("")
}

/// Tells the warnings of several answers, a line each.
fn warnings(answers: &[proto::Answer]) -> String {
    let told: String = answers.iter().map(warnings_of).collect();
    if told.is_empty() {
        told
    } else {
        format!("\n{told}")
    }
}

fn warnings_of(answer: &proto::Answer) -> String {
    let key = answer.state.clone().unwrap_or_default().key;
    answer
        .warnings
        .iter()
        .map(|warning| format!("warning, state {key}: {warning}\n"))
        .collect()
}

/// Tells the ego's actions of each answer that has them.
fn by_state(answers: &[proto::Answer], labels: &proto::Labels) -> String {
    let full = answers.iter().filter(|answer| !answer.by_action.is_empty());
    full.map(|answer| {
        let key = answer.state.clone().unwrap_or_default().key;
        format!(
            "\nstate {key}\n{}{}",
            by_action(answer, labels),
            by_model(answer, labels)
        )
    })
    .collect()
}

/// Tells what a verdict rests on.
pub(super) fn basis(answer: &proto::Answer) -> String {
    match (answer.basis(), answer.basis_version) {
        (proto::Basis::Counts, _) => "counts".into(),
        (proto::Basis::Model, Some(version)) => format!("model, version {version}"),
        (proto::Basis::Model, None) => "model".into(),
        (proto::Basis::Prior, _) => "prior".into(),
        (proto::Basis::Unspecified, _) => "?".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn variable(name: &str, actions: &[&str]) -> Option<proto::Variable> {
        let actions = actions.iter().map(|action| (*action).to_owned()).collect();
        Some(proto::Variable {
            name: name.into(),
            actions,
        })
    }

    fn answer(key: &str) -> proto::Answer {
        let bin = |feature: &str, label: &str| proto::Bin {
            feature: feature.into(),
            bin: 0,
            label: label.into(),
        };
        let action = |action: &str, visits, divergence, response: &[f64]| proto::ActionFigures {
            action: action.into(),
            visits,
            plug_in_divergence: divergence,
            divergence: divergence.map(|divergence| divergence / 2.0),
            divergence_interval: divergence.map(|upper| proto::Interval { lower: 0.0, upper }),
            response: response.to_vec(),
            ..proto::ActionFigures::default()
        };
        proto::Answer {
            state: Some(proto::State {
                key: key.into(),
                bins: vec![bin("distance", "[1, 2)"), bin("lane", "3")],
            }),
            visits: 1_812,
            verdict: proto::Verdict::NoInfluence.into(),
            basis: proto::Basis::Counts.into(),
            entries: Some(40),
            unit: "nats".into(),
            threshold: Some(0.5),
            rule: "paper".into(),
            mutual_information: Some(proto::MutualInformation {
                plug_in: 0.01324,
                expected_if_independent: 0.0121,
                expected_method: "asymptotic".into(),
                estimates: [("excess".to_owned(), 0.00114)].into(),
                posterior_mean: Some(0.0012),
                interval: Some(proto::Interval {
                    lower: 0.0,
                    upper: 0.0143,
                }),
                ..proto::MutualInformation::default()
            }),
            dependence: proto::Dependence::Open.into(),
            probability: Some(proto::Probability {
                dependent: 0.2,
                above_threshold: 0.0,
            }),
            significance: Some(proto::Significance {
                p_value: 0.21,
                method: "permutation".into(),
            }),
            segmentation: Some(proto::Segmentation {
                count: 12,
                differ: Some(0.31),
            }),
            warnings: vec!["pooled p = 0.0010, but within segments p = 0.2100".into()],
            visits_to_decide: Some(proto::VisitsToDecide {
                visits: Some(2_000),
            }),
            by_action: vec![
                action("stay", 1_800, Some(0.01), &[0.25, 0.75]),
                action("go", 0, None, &[]),
            ],
            ..proto::Answer::default()
        }
    }

    fn response(answers: Vec<proto::Answer>) -> proto::BatchGetInfluenceResponse {
        let labels = proto::Labels {
            ego: variable("robot", &["stay", "go"]),
            other: variable("human", &["stay", "go"]),
            given: Vec::new(),
        };
        proto::BatchGetInfluenceResponse {
            labels: Some(labels),
            lag: 0,
            answers,
        }
    }

    #[test]
    fn one_state_is_told_in_full() {
        insta::assert_snapshot!(render("hallway", &response(vec![answer("2.3")])));
    }

    fn decided_by_a_network(key: &str) -> proto::Answer {
        let action = |action: &str, probability, response: &[f64]| proto::ModelAction {
            action: action.into(),
            probability,
            divergence: 0.31,
            response: response.to_vec(),
            ..proto::ModelAction::default()
        };
        let model = proto::ModelFigures {
            version: 3,
            kind: proto::ModelKind::Joint.into(),
            probability: Some(0.8123),
            mutual_information: Some(0.6421),
            agrees: true,
            out_of_range: Vec::new(),
            by_action: vec![
                action("stay", 0.75, &[0.9, 0.1]),
                action("go", 0.25, &[0.2, 0.8]),
            ],
        };
        proto::Answer {
            visits: 2,
            entries: None,
            verdict: proto::Verdict::Influences.into(),
            basis: proto::Basis::Model.into(),
            basis_version: Some(3),
            model: Some(model),
            significance: None,
            segmentation: None,
            warnings: Vec::new(),
            visits_to_decide: None,
            ..answer(key)
        }
    }

    #[test]
    fn a_network_is_told_beside_the_counts() {
        insta::assert_snapshot!(render(
            "hallway",
            &response(vec![decided_by_a_network("2.3")])
        ));
    }

    #[test]
    fn a_network_that_cannot_tell_says_so() {
        let model = proto::ModelFigures {
            version: 3,
            kind: proto::ModelKind::Direct.into(),
            ..Default::default()
        };
        let told = render(
            "hallway",
            &response(vec![proto::Answer {
                model: Some(model),
                ..answer("2.3")
            }]),
        );
        let expected =
            "\nmodel, version 3 (direct): cannot tell at this threshold; its members disagree\n";
        assert!(told.contains(expected), "{told}");
    }

    #[test]
    fn features_out_of_range_are_named() {
        let model = proto::ModelFigures {
            out_of_range: vec!["lane".into(), "sign".into()],
            ..decided_by_a_network("2.3").model.expect("told")
        };
        let told = render(
            "hallway",
            &response(vec![proto::Answer {
                model: Some(model),
                ..answer("2.3")
            }]),
        );
        let expected =
            "; its members agree; no verdict, for it was trained without such lane, sign\n";
        assert!(told.contains(expected), "{told}");
    }

    #[test]
    fn networks_have_a_column_among_several_states() {
        let plain = |answer: proto::Answer| proto::Answer {
            by_action: Vec::new(),
            ..answer
        };
        let answers = vec![plain(answer("2.2")), plain(decided_by_a_network("2.3"))];
        insta::assert_snapshot!(render("hallway", &response(answers)));
    }

    #[test]
    fn several_states_are_told_a_line_each() {
        let plain = proto::Answer {
            by_action: Vec::new(),
            ..answer("2.3")
        };
        let basis = proto::Basis::Prior.into();
        let unseen = proto::Answer {
            visits: 0,
            basis,
            warnings: Vec::new(),
            ..plain.clone()
        };
        insta::assert_snapshot!(render("hallway", &response(vec![plain, unseen])));
    }
}
