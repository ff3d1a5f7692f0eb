//! Lagged, conditional figures from tracks to numbers: which entries are draws, what is held fixed,
//! and what the tables say.

use nudge::information::{Method, conditional, expected_if_independent, p_value, plug_in};
use nudge::simulation::planted::lagged::{Asked, Counted, Draws, Options, Step};
use serde_json::Value;

use super::{TARGET, list, number};

/// The tracks of a world as steps.
fn tracks(world: &Value) -> Vec<Vec<Step>> {
    let numbers = |values: &Value| -> Vec<u64> {
        list(values)
            .iter()
            .map(|value| value.as_u64().expect("a number"))
            .collect()
    };
    let track = |track: &Value| {
        let [leader, follower] = [0, 1].map(|agent| numbers(&track["actions"][agent]));
        let steps = numbers(&track["states"])
            .into_iter()
            .zip(leader.into_iter().zip(follower));
        steps
            .map(|(state, (leader, follower))| Step {
                state: state as usize,
                actions: [leader, follower],
            })
            .collect()
    };
    list(&world["tracks"]).iter().map(track).collect()
}

#[test]
fn lagged_figures_match_high_precision() {
    let file: Value =
        serde_json::from_str(include_str!("../../golden/lagged.json")).expect("the file is JSON");
    let mut exact = 0;
    for world in list(&file["worlds"]) {
        let letters = [0, 1].map(|agent| world["letters"][agent].as_u64().expect("a number"));
        let options = Options {
            letters: letters[0].max(letters[1]) as usize,
            states: 3,
            ..Options::default()
        };
        for golden in list(&world["figures"]) {
            let of = |key: &str| golden[key].as_u64().expect("a number") as usize;
            let asked = Asked {
                ego: of("ego"),
                lag: of("lag"),
            };
            let counted = Counted::of_tracks(
                tracks(world).into_iter(),
                &options,
                Draws::Renewed,
                [usize::MAX, asked.lag],
            );
            let tables = counted.tables(of("state"), asked);
            let what = format!("{}: {golden}", world["name"]);
            let close = |value: f64, golden: &Value| {
                assert!((value - number(golden)).abs() <= TARGET, "{value}, {what}")
            };

            let draws: u64 = tables.iter().map(|table| table.total()).sum();
            assert_eq!(draws, of("draws") as u64, "{what}");
            close(conditional(&tables, plug_in), &golden["plug_in"]);
            let expected = |table: &_| expected_if_independent(table).0;
            close(conditional(&tables, expected), &golden["expected"]);
            let significance = p_value(&tables, 199, 1);
            if !golden["p"].is_null() {
                assert_eq!(significance.method, Method::Exact, "{what}");
                close(significance.p_value, &golden["p"]);
                exact += 1;
            }
        }
    }
    assert!(exact > 40, "{exact} with an exact p");
}
