//! `nudge experiment planted`: every decision beside every other, in worlds whose influence was planted.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::cli::Failure;
use crate::cli::output::{Table, count, print, print_json};
use crate::cli::progress::Progress;
use crate::experiments::findings::{Bound, REVISION};
use crate::experiments::measures::Spread;
use crate::experiments::planted::{
    self, Decision, Figure, Options, Report, SHARES, USUAL_SHARE, World, arm_name, generator_name,
};
use crate::experiments::seeds::Seeds;
use crate::simulation::planted::{Arm, Generator};

/// The figures by which decisions are compared.
const COMPARED: [Figure; 9] = [
    Figure::AucPlanted,
    Figure::AucStrong,
    Figure::F1,
    Figure::Rmse,
    Figure::Coverage,
    Figure::CoverageDependent,
    Figure::Precision,
    Figure::Recall,
    Figure::Undecided,
];

/// The figures that show what is called influence where there is little of it, or nothing else.
const CALLED: [(&str, Decision, Figure); 7] = [
    ("mean P(dependent)", Decision::SpikeAndSlab, Figure::MeanProbability),
    ("established", Decision::SpikeAndSlab, Figure::Established),
    ("falsely", Decision::SpikeAndSlab, Figure::FalselyEstablished),
    ("called", Decision::SpikeAndSlab, Figure::Called),
    ("falsely", Decision::SpikeAndSlab, Figure::FalselyCalled),
    ("called by the paper's rule", Decision::PapersFilter, Figure::Called),
    ("falsely", Decision::PapersFilter, Figure::FalselyCalled),
];

