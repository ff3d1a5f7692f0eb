//! The stored form of a card: versioned JSON of our own, beside its weights and in their file,
//! where people and other tools read it too. And that of a pair: its variables by position.
//!
//! The second form is the first one of a network at a lag, which says so. Networks of one tick are
//! written in the first, as ever: builds that know of no lags read them, and refuse the others.

use serde::{Deserialize, Serialize};

use crate::domain::{
    Calibration, Card, FitId, ModelKind, Pair, Reliability, Schema, Score, Training, Weighting,
};
use crate::store::form::{self, Unreadable};

/// The version of the form of a network of one tick.
const FORM: u32 = 1;

/// The version of the form of a network at a lag.
const FORM_AT_LAG: u32 = 2;

/// What was left out of a network that was trained by a build whose cards do not tell.
const DROPOUT_BEFORE_IT_WAS_TOLD: f64 = 0.5;

#[derive(Serialize, Deserialize)]
struct CardText {
    training: TrainingText,
    /// In the second form only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    lag: Option<u32>,
    imported: bool,
    schema_hash: String,
    threshold: f64,
    revision: u64,
    fit: FitText,
    states: u64,
    visits: u64,
    inputs: u64,
    split: String,
    epochs: Vec<u64>,
    dropout: Option<f64>,
    judged_states: u64,
    positive_share: f64,
    calibration: CalibrationText,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    base_rate: Option<f64>,
    score: ScoreText,
    baselines: Vec<ScoreText>,
    reliability: Vec<ReliabilityText>,
    not_better_than: Vec<String>,
}

#[derive(Serialize, Deserialize)]
struct TrainingText {
    kind: String,
    width: usize,
    members: usize,
    folds: usize,
    epochs: usize,
    weighting: String,
    seed: u64,
}

#[derive(Serialize, Deserialize)]
struct FitText {
    version: u64,
    revision: u64,
}

#[derive(Serialize, Deserialize)]
struct CalibrationText {
    intercept: f64,
    slope: f64,
}

#[derive(Serialize, Deserialize)]
struct ScoreText {
    name: String,
    log_likelihood: Option<f64>,
    auroc: Option<f64>,
    precision: Option<f64>,
    recall: Option<f64>,
    f1: f64,
    brier: f64,
}

#[derive(Serialize, Deserialize)]
struct ReliabilityText {
    from: f64,
    states: u64,
    predicted: f64,
    observed: f64,
}

/// Writes a card.
pub fn write_card(card: &Card) -> String {
    let Card {
        training,
        fit,
        calibration,
        ..
    } = card;
    let form = if card.lag == 0 { FORM } else { FORM_AT_LAG };
    form::write(
        form,
        &CardText {
            training: write_training(training),
            lag: Some(card.lag).filter(|lag| *lag > 0),
            imported: card.imported,
            schema_hash: card.schema_hash.clone(),
            threshold: card.threshold,
            revision: card.revision,
            fit: FitText {
                version: fit.version,
                revision: fit.revision,
            },
            states: card.states,
            visits: card.visits,
            inputs: card.inputs,
            split: card.split.clone(),
            epochs: card.epochs.clone(),
            dropout: Some(card.dropout),
            judged_states: card.judged_states,
            positive_share: card.positive_share,
            calibration: CalibrationText {
                intercept: calibration.intercept,
                slope: calibration.slope,
            },
            base_rate: card.base_rate,
            score: write_score(&card.score),
            baselines: card.baselines.iter().map(write_score).collect(),
            reliability: card.reliability.iter().map(write_tenth).collect(),
            not_better_than: card.not_better_than.clone(),
        },
    )
}

