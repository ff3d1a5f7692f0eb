//! The forward pass that is served, encoding included: one state at a time beside many at once, and
//! predicting beside remembering.

use std::hint::black_box;
use std::time::Instant;

use nudge::domain::StateKey;
use nudge::model::Network;

use super::ROUNDS;
use super::play::Play;
use super::support::{median, report as compare};

/// Rows that are predicted in one measurement, in as many calls as that takes.
const ROWS: usize = 1_024;

/// Mutual information of one row and of many.
pub fn report(play: &Play, network: &Network) {
    let states = play.learned.iter().cycle().take(ROWS);
    let keys: Vec<StateKey> = states.map(|state| StateKey::new(state)).collect();
    let predict = |keys: &[StateKey]| {
        drop(black_box(
            network.predict_once(black_box(keys), network.threshold),
        ));
    };
    let again = |keys: &[StateKey]| {
        drop(black_box(
            network.predict(black_box(keys), network.threshold),
        ));
    };

    let alone = rows_per_second(&keys, 1, predict);
    let together = rows_per_second(&keys, ROWS, predict);
    let what = format!("predicting {ROWS} at once");
    compare(&what, together, "one at a time", alone, "rows/s", "");
    for (size, predicted) in [(1, alone), (ROWS, together)] {
        let again = rows_per_second(&keys, size, again);
        let what = format!("telling {size} at once that were asked before");
        compare(&what, again, "predicting them", predicted, "rows/s", "");
    }
}

fn rows_per_second(rows: &[StateKey], at_once: usize, predict: impl Fn(&[StateKey])) -> f64 {
    let time = |_| {
        let started = Instant::now();
        rows.chunks(at_once).for_each(&predict);
        rows.len() as f64 / started.elapsed().as_secs_f64()
    };
    median((0..ROUNDS).map(time).collect())
}
