//! How figures are written: as mean and standard deviation over seeds, and as targets beside what
//! was measured.

use crate::cli::output::Table;
use crate::experiments::findings::{Bound, Target};
use crate::experiments::measures::Spread;

/// Returns targets beside what was measured, each row with the names of its world, method and
/// figure.
pub(super) fn targets<W, D, F>(
    targets: &[Target<W, D, F>],
    worlds: &[&str],
    named: impl Fn(&Target<W, D, F>) -> Vec<String>,
) -> String {
    let mut table =
        Table::new(&[worlds, &["decision", "figure", "target", "measured", ""]].concat());
    for target in targets {
        let bound = match target.bound {
            Bound::AtLeast(at) => format!(">= {at}"),
            Bound::AtMost(at) => format!("<= {at}"),
        };
        let measured = target
            .measured
            .map_or("-".to_owned(), |measured| format!("{measured:.4}"));
        let met = if target.is_met() { "met" } else { "MISSED" };
        table.row(
            named(target)
                .into_iter()
                .chain([bound, measured, met.to_owned()]),
        );
    }
    table.render("")
}

/// Returns a figure over seeds with three decimals.
pub(super) fn spread(spread: Option<Spread>) -> String {
    spread_to(3, spread)
}

/// Returns a figure over seeds with so many decimals.
pub(super) fn spread_to(decimals: usize, spread: Option<Spread>) -> String {
    match spread {
        Some(Spread {
            mean, sd: Some(sd), ..
        }) => format!("{mean:.decimals$} ±{sd:.decimals$}"),
        Some(Spread { mean, .. }) => format!("{mean:.decimals$}"),
        None => "-".to_owned(),
    }
}