/// Compare ways to decide where the true influence is known
#[derive(Debug, Args)]
#[command(long_about = "Compare ways to decide where the true influence is known.\n\n\
    Worlds are drawn by three generators, in which 30 % of the states have influence; visits are as uneven as in play, half of the states have 12 or \
    fewer. The plug-in (the paper's figure), the paper's rule, the plug-in less its mean under independence, NSB, a permutation test and the \
    default rule (spike and slab) are asked of a service that counted them. Beside them stand the same worlds with the other's actions shuffled, where \
    nothing is left to find, and worlds whose margins give nothing away; then worlds of 50, 200 and --states states with influence nowhere, in 30 % \
    and everywhere. With --out the figures are written as planted.csv and planted.json, and the plot as planted.svg.\n\n\
    Example:\n  nudge experiment planted --seeds 3 --states 500 --out ./results")]
pub(in crate::cli) struct Planted {
    /// How many seeds
    #[arg(long, value_name = "NUMBER", default_value_t = Options::default().seeds.number, value_parser = clap::value_parser!(u32).range(1..=1_000))]
    seeds: u32,
    /// The first seed; the others follow it
    #[arg(long, value_name = "NUMBER", default_value_t = Options::default().seeds.first)]
    seed: u32,
    /// States of the worlds on which decisions are compared
    #[arg(long, value_name = "NUMBER", default_value_t = Options::default().states as u32, value_parser = clap::value_parser!(u32).range(1..=50_000))]
    states: u32,
    /// Directory for planted.csv, planted.json and planted.svg, made if it is missing
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Planted {
    pub(super) async fn run(self) -> Result<(), Failure> {
        let seeds = Seeds { number: self.seeds, first: self.seed };
        let options = Options { seeds, states: self.states as usize };
        if let Some(directory) = &self.out {
            std::fs::create_dir_all(directory).map_err(|error| unwritable(directory, &error))?;
        }
        let progress = Progress::new(options.worlds().len() as u64 * u64::from(options.seeds.number));
        progress.part("planted influence");
        let report = planted::run(&options, || progress.step()).await?;
        progress.finish();
        if let Some(directory) = &self.out {
            write(directory, "planted.csv", &report.findings.csv())?;
            write(directory, "planted.json", &format!("{:#}\n", report.json()))?;
            write(directory, "planted.svg", &planted::plot(&report))?;
        }
        if self.json { print_json(&report.json()) } else { print(&render(&report)) }
    }
}

fn write(directory: &Path, name: &str, text: &str) -> Result<(), Failure> {
    let path = directory.join(name);
    std::fs::write(&path, text).map_err(|error| unwritable(&path, &error))
}

fn unwritable(path: &Path, error: &std::io::Error) -> Failure {
    Failure::usage(format!("cannot write {}: {error}", path.display()))
}

/// Returns the report as people read it.
fn render(report: &Report) -> String {
    let mut text = format!(
        "planted influence, nudge {}: {}, {} states, {USUAL_SHARE} % of them with influence; mean ±sd over seeds\n",
        REVISION,
        report.options.seeds,
        count(report.options.states as u64),
    );
    for generator in Generator::ALL {
        let letters = generator.alphabet().rows;
        text +=
            &format!("\n{}: {letters} x {letters} actions\n{}", generator_name(generator), compared(report, generator));
    }
    text += &format!("\n{} where there is less to go by, or nothing\n{}", Figure::AucPlanted.as_str(), arms(report));
    text += &format!("\nwhat is said of whole worlds, % of states\n{}", called(report));
    text += &format!("\ntargets, stated for 2,500 states and at least 10 seeds\n{}", targets(report));
    text
}

fn compared(report: &Report, generator: Generator) -> String {
    let mut table = Table::new(&[&["decision"], COMPARED.map(Figure::as_str).as_slice()].concat());
    let world = report.options.compared(generator, Arm::Plain);
    for decision in Decision::ALL {
        let cells = COMPARED.iter().map(|figure| told(report.findings.find(&world, decision, *figure)));
        table.row(std::iter::once(decision.as_str().to_owned()).chain(cells));
    }
    table.render("")
}

fn arms(report: &Report) -> String {
    let titles = Generator::ALL.map(generator_name);
    let mut table = Table::new(&[&["arm", "decision"], titles.as_slice()].concat());
    for arm in [Arm::Plain, Arm::LeakFree, Arm::Shuffled] {
        for decision in Decision::ALL.into_iter().filter(|decision| *decision != Decision::PapersFilter) {
            let area = |generator| {
                report.findings.find(&report.options.compared(generator, arm), decision, Figure::AucPlanted)
            };
            let named = [arm_name(arm), decision.as_str()].map(str::to_owned);
            table.row(named.into_iter().chain(Generator::ALL.map(|generator| told(area(generator)))));
        }
    }
    table.render("")
}

fn called(report: &Report) -> String {
    let titles = CALLED.map(|(title, ..)| title);
    let mut table = Table::new(&[&["world", "states", "with influence"], titles.as_slice()].concat());
    let mut row = |name: &str, world: World| {
        let cell = |(_, decision, figure)| report.findings.find(&world, decision, figure);
        let percent =
            |spread: Option<Spread>| spread.map_or("-".to_owned(), |spread| format!("{:.1}", spread.mean * 100.0));
        let named = [name.to_owned(), count(world.states as u64), format!("{} %", world.dependent)];
        table.row(named.into_iter().chain(CALLED.map(|column| percent(cell(column)))));
    };
    for generator in Generator::ALL {
        let name = generator_name(generator);
        for states in report.options.sizes() {
            for dependent in SHARES {
                row(name, World { generator, arm: Arm::Plain, states, dependent });
            }
        }
        row(&format!("{name} shuffled"), report.options.compared(generator, Arm::Shuffled));
    }
    table.render("")
}

fn targets(report: &Report) -> String {
    let mut table = Table::new(&["world", "decision", "figure", "target", "measured", ""]);
    for target in report.targets() {
        let bound = match target.bound {
            Bound::AtLeast(at) => format!(">= {at}"),
            Bound::AtMost(at) => format!("<= {at}"),
        };
        let measured = target.measured.map_or("-".to_owned(), |measured| format!("{measured:.4}"));
        let met = if target.is_met() { "met" } else { "MISSED" };
        let (decision, figure) = (target.decision.as_str(), target.figure.as_str());
        let named = [generator_name(target.world.generator), decision, figure].map(str::to_owned);
        table.row(named.into_iter().chain([bound, measured, met.to_owned()]));
    }
    table.render("")
}

fn told(spread: Option<Spread>) -> String {
    match spread {
        Some(Spread { mean, sd: Some(sd), .. }) => format!("{mean:.3} ±{sd:.3}"),
        Some(Spread { mean, .. }) => format!("{mean:.3}"),
        None => "-".to_owned(),
    }
}
