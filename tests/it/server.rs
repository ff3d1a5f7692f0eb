//! The service as a process of its own, which can be killed.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// The real binary on a database.
pub struct Server {
    child: Child,
    pub address: SocketAddr,
}

impl Server {
    /// Starts it and returns once it says where it listens.
    pub fn start(data: &Path, listen: &str) -> Self {
        Self::run(&mut Self::command(data, listen))
            .unwrap_or_else(|status| panic!("it ended with {status}"))
    }

    /// Returns what starts it, for those who have something to add.
    pub fn command(data: &Path, listen: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_nudge"));
        command
            .args(["serve", "--listen", listen, "--data"])
            .arg(data)
            .stdout(Stdio::piped())
            .stderr(Stdio::null());
        command
    }

    /// Returns what starts one that folds its journal after every few commits.
    pub fn folding(data: &Path, listen: &str) -> Command {
        let mut command = Self::command(data, listen);
        command.env("NUDGE_FOLD_CELLS", "500");
        command
    }

    /// Starts it and returns once it says where it listens, or how it ended before.
    pub fn run(command: &mut Command) -> Result<Self, ExitStatus> {
        let mut child = command.spawn().expect("the binary starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("piped"))
            .read_line(&mut line)
            .expect("a line");
        if line.is_empty() {
            return Err(child.wait().expect("its output ended, and so does it"));
        }
        let address = line
            .trim()
            .rsplit("://")
            .next()
            .and_then(|address| address.parse().ok());
        Ok(Self {
            child,
            address: address.unwrap_or_else(|| panic!("no address in {line:?}")),
        })
    }

    /// Returns the number of its process.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Asks it to stop, as an operator does.
    pub fn ask_to_stop(&self) {
        self.signal("TERM");
    }

    /// Sends it a signal: `TERM`, `INT`, `HUP`.
    pub fn signal(&self, name: &str) {
        let sent = Command::new("kill")
            .args([&format!("-{name}"), &self.pid().to_string()])
            .status();
        assert!(sent.expect("kill is there").success());
    }

    /// Waits for its end, and returns how it ended, or nothing where it goes on.
    pub async fn ended_within(&mut self, limit: Duration) -> Option<ExitStatus> {
        let late = Instant::now() + limit;
        loop {
            match self.child.try_wait().expect("a child of ours") {
                None if Instant::now() < late => tokio::time::sleep(Duration::from_millis(5)).await,
                ended => return ended,
            }
        }
    }

    /// Waits until it has ended, and returns how.
    pub fn ended(&mut self) -> ExitStatus {
        self.child.wait().expect("it was started")
    }

    /// Ends it as kill -9 does.
    pub fn kill(mut self) {
        self.child.kill().expect("running");
        self.child.wait().expect("killed");
    }

    /// Tells it to stop, and returns the code that it ends with.
    pub fn terminate(mut self) -> Option<i32> {
        self.ask_to_stop();
        self.child.wait().expect("it ends").code()
    }
}

/// A test that fails leaves no service behind, which would keep whatever it inherited: files,
/// locks, the port.
impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
