//! `nudge regions`: where influence lives.

use clap::Args;

use super::Failure;
use super::asking::asked;
use super::output::{Table, count, print, print_json, steps_later, to_json};
use super::profile::p_value;
use super::query::Within;
use super::server::Server;
use crate::api::{json as dto, proto};
use crate::domain::draft::RegionDraft;
use crate::error::Problem;

/// A line of the table has so many columns.
const WIDTH: usize = 80;

/// Find the regions in which one agent influences another
#[derive(Debug, Args)]
#[command(
    long_about = "Find the regions in which one agent influences another: rules of one to three conditions on features of the state.\n\n\
    Half of the segments are searched, over every rule; what is found there is tested on the other half, and told where that test passes \
    at a false discovery rate. Every figure but the first z is of the half that tests. What is weaker than three standard deviations in the half \
    that is searched is not promised to be found.\n\n\
    Example:\n  nudge regions kitchen --ego cook --other waiter --lag 4\n  \
    nudge regions kitchen --lag 4 --region distance=1..2 --most 3 --json"
)]
pub(super) struct Regions {
    /// Name of the environment
    environment: String,
    /// Agent whose influence is asked about; the first one unless given
    #[arg(long, value_name = "AGENT")]
    ego: Option<String>,
    /// Agent that may be influenced, or outcome with values; the second agent unless given
    #[arg(long, value_name = "AGENT")]
    other: Option<String>,
    /// Steps after which the other's action is observed, as the environment declares them; 0, the
    /// same tick, unless given
    #[arg(
        long,
        value_name = "STEPS",
        allow_negative_numbers = true,
        default_value_t = 0,
        hide_default_value = true
    )]
    lag: i32,
    /// Agents whose actions are held fixed
    #[arg(long, num_args = 1.., value_name = "AGENT")]
    given: Vec<String>,
    /// Segments to count; all unless given
    #[arg(long, num_args = 1.., value_name = "SEGMENT")]
    segments: Vec<String>,
    /// What is compared within each segment alone, and dealt into halves by segment; auto unless
    /// given
    #[arg(long, value_enum)]
    within: Option<Within>,
    /// The states that are searched: what some of their features, or of the derived ones, may be:
    /// a value, several (a,b), a range (1..2) or bins by their numbers (#0,#1); all unless given
    #[arg(long, num_args = 1.., value_name = "FEATURE=VALUES")]
    region: Vec<String>,
    /// Regions that are tested, at most; 10 unless given
    #[arg(
        long,
        value_name = "REGIONS",
        default_value_t = 0,
        hide_default_value = true
    )]
    most: u32,
    /// Share of false ones among those told that is accepted on average; .05 unless given
    #[arg(long, value_name = "RATE")]
    fdr: Option<f64>,
    /// Unit of the figures, nats or bits; the rule's unless given
    #[arg(long)]
    unit: Option<String>,
    /// Print JSON, as REST answers it
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

impl Regions {
    pub(super) async fn run(self) -> Result<(), Failure> {
        let request = self.request()?;
        let connection = self.server.connect().await?;
        let ask = || {
            let (mut client, request) = (connection.influence(), request.clone());
            async move { client.find_regions(request).await }
        };
        let response = asked(ask).await?;

        match self.json {
            true => print_json(&to_json(dto::RegionSearch::from(response))),
            false => print(&render(&self.environment, &response)),
        }
    }

    /// Returns the question as the service takes it.
    fn request(&self) -> Result<proto::FindRegionsRequest, Problem> {
        let region = RegionDraft::of_words(&self.region).map_err(|faults| {
            let faults = faults.into_iter().map(|fault| fault.under("/region"));
            Problem::invalid("question", faults.collect())
        })?;
        let within = self.within.map_or(proto::Within::Unspecified, Into::into);
        let scope = proto::Scope {
            environment: self.environment.clone(),
            ego: self.ego.clone().unwrap_or_default(),
            other: self.other.clone().unwrap_or_default(),
            given: self.given.clone(),
            segments: self.segments.clone(),
            unit: self.unit.clone().unwrap_or_default(),
            within: within.into(),
            lag: self.lag,
            ..proto::Scope::default()
        };
        Ok(proto::FindRegionsRequest {
            scope: Some(scope),
            region: Some(region.into()),
            most: self.most,
            fdr: self.fdr,
        })
    }
}

/// Returns a search as text.
fn render(environment: &str, search: &proto::FindRegionsResponse) -> String {
    let labels = search.labels.clone().unwrap_or_default();
    let [ego, other] = [labels.ego, labels.other].map(|one| one.unwrap_or_default().name);
    let mut text = format!(
        "{environment}: {ego} -> {other}, {}, {}\n\n",
        steps_later(search.lag),
        search.region_in_words
    );

    for (at, found) in (1..).zip(&search.regions) {
        text += &wrapped(&format!("{at}  "), &place(&found.region_in_words));
    }
    if !search.regions.is_empty() {
        text += &format!("\n{}\n", table(search));
    }
    text += &wrapped("", &sentence(search));
    if !search.left_out.is_empty() {
        let left_out = search.left_out.join(", ");
        text += &wrapped(
            "",
            &format!("Too many features for rules of several conditions: without {left_out}."),
        );
    }
    text + &format!("from {} transitions\n", count(search.as_of))
}

