//! The social force model: what moves a pedestrian, as accelerations. Formulas only; who meets whom
//! and when is the crowd's business.
//!
//! D. Helbing, P. Molnár, "Social force model for pedestrian dynamics", Phys. Rev. E 51, 4282
//! (1995), equations 2 to 11. Metres, seconds, metres per second; forces are per unit of mass,
//! m/s^2. No function returns NaN or an infinity for finite arguments: where a gradient has no
//! direction, which is said at each function, there is no force.

use glam::DVec2;

use super::Wall;
use nudge_core::error::Fault;

/// The constants of the model. The default is the paper's.
#[derive(Debug, Clone, PartialEq)]
pub struct SocialForce {
    /// Time in which a velocity approaches the desired one, tau, in s.
    pub relaxation_time: f64,
    /// Height of the potential around another pedestrian, V0, in m^2/s^2.
    pub repulsion: f64,
    /// Range over which that potential falls to 1/e, sigma, in m.
    pub repulsion_range: f64,
    /// Time over which another pedestrian's next step is foreseen, in s: a step is as long as the
    /// way made in it.
    pub step_time: f64,
    /// Height of a wall's potential, U0, in m^2/s^2.
    pub wall_repulsion: f64,
    /// Range over which a wall's potential falls to 1/e, R, in m.
    pub wall_range: f64,
    /// Half of the angle of sight, phi, in degrees.
    pub sight_half_angle: f64,
    /// Weight of what happens out of sight, c.
    pub weight_behind: f64,
    /// Strength of the fluctuations, q, in m/s^(3/2): over dt each component of a velocity takes a
    /// normal kick of deviation q sqrt(dt).
    pub noise: f64,
    /// Largest speed, in desired speeds.
    pub speed_cap: f64,
}

/// A force too weak to be reckoned with, in m/s^2. In a step of 0.05 s it changes a velocity by
/// 5e-11 m/s; the noise does by 0.02 m/s.
pub const NEGLIGIBLE: f64 = 1e-9;

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
        // Farther out nobody could tell what was meant, and positions would leave the numbers.
        let positive = (1e-6, 1e6, "a number from 1e-6 to 1e6");
        let not_negative = (0.0, 1e6, "a number from 0 to 1e6");
        let constants = [
            ("/relaxation_time", self.relaxation_time, positive),
            ("/repulsion", self.repulsion, not_negative),
            ("/repulsion_range", self.repulsion_range, positive),
            ("/step_time", self.step_time, not_negative),
            ("/wall_repulsion", self.wall_repulsion, not_negative),
            ("/wall_range", self.wall_range, positive),
            (
                "/sight_half_angle",
                self.sight_half_angle,
                (0.0, 180.0, "an angle of 0 to 180 degrees"),
            ),
            (
                "/weight_behind",
                self.weight_behind,
                (0.0, 1.0, "a weight of 0 to 1"),
            ),
            ("/noise", self.noise, not_negative),
            (
                "/speed_cap",
                self.speed_cap,
                (1.0, 1e3, "a number from 1 to 1000"),
            ),
        ];
        let wrong = constants
            .into_iter()
            .filter(|(_, value, (low, high, _))| !(low..=high).contains(&value));
        wrong
            .map(|(pointer, value, (.., expected))| {
                Fault::new(pointer, format!("got {value}, expected {expected}"))
            })
            .collect()
    }

    /// Returns the pull towards the desired velocity, (v0 e - v) / tau (equation 2).
    pub fn driving_force(&self, desired_speed: f64, direction: DVec2, velocity: DVec2) -> DVec2 {
        (desired_speed * direction - velocity) / self.relaxation_time
    }

    /// Returns the next step s of a pedestrian: as long as the way at the present speed, in the
    /// *desired* direction (equation 4).
    pub fn next_step(&self, velocity: DVec2, direction: DVec2) -> DVec2 {
        self.step_time * velocity.length() * direction
    }

    /// Returns the force of another pedestrian who is felt at `r` (from the other to oneself) and
    /// is about to step by `step`, sight left aside: f = -grad V0 exp(-b / sigma), b being the
    /// [`semi_minor_axis`] (equations 3 and 4).
    ///
    /// With p = |r|, q = |r - s| and n the unit vector that halves the angle between r and r - s,
    ///
    /// ```text
    /// f = V0/sigma exp(-b/sigma) (p + q)/(4b) (r/p + (r - s)/q) = V0/sigma exp(-b/sigma) (p + q)/(2 sqrt(pq)) n
    /// ```
    ///
    /// because r/p + (r - s)/q = (2b / sqrt(pq)) n. The right side stays sharp as b goes to 0. On
    /// the step itself, from r = 0 to r = s, the potential is level, falls off alike on both sides,
    /// and the force is 0.
    #[inline]
    pub fn repulsion(&self, r: DVec2, step: DVec2) -> DVec2 {
        let ahead = r - step;
        let (p, q) = (r.length(), ahead.length());
        let steepness = self.repulsion / self.repulsion_range
            * (-semi_minor_axis(r, step) / self.repulsion_range).exp();
        let halving = q * r + p * ahead;
        finite(halving * (steepness * (p + q) / (2.0 * (p * q).sqrt() * halving.length())))
    }

    /// Returns the distance from which on another, whose next step is `step` m long, is felt with
    /// less than [`NEGLIGIBLE`] m/s^2 wherever that one goes.
    ///
    /// At a distance of R both the force's exponent and its form are worst straight ahead of the
    /// other, where |r - s| = R - |s|, b^2 = R (R - |s|) and
    ///
    /// ```text
    /// |f| = V0/sigma exp(-b/sigma) sqrt(1 + (|s| / 2b)^2)
    /// ```
    ///
    /// which falls as R grows. Solving for b in the exponent with a smaller b under the root gives
    /// a b on the safe side, and b gives R.
    pub fn reach(&self, step: f64) -> f64 {
        let ranges = (self.repulsion / self.repulsion_range / NEGLIGIBLE)
            .ln()
            .max(1.0);
        let stretch = (1.0 + (step / (2.0 * self.repulsion_range * ranges)).powi(2)).sqrt();
        let b = self.repulsion_range * (ranges + stretch.ln());
        step / 2.0 + (step * step / 4.0 + b * b).sqrt()
    }

    /// Returns how much a force counts for one who looks along `direction`: whole if it comes from
    /// within sight, that is if e . (-f) >= |f| cos phi, and else `weight_behind` (equation 8).
    #[inline]
    pub fn sight_weight(&self, direction: DVec2, force: DVec2) -> f64 {
        let within =
            direction.dot(-force) >= force.length() * self.sight_half_angle.to_radians().cos();
        if within { 1.0 } else { self.weight_behind }
    }

    /// Returns the [`repulsion`](Self::repulsion) as it counts for one who looks along `direction`
    /// (equation 9).
    #[inline]
    pub fn pair_force(&self, r: DVec2, step: DVec2, direction: DVec2) -> DVec2 {
        let force = self.repulsion(r, step);
        self.sight_weight(direction, force) * force
    }

    /// Returns the force of a wall at its nearest point, U0/R exp(-d/R) away from it (equation 5).
    /// One who stands on the wall feels none.
    pub fn wall_force(&self, wall: &Wall, position: DVec2) -> DVec2 {
        let away = wall.away(position);
        let distance = away.length();
        finite(
            away * (self.wall_repulsion / self.wall_range * (-distance / self.wall_range).exp()
                / distance),
        )
    }
}

