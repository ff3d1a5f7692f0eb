//! `nudge experiment planted`: every method beside every other, in worlds whose influence was
//! planted.

mod figures;
mod hard;
mod kitchens;
mod lagged;
mod segments;
mod tables;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::Value;

use crate::cli::Failure;
use crate::cli::output::{print, print_json};
use crate::cli::progress::Progress;
use crate::experiments::kitchens::{self as in_kitchens, Layout};
use crate::experiments::planted::{
    self as of_tables, World, hard as in_hard_worlds, lagged as of_followers,
    segments as in_segments,
};
use crate::experiments::seeds::Seeds;
use crate::simulation::planted::{lagged as tracks, segments as drawn};

/// Compare ways to decide where the true influence is known
#[derive(Debug, Args)]
#[command(
    long_about = "Compare ways to decide where the true influence is known.\n\n\
    tables: worlds are drawn by three generators, in which 30 % of the states have influence; visits are as uneven as in play, half of the states have 12 \
    or fewer. The plug-in (the paper's figure), the paper's rule, the plug-in less its mean under independence, NSB, a permutation test and the \
    default rule (spike and slab) are asked of a service that counted them. Beside them stand the same worlds with the other's actions shuffled, where \
    nothing is left to find, and worlds whose margins give nothing away; then worlds of 50, 200 and --states states with influence nowhere, in 30 % \
    and everywhere. Some two minutes for ten seeds.\n\n\
    kitchens: the states that people visited in two layouts of Overcooked, with policies fitted to theirs, in which the other steps aside where the \
    ego is near (or copies it, or steps aside only where the ego holds something). A service counts the training games and is asked about the states \
    that only the test games have: by its networks, by a look-up table, by what was counted in coarser states, and beside them by a network whose \
    service counted shuffled actions. Some five minutes for five seeds on two cores.\n\n\
    hard: worlds that the evidence was not built on: 2 to 64 actions, one that is mostly or rarely taken, copies, weak dependence seen up to a million \
    times, segments with habits of their own, dependence everywhere and nowhere. The default rule is asked: how well it ranks and estimates, what its \
    intervals cover, what it falsely excludes or establishes, and its verdicts by few visits and by many. A minute for ten seeds.\n\n\
    segments: worlds whose visits come in 2 to 300 segments, in which either agent's habits or both differ, or nobody's, and nothing is dependent, or 30 % \
    of the states are: in all segments alike, in a single one, or in each by other responses. Evidence is asked by itself: what it falsely establishes, \
    finds, excludes and covers within segments, and how much of what is listed at a false discovery rate of 0.05 is false. A minute or two for ten seeds.\n\n\
    lagged: tracks in which a follower copies a leader one or three steps later, or nobody copies anybody, and in which both choose at each step or hold \
    their actions. Evidence is asked by itself at lags 0 to 8 in both directions, on draws that all agents have acted anew since: where it finds the copy, \
    what it falsely finds at other lags, in reverse and among shuffled actions, and what the profile's peak is. Two minutes for ten seeds.\n\n\
    With --out the figures of tables are written as planted.csv and planted.json with the plot planted.svg; those of kitchens, hard, segments and lagged \
    under these names.\n\n\
    Example:\n  nudge experiment planted --seeds 3 --states 500 --out ./results\n  \
    nudge experiment planted --part kitchens --layout counter_circuit --seeds 1\n  \
    nudge experiment planted --part hard --world copy --world weak25 --seeds 3\n  \
    nudge experiment planted --part segments --world opposite\n  \
    nudge experiment planted --part lagged --world copy3 --seeds 3"
)]
pub(in crate::cli) struct Planted {
    /// Run one part only [default: all of them]
    #[arg(long, value_name = "PART")]
    part: Option<Part>,
    /// How many seeds [default: 10; 5 for kitchens]
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..=1_000))]
    seeds: Option<u32>,
    /// The first seed; the others follow it
    #[arg(long, value_name = "NUMBER", default_value_t = of_tables::Options::default().seeds.first)]
    seed: u32,
    /// States of the worlds of tables on which methods are compared [default: 2500], the most of
    /// a hard world [default: 150 to 1500], those of a world of segments [default: 200], and of
    /// tracks [default: 40]
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..=50_000))]
    states: Option<u32>,
    /// A world of hard, segments or lagged of this name only; may be given again [default: all of them]
    #[arg(long = "world", value_name = "NAME", value_parser = named)]
    worlds: Vec<Named>,
    /// Kitchens of one layout only: asymmetric_advantages or counter_circuit
    #[arg(long, value_name = "NAME")]
    layout: Option<Layout>,
    /// The most passes of the kitchens' networks over the states
    #[arg(long, value_name = "NUMBER", default_value_t = in_kitchens::Options::default().epochs, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    epochs: u32,
    /// Directory for the figures and plots, made if it is missing
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A part of the experiment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Part {
    /// Drawn tables
    Tables,
    /// Visits of people
    Kitchens,
    /// Tables unlike those that the evidence was built on
    Hard,
    /// Tables whose visits come in segments
    Segments,
    /// Tracks in which one copies the other some steps later
    Lagged,
}

