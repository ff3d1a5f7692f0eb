//! How far a long command is: a bar on a terminal, plain lines in a pipe. Both on standard error.

use std::io::{IsTerminal, Write};

use indicatif::{ProgressBar, ProgressStyle};

use super::output::count;

/// A bar, or nothing until a part is done.
pub(super) struct Progress {
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Begins with that many steps to do.
    pub(super) fn new(steps: u64) -> Self {
        Self { bar: std::io::stderr().is_terminal().then(|| bar(steps)) }
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

    /// Notes that a part is done.
    pub(super) fn part_done(&self, name: &str, steps: u64) {
        if self.bar.is_none() {
            let _ = writeln!(std::io::stderr(), "{name}: {} transitions", count(steps));
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
    const TEMPLATE: &str = "{msg:32} {bar:40} {human_pos}/{human_len}  {per_sec}  {eta}";
    let style = ProgressStyle::with_template(TEMPLATE).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(steps).with_style(style)
}
