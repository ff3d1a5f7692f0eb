//! The house rules as a test: who may import whom, and who alone may use which crate.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Rooms by rank. A room may import any lower rank, never its own or a higher one.
const RANKS: &[&[&str]] = &[
    &["information", "error", "config", "telemetry", "tls"],
    &["domain", "work"],
    &["evidence", "store", "simulation", "recordings", "access", "api"],
    &["ingest", "client", "priors"],
    &["model"],
    &["environments", "influence"],
    &["app"],
    &["serve", "experiments"],
    &["cli"],
    &["main"],
];

/// Crates, and the only rooms that may name them.
const RESERVED: &[(&str, &[&str])] = &[
    ("sqlx", &["store"]),
    ("prost", &["api"]),
    ("tonic", &["api", "client", "serve", "cli"]),
    ("axum", &["serve"]),
    ("rustls", &["tls", "client", "serve"]),
    ("tokio_rustls", &["client", "serve"]),
    ("candle_core", &["model"]),
    ("candle_nn", &["model"]),
    ("ndarray", &["model"]),
    ("safetensors", &["model"]),
    ("clap", &["cli", "main"]),
    ("governor", &["access"]),
    ("csv", &["recordings", "experiments"]),
    ("plotters", &["simulation", "experiments"]),
    (
        "tokio",
        &[
            "work",
            "ingest",
            "store",
            "client",
            "priors",
            "model",
            "environments",
            "influence",
            "app",
            "serve",
            "cli",
            "main",
        ],
    ),
];

fn sources() -> BTreeMap<String, Vec<PathBuf>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut rooms: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    let mut waiting = vec![root.clone()];
    while let Some(directory) = waiting.pop() {
        for entry in fs::read_dir(directory).expect("src can be read") {
            let path = entry.expect("an entry can be read").path();
            if path.is_dir() {
                waiting.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let inside = path.strip_prefix(&root).expect("below src");
                let room = inside.components().next().expect("has a name").as_os_str().to_string_lossy();
                rooms.entry(room.trim_end_matches(".rs").to_owned()).or_default().push(path);
            }
        }
    }
    rooms.remove("lib");
    rooms
}

fn rank(room: &str) -> usize {
    RANKS.iter().position(|rooms| rooms.contains(&room)).unwrap_or_else(|| panic!("{room} has no rank: give it one"))
}

/// Returns the lines that are code: comments and what follows `//` are left out.
fn code(path: &Path) -> Vec<String> {
    let text = fs::read_to_string(path).expect("a source can be read");
    text.lines().map(|line| line.split("//").next().unwrap_or_default().to_owned()).collect()
}

/// Returns the words that follow `prefix` in a line, as in `crate::store::Store`.
fn named_after<'a>(line: &'a str, prefix: &str) -> Vec<&'a str> {
    let word = |rest: &'a str| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default();
    line.match_indices(prefix).map(|(at, found)| word(&line[at + found.len()..])).collect()
}

#[test]
fn imports_point_downwards() {
    let mut wrong = Vec::new();
    for (room, files) in sources() {
        for file in files {
            for line in code(&file) {
                for prefix in ["crate::", "nudge::"] {
                    let imported =
                        named_after(&line, prefix).into_iter().filter(|name| !name.is_empty() && *name != room);
                    let upwards = imported.filter(|name| RANKS.concat().contains(name) && rank(name) >= rank(&room));
                    wrong.extend(upwards.map(|name| format!("{}: {room} imports {name}", file.display())));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "imports that do not point downwards:\n{}", wrong.join("\n"));
}

#[test]
fn crates_stay_in_their_rooms() {
    let mut wrong = Vec::new();
    for (room, files) in sources() {
        for file in files {
            for line in code(&file) {
                for (name, rooms) in RESERVED {
                    let path = format!("{name}::");
                    let mut uses = line.match_indices(&path).map(|(at, _)| line[..at].chars().last());
                    let begins =
                        |before: Option<char>| before.is_none_or(|c| !c.is_alphanumeric() && c != '_' && c != ':');
                    if uses.any(begins) && !rooms.contains(&room.as_str()) {
                        wrong.push(format!("{}: {room} uses {name}", file.display()));
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "crates outside their rooms:\n{}", wrong.join("\n"));
}

#[test]
fn every_room_is_on_the_map() {
    let map = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs")).expect("lib.rs can be read");
    for room in sources().keys().filter(|room| *room != "main") {
        assert!(map.contains(&format!("pub mod {room};")), "{room} is not on the map");
    }
    assert!(!map.contains("pub use"), "the map re-exports nothing");
}

#[test]
fn every_file_says_what_it_is_for() {
    for file in sources().into_values().flatten() {
        let text = fs::read_to_string(&file).expect("a source can be read");
        assert!(text.starts_with("//!"), "{} does not open with //!", file.display());
    }
}
