//! How far a long command is: a bar on a terminal, plain lines in a pipe. Both on standard error.

use std::io::{IsTerminal, Write};

use indicatif::{ProgressBar, ProgressStyle};

use super::output::count;

/// Steps of a bar that shows a share.
const SHARES: u64 = 1_000;

/// A bar, or nothing until a part is done.
pub(super) struct Progress {
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Begins with that many steps to do.
    pub(super) fn new(steps: u64) -> Self {
        Self { bar: std::io::stderr().is_terminal().then(|| bar(steps)) }
    }

    /// Begins something of which only a share is known to be done.
    pub(super) fn of_share() -> Self {
        Self { bar: std::io::stderr().is_terminal().then(share) }
    }

    /// Shows nothing, for those who tell in another way.
    pub(super) fn silent() -> Self {
        Self { bar: Some(ProgressBar::hidden()) }
    }

    /// Says what is being done.
    pub(super) fn part(&self, name: &str) {
        if let Some(bar) = &self.bar {
            bar.set_message(name.to_owned());
        }
    }

    /// Notes one step.
    pub(super) fn step(&self) {
        if let Some(bar) = &self.bar {
            bar.inc(1);
        }
    }

    /// Notes how many steps are done by now.
    pub(super) fn at(&self, steps: u64) {
        if let Some(bar) = &self.bar {
            bar.set_position(steps);
        }
    }

    /// Notes which share is done by now, 0 to 1.
    pub(super) fn at_share(&self, share: f64) {
        self.at((share * SHARES as f64) as u64);
    }

    /// Notes that a part is done.
    pub(super) fn part_done(&self, name: &str, steps: u64) {
        self.line(&format!("{name}: {} transitions", count(steps)));
    }

    /// Says a line, where there is no bar.
    pub(super) fn line(&self, line: &str) {
        if self.bar.is_none() {
            // Where standard error is closed there is nobody left to tell.
            let _ = writeln!(std::io::stderr(), "{line}");
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

fn bar(steps: u64) -> ProgressBar {
    styled(steps, "{msg:32} {bar:40} {human_pos}/{human_len}  {per_sec}  {eta}")
}

fn share() -> ProgressBar {
    // The message stands last, because it is cut off where the terminal ends.
    styled(SHARES, "{bar:40} {percent:>3} %  {elapsed}  {wide_msg}")
}

fn styled(steps: u64, template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(steps).with_style(style)
}
