//! What descriptions of outcomes mean, and which cells of which family a record counts in.

use proptest::prelude::*;

use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft, OutcomeDraft};
use crate::domain::{Agent, Family, Numbers, Presence, Schema, SchemaDraft, Values};

fn feature(name: &str, kind: KindDraft) -> FeatureDraft {
    FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![kind],
    }
}

fn labels(labels: &[&str]) -> KindDraft {
    KindDraft::Categorical(labels.iter().map(ToString::to_string).collect())
}

fn agent(name: &str, kind: KindDraft) -> AgentDraft {
    AgentDraft {
        name: name.into(),
        action: vec![feature("move", kind)],
        may_be_absent: false,
    }
}

/// The environment `trio` of the databases that earlier builds left.
fn trio() -> SchemaDraft {
    SchemaDraft {
        state: vec![feature("place", KindDraft::Integer(0, 3))],
        agents: vec![
            agent("a", labels(&["go", "stop"])),
            agent("b", KindDraft::Integer(-2, 2)),
            AgentDraft {
                action: vec![feature("wait", labels(&["always"]))],
                ..agent("c", labels(&[]))
            },
        ],
        ..SchemaDraft::default()
    }
}

fn later(agent: &str, lag: i64) -> OutcomeDraft {
    OutcomeDraft {
        agent: Some(agent.into()),
        lag: Some(lag),
        ..OutcomeDraft::default()
    }
}

fn value(name: &str, lag: i64, kind: KindDraft) -> OutcomeDraft {
    OutcomeDraft {
        name: name.into(),
        lag: Some(lag),
        value: vec![feature("is", kind)],
        ..OutcomeDraft::default()
    }
}

fn with(lags: &[i64], outcomes: &[OutcomeDraft]) -> SchemaDraft {
    SchemaDraft {
        outcomes: outcomes.to_vec(),
        lags: lags.to_vec(),
        ..trio()
    }
}

fn schema(draft: &SchemaDraft) -> Schema {
    Schema::try_from(draft).expect("valid")
}

fn names(schema: &Schema) -> Vec<&str> {
    let outcomes = schema.outcomes().iter();
    outcomes.map(|outcome| outcome.name.as_str()).collect()
}

#[test]
fn a_description_without_outcomes_has_the_hash_that_it_always_had() {
    // As the first build that landed told it: tests/fixtures/schema-1-af3f5d0.json.gz.
    let kept = "5869d73b4da234a400712118fcf8e09893c1d90add406972b362ae05e0fe3a87";
    assert_eq!(schema(&trio()).hash().to_string(), kept);
}

#[test]
fn hashes_of_outcomes_are_kept_for_ever() {
    let mut absent = trio();
    absent.agents[1].may_be_absent = true;
    let pot = value("pot", 1, labels(&["empty", "full"]));
    let drafts = [
        with(&[1, 2], &[]),
        with(&[], std::slice::from_ref(&pot)),
        absent.clone(),
        SchemaDraft {
            agents: absent.agents,
            ..with(&[3], &[pot])
        },
    ];
    let hashes = drafts.map(|draft| schema(&draft).hash().to_string());
    assert_eq!(hashes, KEPT);
}

/// Of the build that brought outcomes.
const KEPT: [&str; 4] = [
    "260facdef1ae360b2bd2da3d25be7c60bfa1b8cc07744a338219baa9285207c9",
    "0209fac6f8ee6d007992aac84784c8f3d274fe93b9b380a70a8a72272081332b",
    "990c35913c4a3fd86bda3fba2d705e6abeee9d64f6a58dd276b81f4b5c338a2a",
    "bd7949ae768f1f07a63d4ac7592fd3cf65bd7bb28e88a37ec72c12ec212c81fe",
];

#[test]
fn every_part_of_an_outcome_is_in_the_hash() {
    let mut drafts = vec![trio(), with(&[1], &[]), with(&[2], &[])];
    drafts.push(with(&[], &[later("a", 1)]));
    drafts.push(with(&[], &[value("pot", 1, KindDraft::Integer(0, 1))]));
    drafts.push(with(&[], &[value("pot", 2, KindDraft::Integer(0, 1))]));
    drafts.push(with(&[], &[value("pot", 1, KindDraft::Integer(0, 2))]));
    drafts.push(with(&[], &[value("pan", 1, KindDraft::Integer(0, 1))]));
    for absent in 0..3 {
        let mut draft = trio();
        draft.agents[absent].may_be_absent = true;
        drafts.push(draft);
    }
    let hashes: Vec<_> = drafts.iter().map(|draft| schema(draft).hash()).collect();
    for (at, hash) in hashes.iter().enumerate() {
        assert!(!hashes[..at].contains(hash), "{:?}", drafts[at]);
    }
}

