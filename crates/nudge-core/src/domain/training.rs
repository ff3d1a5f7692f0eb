//! The hyperparameters of a training as they were asked for, checked.

use std::ops::RangeInclusive;
use std::str::FromStr;

use super::draft::TrainingDraft;
use super::{Pair, Schema, Training};
use crate::error::{Fault, Problem};

const WIDTH: RangeInclusive<u64> = 1..=Training::MOST_WIDTH as u64;
const MEMBERS: RangeInclusive<u64> = 1..=Training::MOST_MEMBERS as u64;
const FOLDS: RangeInclusive<u64> = Training::FEWEST_FOLDS as u64..=Training::MOST_FOLDS as u64;
const EPOCHS: RangeInclusive<u64> = 1..=10_000;

impl Training {
    /// The most units of a hidden layer.
    pub const MOST_WIDTH: usize = 1_024;
    /// The most networks that are averaged.
    pub const MOST_MEMBERS: usize = 16;
    /// The fewest parts that the states are cut into: one to learn from, one to judge by.
    pub const FEWEST_FOLDS: usize = 2;
    /// The most parts that the states are cut into.
    pub const MOST_FOLDS: usize = 20;

    /// Checks a request and lists every fault; returns whose network it is and how it is trained.
    pub fn new(schema: &Schema, draft: &TrainingDraft) -> Result<(Pair, Self), Problem> {
        let usual = Self::default();
        let mut faults = Vec::new();

        let pair = Pair::of_network(schema, draft.ego.clone(), draft.other.clone(), draft.lag)
            .map_err(|found| faults.extend(found))
            .ok();

        let training = Self {
            kind: word(draft.kind.as_deref(), usual.kind, "/kind", &mut faults),
            width: number(draft.width, usual.width, WIDTH, "/width", &mut faults),
            members: number(
                draft.members,
                usual.members,
                MEMBERS,
                "/members",
                &mut faults,
            ),
            folds: number(draft.folds, usual.folds, FOLDS, "/folds", &mut faults),
            epochs: number(draft.epochs, usual.epochs, EPOCHS, "/epochs", &mut faults),
            weighting: word(
                draft.weighting.as_deref(),
                usual.weighting,
                "/weighting",
                &mut faults,
            ),
            seed: draft.seed.unwrap_or(usual.seed),
        };

        if training.members > training.folds {
            let Self { members, folds, .. } = training;
            let detail = format!(
                "got {members} members for {folds} folds, expected one fold for each at least"
            );
            faults.push(Fault::new("/members", detail));
        }

        match pair {
            Some(pair) if faults.is_empty() => Ok((pair, training)),
            _ => Err(Problem::invalid("training", faults)),
        }
    }
}

fn word<T: FromStr<Err = String>>(
    text: Option<&str>,
    usual: T,
    pointer: &str,
    faults: &mut Vec<Fault>,
) -> T {
    match text.map(str::parse) {
        None => usual,
        Some(Ok(value)) => value,
        Some(Err(detail)) => {
            faults.push(Fault::new(pointer, detail));
            usual
        }
    }
}

fn number(
    asked: Option<u64>,
    usual: usize,
    allowed: RangeInclusive<u64>,
    pointer: &str,
    faults: &mut Vec<Fault>,
) -> usize {
    let Some(asked) = asked else { return usual };
    if !allowed.contains(&asked) {
        faults.push(Fault::new(
            pointer,
            format!(
                "got {asked}, expected {} to {}",
                allowed.start(),
                allowed.end()
            ),
        ));
    }
    asked as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

    fn schema() -> Schema {
        let feature = |name: &str| FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![KindDraft::Integer(0, 3)],
        };
        let agent = |name: &str| AgentDraft {
            name: name.into(),
            action: vec![feature("move")],
            ..AgentDraft::default()
        };
        Schema::try_from(&SchemaDraft {
            state: vec![feature("place")],
            agents: vec![agent("robot"), agent("human")],
            ..SchemaDraft::default()
        })
        .expect("valid")
    }

    #[test]
    fn what_is_absent_has_its_default() {
        let (pair, training) = Training::new(&schema(), &TrainingDraft::default()).expect("valid");
        assert_eq!(
            (pair.ego, pair.other, training),
            (0, 1, Training::default())
        );
    }

    #[test]
    fn every_fault_is_listed() {
        let draft = TrainingDraft {
            ego: Some("cat".into()),
            kind: Some("deep".into()),
            width: Some(0),
            members: Some(6),
            epochs: Some(u64::MAX),
            weighting: Some("x".into()),
            ..TrainingDraft::default()
        };
        let problem = Training::new(&schema(), &draft).expect_err("wrong");
        let pointers: Vec<&str> = problem
            .faults
            .iter()
            .map(|fault| fault.pointer.as_str())
            .collect();
        assert_eq!(
            pointers,
            [
                "/ego",
                "/kind",
                "/width",
                "/epochs",
                "/weighting",
                "/members"
            ]
        );
    }
}
