//! Tracks by examples, and against what the whole track says at once.

use proptest::prelude::*;

use super::*;
use crate::domain::SchemaDraft;
use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft, OutcomeDraft};

fn feature(name: &str, kind: KindDraft) -> FeatureDraft {
    FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![kind],
    }
}

/// A state of one feature, two agents of two and three actions, the second of two features, lags of
/// both, and a value that is observed some steps later.
fn schema(lags: &[i64], pot: Option<i64>) -> Schema {
    let agent = |name: &str, action| AgentDraft {
        name: name.into(),
        action,
        may_be_absent: true,
    };
    let pot = pot.map(|lag| OutcomeDraft {
        name: "pot".into(),
        lag: Some(lag),
        value: vec![feature("pot.onions", KindDraft::Integer(0, 3))],
        ..OutcomeDraft::default()
    });
    let draft = SchemaDraft {
        state: vec![feature("distance", KindDraft::Continuous(vec![1.0, 2.0]))],
        agents: vec![
            agent("a", vec![feature("a.go", KindDraft::Integer(0, 1))]),
            agent(
                "b",
                vec![
                    feature("b.go", KindDraft::Integer(0, 2)),
                    feature("b.side", KindDraft::Integer(0, 0)),
                ],
            ),
        ],
        outcomes: pot.into_iter().collect(),
        lags: lags.to_vec(),
    };
    Schema::try_from(&draft).expect("valid")
}

/// Returns the flags of steps at these distances, where both agents change their actions at each.
fn flags<const N: usize>(distances: [f32; N]) -> [Entry; N] {
    let mut track = Track::new(&schema(&[], None));
    let mut action = 0.0;
    distances.map(|distance| {
        action = 1.0 - action;
        let step = Step::new(vec![distance], vec![action, action, 0.0]);
        track.step(step).expect("nothing is held back").entry
    })
}

#[test]
fn a_step_enters_when_its_bin_is_another() {
    use Entry::{Entered, Stayed};
    let flags = flags([0.1, 0.9, 1.0, 1.5, 0.5, 0.5]);
    assert_eq!(flags, [Entered, Stayed, Entered, Stayed, Entered, Stayed]);
}

#[test]
fn after_a_state_without_a_key_the_next_step_enters() {
    assert_eq!(flags([0.5, f32::NAN, f32::NAN, 0.5]), [Entry::Entered; 4]);
}

#[test]
fn what_has_no_bin_is_nobodys_action() {
    let mut track = Track::new(&schema(&[1], None));
    let mut step = |distance, a: f32| track.step(Step::new(vec![distance], vec![a, 0.0, 0.0]));
    assert_eq!(step(0.5, 0.0), None);
    let first = step(0.5, 7.0).expect("released");
    assert_eq!(
        first.actions_present,
        [],
        "what will be rejected is sent as it is"
    );
    assert_eq!(first.outcomes, [0.0, 0.0, 0.0]);
    assert_eq!(
        first.outcomes_present,
        [false, true],
        "7 would reject this one, too"
    );
    let misfit = step(0.5, 0.0).expect("released");
    assert_eq!((misfit.actions[0], misfit.entry), (7.0, Entry::Entered));
    let held = step(1.5, 0.0).expect("released");
    assert_eq!(
        held.entry,
        Entry::Stayed,
        "both hold what they did before it"
    );
}

