//! `nudge demo`: the service with real human games in it, what it found, and what to try.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::Failure;
use super::ingest::{self, Report};
use super::output::{Table, count, figure, print};
use super::progress::Progress;
use super::serve::{Service, Signals, address};
use crate::api::json::verdict;
use crate::api::proto;
use crate::client::Connection;
use crate::config::Config;
use crate::recordings::overcooked::{self, Abstraction};
use crate::telemetry;

/// States told of each environment.
const TOLD: u32 = 3;

/// Try it: the service, real human games, and what they show
#[derive(Debug, Args)]
#[command(
    long_about = "Start a service on a database of its own, send real human games of Overcooked into it over gRPC, say what was found, \
    and keep serving until Ctrl-C.\n\n\
    The games come with the program. A second run finds them counted and changes nothing.\n\n\
    Example:\n  nudge demo --data ./nudge-demo --duration 20s"
)]
pub(super) struct Demo {
    /// Address of every face; port 0 takes a free one
    #[arg(long, env = "NUDGE_LISTEN", value_name = "ADDR", value_parser = address, default_value_t = Config::default().listen)]
    listen: SocketAddr,
    /// Directory of the database, made if it is missing
    #[arg(long, value_name = "DIR", default_value = "nudge-demo")]
    data: PathBuf,
    /// End by itself after so long: 20s, 5m or 1h
    #[arg(long, value_parser = duration)]
    duration: Option<Duration>,
    /// Start over: forget the games that were counted before
    #[arg(long)]
    fresh: bool,
}

impl Demo {
    /// Serves, plays and tells, until a signal or the end of the time.
    pub(super) async fn run(self) -> Result<(), Failure> {
        telemetry::log(telemetry::LogFormat::Human);
        let signals = Signals::install()?;
        let config = Config { listen: self.listen, data: self.data.clone(), ..Config::default() };
        let service = Service::start(&config).await?;
        let address = reachable(service.address);
        print(&format!("listening on http://{address}, counting in {}", config.database().display()))?;
        let shown = tokio::select! {
            shown = self.show(address) => shown,
            () = signals.next() => Ok(()),
        };
        let stopped = service.stop_unless(&signals).await;
        shown.and(stopped)
    }

    async fn show(&self, address: SocketAddr) -> Result<(), Failure> {
        let ended = tokio::time::sleep(self.duration.unwrap_or(Duration::MAX));
        let shown = async {
            let connection = Connection::open(&address.to_string()).await?;
            let environments = self.play(&connection).await?;
            let best = tell(&connection, &environments).await?;
            print(&to_try(address, &best))?;
            std::future::pending().await
        };
        tokio::select! {
            shown = shown => shown,
            () = ended => Ok(()),
        }
    }

    /// Sends the games that are not counted yet and returns the names of their environments.
    async fn play(&self, connection: &Connection) -> Result<Vec<String>, Failure> {
        let mut parts = Vec::new();
        for (name, bytes) in overcooked::embedded() {
            parts.extend(ingest::parts_of(name, bytes, Abstraction::default())?);
        }
        let mut names: Vec<String> = parts.iter().map(ingest::Part::environment_name).collect();
        names.sort();
        names.dedup();
        if self.fresh {
            forget(connection, &names).await?;
        }
        let progress = Progress::new(parts.iter().map(ingest::Part::steps).sum());
        let report = Report::of(&parts, connection, &progress).await?;
        progress.finish();
        print(&format!("\nhuman games of Overcooked, each transition counted once\n{}", report.table()))?;
        Ok(names)
    }
}

async fn forget(connection: &Connection, names: &[String]) -> Result<(), Failure> {
    for name in names {
        let request = proto::DeleteEnvironmentRequest { name: name.clone() };
        match connection.environments().delete_environment(request).await {
            Ok(_) => {}
            Err(status) if status.code() == tonic::Code::NotFound => {}
            Err(status) => return Err(status.into()),
        }
    }
    Ok(())
}

/// A state worth a look: its environment and its key.
#[derive(Default)]
struct Best {
    environment: String,
    key: String,
    plug_in: f64,
}

