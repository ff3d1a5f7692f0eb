//! The configuration of a service. A field of [`Config`] is a flag, its environment variable, its
//! default, its line of `--print-config` and its row of the README's table (a test compares them).

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::{Args, Command, FromArgMatches, ValueEnum};
use serde::{Serialize, Serializer};
use serde_json::Value;

use super::Failure;
use super::addresses::{address, host, origin};
use super::duration::Period;
use crate::app::Upkeep;
use crate::serve::connections::files;
use crate::serve::connections::limits::Limits;
use crate::serve::tls::{Tls, TlsFiles};
use crate::store::{Options, Quotas};
use crate::telemetry::LogFormat;

/// How a service runs.
#[derive(Debug, Clone, PartialEq, Args, Serialize)]
pub struct Config {
    /// The address of every face. Port 0 takes a free one.
    #[arg(long, env = "NUDGE_LISTEN", value_name = "ADDR", value_parser = address, default_value = "127.0.0.1:8080")]
    pub(super) listen: SocketAddr,
    /// The directory of the database, made if it is missing; one service to a directory.
    #[arg(
        long,
        env = "NUDGE_DATA",
        value_name = "DIR",
        default_value = "nudge-data"
    )]
    #[serde(serialize_with = "as_text")]
    pub(super) data: PathBuf,
    /// The most cells (state, segment, joint action; and value, of each outcome) of an environment.
    #[arg(long, env = "NUDGE_MAX_CELLS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Quotas::default().cells)]
    pub(super) max_cells: u64,
    /// The most segments of an environment.
    #[arg(long, env = "NUDGE_MAX_SEGMENTS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Quotas::default().segments)]
    pub(super) max_segments: u64,
    /// The most producers of an environment.
    #[arg(long, env = "NUDGE_MAX_PRODUCERS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Quotas::default().producers)]
    pub(super) max_producers: u64,
    /// The most models (versions of networks) of an environment.
    #[arg(long, env = "NUDGE_MAX_MODELS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Quotas::default().models)]
    pub(super) max_models: u64,
    /// The most environments. Those that exist stay, also where there are more.
    #[arg(long, env = "NUDGE_MAX_ENVIRONMENTS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Quotas::default().environments)]
    pub(super) max_environments: u64,
    /// Cells kept in memory.
    #[arg(long, env = "NUDGE_CACHE_CELLS", value_name = "N", default_value_t = Options::default().cache_cells)]
    pub(super) cache_cells: usize,
    /// Cells that were counted and are in the journal alone, from which on it is folded into rows:
    /// more are folded faster each, and take memory (4 to 8 bytes) and time at a start.
    #[arg(long, env = "NUDGE_FOLD_CELLS", value_name = "N", value_parser = at_least_one::<usize>, default_value_t = Options::default().fold_from)]
    pub(super) fold_cells: usize,
    /// How often it is looked whether priors are to be fitted to the counts again, which is when a
    /// tenth more was counted, for pairs of agents that were asked about within the last hour; 0s
    /// for never.
    #[arg(
        long,
        env = "NUDGE_FIT_EVERY",
        value_name = "TIME",
        default_value = "5s"
    )]
    pub(super) fit_every: Period,
    /// How often it is looked whether networks are to be trained again, which is when half as much
    /// again was counted; 0s for never.
    #[arg(
        long,
        env = "NUDGE_TRAIN_EVERY",
        value_name = "TIME",
        default_value = "0s"
    )]
    pub(super) train_every: Period,
    /// The most connections, as far as the limit on open files (ulimit -n) leaves room; the idlest
    /// one makes room for a new one.
    #[arg(long, env = "NUDGE_MAX_CONNECTIONS", value_name = "N", value_parser = at_least_one::<usize>, default_value_t = Limits::default().connections)]
    pub(super) max_connections: usize,
    /// The age, give or take a tenth, at which a connection is asked to leave, so that clients
    /// spread over services anew; 0s for never.
    #[arg(long, env = "NUDGE_MAX_CONNECTION_AGE", value_name = "TIME", default_value_t = Period(Limits::default().age))]
    pub(super) max_connection_age: Period,
    /// The file of the keys that are let in (see `nudge key new`), read again on SIGHUP. Without
    /// one, everybody who reaches the service is let in.
    #[arg(long, env = "NUDGE_KEYS", value_name = "FILE")]
    #[serde(serialize_with = "as_text_if_given")]
    pub(super) keys: Option<PathBuf>,
    /// Let in everybody who reaches an address that is not this machine's own: only where something
    /// else keeps others away.
    #[arg(long, env = "NUDGE_INSECURE", value_parser = clap::builder::BoolishValueParser::new())]
    pub(super) insecure: bool,
    /// A name by which the service may be asked for without a key, beside loopback names and the
    /// address that it listens on, such as nudge.example.org or *.example.org; repeat it, or
    /// separate several by commas.
    #[arg(long, env = "NUDGE_HOSTS", value_name = "NAME", value_delimiter = ',', value_parser = host)]
    pub(super) hosts: Vec<String>,
    /// The certificate of the service in PEM, with those between it and its authority: every face
    /// speaks TLS (HTTP/1.1 and HTTP/2). It is read again when it changes.
    #[arg(long, env = "NUDGE_TLS_CERT", value_name = "FILE")]
    #[serde(serialize_with = "as_text_if_given")]
    pub(super) tls_cert: Option<PathBuf>,
    /// The private key of the certificate, in PEM and not encrypted.
    #[arg(long, env = "NUDGE_TLS_KEY", value_name = "FILE")]
    #[serde(serialize_with = "as_text_if_given")]
    pub(super) tls_key: Option<PathBuf>,
    /// The certificates of authorities, in PEM: every client needs a certificate of one of them
    /// (mutual TLS).
    #[arg(long, env = "NUDGE_TLS_CLIENT_CA", value_name = "FILE")]
    #[serde(serialize_with = "as_text_if_given")]
    pub(super) tls_client_ca: Option<PathBuf>,
    /// An origin whose pages may call, such as https://example.org; repeat it, or separate several
    /// by commas.
    #[arg(long, env = "NUDGE_CORS_ORIGINS", value_name = "ORIGIN", value_delimiter = ',', value_parser = origin)]
    pub(super) cors_origins: Vec<String>,
    /// How log lines look; RUST_LOG says how much is logged.
    #[arg(long, env = "NUDGE_LOG", value_enum, default_value_t = Log::Human)]
    pub(super) log: Log,
}

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Log {
    /// For people.
    Human,
    /// One JSON object a line.
    Json,
}

