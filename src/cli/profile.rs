//! Lag profiles for people: a line a lag, the excess beside where it would lie under independence.

use std::path::PathBuf;

use clap::Args;

use super::Failure;
use super::output::{Table, cannot_write, count};
use crate::api::proto;
use crate::experiments::lag_profile::{Curve, plot};

/// What a profile is asked with beside the pair.
#[derive(Debug, Clone, Default, Args)]
pub(super) struct ProfileArguments {
    /// Say what all states say together, at one lag after the other
    #[arg(long, conflicts_with_all = ["state", "key", "lag", "graph", "features", "policy", "policy_segments", "estimators", "significance", "visits_to_decide", "view", "rule_kind", "rule_threshold", "rule_share", "rule_unit", "rule_min_visits", "rule_confidence"])]
    pub(super) profile: bool,
    /// The lags of the profile; 0 and all that are declared unless given
    #[arg(long, num_args = 1.., value_delimiter = ',', allow_negative_numbers = true, value_name = "STEPS", requires = "profile")]
    lags: Vec<i32>,
    /// Say the other direction too: the other's action on the ego's
    #[arg(long, requires = "profile", conflicts_with = "json")]
    pub(super) both: bool,
    /// File to draw the profile into, as SVG
    #[arg(long, value_name = "FILE", requires = "profile")]
    svg: Option<PathBuf>,
}

impl ProfileArguments {
    /// Returns the question as the service takes it.
    pub(super) fn request(
        &self,
        scope: proto::Scope,
        region: proto::Region,
    ) -> proto::GetProfileRequest {
        proto::GetProfileRequest {
            scope: Some(scope),
            region: Some(region),
            lags: self.lags.clone(),
        }
    }

    /// Draws a profile, or one of each direction, where a file was given for it.
    pub(super) fn draw(
        &self,
        environment: &str,
        profiles: &[proto::GetProfileResponse],
    ) -> Result<(), Failure> {
        let (Some(file), Some(first)) = (&self.svg, profiles.first()) else {
            return Ok(());
        };
        let title = format!("{environment}, {}", first.region_in_words);
        let curves: Vec<Curve> = profiles.iter().map(curve).collect();
        let svg = plot(&title, &first.unit, &curves);
        std::fs::write(file, svg).map_err(|error| cannot_write(file, &error))
    }
}

fn curve(profile: &proto::GetProfileResponse) -> Curve {
    let point = |point: &proto::ProfilePoint| {
        let null = point.null.unwrap_or_default();
        (point.lag, point.excess, [null.lower, null.upper])
    };
    let [ego, other] = pair(profile);
    Curve {
        name: format!("{ego} \u{2192} {other}"),
        points: profile.profile.iter().map(point).collect(),
    }
}

/// Returns whose influence on whom a profile is of.
pub(super) fn pair(profile: &proto::GetProfileResponse) -> [String; 2] {
    let labels = profile.labels.clone().unwrap_or_default();
    [labels.ego, labels.other].map(|one| one.unwrap_or_default().name)
}

fn title(environment: &str, profile: &proto::GetProfileResponse) -> String {
    let [ego, other] = pair(profile);
    let region = &profile.region_in_words;
    format!("{environment}: {ego} -> {other}, {region}")
}

/// Returns a profile as text.
pub(super) fn render(environment: &str, profile: &proto::GetProfileResponse) -> String {
    let unit = &profile.unit;
    let mut table = Table::new(&[
        "lag",
        "draws",
        "strata",
        &format!("excess ({unit})"),
        "if independent",
        "p",
        "p, one pattern",
    ]);
    for point in &profile.profile {
        table.row(row(point));
    }

    let transitions = count(profile.as_of);
    format!(
        "{}\n\n{}\n{}\nfrom {transitions} transitions\n",
        title(environment, profile),
        table.render("  "),
        peak(profile)
    )
}

fn row(point: &proto::ProfilePoint) -> [String; 7] {
    let null = point.null.unwrap_or_default();
    [
        point.lag.to_string(),
        count(point.draws),
        count(point.strata),
        small(point.excess),
        range(null),
        p_value(point.p_value),
        point.p_value_same_pattern.map_or("-".into(), p_value),
    ]
}

/// Returns a small number, a negative one that is 0 by then as 0.
fn small(number: f64) -> String {
    format!("{:.5}", (number * 1e5).round() / 1e5 + 0.0)
}

/// Returns the two ends of a range of small numbers.
pub(super) fn range(range: proto::Range) -> String {
    format!("{} to {}", small(range.lower), small(range.upper))
}

/// Returns a p-value so that it can be told whether it is small.
pub(super) fn p_value(p: f64) -> String {
    match p {
        0.0 => "<1e-300".into(),
        p if p >= 0.001 => format!("{p:.3}"),
        p => format!("{p:.0e}"),
    }
}

/// Says in a sentence where the profile has its peak.
fn peak(profile: &proto::GetProfileResponse) -> String {
    let lags = profile.profile.len();
    match (profile.peak, lags) {
        (Some(0), _) => "The peak is in the same tick, where dependence has no direction.".into(),
        (Some(lag), _) => format!(
            "The peak is at lag {lag}. Where actions are held, neighbouring lags depend as well."
        ),
        (None, 1) => "Nothing that chance would not show.".into(),
        (None, lags) => format!("Nothing at any of {lags} lags that chance would not show."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_is_told_a_line_a_lag() {
        let point = |lag, excess, p_value| proto::ProfilePoint {
            lag,
            draws: 5_002,
            strata: 880,
            excess,
            null: Some(proto::Range {
                lower: -0.003,
                upper: 0.003,
            }),
            p_value,
            ..proto::ProfilePoint::default()
        };
        let variable = |name: &str| {
            Some(proto::Variable {
                name: name.into(),
                ..proto::Variable::default()
            })
        };
        let profile = proto::GetProfileResponse {
            labels: Some(proto::Labels {
                ego: variable("cook"),
                other: variable("waiter"),
                given: Vec::new(),
            }),
            unit: "nats".into(),
            region_in_words: "everywhere".into(),
            profile: vec![point(0, -0.001, 0.7), point(6, 0.0117, 2e-9)],
            peak: Some(6),
            as_of: 12_345,
            ..proto::GetProfileResponse::default()
        };
        insta::assert_snapshot!(render("kitchen", &profile));
    }
}
