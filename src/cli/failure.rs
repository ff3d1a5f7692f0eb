//! How a command fails: one line that says what to do, or a fault a line; never a backtrace.

use std::io::Write;
use std::process::ExitCode;

use crate::access::redacted;
use crate::client::{ClientError, Refusal};
use crate::error::{ErrorKind, Fault, Problem};

/// The exit code of a command that a signal ended, as shells have it for Ctrl-C.
const INTERRUPTED: u8 = 130;

/// Why a command stopped, and its exit code.
#[derive(Debug, PartialEq, Eq)]
pub struct Failure {
    code: u8,
    lines: Vec<String>,
}

impl Failure {
    /// Makes the failure of a command that cannot be done as it was given.
    pub fn usage(line: impl ToString) -> Self {
        Self {
            code: 2,
            lines: vec![line.to_string()],
        }
    }

    /// Makes the failure of a command that was understood and refused.
    pub fn refused(line: impl Into<String>) -> Self {
        Self {
            code: 1,
            lines: vec![line.into()],
        }
    }

    /// Makes the failure of a command that was understood and refused for several reasons, a line
    /// each.
    pub fn refused_for(lines: Vec<String>) -> Self {
        Self { code: 1, lines }
    }

    /// Makes the end of a command whose reader has gone, as `head` does: nothing is wrong and
    /// nobody listens.
    pub fn unheard() -> Self {
        Self {
            code: 0,
            lines: Vec::new(),
        }
    }

    /// Makes the end of a command that a signal ended: nothing is wrong, and the line says what
    /// became of what it waited for.
    pub fn interrupted(line: impl Into<String>) -> Self {
        Self {
            code: INTERRUPTED,
            lines: vec![line.into()],
        }
    }

    /// Prints the lines to standard error and returns the exit code. A secret that was given in the
    /// wrong place is not in them.
    pub fn report(self) -> ExitCode {
        let mut stderr = std::io::stderr().lock();
        for (i, line) in self.lines.iter().enumerate() {
            let lead = match (i, self.code) {
                (0, INTERRUPTED) => "",
                (0, _) => "error: ",
                _ => "  ",
            };
            // Where standard error is closed too there is nobody left to tell.
            let _ = writeln!(stderr, "{lead}{}", redacted(line));
        }
        ExitCode::from(self.code)
    }

    /// Tells every fault on its own line, below what the message says before it lists some of them.
    fn of_faults(code: u8, message: &str, faults: &[Fault]) -> Self {
        if faults.is_empty() {
            return Self {
                code,
                lines: vec![message.into()],
            };
        }

        let title = message.split_once(": ").map_or(message, |(title, _)| title);
        let faults = faults.iter().map(Fault::to_string);

        Self {
            code,
            lines: std::iter::once(title.to_owned()).chain(faults).collect(),
        }
    }
}

impl From<Problem> for Failure {
    /// Tells a problem that was found before anything was sent.
    fn from(problem: Problem) -> Self {
        Self::of_faults(2, &problem.message, &problem.faults)
    }
}

impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        match &error {
            ClientError::Refused(Refusal {
                kind: ErrorKind::Unauthenticated,
                message,
                ..
            }) => Self::refused(format!(
                "{message}: give a key by NUDGE_KEY or --api-key-file"
            )),
            ClientError::Refused(Refusal {
                message, faults, ..
            }) => Self::of_faults(1, message, faults),
            ClientError::Unreachable { .. } => Self::usage(format!(
                "{error}: start a service with `nudge serve`, or name another with --server"
            )),
            ClientError::NotNudge { .. } => {
                Self::usage(format!("{error}: name another address with --server"))
            }
            ClientError::Address { .. } => {
                Self::usage(format!("{error} (--server or NUDGE_SERVER)"))
            }
            ClientError::Invalid(_) | ClientError::Tls(_) | ClientError::Untrusted { .. } => {
                Self::usage(error.to_string())
            }
            ClientError::GaveUp { .. } => {
                Self::usage(format!("{error}; run the same command again to go on"))
            }
            ClientError::Disagreement(_) | ClientError::Stopped => Self::refused(error.to_string()),
        }
    }
}

impl From<tonic::Status> for Failure {
    fn from(status: tonic::Status) -> Self {
        ClientError::from(status).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_told_one_a_line() {
        let faults = (0..5)
            .map(|i| Fault::new(format!("/states/{i}/x"), "missing"))
            .collect();
        let failure = Failure::from(Problem::invalid("question", faults));
        assert_eq!(failure.lines.len(), 6);
        assert_eq!(
            failure.lines[..2],
            ["invalid question", "/states/0/x: missing"]
        );
    }
}