#[test]
fn outcomes_are_what_follows_and_the_end_has_what_is_known() {
    let schema = schema(&[1, 3], Some(1));
    let names: Vec<&str> = schema
        .outcomes()
        .iter()
        .map(|outcome| &outcome.name[..])
        .collect();
    let mut track = Track::new(&schema);
    let step = |at: usize| {
        let step = Step::new(vec![at as f32], vec![(at % 2) as f32, (at % 3) as f32, 0.0]);
        if at == 2 {
            step
        } else {
            step.observing(vec![at as f32])
        }
    };
    let mut records: Vec<Record> = (0..4).filter_map(|at| track.step(step(at))).collect();
    assert_eq!((records.len(), track.held_back()), (1, 3));
    records.extend(track.end());
    assert_eq!(records.len(), 4);

    let of = |record: &Record, name: &str| {
        let at = names.iter().position(|one| *one == name).expect("declared");
        let widths = schema.outcomes().iter().map(|outcome| outcome.value.len());
        let first: usize = widths.take(at).sum();
        let there = record.outcomes_present.get(at).copied().unwrap_or(true);
        (there && !record.outcomes.is_empty()).then(|| record.outcomes[first])
    };
    let all = |name: &str| {
        records
            .iter()
            .map(|record| of(record, name))
            .collect::<Vec<_>>()
    };
    assert_eq!(all("a@1"), [Some(1.0), Some(0.0), Some(1.0), None]);
    assert_eq!(all("b@3"), [Some(0.0), None, None, None]);
    assert_eq!(all("pot"), [Some(1.0), None, Some(3.0), None]);
    assert!(records[3].outcomes.is_empty(), "nothing is known of it");
}

#[test]
fn nothing_of_before_a_gap_is_the_outcome_of_what_came_after_it() {
    let mut track = Track::new(&schema(&[1, 2], None));
    let step = |a: f32| Step::new(vec![0.5], vec![a, a, 0.0]);
    assert_eq!(track.step(step(0.0)), None);
    assert_eq!(track.step(step(1.0)), None);
    let released = track.gap();
    assert_eq!((released.len(), track.held_back()), (2, 0));
    assert_eq!(released[0].outcomes_present, [true, false, true, false]);
    assert!(released[1].outcomes.is_empty());
    assert_eq!(track.step(step(0.0)), None);
    assert_eq!(track.end()[0].entry, Entry::Entered);
}

#[test]
fn who_takes_turns_takes_part_and_who_is_dead_does_not() {
    // The state changes at each step, the first agent acts at each other one and never holds.
    let entries = |lags: &[i64], is_dead: bool, b: fn(usize) -> f32| {
        let mut track = Track::new(&schema(lags, None));
        let step = |at: usize| {
            let acts = vec![at.is_multiple_of(2), !at.is_multiple_of(2) && !is_dead];
            let distance = if at.is_multiple_of(2) { 0.5 } else { 1.5 };
            Step::new(vec![distance], vec![(at / 2 % 2) as f32, b(at), 0.0]).acting(acts)
        };
        let mut records: Vec<Record> = (0..12).filter_map(|at| track.step(step(at))).collect();
        records.extend(track.end());
        let first = records.iter().step_by(2);
        first
            .filter(|record| record.entry == Entry::Entered)
            .count()
    };
    type Moves = fn(usize) -> f32;
    let (holds, changes): (Moves, Moves) = (|_| 1.0, |at| (at / 2 % 2) as f32);
    assert_eq!(entries(&[1], false, changes), 6);
    assert_eq!(
        entries(&[1], false, holds),
        2,
        "its first action, and no other"
    );
    assert_eq!(
        entries(&[], false, holds),
        6,
        "nothing of it is counted with these"
    );
    assert_eq!(entries(&[1], true, holds), 6);
}

