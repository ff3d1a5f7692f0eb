//! Progress of a long command: a bar on a terminal, plain lines in a pipe. Both on standard error.

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
        Self {
            bar: std::io::stderr().is_terminal().then(|| bar(steps)),
        }
    }

    /// Begins something of which only a share is known to be done.
    pub(super) fn of_share() -> Self {
        Self {
            bar: std::io::stderr().is_terminal().then(share),
        }
    }

    /// Shows nothing, for those who tell in another way.
    pub(super) fn silent() -> Self {
        Self {
            bar: Some(ProgressBar::hidden()),
        }
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
    styled(steps, STEPS)
}

fn share() -> ProgressBar {
    styled(SHARES, SHARE)
}

/// Words have a line of their own, which is cut off where the terminal ends; the bar below it fits
/// into 60 columns with its figures.
const STEPS: &str = "{wide_msg}\n{bar:16} {human_pos}/{human_len}  {per_sec}  {eta}";
const SHARE: &str = "{wide_msg}\n{bar:32} {percent:>3} %  {elapsed}";

fn styled(steps: u64, template: &str) -> ProgressBar {
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(steps).with_style(style)
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::sync::{Arc, Mutex};

    use indicatif::{ProgressDrawTarget, TermLike};

    use super::*;

    /// A terminal of a width, and what was written on it.
    #[derive(Debug, Clone)]
    struct Terminal(u16, Arc<Mutex<String>>);

    impl TermLike for Terminal {
        fn width(&self) -> u16 {
            self.0
        }

        fn move_cursor_up(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn move_cursor_down(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn move_cursor_right(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn move_cursor_left(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn write_line(&self, text: &str) -> io::Result<()> {
            self.write_str(text).and_then(|()| self.write_str("\n"))
        }

        fn write_str(&self, text: &str) -> io::Result<()> {
            self.1.lock().expect("no panic").push_str(text);
            Ok(())
        }

        fn clear_line(&self) -> io::Result<()> {
            Ok(())
        }

        fn flush(&self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Returns what is drawn on a terminal of that width.
    fn drawn(bar: ProgressBar, width: u16, message: &str) -> String {
        let terminal = Terminal(width, Arc::default());
        bar.set_draw_target(ProgressDrawTarget::term_like(Box::new(terminal.clone())));
        bar.set_message(message.to_owned());
        bar.force_draw();
        let written = terminal.1.lock().expect("no panic").clone();
        bar.abandon();
        written
    }

    #[test]
    fn words_are_seen_on_every_terminal() {
        let waits = "2 ahead: waits for job-1796000000000 of `lane`, 24 % done";
        for width in [60, 80, 200] {
            let drawn = drawn(share(), width, waits);
            assert!(drawn.contains(waits), "{width}: {drawn}");
            assert!(drawn.contains("  0 %"), "{width}: {drawn}");
        }
        let part = "cramped_room: sending the games of 2019";
        for width in [60, 80, 200] {
            let drawn = drawn(bar(9_999_999), width, part);
            assert!(
                drawn.contains(part) && drawn.contains("0/9,999,999"),
                "{width}: {drawn}"
            );
        }
    }
}
