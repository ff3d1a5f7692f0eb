//! A crowd that walks: who is where, how fast, and what a step of time makes of it.

use glam::DVec2;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::{SocialForce, Wall};

/// One who walks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pedestrian {
    /// A number of one's own, kept while others come and go.
    pub id: u32,
    /// In m.
    pub position: DVec2,
    /// In m/s.
    pub velocity: DVec2,
    /// Where one wants to go, a unit vector.
    pub direction: DVec2,
    /// How fast, in m/s.
    pub desired_speed: f64,
}

/// Pedestrians, the walls between which they walk, and the randomness that moves them: the whole microstate. A clone walks on as its original does.
#[derive(Debug, Clone)]
pub struct Crowd {
    model: SocialForce,
    walls: Vec<Wall>,
    band: (f64, f64),
    pedestrians: Vec<Pedestrian>,
    random: Pcg64,
}

/// What a pedestrian looks like to the others during one step of time.
#[derive(Clone, Copy)]
struct Obstacle {
    position: DVec2,
    step: DVec2,
}

impl Crowd {
    /// Makes a crowd. Ids are the caller's: each should be given once.
    pub fn new(model: SocialForce, walls: Vec<Wall>, pedestrians: Vec<Pedestrian>, seed: u64) -> Self {
        let band = (f64::NEG_INFINITY, f64::INFINITY);
        Self { model, walls, band, pedestrians, random: Pcg64::seed_from_u64(seed) }
    }

    /// Keeps every y in `low..=high` from now on, in m: a kick of noise throws nobody through a wall.
    pub fn within(mut self, low: f64, high: f64) -> Self {
        self.band = (low, high);
        for pedestrian in &mut self.pedestrians {
            pedestrian.position.y = pedestrian.position.y.clamp(low, high);
        }
        self
    }

    /// Returns those who walk, in the order in which they were given.
    pub fn pedestrians(&self) -> &[Pedestrian] {
        &self.pedestrians
    }

    /// Lets one more in, whose id nobody else has.
    pub fn add(&mut self, pedestrian: Pedestrian) {
        self.pedestrians.push(pedestrian);
    }

    /// Takes out everyone of whom `leaves` is true. The others keep their order.
    pub fn remove(&mut self, leaves: impl Fn(&Pedestrian) -> bool) {
        self.pedestrians.retain(|pedestrian| !leaves(pedestrian));
    }

    /// Gives one pedestrian another velocity; returns whether that one is there.
    pub fn set_velocity(&mut self, id: u32, velocity: DVec2) -> bool {
        let found = self.pedestrians.iter_mut().find(|pedestrian| pedestrian.id == id);
        found.map(|pedestrian| pedestrian.velocity = velocity).is_some()
    }

    /// Gives one pedestrian another way to go, a unit vector; returns whether that one is there.
    pub fn set_direction(&mut self, id: u32, direction: DVec2) -> bool {
        let found = self.pedestrians.iter_mut().find(|pedestrian| pedestrian.id == id);
        found.map(|pedestrian| pedestrian.direction = direction).is_some()
    }

    /// Walks for `dt` seconds: semi-implicit Euler, so forces come from the state before and positions move with the velocity after.
    ///
    /// The noise is drawn here in the pedestrians' order, so the bytes do not depend on threads.
    pub fn step(&mut self, dt: f64) {
        let forces = self.forces();
        let deviation = self.model.noise * dt.sqrt();
        for (pedestrian, force) in self.pedestrians.iter_mut().zip(forces) {
            let mut normal = || StandardNormal.sample(&mut self.random);
            let kick = deviation * DVec2::new(normal(), normal());
            let fastest = self.model.speed_cap * pedestrian.desired_speed;
            pedestrian.velocity = (pedestrian.velocity + dt * force + kick).clamp_length_max(fastest);
            pedestrian.position += dt * pedestrian.velocity;
            pedestrian.position.y = pedestrian.position.y.clamp(self.band.0, self.band.1);
        }
    }

    fn forces(&self) -> Vec<DVec2> {
        let obstacle = |one: &Pedestrian| Obstacle {
            position: one.position,
            step: self.model.next_step(one.velocity, one.direction),
        };
        let obstacles: Vec<Obstacle> = self.pedestrians.iter().map(obstacle).collect();
        (0..obstacles.len()).map(|i| self.force(i, &obstacles)).collect()
    }

    /// Returns all that acts on the `i`th pedestrian, in m/s^2.
    fn force(&self, i: usize, obstacles: &[Obstacle]) -> DVec2 {
        let Pedestrian { position, velocity, direction, desired_speed, .. } = self.pedestrians[i];
        let drive = self.model.driving_force(desired_speed, direction, velocity);
        let walls = self.walls.iter().map(|wall| self.model.wall_force(wall, position));
        let others = obstacles.iter().enumerate().filter(|(j, _)| *j != i);
        let pairs = others.map(|(_, other)| self.model.pair_force(position - other.position, other.step, direction));
        drive + walls.sum::<DVec2>() + pairs.sum::<DVec2>()
    }
}
