//! The social force model: what moves a pedestrian, as accelerations. Formulas only; who meets whom and when is the crowd's business.
//!
//! D. Helbing, P. Molnár, "Social force model for pedestrian dynamics", Phys. Rev. E 51, 4282 (1995), equations 2 to 11. Metres, seconds, metres per
//! second; forces are per unit of mass, m/s^2. No function returns NaN or an infinity for finite arguments: where a gradient has no direction, which is
//! said at each function, there is no force.

use glam::DVec2;

use super::Wall;
use crate::error::Fault;

/// The constants of the model. The default is the paper's.
#[derive(Debug, Clone, PartialEq)]
pub struct SocialForce {
    /// Time in which a velocity approaches the desired one, tau, in s.
    pub relaxation_time: f64,
    /// Height of the potential around another pedestrian, V0, in m^2/s^2.
    pub repulsion: f64,
    /// Range over which that potential falls to 1/e, sigma, in m.
    pub repulsion_range: f64,
    /// Time over which another pedestrian's next step is foreseen, in s: a step is as long as the way made in it.
    pub step_time: f64,
    /// Height of a wall's potential, U0, in m^2/s^2.
    pub wall_repulsion: f64,
    /// Range over which a wall's potential falls to 1/e, R, in m.
    pub wall_range: f64,
    /// Half of the angle of sight, phi, in degrees.
    pub sight_half_angle: f64,
    /// Weight of what happens out of sight, c.
    pub weight_behind: f64,
    /// Strength of the fluctuations, q, in m/s^(3/2): over dt each component of a velocity takes a normal kick of deviation q sqrt(dt).
    pub noise: f64,
    /// Largest speed, in desired speeds.
    pub speed_cap: f64,
}

impl Default for SocialForce {
    fn default() -> Self {
        Self {
            relaxation_time: 0.5,
            repulsion: 2.1,
            repulsion_range: 0.3,
            step_time: 2.0,
            wall_repulsion: 10.0,
            wall_range: 0.2,
            sight_half_angle: 100.0,
            weight_behind: 0.5,
            noise: 0.1,
            speed_cap: 1.3,
        }
    }
}

impl SocialForce {
    /// Returns every constant that no crowd could walk with.
    pub fn check(&self) -> Vec<Fault> {
        let positive = (f64::MIN_POSITIVE, f64::MAX, "a positive number");
        let not_negative = (0.0, f64::MAX, "a number that is not negative");
        let constants = [
            ("/relaxation_time", self.relaxation_time, positive),
            ("/repulsion", self.repulsion, not_negative),
            ("/repulsion_range", self.repulsion_range, positive),
            ("/step_time", self.step_time, not_negative),
            ("/wall_repulsion", self.wall_repulsion, not_negative),
            ("/wall_range", self.wall_range, positive),
            ("/sight_half_angle", self.sight_half_angle, (0.0, 180.0, "an angle of 0 to 180 degrees")),
            ("/weight_behind", self.weight_behind, (0.0, 1.0, "a weight of 0 to 1")),
            ("/noise", self.noise, not_negative),
            ("/speed_cap", self.speed_cap, (1.0, f64::MAX, "a number of at least 1")),
        ];
        let wrong = constants.into_iter().filter(|(_, value, (low, high, _))| !(low..=high).contains(&value));
        wrong
            .map(|(pointer, value, (.., expected))| Fault::new(pointer, format!("{value}, expected {expected}")))
            .collect()
    }

    /// Returns the pull towards the desired velocity, (v0 e - v) / tau (equation 2).
    pub fn driving_force(&self, desired_speed: f64, direction: DVec2, velocity: DVec2) -> DVec2 {
        (desired_speed * direction - velocity) / self.relaxation_time
    }

    /// Returns the next step s of a pedestrian: as long as the way at the present speed, in the *desired* direction (equation 4).
    pub fn next_step(&self, velocity: DVec2, direction: DVec2) -> DVec2 {
        self.step_time * velocity.length() * direction
    }

    /// Returns the force of another pedestrian who is felt at `r` (from the other to oneself) and is about to step by `step`, sight left aside:
    /// f = -grad V0 exp(-b / sigma), b being the [`semi_minor_axis`] (equations 3 and 4).
    ///
    /// With p = |r|, q = |r - s| and n the unit vector that halves the angle between r and r - s,
    ///
    /// ```text
    /// f = V0/sigma exp(-b/sigma) (p + q)/(4b) (r/p + (r - s)/q) = V0/sigma exp(-b/sigma) (p + q)/(2 sqrt(pq)) n
    /// ```
    ///
    /// because r/p + (r - s)/q = (2b / sqrt(pq)) n. The right side stays sharp as b goes to 0. On the step itself, from r = 0 to r = s, the potential
    /// is level, falls off alike on both sides, and the force is 0.
    pub fn repulsion(&self, r: DVec2, step: DVec2) -> DVec2 {
        let ahead = r - step;
        let (p, q) = (r.length(), ahead.length());
        let steepness =
            self.repulsion / self.repulsion_range * (-semi_minor_axis(r, step) / self.repulsion_range).exp();
        let halving = q * r + p * ahead;
        finite(halving * (steepness * (p + q) / (2.0 * (p * q).sqrt() * halving.length())))
    }

    /// Returns how much a force counts for one who looks along `direction`: whole if it comes from within sight, that is if
    /// e . (-f) >= |f| cos phi, and else `weight_behind` (equation 8).
    pub fn sight_weight(&self, direction: DVec2, force: DVec2) -> f64 {
        let within = direction.dot(-force) >= force.length() * self.sight_half_angle.to_radians().cos();
        if within { 1.0 } else { self.weight_behind }
    }

    /// Returns the [`repulsion`](Self::repulsion) as it counts for one who looks along `direction` (equation 9).
    pub fn pair_force(&self, r: DVec2, step: DVec2, direction: DVec2) -> DVec2 {
        let force = self.repulsion(r, step);
        self.sight_weight(direction, force) * force
    }

    /// Returns the force of a wall at its nearest point, U0/R exp(-d/R) away from it (equation 5). One who stands on the wall feels none.
    pub fn wall_force(&self, wall: &Wall, position: DVec2) -> DVec2 {
        let away = wall.away(position);
        let distance = away.length();
        finite(away * (self.wall_repulsion / self.wall_range * (-distance / self.wall_range).exp() / distance))
    }
}

/// Returns b, the semi-minor axis of the ellipse through oneself whose foci are the other's place and its place after the next step:
/// 2b = sqrt((|r| + |r - s|)^2 - |s|^2).
///
/// Reckoned as |q r + p (r - s)| / (2 sqrt(pq)), which loses no digits near the step; 0 at its ends.
pub fn semi_minor_axis(r: DVec2, step: DVec2) -> f64 {
    let ahead = r - step;
    let (p, q) = (r.length(), ahead.length());
    let product = p * q;
    if product > 0.0 { (q * r + p * ahead).length() / (2.0 * product.sqrt()) } else { 0.0 }
}

/// Where a direction is 0/0, or a distance beyond any number, there is no force.
fn finite(force: DVec2) -> DVec2 {
    if force.is_finite() { force } else { DVec2::ZERO }
}
