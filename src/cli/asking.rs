//! Retries of questions that commands ask: again by themselves while the service makes the answer
//! or is away, with a line that says so.

use std::io::{IsTerminal, Write};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use tonic::{Response, Status};

use super::Failure;
use crate::client::patiently_telling;

/// How often a line that waits on a terminal is drawn, so that its clock goes on.
const TICK: Duration = Duration::from_millis(200);

/// Asks until there is an answer, or it has taken too long. Only for what may be asked twice.
pub(super) async fn asked<T, F>(ask: impl FnMut() -> F) -> Result<T, Failure>
where
    F: Future<Output = Result<Response<T>, Status>>,
{
    let mut waiting = Waiting::default();
    let answer = patiently_telling(ask, |why| waiting.tell(why)).await;
    waiting.finish();
    Ok(answer?)
}

/// What is said meanwhile, on standard error: one line that is redrawn on a terminal, in a pipe a
/// line whenever there is something new.
#[derive(Default)]
struct Waiting {
    bar: Option<ProgressBar>,
    last: String,
}

impl Waiting {
    fn tell(&mut self, why: &str) {
        if self.last == why {
            return;
        }

        self.last = why.to_owned();
        let line = format!(
            "{}; asking again",
            why.trim_end_matches("; it goes on, ask again")
        );

        if std::io::stderr().is_terminal() {
            self.bar.get_or_insert_with(spinner).set_message(line);
        } else {
            // Where standard error is closed there is nobody left to tell.
            let _ = writeln!(std::io::stderr(), "{line}");
        }
    }

    fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

fn spinner() -> ProgressBar {
    let style = ProgressStyle::with_template("{spinner} {elapsed}  {wide_msg}");
    let bar = ProgressBar::new_spinner()
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
    bar.enable_steady_tick(TICK);
    bar
}
