//! What networks say of themselves, for people: how they did beside every baseline, and whether
//! they answer.

use super::output::{Table, count, figure, figure_or_dash, significant};
use crate::api::json::{job_state, model_kind, weighting};
use crate::api::proto;
use crate::domain::ModelId;

/// Returns what one version says of itself.
pub(super) fn render(environment: &str, model: &proto::Model) -> String {
    let card = model.card.clone().unwrap_or_default();
    let (ego, other, version) = (&model.ego, later(&model.other, model.lag), model.version);
    let heading = format!("{environment}: {ego} on {other}, model version {version}");
    if model.unreadable.is_some() {
        return format!("{heading}\n\n{}\n", standing(environment, model, &card));
    }

    let standing = format!("{}\n", standing(environment, model, &card));
    format!(
        "{heading}\n\n{}\n{}\n{}{standing}",
        facts(&card),
        scores(&card),
        reliability(&card)
    )
}

/// Returns the name of the other as it is observed: at a lag with the lag behind it.
pub(super) fn later(other: &str, lag: u32) -> String {
    match lag {
        0 => other.to_owned(),
        lag => format!("{other}@{lag}"),
    }
}

/// Returns every version and every job, a line each.
pub(super) fn list(environment: &str, response: &proto::ListModelsResponse) -> String {
    let models = match response.models.is_empty() {
        true => format!("no models yet: `nudge train {environment}` makes one\n"),
        false => versions(&response.models),
    };
    if response.jobs.is_empty() {
        models
    } else {
        format!("{models}\n{}", jobs(&response.jobs))
    }
}

/// Returns how far a job is, in a line.
pub(super) fn job_line(job: &proto::Job) -> String {
    let message = if job.message.is_empty() {
        String::new()
    } else {
        format!(": {}", job.message)
    };
    let (id, state) = (ModelId::Job(job.id), job_state(job.state));
    match job.state() {
        proto::JobState::Running => format!("{id} {state}, {}{message}", how_far(job)),
        _ => format!("{id} {state}{message}"),
    }
}

/// Returns how much of a job is done, and how long the rest will take if that can be told: "34 %,
/// about 2 min left".
fn how_far(job: &proto::Job) -> String {
    let done = format!("{:.0} %", 100.0 * job.progress);
    match job.seconds_left {
        Some(seconds) => format!("{done}, about {} left", about(seconds)),
        None => done,
    }
}

/// Returns a time in a unit of its size.
pub(super) fn about(seconds: f64) -> String {
    match seconds {
        0.0..90.0 => format!("{:.0} s", seconds.max(1.0)),
        90.0..5_400.0 => format!("{:.0} min", seconds / 60.0),
        _ => format!("{:.1} h", seconds / 3_600.0),
    }
}

/// Tells how it was trained, a fact a line.
fn facts(card: &proto::Card) -> String {
    let training = card.training.unwrap_or_default();
    let passes: Vec<String> = card.epochs.iter().copied().map(count).collect();
    let mut facts = vec![
        ("network", network(&training)),
        ("trained on", trained_on(card)),
        ("split", card.split.clone()),
        (
            "passes",
            format!(
                "{} of at most {}, leaving out {} of the hidden units",
                passes.join(", "),
                count(training.epochs),
                // Cards of earlier builds hold what a float makes of it.
                card.dropout as f32
            ),
        ),
        ("judged by", judged_by(card, &training)),
        (
            "threshold",
            format!("{} nats", significant(card.threshold, 6)),
        ),
    ];

    // A direct network has no mutual information to make a probability of.
    if let (proto::ModelKind::Joint, Some(calibration)) = (training.kind(), card.calibration) {
        facts.push(("calibration", calibrated(&calibration)));
    }
    if let Some(base_rate) = card.base_rate {
        facts.push((
            "base rate",
            format!(
                "P(above) {} on average; a verdict needs three times those odds, or a third",
                figure(base_rate)
            ),
        ));
    }
    if card.imported {
        let told = if card.epochs.is_empty() {
            "trained by another tool: nobody knows which states it has seen"
        } else {
            "from a file that Nudge wrote: what it says is what it said there, how it did is measured here"
        };
        facts.push(("imported", told.into()));
    }

    facts
        .iter()
        .map(|(name, fact)| format!("{name:<11}  {fact}\n"))
        .collect()
}

