//! Tests of derived features: their alphabets, and bins against the labels that people read.

use proptest::prelude::*;

use super::*;
use crate::domain::SchemaDraft;
use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

fn schema() -> Schema {
    let feature = |(name, kind): (&str, KindDraft)| FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![kind],
    };
    let held = || KindDraft::Categorical(["nothing", "onion", "dish"].map(String::from).to_vec());
    let state = [
        ("a.x", KindDraft::Integer(1, 5)),
        ("a.y", KindDraft::Integer(0, 2)),
        ("b.x", KindDraft::Integer(3, 9)),
        ("b.y", KindDraft::Integer(-4, -2)),
        ("a.held", held()),
        ("b.held", held()),
        ("a.heading", KindDraft::Circular(4, None)),
        ("b.heading", KindDraft::Circular(4, None)),
        ("bearing", KindDraft::Circular(8, None)),
        ("a.way", KindDraft::Continuous(vec![0.5, 1.0])),
        ("b.way", KindDraft::Continuous(vec![0.5, 1.0])),
        ("far", KindDraft::Integer(-(1 << 24), 1 << 24)),
    ];
    let agent = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![feature(("go", KindDraft::Integer(0, 1)))],
        ..AgentDraft::default()
    };
    let draft = SchemaDraft {
        state: state.into_iter().map(feature).collect(),
        agents: vec![agent("robot"), agent("human")],
        lags: vec![1],
        ..SchemaDraft::default()
    };
    Schema::try_from(&draft).expect("valid")
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().copied().map(String::from).collect()
}

fn named(name: &str, kind: DerivedKindDraft) -> DerivedDraft {
    DerivedDraft {
        name: name.into(),
        kinds: vec![kind],
    }
}

fn difference(name: &str, of: &[&str]) -> DerivedDraft {
    named(name, DerivedKindDraft::Difference(names(of)))
}

fn equal(name: &str, of: &[&str]) -> DerivedDraft {
    named(name, DerivedKindDraft::Equal(names(of)))
}

fn manhattan(name: &str, of: &[&[&str]]) -> DerivedDraft {
    let pairs = of.iter().map(|pair| names(pair)).collect();
    named(name, DerivedKindDraft::Manhattan(pairs))
}

fn drafts() -> Vec<DerivedDraft> {
    vec![
        difference("dx", &["b.x", "a.x"]),
        manhattan("distance", &[&["a.x", "b.x"], &["b.y", "a.y"]]),
        equal("same_x", &["a.x", "b.x"]),
        equal("same_held", &["a.held", "b.held"]),
        equal("same_way", &["a.way", "b.way"]),
        difference("turned", &["b.heading", "a.heading"]),
    ]
}

#[test]
fn alphabets_hold_what_can_be() {
    let derived = DerivedFeatures::checked(&drafts(), &schema()).expect("valid");
    let expected: Vec<String> = derived.iter().map(|one| one.kind.expected()).collect();
    assert_eq!(
        expected,
        [
            "a whole number from -2 to 8",
            // 0 to 8 apart in x, 2 to 6 in y.
            "a whole number from 2 to 14",
            "one of false, true, or an index from 0 to 1",
            "one of false, true, or an index from 0 to 1",
            "one of false, true, or an index from 0 to 1",
            "a finite angle in radians",
        ]
    );
    let formulas: Vec<String> = derived.iter().map(|one| one.formula(&schema())).collect();
    assert_eq!(
        formulas[..3],
        ["b.x - a.x", "|a.x - b.x| + |b.y - a.y|", "a.x = b.x"]
    );
}

#[test]
fn descriptions_come_back_as_they_were() {
    let derived = DerivedFeatures::checked(&drafts(), &schema()).expect("valid");
    assert_eq!(derived.draft(&schema()), drafts());
}

#[test]
fn every_fault_is_listed_by_pointer() {
    let drafts = [
        difference("Dx", &["a.x", "b.z"]),
        difference("a.x", &["a.x", "b.x", "a.y"]),
        difference("human@1", &["a.x", "a.x"]),
        difference("robot", &["a.way", "b.way"]),
        difference("held", &["a.held", "a.x"]),
        difference("held", &["bearing", "a.heading"]),
        equal("e", &["a.held", "a.x"]),
        manhattan("m", &[]),
        manhattan("n", &[&["a.x", "b.x"], &["a.held", "b.held"], &["q", "r"]]),
        difference("o", &["far", "a.x"]),
        DerivedDraft::default(),
    ];
    let faults = DerivedFeatures::checked(&drafts, &schema()).expect_err("wrong");
    let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
    assert_eq!(
        pointers,
        [
            "/derived/1/name",
            "/derived/2/name",
            "/derived/3/name",
            "/derived/5/name",
            "/derived/0/name",
            "/derived/0/difference/1",
            "/derived/1/difference",
            "/derived/2/name",
            "/derived/2/difference",
            "/derived/3/difference",
            "/derived/4/difference",
            "/derived/5/difference",
            "/derived/6/equal",
            "/derived/7/manhattan",
            "/derived/8/manhattan/1",
            "/derived/8/manhattan/2/0",
            "/derived/8/manhattan/2/1",
            "/derived/9/difference",
            "/derived/10/name",
            "/derived/10",
        ]
    );
    let many = vec![difference("x", &["a.x", "b.x"]); MOST_DERIVED + 1];
    let faults = DerivedFeatures::checked(&many, &schema()).expect_err("too many");
    assert_eq!(
        faults[0].to_string(),
        "/derived: got 65 features, expected 0 to 64"
    );
}

proptest! {
    /// Values of bins, by the labels that people read.
    #[test]
    fn bins_are_those_of_the_values(bins in schema_bins()) {
        let schema = schema();
        let derived = DerivedFeatures::checked(&drafts(), &schema).expect("valid");
        let key = StateKey::new(&bins);
        let value = |name: &str| {
            let at = schema.state().iter().position(|one| one.name.as_str() == name).expect("there");
            schema.state()[at].kind.bin_label(bins[at])
        };
        let number = |name: &str| value(name).parse::<i64>().expect("a whole number");
        let [ax, bx, ay, by] = ["a.x", "b.x", "a.y", "b.y"].map(number);
        let told: Vec<String> = derived.iter().map(|one| one.kind.bin_label(one.bin(&key))).collect();
        prop_assert_eq!(&told[..5], [
            (bx - ax).to_string(),
            ((ax - bx).abs() + (ay - by).abs()).to_string(),
            (ax == bx).to_string(),
            (value("a.held") == value("b.held")).to_string(),
            (value("a.way") == value("b.way")).to_string(),
        ]);
        // A quarter of a turn is a sector.
        let quarters = (bins[7] + 4 - bins[6]) % 4;
        prop_assert_eq!(derived[5].bin(&key), quarters);
        for one in derived.iter() {
            prop_assert!(one.bin(&key) < one.kind.bins());
        }
    }
}

fn schema_bins() -> impl Strategy<Value = Vec<u32>> {
    let bins: Vec<_> = schema()
        .state()
        .iter()
        .map(|one| 0..one.kind.bins())
        .collect();
    bins
}