/// Reads a card back.
pub fn read_card(text: &str) -> Result<Card, Unreadable> {
    let form = form::version(text)?;
    if !(FORM..=FORM_AT_LAG).contains(&form) {
        return Err(Unreadable::Newer {
            found: form,
            newest: FORM_AT_LAG,
        });
    }

    let content: CardText = form::read_content(text)?;
    match (form, content.lag) {
        (FORM, None) => read_content(content, 0),
        (FORM_AT_LAG, Some(lag)) if lag > 0 => read_content(content, lag),
        (form, lag) => {
            let lag = lag.map_or_else(|| "none".to_owned(), |lag| lag.to_string());
            Err(Unreadable::spoiled(format!(
                "lag {lag} in form {form}, expected none in form {FORM}, and one above 0 in form {FORM_AT_LAG}"
            )))
        }
    }
}

fn read_content(text: CardText, lag: u32) -> Result<Card, Unreadable> {
    let untold = if text.imported {
        0.0
    } else {
        DROPOUT_BEFORE_IT_WAS_TOLD
    };
    Ok(Card {
        training: read_training(text.training)?,
        lag,
        imported: text.imported,
        schema_hash: text.schema_hash,
        threshold: text.threshold,
        revision: text.revision,
        fit: FitId {
            version: text.fit.version,
            revision: text.fit.revision,
        },
        states: text.states,
        visits: text.visits,
        inputs: text.inputs,
        split: text.split,
        epochs: text.epochs,
        dropout: text.dropout.unwrap_or(untold),
        judged_states: text.judged_states,
        positive_share: text.positive_share,
        calibration: Calibration {
            intercept: text.calibration.intercept,
            slope: text.calibration.slope,
        },
        base_rate: text.base_rate.map(share).transpose()?,
        score: read_score(text.score),
        baselines: text.baselines.into_iter().map(read_score).collect(),
        reliability: text.reliability.into_iter().map(read_tenth).collect(),
        not_better_than: text.not_better_than,
    })
}

/// Verdicts are held against it, so it must be what it is called.
fn share(base_rate: f64) -> Result<f64, Unreadable> {
    match (0.0..=1.0).contains(&base_rate) {
        true => Ok(base_rate),
        false => Err(Unreadable::spoiled(format!(
            "base_rate {base_rate}, expected 0 to 1"
        ))),
    }
}

/// Says where a card is of another lag than the pair that it stands beside.
pub fn check_lag(card: &Card, schema: &Schema, pair: &Pair) -> Result<(), String> {
    let (told, lag) = (card.lag, pair.lag(schema));
    if told != lag {
        return Err(format!("is of lag {told}, expected {lag}"));
    }
    Ok(())
}

/// Returns the position by which the registry knows the other: that of the agent, or behind all
/// agents that of the outcome which is its action later. To builds that know of no lags such a
/// position is none of an agent.
pub fn write_other(schema: &Schema, pair: &Pair) -> usize {
    pair.later
        .map_or(pair.other, |outcome| schema.agents().len() + outcome)
}

/// Reads a pair by its positions, or says which is none of it.
pub fn read_pair(schema: &Schema, ego: usize, other: usize) -> Result<Pair, String> {
    let (agents, outcomes) = (schema.agents().len(), schema.outcomes());
    if ego >= agents {
        return Err(format!(
            "its ego: got position {ego}, expected 0 to {}",
            agents - 1
        ));
    }
    if other < agents {
        return Ok(Pair::new(ego, other, Vec::new()));
    }

    let Some(outcome) = outcomes.get(other - agents) else {
        let last = agents + outcomes.len() - 1;
        return Err(format!(
            "its other: got position {other}, expected 0 to {last}"
        ));
    };
    let got = format!("its other: got position {other}, which is {}", outcome.name);
    match outcome.agent {
        None => Err(format!("{got}, expected an agent's action")),
        Some(agent) if agent == ego => Err(format!("{got}, of the ego itself; expected another's")),
        Some(agent) => Ok(Pair {
            later: Some(other - agents),
            ..Pair::new(ego, agent, Vec::new())
        }),
    }
}

fn write_training(training: &Training) -> TrainingText {
    let Training {
        kind,
        width,
        members,
        folds,
        epochs,
        weighting,
        seed,
    } = *training;
    let (kind, weighting) = (kind.as_str().to_owned(), weighting.as_str().to_owned());
    TrainingText {
        kind,
        width,
        members,
        folds,
        epochs,
        weighting,
        seed,
    }
}