impl Log {
    /// Returns the format of log lines.
    pub(super) fn format(self) -> LogFormat {
        match self {
            Self::Human => LogFormat::Human,
            Self::Json => LogFormat::Json,
        }
    }
}

impl Default for Config {
    /// Returns what holds where neither flags nor variables say anything.
    fn default() -> Self {
        let nothing = flags()
            .mut_args(|flag| flag.env(None::<&str>))
            .get_matches_from(["nudge"]);
        Self::from_arg_matches(&nothing).expect("every flag has a default or may be absent")
    }
}

impl Config {
    /// Returns what the store may hold and keep in memory.
    pub(super) fn store(&self) -> Options {
        Options {
            quotas: Quotas {
                cells: self.max_cells,
                segments: self.max_segments,
                producers: self.max_producers,
                models: self.max_models,
                environments: self.max_environments,
            },
            cache_cells: self.cache_cells,
            fold_from: self.fold_cells,
            ..Options::default()
        }
    }

    /// Returns how often priors and networks are looked at.
    pub(super) fn upkeep(&self) -> Upkeep {
        Upkeep {
            fit_every: self.fit_every.0,
            train_every: self.train_every.0,
        }
    }

    /// Returns what connections may take, as far as open files leave room for them.
    pub(super) fn limits(&self) -> Limits {
        Limits {
            connections: files::leave_room_for(self.max_connections),
            age: self.max_connection_age.0,
            ..Limits::default()
        }
    }

