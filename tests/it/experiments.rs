//! The experiments, small: that their bytes repeat, that nothing is found where nothing is, and
//! that the default rule earns its place.

use std::path::Path;
use std::process::{Command, Output};

use nudge::domain::{Dependence, Independence, Verdict};
use nudge::experiments::kitchens::{self, Layout, ResponseModel};
use nudge::experiments::planted::{
    Case, Figure, Method, Options, Report, Target, World, hard, measure, run,
};
use nudge::experiments::seeds::Seeds;
use nudge::simulation::planted::{Arm, Generator};
use serde_json::Value;

/// Large enough for a fit, small enough for a test.
const SMALL: Options = Options {
    seeds: Seeds {
        number: 2,
        first: 1,
    },
    states: 120,
};

fn mean(report: &Report, generator: Generator, arm: Arm, method: Method, figure: Figure) -> f64 {
    report
        .findings
        .find(&SMALL.compared(generator, arm), method, figure)
        .expect("defined")
        .mean
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_default_rule_finds_what_is_planted_and_nothing_else() {
    let mut worlds = 0;
    let report = run(&SMALL, || worlds += 1)
        .await
        .expect("a temporary directory");
    assert_eq!(worlds, SMALL.worlds().len() * 2);
    for generator in Generator::USUAL {
        let of = |arm, method, figure| mean(&report, generator, arm, method, figure);
        let area = |method| of(Arm::Plain, method, Figure::AucPlanted);
        assert!(
            area(Method::SpikeAndSlab) > area(Method::PlugIn) + 0.03,
            "{generator:?}"
        );
        let error = |method| of(Arm::Plain, method, Figure::Rmse);
        assert!(
            error(Method::SpikeAndSlab) < 0.7 * error(Method::PlugIn),
            "{generator:?}"
        );

        let shuffled = |method, figure| of(Arm::Shuffled, method, figure);
        assert!(
            shuffled(Method::SpikeAndSlab, Figure::MeanProbability) < 0.1,
            "{generator:?}"
        );
        assert!(
            shuffled(Method::PapersFilter, Figure::FalselyCalled) > 0.05,
            "bias passes for influence there"
        );
        for never in [Figure::FalselyCalled, Figure::FalselyEstablished] {
            assert!(
                shuffled(Method::SpikeAndSlab, never) < 0.01,
                "{generator:?}: {never:?}"
            );
        }
    }
    let of_precision = |target: &&Target| target.figure == Figure::Precision;
    assert_eq!(
        report
            .targets()
            .iter()
            .filter(|target| !of_precision(target))
            .count(),
        18
    );
    assert!(
        report
            .targets()
            .iter()
            .all(|target| target.measured.is_some()),
        "every target was measured"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_was_never_counted_is_told_by_what_was() {
    let seeds = Seeds {
        number: 1,
        first: 1,
    };
    let (layouts, response_models) = (
        vec![Layout::AsymmetricAdvantages],
        vec![ResponseModel::Yield],
    );
    let options = kitchens::Options {
        seeds,
        layouts,
        response_models,
        epochs: 10,
        steps: Some(2_500),
    };
    let mut worlds = 0;
    let report = kitchens::run(&options, || worlds += 1)
        .await
        .expect("a temporary directory");
    assert_eq!((worlds, report.worlds[0].1.unseen), (1, 1_445));

    let world = options.worlds()[0];
    let of = |method, figure| {
        report
            .findings
            .find(&world, method, figure)
            .expect("defined")
            .mean
    };
    for method in kitchens::Method::ALL {
        kitchens::Figure::ALL
            .iter()
            .for_each(|figure| assert!(of(method, *figure).is_finite()));
    }
    let f1 = |method| of(method, kitchens::Figure::F1);
    assert!(f1(kitchens::Method::Oracle) > 0.99);
    assert_eq!(
        (
            f1(kitchens::Method::LookUp),
            of(kitchens::Method::LookUp, kitchens::Figure::Undecided)
        ),
        (0.0, 1.0)
    );
    assert!(f1(kitchens::Method::Joint) > f1(kitchens::Method::AllPositive) + 0.2);
    assert_eq!(
        of(kitchens::Method::Shuffled, kitchens::Figure::Called),
        0.0
    );
    assert!(
        report
            .targets()
            .iter()
            .all(|target| target.measured.is_some()),
        "every target was measured"
    );

    let again = kitchens::run(&options, || ())
        .await
        .expect("a temporary directory");
    assert_eq!(
        (report.findings.csv(), kitchens::plot(&report)),
        (again.findings.csv(), kitchens::plot(&again))
    );
}

fn planted(out: &Path, more: &[&str]) -> Output {
    part("tables", out, more)
}

fn part(name: &str, out: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nudge"));
    let always = [
        "experiment",
        "planted",
        "--part",
        name,
        "--seeds",
        "1",
        "--seed",
        "7",
        "--out",
    ];
    command.args(always).arg(out).args(more);
    command.output().expect("it starts")
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let directory = tempfile::tempdir().expect("a directory");
    let [first, second] = ["first", "second/deeper"].map(|name| directory.path().join(name));
    let [told, again] = [&first, &second].map(|out| planted(out, &["--states", "20"]));
    assert!(
        told.status.success(),
        "{}",
        String::from_utf8_lossy(&told.stderr)
    );
    assert_eq!(told.stdout, again.stdout);
    for name in ["planted.csv", "planted.json", "planted.svg"] {
        let [bytes, repeated] =
            [&first, &second].map(|out| std::fs::read(out.join(name)).expect("written"));
        assert_eq!(bytes, repeated, "{name}");
    }
    let text = String::from_utf8(told.stdout).expect("text");
    assert!(text.starts_with("planted influence, nudge 0."), "{text}");
    for part in [
        "seed 7, 20 states",
        "G3: 9 x 9 actions",
        "leak-free",
        "G1 shuffled",
        "targets, stated for",
    ] {
        assert!(text.contains(part), "no {part:?} in {text}");
    }
}

#[test]
fn figures_are_told_as_json_and_as_lines() {
    let directory = tempfile::tempdir().expect("a directory");
    let told = planted(directory.path(), &["--states", "10", "--json"]);
    let report: Value = serde_json::from_slice(&told.stdout).expect("JSON");
    assert_eq!(
        report["parameters"],
        serde_json::json!({"seeds": 1, "first_seed": 7, "states": 10})
    );
    let csv = std::fs::read_to_string(directory.path().join("planted.csv")).expect("written");
    let mut lines = csv.lines();
    let titles = "generator,arm,states,dependent_percent,decision,figure,mean,sd,seeds";
    assert_eq!(lines.next(), Some(titles));
    assert_eq!(
        lines.count(),
        report["findings"].as_array().expect("a list").len()
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hard_worlds_are_judged_where_there_are_states_to_judge_by() {
    let worlds = ["none", "all-dependent", "2x2", "weak", "segments"]
        .map(|name| hard::named(name).expect("a name"));
    let options = hard::Options {
        seeds: Seeds {
            number: 2,
            first: 1,
        },
        states: Some(60),
        worlds: worlds.to_vec(),
    };
    let mut done = 0;
    let report = hard::run(&options, || done += 1)
        .await
        .expect("a temporary directory");
    assert_eq!(done, 2 * worlds.len());

    let [none, all, two, weak, segments] = options.worlds()[..] else {
        panic!("five worlds")
    };
    let of = |world, figure| {
        report
            .findings
            .find(&world, hard::METHOD, figure)
            .map(|spread| spread.mean)
    };
    for world in [none, all, two, weak, segments] {
        let everywhere = [
            Figure::Rmse,
            Figure::Coverage,
            Figure::Called,
            Figure::Undecided,
        ];
        assert!(
            everywhere.iter().all(|figure| of(world, *figure).is_some()),
            "{}",
            hard::name(&world)
        );
        assert_eq!(
            of(world, Figure::DecidedByMany).is_some(),
            world == weak,
            "only weak states are seen so often"
        );
    }
    for independent in [none, segments] {
        assert_eq!(of(independent, Figure::AucPlanted), None);
        assert_eq!(of(independent, Figure::ExcludedIfDependent), None);
    }
    assert_eq!(of(all, Figure::EstablishedIfIndependent), None);
    assert_eq!(
        of(all, Figure::Coverage),
        of(all, Figure::CoverageDependent)
    );
    assert_eq!(
        [
            of(weak, Figure::UndecidedByFew),
            of(segments, Figure::UndecidedByFew)
        ],
        [None; 2]
    );

    let targets = report.targets();
    let judged = |world, figure| {
        targets
            .iter()
            .any(|target| target.world == world && target.figure == figure)
    };
    assert!(targets.iter().all(|target| target.measured.is_some()));
    assert!(
        judged(two, Figure::Rmse) && !judged(weak, Figure::Rmse),
        "a prototype was measured in the first only"
    );
    assert!(
        judged(none, Figure::EstablishedIfIndependent)
            && !judged(segments, Figure::EstablishedIfIndependent)
    );
    assert!(judged(weak, Figure::WrongByMany) && !judged(two, Figure::WrongByMany));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn visits_are_sent_as_counts_of_entries_in_their_segments() {
    for (generator, visits) in [
        (Generator::Weak(6), 1_000..=1_000_000),
        (Generator::Segments, 320..=320),
    ] {
        let world = World {
            generator,
            arm: Arm::Plain,
            states: 3,
            dependent: 50,
        };
        let cases = world
            .cases(1, &[Method::SpikeAndSlab])
            .await
            .expect("a temporary directory");
        assert_eq!(cases.len(), 3);
        for case in cases {
            let seen = case.answer.visits;
            let figures = case.figures().expect("asked for");
            assert!(visits.contains(&seen), "{generator:?}: {seen}");
            assert_eq!(
                (figures.independence, figures.entries),
                (Independence::Entries, Some(seen)),
                "{generator:?}"
            );
        }
    }
}

/// What is said of a state: its visits, its mutual information, and what is told of both questions.
type Said = (u64, f64, Verdict, Dependence);

/// Returns answers of a service in which this is said instead of what it said.
async fn cases(said: &[Said]) -> Vec<Case> {
    let world = World {
        generator: Generator::TwoByTwo,
        arm: Arm::Plain,
        states: said.len(),
        dependent: 30,
    };
    let mut cases = world
        .cases(1, &[Method::SpikeAndSlab])
        .await
        .expect("a temporary directory");
    for (case, (visits, information, verdict, dependence)) in cases.iter_mut().zip(said) {
        (case.information, case.planted) = (*information, *information > 0.0);
        (case.answer.visits, case.answer.verdict) = (*visits, *verdict);
        let figures = case
            .answer
            .figures
            .as_mut()
            .expect("figures were asked for");
        figures
            .evidence
            .as_mut()
            .expect("two actions each")
            .dependence = *dependence;
    }
    cases
}

fn measured(cases: &[Case], figures: &[Figure]) -> Vec<Option<f64>> {
    measure(&[Method::SpikeAndSlab], figures, cases)
        .into_iter()
        .map(|(.., figure)| figure)
        .collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn false_claims_are_shares_of_the_states_that_they_are_false_of() {
    let said = |information, dependence| (12, information, Verdict::Undecided, dependence);
    let said = [
        said(0.2, Dependence::Excluded),
        said(0.2, Dependence::Open),
        said(0.6, Dependence::Established),
        said(0.6, Dependence::Established),
        said(0.0, Dependence::Established),
        said(0.0, Dependence::Excluded),
    ];
    let cases = cases(&said).await;

    let figures = [
        Figure::ExcludedIfDependent,
        Figure::EstablishedIfIndependent,
    ];
    assert_eq!(measured(&cases, &figures), [Some(0.25), Some(0.5)]);
    assert_eq!(
        measured(&cases[..4], &figures),
        [Some(0.25), None],
        "nothing is independent"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn many_visits_must_decide_and_few_must_not() {
    let said = |visits, information, verdict| (visits, information, verdict, Dependence::Open);
    let said = [
        said(10_000, 0.4, Verdict::NoInfluence),
        said(10_000, 0.4, Verdict::Influences),
        said(20_000, 0.6, Verdict::NoInfluence),
        said(20_000, 0.6, Verdict::Undecided),
        said(20_000, 0.52, Verdict::Undecided),
        said(9_999, 0.6, Verdict::NoInfluence),
        said(2, 0.6, Verdict::Influences),
        said(1, 0.6, Verdict::Undecided),
        said(3, 0.6, Verdict::Influences),
    ];
    let cases = cases(&said).await;

    let figures = [
        Figure::DecidedByMany,
        Figure::WrongByMany,
        Figure::UndecidedByFew,
    ];
    assert_eq!(
        measured(&cases, &figures),
        [Some(0.75), Some(0.5), Some(0.5)]
    );
    assert_eq!(
        measured(&cases[4..6], &figures),
        [None; 3],
        "too near the threshold, and seen too little"
    );
}

#[test]
fn a_hard_world_is_chosen_by_its_name_and_repeats() {
    let directory = tempfile::tempdir().expect("a directory");
    let [first, second] = ["first", "second"].map(|name| directory.path().join(name));
    let few = ["--states", "12", "--world", "segments", "--world", "copy"];
    let [told, again] = [&first, &second].map(|out| part("hard", out, &few));
    assert!(
        told.status.success(),
        "{}",
        String::from_utf8_lossy(&told.stderr)
    );
    assert_eq!(told.stdout, again.stdout);
    for name in ["hard.csv", "hard.json", "hard.svg"] {
        let [bytes, repeated] =
            [&first, &second].map(|out| std::fs::read(out.join(name)).expect("written"));
        assert_eq!(bytes, repeated, "{name}");
    }
    let text = String::from_utf8(told.stdout).expect("text");
    assert!(
        text.starts_with("planted influence in hard worlds, nudge 0."),
        "{text}"
    );
    for part in [
        "seed 7; spike and slab",
        "copy      6 x 6        12  30 %",
        "segments: what is established has no target",
    ] {
        assert!(text.contains(part), "no {part:?} in {text}");
    }
    let report: Value =
        serde_json::from_slice(&std::fs::read(first.join("hard.json")).expect("written"))
            .expect("JSON");
    let parameters = serde_json::json!({"seeds": 1, "first_seed": 7, "states": 12, "worlds": ["copy", "segments"]});
    assert_eq!(report["parameters"], parameters);

    let unknown = part("hard", &first, &["--world", "easy"]);
    let stderr = String::from_utf8_lossy(&unknown.stderr);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(
        stderr.contains(r#"got "easy", expected one of all-dependent, none, 2x2"#),
        "{stderr}"
    );
}

#[test]
fn a_world_of_segments_is_chosen_by_its_name_and_repeats() {
    let directory = tempfile::tempdir().expect("a directory");
    let [first, second] = ["first", "second"].map(|name| directory.path().join(name));
    let few = [
        "--states",
        "12",
        "--world",
        "opposite",
        "--world",
        "both-in-one",
    ];
    let [told, again] = [&first, &second].map(|out| part("segments", out, &few));
    assert!(
        told.status.success(),
        "{}",
        String::from_utf8_lossy(&told.stderr)
    );
    assert_eq!(told.stdout, again.stdout);
    for name in ["segments.csv", "segments.json", "segments.svg"] {
        let [bytes, repeated] =
            [&first, &second].map(|out| std::fs::read(out.join(name)).expect("written"));
        assert_eq!(bytes, repeated, "{name}");
    }
    let text = String::from_utf8(told.stdout).expect("text");
    assert!(
        text.starts_with("planted influence in segments, nudge 0."),
        "{text}"
    );
    for part in [
        "seed 7, 12 states",
        "pooled, 30 visits a state",
        "pooled, 150 visits a state",
        "MISSED",
    ] {
        assert!(text.contains(part), "no {part:?} in {text}");
    }
    let report: Value =
        serde_json::from_slice(&std::fs::read(first.join("segments.json")).expect("written"))
            .expect("JSON");
    let worlds = ["opposite", "both-in-one"];
    let parameters =
        serde_json::json!({"seeds": 1, "first_seed": 7, "states": 12, "worlds": worlds});
    assert_eq!(report["parameters"], parameters);
    assert_eq!(report["findings"][0]["within"], "pooled");

    let elsewhere = part("hard", &first, &["--world", "opposite"]);
    let stderr = String::from_utf8_lossy(&elsewhere.stderr);
    assert_eq!(elsewhere.status.code(), Some(2));
    assert!(
        stderr.contains("--world opposite is a world of --part segments, which is not run"),
        "{stderr}"
    );
}

#[test]
fn a_mistaken_flag_is_named_with_what_was_expected() {
    let directory = tempfile::tempdir().expect("a directory");
    let file = directory.path().join("taken");
    std::fs::write(&file, "").expect("written");
    for (more, expected) in [
        (
            ["--states", "0"],
            "invalid value '0' for '--states <NUMBER>'",
        ),
        (
            ["--states", "many"],
            "invalid value 'many' for '--states <NUMBER>'",
        ),
        (["--states", "10"], "error: cannot write "),
    ] {
        let told = planted(&file, &more);
        let stderr = String::from_utf8_lossy(&told.stderr);
        assert_eq!(
            (told.status.code(), told.stdout.len()),
            (Some(2), 0),
            "{stderr}"
        );
        assert!(stderr.contains(expected), "{stderr}");
    }
}
