//! What all states of an environment say as one: whose action tells of whose, and how much later.

use super::names::{TWIN, short};
use crate::api::proto;
use crate::cli::Failure;
use crate::cli::output::{Table, figure, print};
use crate::cli::profile::p_value;
use crate::cli::regions::place;
use crate::client::{Connection, patiently, schema_of};

/// The level at which an environment is said to have influence in it, divided by the number of
/// directions and lags that were looked at (Bonferroni).
const LEVEL: f64 = 0.05;

const EXPLAINED: &str = "
excess: mutual information beyond what it would be without influence, in nats a
step; chance: where that lies then, in 95 % of cases; p: how often chance shows
as much; size: how strong it is. Nothing is found where p is above .05 divided by
the lags looked at, both ways: the strongest of many is large by chance.
follower is planted: it copies its leader two steps later, where they are near.
shuffled is the same play with actions exchanged within each state.";

const WHERE: &str = "
where: the region that stands out in half of the games; z, p: how far the same
region stands out in the other half. Where none does, none is told.";

/// One lag in one direction.
struct Looked {
    ego: String,
    other: String,
    point: proto::ProfilePoint,
}

/// What stands out of all lags in both directions.
struct Strongest {
    looked: Looked,
    /// Whether chance would not show it.
    is_found: bool,
}

/// Prints a line an environment: the strongest lag and direction beside what chance would show.
pub(super) async fn tell(connection: &Connection, environments: &[String]) -> Result<(), Failure> {
    let titles = [
        "environment",
        "who on whom",
        "lag",
        "excess",
        "chance",
        "p",
        "size",
    ];
    let mut table = Table::new(&titles);
    let mut regions = Table::new(&["environment", "where", "z", "p"]);
    for environment in environments {
        let strongest = strongest(connection, environment).await?;
        table.row(row(environment, &strongest));
        if strongest.is_found {
            for found in found(connection, environment, strongest.looked).await? {
                regions.row(region(environment, &found));
            }
        }
    }
    print(&format!(
        "\nwhere one's action shows in what the other does: all states as one\n\n{}{EXPLAINED}\n\n{}{WHERE}",
        table.render(""),
        regions.render("")
    ))
}

/// Returns the regions in which that lives: found in one half of the segments, tested on the other.
async fn found(
    connection: &Connection,
    environment: &str,
    looked: Looked,
) -> Result<Vec<proto::FoundRegion>, Failure> {
    let scope = proto::Scope {
        environment: environment.into(),
        ego: looked.ego,
        other: looked.other,
        lag: looked.point.lag as i32,
        ..Default::default()
    };
    let request = proto::FindRegionsRequest {
        scope: Some(scope),
        ..Default::default()
    };
    let ask = || {
        let (mut client, request) = (connection.influence(), request.clone());
        async move { client.find_regions(request).await }
    };
    Ok(patiently(ask).await?.regions)
}

fn region(environment: &str, found: &proto::FoundRegion) -> [String; 4] {
    [
        label(environment),
        place(&found.region_in_words),
        format!("{:.1}", found.z),
        p_value(found.p_value),
    ]
}

/// Looks at every lag in both directions: returns the largest excess of those that chance would not
/// show, else what chance would show least often.
async fn strongest(connection: &Connection, environment: &str) -> Result<Strongest, Failure> {
    let looked = looked(connection, environment).await?;
    let level = LEVEL / looked.len() as f64;
    let is_found = |looked: &Looked| looked.point.p_value <= level && looked.point.excess > 0.0;
    let strength = |looked: &Looked| match is_found(looked) {
        true => (1, looked.point.excess),
        false => (0, -looked.point.p_value),
    };
    let by_strength = |a: &Looked, b: &Looked| {
        let [(a_found, a), (b_found, b)] = [strength(a), strength(b)];
        a_found.cmp(&b_found).then(a.total_cmp(&b))
    };

    let strongest = looked.into_iter().max_by(by_strength);
    let looked = strongest.expect("every environment has a lag, that of the same tick");
    let is_found = is_found(&looked);
    Ok(Strongest { looked, is_found })
}

async fn looked(connection: &Connection, environment: &str) -> Result<Vec<Looked>, Failure> {
    let schema = schema_of(&connection.environment(environment).await?)?;
    let [one, two] = [0, 1].map(|agent| schema.agents()[agent].name.to_string());
    let mut looked = profile(connection, environment, [&one, &two]).await?;
    if !schema.outcomes().is_empty() {
        let back = profile(connection, environment, [&two, &one]).await?;
        // In the same tick there is one dependence, which was looked at.
        looked.extend(back.into_iter().filter(|looked| looked.point.directed));
    }
    Ok(looked)
}

async fn profile(
    connection: &Connection,
    environment: &str,
    [ego, other]: [&str; 2],
) -> Result<Vec<Looked>, Failure> {
    let scope = proto::Scope {
        environment: environment.into(),
        ego: ego.into(),
        other: other.into(),
        ..Default::default()
    };
    let request = proto::GetProfileRequest {
        scope: Some(scope),
        ..Default::default()
    };
    let ask = || {
        let (mut client, request) = (connection.influence(), request.clone());
        async move { client.get_profile(request).await }
    };
    let looked = |point| Looked {
        ego: ego.into(),
        other: other.into(),
        point,
    };
    let profile = patiently(ask).await?.profile;
    Ok(profile.into_iter().map(looked).collect())
}

fn row(environment: &str, strongest: &Strongest) -> [String; 7] {
    let Strongest { looked, is_found } = strongest;
    let Looked { ego, other, point } = looked;
    let arrow = if point.directed { "->" } else { "--" };
    let (pair, size) = match is_found {
        true => (format!("{ego}{arrow}{other}"), figure(point.size)),
        false => ("nothing found".into(), "-".into()),
    };
    [
        label(environment),
        pair,
        point.lag.to_string(),
        figure(point.excess),
        format!("\u{b1}{}", figure(point.null.unwrap_or_default().upper)),
        p_value(point.p_value),
        size,
    ]
}

/// Returns what an environment is called here: a twin stands below what it is a twin of.
fn label(environment: &str) -> String {
    let twin = environment.strip_suffix(&TWIN.to_string());
    match twin.is_some_and(|rest| rest.ends_with('.')) {
        true => format!("  {TWIN}"),
        false => short(environment).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_what_is_found_and_says_where_nothing_is() {
        let point = proto::ProfilePoint {
            lag: 6,
            directed: true,
            excess: 0.011_64,
            null: Some(proto::Range {
                lower: -0.004,
                upper: 0.004,
            }),
            p_value: 2e-8,
            size: 0.0271,
            ..proto::ProfilePoint::default()
        };
        let line = |is_found| {
            let [ego, other] = ["player_1", "player_0"].map(str::to_owned);
            let looked = Looked { ego, other, point };
            row("demo.kitchen", &Strongest { looked, is_found }).join(" ")
        };
        assert_eq!(
            line(true),
            "kitchen player_1->player_0 6 0.0116 \u{b1}0.0040 2e-8 0.0271"
        );
        assert_eq!(
            line(false),
            "kitchen nothing found 6 0.0116 \u{b1}0.0040 2e-8 -"
        );
    }
}
