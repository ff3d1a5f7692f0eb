//! Networks beside other programs on the same machine: what a prediction costs, what a training
//! costs and how good it is, and what a training costs those who ask meanwhile.
//!
//! `cargo bench --bench model`, or `cargo bench --bench model -- forward` for one of `forward`,
//! `infer`, `busy` and `training`; with `NUDGE_PYTHON=/path/to/python` training stands beside
//! `benches/model_yardsticks.py`, which says what that Python needs.

#![allow(missing_docs)]

#[path = "../support/mod.rs"]
mod support;

mod forward;
mod play;
mod serving;
mod training;

use play::Play;
use support::{runtime, wanted};

const ROUNDS: usize = 7;

fn main() {
    runtime().block_on(async {
        let play = Play::start().await;
        let network = play.train(None).await.network;
        if wanted("forward") {
            forward::report(&play, &network);
        }
        if wanted("infer") {
            serving::infer(&play).await;
        }
        if wanted("busy") {
            serving::busy(&play).await;
        }
        if wanted("training") {
            training::report(&play).await;
        }
        play.stop().await;
    });
}