fn network(training: &proto::Training) -> String {
    let proto::Training {
        members,
        width,
        seed,
        ..
    } = training;
    format!(
        "{}, {members} members of {width} units, seed {seed}",
        model_kind(training.kind)
    )
}

fn trained_on(card: &proto::Card) -> String {
    let (states, visits) = (count(card.states), count(card.visits));
    format!(
        "{states} states seen {visits} times, {} numbers a state, at revision {}",
        card.inputs, card.revision
    )
}

fn judged_by(card: &proto::Card, training: &proto::Training) -> String {
    let (states, weighting) = (count(card.judged_states), weighting(training.weighting));
    let (fit, share) = (
        card.fit.unwrap_or_default().version,
        figure(card.positive_share),
    );
    format!(
        "{states} states weighted by {weighting}, with fit {fit} of the prior; share with influence {share}"
    )
}

fn calibrated(calibration: &proto::Calibration) -> String {
    let [intercept, slope] = [calibration.intercept, calibration.slope].map(figure);
    format!("P(above) = logistic({intercept} + {slope} ln(MI + 0.005))")
}

fn scores(card: &proto::Card) -> String {
    let mut table = Table::new(&[
        "judged",
        "log-likelihood (nats)",
        "AUROC",
        "precision",
        "recall",
        "F1",
        "Brier",
    ]);
    for score in card.score.iter().chain(&card.baselines) {
        let figures = [
            score.log_likelihood,
            score.auroc,
            score.precision,
            score.recall,
            Some(score.f1),
            Some(score.brier),
        ];
        table.row(std::iter::once(score.name.clone()).chain(figures.map(figure_or_dash)));
    }
    table.render("")
}

/// Tells whether probabilities are what they say; nothing where nothing was judged.
fn reliability(card: &proto::Card) -> String {
    if card.reliability.is_empty() {
        return String::new();
    }

    let mut table = Table::new(&["P(above)", "states", "predicted", "by the evidence"]);
    for tenth in &card.reliability {
        let range = format!("{:.1} to {:.1}", tenth.from, tenth.from + 0.1);
        table.row([
            range,
            count(tenth.states),
            figure(tenth.predicted),
            figure(tenth.observed),
        ]);
    }

    table.render("") + "\n"
}

/// Says whether it answers, and what can be done about it.
fn standing(environment: &str, model: &proto::Model, card: &proto::Card) -> String {
    let unbeaten = card.not_better_than.join(", ");
    let activate = format!("`nudge model activate {environment} {}`", model.version);
    if let Some(why) = &model.unreadable {
        let end = match model.active {
            true => format!(
                "`nudge model rollback {environment} {}` takes it back",
                model.version
            ),
            false => format!(
                "`nudge model delete {environment} {}` deletes it",
                model.version
            ),
        };
        return format!("cannot be read, answers nothing: {why}; {end}");
    }

    match (model.active, card.not_better_than.is_empty()) {
        _ if model.stale => {
            "stale: the rule has another threshold now, for which it cannot answer; train another"
                .into()
        }
        (true, true) => "active: it answers where counts do not decide".into(),
        (true, false) => format!("active, though it does not beat {unbeaten}"),
        (false, true) => format!("not active: {activate} makes it answer"),
        (false, false) => format!(
            "not active: it does not beat {unbeaten}; {activate} makes it answer all the same"
        ),
    }
}

fn versions(models: &[proto::Model]) -> String {
    let titles = [
        "version",
        "ego",
        "other",
        "kind",
        "state",
        "log-likelihood (nats)",
        "F1",
        "Brier",
        "does not beat",
    ];
    let mut table = Table::new(&titles);
    for model in models {
        if let Some(why) = &model.unreadable {
            let (version, state) = (
                model.version.to_string(),
                if model.active {
                    "unreadable, active"
                } else {
                    "unreadable"
                },
            );
            let dash = || "-".to_owned();
            table.row([
                version,
                model.ego.clone(),
                later(&model.other, model.lag),
                dash(),
                state.into(),
                dash(),
                dash(),
                dash(),
                why.clone(),
            ]);
            continue;
        }
        let card = model.card.clone().unwrap_or_default();
        let score = card.score.unwrap_or_default();
        let state = match (model.stale, model.active) {
            (true, _) => "stale",
            (false, true) => "active",
            (false, false) => "-",
        };
        let unbeaten = match card.not_better_than.is_empty() {
            true => "-".into(),
            false => card.not_better_than.join(", "),
        };
        table.row([
            model.version.to_string(),
            model.ego.clone(),
            later(&model.other, model.lag),
            model_kind(card.training.unwrap_or_default().kind).into(),
            state.into(),
            figure_or_dash(score.log_likelihood),
            figure(score.f1),
            figure(score.brier),
            unbeaten,
        ]);
    }

    table.render("")
}

