//! Tests of regions and grains: words, pointers, and membership against the bins one by one.

use proptest::prelude::*;

use super::*;
use crate::domain::draft::{
    AgentDraft, ConditionDraft, DerivedDraft, DerivedKindDraft, FeatureDraft, KindDraft,
    RangeDraft, ValueDraft,
};
use crate::domain::{CoarseKey, DerivedFeatures, Grain, Schema, SchemaDraft};

fn schema() -> Schema {
    let feature = |(name, unit, kind): (&str, Option<&str>, KindDraft)| FeatureDraft {
        name: name.into(),
        unit: unit.map(String::from),
        kinds: vec![kind],
    };
    let labels = |labels: &[&str]| {
        KindDraft::Categorical(labels.iter().copied().map(String::from).collect())
    };
    let state = [
        ("a.x", None, KindDraft::Integer(1, 5)),
        ("b.x", None, KindDraft::Integer(-2, 5)),
        (
            "held",
            None,
            labels(&["nothing", "onion", "dish", "1,2", "a..b", "#0"]),
        ),
        ("door", None, labels(&["2", "0", "1"])),
        (
            "gap",
            Some("m"),
            KindDraft::Continuous(vec![0.5, 0.7, 1.0, 3.0]),
        ),
        ("one", None, KindDraft::Continuous(vec![])),
        ("bearing", Some("deg"), KindDraft::Circular(8, None)),
    ];
    let agent = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![feature(("go", None, KindDraft::Integer(0, 1)))],
        ..AgentDraft::default()
    };
    let draft = SchemaDraft {
        state: state.into_iter().map(feature).collect(),
        agents: vec![agent("robot"), agent("human")],
        ..SchemaDraft::default()
    };
    Schema::try_from(&draft).expect("valid")
}

fn coordinates() -> Coordinates {
    let names = || ["b.x", "a.x"].map(String::from).to_vec();
    let derived = [
        ("dx", DerivedKindDraft::Difference(names())),
        ("distance", DerivedKindDraft::Manhattan(vec![names()])),
        ("same", DerivedKindDraft::Equal(names())),
    ];
    let derived = derived.map(|(name, kind)| DerivedDraft {
        name: name.into(),
        kinds: vec![kind],
    });
    let schema = schema();
    let derived = DerivedFeatures::checked(&derived, &schema).expect("valid");
    Coordinates::new(&schema, &derived)
}

const NAMES: [&str; 10] = [
    "a.x", "b.x", "held", "door", "gap", "one", "bearing", "dx", "distance", "same",
];

fn read(words: &[&str]) -> Result<Region, Vec<Fault>> {
    Region::checked(&RegionDraft::of_words(words)?, &coordinates())
}

fn bins(words: &[&str]) -> Vec<u32> {
    let region = read(words).expect("valid");
    assert_eq!(region.0.len(), 1, "{region}");
    region.0[0].bins.bins().collect()
}

#[test]
fn conditions_are_sets_of_bins() {
    let cases: &[(&str, &[u32])] = &[
        ("a.x=2", &[1]),
        ("a.x=2,5,2.0", &[1, 4]),
        ("a.x=#2,#0", &[0, 2]),
        ("a.x=2..3", &[1, 2]),
        ("a.x=4..", &[3, 4]),
        ("b.x=..-1", &[0, 1]),
        ("b.x=-1..-1", &[1]),
        ("held=dish,onion", &[1, 2]),
        ("held=\"1,2\",nothing", &[0, 3]),
        ("held=\"a..b\"", &[4]),
        ("held=\"#0\"", &[5]),
        ("held=#0", &[0]),
        // By the label that reads so, not by its index.
        ("door=2", &[0]),
        ("door=#2", &[2]),
        ("gap=0.7..3", &[2, 3]),
        ("gap=..0.5", &[0]),
        ("gap=1..", &[3, 4]),
        // A value stands for the bin that it lies in, as in a state.
        ("gap=0.6", &[1]),
        ("gap=0.7,9", &[2, 4]),
        ("gap=\"[0.5, 0.7)\",>= 3", &[1, 4]),
        ("gap=\"< 0.5\"", &[0]),
        ("bearing=44,359", &[0, 1]),
        ("distance=1..2", &[1, 2]),
        ("dx=-7", &[0]),
        ("same=true", &[1]),
    ];
    for (word, expected) in cases {
        assert_eq!(bins(&[word]), *expected, "{word}");
    }
}

#[test]
fn a_range_ends_before_below_and_with_to() {
    let range = |to: Option<f64>, below: Option<f64>| {
        let number = ValueDraft::Number;
        let range = RangeDraft {
            from: Some(number(2.0)),
            to: to.map(number),
            below: below.map(number),
        };
        let draft = RegionDraft(vec![("a.x".into(), ConditionDraft::Between(range))]);
        Region::checked(&draft, &coordinates()).expect("valid")
    };
    assert_eq!(range(Some(3.0), None), range(None, Some(4.0)));
    assert_eq!(range(Some(5.0), None), range(None, None));
    assert_eq!(range(None, Some(6.0)), range(None, None));
}