/// Returns b, the semi-minor axis of the ellipse through oneself whose foci are the other's place
/// and its place after the next step: 2b = sqrt((|r| + |r - s|)^2 - |s|^2).
///
/// Reckoned as |q r + p (r - s)| / (2 sqrt(pq)), which loses no digits near the step; 0 at its
/// ends.
#[inline]
pub fn semi_minor_axis(r: DVec2, step: DVec2) -> f64 {
    let ahead = r - step;
    let (p, q) = (r.length(), ahead.length());
    let product = p * q;
    if product > 0.0 {
        (q * r + p * ahead).length() / (2.0 * product.sqrt())
    } else {
        0.0
    }
}

/// Where a direction is 0/0, or a distance beyond any number, there is no force.
#[inline]
fn finite(force: DVec2) -> DVec2 {
    if force.is_finite() {
        force
    } else {
        DVec2::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Central differences over 1e-5 m, where the potential bends over some 0.1 m, relative to the
    /// steepest slope.
    const DIFFERENCES: f64 = 1e-6;

    fn vector(size: f64) -> impl Strategy<Value = DVec2> {
        (-size..size, -size..size).prop_map(|(x, y)| DVec2::new(x, y))
    }

    /// Any finite numbers: zeros, the smallest, the largest.
    fn any_vector() -> impl Strategy<Value = DVec2> {
        use prop::num::f64::{NEGATIVE, NORMAL, POSITIVE, SUBNORMAL, ZERO};
        let number = || {
            prop_oneof![
                POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO,
                Just(0.0),
                Just(1.0)
            ]
        };
        (number(), number()).prop_map(|(x, y)| DVec2::new(x, y))
    }

    fn potential(r: DVec2, step: DVec2) -> f64 {
        let model = SocialForce::default();
        let axes = ((r.length() + (r - step).length()).powi(2) - step.length_squared())
            .max(0.0)
            .sqrt();
        model.repulsion * (-axes / 2.0 / model.repulsion_range).exp()
    }

    proptest! {
        #[test]
        fn the_repulsion_is_the_slope_of_the_potential(r in vector(3.0), step in vector(2.0)) {
            prop_assume!(semi_minor_axis(r, step) > 0.1);
            let slope = |by: DVec2| (potential(r + by, step) - potential(r - by, step)) / (2.0 * by.length());
            let expected = -DVec2::new(slope(1e-5 * DVec2::X), slope(1e-5 * DVec2::Y));
            let force = SocialForce::default().repulsion(r, step);

            prop_assert!(force.abs_diff_eq(expected, 7.0 * DIFFERENCES), "{force} instead of {expected}");
        }

        #[test]
        fn beyond_its_reach_nobody_is_felt(heading in 0.0..360_f64, length in 0.0..12_f64, beyond in 0.0..3_f64) {
            let model = SocialForce::default();
            let r = (model.reach(length) + beyond) * DVec2::from_angle(heading.to_radians());
            for step in [length * DVec2::X, length * r.normalize()] {
                prop_assert!(model.repulsion(r, step).length() <= NEGLIGIBLE);
            }
        }

        #[test]
        fn no_force_is_beyond_numbers(r in any_vector(), step in any_vector(), looks in vector(1.0)) {
            let model = SocialForce::default();
            prop_assert!(model.pair_force(r, step, looks).is_finite());
            prop_assert!(model.wall_force(&Wall::along(0.0), r).is_finite());
        }
    }

    #[test]
    fn the_reach_is_not_much_farther_than_it_must_be() {
        let model = SocialForce::default();
        for length in [0.0, 2.7, 5.0] {
            let nearer = (model.reach(length) - 0.05) * DVec2::X;
            assert!(model.repulsion(nearer, length * DVec2::X).length() > NEGLIGIBLE);
        }
    }

    #[test]
    fn where_the_potential_has_no_slope_there_is_no_force() {
        let step = 2.0 * DVec2::X;
        for r in [DVec2::ZERO, DVec2::X, step] {
            assert_eq!(SocialForce::default().repulsion(r, step), DVec2::ZERO);
            assert_eq!(semi_minor_axis(r, step), 0.0);
        }
        assert_eq!(
            SocialForce::default().wall_force(&Wall::along(1.0), DVec2::ONE),
            DVec2::ZERO
        );
    }

    #[test]
    fn beside_a_step_the_push_is_straight_away_from_it() {
        let model = SocialForce::default();
        let steepest = model.repulsion / model.repulsion_range;
        for side in [1e-12, -1e-12] {
            let force = model.repulsion(DVec2::new(1.0, side), 2.0 * DVec2::X);
            assert!(
                force.abs_diff_eq(DVec2::new(0.0, steepest.copysign(side)), 1e-9),
                "{force}"
            );
        }
    }

    #[test]
    fn who_stands_still_pushes_as_a_circle() {
        let force = SocialForce::default().repulsion(DVec2::new(0.0, 0.6), DVec2::ZERO);
        assert!(
            force.abs_diff_eq(DVec2::new(0.0, 7.0 * (-2_f64).exp()), 1e-15),
            "{force}"
        );
    }

    #[test]
    fn what_comes_from_behind_counts_half() {
        let model = SocialForce::default();
        let from = |degrees: f64| -DVec2::from_angle(degrees.to_radians());

        assert_eq!(
            [0.0, 99.9, -99.9].map(|degrees| model.sight_weight(DVec2::X, from(degrees))),
            [1.0; 3]
        );
        assert_eq!(
            [100.1, -100.1, 180.0].map(|degrees| model.sight_weight(DVec2::X, from(degrees))),
            [0.5; 3]
        );
    }

    #[test]
    fn every_impossible_constant_is_told() {
        let wrong = SocialForce {
            noise: -0.1,
            repulsion_range: 0.0,
            weight_behind: 1.5,
            wall_range: f64::NAN,
            ..Default::default()
        };
        let told: Vec<String> = wrong.check().iter().map(Fault::to_string).collect();

        assert_eq!(SocialForce::default().check(), []);
        assert_eq!(
            told,
            [
                "/repulsion_range: got 0, expected a number from 1e-6 to 1e6",
                "/wall_range: got NaN, expected a number from 1e-6 to 1e6",
                "/weight_behind: got 1.5, expected a weight of 0 to 1",
                "/noise: got -0.1, expected a number from 0 to 1e6",
            ]
        );
    }
}
