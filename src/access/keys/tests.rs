//! Keys files, right and wrong ones, and whatever else may be in one.

use std::time::{Duration, Instant};

use proptest::prelude::*;

use super::*;
use crate::access::{bearer, generate};
use crate::domain::KeyScope;

fn digest(key: &str) -> KeyDigest {
    KeyDigest::of_key(key.as_bytes())
}

fn faults(text: &str) -> Vec<String> {
    Keys::parse(text).expect_err("wrong")
}

#[test]
fn a_line_is_a_key_and_several_may_have_a_name() {
    let text = format!(
        "# who is let in\n\n  game {} ingest,read environments=hall*,lane rate=2/h \n\tgame {} ingest\r\n#{}\n",
        digest("one"),
        digest("two"),
        digest("three"),
    );
    let keys = Keys::parse(&text).expect("right");
    assert_eq!(keys.len(), 2);
    let [one, two] = ["one", "two"].map(|key| keys.find(digest(key)).expect("there"));
    assert_eq!(one.name(), two.name());
    assert!(one.principal().may_see("hallway") && !one.principal().may_see("kitchen"));
    assert!(
        two.principal().is_everywhere()
            && two
                .principal()
                .authorize([KeyScope::Read].into_iter().collect())
                .is_err()
    );
    assert!(keys.find(digest("three")).is_none(), "a comment is no key");
    assert!((0..9).all(|_| two.take().is_ok()), "it has no rate");
    assert!(Keys::parse("").expect("an empty file").is_empty());
}

#[test]
fn every_fault_names_its_line_its_field_its_value_and_what_was_expected() {
    let (one, two) = (digest("one"), digest("two"));
    let text = format!(
        "Game {one} read\n\ngame abc reed,write rate=fast\ngame\na {two} read scope=x colour\nb {two} read rate=1/s rate=1/s\nc {one} admin environments=A*,b\n"
    );
    let told = faults(&text);
    for (begins, says) in [
        ("line 1: name: got \"Game\", expected", "a-z"),
        (
            "line 3: digest: got 3 characters (not shown), expected",
            "64",
        ),
        ("line 3: scopes: got \"reed\", expected", "ingest"),
        ("line 3: rate: got \"fast\", expected", "50/s"),
        ("line 4: digest: missing, expected", "DIGEST"),
        ("line 4: scopes: missing, expected", "SCOPES"),
        ("line 5: option: got \"scope=x\", expected", "rate="),
        ("line 5: option: got \"colour\", expected", "environments="),
        ("line 6: rate: given twice, expected", "once"),
        ("line 7: environments: got \"A*\", expected", "`*`"),
    ] {
        assert!(
            told.iter()
                .any(|told| told.starts_with(begins) && told.contains(says)),
            "{begins} in\n{}",
            told.join("\n")
        );
    }
    assert_eq!(told.len(), 10);
    assert_eq!(
        faults(&format!("a {one} read\nb {one} read")).len(),
        1,
        "one key for two"
    );
}

#[test]
fn a_key_that_stands_where_its_digest_should_is_not_told() {
    let key = generate().expect("randomness");
    let text = key.reveal();
    for line in [
        format!("a {text} read"),
        text.to_string(),
        format!("a {} {text}", digest("x")),
        format!("a {} read rate={text}", digest("x")),
        format!("a {} read {text}", digest("x")),
        format!("a {} read environments={text}", digest("x")),
    ] {
        assert!(!faults(&line).join("\n").contains(&text[6..14]), "{line}");
    }
}

#[test]
fn rates_go_on_over_a_reload_unless_they_change() {
    let keys =
        |rate: &str| Keys::parse(&format!("a {} read rate={rate}", digest("a"))).expect("right");
    let before = keys("1/h");
    before
        .find(digest("a"))
        .expect("there")
        .take()
        .expect("the first");
    let same = keys("1/h").going_on_from(&before);
    assert!(same.find(digest("a")).expect("there").take().is_err());
    let other = keys("2/h").going_on_from(&before);
    assert!(other.find(digest("a")).expect("there").take().is_ok());
}

fn line() -> impl Strategy<Value = String> {
    let scopes = prop::sample::subsequence(vec!["read", "ingest", "train", "admin"], 1..=4);
    let patterns = prop::option::of(prop::collection::vec("[a-z0-9.*_-]{1,12}", 1..4));
    let rate = prop::option::of((1_u32.., "[smh]"));
    (
        "[a-z0-9][a-z0-9._-]{0,62}",
        any::<[u8; 32]>(),
        scopes,
        patterns,
        rate,
    )
        .prop_map(|(name, key, scopes, patterns, rate)| {
            let patterns = patterns.map_or_else(String::new, |patterns| {
                format!(" environments={}", patterns.join(","))
            });
            let rate = rate.map_or_else(String::new, |(number, unit)| {
                format!(" rate={number}/{unit}")
            });
            format!(
                "{name} {} {}{patterns}{rate}",
                KeyDigest::of_key(&key),
                scopes.join(",")
            )
        })
}

proptest! {
    #[test]
    fn a_line_that_is_read_is_written_as_it_was(text in line()) {
        let line: Line = text.parse().map_err(|faults| TestCaseError::fail(format!("{faults:?}")))?;
        prop_assert_eq!(line.to_string(), text);
    }
}

/// Throws at the parsers whatever is near to what they take: for a moment, or as long as
/// `NUDGE_FUZZ_SECONDS` says.
#[test]
fn parsers_survive_anything() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;

    let seconds = std::env::var("NUDGE_FUZZ_SECONDS")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(1);
    let until = Instant::now() + Duration::from_secs(seconds);
    let mut runner = TestRunner::default();
    let noise = "([ -~]|\\PC|[ \t\r\n#=,*/]|nudge_){0,80}";
    let file = prop_oneof![
        prop::collection::vec(line(), 0..5).prop_map(|lines| lines.join("\n")),
        noise,
        (line(), noise, 0_usize..200).prop_map(|(mut line, noise, at)| {
            line.insert_str(line.floor_char_boundary(at.min(line.len())), &noise);
            line
        }),
    ];
    let header = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..600),
        "(Bearer|bearer) nudge_[0-9a-f]{1,64}".prop_map(String::into_bytes),
        "[Bb]earer[ \t]{0,3}[ -~]{0,80}".prop_map(String::into_bytes),
    ];
    let (mut read, mut found) = (0, 0);
    while Instant::now() < until {
        let text = file.new_tree(&mut runner).expect("a text").current();
        match Keys::parse(&text) {
            Ok(keys) => read += keys.len(),
            Err(faults) => {
                assert!(!faults.is_empty() && faults.iter().all(|fault| fault.starts_with("line ")))
            }
        }
        let headers = prop::collection::vec(&header, 0..3)
            .new_tree(&mut runner)
            .expect("headers")
            .current();
        if let Ok(Some(key)) = bearer(headers.iter().map(Vec::as_slice)) {
            assert!(!key.is_empty() && key.is_ascii() && headers.len() == 1);
            found += 1;
        }
    }
    assert!(
        read > 0 && found > 0,
        "right ones were among them: {read} lines, {found} headers"
    );
}