#[test]
fn lags_stand_for_every_agent_at_every_lag() {
    let short = schema(&with(&[3, 1], &[]));
    assert_eq!(names(&short), ["a@1", "a@3", "b@1", "b@3", "c@1", "c@3"]);
    let written: Vec<_> = ["a", "b", "c"]
        .iter()
        .flat_map(|name| [later(name, 1), later(name, 3)])
        .collect();
    let long = schema(&with(&[], &written));
    assert_eq!((long.hash(), &long), (short.hash(), &short));

    // What is told is the long form, and means the same.
    assert_eq!(short.draft().lags, [0; 0]);
    assert_eq!(schema(&short.draft()), short);

    let mixed = schema(&with(
        &[2],
        &[value("pot", 1, labels(&["x"])), later("b", 1)],
    ));
    assert_eq!(names(&mixed), ["a@2", "b@2", "c@2", "pot", "b@1"]);
    assert_eq!(schema(&mixed.draft()), mixed);
    assert_eq!(mixed.action_at(1, 2), Some(1));
    assert_eq!((mixed.outcome("pot"), mixed.outcome("b")), (Some(3), None));
}

#[test]
fn every_fault_of_an_outcome_has_its_place() {
    let told = |draft: &SchemaDraft| -> Vec<(String, String)> {
        let faults = Schema::try_from(draft).expect_err("wrong");
        let told = faults
            .into_iter()
            .map(|fault| (fault.pointer, fault.detail));
        told.collect()
    };
    let both = OutcomeDraft {
        agent: Some("a".into()),
        ..value("both", 1, labels(&["x"]))
    };
    let renamed = OutcomeDraft {
        name: "reply".into(),
        ..later("a", 1)
    };
    let unlagged = OutcomeDraft {
        lag: None,
        ..value("when", 1, labels(&["x"]))
    };
    for (outcome, pointer, said) in [
        (later("a", 0), "/outcomes/0/lag", "got 0, expected 1 to 64"),
        (
            later("a", 65),
            "/outcomes/0/lag",
            "got 65, expected 1 to 64",
        ),
        (
            later("a", -1),
            "/outcomes/0/lag",
            "got -1, expected 1 to 64",
        ),
        (unlagged, "/outcomes/0/lag", "missing, expected 1 to 64"),
        (
            later("d", 1),
            "/outcomes/0/agent",
            "unknown agent \"d\"; known: ",
        ),
        (both, "/outcomes/0", "got both of agent and value"),
        (OutcomeDraft::default(), "/outcomes/0", "got neither of"),
        (
            renamed,
            "/outcomes/0/name",
            "got \"reply\", expected \"a@1\"",
        ),
        (
            value("a@1", 1, labels(&["x"])),
            "/outcomes/0/name",
            "'@' is for",
        ),
        (
            value("A", 1, labels(&["x"])),
            "/outcomes/0/name",
            "is not a name",
        ),
        (
            value("a", 1, labels(&["x"])),
            "/outcomes/0/name",
            "used twice",
        ),
        (
            value("place", 1, labels(&["x"])),
            "/outcomes/0/name",
            "used twice",
        ),
        (
            value("pot", 1, labels(&[])),
            "/outcomes/0/value/0/categorical/labels",
            "got 0 labels",
        ),
    ] {
        let told = told(&with(&[], &[outcome]));
        let is_told = |(at, detail): &(String, String)| at == pointer && detail.contains(said);
        assert!(told.iter().any(is_told), "{pointer} {said}: {told:?}");
    }

    let pointers = |draft: &SchemaDraft| -> Vec<String> {
        told(draft)
            .into_iter()
            .map(|(pointer, _)| pointer)
            .collect()
    };
    let lags = with(&[0, 2, 65, 2, -3], &[]);
    assert_eq!(
        pointers(&lags),
        ["/lags/0", "/lags/2", "/lags/3", "/lags/4"]
    );
    let twice = with(&[1], &[later("b", 1), later("c", 2), later("c", 2)]);
    assert_eq!(pointers(&twice), ["/outcomes/0/name", "/outcomes/2/name"]);
    let mut at = trio();
    at.agents[0].name = "a@1".into();
    assert_eq!(pointers(&at), ["/agents/0/name"]);
}