    /// Reads the certificate and what belongs to it, where TLS is wanted.
    pub(super) fn tls(&self) -> Result<Option<Tls>, Failure> {
        let (given, missing) = match (&self.tls_cert, &self.tls_key, &self.tls_client_ca) {
            (None, None, None) => return Ok(None),
            (Some(certificate), Some(key), authorities) => {
                let files = TlsFiles {
                    certificate: certificate.clone(),
                    key: key.clone(),
                    client_authorities: authorities.clone(),
                };
                return Tls::open(files).map(Some).map_err(Failure::usage);
            }
            (Some(_), None, _) => ("--tls-cert (NUDGE_TLS_CERT)", "--tls-key (NUDGE_TLS_KEY)"),
            (None, Some(_), _) => ("--tls-key (NUDGE_TLS_KEY)", "--tls-cert (NUDGE_TLS_CERT)"),
            (None, None, Some(_)) => (
                "--tls-client-ca (NUDGE_TLS_CLIENT_CA)",
                "--tls-cert and --tls-key",
            ),
        };
        Err(Failure::usage(format!(
            "{given} is given without {missing}: TLS needs a certificate and its private key"
        )))
    }

    /// Returns every setting as a line of TOML, in the order of the flags; those that are absent
    /// have none.
    pub(super) fn to_toml(&self) -> String {
        let fields = serde_json::to_value(self).expect("settings are texts, numbers and lists");
        flags()
            .get_arguments()
            .filter_map(|flag| {
                let (name, value) = (flag.get_id().as_str(), fields.get(flag.get_id().as_str())?);
                (!value.is_null()).then(|| format!("{name} = {}\n", literal(value)))
            })
            .collect()
    }
}

/// Returns the path of the database in its directory.
pub(super) fn database(data: &Path) -> PathBuf {
    data.join("nudge.db")
}

/// Returns a command that has every setting as a flag, and nothing else.
fn flags() -> Command {
    Config::augment_args(Command::new("nudge").disable_help_flag(true))
}

/// Returns a value as TOML writes it, which is as JSON does but for the space in lists and the
/// control character that JSON leaves as it is.
fn literal(value: &Value) -> String {
    match value {
        Value::Array(values) => {
            let values: Vec<String> = values.iter().map(literal).collect();
            format!("[{}]", values.join(", "))
        }
        other => other.to_string().replace('\u{7f}', "\\u007f"),
    }
}

/// Writes a path, of which what is no Unicode cannot be shown.
fn as_text<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

fn as_text_if_given<S: Serializer>(
    path: &Option<PathBuf>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    match path {
        Some(path) => as_text(path, serializer),
        None => serializer.serialize_none(),
    }
}

fn at_least_one<N: FromStr + Default + PartialOrd>(text: &str) -> Result<N, String> {
    text.parse()
        .ok()
        .filter(|number| *number > N::default())
        .ok_or_else(|| format!("got {text:?}, expected a whole number of at least 1"))
}

#[cfg(test)]
mod tests {
    use clap::Arg;

    use super::*;

    /// The README's section has this title.
    const SECTION: &str = "\n## Flags of `serve`\n\n";

    /// Returns the settings of flags, with no variable read.
    fn given(flags_given: &[&str]) -> Config {
        let matches = flags()
            .mut_args(|flag| flag.env(None::<&str>))
            .get_matches_from(["nudge"].iter().chain(flags_given));
        Config::from_arg_matches(&matches).expect("settings")
    }

    fn default(flag: &Arg) -> String {
        let values: Vec<String> = flag
            .get_default_values()
            .iter()
            .map(|value| value.to_string_lossy().into_owned())
            .collect();
        match values.as_slice() {
            [] => "none".to_owned(),
            values => format!("`{}`", values.join(",")),
        }
    }

    /// Returns the README's row of a flag.
    fn row(flag: &Arg) -> String {
        let long = flag.get_long().expect("every setting has a long flag");
        let variable = flag.get_env().expect("every setting has a variable");
        let help = flag.get_long_help().or(flag.get_help());
        let help = help.expect("every setting is explained").to_string();
        format!(
            "| `--{long}` | `{}` | {} | {} |\n",
            variable.to_string_lossy(),
            default(flag),
            help.trim_end_matches('.')
        )
    }

