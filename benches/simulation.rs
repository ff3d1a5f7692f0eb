//! Pedestrian-steps a second of crowds of 10 to 10,000, on one thread and on all, beside other
//! programs on the same machine.
//!
//! `cargo bench --bench simulation`. With `NUDGE_PYTHON` naming a Python that has PySocialForce and
//! numba, the yardsticks of `social_force_yardsticks.py` run too and the ratios are printed.

#![allow(missing_docs)]

mod support;

use std::time::Instant;

use glam::DVec2;
use nudge::simulation::{Crowd, Pedestrian, SocialForce, Wall};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;
use support::{median, python, report};

const WIDTH: f64 = 4.0;
const DT: f64 = 0.05;
const STEPS: usize = 200;

fn main() {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let alone = sizes(1);
    sizes(threads);
    yardsticks(&alone);
}

/// Prints a row for each size and returns pedestrian-steps a second by size.
fn sizes(threads: usize) -> Vec<(usize, f64)> {
    println!(
        "threads: {threads}\n{:>12} {:>20} {:>10} {:>22}",
        "pedestrians", "pedestrian-steps/s", "us/step", "cost to linear, x1,000"
    );
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("a pool");
    let rate = |size| (size, pool.install(|| rate(size)));
    let rates: Vec<(usize, f64)> = [10, 100, 1_000, 10_000].map(rate).into();
    for (size, rate) in &rates {
        let to_linear = rates[2].1 / rate;
        println!(
            "{size:>12} {rate:>20.0} {:>10.1} {to_linear:>22.2}",
            *size as f64 / rate * 1e6
        );
    }
    rates
}

fn rate(size: usize) -> f64 {
    // Each measurement walks some 50,000 pedestrian-steps or more, from the same beginning.
    let repeats = (250 / size).max(1);
    let crowd = crowd(size);
    let walk = || {
        let started = Instant::now();
        for _ in 0..repeats {
            let mut crowd = crowd.clone();
            (0..STEPS).for_each(|_| crowd.step(DT));
        }
        (repeats * size * STEPS) as f64 / started.elapsed().as_secs_f64()
    };
    median((0..7).map(|_| walk()).collect())
}

/// Counter-flow, spread uniformly over 2 m of hallway a pedestrian.
fn crowd(size: usize) -> Crowd {
    let mut random = Pcg64::seed_from_u64(1);
    let speeds = Normal::new(1.34, 0.26).expect("a deviation");
    let pedestrian = |id: usize| {
        let direction = if id.is_multiple_of(2) {
            DVec2::X
        } else {
            DVec2::NEG_X
        };
        let position = DVec2::new(
            random.random_range(0.0..2.0 * size as f64),
            random.random_range(0.3..WIDTH - 0.3),
        );
        let desired_speed = f64::max(speeds.sample(&mut random), 0.3);
        Pedestrian {
            id: id as u32,
            position,
            velocity: desired_speed * direction,
            direction,
            desired_speed,
        }
    };
    let pedestrians = (0..size).map(pedestrian).collect();
    let walls = vec![Wall::along(0.0), Wall::along(WIDTH)];
    Crowd::new(SocialForce::default(), walls, pedestrians, 1).within(0.01, WIDTH - 0.01)
}

fn yardsticks(alone: &[(usize, f64)]) {
    let Some(lines) = python("social_force_yardsticks.py", None) else {
        return println!(
            "no yardsticks: NUDGE_PYTHON names no Python, see benches/social_force_yardsticks.py"
        );
    };
    for line in lines {
        let [name, size, rate] = &line[..] else {
            panic!("not a yardstick: {line:?}")
        };
        let (size, beside): (usize, f64) =
            (size.parse().expect("a size"), rate.parse().expect("a rate"));
        let ours = alone
            .iter()
            .find(|(of, _)| *of == size)
            .expect("measured")
            .1;
        let target = if name == "numba" {
            "(target >= 2 at 100)"
        } else {
            "(target >= 100)"
        };
        report(
            &format!("{size} pedestrians, one thread"),
            ours,
            name,
            beside,
            "pedestrian-steps/s",
            target,
        );
    }
}
