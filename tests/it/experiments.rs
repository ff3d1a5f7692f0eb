//! The experiments, small: that their bytes repeat, that nothing is found where nothing is, and that the default rule earns its place.

use std::path::Path;
use std::process::{Command, Output};

use nudge::experiments::kitchens::{self, Layout, Manner};
use nudge::experiments::planted::{Decision, Figure, Options, Report, run};
use nudge::experiments::seeds::Seeds;
use nudge::simulation::planted::{Arm, Generator};
use serde_json::Value;

/// Large enough for a fit, small enough for a test.
const SMALL: Options = Options { seeds: Seeds { number: 2, first: 1 }, states: 120 };

fn mean(report: &Report, generator: Generator, arm: Arm, decision: Decision, figure: Figure) -> f64 {
    report.findings.find(&SMALL.compared(generator, arm), decision, figure).expect("defined").mean
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_default_rule_finds_what_is_planted_and_nothing_else() {
    let mut worlds = 0;
    let report = run(&SMALL, || worlds += 1).await.expect("a temporary directory");
    assert_eq!(worlds, SMALL.worlds().len() * 2);
    for generator in Generator::USUAL {
        let of = |arm, decision, figure| mean(&report, generator, arm, decision, figure);
        let area = |decision| of(Arm::Plain, decision, Figure::AucPlanted);
        assert!(area(Decision::SpikeAndSlab) > area(Decision::PlugIn) + 0.03, "{generator:?}");
        let error = |decision| of(Arm::Plain, decision, Figure::Rmse);
        assert!(error(Decision::SpikeAndSlab) < 0.7 * error(Decision::PlugIn), "{generator:?}");

        let shuffled = |decision, figure| of(Arm::Shuffled, decision, figure);
        assert!(shuffled(Decision::SpikeAndSlab, Figure::MeanProbability) < 0.1, "{generator:?}");
        assert!(shuffled(Decision::PapersFilter, Figure::FalselyCalled) > 0.05, "bias passes for influence there");
        for never in [Figure::FalselyCalled, Figure::FalselyEstablished] {
            assert!(shuffled(Decision::SpikeAndSlab, never) < 0.01, "{generator:?}: {never:?}");
        }
    }
    assert_eq!(report.targets().len(), 18);
    assert!(report.targets().iter().all(|target| target.measured.is_some()), "every target was measured");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_was_never_counted_is_told_by_what_was() {
    let seeds = Seeds { number: 1, first: 1 };
    let (layouts, manners) = (vec![Layout::AsymmetricAdvantages], vec![Manner::Yield]);
    let options = kitchens::Options { seeds, layouts, manners, epochs: 10, steps: Some(2_500) };
    let mut worlds = 0;
    let report = kitchens::run(&options, || worlds += 1).await.expect("a temporary directory");
    assert_eq!((worlds, report.worlds[0].1.unseen), (1, 1_445));

    let world = options.worlds()[0];
    let of = |decision, figure| report.findings.find(&world, decision, figure).expect("defined").mean;
    for decision in kitchens::Decision::ALL {
        kitchens::Figure::ALL.iter().for_each(|figure| assert!(of(decision, *figure).is_finite()));
    }
    let f1 = |decision| of(decision, kitchens::Figure::F1);
    assert!(f1(kitchens::Decision::Oracle) > 0.99);
    assert_eq!(
        (f1(kitchens::Decision::LookUp), of(kitchens::Decision::LookUp, kitchens::Figure::Undecided)),
        (0.0, 1.0)
    );
    assert!(f1(kitchens::Decision::Joint) > f1(kitchens::Decision::AllPositive) + 0.2);
    assert_eq!(of(kitchens::Decision::Shuffled, kitchens::Figure::Called), 0.0);
    assert!(report.targets().iter().all(|target| target.measured.is_some()), "every target was measured");

    let again = kitchens::run(&options, || ()).await.expect("a temporary directory");
    assert_eq!((report.findings.csv(), kitchens::plot(&report)), (again.findings.csv(), kitchens::plot(&again)));
}

fn planted(out: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nudge"));
    let always = ["experiment", "planted", "--part", "tables", "--seeds", "1", "--seed", "7", "--out"];
    command.args(always).arg(out).args(more);
    command.output().expect("it starts")
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let directory = tempfile::tempdir().expect("a directory");
    let [first, second] = ["first", "second/deeper"].map(|name| directory.path().join(name));
    let [told, again] = [&first, &second].map(|out| planted(out, &["--states", "20"]));
    assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
    assert_eq!(told.stdout, again.stdout);
    for name in ["planted.csv", "planted.json", "planted.svg"] {
        let [bytes, repeated] = [&first, &second].map(|out| std::fs::read(out.join(name)).expect("written"));
        assert_eq!(bytes, repeated, "{name}");
    }
    let text = String::from_utf8(told.stdout).expect("text");
    assert!(text.starts_with("planted influence, nudge 0."), "{text}");
    for part in ["seed 7, 20 states", "G3: 9 x 9 actions", "leak-free", "G1 shuffled", "targets, stated for"] {
        assert!(text.contains(part), "no {part:?} in {text}");
    }
}

#[test]
fn figures_are_told_as_json_and_as_lines() {
    let directory = tempfile::tempdir().expect("a directory");
    let told = planted(directory.path(), &["--states", "10", "--json"]);
    let report: Value = serde_json::from_slice(&told.stdout).expect("JSON");
    assert_eq!(report["parameters"], serde_json::json!({"seeds": 1, "first_seed": 7, "states": 10}));
    let csv = std::fs::read_to_string(directory.path().join("planted.csv")).expect("written");
    let mut lines = csv.lines();
    let titles = "generator,arm,states,dependent_percent,decision,figure,mean,sd,seeds";
    assert_eq!(lines.next(), Some(titles));
    assert_eq!(lines.count(), report["findings"].as_array().expect("a list").len());
}

#[test]
fn a_mistaken_flag_is_named_with_what_was_expected() {
    let directory = tempfile::tempdir().expect("a directory");
    let file = directory.path().join("taken");
    std::fs::write(&file, "").expect("written");
    for (more, expected) in [
        (["--states", "0"], "invalid value '0' for '--states <NUMBER>'"),
        (["--states", "many"], "invalid value 'many' for '--states <NUMBER>'"),
        (["--states", "10"], "error: cannot write "),
    ] {
        let told = planted(&file, &more);
        let stderr = String::from_utf8_lossy(&told.stderr);
        assert_eq!((told.status.code(), told.stdout.len()), (Some(2), 0), "{stderr}");
        assert!(stderr.contains(expected), "{stderr}");
    }
}