impl Part {
    fn as_str(self) -> &'static str {
        match self {
            Self::Tables => "tables",
            Self::Kitchens => "kitchens",
            Self::Hard => "hard",
            Self::Segments => "segments",
            Self::Lagged => "lagged",
        }
    }
}

/// A world that has a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Named {
    Hard(World),
    Segments(drawn::World),
    Lagged(tracks::World),
}

impl Named {
    fn part(self) -> Part {
        match self {
            Self::Hard(_) => Part::Hard,
            Self::Segments(_) => Part::Segments,
            Self::Lagged(_) => Part::Lagged,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Hard(world) => in_hard_worlds::name(&world),
            Self::Segments(world) => world.name,
            Self::Lagged(world) => world.name,
        }
    }

    /// Returns every world that has a name.
    fn all() -> Vec<Self> {
        let hard = in_hard_worlds::worlds().into_iter().map(Self::Hard);
        hard.chain(drawn::WORLDS.map(Self::Segments))
            .chain(tracks::WORLDS.map(Self::Lagged))
            .collect()
    }
}

/// What a part found, in every form.
struct Told {
    part: &'static str,
    name: &'static str,
    text: String,
    json: Value,
    csv: String,
    svg: String,
}

impl Planted {
    pub(super) async fn run(self) -> Result<(), Failure> {
        self.check_worlds()?;
        if let Some(directory) = &self.out {
            std::fs::create_dir_all(directory).map_err(|error| unwritable(directory, &error))?;
        }
        let wanted = |part| self.is_wanted(part);
        let mut parts = Vec::new();
        if wanted(Part::Tables) {
            parts.push(self.write_part(self.tables().await?)?);
        }
        if wanted(Part::Kitchens) {
            parts.push(self.write_part(self.kitchens().await?)?);
        }
        if wanted(Part::Hard) {
            parts.push(self.write_part(self.hard().await?)?);
        }
        if wanted(Part::Segments) {
            parts.push(self.write_part(self.segments())?);
        }
        if wanted(Part::Lagged) {
            parts.push(self.write_part(self.lagged())?);
        }

        match &parts[..] {
            [part] if self.json => print_json(&part.json),
            _ if self.json => print_json(
                &parts
                    .into_iter()
                    .map(|part| (part.part, part.json))
                    .collect::<Value>(),
            ),
            _ => print(
                &parts
                    .iter()
                    .map(|part| part.text.as_str())
                    .collect::<Vec<_>>()
                    .join("\n"),
            ),
        }
    }

    /// Refuses a world of a part that is not run.
    fn check_worlds(&self) -> Result<(), Failure> {
        let idle = self
            .worlds
            .iter()
            .find(|world| !self.is_wanted(world.part()));
        idle.map_or(Ok(()), |world| {
            let (name, part) = (world.name(), world.part().as_str());
            Err(Failure::usage(format!(
                "--world {name} is a world of --part {part}, which is not run"
            )))
        })
    }

    async fn tables(&self) -> Result<Told, Failure> {
        let usual = of_tables::Options::default();
        let options = of_tables::Options {
            seeds: self.seeds(usual.seeds),
            states: self.states.map_or(usual.states, |states| states as usize),
        };
        let progress =
            Progress::new(options.worlds().len() as u64 * u64::from(options.seeds.number));
        progress.part("planted influence");
        let report = of_tables::run(&options, || progress.step()).await?;
        progress.finish();
        let svg = of_tables::plot(&report);

        Ok(Told {
            part: "tables",
            name: "planted",
            text: tables::render(&report),
            json: report.json(),
            csv: report.findings.csv(),
            svg,
        })
    }

    async fn kitchens(&self) -> Result<Told, Failure> {
        let usual = in_kitchens::Options::default();
        let layouts = self.layout.map_or(usual.layouts, |layout| vec![layout]);
        let options = in_kitchens::Options {
            seeds: self.seeds(usual.seeds),
            layouts,
            epochs: self.epochs,
            ..usual
        };

        let progress =
            Progress::new(options.worlds().len() as u64 * u64::from(options.seeds.number));
        progress.part("planted influence in kitchens");
        let report = in_kitchens::run(&options, || progress.step()).await?;
        progress.finish();
        let svg = in_kitchens::plot(&report);

        Ok(Told {
            part: "kitchens",
            name: "kitchens",
            text: kitchens::render(&report),
            json: report.json(),
            csv: report.findings.csv(),
            svg,
        })
    }