/// Says where, of a region in words.
pub(super) fn place(region: &str) -> String {
    match region {
        "everywhere" => region.into(),
        conditions => format!("when {conditions}"),
    }
}

fn table(search: &proto::FindRegionsResponse) -> String {
    let mut table = Table::new(&[
        "",
        "draws",
        "z searched",
        "z tested",
        "p",
        "q",
        &format!("size ({})", search.unit),
    ]);
    for (at, found) in (1..).zip(&search.regions) {
        table.row([
            format!("{at}"),
            count(found.draws),
            format!("{:.1}", found.z_searched),
            format!("{:.1}", found.z),
            p_value(found.p_value),
            p_value(found.q_value),
            size(found),
        ]);
    }
    table.render("")
}

/// Returns a size with the wider of its intervals.
fn size(found: &proto::FoundRegion) -> String {
    let bound = if found.share < 0.5 { ">= " } else { "" };
    let interval = found.size_interval_new_segments.or(found.size_interval);
    let interval = interval.map(|ends| format!(" ({:.3} to {:.3})", ends.lower, ends.upper));
    format!("{bound}{:.3}{}", found.size, interval.unwrap_or_default())
}

/// Says what was done, and what it means where nothing was found.
fn sentence(search: &proto::FindRegionsResponse) -> String {
    let halves = match search.dealt.as_str() {
        "segments" => format!(
            "{} segments were searched and {} test",
            search.segments_searched, search.segments_tested
        ),
        _ => "Half of the states were searched and the others test: too few segments".into(),
    };
    let rules = count(search.rules);
    let found = match (search.regions.len(), search.tested) {
        (0, 0) => "Nothing found: no rule stands out".into(),
        (0, 1) => "Nothing found: the only region that stood out did not in the other half".into(),
        (0, tested) => {
            format!("Nothing found: of {tested} regions that stood out none did in the other half")
        }
        (found, tested) => {
            format!("{found} of {tested} regions that stood out did so in the other half too")
        }
    };
    format!("{found}. {halves}; {rules} rules were looked at.")
}

/// Returns a text in lines of at most 80 columns, the first after a head and the others below it.
fn wrapped(head: &str, text: &str) -> String {
    let indent = head.chars().count();
    let (mut lines, mut line) = (String::new(), head.to_owned());
    let mut length = indent;
    for word in text.split(' ') {
        let wide = word.chars().count();
        if length > indent && length + 1 + wide > WIDTH {
            lines += &format!("{}\n", line.trim_end());
            (line, length) = (" ".repeat(indent), indent);
        }
        if length > indent {
            line.push(' ');
            length += 1;
        }
        line += word;
        length += wide;
    }
    lines + &line + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn searched(regions: Vec<proto::FoundRegion>, tested: u32) -> proto::FindRegionsResponse {
        proto::FindRegionsResponse {
            lag: 4,
            region_in_words: "everywhere".into(),
            unit: "nats".into(),
            dealt: "segments".into(),
            segments_searched: 8,
            segments_tested: 7,
            regions,
            tested,
            rules: 166_120,
            as_of: 12_345,
            ..proto::FindRegionsResponse::default()
        }
    }

    #[test]
    fn regions_are_told_in_words_and_in_figures() {
        let region = |words: &str, z: f64, p: f64| proto::FoundRegion {
            region_in_words: words.into(),
            draws: 1_234,
            z_searched: z + 1.0,
            z,
            p_value: p,
            q_value: p,
            size: 0.0321,
            size_interval: Some(proto::Range {
                lower: 0.02,
                upper: 0.04,
            }),
            share: 0.4,
            ..proto::FoundRegion::default()
        };
        let long = "distance 1 to 2, player_1.held onion, dish, soup or nothing, player_0.orientation north";
        let found = vec![region(long, 7.25, 2e-9), region("dx 1", 3.0, 0.004)];
        let told = render("kitchen", &searched(found, 3));
        assert!(
            told.lines().all(|line| line.chars().count() <= WIDTH),
            "{told}"
        );
        insta::assert_snapshot!(told);
    }

    #[test]
    fn nothing_found_is_said_in_a_sentence() {
        let told = |tested| render("kitchen", &searched(Vec::new(), tested));
        assert!(
            told(0).contains("Nothing found: no rule stands out."),
            "{}",
            told(0)
        );
        assert!(told(1).contains("the only region"), "{}", told(1));
        insta::assert_snapshot!(told(2));
    }
}
