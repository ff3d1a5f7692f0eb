//! The options of a simulated hallway: a flag for every number of its protocol.

use clap::{Args, ValueEnum};

use crate::cli::Failure;
use crate::error::{Fault, Problem};
use crate::simulation::SocialForce;
use crate::simulation::hallway::{Hallway, Protocol, Scenario};

/// Which trials are simulated.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Protocol")]
pub(super) struct Options {
    /// Who walks where: counter-flow, or crossing, where one walks across a flow through a doorway
    /// in the middle of both walls
    #[arg(long, default_value_t)]
    scenario: Scenario,
    /// Length and width of the hallway in metres
    #[arg(long, value_enum, default_value_t = Preset::Short)]
    preset: Preset,
    /// Length of the hallway in metres, in place of the preset's
    #[arg(long, value_name = "METRES")]
    length: Option<f64>,
    /// Width of the hallway in metres, in place of the preset's
    #[arg(long, value_name = "METRES")]
    width: Option<f64>,
    /// Width of the doorway in metres
    #[arg(long, value_name = "METRES", default_value_t = Protocol::default().doorway)]
    doorway: f64,
    /// Pedestrians of a trial, at least 2
    #[arg(long, value_name = "COUNT", default_value_t = Protocol::default().pedestrians)]
    pedestrians: u32,
    /// Number of trials
    #[arg(long, value_name = "COUNT", default_value_t = Protocol::default().trials)]
    trials: u32,
    /// The same seed gives the same trials
    #[arg(long, default_value_t = Protocol::default().seed)]
    seed: u64,
    /// End of a trial in which somebody is still there, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = Protocol::default().longest_trial)]
    longest_trial: f64,
    /// Step of the simulation in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = Protocol::default().dt)]
    dt: f64,
    /// From one record to the next in seconds, a whole multiple of dt
    #[arg(long, value_name = "SECONDS", default_value_t = Protocol::default().record_interval)]
    record_interval: f64,
    /// Mean of desired speeds in m/s
    #[arg(long, value_name = "M/S", default_value_t = Protocol::default().speed_mean)]
    speed_mean: f64,
    /// Standard deviation of desired speeds in m/s
    #[arg(long, value_name = "M/S", default_value_t = Protocol::default().speed_sd)]
    speed_sd: f64,
    /// Desired speeds below it are drawn again, in m/s
    #[arg(long, value_name = "M/S", default_value_t = Protocol::default().speed_min)]
    speed_min: f64,
    /// Pedestrians start at most so far from their end, in metres
    #[arg(long, value_name = "METRES", default_value_t = Protocol::default().start_zone)]
    start_zone: f64,
    /// Pedestrians start at least so far from the walls, in metres
    #[arg(long, value_name = "METRES", default_value_t = Protocol::default().start_margin)]
    start_margin: f64,
    /// Pedestrians start at least so far from each other, in metres
    #[arg(long, value_name = "METRES", default_value_t = Protocol::default().start_gap)]
    start_gap: f64,
    #[command(flatten)]
    model: Model,
}

/// The sizes that the paper and its repetition use.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Preset {
    /// 20 m long, 4 m wide
    #[value(name = "20x4")]
    Short,
    /// 30 m long, 6 m wide
    #[value(name = "30x6")]
    Long,
}

/// The constants of the social force model.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Social force model")]
struct Model {
    /// Time in which a velocity approaches the desired one, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = SocialForce::default().relaxation_time)]
    relaxation_time: f64,
    /// Height of the potential around another pedestrian, in m^2/s^2
    #[arg(long, value_name = "HEIGHT", default_value_t = SocialForce::default().repulsion)]
    repulsion: f64,
    /// Range of that potential in metres
    #[arg(long, value_name = "METRES", default_value_t = SocialForce::default().repulsion_range)]
    repulsion_range: f64,
    /// Time over which another's next step is foreseen, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = SocialForce::default().step_time)]
    step_time: f64,
    /// Height of a wall's potential, in m^2/s^2
    #[arg(long, value_name = "HEIGHT", default_value_t = SocialForce::default().wall_repulsion)]
    wall_repulsion: f64,
    /// Range of that potential in metres
    #[arg(long, value_name = "METRES", default_value_t = SocialForce::default().wall_range)]
    wall_range: f64,
    /// Half of the angle of sight in degrees
    #[arg(long, value_name = "DEGREES", default_value_t = SocialForce::default().sight_half_angle)]
    sight_half_angle: f64,
    /// Weight of what happens out of sight, 0 to 1
    #[arg(long, value_name = "WEIGHT", default_value_t = SocialForce::default().weight_behind)]
    weight_behind: f64,
    /// Strength of the fluctuations, in m/s^(3/2)
    #[arg(long, value_name = "STRENGTH", default_value_t = SocialForce::default().noise)]
    noise: f64,
    /// Largest speed, in desired speeds
    #[arg(long, value_name = "RATIO", default_value_t = SocialForce::default().speed_cap)]
    speed_cap: f64,
}

impl Options {
    /// Checks the protocol; every fault is told by its flag.
    pub(super) fn hallway(&self) -> Result<Hallway, Failure> {
        Hallway::try_from(self.protocol()).map_err(|faults| {
            Problem::invalid("hallway", faults.into_iter().map(by_flag).collect()).into()
        })
    }

    fn protocol(&self) -> Protocol {
        let (length, width) = match self.preset {
            Preset::Short => (20.0, 4.0),
            Preset::Long => (30.0, 6.0),
        };
        Protocol {
            scenario: self.scenario,
            length: self.length.unwrap_or(length),
            width: self.width.unwrap_or(width),
            doorway: self.doorway,
            pedestrians: self.pedestrians,
            trials: self.trials,
            longest_trial: self.longest_trial,
            dt: self.dt,
            record_interval: self.record_interval,
            speed_mean: self.speed_mean,
            speed_sd: self.speed_sd,
            speed_min: self.speed_min,
            start_zone: self.start_zone,
            start_margin: self.start_margin,
            start_gap: self.start_gap,
            model: self.model.constants(),
            seed: self.seed,
        }
    }
}

impl Model {
    fn constants(&self) -> SocialForce {
        SocialForce {
            relaxation_time: self.relaxation_time,
            repulsion: self.repulsion,
            repulsion_range: self.repulsion_range,
            step_time: self.step_time,
            wall_repulsion: self.wall_repulsion,
            wall_range: self.wall_range,
            sight_half_angle: self.sight_half_angle,
            weight_behind: self.weight_behind,
            noise: self.noise,
            speed_cap: self.speed_cap,
        }
    }
}

/// Flags are called as the fields are: `/model/speed_cap` is `--speed-cap`.
pub(super) fn by_flag(fault: Fault) -> Fault {
    let field = fault.pointer.rsplit('/').next().unwrap_or_default();
    Fault::new(format!("--{}", field.replace('_', "-")), fault.detail)
}
