//! `nudge demo`: the service with real human games, a planted follower and a simulated hallway in
//! it, what it found, and what to try.

mod found;
mod live;
mod names;
mod planted;
mod pooled;

use std::cell::RefCell;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use self::found::{Best, Found};
use self::live::Live;
use self::names::{OWN, TWIN};
use super::Failure;
use super::addresses::{address, reachable};
use super::config::{Config, database};
use super::duration::{Period, duration};
use super::ingest::{self, Part};
use super::lags::Lags;
use super::output::{count, print};
use super::progress::Progress;
use super::report::Report;
use super::serve::Service;
use super::signals::Signals;
use super::simulate::{Pace, Run};
use crate::api::proto;
use crate::app::App;
use crate::client::Connection;
use crate::error::Problem;
use crate::recordings::overcooked::{self, Abstraction};
use crate::simulation::hallway::{Hallway, Protocol};
use crate::telemetry;

/// The environment of the simulated hallway.
const HALLWAY: &str = "demo.hallway";

/// The layout of which a twin is shown too: one player must wait for the other there.
const WAITING: &str = "demo.forced_coordination";

/// Trials of the simulated hallway: enough that something is established in it.
const TRIALS: u32 = 300;

/// The demo lasts seconds, so priors are fitted more eagerly than usual.
const FIT_EVERY: Duration = Duration::from_secs(1);

/// Try it: the service, real human games, a planted follower, a simulated hallway, and what they
/// show
#[derive(Debug, Args)]
#[command(
    long_about = "Start a service on a database of its own, send real human games of Overcooked, a planted follower and a simulated \
    hallway into it over gRPC, show what it counts and finds meanwhile, say what was found, and keep serving until Ctrl-C.\n\n\
    The games come with the program, and what is simulated has a seed. A second run finds all of them counted and changes nothing.\n\n\
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
    /// Let in everybody who reaches an address that is not this machine's own
    #[arg(long, env = "NUDGE_INSECURE", value_parser = clap::builder::BoolishValueParser::new())]
    insecure: bool,
    /// Start over: forget what was counted before
    #[arg(long)]
    fresh: bool,
}

impl Demo {
    /// Serves, plays and tells, until a signal or the end of the time.
    pub(super) async fn run(self) -> Result<(), Failure> {
        telemetry::log(telemetry::LogFormat::Human);
        let signals = Signals::install()?;
        let (listen, data, insecure) = (self.listen, self.data.clone(), self.insecure);
        let config = Config {
            listen,
            data,
            insecure,
            fit_every: Period(FIT_EVERY),
            ..Config::default()
        };
        let Some(service) = Service::start(&config, None, &signals).await? else {
            return Ok(());
        };

        let address = reachable(service.address);
        print(&format!(
            "listening on http://{address}, counting in {}",
            database(&config.data).display()
        ))?;
        if !self.fresh {
            print(&counted_before(&service.running.app).await)?;
        }

        let shown = tokio::select! {
            shown = self.show(address) => shown,
            () = signals.next() => Ok(()),
        };
        let stopped = service.stop_unless(&signals).await;
        shown.and(stopped)
    }

    async fn show(&self, address: SocketAddr) -> Result<(), Failure> {
        let ended = tokio::time::sleep(self.duration.unwrap_or(Duration::MAX));
        let so_far = RefCell::new(SoFar::default());
        let shown = async {
            let connection = Connection::open(&address.to_string()).await?;
            let played = self.play(&connection).await?;

            so_far.borrow_mut().stage = Stage::Looking(played.alone.clone());
            pooled::tell(&connection, &played.all()).await?;
            for environment in &played.alone {
                let seen = found::look(&connection, environment).await?;
                so_far.borrow_mut().saw(seen, environment);
            }

            let best = so_far.borrow_mut().tell()?;
            so_far.borrow_mut().stage = Stage::Training;
            print(&to_try(address, &best))?;
            found::train(&connection, HALLWAY).await?;
            so_far.borrow_mut().stage = Stage::Told;
            std::future::pending().await
        };

        tokio::select! {
            shown = shown => shown,
            () = ended => self.end(&so_far.borrow()),
        }
    }

