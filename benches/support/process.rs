//! What a process that is measured takes of its machine, by the `/proc` of Linux.

use std::process::Child;

/// Returns a number of a file of a process: the first after a name at the beginning of a line.
pub fn field(child: &Child, file: &str, name: &str) -> u64 {
    let text = read(child, file);
    let line = text.lines().find_map(|line| line.strip_prefix(name));
    let number = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
    number.expect("a number")
}

/// Returns the processor time that a process has taken, in seconds.
pub fn cpu_seconds(child: &Child) -> f64 {
    /// `USER_HZ`, which is the same on every machine.
    const TICKS: f64 = 100.0;
    let text = read(child, "stat");
    // The name of the program may have spaces; of what follows it, the 12th and the 13th.
    let after = text.rsplit(')').next().expect("a name in brackets");
    let ticks = after.split_whitespace().skip(11).take(2);
    ticks.map(|n| n.parse::<f64>().expect("ticks")).sum::<f64>() / TICKS
}

fn read(child: &Child, file: &str) -> String {
    std::fs::read_to_string(format!("/proc/{}/{file}", child.id())).expect("linux")
}
