//! What becomes of good and bad transitions.

use nudge_core::domain::{Entry, Rejection, Sequence, Values};
use nudge_core::error::ErrorKind;

use super::*;
use crate::json::description_of_text;

fn schema() -> Schema {
    let text = r#"{
        "state": [{"name": "distance", "continuous": {"edges": [0.5, 1]}},
                  {"name": "held", "categorical": {"labels": ["nothing", "oignon é", "左"]}}],
        "agents": [{"name": "robot", "action": [{"name": "turn", "continuous": {"edges": [0]}},
                                                {"name": "speed", "integer": {"min": 0, "max": 3}}]},
                   {"name": "human", "action": [{"name": "move", "categorical": {"labels": ["go", "stay"]}}]}]}"#;
    Schema::try_from(&description_of_text(text).expect("valid").schema).expect("valid")
}

const GOOD: &str = r#"{"state": {"held": "左", "distance": 1.2}, "actions": {"human": "stay", "robot": {"speed": 2, "turn": -0.1}}}"#;

fn batch(transitions: &[&str]) -> Batch {
    let body = format!(
        r#"{{"producer": "game-7", "sequence": 3, "transitions": [{}]}}"#,
        transitions.join(", ")
    );
    batch_of_json(&schema(), body.as_bytes())
        .expect("a batch")
        .batch
}

fn head() -> Head {
    Head {
        producer: "game-7".into(),
        sequence: 3,
        ..Head::default()
    }
}

fn rejection(transition: &str) -> Rejection {
    let mut batch = batch(&[GOOD, transition, GOOD]);
    assert_eq!(batch.records.len, 3);
    assert_eq!(batch.records.undecodable.len(), 1, "{transition}");
    let rejection = batch.records.undecodable.remove(0);
    assert_eq!(rejection.index, 1);
    rejection
}

/// A good transition with one member of it replaced.
fn with(good: &str, instead: &str) -> String {
    assert!(GOOD.contains(good));
    GOOD.replace(good, instead)
}

#[test]
fn a_transition_is_put_in_the_order_of_the_environment() {
    let batch = batch(&[GOOD]);
    assert_eq!(batch.sequence, Sequence::new(3).expect("valid"));
    assert_eq!(batch.records.states, Values::from(vec![1.2, 2.0]));
    assert_eq!(batch.records.actions, Values::from(vec![-0.1, 2.0, 1.0]));
    assert!(batch.records.entries.is_empty() && batch.records.counts.is_empty());
}

