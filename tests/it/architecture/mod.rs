//! The house rules as a test: who may import whom, who alone may use which crate, who does no I/O,
//! that the exactly-once rule knows no database, and that no files import each other in a circle.
//! `imports` reads who imports whom; `seen` tests the test, and `dependencies` reads what a crate
//! brings along.

mod dependencies;
mod imports;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use imports::{Source, Sources};

/// Rooms by rank. A room may import any lower rank, never its own or a higher one.
const RANKS: &[&[&str]] = &[
    &["special_functions"],
    &["information", "error", "telemetry"],
    &["domain", "work"],
    &["tracks"],
    &[
        "evidence",
        "store",
        "simulation",
        "recordings",
        "access",
        "api",
    ],
    &["ingest", "client", "tls", "priors"],
    &["model"],
    &["environments", "influence"],
    &["app"],
    &["serve"],
    &["experiments"],
    &["cli"],
    &["main"],
];

/// Crates, and the only rooms that may name them.
const RESERVED: &[(&str, &[&str])] = &[
    ("sqlx", &["store"]),
    ("sha2", &["store"]),
    ("prost", &["api"]),
    ("tonic", &["api", "client", "serve", "cli"]),
    ("axum", &["serve"]),
    ("ndarray", &["model"]),
    ("safetensors", &["model"]),
    ("rustls", &["client", "serve"]),
    ("tokio_rustls", &["client", "serve"]),
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

/// Rooms that are mathematics and words: they neither read nor write nor look at a clock.
const PURE: &[&str] = &[
    "special_functions",
    "information",
    "domain",
    "tracks",
    "evidence",
];

/// A part of a room that is a rule and nothing else, and all that it may name: a database carries it
/// out, and it knows of none.
const RULE: &str = "store::ledger";

/// What the rule may name, by the beginnings of paths. `Books` are asked, so `async_trait` is among
/// them.
const RULE_MAY_NAME: &[&[&str]] = &[
    &["crate", "domain"],
    &["crate", "store", "ledger"],
    &["crate", "store", "map"],
    &["std", "cmp"],
    &["std", "collections"],
    &["std", "iter"],
    &["std", "mem"],
    &["std", "sync", "Arc"],
    // Of threads only those that compute and have ended before what began them goes on.
    &["std", "thread", "Builder"],
    &["std", "thread", "scope"],
    &["async_trait"],
];

/// What the standard library has for that.
const IO: &[&[&str]] = &[
    &["std", "fs"],
    &["std", "io"],
    &["std", "net"],
    &["std", "env"],
    &["std", "process"],
    &["std", "thread"],
    &["std", "time", "Instant"],
    &["std", "time", "SystemTime"],
];

/// The folders of the service and of the crates that it is made of, with the room that a whole
/// crate is.
const ROOTS: [(&str, Option<&str>); 5] = [
    ("src", None),
    ("crates/nudge-core/src", None),
    ("crates/nudge-wire/src", Some("api")),
    ("crates/nudge-client/src", Some("client")),
    ("crates/nudge-worlds/src", None),
];

fn roots() -> Vec<(PathBuf, Option<&'static str>)> {
    let folder = |folder| Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    ROOTS.map(|(name, room)| (folder(name), room)).to_vec()
}

/// Reads all crates, once for all rules.
fn sources() -> &'static Sources {
    static SOURCES: LazyLock<Sources> = LazyLock::new(|| Sources::read_folders(&roots()));
    &SOURCES
}

fn rank(room: &str) -> usize {
    RANKS
        .iter()
        .position(|rooms| rooms.contains(&room))
        .unwrap_or_else(|| panic!("{room} has no rank: give it one"))
}

fn room(module: &str) -> &str {
    module.split("::").next().unwrap_or_default()
}

/// Returns what every file does that one in its room may not.
fn faults<'a>(
    sources: &'a Sources,
    fault: impl Fn(&str, &[String]) -> Option<String> + 'a,
) -> Vec<String> {
    let of_file = |(module, source): (String, &Source)| {
        let faults = source.paths().filter_map(|path| fault(room(&module), path));
        faults
            .map(|fault| format!("{module}: {fault}"))
            .collect::<Vec<_>>()
    };
    // The root is the map.
    sources
        .files()
        .filter(|(module, _)| !module.is_empty())
        .flat_map(of_file)
        .collect()
}