/// Prints where plug-in mutual information is highest beside what independence would give, and returns the highest of all.
async fn tell(connection: &Connection, environments: &[String]) -> Result<Best, Failure> {
    let mut best = Best::default();
    let mut table = Table::new(&["environment", "state", "visits", "plug-in", "if independent", "paper's rule"]);
    let mut summaries =
        Table::new(&["environment", "transitions", "states", "visits in states with >= 8", "undecided"]);
    for environment in environments {
        let scope = proto::Scope { environment: environment.clone(), ..Default::default() };
        let request = proto::SummarizeRequest { scope: Some(scope.clone()) };
        summaries.row(summary_row(environment, &connection.influence().summarize(request).await?.into_inner()));
        let request = proto::ListStatesRequest {
            scope: Some(scope),
            order_by: "plug_in desc".into(),
            min_visits: 8,
            page_size: TOLD,
            ..Default::default()
        };
        for state in connection.influence().list_states(request).await?.into_inner().states {
            let key = state.state.clone().unwrap_or_default().key;
            if state.plug_in > best.plug_in {
                best = Best { environment: environment.clone(), key: key.clone(), plug_in: state.plug_in };
            }
            table.row(state_row(environment, key, &state));
        }
    }
    print(&format!("\n{}", summaries.render("")))?;
    print(&format!(
        "\nwhere player_0 and player_1 seem most dependent (nats, states seen at least 8 times)\n{}",
        table.render("")
    ))?;
    print(
        "\nThese are the highest of hundreds of states, seen a few times each: there plug-in mutual information is mostly bias and luck, \
         which is why\nevery figure stands beside the one expected if the players were independent.",
    )?;
    Ok(best)
}

fn summary_row(environment: &str, summary: &proto::SummarizeResponse) -> [String; 5] {
    let undecided = summary.verdicts.map_or(0, |verdicts| verdicts.undecided);
    let share = summary.share_of_visits_with_enough_data * 100.0;
    [
        environment.to_owned(),
        count(summary.transitions),
        count(summary.states),
        format!("{share:.0} %"),
        count(undecided),
    ]
}

fn state_row(environment: &str, key: String, state: &proto::StateFigures) -> [String; 6] {
    let [plug_in, expected] = [state.plug_in, state.expected_if_independent].map(figure);
    [environment.to_owned(), key, count(state.visits), plug_in, expected, verdict(state.verdict).to_owned()]
}

fn to_try(address: SocketAddr, best: &Best) -> String {
    let Best { environment, key, .. } = best;
    format!(
        "\nto try:\n  \
         curl -s 'http://{address}/v1/environments/{environment}/influence?key={key}'\n  \
         curl -s 'http://{address}/v1/environments/{environment}/summary'\n  \
         nudge query {environment} --key {key} --server http://{address}\n  \
         buf curl --protocol grpc --http2-prior-knowledge -d '{{\"scope\":{{\"environment\":\"{environment}\"}},\"key\":\"{key}\"}}' \
         http://{address}/nudge.v1.InfluenceService/GetInfluence\n  \
         documentation: http://{address}/docs\n\nserving until Ctrl-C"
    )
}

/// Returns an address that a client on this machine can reach.
fn reachable(address: SocketAddr) -> SocketAddr {
    match address.ip() {
        ip if ip.is_unspecified() => SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), address.port()),
        _ => address,
    }
}

fn duration(text: &str) -> Result<Duration, String> {
    let wrong = || format!("got {text:?}, expected a whole number and s, m or h: 20s");
    let (number, unit) = text.split_at(text.len() - text.chars().next_back().map_or(0, char::len_utf8));
    let seconds = match unit {
        "s" => 1,
        "m" => 60,
        "h" => 3_600,
        _ => return Err(wrong()),
    };
    let number: u64 = number.parse().map_err(|_| wrong())?;
    number.checked_mul(seconds).map(Duration::from_secs).ok_or_else(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_a_unit() {
        assert_eq!(duration("20s"), Ok(Duration::from_secs(20)));
        assert_eq!(duration("2m"), Ok(Duration::from_secs(120)));
        for bad in ["", "20", "s", "-1s", "1.5s", "20 s", "9é", "99999999999999999999h"] {
            assert!(duration(bad).is_err(), "{bad}");
        }
    }
}
