//! How an experiment in the hallway is run: every number of it, and what is refused.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use crate::simulation::SocialForce;
use nudge_core::error::Fault;

/// Who walks where.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scenario {
    /// Two flows meet: every other pedestrian walks from left to right, the rest from right to
    /// left.
    #[default]
    CounterFlow,
    /// One pedestrian walks across the hallway, through a doorway in the middle of both walls, at a
    /// right angle to all others, who walk from left to right.
    ///
    /// It enters so that it would meet the middle of the flow in the middle of the hallway, and
    /// leaves through the far doorway, through which nobody else leaves. Two whose ways cross at a
    /// right angle can dance around each other for long in this model: of 200 trials with one other
    /// 50 end only with the longest trial, 60 s; with nine others, 88.
    Crossing,
}

impl Scenario {
    /// Every scenario.
    pub const ALL: [Self; 2] = [Self::CounterFlow, Self::Crossing];

    /// Returns the word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::CounterFlow => "counter-flow",
            Self::Crossing => "crossing",
        }
    }
}

impl fmt::Display for Scenario {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Scenario {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "got {text:?}, expected one of {}",
                Self::ALL.map(Self::as_str).join(", ")
            )
        };
        Self::ALL
            .into_iter()
            .find(|one| one.as_str() == text)
            .ok_or_else(wrong)
    }
}

/// Every number of an experiment, unchecked: [`Hallway`](super::Hallway) is what comes of it.
/// Lengths are in metres, times in seconds.
///
/// x runs along the hallway from 0 to `length`, y across it from 0 to `width`.
#[derive(Debug, Clone, PartialEq)]
pub struct Protocol {
    /// Who walks where.
    pub scenario: Scenario,
    /// Length of the hallway.
    pub length: f64,
    /// Width of the hallway, from wall to wall.
    pub width: f64,
    /// Width of the doorway in the middle of both walls; only the crossing has one.
    pub doorway: f64,
    /// Pedestrians of a trial.
    pub pedestrians: u32,
    /// Trials, numbered from 1.
    pub trials: u32,
    /// A trial ends after so long, if somebody is still there.
    pub longest_trial: f64,
    /// A step of the simulation.
    pub dt: f64,
    /// From one record to the next; a whole multiple of `dt`.
    pub record_interval: f64,
    /// Mean of the normal distribution of desired speeds, in m/s.
    pub speed_mean: f64,
    /// Standard deviation of desired speeds, in m/s.
    pub speed_sd: f64,
    /// Desired speeds below it are drawn again, in m/s.
    pub speed_min: f64,
    /// Pedestrians start at most so far from their end of the hallway.
    pub start_zone: f64,
    /// Pedestrians start at least so far from the walls.
    pub start_margin: f64,
    /// Pedestrians start at least so far from each other.
    pub start_gap: f64,
    /// The forces.
    pub model: SocialForce,
    /// The same seed gives the same trials.
    pub seed: u64,
}

impl Default for Protocol {
    /// The hallway of 20 x 4 m with ten pedestrians in counter-flow, ten trials.
    fn default() -> Self {
        Self {
            scenario: Scenario::default(),
            length: 20.0,
            width: 4.0,
            doorway: 1.5,
            pedestrians: 10,
            trials: 10,
            longest_trial: 60.0,
            dt: 0.05,
            record_interval: 0.2,
            speed_mean: 1.34,
            speed_sd: 0.26,
            speed_min: 0.3,
            start_zone: 5.0,
            start_margin: 0.3,
            start_gap: 0.6,
            model: SocialForce::default(),
            seed: 0,
        }
    }
}

impl Protocol {
    /// Returns every fault, by the name of the field.
    pub fn check(&self) -> Vec<Fault> {
        let mut faults = Faults::default();
        faults.number("length", self.length, 0.1..=10_000.0);
        faults.number("width", self.width, 0.1..=1_000.0);
        faults.whole("pedestrians", self.pedestrians, 2..=100_000);
        faults.whole("trials", self.trials, 1..=1_000_000);
        faults.number("longest_trial", self.longest_trial, 0.0..=86_400.0);
        faults.number("dt", self.dt, 0.001..=1.0);
        faults.number("record_interval", self.record_interval, 0.001..=60.0);
        faults.number("speed_mean", self.speed_mean, 0.01..=10.0);
        faults.number("speed_sd", self.speed_sd, 0.0..=10.0);
        faults.number("speed_min", self.speed_min, 0.0..=10.0);
        faults.number("start_zone", self.start_zone, 0.0..=10_000.0);
        faults.number("start_margin", self.start_margin, 0.0..=1_000.0);
        faults.number("start_gap", self.start_gap, 0.0..=100.0);
        if self.scenario == Scenario::Crossing {
            faults.number("doorway", self.doorway, 0.1..=10_000.0);
        }
        if faults.0.is_empty() {
            self.check_together(&mut faults);
        }
        faults.0.extend(
            self.model
                .check()
                .into_iter()
                .map(|fault| fault.under("/model")),
        );
        faults.0
    }

    /// Checks what only makes sense of numbers that are sound by themselves.
    fn check_together(&self, faults: &mut Faults) {
        /// How far a ratio of decimal fractions may be from a whole number.
        const ROUNDING: f64 = 1e-6;
        let ratio = self.record_interval / self.dt;
        if (ratio - ratio.round()).abs() > ROUNDING || ratio < 1.0 - ROUNDING {
            faults.add(
                "record_interval",
                self.record_interval,
                format!("a whole multiple of dt, which is {}", self.dt),
            );
        }
        if self.speed_min > self.speed_mean {
            faults.add(
                "speed_min",
                self.speed_min,
                format!("at most speed_mean, which is {}", self.speed_mean),
            );
        }
        if self.start_margin > self.width / 2.0 {
            faults.add(
                "start_margin",
                self.start_margin,
                format!("at most half of width, which is {}", self.width),
            );
        }
        let (room, what) = match self.scenario {
            Scenario::CounterFlow => (self.length / 2.0, "at most half of length"),
            Scenario::Crossing => (
                (self.length - self.doorway) / 2.0,
                "to end before the doorway",
            ),
        };
        if self.start_zone > room {
            faults.add(
                "start_zone",
                self.start_zone,
                format!("{what}, which leaves {room}"),
            );
        }
    }

    /// Returns how many steps lie between two records, at least 1.
    pub(super) fn steps_per_record(&self) -> u32 {
        (self.record_interval / self.dt).round() as u32
    }
}

/// The faults found so far.
#[derive(Default)]
struct Faults(Vec<Fault>);

impl Faults {
    fn add(&mut self, name: &str, value: impl fmt::Display, expected: impl fmt::Display) {
        self.0.push(Fault::new(
            format!("/{name}"),
            format!("got {value}, expected {expected}"),
        ));
    }

    /// NaN lies in no range.
    fn number(&mut self, name: &str, value: f64, allowed: RangeInclusive<f64>) {
        if !allowed.contains(&value) {
            self.add(
                name,
                value,
                format!("a number from {} to {}", allowed.start(), allowed.end()),
            );
        }
    }

    fn whole(&mut self, name: &str, value: u32, allowed: RangeInclusive<u32>) {
        if !allowed.contains(&value) {
            self.add(
                name,
                value,
                format!("{} to {}", allowed.start(), allowed.end()),
            );
        }
    }
}
