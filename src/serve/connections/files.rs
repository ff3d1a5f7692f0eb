//! Open files: every connection is one, and the database must never find that there are none left.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Files that are not connections: the database, its journal and readers, what SQLite sorts in, the
/// log, the listener and the guests.
const KEPT: u64 = 96;

/// The fewest connections, however few files there are.
const LEAST: usize = 8;

/// Raises the limit on open files as far as it goes, and returns how many of so many connections it
/// leaves room for.
pub fn leave_room_for(connections: usize) -> usize {
    let files = raise();
    let room = room(files);
    if room < connections {
        tracing::warn!(
            files,
            connections = room,
            wanted = connections,
            "open files are limited (ulimit -n), and so are connections"
        );
    }
    connections.min(room)
}

fn room(files: u64) -> usize {
    usize::try_from(files.saturating_sub(KEPT))
        .unwrap_or(usize::MAX)
        .max(LEAST)
}

/// Raises the soft limit to the hard one, where that is allowed, and returns what is in force.
fn raise() -> u64 {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum {
        // A refusal leaves it as it was.
        let _ = setrlimit(
            Resource::Nofile,
            Rlimit {
                current: maximum,
                maximum,
            },
        );
    }
    getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_database_keeps_its_files() {
        assert_eq!([0, 64, 256, 1_024].map(room), [8, 8, 160, 928]);
        assert!(leave_room_for(1) == 1 && leave_room_for(usize::MAX) as u64 <= raise());
    }
}
