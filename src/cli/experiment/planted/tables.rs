//! Report of contingency tables with planted influence as text.

use super::figures::{spread, targets};
use crate::cli::output::{Table, count};
use crate::experiments::findings::REVISION;
use crate::experiments::measures::Spread;
use crate::experiments::planted::{
    Figure, Method, Report, SHARES, Target, USUAL_SHARE, World, arm_name, generator_name,
};
use crate::simulation::planted::{Arm, Generator};

/// The figures by which methods are compared.
const COMPARED: [Figure; 9] = [
    Figure::AucPlanted,
    Figure::AucStrong,
    Figure::F1,
    Figure::Rmse,
    Figure::Coverage,
    Figure::CoverageDependent,
    Figure::Precision,
    Figure::Recall,
    Figure::Undecided,
];

/// The figures that show what is called influence where there is little of it, or nothing else.
const CALLED: [(&str, Method, Figure); 7] = [
    (
        "mean P(dependent)",
        Method::SpikeAndSlab,
        Figure::MeanProbability,
    ),
    ("established", Method::SpikeAndSlab, Figure::Established),
    ("falsely", Method::SpikeAndSlab, Figure::FalselyEstablished),
    ("called", Method::SpikeAndSlab, Figure::Called),
    ("falsely", Method::SpikeAndSlab, Figure::FalselyCalled),
    (
        "called by the paper's rule",
        Method::PapersFilter,
        Figure::Called,
    ),
    ("falsely", Method::PapersFilter, Figure::FalselyCalled),
];

/// Returns the report as people read it.
pub(super) fn render(report: &Report) -> String {
    let mut text = format!(
        "planted influence, nudge {}: {}, {} states, {USUAL_SHARE} % of them with influence; mean ±sd over seeds\n",
        REVISION,
        report.options.seeds,
        count(report.options.states as u64),
    );

    for generator in Generator::USUAL {
        let letters = generator.alphabet().rows;
        text += &format!(
            "\n{}: {letters} x {letters} actions\n{}",
            generator_name(generator),
            compared(report, generator)
        );
    }

    text += &format!(
        "\n{} where there is less to go by, or nothing\n{}",
        Figure::AucPlanted.as_str(),
        arms(report)
    );
    text += &format!(
        "\nwhat is said of whole worlds, % of states\n{}",
        called(report)
    );
    text += &format!(
        "\ntargets, stated for 2,500 states and at least 10 seeds; precision where 20 or more are called\n{}",
        targets(&report.targets(), &["world"], named)
    );
    text
}

fn compared(report: &Report, generator: Generator) -> String {
    let mut table = Table::new(&[&["decision"], COMPARED.map(Figure::as_str).as_slice()].concat());
    let world = report.options.compared(generator, Arm::Plain);
    for method in Method::ALL {
        let cells = COMPARED
            .iter()
            .map(|figure| spread(report.findings.find(&world, method, *figure)));
        table.row(std::iter::once(method.as_str().to_owned()).chain(cells));
    }
    table.render("")
}

fn arms(report: &Report) -> String {
    let titles = Generator::USUAL.map(generator_name);
    let mut table = Table::new(&[&["arm", "decision"], titles.as_slice()].concat());
    for arm in [Arm::Plain, Arm::LeakFree, Arm::Shuffled] {
        for method in Method::ALL
            .into_iter()
            .filter(|method| *method != Method::PapersFilter)
        {
            let area = |generator| {
                report.findings.find(
                    &report.options.compared(generator, arm),
                    method,
                    Figure::AucPlanted,
                )
            };
            let named = [arm_name(arm), method.as_str()].map(str::to_owned);
            table.row(
                named
                    .into_iter()
                    .chain(Generator::USUAL.map(|generator| spread(area(generator)))),
            );
        }
    }

    table.render("")
}

fn called(report: &Report) -> String {
    let titles = CALLED.map(|(title, ..)| title);
    let mut table =
        Table::new(&[&["world", "states", "with influence"], titles.as_slice()].concat());
    let mut row = |name: &str, world: World| {
        let cell = |(_, method, figure)| report.findings.find(&world, method, figure);
        let named = [
            name.to_owned(),
            count(world.states as u64),
            format!("{} %", world.dependent),
        ];
        table.row(
            named
                .into_iter()
                .chain(CALLED.map(|column| percent(cell(column)))),
        );
    };

    for generator in Generator::USUAL {
        let name = generator_name(generator);
        for states in report.options.sizes() {
            for dependent in SHARES {
                row(
                    name,
                    World {
                        generator,
                        arm: Arm::Plain,
                        states,
                        dependent,
                    },
                );
            }
        }
        row(
            &format!("{name} shuffled"),
            report.options.compared(generator, Arm::Shuffled),
        );
    }

    table.render("")
}

/// Returns a share in percent, without its unit.
fn percent(share: Option<Spread>) -> String {
    share.map_or("-".to_owned(), |share| format!("{:.1}", share.mean * 100.0))
}

fn named(target: &Target) -> Vec<String> {
    let names = [
        generator_name(target.world.generator),
        target.method.as_str(),
        target.figure.as_str(),
    ];
    names.map(str::to_owned).to_vec()
}
