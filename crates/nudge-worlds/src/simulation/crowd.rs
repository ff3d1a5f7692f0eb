//! A crowd that walks: who is where, how fast, and what a step of time makes of it.

use glam::DVec2;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::neighbours::Neighbours;
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

/// Pedestrians, the walls between which they walk, and the randomness that moves them: the whole
/// microstate. A clone walks on as its original does.
///
/// The bytes of a walk depend on the state and on nothing else. Whoever is beyond another's
/// [reach](SocialForce::reach) is not felt, by this rule and not by what an index happened to find,
/// and forces add up in the pedestrians' order: with or without an index, on one thread or many,
/// the sums are the same.
#[derive(Debug, Clone)]
pub struct Crowd {
    model: SocialForce,
    walls: Vec<Wall>,
    band: (f64, f64),
    pedestrians: Vec<Pedestrian>,
    random: Pcg64,
    neighbours: Neighbours,
}

/// From this size on a crowd's forces are worth more threads than one: at 150 two threads take a
/// quarter off a step.
const PARALLEL_FROM: usize = 150;

/// What a pedestrian is to the others during one step of time.
struct Obstacle {
    position: DVec2,
    step: DVec2,
    reach: f64,
}

impl Crowd {
    /// Makes a crowd. Ids are the caller's: each should be given once. Places and velocities are
    /// finite, as those of every walk from them will be.
    pub fn new(
        model: SocialForce,
        walls: Vec<Wall>,
        pedestrians: Vec<Pedestrian>,
        seed: u64,
    ) -> Self {
        let band = (f64::NEG_INFINITY, f64::INFINITY);
        let (random, neighbours) = (Pcg64::seed_from_u64(seed), Neighbours::default());
        Self {
            model,
            walls,
            band,
            pedestrians,
            random,
            neighbours,
        }
    }

    /// Keeps every y in `low..=high` from now on, in m: a kick of noise throws nobody through a
    /// wall.
    ///
    /// # Panics
    ///
    /// If `low` is not at most `high`.
    pub fn within(mut self, low: f64, high: f64) -> Self {
        self.band = (low, high);
        self.neighbours = Neighbours::default();
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
        self.neighbours = Neighbours::default();
    }

    /// Takes out everyone of whom `leaves` is true. The others keep their order.
    pub fn remove(&mut self, leaves: impl Fn(&Pedestrian) -> bool) {
        let before = self.pedestrians.len();
        self.pedestrians.retain(|pedestrian| !leaves(pedestrian));
        if self.pedestrians.len() < before {
            self.neighbours = Neighbours::default();
        }
    }

    /// Gives one pedestrian another velocity; returns whether that one is there.
    pub fn set_velocity(&mut self, id: u32, velocity: DVec2) -> bool {
        let found = self
            .pedestrians
            .iter_mut()
            .find(|pedestrian| pedestrian.id == id);
        found
            .map(|pedestrian| pedestrian.velocity = velocity)
            .is_some()
    }

    /// Gives one pedestrian another way to go, a unit vector; returns whether that one is there.
    pub fn set_direction(&mut self, id: u32, direction: DVec2) -> bool {
        let found = self
            .pedestrians
            .iter_mut()
            .find(|pedestrian| pedestrian.id == id);
        found
            .map(|pedestrian| pedestrian.direction = direction)
            .is_some()
    }

    /// Walks for `dt` seconds: semi-implicit Euler, so forces come from the state before and
    /// positions move with the velocity after.
    ///
    /// The noise is drawn here in the pedestrians' order, so the bytes do not depend on threads.
    pub fn step(&mut self, dt: f64) {
        let forces = self.forces();
        let deviation = self.model.noise * dt.sqrt();
        let mut fastest: f64 = 0.0;
        for (pedestrian, force) in self.pedestrians.iter_mut().zip(forces) {
            let mut normal = || StandardNormal.sample(&mut self.random);
            let kick = deviation * DVec2::new(normal(), normal());
            let cap = self.model.speed_cap * pedestrian.desired_speed;
            pedestrian.velocity = (pedestrian.velocity + dt * force + kick).clamp_length_max(cap);
            pedestrian.position += dt * pedestrian.velocity;
            pedestrian.position.y = pedestrian.position.y.clamp(self.band.0, self.band.1);
            fastest = fastest.max(pedestrian.velocity.length());
        }
        self.neighbours.approach(2.0 * dt * fastest);
    }

