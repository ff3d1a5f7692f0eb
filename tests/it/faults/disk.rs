//! A disk that does as it is told: the shim, built once, and the words by which a test speaks to
//! it.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use tempfile::TempDir;

/// The classes of calls, which can be added up.
pub const WRITE: u64 = 1;
pub const SYNC: u64 = 2;
pub const TRUNCATE: u64 = 4;
pub const READ: u64 = 8;
pub const UNLINK: u64 = 16;
/// Every call that changes something.
pub const CHANGES: u64 = WRITE | SYNC | TRUNCATE | UNLINK;

pub const EIO: u64 = 5;
pub const ENOSPC: u64 = 28;
/// No error: the process dies, as by kill -9.
pub const DEATH: u64 = 0;

/// From then on.
pub const FOR_EVER: u64 = u64::MAX;

/// Where each word stands in the control file; `shim.rs` says what they mean.
#[derive(Clone, Copy)]
enum Word {
    Mask,
    Pass,
    Failures,
    Errno,
    Budget,
    Seen,
    Failed,
}

/// A directory for a database, on a disk that does as it is told.
pub struct Disk {
    data: TempDir,
    control: File,
    /// Holds the control file and the log.
    beside: TempDir,
}

impl Disk {
    /// Makes a directory for a new database.
    pub fn new() -> Self {
        let beside = TempDir::new().expect("a temporary directory");
        let control = File::options()
            .read(true)
            .write(true)
            .create_new(true)
            .open(beside.path().join("control"));
        let control = control.expect("a file");
        control.set_len(4_096).expect("room");
        Self {
            data: TempDir::new().expect("a temporary directory"),
            control,
            beside,
        }
    }

    /// Makes a directory with a copy of a database.
    pub fn holding(database: &Path) -> Self {
        let disk = Self::new();
        std::fs::copy(database, disk.path().join("nudge.db")).expect("copied");
        disk
    }

    /// Returns the directory.
    pub fn path(&self) -> &Path {
        self.data.path()
    }

    /// Returns a place for a file of the test's own, off this disk.
    pub fn beside(&self, name: &str) -> PathBuf {
        self.beside.path().join(name)
    }

    /// Returns where everything that reaches the disk is written down, if it is.
    pub fn log(&self) -> PathBuf {
        self.beside("log")
    }

    /// Puts the disk under a server that is about to be started.
    pub fn under<'a>(&self, server: &'a mut Command) -> &'a mut Command {
        let directory = self.path().canonicalize().expect("it is there");
        // Nobody writes but whom the test asks to.
        server
            .env("NUDGE_FIT_EVERY", "0s")
            .env("LD_PRELOAD", shim())
            .env("NUDGE_SHIM_DIRECTORY", directory)
            .env("NUDGE_SHIM_CONTROL", self.beside.path().join("control"))
    }

    /// The same, and writes down what reaches the disk.
    pub fn recording_under<'a>(&self, server: &'a mut Command) -> &'a mut Command {
        self.under(server).env("NUDGE_SHIM_LOG", self.log())
    }

    /// Counts the calls of these classes from now on, and fails none.
    pub fn count(&self, classes: u64) {
        self.fail(classes, u64::MAX, 0, EIO);
    }

    /// Lets so many calls of these classes pass, and then fails so many.
    pub fn fail(&self, classes: u64, pass: u64, failures: u64, errno: u64) {
        // Nothing is failed while the words change.
        self.set(Word::Mask, 0);
        for word in [Word::Seen, Word::Failed] {
            self.set(word, 0);
        }
        self.set(Word::Errno, errno);
        self.set(Word::Pass, pass);
        self.set(Word::Failures, failures);
        self.set(Word::Mask, classes);
    }

    /// Fails nothing any more.
    pub fn mend(&self) {
        self.set(Word::Mask, 0);
    }

    /// Lets the files grow by so many bytes, and no further.
    pub fn leave_room(&self, bytes: u64) {
        self.set(Word::Budget, self.used() + bytes);
    }

    /// Lets the files grow as they like.
    pub fn make_room(&self) {
        self.set(Word::Budget, 0);
    }

    /// Returns how many calls of the classes named there were.
    pub fn seen(&self) -> u64 {
        self.get(Word::Seen)
    }

    /// Returns how many calls were failed.
    pub fn failed(&self) -> u64 {
        self.get(Word::Failed)
    }

    fn used(&self) -> u64 {
        let files = std::fs::read_dir(self.path()).expect("a directory");
        files
            .map(|file| {
                file.and_then(|file| file.metadata())
                    .map_or(0, |found| found.len())
            })
            .sum()
    }

    fn set(&self, word: Word, value: u64) {
        self.control
            .write_all_at(&value.to_ne_bytes(), 8 * word as u64)
            .expect("written");
    }

    fn get(&self, word: Word) -> u64 {
        let mut bytes = [0; 8];
        self.control
            .read_exact_at(&mut bytes, 8 * word as u64)
            .expect("read");
        u64::from_ne_bytes(bytes)
    }
}

/// Builds the shim, once a run, with nothing but the Rust toolchain.
fn shim() -> &'static Path {
    static SHIM: LazyLock<PathBuf> = LazyLock::new(|| {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/faults/shim.rs");
        let library = Path::new(env!("CARGO_TARGET_TMPDIR")).join("libnudge_shim.so");
        let made = TempDir::new_in(env!("CARGO_TARGET_TMPDIR")).expect("a temporary directory");
        let fresh = made.path().join("libnudge_shim.so");
        let rustc = std::env::var_os("RUSTC").unwrap_or("rustc".into());
        let built = Command::new(rustc)
            .args([
                "--edition",
                "2024",
                "--crate-type",
                "cdylib",
                "-O",
                "-D",
                "warnings",
                "-o",
            ])
            .args([&fresh, &source])
            .output()
            .expect("rustc is there");
        assert!(
            built.status.success(),
            "{}",
            String::from_utf8_lossy(&built.stderr)
        );
        // Another run may load the older one at this moment: it is replaced, and not written over.
        std::fs::rename(fresh, &library).expect("one file system");
        library
    });
    &SHIM
}
