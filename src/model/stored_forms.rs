//! The stored form of a card: versioned JSON of our own, beside its weights and in their file,
//! where people and other tools read it too.

use serde::{Deserialize, Serialize};

use crate::domain::{Calibration, Card, FitId, ModelKind, Reliability, Score, Training, Weighting};
use crate::store::form::{self, Unreadable};

/// The version of the form that is written.
const FORM: u32 = 1;

/// What was left out of a network that was trained by a build whose cards do not tell.
const DROPOUT_BEFORE_IT_WAS_TOLD: f64 = 0.5;

#[derive(Serialize, Deserialize)]
struct CardText {
    training: TrainingText,
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
    form::write(
        FORM,
        &CardText {
            training: write_training(training),
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
    match form::version(text)? {
        1 => read_first_form(form::read_content(text)?),
        found => Err(Unreadable::Newer {
            found,
            newest: FORM,
        }),
    }
}

fn read_first_form(text: CardText) -> Result<Card, Unreadable> {
    let untold = if text.imported {
        0.0
    } else {
        DROPOUT_BEFORE_IT_WAS_TOLD
    };
    Ok(Card {
        training: read_training(text.training)?,
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
            assert_eq!(read_card(&text), Ok(written));
        }
    }

    #[test]
    fn what_cannot_be_read_says_why() {
        let why = |text: &str| read_card(text).expect_err("not a card").to_string();
        assert_eq!(
            why(&FIRST.replacen('{', "{\"form\":9,", 1)),
            "it has form 9 of a newer build, and this one reads up to 1"
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