fn read_training(text: TrainingText) -> Result<Training, Unreadable> {
    let TrainingText {
        kind,
        width,
        members,
        folds,
        epochs,
        weighting,
        seed,
    } = text;
    let kind: ModelKind = kind
        .parse()
        .map_err(|error: String| Unreadable::spoiled(format!("kind: {error}")))?;
    let weighting: Weighting = weighting
        .parse()
        .map_err(|error: String| Unreadable::spoiled(format!("weighting: {error}")))?;
    Ok(Training {
        kind,
        width,
        members,
        folds,
        epochs,
        weighting,
        seed,
    })
}

fn write_score(score: &Score) -> ScoreText {
    let Score {
        name,
        log_likelihood,
        auroc,
        precision,
        recall,
        f1,
        brier,
    } = score.clone();
    ScoreText {
        name,
        log_likelihood,
        auroc,
        precision,
        recall,
        f1,
        brier,
    }
}

fn read_score(text: ScoreText) -> Score {
    let ScoreText {
        name,
        log_likelihood,
        auroc,
        precision,
        recall,
        f1,
        brier,
    } = text;
    Score {
        name,
        log_likelihood,
        auroc,
        precision,
        recall,
        f1,
        brier,
    }
}

fn write_tenth(tenth: &Reliability) -> ReliabilityText {
    let Reliability {
        from,
        states,
        predicted,
        observed,
    } = *tenth;
    ReliabilityText {
        from,
        states,
        predicted,
        observed,
    }
}

