//! File systems of a test's own: small enough to be full.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use tempfile::TempDir;

/// A file system in memory, gone with the test.
pub struct SmallDisk {
    mounted: TempDir,
}

impl SmallDisk {
    /// Mounts one of that size, such as `12m`; `None` where this user may not.
    pub fn mount(size: &str) -> Option<Self> {
        let mounted = tempfile::tempdir().expect("a directory");
        let size = format!("size={size}");
        let done = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &size, "tmpfs"])
            .arg(mounted.path())
            .output();
        let done = done.expect("mount is there");
        done.status.success().then_some(Self { mounted })
    }

    /// Makes a directory on it.
    pub fn directory(&self) -> Arc<TempDir> {
        Arc::new(TempDir::new_in(self.mounted.path()).expect("a directory"))
    }

    /// Takes all the room that is left, and returns the file that has it.
    pub fn fill(&self) -> PathBuf {
        let path = self.mounted.path().join("filler");
        let mut file = std::fs::File::options()
            .create(true)
            .append(true)
            .open(&path)
            .expect("made");
        for size in [1 << 16, 1 << 10, 1] {
            while file.write_all(&vec![0; size]).is_ok() {}
        }
        path
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // What still has a file open there keeps it until then.
        let _ = Command::new("umount")
            .args(["-l".as_ref(), self.mounted.path().as_os_str()])
            .status();
    }
}

/// Runs the test of that name again as the root of a namespace of its own, where it may mount.
pub fn run_as_root(test: &str) {
    assert!(
        std::env::var_os("NUDGE_TEST_AS_ROOT").is_none(),
        "no file system can be mounted here, not even in a namespace"
    );
    let this: &Path = &std::env::current_exe().expect("a test binary");
    let done = Command::new("unshare")
        .args(["--map-root-user", "--mount"])
        .arg(this)
        .args(["--exact", test, "--nocapture"])
        .env("NUDGE_TEST_AS_ROOT", "1")
        .status()
        .expect("unshare is there");
    assert!(done.success(), "{test} failed in a namespace of its own");
}