    /// Ends the show where `--duration` says so: tells what was found so far, and what was not told
    /// for want of time.
    fn end(&self, so_far: &SoFar) -> Result<(), Failure> {
        let Some((doing, missing)) = so_far.stage.unfinished() else {
            return Ok(());
        };
        if !matches!(so_far.stage, Stage::Training) {
            so_far.found.tell()?;
        }
        print(&format!(
            "\nended by --duration while {doing}: it was about to show {missing}. Give it longer; what is counted stays in {}",
            self.data.display()
        ))
    }

    /// Sends the games, the follower and the hallway side by side, as far as they are not counted
    /// yet, and returns the names of their environments.
    async fn play(&self, connection: &Connection) -> Result<Played, Failure> {
        // Reading them takes a second or two, which `--duration` and signals do not wait for.
        let parts = tokio::task::spawn_blocking(games)
            .await
            .map_err(Failure::usage)??;
        let names = Played::of_parts(&parts);
        if self.fresh {
            forget(connection, &names.all()).await?;
        }

        let hallway = Hallway::try_from(Protocol {
            trials: TRIALS,
            ..Protocol::default()
        });
        let hallway = hallway.map_err(|faults| Problem::invalid("hallway", faults))?;
        let run = Run {
            hallway,
            environment: HALLWAY.into(),
            lags: Lags::none(),
            pace: Pace::Fast,
        };

        let silent = Progress::silent();
        let mut live = Live::begin(connection, names.alone.clone()).await?;
        let sending = async {
            tokio::try_join!(
                Report::send_parts(&parts, connection, &silent),
                run.send(connection, |_| ()),
                planted::send(connection, None),
                planted::send(connection, Some(TWIN)),
            )
        };
        let sent = tokio::select! {
            sent = sending => sent?,
            stopped = live.run() => match stopped? {},
        };
        live.finish();

        let (mut report, hallway, follower, twin) = sent;
        report.add(HALLWAY.into(), hallway);
        for (name, totals) in [follower, twin] {
            report.add(name, totals);
        }
        print(&format!(
            "\nhuman games of Overcooked, and simulations: each transition counted once\n\n{}",
            report.table()
        ))?;
        Ok(names)
    }
}

/// The names of the environments that were played into.
struct Played {
    /// Those whose states are looked at each alone too, in order.
    alone: Vec<String>,
    /// Those whose truth is known: what is planted, and twins.
    known: Vec<String>,
}

impl Played {
    fn of_parts(parts: &[Part]) -> Self {
        let names = parts.iter().map(Part::environment_name);
        let twin = format!("{WAITING}.{TWIN}");
        let mut alone: Vec<String> = names.filter(|name| *name != twin).collect();
        alone.push(HALLWAY.into());
        alone.sort();
        alone.dedup();
        let known = vec![
            twin,
            planted::environment_name(None),
            planted::environment_name(Some(TWIN)),
        ];
        Self { alone, known }
    }

    fn all(&self) -> Vec<String> {
        // A twin comes right after what it is a twin of.
        let mut all = [&self.alone[..], &self.known].concat();
        all.sort();
        all
    }
}

/// How far the show is.
#[derive(Default)]
struct SoFar {
    stage: Stage,
    found: Found,
}

/// What is being done for what is shown next.
#[derive(Default)]
enum Stage {
    /// Games are read and sent.
    #[default]
    Counting,
    /// Every state is looked at, of these environments.
    Looking(Vec<String>),
    /// A network is trained; what was found is told already.
    Training,
    /// Everything was told.
    Told,
}