#[test]
fn entry_and_count_are_kept() {
    let batch = batch(&[
        &with(r#"{"state""#, r#"{"entry": true, "count": 2.0, "state""#),
        GOOD,
    ]);
    assert_eq!(batch.records.entries, [Entry::Entered, Entry::Unknown]);
    assert_eq!(batch.records.counts, [2, 1]);
}

#[test]
fn a_track_is_kept_to_the_last_digit() {
    let with_track = |track: &str| with(r#"{"state""#, &format!(r#"{{"track": {track}, "state""#));
    let most = u64::MAX.to_string();
    let kept = batch(&[
        &with_track("0"),
        GOOD,
        &with_track(&most),
        &with_track("7.0"),
    ]);
    let expected = [Some(0), None, Some(u64::MAX), Some(7)];
    assert_eq!(kept.records.tracks, expected);
    assert_eq!(batch(&[&with_track("null"), GOOD]), batch(&[GOOD, GOOD]));

    for wrong in [
        "-1",
        "1.5",
        "1e300",
        "1e400",
        "18446744073709551616",
        r#""7""#,
        "true",
        "[7]",
    ] {
        let told = rejection(&with_track(wrong));
        assert_eq!(told.field, "/track", "{wrong}");
        assert!(told.reason.contains("expected a"), "{}", told.reason);
    }
    assert_eq!(rejection(&with_track("1, \"track\": 1")).field, "/track");
}

#[test]
fn a_label_may_be_given_by_its_index() {
    assert_eq!(
        batch(&[&with(r#""左""#, "1")]).records.states,
        Values::from(vec![1.2, 1.0])
    );
}

#[test]
fn a_bad_value_rejects_its_record_only() {
    for (good, instead, field) in [
        (r#""左""#, r#""right""#, "/state/held"),
        ("1.2", "null", "/state/distance"),
        ("1.2", "true", "/state/distance"),
        ("1.2", r#""1.2 m""#, "/state/distance"),
        ("1.2", r#""NaN""#, "/state/distance"),
        (r#""左""#, "true", "/state/held"),
        ("1.2", "1e300", "/state/distance"),
        ("1.2", "1e400", "/state/distance"),
        (r#""左""#, "-1e400", "/state/held"),
        (
            r#""human": "stay""#,
            r#""human": 1e400"#,
            "/actions/human/move",
        ),
        ("-0.1", "1e400", "/actions/robot/turn"),
        (r#"{"speed": 2, "turn": -0.1}"#, "1e400", "/actions/robot"),
        (r#"{"state""#, r#"{"count": 1e400, "state""#, "/count"),
        (r#"{"state""#, r#"{"entry": 1e400, "state""#, "/entry"),
        (r#"{"state""#, r#"{"weight": 1e400, "state""#, "/weight"),
        ("1.2", "[1.2]", "/state/distance"),
        (
            r#""distance": 1.2"#,
            r#""distanse": 1.2"#,
            "/state/distanse",
        ),
        (
            r#""distance": 1.2"#,
            r#""a/b": 1, "distance": 1"#,
            "/state/a~1b",
        ),
        (
            r#""distance": 1.2"#,
            r#""distance": 1, "distance": 2"#,
            "/state/distance",
        ),
        (r#", "distance": 1.2"#, "", "/state/distance"),
        (
            r#""human": "stay""#,
            r#""human": "stay", "human": "go""#,
            "/actions/human",
        ),
        (
            r#""human": "stay""#,
            r#""human": {"move": "fly"}"#,
            "/actions/human/move",
        ),
        (r#""human": "stay", "#, "", "/actions/human"),
        (
            r#""human": "stay""#,
            r#""human": "stay", "dog": 1"#,
            "/actions/dog",
        ),
        (r#"{"speed": 2, "turn": -0.1}"#, "1", "/actions/robot"),
        (r#""speed": 2, "#, "", "/actions/robot/speed"),
        (r#"{"state""#, r#"{"count": 0, "state""#, "/count"),
        (r#"{"state""#, r#"{"count": -1, "state""#, "/count"),
        (r#"{"state""#, r#"{"count": 1.5, "state""#, "/count"),
        (r#"{"state""#, r#"{"count": "1", "state""#, "/count"),
        (
            r#"{"state""#,
            r#"{"count": 1, "count": 1, "state""#,
            "/count",
        ),
        (r#"{"state""#, r#"{"entry": 1, "state""#, "/entry"),
        (r#"{"state""#, r#"{"weight": 1, "state""#, "/weight"),
    ] {
        let rejection = rejection(&with(good, instead));
        assert_eq!(rejection.field, field, "{instead}: {}", rejection.reason);
        assert!(!rejection.reason.is_empty());
    }
}

#[test]
fn null_says_that_a_member_is_absent() {
    let nulls = batch(&[
        &with(r#"{"state""#, r#"{"entry": null, "count": null, "state""#),
        GOOD,
    ]);
    assert_eq!(nulls, batch(&[GOOD, GOOD]));
    for (good, instead, field) in [
        (
            r#"{"state""#,
            r#"{"entry": null, "entry": true, "state""#,
            "/entry",
        ),
        (r#"{"state""#, r#"{"weight": null, "state""#, "/weight"),
        (r#""human": "stay""#, r#""human": null"#, "/actions/human"),
    ] {
        assert_eq!(rejection(&with(good, instead)).field, field, "{instead}");
    }
    let body = format!(
        r#"{{"producer": "p", "sequence": 3, "segment": null, "environment_uid": null, "transitions": [{GOOD}]}}"#
    );
    let incoming = batch_of_json(&schema(), body.as_bytes()).expect("a batch");
    assert_eq!(
        (incoming.batch, incoming.environment_uid.as_str()),
        (batch(&[GOOD]), "")
    );
}

#[test]
fn a_number_that_is_none_fails_a_document_and_rejects_a_line() {
    for word in ["NaN", "Infinity", "-Infinity"] {
        let bad = with("1.2", word);
        let body = format!(
            "{{\"producer\": \"p\", \"sequence\": 1, \"transitions\": [{GOOD}, {bad}, {GOOD}]}}"
        );
        let problem = batch_of_json(&schema(), body.as_bytes()).expect_err("no JSON");
        assert_eq!(
            (problem.kind, problem.faults.len()),
            (ErrorKind::Invalid, 1)
        );
        assert_eq!(problem.faults[0].pointer, "/transitions/1/state/distance");
        let told = format!("got {word}, expected a finite number");
        assert!(problem.faults[0].detail.starts_with(&told), "{problem}");

        let lines = batch_of_lines(
            &schema(),
            head(),
            format!("{GOOD}\n{bad}\n{GOOD}").as_bytes(),
        )
        .expect("a batch");
        let [rejected] = &lines.batch.records.undecodable[..] else {
            panic!("one line: {lines:?}")
        };
        assert_eq!(
            (rejected.index, rejected.field.as_str()),
            (1, "/state/distance")
        );
        assert!(rejected.reason.starts_with(&told), "{}", rejected.reason);
    }
}

#[test]
fn a_number_that_no_double_holds_is_told_as_it_was_written() {
    let far = rejection(&with("1.2", "-1.5E+400"));
    assert_eq!(far.reason, "got -1.5E+400, expected a finite number");
    let digits = "9".repeat(400);
    let long = rejection(&with("1.2", &digits));
    assert_eq!(
        long.reason,
        format!("got {}..., expected a finite number", &digits[..64])
    );

    let both =
        rejection(&with("1.2", "1e400").replace("\"stay\"", "{\"move\": {\"deep\": [1e400]}}"));
    assert_eq!(
        both.reason,
        "got 1e400, expected a finite number; \
         /actions/human/move: got an object, expected one of go, stay, or an index from 0 to 1"
    );
    let twice = rejection(&with(
        r#""distance": 1.2"#,
        r#""distance": 1e400, "distance": 2"#,
    ));
    assert!(twice.reason.contains("given 2 times"), "{}", twice.reason);

    let lines = format!("{GOOD}\n{}\n{GOOD}", with("1.2", "1e400"));
    let lines = batch_of_lines(&schema(), head(), lines.as_bytes()).expect("a batch");
    let rejected = &lines.batch.records.undecodable[..];
    assert_eq!(
        rejected
            .iter()
            .map(|r| (r.index, r.field.as_str()))
            .collect::<Vec<_>>(),
        [(1, "/state/distance")]
    );
}

#[test]
fn what_is_no_transition_is_rejected() {
    for text in ["null", "3", "[]", "\"x\"", "{}", "true", "1e400", "[1e400]"] {
        rejection(text);
    }
    let lines = |text: &str| {
        let batch = batch_of_lines(&schema(), head(), text.as_bytes()).expect("a batch");
        batch.batch.records.undecodable[0].reason.clone()
    };
    for text in [
        "1e400 1",
        "{\"state\": 1e400",
        "{\"state\": 1e400, }",
        "{\"state\": 1e400, \"x\": \"\\ud800\"}",
    ] {
        assert!(
            lines(text).starts_with("not JSON: "),
            "{text}: {}",
            lines(text)
        );
    }
    let deep_behind = format!(
        "{{\"state\": 1e400, \"x\": {}1{}}}",
        "{\"x\":".repeat(50_000),
        "}".repeat(50_000)
    );
    assert_eq!(
        rejection(&deep_behind).field,
        "/x",
        "nobody goes down there"
    );
    let deep = format!("{}{}", "[".repeat(5_000), "]".repeat(5_000));
    assert!(rejection(&deep).reason.contains("recursion limit"));
}

#[test]
fn all_faults_of_a_record_are_one_reason() {
    let told = rejection(
        r#"{"state": {"distance": 1}, "actions": {"human": "fly", "robot": 1}, "count": 0}"#,
    );
    assert_eq!(told.field, "/state/held");
    assert_eq!(
        told.reason,
        "missing, expected one of nothing, oignon é, 左, or an index from 0 to 2; \
         /actions/robot: got 1, expected an object of turn, speed; \
         /actions/human/move: got \"fly\", expected one of go, stay, or an index from 0 to 1; \
         /count: got 0, expected a whole number, at least 1"
    );
}

#[test]
fn reasons_stay_short() {
    let long = "x".repeat(100_000);
    let many: Vec<String> = (0..1_000)
        .map(|i| format!("\"{long}{i}\": 1"))
        .take(9)
        .collect();
    let told = rejection(&with(r#""distance": 1.2"#, &many.join(", ")));
    assert!(
        told.reason.len() < 1_000 && told.field.len() < 300,
        "{}",
        told.reason.len()
    );
    assert!(told.reason.ends_with("; and 6 more"), "{}", told.reason);
}

#[test]
fn what_is_wrong_with_the_batch_fails_it() {
    let pointer = |body: &str| {
        batch_of_json(&schema(), body.as_bytes())
            .expect_err("wrong")
            .faults
            .first()
            .map(|fault| fault.pointer.clone())
    };
    let at = |text: &str| Some(text.to_owned());
    assert_eq!(pointer("nonsense"), at(""));
    assert_eq!(
        pointer(r#"{"producer": "a", "sequence": -1, "transitions": []}"#),
        at("/sequence")
    );
    assert_eq!(
        pointer(r#"{"producer": "a", "sequence": 0, "transitions": []}"#),
        at("/sequence")
    );
    assert_eq!(
        pointer(r#"{"producer": "a b", "sequence": 1, "transitions": []}"#),
        at("/producer")
    );
    assert_eq!(
        pointer(r#"{"producer": "a", "sequence": 1, "segment": "\n", "transitions": []}"#),
        at("/segment")
    );
    assert_eq!(
        pointer(r#"{"producer": "a", "sequence": 1, "segments": "x", "transitions": []}"#),
        at("/segments")
    );
    assert_eq!(
        pointer(r#"{"sequence": 1, "transitions": []}"#),
        at("/producer")
    );
    assert_eq!(pointer("[]"), at(""));
    assert_eq!(
        pointer(r#"{"producer": "a", "sequence": 1, "transitions": {}}"#),
        at("/transitions")
    );
    assert_eq!(
        pointer(r#"{"producer": "a", "sequence": 1, "transitions": [{]}"#),
        at("/transitions/0")
    );
}

#[test]
fn a_batch_has_a_limit() {
    let body = |count: usize| {
        let transitions = vec!["0"; count].join(",");
        format!(r#"{{"producer": "a", "sequence": 1, "transitions": [{transitions}]}}"#)
    };
    assert!(batch_of_json(&schema(), body(10_000).as_bytes()).is_ok());
    let problem = batch_of_json(&schema(), body(10_001).as_bytes()).expect_err("too large");
    assert_eq!(
        (problem.kind, problem.reason),
        (ErrorKind::TooLarge, "BATCH_TOO_LARGE")
    );
}

#[test]
fn lines_are_the_same_batch() {
    let body = format!("{GOOD}\r\n\n  {GOOD}\nnot json\n{{\"a\": \"\u{e9}\"}}\n");
    let lines = batch_of_lines(&schema(), head(), body.as_bytes()).expect("a batch");
    let rejected: Vec<u32> = lines
        .batch
        .records
        .undecodable
        .iter()
        .map(|rejection| rejection.index)
        .collect();
    assert_eq!((lines.batch.records.len, rejected), (4, vec![2, 3]));
    let good =
        batch_of_lines(&schema(), head(), format!("{GOOD}\n{GOOD}").as_bytes()).expect("a batch");
    assert_eq!(good.batch, batch(&[GOOD, GOOD]));
    let invalid = batch_of_lines(&schema(), head(), b"{\"state\": \"\xff\"}").expect("a batch");
    assert_eq!(invalid.batch.records.undecodable.len(), 1);
}
