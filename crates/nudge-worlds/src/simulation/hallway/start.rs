//! Where pedestrians start and how fast they want to walk: drawn at random, and drawn again where
//! somebody stands too close.

use glam::{DVec2, dvec2};
use rand::RngExt;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use super::{Protocol, Scenario};
use crate::simulation::Pedestrian;
use nudge_core::error::Fault;

/// Places drawn for one pedestrian before all are taken away again, and how often that may happen.
/// Drawn one after the other, circles around pedestrians cover at most about half of a zone; what
/// needs more is refused.
const ATTEMPTS: u32 = 1_000;
const RESTARTS: u32 = 100;

/// Draws those who walk along the hallway. Ids count from 0; in counter-flow even ones walk to the
/// right and odd ones to the left.
pub(super) fn along(protocol: &Protocol, random: &mut Pcg64) -> Result<Vec<Pedestrian>, Fault> {
    let across = u32::from(protocol.scenario == Scenario::Crossing);
    let mut most = 0;
    for _ in 0..RESTARTS {
        let placed = attempt(protocol, protocol.pedestrians - across, random);
        let count = placed.len() as u32 + across;
        if count == protocol.pedestrians {
            return Ok(placed);
        }
        most = most.max(count);
    }
    let Protocol {
        pedestrians,
        start_gap,
        ..
    } = protocol;
    let detail = format!(
        "got {pedestrians}, expected at most about {most}: no more find a place {start_gap} m apart"
    );
    Err(Fault::new("/pedestrians", detail))
}

/// Draws the one who walks across, from the middle of the lower wall.
pub(super) fn across(protocol: &Protocol, random: &mut Pcg64) -> Pedestrian {
    let place = dvec2(protocol.length / 2.0, 0.0);
    pedestrian(protocol.pedestrians - 1, place, DVec2::Y, protocol, random)
}

/// Places as many as find a place.
fn attempt(protocol: &Protocol, count: u32, random: &mut Pcg64) -> Vec<Pedestrian> {
    let mut placed: Vec<Pedestrian> = Vec::new();
    for id in 0..count {
        let to_right = protocol.scenario == Scenario::Crossing || id % 2 == 0;
        let is_free = |place: &DVec2| {
            placed
                .iter()
                .all(|one| one.position.distance(*place) >= protocol.start_gap)
        };

        let Some(place) = (0..ATTEMPTS)
            .map(|_| place(protocol, to_right, random))
            .find(is_free)
        else {
            break;
        };

        let direction = if to_right { DVec2::X } else { DVec2::NEG_X };
        placed.push(pedestrian(id, place, direction, protocol, random));
    }
    placed
}

fn place(protocol: &Protocol, to_right: bool, random: &mut Pcg64) -> DVec2 {
    let from_end = random.random_range(0.0..=protocol.start_zone);
    let y = random.random_range(protocol.start_margin..=protocol.width - protocol.start_margin);
    dvec2(
        if to_right {
            from_end
        } else {
            protocol.length - from_end
        },
        y,
    )
}

fn pedestrian(
    id: u32,
    position: DVec2,
    direction: DVec2,
    protocol: &Protocol,
    random: &mut Pcg64,
) -> Pedestrian {
    let desired_speed = desired_speed(protocol, random);
    Pedestrian {
        id,
        position,
        velocity: desired_speed * direction,
        direction,
        desired_speed,
    }
}

fn desired_speed(protocol: &Protocol, random: &mut Pcg64) -> f64 {
    let speeds = Normal::new(protocol.speed_mean, protocol.speed_sd)
        .expect("checked: finite, and the sd not negative");
    // The mean is not below the least, so at least every other draw is kept.
    speeds
        .sample_iter(random)
        .find(|speed| *speed >= protocol.speed_min)
        .expect("draws do not end")
}