fn jobs(jobs: &[proto::Job]) -> String {
    let mut table = Table::new(&["job", "ego", "other", "state", "done", "message"]);
    for job in jobs {
        table.row([
            ModelId::Job(job.id).to_string(),
            job.ego.clone(),
            later(&job.other, job.lag),
            job_state(job.state).into(),
            format!("{:.0} %", job.progress * 100.0),
            job.message.clone(),
        ]);
    }
    table.render("")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(name: &str, log_likelihood: Option<f64>, figures: [Option<f64>; 3]) -> proto::Score {
        let [auroc, precision, recall] = figures;
        proto::Score {
            name: name.into(),
            log_likelihood,
            auroc,
            precision,
            recall,
            f1: 0.7512,
            brier: 0.0834,
        }
    }

    fn model() -> proto::Model {
        let training = proto::Training {
            kind: proto::ModelKind::Joint.into(),
            width: 64,
            members: 3,
            folds: 5,
            epochs: 500,
            weighting: proto::Weighting::Visits.into(),
            seed: 7,
        };
        let tenth = |from, states| proto::Reliability {
            from,
            states,
            predicted: from + 0.04,
            observed: from + 0.05,
        };
        let card = proto::Card {
            training: Some(training),
            schema_hash: "ab12".into(),
            threshold: 0.5,
            revision: 40_212,
            fit: Some(proto::Fit {
                version: 2,
                revision: 40_000,
            }),
            states: 812,
            visits: 40_212,
            inputs: 23,
            split: "each member is judged by one of 5 parts of the states".into(),
            epochs: vec![41, 38, 52],
            dropout: 0.5,
            judged_states: 488,
            positive_share: 0.231,
            calibration: Some(proto::Calibration {
                intercept: 1.5,
                slope: 0.75,
            }),
            base_rate: Some(0.2245),
            score: Some(score(
                "network",
                Some(-1.2034),
                [Some(0.9312), Some(0.8), Some(0.7)],
            )),
            baselines: vec![
                score("all_positive", None, [None, Some(0.231), Some(1.0)]),
                score("look_up", Some(-1.5), [Some(0.5), None, Some(0.0)]),
            ],
            reliability: vec![tenth(0.0, 444), tenth(0.8, 44)],
            ..Default::default()
        };
        let (ego, other) = ("robot".into(), "human".into());
        proto::Model {
            version: 3,
            ego,
            other,
            active: true,
            stale: false,
            card: Some(card),
            unreadable: None,
            lag: 0,
        }
    }

    fn worse() -> proto::Model {
        let card = model().card.map(|card| proto::Card {
            not_better_than: vec!["look_up".into(), "shuffled".into()],
            ..card
        });
        proto::Model {
            version: 4,
            active: false,
            card,
            ..model()
        }
    }

    fn job(id: u64, state: proto::JobState, message: &str) -> proto::Job {
        let (ego, other, message) = ("robot".into(), "human".into(), message.into());
        proto::Job {
            id,
            ego,
            other,
            state: state.into(),
            progress: 0.25,
            message,
            ..Default::default()
        }
    }

    #[test]
    fn a_version_is_told_beside_every_baseline() {
        insta::assert_snapshot!(render("hallway", &model()));
    }

    #[test]
    fn versions_and_jobs_are_told_a_line_each() {
        let jobs = vec![
            job(1, proto::JobState::Running, "training member 2 of 3"),
            job(2, proto::JobState::Queued, ""),
        ];
        let response = proto::ListModelsResponse {
            models: vec![model(), worse()],
            jobs,
            ..Default::default()
        };
        insta::assert_snapshot!(list("hallway", &response));
        let nothing = list("hallway", &proto::ListModelsResponse::default());
        assert_eq!(nothing, "no models yet: `nudge train hallway` makes one\n");
    }

    #[test]
    fn its_standing_says_what_can_be_done() {
        let told = |model: proto::Model| {
            standing("hallway", &model, &model.card.clone().unwrap_or_default())
        };
        let worse = worse();
        let cases = [
            (model(), "active: it answers where counts do not decide"),
            (
                proto::Model {
                    active: false,
                    ..model()
                },
                "not active: `nudge model activate hallway 3` makes it answer",
            ),
            (
                worse.clone(),
                "not active: it does not beat look_up, shuffled; `nudge model activate hallway 4` makes it answer all the same",
            ),
            (
                proto::Model {
                    active: true,
                    ..worse
                },
                "active, though it does not beat look_up, shuffled",
            ),
            (
                proto::Model {
                    stale: true,
                    ..model()
                },
                "stale: the rule has another threshold now, for which it cannot answer; train another",
            ),
        ];
        for (model, expected) in cases {
            assert_eq!(told(model), expected);
        }
    }

    #[test]
    fn a_version_that_cannot_be_read_says_why_and_what_can_be_done() {
        let unreadable = proto::Model {
            card: None,
            unreadable: Some("it has form 9".into()),
            ..model()
        };
        let told = render("hallway", &unreadable);
        let expected = "cannot be read, answers nothing: it has form 9; `nudge model rollback hallway 3` takes it back";
        assert_eq!(
            told,
            format!("hallway: robot on human, model version 3\n\n{expected}\n")
        );
        let inactive = proto::Model {
            active: false,
            ..unreadable.clone()
        };
        assert!(
            render("hallway", &inactive).ends_with("; `nudge model delete hallway 3` deletes it\n")
        );

        let response = proto::ListModelsResponse {
            models: vec![model(), unreadable],
            ..Default::default()
        };
        let line = list("hallway", &response)
            .lines()
            .last()
            .map(str::to_owned)
            .unwrap_or_default();
        assert_eq!(
            line.split("  ")
                .filter(|cell| !cell.is_empty())
                .map(str::trim)
                .collect::<Vec<_>>()
                .join("|"),
            "3|robot|human|-|unreadable, active|-|-|-|it has form 9"
        );
    }

    #[test]
    fn a_network_at_a_lag_says_when_the_other_is_observed() {
        let model = proto::Model { lag: 3, ..model() };
        let told = render("hallway", &model);
        assert!(told.starts_with("hallway: robot on human@3, model version 3\n"));
        let job = proto::Job {
            lag: 3,
            ..job(1, proto::JobState::Running, "learns")
        };
        let response = proto::ListModelsResponse {
            models: vec![model],
            jobs: vec![job],
            ..Default::default()
        };
        let listed = list("hallway", &response);
        assert_eq!(listed.matches("human@3").count(), 2, "{listed}");
    }

    #[test]
    fn an_imported_network_says_so() {
        let told = |epochs: Vec<u64>| {
            let card = model().card.map(|card| proto::Card {
                imported: true,
                epochs,
                ..card
            });
            render("hallway", &proto::Model { card, ..model() })
        };
        let [own, foreign] = [told(vec![30]), told(Vec::new())];
        assert!(
            own.contains("\nimported     from a file that Nudge wrote"),
            "{own}"
        );
        assert!(
            foreign.contains("\nimported     trained by another tool"),
            "{foreign}"
        );
    }

    #[test]
    fn a_job_is_a_line() {
        let running = job(3, proto::JobState::Running, "training member 2 of 3");
        assert_eq!(
            job_line(&running),
            "job-3 running, 25 %: training member 2 of 3"
        );
        for (seconds, left) in [
            (0.2, "1 s"),
            (89.0, "89 s"),
            (90.0, "2 min"),
            (5_399.0, "90 min"),
            (9_000.0, "2.5 h"),
        ] {
            let told = job_line(&proto::Job {
                seconds_left: Some(seconds),
                ..running.clone()
            });
            assert_eq!(
                told,
                format!("job-3 running, 25 %, about {left} left: training member 2 of 3")
            );
        }
        assert_eq!(
            job_line(&job(4, proto::JobState::Queued, "")),
            "job-4 queued"
        );
    }
}
