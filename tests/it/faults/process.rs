//! What the operating system says of a process.

use std::fs;

/// The most memory that the service may take, whatever is done to it.
const MOST_MEMORY_MIB: u64 = 400;

/// Checks that a process never took more memory than a service may.
pub fn assert_memory_is_bounded(pid: u32) {
    let most = most_memory_mib(pid);
    assert!(
        most <= MOST_MEMORY_MIB,
        "{most} MiB at most, expected {MOST_MEMORY_MIB}"
    );
}

/// Returns the most memory that a process ever had, in MiB.
pub fn most_memory_mib(pid: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).expect("it runs");
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .expect("told");
    line.trim()
        .trim_end_matches(" kB")
        .parse::<u64>()
        .expect("a number")
        / 1_024
}

/// Checks that this process may open so many files, which the service inherits.
pub fn assert_may_open(files: u64) {
    let limits = fs::read_to_string("/proc/self/limits").expect("told");
    let line = limits
        .lines()
        .find(|line| line.starts_with("Max open files"))
        .expect("told");
    let soft = line
        .split_whitespace()
        .nth(3)
        .and_then(|soft| soft.parse().ok())
        .unwrap_or(u64::MAX);
    assert!(
        soft >= files,
        "`ulimit -n` is {soft}, expected {files} or more"
    );
}
