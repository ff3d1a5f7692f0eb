//! Regions on the command line: a `--region` each, and what is answered about them, for people.

use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};

use super::answers::{basis, heading, probabilities, segmentation};
use super::output::{Table, count, figure, figure_or_dash, percent};
use super::profile::{p_value, range};
use crate::api::json::verdict;
use crate::api::proto;
use crate::domain::draft::RegionDraft;
use crate::error::{Fault, Problem};

/// How many of the other's actions are told after each of the ego's.
const RESPONSES_TOLD: usize = 2;

/// The regions of a question, a flag each; one without conditions is all states.
#[derive(Debug, Clone, Default)]
pub(super) struct Regions(Vec<Vec<String>>);

impl FromArgMatches for Regions {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut regions = Self::default();
        regions.update_from_arg_matches(matches)?;
        Ok(regions)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        let given = matches.value_source("region") == Some(ValueSource::CommandLine);
        let flags = matches.get_occurrences::<String>("region").into_iter();
        self.0 = flags
            .flatten()
            .map(|words| words.cloned().collect())
            .collect();
        if given && self.0.is_empty() {
            self.0.push(Vec::new());
        }
        Ok(())
    }
}

impl Args for Regions {
    fn augment_args(command: Command) -> Command {
        command.arg(
            Arg::new("region")
                .long("region")
                .num_args(0..)
                .action(ArgAction::Append)
                .value_name("FEATURE=VALUES")
                .help(
                    "All states of a region, asked about as one: what some of their features, or \
                     of the derived ones, may be: a value, several (a,b), a range (1..2) or bins \
                     by their numbers (#0,#1); without any, all states. A flag a region",
                ),
        )
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl Regions {
    /// Returns whether there is none.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns how many there are.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns the regions as the service takes them.
    pub(super) fn messages(&self) -> Result<Vec<proto::Region>, Problem> {
        let (mut regions, mut faults) = (Vec::new(), Vec::new());
        for (at, words) in self.0.iter().enumerate() {
            match RegionDraft::of_words(words) {
                Ok(draft) => regions.push(draft.into()),
                Err(found) => faults.extend(under(found, &format!("/regions/{at}"))),
            }
        }
        match faults.is_empty() {
            true => Ok(regions),
            false => Err(Problem::invalid("question", faults)),
        }
    }

    /// Returns the one region that all flags describe together.
    pub(super) fn joined(&self) -> Result<proto::Region, Problem> {
        let draft = RegionDraft::of_words(&self.0.concat());
        draft
            .map(Into::into)
            .map_err(|faults| Problem::invalid("question", under(faults, "/region").collect()))
    }
}

fn under(faults: Vec<Fault>, place: &str) -> impl Iterator<Item = Fault> {
    faults.into_iter().map(move |fault| fault.under(place))
}

/// Returns answers about regions as text: one in full, several as a table.
pub(super) fn render(environment: &str, response: &proto::BatchGetInfluenceResponse) -> String {
    let labels = response.labels.clone().unwrap_or_default();
    let heading = heading(environment, &labels, response.lag, &response.answers);
    match response.answers.as_slice() {
        [only] if only.mutual_information.is_some() => {
            format!("{heading}\n\n{}", one(only, &labels))
        }
        all => format!("{heading}\n\n{}", several(all)),
    }
}

/// Tells one answer in full.
fn one(answer: &proto::Answer, labels: &proto::Labels) -> String {
    let strata = answer.strata.unwrap_or_default();
    let entries = answer
        .entries
        .map(|entries| format!(", {} entries", count(entries)));
    let mut lines = vec![
        format!("region: {}", answer.region_in_words),
        format!(
            "{}, from {}: {} visits{} in {} states, {} strata",
            verdict(answer.verdict),
            basis(answer),
            count(answer.visits),
            entries.unwrap_or_default(),
            count(strata.states),
            count(strata.strata)
        ),
    ];
    lines.extend(probabilities(answer));
    lines.extend(
        answer
            .dependent_share
            .map(|share| format!("share of visits in dependent states {}", percent(share))),
    );
    lines.push(tests(answer));
    lines.extend(segmentation(answer));
    lines.extend(
        answer
            .warnings
            .iter()
            .map(|warning| format!("warning: {warning}")),
    );

    let lines: String = lines.iter().map(|line| format!("{line}\n")).collect();
    let information = answer.mutual_information.clone().unwrap_or_default();
    let left_out = merged(answer, &information);
    let actions = by_action(answer, labels);
    format!(
        "{lines}{}{left_out}{actions}",
        figures(answer, &information)
    )
}

fn tests(answer: &proto::Answer) -> String {
    let pattern = answer.p_value_same_pattern;
    format!(
        "p {} that independence shows as much within strata, {} one shared pattern",
        answer.p_value.map_or("-".into(), p_value),
        pattern.map_or("-".into(), p_value)
    )
}

fn figures(answer: &proto::Answer, information: &proto::MutualInformation) -> String {
    let mut table = Table::new(&["mutual information", &answer.unit]);
    table.row(["size".into(), figure_or_dash(information.size)]);
    let intervals = [
        ("  95 % on these segments", information.size_interval),
        (
            "  95 % on new segments",
            information.size_interval_new_segments,
        ),
    ];
    for (name, ends) in intervals {
        table.row([name.into(), ends.map_or("-".into(), range)]);
    }
    if let (Some(mean), Some(ends)) = (information.posterior_mean, information.interval) {
        table.row(["posterior mean".into(), figure(mean)]);
        let ends = proto::Range {
            lower: ends.lower,
            upper: ends.upper,
        };
        table.row(["  90 %".into(), range(ends)]);
    }
    table.row(["plug-in".into(), figure(information.plug_in)]);
    let expected = information.expected_if_independent;
    table.row(["expected if independent".into(), figure(expected)]);
    table.row(["excess".into(), figure_or_dash(information.excess)]);
    table.row([
        "  95 % if independent".into(),
        information.null.map_or("-".into(), range),
    ]);
    table.render("  ")
}

/// Tells the figures with nothing left out beside the merged ones, where features were left out.
fn merged(answer: &proto::Answer, information: &proto::MutualInformation) -> String {
    let Some(stratified) = &information.stratified else {
        return String::new();
    };
    let mut table = Table::new(&["", "strata", "excess", "95 % if independent", "p"]);
    let strata = |strata: Option<proto::Strata>| count(strata.unwrap_or_default().strata);
    table.row([
        "merged".into(),
        strata(answer.strata),
        figure_or_dash(information.excess),
        information.null.map_or("-".into(), range),
        answer.p_value.map_or("-".into(), p_value),
    ]);
    table.row([
        "stratified".into(),
        strata(stratified.strata),
        figure(stratified.excess),
        stratified.null.map_or("-".into(), range),
        p_value(stratified.p_value),
    ]);
    let left_out = answer.left_out.join(", ");
    format!("\nleft out: {left_out}\n{}", table.render("  "))
}

fn by_action(answer: &proto::Answer, labels: &proto::Labels) -> String {
    if answer.by_action.is_empty() {
        return String::new();
    }
    let divergence = format!("divergence ({})", answer.unit);
    let mut table = Table::new(&[
        "action",
        "draws",
        &divergence,
        "if independent",
        "answered by (if independent)",
    ]);
    for action in &answer.by_action {
        table.row([
            action.action.clone(),
            count(action.visits),
            figure_or_dash(action.plug_in_divergence),
            figure_or_dash(action.expected_divergence),
            responses(action, labels),
        ]);
    }
    format!("\n{}", table.render("  "))
}

/// Tells the responses that differ most from independence: `stay 61 % (48 %)`.
fn responses(action: &proto::ActionFigures, labels: &proto::Labels) -> String {
    let names = labels.other.as_ref().map(|other| other.actions.as_slice());
    let label = |index: usize| match names.unwrap_or_default().get(index) {
        Some(label) => label.clone(),
        None => format!("#{index}"),
    };
    let beside = action.response.iter().zip(&action.response_if_independent);
    let mut told: Vec<(usize, f64, f64)> = beside
        .enumerate()
        .map(|(index, (seen, expected))| (index, *seen, *expected))
        .collect();
    told.sort_by(|a, b| (b.1 - b.2).abs().total_cmp(&(a.1 - a.2).abs()));

    let told = told.into_iter().take(RESPONSES_TOLD);
    let told = told.map(|(index, seen, expected)| {
        format!("{} {} ({})", label(index), percent(seen), percent(expected))
    });
    told.collect::<Vec<_>>().join(", ")
}

/// Tells several answers a line each.
fn several(answers: &[proto::Answer]) -> String {
    let mut table = Table::new(&[
        "region",
        "visits",
        "verdict",
        "size",
        "excess",
        "95 % if independent",
        "p",
        "one pattern",
    ]);
    for answer in answers {
        let information = answer.mutual_information.clone().unwrap_or_default();
        table.row([
            answer.region_in_words.clone(),
            count(answer.visits),
            verdict(answer.verdict).into(),
            figure_or_dash(information.size),
            figure_or_dash(information.excess),
            information.null.map_or("-".into(), range),
            answer.p_value.map_or("-".into(), p_value),
            answer.p_value_same_pattern.map_or("-".into(), p_value),
        ]);
    }
    table.render("")
}
