//! The social force model against 40-digit differentiation and an independent trajectory;
//! `tests/golden/SOURCE.md` says where each value came from.

use glam::DVec2;
use nudge::simulation::{Crowd, Pedestrian, SocialForce, Wall, semi_minor_axis};
use serde_json::Value;

/// The target for forces, relative.
const FORCES: f64 = 1e-9;
/// The target for a trajectory of 200 steps, in m and m/s.
const TRAJECTORY: f64 = 1e-6;

#[test]
fn pair_forces_match_the_references() {
    let model = SocialForce::default();
    for pair in list(&golden()["pair"]) {
        let direction = vector(&pair["e_beta"]);
        let r = vector(&pair["r_alpha"]) - vector(&pair["r_beta"]);
        let step = model.next_step(number(&pair["speed_beta"]) * direction, direction);
        let force = model.repulsion(r, step);
        let looks = vector(&pair["e_alpha"]);

        close(pair, semi_minor_axis(r, step), number(&pair["b"]));
        close_vectors(pair, force, vector(&pair["f"]));
        assert_eq!(
            model.sight_weight(looks, force),
            number(&pair["w"]),
            "{pair}"
        );
        close_vectors(pair, model.pair_force(r, step, looks), vector(&pair["F"]));
    }
}

#[test]
fn driving_forces_match_the_references() {
    for drive in list(&golden()["driving"]) {
        let (direction, velocity) = (vector(&drive["e"]), vector(&drive["v"]));
        let force = SocialForce::default().driving_force(number(&drive["v0"]), direction, velocity);

        close_vectors(drive, force, vector(&drive["F"]));
    }
}

#[test]
fn wall_forces_match_the_references() {
    for wall in list(&golden()["wall"]) {
        let distance = number(&wall["distance"]);
        let force = |y| SocialForce::default().wall_force(&Wall::along(0.0), DVec2::new(3.7, y));

        close_vectors(wall, force(distance), DVec2::new(0.0, number(&wall["F"])));
        close_vectors(wall, force(-distance), DVec2::new(0.0, -number(&wall["F"])));
    }
}

#[test]
fn four_pedestrians_walk_as_in_the_reference() {
    for golden in list(&golden()["trajectory"]) {
        let init = &golden["init"];
        let walls = vec![Wall::along(0.0), Wall::along(number(&init["W"]))];
        let mut crowd = Crowd::new(
            SocialForce {
                noise: 0.0,
                ..Default::default()
            },
            walls,
            pedestrians(init),
            0,
        );
        let mut steps = 0;
        for snapshot in list(&golden["snapshots"]) {
            while steps < number(&snapshot["step"]) as u32 {
                crowd.step(number(&init["dt"]));
                steps += 1;
            }
            for (i, walker) in crowd.pedestrians().iter().enumerate() {
                let at = |name: &str| number(&snapshot[name][i]);
                let (position, velocity) =
                    (DVec2::new(at("x"), at("y")), DVec2::new(at("vx"), at("vy")));

                assert!(
                    walker.position.abs_diff_eq(position, TRAJECTORY),
                    "step {steps}: {walker:?} not at {position}"
                );
                assert!(
                    walker.velocity.abs_diff_eq(velocity, TRAJECTORY),
                    "step {steps}: {walker:?} not at {velocity}"
                );
            }
        }
        assert_eq!(steps, 200, "the file was walked to its end");
    }
}

fn pedestrians(init: &Value) -> Vec<Pedestrian> {
    let pedestrian = |i: usize| {
        let at = |name: &str| number(&init[name][i]);
        Pedestrian {
            id: i as u32,
            position: DVec2::new(at("x"), at("y")),
            velocity: DVec2::new(at("vx"), at("vy")),
            direction: DVec2::new(at("ex"), 0.0),
            desired_speed: at("v0"),
        }
    };
    (0..list(&init["x"]).len()).map(pedestrian).collect()
}

fn golden() -> Value {
    serde_json::from_str(include_str!("../../golden/social_force.json"))
        .expect("the golden file is JSON")
}

fn list(value: &Value) -> &Vec<Value> {
    value
        .as_array()
        .filter(|list| !list.is_empty())
        .expect("a list in the golden file")
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number in the golden file")
}

fn vector(value: &Value) -> DVec2 {
    DVec2::new(number(&value[0]), number(&value[1]))
}

fn close(golden: &Value, value: f64, reference: f64) {
    assert!(
        (value - reference).abs() <= FORCES * reference.abs(),
        "{golden}: {value:e} instead of {reference:e}"
    );
}

fn close_vectors(golden: &Value, value: DVec2, reference: DVec2) {
    assert!(
        value.distance(reference) <= FORCES * reference.length(),
        "{golden}: {value} instead of {reference}"
    );
}