impl Stage {
    /// Returns what is being done, and what was to be shown after it; nothing where all is told.
    fn unfinished(&self) -> Option<(&'static str, String)> {
        match self {
            Self::Counting => Some((
                "sending games",
                "what was counted, and where two agents depend on each other".to_owned(),
            )),
            Self::Looking(left) => Some((
                "looking at every state",
                format!(
                    "where two agents depend on each other in {}",
                    left.join(", ")
                ),
            )),
            Self::Training => Some((
                "training a network",
                format!("how a network of {HALLWAY} does where counts do not decide"),
            )),
            Self::Told => None,
        }
    }
}

impl SoFar {
    fn saw(&mut self, seen: found::Seen, environment: &str) {
        self.found.add(seen);
        if let Stage::Looking(left) = &mut self.stage {
            left.retain(|other| other != environment);
        }
    }

    fn tell(&mut self) -> Result<Best, Failure> {
        self.stage = Stage::Told;
        self.found.tell()?;
        Ok(std::mem::take(&mut self.found.best))
    }
}

/// Returns what was counted in an earlier run, from the totals that are kept: looking at every
/// state takes longer than some demos last.
async fn counted_before(app: &App) -> String {
    let mut told = String::new();
    for environment in app.store.environments() {
        // One that cannot be read is told by what follows.
        let Ok(totals) = app.store.totals(environment.id).await else {
            continue;
        };
        if totals.transitions > 0 {
            let [transitions, states] = [totals.transitions, totals.states].map(count);
            told += &format!(
                "{}: {transitions} transitions in {states} states, counted before\n",
                environment.name
            );
        }
    }
    match told.is_empty() {
        true => {
            "counting games and a hallway, and then looking at every state: that takes some seconds"
                .into()
        }
        false => told + "looking at every state of them: that takes some seconds",
    }
}

/// Returns the games that come with the program.
fn games() -> Result<Vec<Part>, Failure> {
    let mut parts = Vec::new();
    for (name, bytes) in overcooked::embedded() {
        let found = ingest::parts_of(name, bytes, Abstraction::default(), &Lags::default())?;
        parts.extend(found.into_iter().map(|part| part.under(Some(OWN))));
    }
    let waiting = parts
        .iter()
        .filter(|part| part.environment_name() == WAITING);
    let twins: Vec<Part> = waiting
        .cloned()
        .map(|part| part.with_twin(Some(TWIN)))
        .collect();
    parts.extend(twins);
    Ok(parts)
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

fn to_try(address: SocketAddr, best: &Best) -> String {
    let Best {
        environment, key, ..
    } = best;
    format!(
        "\nto try:\n  \
         curl -s 'http://{address}/v1/environments/{environment}/influence?key={key}'\n  \
         curl -s 'http://{address}/v1/environments/{environment}/summary?fdr=0.05'\n  \
         curl -s -H 'accept: text/vnd.graphviz' 'http://{address}/v1/environments/{environment}/graph?key={key}'\n  \
         nudge query {environment} --key {key} --server http://{address}\n  \
         nudge query {WAITING} --profile --both --svg profile.svg --server http://{address}\n  \
         buf curl --protocol grpc --http2-prior-knowledge -d '{{\"scope\":{{\"environment\":\"{environment}\"}},\"key\":\"{key}\"}}' \
         http://{address}/nudge.v1.InfluenceService/GetInfluence\n  \
         documentation: http://{address}/docs\n\nserving until Ctrl-C"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_in_the_middle_is_told_until_all_is_shown() {
        let looking = Stage::Looking(vec!["a".into(), "b".into()]);
        let (doing, missing) = looking.unfinished().expect("there is more");
        assert_eq!(
            (doing, missing.ends_with("in a, b")),
            ("looking at every state", true)
        );
        assert_eq!(
            Stage::Training.unfinished().expect("there is more").0,
            "training a network"
        );
        assert!(Stage::Counting.unfinished().is_some() && Stage::Told.unfinished().is_none());
    }
}