    /// Returns all that acts on each pedestrian, in m/s^2.
    fn forces(&mut self) -> Vec<DVec2> {
        let obstacles: Vec<Obstacle> = self
            .pedestrians
            .iter()
            .map(|one| self.obstacle(one))
            .collect();
        let farthest = obstacles
            .iter()
            .map(|obstacle| obstacle.reach)
            .fold(0.0, f64::max);

        if !self.neighbours.cover(farthest) {
            let places: Vec<DVec2> = obstacles.iter().map(|obstacle| obstacle.position).collect();
            self.neighbours = Neighbours::search(&places, farthest);
        }

        let force = |i| self.force(i, &obstacles);
        if obstacles.len() < PARALLEL_FROM {
            (0..obstacles.len()).map(force).collect()
        } else {
            (0..obstacles.len()).into_par_iter().map(force).collect()
        }
    }

    fn obstacle(&self, one: &Pedestrian) -> Obstacle {
        let step = self.model.next_step(one.velocity, one.direction);
        Obstacle {
            position: one.position,
            step,
            reach: self.model.reach(step.length()),
        }
    }

    fn force(&self, i: usize, obstacles: &[Obstacle]) -> DVec2 {
        let Pedestrian {
            position,
            velocity,
            direction,
            desired_speed,
            ..
        } = self.pedestrians[i];

        let drive = self.model.driving_force(desired_speed, direction, velocity);
        let walls = self
            .walls
            .iter()
            .map(|wall| self.model.wall_force(wall, position));
        let pairs = self.neighbours.candidates(i).iter().filter_map(|j| {
            let other = &obstacles[*j as usize];
            let r = position - other.position;
            (r.length_squared() <= other.reach * other.reach)
                .then(|| self.model.pair_force(r, other.step, direction))
        });

        drive + walls.sum::<DVec2>() + pairs.sum::<DVec2>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::NEGLIGIBLE;
    use rand::RngExt;

    const DT: f64 = 0.05;

    /// Counter-flow, 2 m of a 4 m wide hallway a pedestrian.
    fn crowd(size: u32) -> Crowd {
        let mut random = Pcg64::seed_from_u64(7);
        let mut pedestrian = |id: u32| {
            let direction = if id.is_multiple_of(2) {
                DVec2::X
            } else {
                DVec2::NEG_X
            };
            let position = DVec2::new(
                random.random_range(0.0..2.0 * f64::from(size)),
                random.random_range(0.3..3.7),
            );
            Pedestrian {
                id,
                position,
                velocity: 1.34 * direction,
                direction,
                desired_speed: 1.34,
            }
        };
        let pedestrians = (0..size).map(&mut pedestrian).collect();
        let walls = vec![Wall::along(0.0), Wall::along(4.0)];
        Crowd::new(SocialForce::default(), walls, pedestrians, 1).within(0.01, 3.99)
    }

    fn walked(mut crowd: Crowd, steps: usize) -> Vec<Pedestrian> {
        (0..steps).for_each(|_| crowd.step(DT));
        crowd.pedestrians
    }

    #[test]
    fn one_thread_and_four_walk_to_the_same_bytes() {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("a pool");
            pool.install(|| walked(crowd(600), 200))
        };
        assert_eq!(on(1), on(4));
    }

    #[test]
    fn with_and_without_an_index_they_walk_to_the_same_bytes() {
        let mut all_pairs = crowd(300);
        all_pairs.neighbours = Neighbours::everyone(300);

        assert_eq!(walked(crowd(300), 100), walked(all_pairs, 100));
    }

