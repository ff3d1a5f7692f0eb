//! Report of kitchens as text: tables of methods in states that were never counted.

use super::figures::{spread, targets};
use crate::cli::output::{Table, count};
use crate::experiments::findings::REVISION;
use crate::experiments::kitchens::{Facts, Figure, Method, Report, Target, World};

/// Returns the report as people read it.
pub(super) fn render(report: &Report) -> String {
    let mut text = format!(
        "planted influence in kitchens, nudge {}: {}; states that were never counted, by time steps of the test games; mean ±sd over seeds\n",
        REVISION, report.options.seeds,
    );

    for (world, facts) in &report.worlds {
        text += &format!("\n{}\n{}", titled(world, facts), compared(report, world));
    }

    text += &format!(
        "\ntargets, stated for 5 seeds or more\n{}",
        targets(&report.targets(), &["layout", "manner"], named)
    );
    text
}

fn titled(
    World {
        layout,
        response_model,
    }: &World,
    facts: &Facts,
) -> String {
    let [counted, unseen, steps] =
        [facts.counted, facts.unseen, facts.steps].map(|number| count(number as u64));
    format!(
        "{} as {}, {}: {counted} steps counted; {unseen} states unseen, {steps} steps in them, {:.1} % with influence",
        layout.as_str(),
        layout.abstraction(),
        response_model.as_str(),
        100.0 * facts.strong_share(),
    )
}

fn compared(report: &Report, world: &World) -> String {
    let mut table =
        Table::new(&[&["decision"], Figure::ALL.map(Figure::as_str).as_slice()].concat());
    for method in Method::ALL {
        let cells =
            Figure::ALL.map(
                |figure| match (figure, report.findings.find(world, method, figure)) {
                    (Figure::Called, Some(states)) => {
                        format!("{:.1} ±{:.1}", states.mean, states.sd.unwrap_or(0.0))
                    }
                    (_, told) => spread(told),
                },
            );
        table.row([method.as_str().to_owned()].into_iter().chain(cells));
    }
    table.render("")
}

fn named(target: &Target) -> Vec<String> {
    let World {
        layout,
        response_model,
    } = target.world;
    [
        layout.as_str(),
        response_model.as_str(),
        target.method.as_str(),
        target.figure.as_str(),
    ]
    .map(str::to_owned)
    .to_vec()
}
