//! `nudge key`: keys to be let in with, and the file of those that a service lets in.

use std::convert::Infallible;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use tokio::signal::unix::{Signal, SignalKind};
use tokio::sync::Mutex;

use super::signals::take;
use super::{Failure, output};
use crate::access::{Keys, Line, Rate, generate, read_text};
use crate::domain::{KeyScope, Name, Pattern};
use crate::serve::access::Keyring;

/// Make keys to be let in with
#[derive(Debug, Subcommand)]
#[command(long_about = "Make keys to be let in with.\n\n\
    Example:\n  nudge key new game-server --scope ingest --append keys.txt")]
pub(super) enum Command {
    New(New),
}

/// Make a key, and print it once
#[derive(Debug, Args)]
#[command(long_about = "Make a key, and print it once.\n\n\
    The key goes to standard output, alone on its line, so that it can be piped to where secrets are kept. The line for the keys file has the key's \
    digest only: with --append it is added to the file, else it goes to standard error. The service reads the file again on SIGHUP.\n\n\
    To replace a key, make another of the same name, let clients take it, and then take the old line out: producers belong to the name.\n\n\
    Examples:\n  nudge key new game-server --scope ingest --environments 'hallway*' --append keys.txt\n  \
    nudge key new dashboard --scope read --rate 600/m --append keys.txt | vault kv put secret/nudge key=-")]
pub(super) struct New {
    /// Whose key it is; producers belong to this name
    name: Name,
    /// What it is for: read, ingest, train, admin; repeat it, or separate several by commas. None
    /// implies another
    #[arg(
        long = "scope",
        value_name = "SCOPE",
        value_delimiter = ',',
        required = true
    )]
    scopes: Vec<KeyScope>,
    /// The environments that it is for, such as 'hallway*'; repeat it, or separate several by
    /// commas. All by default
    #[arg(long, value_name = "PATTERN", value_delimiter = ',')]
    environments: Vec<Pattern>,
    /// How often it may ask, such as 50/s, 600/m or 1000/h; as often as it likes by default
    #[arg(long, value_name = "RATE")]
    rate: Option<Rate>,
    /// The keys file to add the line to, made for its owner alone (0600) if it is missing
    #[arg(long, value_name = "FILE")]
    append: Option<PathBuf>,
}

impl Command {
    /// Does what is asked.
    pub(super) fn run(self) -> Result<(), Failure> {
        match self {
            Self::New(command) => command.run(),
        }
    }
}

impl New {
    fn run(self) -> Result<(), Failure> {
        let key = generate().map_err(Failure::usage)?;
        let line = Line {
            name: self.name,
            digest: key.digest(),
            scopes: self.scopes.into_iter().collect(),
            environments: Some(self.environments).filter(|patterns| !patterns.is_empty()),
            rate: self.rate,
        };

        match &self.append {
            // First the line: a key that nobody lets in is of no use to whoever has it.
            Some(path) => append(path, &line)?,
            // Where standard error is closed nobody wants the line.
            None => drop(writeln!(
                std::io::stderr(),
                "the line for the keys file:\n{line}\nthe key, which is not shown again:"
            )),
        }
        output::print(key.reveal())
    }
}

/// Adds a line to a file that says nothing wrong, in one write.
fn append(path: &Path, line: &Line) -> Result<(), Failure> {
    use std::os::unix::fs::OpenOptionsExt;

    let failed = |error: std::io::Error| {
        Failure::usage(format!("cannot add to {}: {error}", path.display()))
    };
    let unread = |why: String| {
        Failure::usage(format!(
            "cannot read the keys file {}: {why}",
            path.display()
        ))
    };
    // A link that leads nowhere is no missing file.
    let is_missing = path
        .symlink_metadata()
        .is_err_and(|error| error.kind() == std::io::ErrorKind::NotFound);
    let text = if is_missing {
        String::new()
    } else {
        read_text(path).map_err(unread)?
    };
    Keys::parse_whole(&text)
        .map_err(|faults| Failure::usage(format!("{}: {}", path.display(), faults.join("\n"))))?;
    let mut file = std::fs::OpenOptions::new()
        .append(true)
        .create(true)
        .mode(0o600)
        .open(path)
        .map_err(failed)?;
    file.write_all(format!("{line}\n").as_bytes())
        .and_then(|()| file.sync_all())
        .map_err(failed)
}

/// The keys that a service lets in, and the signal to read them again.
pub(super) struct KeysFile {
    /// The keys as they are now; `None` where everybody is let in.
    pub(super) ring: Option<Keyring>,
    /// Where they are read from; `None` where there is no file.
    path: Option<PathBuf>,
    hangups: Mutex<Signal>,
}

impl KeysFile {
    /// Takes SIGHUP over, and reads the file, if there is one.
    pub(super) fn read_and_watch(path: Option<&Path>) -> Result<Self, Failure> {
        // Before the file is read: a change after that comes with a signal that is not lost.
        let hangups = take(SignalKind::hangup())?;
        let ring = match path {
            None => None,
            Some(path) => {
                let keys = Keys::read_file(path).map_err(Failure::usage)?;
                tell(path, &keys, "keys were read");
                Some(Keyring::new(keys))
            }
        };

        Ok(Self {
            ring,
            path: path.map(Path::to_owned),
            hangups: hangups.into(),
        })
    }

    /// Reads the file again whenever SIGHUP comes, for ever. One that is wrong leaves the keys as
    /// they are; where there is none, the signal ends nothing.
    pub(super) async fn follow(&self) -> Infallible {
        loop {
            if self.hangups.lock().await.recv().await.is_none() {
                std::future::pending::<()>().await;
            }
            let (Some(ring), Some(path)) = (&self.ring, &self.path) else {
                tracing::info!("SIGHUP: there is no file of keys to read again");
                continue;
            };
            match Keys::read_file(path) {
                Ok(keys) => {
                    tell(path, &keys, "keys were read again");
                    ring.replace(keys);
                }
                Err(error) => {
                    tracing::error!(%error, "keys were not read again: those from before stay")
                }
            }
        }
    }
}

fn tell(path: &Path, keys: &Keys, what: &str) {
    use std::os::unix::fs::PermissionsExt;

    /// Writing for a group or for others, and reading for others.
    const OPEN: u32 = 0o026;
    let mode = path
        .metadata()
        .map_or(0, |about| about.permissions().mode() & 0o777);
    if mode & OPEN != 0 {
        let mode = format!("{mode:03o}");
        tracing::warn!(file = %path.display(), mode, "others may read or write the keys file, expected its owner alone (600)");
    }
    match keys.is_empty() {
        true => {
            tracing::warn!(file = %path.display(), "{what}, and there is none: nobody is let in")
        }
        false => tracing::info!(file = %path.display(), keys = keys.len(), "{what}"),
    }
}