#[test]
fn regions_are_told_in_words() {
    for (words, told) in [
        (&[][..], "everywhere"),
        (&["a.x=1..5", "gap=..3,"][..1], "everywhere"),
        (
            &["distance=1..2", "held=dish,onion"],
            "held onion or dish, distance 1 to 2",
        ),
        (&["a.x=1,3,4,5"], "a.x 1 or 3 to 5"),
        (&["gap=0.7..3"], "gap 0.7 to 3 m"),
        (&["gap=#0,#4,#2"], "gap below 0.5, 0.7 to 1 or from 3 m"),
        (&["bearing=#7,#0"], "bearing 0 or -45 deg"),
        (&["same=false", "one=3"], "same false"),
    ] {
        assert_eq!(read(words).expect("valid").to_string(), told);
    }
}

#[test]
fn every_fault_is_listed_by_pointer() {
    let wrong = [
        vec!["a.x=6", "hold=onion", "gap=0.6..3.5"],
        vec!["held=onion,oinon,#", "a.x=3..2", "a.x=1..9"],
        vec![
            "held=nothing..onion",
            "bearing=0..90",
            "one=0..1",
            "gap=x..",
            "dx=#99",
        ],
        vec!["door=3", "door=2", "door=1", "distance=1.5..2"],
    ];
    let drafts: Vec<RegionDraft> = wrong
        .iter()
        .map(|words| RegionDraft::of_words(words).unwrap_or_default())
        .collect();
    let faults = Region::several(&drafts, &coordinates()).expect_err("wrong");
    let told: Vec<String> = faults.iter().map(Fault::to_string).collect();
    let single = "expected a value, a list of values, or bins";
    assert_eq!(
        told,
        [
            "/regions/0/a.x: got 6, expected a whole number from 1 to 5",
            "/regions/0/hold: unknown feature \"hold\"; did you mean `held`?",
            "/regions/0/gap/from: got \"0.6\", inside a bin: expected an edge, 0.5 or 0.7",
            "/regions/0/gap/to: got \"3.5\", inside a bin: expected an edge, 3",
            &format!("/regions/2/held: got a range of labels, which have no order: {single}"),
            &format!("/regions/2/bearing: got a range of angles, which go round: {single}"),
            &format!("/regions/2/one: got a range of a feature with a single bin: {single}"),
            "/regions/2/gap/from: got \"x\", expected an edge",
            "/regions/2/dx/bins/0: got \"99\", expected a bin from 0 to 11",
            "/regions/3/door: got \"3\", expected one of 2, 0, 1",
            "/regions/3/distance/from: got \"1.5\", expected a whole number from 0 to 7",
            "/regions/3/door: given twice, expected once",
        ]
    );
    let faults = read(&["a.x=3..2"]).expect_err("nothing");
    assert_eq!(
        faults[0].to_string(),
        "/a.x/to: got \"2\", expected at least from, which is \"3\""
    );
    let many = vec![RegionDraft::default(); MOST_REGIONS + 1];
    assert!(Region::several(&many, &coordinates()).is_err());
}

#[test]
fn ranges_without_a_bin_are_refused() {
    let number = |number| Some(ValueDraft::Number(number));
    for (from, to, below, told) in [
        (
            None,
            None,
            None,
            ": got an object without any, expected from, to, below or bins",
        ),
        (
            None,
            number(2.0),
            number(3.0),
            "/below: got both to and below, expected one of them",
        ),
        (
            number(3.0),
            None,
            number(3.0),
            "/below: got 3, expected more than from, which is 3",
        ),
        (
            None,
            None,
            number(1.0),
            "/below: got 1, expected a whole number from 2 to 6",
        ),
        (
            number(f64::NAN),
            None,
            None,
            "/from: got NaN, expected a whole number from 1 to 5",
        ),
        (
            number(1e300),
            None,
            None,
            "/from: got 1e300, expected a whole number from 1 to 5",
        ),
    ] {
        let range = ConditionDraft::Between(RangeDraft { from, to, below });
        let draft = RegionDraft(vec![("a.x".into(), range)]);
        let faults = Region::checked(&draft, &coordinates()).expect_err("wrong");
        assert_eq!(
            format!("{}: {}", faults[0].pointer, faults[0].detail),
            format!("/a.x{told}")
        );
    }
    let none = RegionDraft(vec![("a.x".into(), ConditionDraft::AnyOf(Vec::new()))]);
    assert!(Region::checked(&none, &coordinates()).is_err());
}