#[test]
fn there_are_as_many_outcomes_and_cells_as_numbers_hold() {
    let all: Vec<i64> = (1..=64).collect();
    let many = SchemaDraft {
        agents: (0..8)
            .map(|at| agent(&format!("a{at}"), labels(&["x"])))
            .collect(),
        ..with(&all, &[])
    };
    assert_eq!(schema(&many).outcomes().len(), 512);
    let more = SchemaDraft {
        outcomes: vec![value("one", 1, labels(&["x"]))],
        ..many
    };
    let faults = Schema::try_from(&more).expect_err("one too many");
    assert_eq!(faults[0].pointer, "/outcomes");

    // 2^48 joint actions, with 2^14 values each; and an absence is a letter more.
    let wide = |name: &str| AgentDraft {
        action: (0..3)
            .map(|at| feature(&format!("f{at}"), KindDraft::Integer(0, 255)))
            .collect(),
        ..agent(name, labels(&[]))
    };
    let full = SchemaDraft {
        agents: vec![wide("a"), wide("b")],
        ..with(&[], &[value("pot", 1, KindDraft::Integer(0, 16_383))])
    };
    let cells = schema(&full).cells_of_family(Family::of_outcome(0));
    assert_eq!(cells, Some(1 << 62));
    let mut absent = full.clone();
    absent.agents[0].may_be_absent = true;
    let mut larger = full.clone();
    larger.outcomes[0].value[0].kinds = vec![KindDraft::Integer(0, 16_384)];
    let lagged = SchemaDraft {
        lags: vec![1],
        ..full
    };
    for (draft, pointer) in [
        (absent, "/outcomes/0"),
        (larger, "/outcomes/0"),
        (lagged, "/lags"),
    ] {
        let faults = Schema::try_from(&draft).expect_err("too many cells");
        assert_eq!(faults[0].pointer, pointer);
    }
}

#[test]
fn an_absence_is_a_letter_behind_the_actions() {
    let mut draft = trio();
    draft.agents[1].may_be_absent = true;
    let schema = schema(&draft);
    assert_eq!(
        (schema.joint_actions(), schema.agents()[1].actions()),
        (12, 5)
    );
    let joints = |actions: &[f32], present: Presence| {
        let numbers = schema.joint_actions_at(&Values::from(actions.to_vec()), &present, 0);
        let records = actions.len() / 3;
        (0..records)
            .map(|lane| numbers.get(lane))
            .collect::<Vec<_>>()
    };
    let actions = [1.0, 2.0, 0.0, 1.0, 0.0, 0.0, 0.0, -2.0, 0.0];
    let absent = Presence::of([true, true, true, true, false, true, false, true, true]);
    let joints = joints(&actions, absent);
    assert_eq!(
        joints,
        [Some(6 + 4), Some(6 + 5), None],
        "a may not be absent"
    );
    assert_eq!(schema.actions_of(11), [1, 5, 0]);
    assert_eq!(schema.agents()[1].action_label(5), Agent::ABSENT);
    assert_eq!(schema.joint_action(&[1.0, 2.0, 0.0]), Some(10));
}

/// What a record observed of `a` at lags 1 to 3, and of `b` at lag 3 alone.
fn lagged(may_be_absent: bool) -> Schema {
    let mut draft = with(
        &[],
        &[
            later("a", 2),
            later("a", 1),
            later("b", 3),
            later("a", 3),
            value("pot", 1, labels(&["empty", "full"])),
        ],
    );
    draft.agents[0].may_be_absent = may_be_absent;
    schema(&draft)
}

fn cells(schema: &Schema, actions: [f32; 3], observed: &[Option<f32>]) -> Vec<Option<[u64; 4]>> {
    let values: Vec<f32> = observed.iter().map(|value| value.unwrap_or(0.0)).collect();
    let present = Presence::of(observed.iter().map(Option::is_some));
    let observed = schema.outcomes_at(&values.into(), &present, 0);
    let joints = schema.joint_actions_at(&actions.to_vec().into(), &Presence::default(), 0);
    let cells = schema.outcome_cells(&joints, &observed);
    let cell = |(at, cells): (usize, &Numbers)| split(schema, at, cells.get(0)?);
    cells.iter().enumerate().map(cell).collect()
}

