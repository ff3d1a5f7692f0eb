//! One trial: from the start to the last pedestrian's leaving.

use std::sync::Arc;

use glam::{DVec2, dvec2};
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::{Protocol, Scenario, start};
use crate::simulation::{Crowd, Pedestrian, Segment, Wall};
use nudge_core::error::Fault;

/// How close to a wall anybody gets, in metres.
const WALL_BAND: f64 = 0.01;

/// How far the walls go on beyond both ends, in metres: where pedestrians leave, they still walk
/// between walls.
const OUTSIDE: f64 = 10.0;

/// A trial as it stands. Cloning it copies the whole microstate: both go on in the same way.
#[derive(Debug, Clone)]
pub struct Trial {
    protocol: Arc<Protocol>,
    number: u32,
    crowd: Crowd,
    /// Whoever walks across and has not entered yet.
    waiting: Option<Pedestrian>,
    steps: u32,
}

impl Trial {
    /// Begins a trial, seeded by the protocol's seed and its number alone.
    pub(super) fn begin(protocol: Arc<Protocol>, number: u32) -> Result<Self, Fault> {
        let mut random = Pcg64::seed_from_u64(seed(&protocol, number, "start"));
        let along = start::along(&protocol, &mut random)?;
        let waiting = (protocol.scenario == Scenario::Crossing)
            .then(|| start::across(&protocol, &mut random));
        let crowd = Crowd::new(
            protocol.model.clone(),
            walls(&protocol),
            along,
            seed(&protocol, number, "noise"),
        );
        let crowd = crowd.within(WALL_BAND, protocol.width - WALL_BAND);
        Ok(Self {
            protocol,
            number,
            crowd,
            waiting,
            steps: 0,
        })
    }

    /// Returns its protocol.
    pub fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    /// Returns its number, from 1.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// Returns the time since it began, in seconds.
    pub fn time(&self) -> f64 {
        f64::from(self.steps) * self.protocol.dt
    }

    /// Returns those who are in the hallway, in order of their ids.
    pub fn pedestrians(&self) -> &[Pedestrian] {
        self.crowd.pedestrians()
    }

    /// Returns whether everybody has left, or the longest trial is over.
    pub fn is_over(&self) -> bool {
        let has_emptied = self.pedestrians().is_empty() && self.waiting.is_none();
        has_emptied || self.time() >= self.protocol.longest_trial
    }

    /// Goes on to the next record.
    pub fn advance(&mut self) {
        (0..self.protocol.steps_per_record()).for_each(|_| self.step());
    }

    /// Goes on by one step of the simulation. Whoever has come to the end of the way is gone after
    /// it.
    pub fn step(&mut self) {
        self.admit();
        self.aim();
        self.crowd.step(self.protocol.dt);
        self.steps += 1;
        let protocol = &self.protocol;
        self.crowd.remove(|one| has_left(protocol, one));
    }

    /// Lets whoever walks across enter when it would meet the middle of the flow in the middle of
    /// the hallway, or as soon after that as nobody stands in the doorway.
    fn admit(&mut self) {
        let Protocol {
            length,
            width,
            start_zone,
            speed_mean,
            start_gap,
            ..
        } = *self.protocol;

        let due = (length - start_zone - width) / 2.0 / speed_mean;
        let is_due = self.time() >= due;
        let pedestrians = self.crowd.pedestrians();
        let is_free = |place: DVec2| {
            pedestrians
                .iter()
                .all(|one| one.position.distance(place) >= start_gap)
        };

        if let Some(entering) = self.waiting.take_if(|one| is_due && is_free(one.position)) {
            self.crowd.add(entering);
        }
    }

    /// Turns whoever walks across towards the far doorway, from which the flow pushes it away.
    fn aim(&mut self) {
        let Protocol {
            scenario,
            length,
            width,
            doorway,
            pedestrians,
            ..
        } = *self.protocol;

        if scenario == Scenario::Crossing {
            let id = pedestrians - 1;
            let beyond = dvec2(length / 2.0, width + doorway / 2.0);
            let position = self
                .pedestrians()
                .iter()
                .find(|one| one.id == id)
                .map(|one| one.position);
            position.map(|position| {
                self.crowd
                    .set_direction(id, (beyond - position).normalize_or(DVec2::Y))
            });
        }
    }
}

/// Returns the walls of a hallway: the lower and the upper one, with a doorway in the middle of
/// both where somebody crosses.
pub fn walls(protocol: &Protocol) -> Vec<Wall> {
    let Protocol {
        scenario,
        length,
        width,
        doorway,
        ..
    } = *protocol;

    let piece = |from: f64, to: f64, y: f64| Segment {
        from: dvec2(from, y),
        to: dvec2(to, y),
    };

    let posts = [(length - doorway) / 2.0, (length + doorway) / 2.0];
    let wall = |y: f64| match scenario {
        Scenario::CounterFlow => Wall::along(y),
        Scenario::Crossing => Wall {
            pieces: vec![
                piece(-OUTSIDE, posts[0], y),
                piece(posts[1], length + OUTSIDE, y),
            ],
        },
    };
    vec![wall(0.0), wall(width)]
}

/// Returns whether somebody has come to the end of the way: an end of the hallway, or the far
/// doorway.
fn has_left(protocol: &Protocol, pedestrian: &Pedestrian) -> bool {
    let Protocol {
        length,
        width,
        doorway,
        pedestrians,
        scenario,
        ..
    } = *protocol;
    let Pedestrian {
        position,
        direction,
        ..
    } = *pedestrian;

    if scenario == Scenario::Crossing && pedestrian.id == pedestrians - 1 {
        return position.y >= width - WALL_BAND
            && (position.x - length / 2.0).abs() <= doorway / 2.0;
    }
    if direction.x > 0.0 {
        position.x >= length
    } else {
        position.x <= 0.0
    }
}

/// Returns the seed of one of a trial's purposes: hashed, so that neighbouring seeds and trials
/// have nothing in common.
fn seed(protocol: &Protocol, number: u32, purpose: &str) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher
        .update(&protocol.seed.to_le_bytes())
        .update(&number.to_le_bytes())
        .update(purpose.as_bytes());
    let mut bytes = [0; 8];
    hasher.finalize_xof().fill(&mut bytes);
    u64::from_le_bytes(bytes)
}
