//! Report of leaders and followers (lagged dependence) as text.

use super::figures::{spread, targets};
use crate::cli::output::{Table, count};
use crate::experiments::findings::REVISION;
use crate::experiments::planted::lagged::{DRAWS, Figure, Report, Target, World, asked};
use crate::simulation::planted::lagged::Asked;

/// What a profile tells of each world.
const TOLD: [Figure; 6] = [
    Figure::Called,
    Figure::CalledFar,
    Figure::Significant,
    Figure::SignificantIfEntered,
    Figure::Excess,
    Figure::Peak,
];

/// Returns the report as people read it.
pub(super) fn render(report: &Report) -> String {
    let mut text = format!(
        "planted followers, nudge {REVISION}: {}, {} states, half of them near, {DRAWS} draws of each, asked I(ego now; other k later | state, other's own action at k - 1); \
        called is P(dependent) >= .95; mean ±sd over seeds\n\
        where actions are held, neighbouring lags truly depend, and states that are not near go on with what was copied\n",
        report.options.seeds,
        count(report.options.states as u64),
    );

    for world in report.options.worlds() {
        text += &format!("\n{}\n{}", world.drawn.name, profile(report, &world));
    }
    text += &format!(
        "\ntargets, stated for 40 states and at least 5 seeds\n{}",
        targets(&report.targets(), &["world", "ego"], named)
    );
    text
}

/// Returns what is found in a world, lag after lag in both directions.
fn profile(report: &Report, world: &World) -> String {
    let titles = TOLD.map(Figure::as_str);
    let mut table = Table::new(&[&["ego", "lag"], titles.as_slice()].concat());
    for asked in asked() {
        let cells = TOLD.map(|figure| spread(report.findings.find(world, asked, figure)));
        table.row(titled(asked).into_iter().chain(cells));
    }
    table.render("")
}

fn titled(Asked { ego, lag }: Asked) -> [String; 2] {
    [["leader", "follower"][ego].to_owned(), lag.to_string()]
}

fn named(target: &Target) -> Vec<String> {
    let Asked { ego, lag } = target.method;
    [
        target.world.drawn.name.to_owned(),
        ["leader", "follower"][ego].to_owned(),
        format!("lag {lag}"),
        target.figure.as_str().to_owned(),
    ]
    .to_vec()
}
