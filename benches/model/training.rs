//! A training beside scikit-learn's perceptron on the same transitions: how long, and what a
//! transition in an unseen state then costs.

use std::fs;
use std::path::Path;

use super::play::{ACTIONS, Joint, Play, Quality};
use super::support::python;

/// Ours is trained with at most so many epochs, more and more: the first that is as good as the
/// yardstick says how long that takes. The last is the default.
const EPOCHS: [u64; 6] = [5, 10, 20, 40, 80, 140];

struct Run {
    seconds: f64,
    quality: Quality,
}

pub async fn report(play: &Play) {
    let truth: Vec<Joint> = play.held_out.iter().map(|(_, truth)| *truth).collect();
    tell(
        "who knows the truth",
        &Run {
            seconds: 0.0,
            quality: play.quality(&truth),
        },
    );
    let mut runs = Vec::new();
    for epochs in EPOCHS {
        let trained = play.train(Some(epochs)).await;
        let run = Run {
            seconds: trained.took.as_secs_f64(),
            quality: play.quality(&play.predictions(&trained.network)),
        };
        tell(
            &format!("training, {epochs} epochs at most, with prior, twins and judging"),
            &run,
        );
        runs.push(run);
    }
    for (yardstick, beside) in yardsticks(play) {
        tell(&yardstick, &beside);
        as_good(&runs, &beside, "a transition", |quality| quality.joint);
        as_good(&runs, &beside, "mutual information", |quality| {
            quality.information
        });
    }
}

fn tell(who: &str, run: &Run) {
    let Run {
        seconds,
        quality: Quality {
            joint,
            ego,
            information,
        },
    } = run;
    println!(
        "{who}: {seconds:.2} s; a transition in a state that was not seen costs {joint:.4} nats, {ego:.4} of them for the ego; mutual information is \
         {information:.4} nats off"
    );
}

fn as_good(runs: &[Run], beside: &Run, at: &str, figure: fn(&Quality) -> f64) {
    match runs
        .iter()
        .find(|run| figure(&run.quality) <= figure(&beside.quality))
    {
        Some(Run { seconds, .. }) => {
            println!(
                "  ours is as good at {at} after {seconds:.2} s: ratio {:.3}",
                seconds / beside.seconds
            );
        }
        None => println!("  ours is never as good at {at}"),
    }
}

/// Runs the script on the same transitions and returns what it printed.
fn yardsticks(play: &Play) -> Vec<(String, Run)> {
    let directory = tempfile::tempdir().expect("a temporary directory");
    write(play, directory.path());
    let Some(lines) = python("model_yardsticks.py", Some(directory.path())) else {
        println!("no yardsticks: NUDGE_PYTHON names no Python, see benches/model_yardsticks.py");
        return Vec::new();
    };
    let run = |line: Vec<String>| {
        let [yardstick, seconds, told] = &line[..] else {
            panic!("not three fields: {line:?}")
        };
        let seconds = seconds.parse().expect("seconds");
        (
            yardstick.clone(),
            Run {
                seconds,
                quality: play.quality(&joints(told)),
            },
        )
    };
    lines.into_iter().map(run).collect()
}

fn joints(text: &str) -> Vec<Joint> {
    let numbers: Vec<f64> = text
        .split(' ')
        .map(|number| number.parse().expect("a probability"))
        .collect();
    let joint =
        |cells: &[f64]| std::array::from_fn(|i| std::array::from_fn(|j| cells[i * ACTIONS + j]));
    numbers.chunks_exact(ACTIONS * ACTIONS).map(joint).collect()
}

/// Writes transitions and unseen states as the script reads them, little-endian: u32 bins and
/// actions; f64 bins and the truth.
fn write(play: &Play, directory: &Path) {
    let numbers = play.transitions.iter().flat_map(|(state, actions)| {
        state
            .iter()
            .copied()
            .chain(actions.iter().map(|action| *action as u32))
            .collect::<Vec<u32>>()
    });
    let learned: Vec<u8> = numbers.flat_map(u32::to_le_bytes).collect();
    let numbers = play.held_out.iter().flat_map(|(state, truth)| {
        state
            .iter()
            .map(|bin| f64::from(*bin))
            .chain(truth.as_flattened().iter().copied())
    });
    let held_out: Vec<u8> = numbers.flat_map(f64::to_le_bytes).collect();
    fs::write(directory.join("learned"), learned).expect("written");
    fs::write(directory.join("held_out"), held_out).expect("written");
}