    #[test]
    fn every_setting_is_a_flag_and_the_variable_of_its_name() {
        for flag in flags().get_arguments() {
            let name = flag.get_id().as_str();
            assert_eq!(flag.get_long(), Some(name.replace('_', "-").as_str()));
            let variable = format!("NUDGE_{}", name.to_uppercase());
            assert_eq!(flag.get_env(), Some(variable.as_ref()), "{name}");
        }
    }

    #[test]
    fn the_readme_has_a_row_for_every_flag_with_its_default() {
        let mut flags = flags();
        flags.build();
        let rows: String = flags.get_arguments().map(row).collect();
        let table = format!(
            "| flag | environment variable | default | meaning |\n|---|---|---|---|\n{rows}"
        );

        let readme = include_str!("../../README.md");
        let (_, section) = readme.split_once(SECTION).expect("the section");
        let (found, _) = section.split_once("\n\n").expect("its end");
        assert_eq!(
            found,
            table.trim_end(),
            "README.md has another table; this is it:\n{table}"
        );
    }

    #[test]
    fn every_setting_is_printed_as_it_was_given() {
        let lines = [
            "listen = \"[::1]:0\"",
            "data = \"a \\\"b\\\"\"",
            "max_cells = 1",
            "max_segments = 2",
            "max_producers = 3",
            "max_models = 4",
            "max_environments = 18446744073709551615",
            "cache_cells = 0",
            "fold_cells = 9",
            "fit_every = \"90s\"",
            "train_every = \"2m\"",
            "max_connections = 7",
            "max_connection_age = \"0s\"",
            "keys = \"keys.txt\"",
            "insecure = true",
            "hosts = [\"a.example\", \"*.b.example\"]",
            "tls_cert = \"c.pem\"",
            "tls_key = \"k.pem\"",
            "tls_client_ca = \"ca.pem\"",
            "cors_origins = [\"https://a.example\"]",
            "log = \"json\"",
        ];
        let config = given(&[
            "--listen=[::1]:0",
            "--data=a \"b\"",
            "--max-cells=1",
            "--max-segments=2",
            "--max-producers=3",
            "--max-models=4",
            "--max-environments=18446744073709551615",
            "--cache-cells=0",
            "--fold-cells=9",
            "--fit-every=90s",
            "--train-every=120s",
            "--max-connections=7",
            "--max-connection-age=0s",
            "--keys=keys.txt",
            "--insecure",
            "--hosts=a.example,*.b.example",
            "--tls-cert=c.pem",
            "--tls-key=k.pem",
            "--tls-client-ca=ca.pem",
            "--cors-origins=https://a.example/",
            "--log=json",
        ]);
        assert_eq!(config.to_toml().lines().collect::<Vec<_>>(), lines);
        assert_eq!(
            lines.len(),
            flags().get_arguments().count(),
            "a setting is missing here"
        );
    }

    #[test]
    fn what_is_not_given_has_its_default_and_no_line_where_it_has_none() {
        assert_eq!(given(&[]), Config::default());
        let printed = Config::default().to_toml();
        for absent in ["keys", "tls_cert", "tls_key", "tls_client_ca"] {
            assert!(!printed.contains(absent), "{printed}");
        }
        assert!(
            printed.contains("max_connection_age = \"1h\"\n"),
            "{printed}"
        );
        assert!(printed.contains("hosts = []\n"), "{printed}");
    }

    #[test]
    fn control_characters_are_escaped() {
        let printed = given(&["--data=a\n\u{1}\u{7f}"]).to_toml();
        let line = r#"data = "a\n\u0001\u007f""#;
        assert!(printed.lines().any(|printed| printed == line), "{printed}");
    }

    #[test]
    fn defaults_are_those_of_the_rooms() {
        let (config, limits) = (Config::default(), Limits::default());
        assert_eq!(config.store().quotas, Quotas::default());
        assert_eq!(config.store().cache_cells, Options::default().cache_cells);
        assert_eq!(config.store().fold_from, Options::default().fold_from);
        assert_eq!(config.max_connections, limits.connections);
        assert_eq!(config.max_connection_age.0, limits.age);
    }
}