fn read_tenth(text: ReliabilityText) -> Reliability {
    let ReliabilityText {
        from,
        states,
        predicted,
        observed,
    } = text;
    Reliability {
        from,
        states,
        predicted,
        observed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft, OutcomeDraft};

    /// As it was written by builds before cards told of dropout and of their version.
    const FIRST: &str = r#"{"training":{"kind":"direct","width":64,"members":3,"folds":5,"epochs":140,"weighting":"states",
        "seed":18446744073709551615},"imported":false,"schema_hash":"ab12","threshold":0.5,"revision":900,
        "fit":{"version":2,"revision":850},"states":60,"visits":900,"inputs":7,"split":"by states","epochs":[41,38],
        "judged_states":12,"positive_share":0.25,"calibration":{"intercept":1.5,"slope":0.75},
        "score":{"name":"network","log_likelihood":-1.25,"auroc":0.9,"precision":null,"recall":0.7,"f1":0.5,"brier":0.125},
        "baselines":[{"name":"majority","log_likelihood":null,"auroc":null,"precision":null,"recall":null,"f1":0.0,"brier":0.2}],
        "reliability":[{"from":0.1,"states":4,"predicted":0.15,"observed":0.2}],"not_better_than":["majority"]}"#;

    #[test]
    fn the_first_card_is_read_with_what_it_has() {
        let read = read_card(FIRST).expect("a card");
        assert_eq!(
            (read.dropout, read.training.seed, read.training.kind),
            (0.5, u64::MAX, ModelKind::Direct)
        );
        assert_eq!(read.base_rate, None);
        assert_eq!(
            (
                read.fit.version,
                read.epochs.as_slice(),
                read.baselines.len()
            ),
            (2, &[41, 38][..], 1)
        );
        let imported =
            read_card(&FIRST.replace("\"imported\":false", "\"imported\":true")).expect("a card");
        assert_eq!(imported.dropout, 0.0, "nobody left anything out here");
    }

    #[test]
    fn a_card_reads_back_exactly_and_says_its_version() {
        let told = Card {
            dropout: 0.2,
            base_rate: Some(0.1 + 0.2),
            ..read_card(FIRST).expect("a card")
        };
        for written in [
            Card {
                base_rate: None,
                ..told.clone()
            },
            told,
        ] {
            let text = write_card(&written);
            assert!(text.starts_with(r#"{"form":1,"training":{"#), "{text}");
            assert!(!text.contains("lag"), "{text}");
            assert_eq!(read_card(&text), Ok(written));
        }
    }

    #[test]
    fn a_card_at_a_lag_has_a_form_of_its_own() {
        let written = Card {
            lag: 3,
            ..read_card(FIRST).expect("a card")
        };
        let text = write_card(&written);
        assert!(text.starts_with(r#"{"form":2,"training":{"#), "{text}");
        assert_eq!(read_card(&text), Ok(written));

        let why = |text: &str| read_card(text).expect_err("not a card").to_string();
        for (wrong, lag) in [
            (text.replace("\"form\":2", "\"form\":1"), "lag 3 in form 1"),
            (text.replace("\"lag\":3", "\"lag\":0"), "lag 0 in form 2"),
            (text.replace("\"lag\":3,", ""), "lag none in form 2"),
            (text.replace("\"lag\":3", "\"lag\":-3"), "invalid value"),
        ] {
            assert!(why(&wrong).contains(lag), "{}", why(&wrong));
        }
    }

    #[test]
    fn positions_read_back_and_others_say_what_they_are() {
        let schema = SchemaDraft {
            state: vec![feature("place")],
            agents: ["a", "b"].map(agent).into(),
            outcomes: vec![OutcomeDraft {
                name: "pot".into(),
                lag: Some(1),
                value: vec![feature("holds")],
                ..OutcomeDraft::default()
            }],
            lags: vec![1, 3],
        };
        let schema = Schema::try_from(&schema).expect("valid");
        for lag in [0, 1, 3] {
            for (ego, other) in [(0, 1), (1, 0)] {
                let pair = Pair::new(ego, other, Vec::new())
                    .at_lag(&schema, lag)
                    .expect("declared");
                assert_eq!(
                    read_pair(&schema, ego, write_other(&schema, &pair)),
                    Ok(pair)
                );
            }
        }

        // Agents, then a@1, a@3, b@1, b@3 and the pot.
        let why = |ego, other| read_pair(&schema, ego, other).expect_err("no pair");
        assert_eq!(why(2, 1), "its ego: got position 2, expected 0 to 1");
        assert_eq!(why(0, 7), "its other: got position 7, expected 0 to 6");
        assert_eq!(
            why(0, 6),
            "its other: got position 6, which is pot, expected an agent's action"
        );
        assert_eq!(
            why(1, 5),
            "its other: got position 5, which is b@3, of the ego itself; expected another's"
        );
    }

    fn feature(name: &str) -> FeatureDraft {
        FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![KindDraft::Integer(0, 2)],
        }
    }

    fn agent(name: &str) -> AgentDraft {
        AgentDraft {
            name: name.into(),
            action: vec![feature("move")],
            ..AgentDraft::default()
        }
    }

    #[test]
    fn what_cannot_be_read_says_why() {
        let why = |text: &str| read_card(text).expect_err("not a card").to_string();
        assert_eq!(
            why(&FIRST.replacen('{', "{\"form\":9,", 1)),
            "it has form 9 of a newer build, and this one reads up to 2"
        );
        assert!(
            why("{}").contains("missing field `training`"),
            "{}",
            why("{}")
        );
        assert!(
            why(&FIRST.replace("direct", "deep"))
                .contains("got \"deep\", expected joint or direct")
        );
        for wrong in ["-0.1", "1.5"] {
            let spoiled = FIRST.replace("\"score\"", &format!("\"base_rate\":{wrong},\"score\""));
            assert!(
                why(&spoiled).contains("expected 0 to 1"),
                "{}",
                why(&spoiled)
            );
        }
        assert!(why("").contains("EOF"), "{}", why(""));
    }

    #[test]
    fn no_card_is_written_that_would_not_be_read() {
        let written = Card {
            positive_share: f64::NAN,
            ..read_card(FIRST).expect("a card")
        };
        assert!(
            read_card(&write_card(&written)).is_err(),
            "JSON has no word for it, so a keeper has to look"
        );
    }
}