    async fn hard(&self) -> Result<Told, Failure> {
        let usual = in_hard_worlds::Options::default();
        let wanted = |world: &World| self.names(Named::Hard(*world));
        let options = in_hard_worlds::Options {
            seeds: self.seeds(usual.seeds),
            states: self.states.map(|states| states as usize),
            worlds: usual.worlds.into_iter().filter(wanted).collect(),
        };

        let progress =
            Progress::new(options.worlds().len() as u64 * u64::from(options.seeds.number));
        progress.part("planted influence in hard worlds");
        let report = in_hard_worlds::run(&options, || progress.step()).await?;
        progress.finish();
        let svg = in_hard_worlds::plot(&report);

        Ok(Told {
            part: "hard",
            name: "hard",
            text: hard::render(&report),
            json: report.json(),
            csv: report.findings.csv(),
            svg,
        })
    }

    fn segments(&self) -> Told {
        let usual = in_segments::Options::default();
        let wanted = |world: &drawn::World| self.names(Named::Segments(*world));
        let options = in_segments::Options {
            seeds: self.seeds(usual.seeds),
            states: self.states.map_or(usual.states, |states| states as usize),
            worlds: usual.worlds.into_iter().filter(wanted).collect(),
        };

        let progress =
            Progress::new(options.worlds().len() as u64 * u64::from(options.seeds.number));
        progress.part("planted influence in segments");
        let report = in_segments::run(&options, || progress.step());
        progress.finish();
        let svg = in_segments::plot(&report);

        Told {
            part: "segments",
            name: "segments",
            text: segments::render(&report),
            json: report.json(),
            csv: report.findings.csv(),
            svg,
        }
    }

    fn lagged(&self) -> Told {
        let usual = of_followers::Options::default();
        let wanted = |world: &tracks::World| self.names(Named::Lagged(*world));
        let options = of_followers::Options {
            seeds: self.seeds(usual.seeds),
            states: self.states.map_or(usual.states, |states| states as usize),
            worlds: usual.worlds.into_iter().filter(wanted).collect(),
        };

        let progress =
            Progress::new(options.worlds().len() as u64 * u64::from(options.seeds.number));
        progress.part("planted followers");
        let report = of_followers::run(&options, || progress.step());
        progress.finish();
        let svg = of_followers::plot(&report);

        Told {
            part: "lagged",
            name: "lagged",
            text: lagged::render(&report),
            json: report.json(),
            csv: report.findings.csv(),
            svg,
        }
    }

    /// Returns whether a part is run.
    fn is_wanted(&self, part: Part) -> bool {
        self.part.is_none_or(|only| only == part)
    }

    /// Returns whether a world is wanted: by its name, or with all the others of its part, of which
    /// none was named.
    fn names(&self, world: Named) -> bool {
        let mut of_part = self
            .worlds
            .iter()
            .filter(|named| named.part() == world.part())
            .peekable();
        of_part.peek().is_none() || of_part.any(|named| *named == world)
    }

    fn seeds(&self, usual: Seeds) -> Seeds {
        Seeds {
            number: self.seeds.unwrap_or(usual.number),
            first: self.seed,
        }
    }

    /// Writes what a part found, as soon as it is found.
    fn write_part(&self, part: Told) -> Result<Told, Failure> {
        if let Some(directory) = &self.out {
            let name = part.name;
            write(directory, &format!("{name}.csv"), &part.csv)?;
            write(
                directory,
                &format!("{name}.json"),
                &format!("{:#}\n", part.json),
            )?;
            write(directory, &format!("{name}.svg"), &part.svg)?;
        }
        Ok(part)
    }
}

/// Returns the world of a name.
fn named(text: &str) -> Result<Named, String> {
    let all = Named::all();
    let expected = || {
        all.iter()
            .map(|world| world.name())
            .collect::<Vec<_>>()
            .join(", ")
    };
    all.iter()
        .find(|world| world.name() == text)
        .copied()
        .ok_or_else(|| format!("got {text:?}, expected one of {}", expected()))
}

fn write(directory: &Path, name: &str, text: &str) -> Result<(), Failure> {
    let path = directory.join(name);
    std::fs::write(&path, text).map_err(|error| unwritable(&path, &error))
}

fn unwritable(path: &Path, error: &std::io::Error) -> Failure {
    Failure::usage(format!("cannot write {}: {error}", path.display()))
}