/// Returns the letters of all agents in a cell of an outcome's family, and the outcome's value.
fn split(schema: &Schema, outcome: usize, cell: u64) -> Option<[u64; 4]> {
    let family = Family::of_outcome(outcome);
    assert!(cell < schema.cells_of_family(family)?);
    let (joint, value) = schema.split(family, cell);
    let [a, b, c] = [0, 1, 2].map(|agent| schema.action_of(joint, agent));
    Some([a, b, c, value])
}

#[test]
fn a_later_action_is_counted_beside_the_one_before_it() {
    let schema = lagged(false);
    let all = [0.0, 1.0, 2.0, 1.0, 1.0].map(Some);
    let found = cells(&schema, [1.0, -1.0, 0.0], &all);
    let expected = [
        // a@2 beside a@1, a@1 beside a now, b@3 beside b now (b@2 is none), a@3 beside a@2.
        [1, 1, 0, 0],
        [1, 1, 0, 1],
        [1, 1, 0, 4],
        [0, 1, 0, 1],
        [1, 1, 0, 1],
    ];
    assert_eq!(found, expected.map(Some));
    let lags = (0..5).map(|at| schema.own_lag(at)).collect::<Vec<_>>();
    assert_eq!(lags, [Some(1), Some(0), Some(0), Some(2), None]);
}

#[test]
fn what_is_missing_counts_nowhere_and_an_absence_is_known() {
    // a@1 is missing, so that a@2 has nothing to be counted beside, unless a may be absent.
    let observed = [Some(0.0), None, None, Some(1.0), Some(1.0)];
    let actions = [1.0, -1.0, 0.0];
    let schema = lagged(false);
    let found = cells(&schema, actions, &observed);
    let expected = [None, None, None, Some([0, 1, 0, 1]), Some([1, 1, 0, 1])];
    assert_eq!(found, expected);

    let schema = lagged(true);
    let found = cells(&schema, actions, &observed);
    assert_eq!(
        found[0],
        Some([2, 1, 0, 0]),
        "it was absent one step before"
    );
    assert_eq!(found[1..], expected[1..]);

    let nothing = schema.outcomes_at(&Values::default(), &Presence::default(), 0);
    let joints = schema.joint_actions_at(&actions.to_vec().into(), &Presence::default(), 0);
    assert_eq!(schema.outcome_cells(&joints, &nothing), []);
    assert_eq!(nothing.misfits(), [false; Numbers::LANES]);
}

proptest! {
    /// Every record is in its own cell, in whichever block of records it stands.
    #[test]
    fn cells_of_many_records_are_those_of_each(
        rows in proptest::collection::vec((0u8..2, -2i8..3, proptest::array::uniform5(proptest::option::of(0u8..2))), 1..150),
        may_be_absent: bool,
    ) {
        let schema = lagged(may_be_absent);
        let observed = |row: &[Option<u8>; 5]| row.map(|value| value.map(f32::from));
        let values: Vec<f32> = rows.iter().flat_map(|(.., row)| observed(row).map(|value| value.unwrap_or(0.0))).collect();
        let present = Presence::of(rows.iter().flat_map(|(.., row)| row.map(|value| value.is_some())));
        let values = Values::from(values);
        let actions = |a: u8, b: i8| [f32::from(a), f32::from(b), 0.0];
        let all_actions: Vec<f32> = rows.iter().flat_map(|(a, b, _)| actions(*a, *b)).collect();
        let all_actions = Values::from(all_actions);
        for first in (0..rows.len()).step_by(Numbers::LANES) {
            let block = schema.outcomes_at(&values, &present, first);
            let joints = schema.joint_actions_at(&all_actions, &Presence::default(), first);
            let found = schema.outcome_cells(&joints, &block);
            for (lane, (a, b, row)) in rows[first..].iter().take(Numbers::LANES).enumerate() {
                let found = found.iter().enumerate().map(|(outcome, cells)| {
                    split(&schema, outcome, cells.get(lane)?)
                });
                prop_assert_eq!(found.collect::<Vec<_>>(), cells(&schema, actions(*a, *b), &observed(row)));
            }
        }
    }
}