fn upwards(sources: &Sources) -> Vec<String> {
    faults(sources, |from, path| {
        let [first, to, ..] = path else { return None };
        let is_upwards = first == "crate"
            && to != from
            && RANKS.concat().contains(&to.as_str())
            && rank(to) >= rank(from);
        is_upwards.then(|| format!("{from} imports {}", path.join("::")))
    })
}

fn strangers(sources: &Sources) -> Vec<String> {
    faults(sources, |from, path| {
        let reserved = RESERVED
            .iter()
            .find(|(name, rooms)| path[0] == *name && !rooms.contains(&from));
        reserved.map(|_| format!("{from} uses {}", path.join("::")))
    })
}

fn impure(sources: &Sources) -> Vec<String> {
    faults(sources, |from, path| {
        let is_io = IO
            .iter()
            .any(|io| path.iter().zip(*io).filter(|(part, io)| part == io).count() == io.len());
        (PURE.contains(&from) && is_io).then(|| format!("{from} uses {}", path.join("::")))
    })
}

/// Returns what the rule names that it may not: of other crates, of the standard library and of the
/// house. Its tests may.
fn beyond_the_rule(sources: &Sources) -> Vec<String> {
    let is_rule = |module: &str| {
        let inside = module.strip_prefix(RULE);
        inside.is_some_and(|rest| {
            rest.is_empty() || (rest.starts_with("::") && !rest.starts_with("::tests"))
        })
    };
    let named = |(module, source): (String, &Source)| {
        let strange = source.paths().filter(|path| is_beyond_the_rule(path));
        strange
            .map(|path| format!("{module} uses {}", path.join("::")))
            .collect::<Vec<_>>()
    };
    let rule = sources.files().filter(|(module, _)| is_rule(module));
    rule.flat_map(named).collect()
}

/// Names from outside begin with a crate; all others are the file's own, or in its prelude.
fn is_beyond_the_rule(path: &[String]) -> bool {
    let is_outside = ["crate", "std", "core", "alloc"].contains(&path[0].as_str())
        || DEPENDENCIES.contains(&path[0]);
    let is_allowed = RULE_MAY_NAME.iter().any(|allowed| {
        let common = path
            .iter()
            .zip(*allowed)
            .filter(|(part, allowed)| part == allowed);
        common.count() == allowed.len()
    });
    is_outside && !is_allowed
}

/// The crates that the service depends on, as code names them.
static DEPENDENCIES: LazyLock<BTreeSet<String>> = LazyLock::new(|| {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
    let text = fs::read_to_string(manifest).expect("Cargo.toml can be read");
    let names = text
        .lines()
        .skip_while(|line| *line != "[dependencies]")
        .skip(1);
    names
        .take_while(|line| !line.starts_with('['))
        .filter_map(|line| Some(line.split_once('=')?.0.trim().replace('-', "_")))
        .collect()
});

#[test]
fn the_exactly_once_rule_is_pure() {
    let wrong = beyond_the_rule(sources());
    assert!(
        wrong.is_empty(),
        "the ledger is for every database, and does no I/O:\n{}",
        wrong.join("\n")
    );
    let is_there = |(module, _): (String, &Source)| module == "store::ledger::decide";
    assert!(sources().files().any(is_there), "the rule has moved");
}

