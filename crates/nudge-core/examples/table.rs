//! A contingency table, and what a statistician would ask of it: mutual information, what chance
//! alone would show, a p-value, and the posterior of one table among others.
//!
//! `cargo run -p nudge-core --example table`

use std::slice::from_ref;

use nudge_core::evidence::{Fitter, Prior, Uses};
use nudge_core::information::{
    Alphabet, Table, expected_if_independent, miller_madow, p_value, plug_in,
};

/// Returns the counts of an intersection: what one driver did (rows), what the other did at the
/// same moment (columns). In the first three the other mostly does the same.
fn intersection(at: u64) -> Table {
    let counts: [[u64; 3]; 3] = match at {
        0..3 => [[9 + at, 2, 1], [1, 12, 2], [1, 1, 8]],
        _ => [[5, 4, 4], [3, 4, 3 + at], [4, 3, 4]],
    };
    let row = |(i, row): (u64, [u64; 3])| (0..).zip(row).map(move |(j, n)| (i, j, n));
    Table::from_counts((0..).zip(counts).flat_map(row))
}

fn main() {
    let tables: Vec<Table> = (0..8).map(intersection).collect();

    // Empirical Bayes: the prior is fitted to all of them.
    let alphabet = Alphabet {
        rows: 3,
        columns: 3,
    };
    let mut uses = Uses::new(alphabet);
    tables.iter().for_each(|table| uses.add(from_ref(table)));
    let mut fitter = Fitter::new(alphabet, &uses);
    tables.iter().for_each(|table| fitter.add(from_ref(table)));
    let prior = Prior::new(&fitter.fit());

    println!("visits  plug-in  Miller-Madow  by chance  p-value  P(dependent)  posterior, 90 %");
    for table in &tables {
        let (visits, plug_in, corrected) = (table.total(), plug_in(table), miller_madow(table));
        let (by_chance, _) = expected_if_independent(table);
        let p = p_value(from_ref(table), 10_000, 1).p_value;

        let posterior = prior.posterior(prior.habits(), from_ref(table));
        let (mean, dependent) = (posterior.mean(), posterior.dependent());
        let [low, high] = posterior.interval();

        println!(
            "{visits:6}  {plug_in:7.3}  {corrected:12.3}  {by_chance:9.3}  {p:7.4}  \
             {dependent:12.3}  {mean:.3} ({low:.3} to {high:.3})"
        );
    }
}