#[test]
fn words_that_say_nothing_are_refused() {
    for (word, pointer) in [
        ("", ""),
        ("held", ""),
        ("held=", "/held"),
        ("held=onion,,dish", "/held"),
        ("held=onion,", "/held"),
        ("held=\"onion", "/held"),
        ("held=\"onion\"dish", "/held"),
        ("held=onion,#0", "/held"),
        ("a.x=..", "/a.x"),
    ] {
        let faults = RegionDraft::of_words(&[word]).expect_err(word);
        assert_eq!(faults[0].pointer, pointer, "{word}");
        assert!(
            faults[0].detail.contains("expected FEATURE=VALUE"),
            "{word}"
        );
    }
}

/// Some bins of some coordinates.
fn chosen() -> impl Strategy<Value = Vec<(usize, Vec<u32>)>> {
    let bins = coordinates();
    let bins = NAMES.map(|name| bins.find(name).expect("there").kind().bins());
    let one = (0..NAMES.len())
        .prop_flat_map(move |at| (Just(at), proptest::collection::vec(0..bins[at], 1..9)));
    proptest::collection::vec(one, 0..6).prop_map(|mut chosen| {
        chosen.sort();
        chosen.dedup_by_key(|(at, _)| *at);
        chosen
    })
}

fn states() -> impl Strategy<Value = StateKey> {
    let bins: Vec<_> = schema()
        .state()
        .iter()
        .map(|one| 0..one.kind.bins())
        .collect();
    bins.prop_map(|bins| StateKey::new(&bins))
}

fn region(chosen: &[(usize, Vec<u32>)]) -> Region {
    let condition = |(at, bins): &(usize, Vec<u32>)| {
        let bins = bins.iter().map(|bin| ValueDraft::Number(f64::from(*bin)));
        (NAMES[*at].to_owned(), ConditionDraft::Bins(bins.collect()))
    };
    // In whichever order.
    let draft = RegionDraft(chosen.iter().rev().map(condition).collect());
    Region::checked(&draft, &coordinates()).expect("valid")
}

proptest! {
    #[test]
    fn a_region_has_the_states_of_all_its_bins(chosen in chosen(), key in states()) {
        let coordinates = coordinates();
        let is_met = |(at, bins): &(usize, Vec<u32>)| {
            bins.contains(&coordinates.find(NAMES[*at]).expect("there").bin(&key))
        };
        prop_assert_eq!(region(&chosen).contains(&key), chosen.iter().all(is_met));
    }

    #[test]
    fn its_description_means_the_same_region(chosen in chosen()) {
        let region = region(&chosen);
        let again = Region::checked(&region.draft(), &coordinates()).expect("its own");
        prop_assert_eq!((again.draft(), &again), (region.draft(), &region));
        prop_assert_eq!(region.is_everything(), region.to_string() == "everywhere");
    }

    #[test]
    fn any_words_are_read_or_refused(words in proptest::collection::vec("(held|gap|dx|x)?=?[\"#.,=0-9a-z -]{0,9}", 0..4)) {
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        match read(&words) {
            Ok(region) => prop_assert!(!region.to_string().is_empty()),
            Err(faults) => prop_assert!(!faults.is_empty()),
        }
    }

    #[test]
    fn a_coarse_state_has_the_bins_that_are_kept(
        kept in proptest::sample::subsequence(NAMES.to_vec(), 0..NAMES.len()).prop_shuffle(),
        two in [states(), states()],
    ) {
        let coordinates = coordinates();
        let grain = Grain::checked(&kept, &coordinates).expect("valid");
        let bins = |key: &StateKey| -> Vec<u32> {
            grain.kept().iter().map(|one| one.bin(key)).collect()
        };
        let coarse = [&two[0], &two[1]].map(|key| grain.coarse(key));
        prop_assert_eq!(grain.bins(coarse[0]), bins(&two[0]));
        prop_assert_eq!(coarse[0].cmp(&coarse[1]), bins(&two[0]).cmp(&bins(&two[1])));

        let left_out: Vec<&str> = grain.left_out().iter().map(|one| one.name().as_str()).collect();
        let expected: Vec<&str> = NAMES[..7].iter().copied().filter(|name| !kept.contains(name)).collect();
        prop_assert_eq!(left_out, expected);
    }
}

#[test]
fn a_grain_lists_its_faults_by_pointer() {
    let faults = Grain::checked(&["dx", "gpa", "dx"], &coordinates()).expect_err("wrong");
    let told: Vec<String> = faults.iter().map(Fault::to_string).collect();
    assert_eq!(
        told,
        [
            "/features/1: unknown feature \"gpa\"; did you mean `gap`?",
            "/features/2: \"dx\" is used twice",
        ]
    );
    let whole = Grain::checked::<&str>(&[], &coordinates()).expect("valid");
    let key = schema().key_of_text("4.7.5.2.4.0.7").expect("a state");
    assert_eq!(
        (whole.coarse(&key), whole.left_out().len()),
        (CoarseKey(0), 7)
    );
}