#[test]
fn imports_point_downwards() {
    let wrong = upwards(sources());
    assert!(
        wrong.is_empty(),
        "imports that do not point downwards:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn crates_stay_in_their_rooms() {
    let wrong = strangers(sources());
    assert!(
        wrong.is_empty(),
        "crates outside their rooms:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn mathematics_and_words_do_no_io() {
    let wrong = impure(sources());
    assert!(
        wrong.is_empty(),
        "I/O where there is none:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn no_files_go_in_circles() {
    let circles: Vec<String> = sources()
        .circles()
        .into_iter()
        .map(|circle| circle.join(", "))
        .collect();
    assert!(
        circles.is_empty(),
        "files that import each other:\n{}",
        circles.join("\n")
    );
}

#[test]
fn every_room_is_on_the_map() {
    // The root's first; a crate that is a room shows what is its own.
    let maps = roots()
        .into_iter()
        .filter(|(_, room)| room.is_none())
        .map(|(root, _)| fs::read_to_string(root.join("lib.rs")).expect("lib.rs can be read"));
    let maps: Vec<String> = maps.collect();
    for (module, _) in sources().files() {
        let room = room(&module);
        if ["", "main"].contains(&room) {
            continue;
        }
        let is_declared = maps.iter().any(|map| map.contains(&format!("mod {room};")))
            || maps[0].contains(&format!(" as {room};"));
        assert!(is_declared, "{room} is in no crate");
        let is_on_a_map = maps.iter().any(|map| map.contains(&format!("`{room}`")));
        assert!(is_on_a_map, "{room} is not on the map");
    }
    let shown: Vec<&str> = maps
        .iter()
        .flat_map(|map| map.lines())
        .filter(|line| line.starts_with("pub use"))
        .collect();
    assert!(
        shown.iter().all(|line| line.starts_with("pub use nudge_")),
        "maps re-export rooms of crates only: {shown:?}"
    );
}

#[test]
fn every_file_says_what_it_is_for() {
    let mut waiting: Vec<PathBuf> = roots().into_iter().map(|(root, _)| root).collect();
    while let Some(path) = waiting.pop() {
        if path.is_dir() {
            let entries = fs::read_dir(path).expect("a folder can be read");
            waiting.extend(entries.map(|entry| entry.expect("an entry can be read").path()));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = fs::read_to_string(&path).expect("a source can be read");
            assert!(
                text.starts_with("//!"),
                "{} does not open with //!",
                path.display()
            );
        }
    }
}

/// Every way to write an import that breaks a rule is seen.
mod seen {
    use super::*;

    #[test]
    fn imports_that_point_upwards() {
        for text in [
            "use crate::serve::Doors;",
            "use crate::{error::Problem, serve::{Doors}};",
            "use crate::serve::{self};",
            "use crate::serve as attendance;",
            "use super::super::serve::*;",
            "fn f() -> crate::serve::Doors { todo!() }",
            "fn f() { vec![1, crate::serve::doors()]; }",
            "#[derive(crate::serve::Derive)] struct S;",
            "fn f() { use nudge::serve::doors; }",
            "pub use crate::serve::Doors;",
            "pub use crate::serve::{self as attendance};",
            "mod inside { use super::super::super::serve::Doors; }",
            "#[serde(with = \"crate::serve::form\")] struct S;",
        ] {
            assert_eq!(
                upwards(&Sources::of_modules(&[("store::sqlite", text)])).len(),
                1,
                "{text}"
            );
        }
        for allowed in [
            "use crate::domain::Name; use super::Store;",
            "use serve::Doors;",
            "mod inside { use super::super::serve::Doors; }",
            "pub(in crate::serve) struct S;",
            "#[cfg(test)] mod tests { use crate::serve::Doors; }",
            "//! Of crate::serve nothing is known: \n const S: &str = \"ask crate::serve::Doors\";",
        ] {
            assert_eq!(
                upwards(&Sources::of_modules(&[("store::sqlite", allowed)])),
                Vec::<String>::new(),
                "{allowed}"
            );
        }
    }

    #[test]
    fn imports_within_and_of_a_crate_that_is_a_room() {
        let upwards_of = |text: &str| upwards(&Sources::of_crate("api", &[("api::grpc", text)]));
        for text in [
            "use nudge_client::Connection;",
            "use crate::{proto, json}; use nudge_client as there;",
            "fn f() -> nudge::serve::Doors { todo!() }",
        ] {
            assert_eq!(upwards_of(text).len(), 1, "{text}");
        }
        for text in [
            "use crate::serve::Doors;",
            "use crate::{proto, json::Answer}; use nudge_core::domain::Name;",
            "use super::proto; mod inside { use crate::proto; }",
        ] {
            assert_eq!(upwards_of(text), Vec::<String>::new(), "{text}");
        }
    }

    #[test]
    fn crates_and_io_where_they_may_not_be() {
        for text in [
            "use sqlx::Row;",
            "use {sqlx as database};",
            "use ::sqlx;",
            "use sqlx::*;",
            "pub use sqlx::Row;",
            "extern crate sqlx as database;",
            "fn f(row: &sqlx::Row) {}",
            "fn f() { sqlx::query!(\"\"); }",
        ] {
            assert_eq!(
                strangers(&Sources::of_modules(&[("domain", text)])).len(),
                1,
                "{text}"
            );
            assert!(
                strangers(&Sources::of_modules(&[("store::sqlite", text)])).is_empty(),
                "{text}"
            );
        }
        for text in [
            "use std::{fmt, fs::File};",
            "use std::time::Instant;",
            "fn f() { std::env::var(\"A\"); }",
            "use std::io as i;",
            "use std::time::{self}; fn f() { time::Instant::now(); }",
            "use std::time as clock; fn f() { g!(clock::SystemTime::now()); }",
            "use std as all; fn f(file: all::fs::File) {}",
        ] {
            assert_eq!(
                impure(&Sources::of_modules(&[("evidence::prior", text)])).len(),
                1,
                "{text}"
            );
        }
        assert!(
            impure(&Sources::of_modules(&[(
                "evidence",
                "use std::time::Duration;"
            )]))
            .is_empty()
        );
    }

    #[test]
    fn what_the_exactly_once_rule_may_not_name() {
        for text in [
            "use sqlx::Row;",
            "use tokio::sync::Mutex;",
            "fn f() { tracing::warn!(\"\"); }",
            "use std::{cmp, fs};",
            "use std::time::Duration;",
            "use crate::store::sqlite::SqliteStore;",
            "use crate::store::{StoreError};",
            "use super::super::sqlite::text;",
            "use std::collections as c; fn f() { std::thread::sleep(d); }",
        ] {
            assert_eq!(
                beyond_the_rule(&Sources::of_modules(&[("store::ledger::quota", text)])).len(),
                1,
                "{text}"
            );
            for elsewhere in [
                "store::sqlite",
                "store::ledger::tests::laws",
                "store::ledgers",
            ] {
                let sources = Sources::of_modules(&[(elsewhere, text)]);
                assert!(beyond_the_rule(&sources).is_empty(), "{elsewhere}: {text}");
            }
        }
        for allowed in [
            "use crate::domain::{Name, Sequence}; use super::books::Books;",
            "use std::collections::BTreeMap; fn f(m: BTreeMap<u8, u8>) { Some(m); u64::from(1_u8); }",
            "use crate::store::map::Map; #[async_trait::async_trait] trait T {}",
        ] {
            let sources = Sources::of_modules(&[("store::ledger::quota", allowed)]);
            assert_eq!(beyond_the_rule(&sources), Vec::<String>::new(), "{allowed}");
        }
    }

    #[test]
    fn circles() {
        let circles = |texts: &[(&str, &str)]| {
            Sources::of_modules(texts)
                .circles()
                .into_iter()
                .collect::<Vec<_>>()
        };
        let two = [
            ("a::b", "use super::c::C;"),
            ("a::c", "fn f() { crate::a::b::g(); }"),
        ];
        assert_eq!(circles(&two), [["a::b", "a::c"]]);

        // Through what a parent re-exports, by another name even; and with the parent itself.
        let exported = [
            ("a", "mod b; mod c; pub use b::B as Other;"),
            ("a::b", "use super::c::C;"),
            ("a::c", "use super::Other;"),
        ];
        assert_eq!(circles(&exported), [["a::b", "a::c"]]);
        let parent = [
            ("a", "mod b; struct A; fn f() { b::g(); }"),
            ("a::b", "use super::A;"),
        ];
        assert_eq!(circles(&parent), [["a", "a::b"]]);

        // With a parent that uses what it re-exports; and with a neighbour that is re-exported, for
        // that one is no map.
        let used = [
            ("a", "mod b; pub use b::B; struct A(B);"),
            ("a::b", "use super::A;"),
        ];
        assert_eq!(circles(&used), [["a", "a::b"]]);
        let beside = [
            ("a::b", "pub use super::c::C; pub struct B;"),
            ("a::c", "use super::b::B; pub struct C;"),
        ];
        assert_eq!(circles(&beside), [["a::b", "a::c"]]);

        // By names that an import brings in.
        let by_name = [
            ("a", "mod b; mod c;"),
            ("a::b", "use crate::a; fn f() { a::c::g(); }"),
            ("a::c", "use super::b::f;"),
        ];
        assert_eq!(circles(&by_name), [["a::b", "a::c"]]);

        // Through a third; not where all point one way, nor where a parent shows what it does not
        // use.
        assert_eq!(
            circles(&[
                ("a", "use crate::b::B;"),
                ("b", "use crate::c::C;"),
                ("c", "use crate::a::A;")
            ]),
            [["a", "b", "c"]]
        );
        assert!(
            circles(&[
                ("a", "mod b; pub use b::B;"),
                ("a::b", "use super::c::C;"),
                ("a::c", "")
            ])
            .is_empty()
        );
        assert!(
            circles(&[
                ("a", "mod b; pub use b::B; pub struct A;"),
                ("a::b", "use super::A;")
            ])
            .is_empty()
        );
        assert!(
            circles(&[
                ("a", "mod b; fn f() { b::g(); }"),
                ("a::b", "pub(in crate::a) fn g() {}")
            ])
            .is_empty()
        );
    }
}
