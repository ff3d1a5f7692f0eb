//! Report of hard worlds as text: tables of calibration and of decisions.

use super::figures::{spread, spread_to, targets};
use crate::cli::output::{Table, count};
use crate::experiments::findings::REVISION;
use crate::experiments::measures::Spread;
use crate::experiments::planted::hard::{METHOD, Report, name};
use crate::experiments::planted::{Figure, Target, World};
use crate::simulation::planted::Generator;

/// What is said of mutual information and of any dependence.
const SAID: [Figure; 6] = [
    Figure::AucPlanted,
    Figure::Rmse,
    Figure::Coverage,
    Figure::CoverageDependent,
    Figure::ExcludedIfDependent,
    Figure::EstablishedIfIndependent,
];

/// What is decided.
const DECIDED: [Figure; 6] = [
    Figure::Called,
    Figure::Precision,
    Figure::Undecided,
    Figure::DecidedByMany,
    Figure::WrongByMany,
    Figure::UndecidedByFew,
];

/// Returns the report as people read it.
pub(super) fn render(report: &Report) -> String {
    format!(
        "planted influence in hard worlds, nudge {REVISION}: {}; {}; mean ±sd over seeds\n\n\
         what is said of mutual information, in nats, and of any dependence\n{}\n\
         verdicts; of states with 10,000 visits and more those whose mutual information is over 0.03 nats from the threshold\n{}\n\
         targets, stated for worlds of the usual sizes and at least 10 seeds; none where there are no such states, or fewer than 20 are called\n{}{}",
        report.options.seeds,
        METHOD.as_str(),
        said(report),
        decided(report),
        targets(&report.targets(), &["world"], named),
        of_segments(report),
    )
}

/// Says why one target is missing, where it is.
fn of_segments(report: &Report) -> &'static str {
    let told = report
        .options
        .worlds
        .iter()
        .any(|world| world.generator == Generator::Segments);
    let why = "segments: what is established has no target, for the evidence does not tell segments with habits of their own apart\n";
    if told { why } else { "" }
}

fn said(report: &Report) -> String {
    let titles = SAID.map(Figure::as_str);
    let mut table = Table::new(
        &[
            &["world", "actions", "states", "dependent"],
            titles.as_slice(),
        ]
        .concat(),
    );

    for world in report.options.worlds() {
        let cells =
            SAID.map(
                |figure| match (figure, report.findings.find(&world, METHOD, figure)) {
                    (Figure::Rmse, error) => spread_to(4, error),
                    (_, told) => spread(told),
                },
            );
        table.row(titled(&world).into_iter().chain(cells));
    }

    table.render("")
}

fn titled(world: &World) -> [String; 4] {
    let alphabet = world.generator.alphabet();
    let actions = format!("{} x {}", alphabet.rows, alphabet.columns);
    [
        name(world).to_owned(),
        actions,
        count(world.states as u64),
        format!("{} %", world.dependent),
    ]
}

fn decided(report: &Report) -> String {
    let titles = DECIDED.map(|figure| {
        if figure == Figure::Called {
            "influences"
        } else {
            figure.as_str()
        }
    });
    let mut table = Table::new(&[&["world"], titles.as_slice()].concat());
    for world in report.options.worlds() {
        let cells =
            DECIDED.map(
                |figure| match (figure, report.findings.find(&world, METHOD, figure)) {
                    (Figure::Called, called) => {
                        spread_to(1, called.map(|share| of_states(share, &world)))
                    }
                    (_, told) => spread(told),
                },
            );
        table.row([name(&world).to_owned()].into_iter().chain(cells));
    }

    table.render("")
}

/// Returns a share of states as a number of them.
fn of_states(Spread { mean, sd, seeds }: Spread, world: &World) -> Spread {
    let states = world.states as f64;
    Spread {
        mean: mean * states,
        sd: sd.map(|sd| sd * states),
        seeds,
    }
}

fn named(target: &Target) -> Vec<String> {
    [
        name(&target.world),
        target.method.as_str(),
        target.figure.as_str(),
    ]
    .map(str::to_owned)
    .to_vec()
}