    #[test]
    fn what_is_beyond_reach_adds_up_to_nothing() {
        let mut crowd = crowd(300);
        let forces = crowd.forces();
        let felt = |one: &Pedestrian| -> DVec2 {
            let others = crowd.pedestrians.iter().filter(|other| other.id != one.id);
            let step = |other: &Pedestrian| crowd.model.next_step(other.velocity, other.direction);
            let pair = |other: &Pedestrian| {
                crowd
                    .model
                    .pair_force(one.position - other.position, step(other), one.direction)
            };
            let walls = crowd
                .walls
                .iter()
                .map(|wall| crowd.model.wall_force(wall, one.position));
            others.map(pair).sum::<DVec2>() + walls.sum::<DVec2>()
        };
        for (one, force) in crowd.pedestrians.iter().zip(forces) {
            let exact = felt(one)
                + crowd
                    .model
                    .driving_force(one.desired_speed, one.direction, one.velocity);
            assert!(
                force.abs_diff_eq(exact, 10.0 * NEGLIGIBLE),
                "{force} instead of {exact}"
            );
        }
    }

    #[test]
    fn a_clone_walks_on_as_its_original() {
        for size in [10, 200] {
            let mut crowd = crowd(size);
            (0..10).for_each(|_| crowd.step(DT));

            assert_eq!(walked(crowd.clone(), 50), walked(crowd, 50));
        }
    }

    #[test]
    fn who_leaves_is_felt_no_more_and_the_others_keep_their_order() {
        for size in [10, 200] {
            let mut crowd = crowd(size);
            crowd.model.noise = 0.0;
            crowd.step(DT);
            crowd.remove(|pedestrian| pedestrian.id % 3 == 0);
            let ids: Vec<u32> = crowd
                .pedestrians()
                .iter()
                .map(|pedestrian| pedestrian.id)
                .collect();
            let anew = Crowd::new(
                crowd.model.clone(),
                crowd.walls.clone(),
                crowd.pedestrians.clone(),
                1,
            )
            .within(0.01, 3.99);

            assert!(ids.is_sorted() && ids.iter().all(|id| id % 3 != 0));
            assert_eq!(walked(crowd, 20), walked(anew, 20));
        }
    }

    #[test]
    fn nobody_outruns_the_cap_or_leaves_the_band() {
        let mut crowd = crowd(20);
        crowd.model.noise = 20.0;
        for _ in 0..100 {
            crowd.step(DT);
            for pedestrian in crowd.pedestrians() {
                assert!(pedestrian.velocity.length() <= 1.3 * 1.34 * (1.0 + f64::EPSILON));
                assert!((0.01..=3.99).contains(&pedestrian.position.y));
            }
        }
    }

    #[test]
    fn noise_kicks_with_its_deviation() {
        let free = SocialForce {
            repulsion: 0.0,
            speed_cap: 10.0,
            ..Default::default()
        };
        let still = |id| Pedestrian {
            id,
            position: DVec2::ZERO,
            velocity: DVec2::X,
            direction: DVec2::X,
            desired_speed: 1.0,
        };
        let crowd = walked(
            Crowd::new(free, Vec::new(), (0..1_000).map(still).collect(), 3),
            1,
        );
        let kicks = crowd
            .iter()
            .flat_map(|pedestrian| (pedestrian.velocity - DVec2::X).to_array());
        let variance = kicks.map(|kick| kick * kick).sum::<f64>() / 2_000.0;

        // q^2 dt = 0.0005; the estimate of 2,000 draws deviates by sqrt(2 / 2,000) = 3 %, and four
        // of these are asked for.
        assert!((variance / 0.0005 - 1.0).abs() < 0.13, "{variance}");
    }

    #[test]
    fn a_velocity_can_be_given() {
        let mut crowd = crowd(3);

        assert!(crowd.set_velocity(1, DVec2::Y));
        assert!(!crowd.set_velocity(3, DVec2::Y));
        assert_eq!(crowd.pedestrians()[1].velocity, DVec2::Y);
    }
}