/// What a track would release, computed from all its steps at once.
fn by_definition(schema: &Schema, parts: &[Vec<Step>]) -> Vec<Record> {
    let mut rule = EntryRule::new(schema.agents().iter().map(Agent::actions));
    let mut records = Vec::new();
    for part in parts {
        for (at, step) in part.iter().enumerate() {
            let acts = |step: &Step, agent: usize| step.acts.get(agent).copied().unwrap_or(true);
            let of_action = |step: &Step, agent: usize| match agent {
                0 => vec![step.actions[0]],
                _ => step.actions[1..3].to_vec(),
            };
            let value = |outcome: &Outcome| {
                let later = part.get(at + outcome.lag as usize)?;
                match outcome.agent {
                    Some(agent) => acts(later, agent).then(|| of_action(later, agent)),
                    None => (!later.observed.is_empty()).then(|| later.observed.clone()),
                }
            };
            let values: Vec<Option<Vec<f32>>> = schema.outcomes().iter().map(value).collect();
            let action = |agent: usize| acts(step, agent).then(|| of_action(step, agent)[0] as u64);
            let later = |agent: usize| {
                let outcomes = schema.outcomes().iter().zip(&values);
                outcomes
                    .into_iter()
                    .any(|(outcome, value)| outcome.agent == Some(agent) && value.is_some())
            };
            let key = schema.key_of_values(&step.state).expect("fits");
            let actions = [0, 1].map(action);
            let part = |agent: usize| actions[agent].is_some() || later(agent);
            let entry = rule.entry_of(&key, &actions, part);

            let width = |at: usize| schema.outcomes()[at].value.len();
            let blank = |(at, value): (usize, &Option<Vec<f32>>)| {
                value.clone().unwrap_or(vec![0.0; width(at)])
            };
            let present: Vec<bool> = values.iter().map(Option::is_some).collect();
            let some = present.contains(&true);
            let outcomes = values.iter().enumerate().flat_map(blank);
            records.push(Record {
                actions_present: step.acts.clone(),
                outcomes: if some { outcomes.collect() } else { Vec::new() },
                outcomes_present: if some && present.contains(&false) {
                    present
                } else {
                    Vec::new()
                },
                entry,
                ..Record::new(step.state.clone(), step.actions.clone())
            });
        }
        rule.gap();
    }
    records
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = (
        0..3u8,
        0..2u8,
        0..3u8,
        prop::option::weighted(0.5, prop::array::uniform2(prop::bool::weighted(0.7))),
        prop::option::of(0..4u8),
    );
    let step = step.prop_map(|(distance, a, b, acts, pot)| Step {
        state: vec![f32::from(distance) + 0.5],
        actions: vec![f32::from(a), f32::from(b), 0.0],
        acts: acts.map(Vec::from).unwrap_or_default(),
        observed: pot.map(f32::from).into_iter().collect(),
        is_observed: Vec::new(),
    });
    prop::collection::vec(step, 0..25)
}

proptest! {
    #[test]
    fn what_is_released_is_what_the_whole_track_says(
        lags in prop::collection::btree_set(1i64..9, 0..4),
        pot in prop::option::of(1i64..7),
        parts in prop::collection::vec(steps(), 1..4),
    ) {
        let schema = schema(&lags.iter().copied().collect::<Vec<_>>(), pot);
        let most = lags.into_iter().chain(pot).max().unwrap_or(0) as usize;
        let mut track = Track::new(&schema);
        let mut released = Vec::new();
        for part in &parts {
            for (at, step) in part.iter().enumerate() {
                released.extend(track.step(step.clone()));
                prop_assert_eq!(track.held_back(), most.min(at + 1));
            }
            released.extend(track.gap());
        }
        prop_assert_eq!(released, by_definition(&schema, &parts));
    }

    /// A crash and a new track lose what was held back, and nothing else.
    #[test]
    fn a_crash_loses_at_most_the_greatest_lag(steps in steps(), most in 0i64..9) {
        let lags: Vec<i64> = (1..=most).collect();
        let schema = schema(&lags, None);
        let whole = by_definition(&schema, std::slice::from_ref(&steps));
        let mut track = Track::new(&schema);
        let released: Vec<Record> =
            steps.iter().filter_map(|step| track.step(step.clone())).collect();
        prop_assert_eq!(released.len() + track.held_back(), steps.len());
        prop_assert!(track.held_back() <= most as usize);
        prop_assert_eq!(&released[..], &whole[..released.len()]);
    }
}
