//! Report of stratified worlds (segments) as text.

use super::figures::{spread, spread_to, targets};
use crate::cli::output::{Table, count};
use crate::experiments::findings::REVISION;
use crate::experiments::planted::segments::{Figure, Report, Target, VISITS, Within, World};
use crate::simulation::planted::segments::Options;

/// Returns the report as people read it.
pub(super) fn render(report: &Report) -> String {
    let mut text = format!(
        "planted influence in segments, nudge {REVISION}: {}, {} states, {:.0} % of them dependent in worlds of some; mean ±sd over seeds\n",
        report.options.seeds,
        count(report.options.states as u64),
        100.0 * Options::default().dependent,
    );

    for (within, visits) in Within::ALL
        .into_iter()
        .flat_map(|within| VISITS.map(|visits| (within, visits)))
    {
        text += &format!(
            "\n{}, {visits} visits a state\n{}",
            within.as_str(),
            found(report, within, visits)
        );
    }
    text += &format!(
        "\ntargets, stated for 200 states and at least 3 seeds; none where there are no such states, or fewer than 20 are established\n{}",
        targets(&report.targets(), &["world", "visits"], named)
    );
    text
}

fn found(report: &Report, within: Within, visits: usize) -> String {
    let titles = Figure::ALL.map(Figure::as_str);
    let mut table = Table::new(&[&["world", "segments", "actions"], titles.as_slice()].concat());
    for world in report
        .options
        .worlds()
        .into_iter()
        .filter(|world| world.visits == visits)
    {
        let cells = Figure::ALL.map(|figure| {
            let found = report.findings.find(&world, within, figure);
            if is_number(figure) {
                spread_to(1, found)
            } else {
                spread(found)
            }
        });
        table.row(titled(&world).into_iter().chain(cells));
    }
    table.render("")
}

/// Returns whether a figure is a number of states, not a share of them.
fn is_number(figure: Figure) -> bool {
    matches!(
        figure,
        Figure::Established | Figure::Listed | Figure::ListedByP
    )
}

fn titled(world: &World) -> [String; 3] {
    let alphabet = world.drawn.alphabet;
    let actions = format!("{} x {}", alphabet.rows, alphabet.columns);
    [
        world.drawn.name.to_owned(),
        world.drawn.segments.to_string(),
        actions,
    ]
}

fn named(target: &Target) -> Vec<String> {
    let World { drawn, visits, .. } = target.world;
    [
        drawn.name,
        &visits.to_string(),
        target.method.as_str(),
        target.figure.as_str(),
    ]
    .map(str::to_owned)
    .to_vec()
}
