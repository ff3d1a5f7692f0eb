//! What a crate brings along for whoever links it alone, with the features it asks for.

use std::collections::BTreeSet;
use std::process::Command;

/// Returns the packages that a crate of the workspace is built with, by Cargo's own resolution.
fn dependencies(package: &str) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--offline", "--locked", "--package", package])
        .args(["--edges", "normal", "--prefix", "none", "--format", "{lib}"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo tree fails: {told}");

    let names = String::from_utf8_lossy(&output.stdout);
    names
        .lines()
        .filter_map(|line| line.split_whitespace().next())
        .map(str::to_owned)
        .collect()
}

/// Returns which of these packages a crate brings along.
fn strangers<'a>(package: &str, unwanted: &[&'a str]) -> Vec<&'a str> {
    let packages = dependencies(package);
    let found = unwanted.iter().filter(|name| packages.contains(**name));
    found.copied().collect()
}

/// What only a service needs, by the names in code.
const SERVICE: [&str; 12] = [
    "nudge",
    "nudge_worlds",
    "axum",
    "axum_core",
    "candle_core",
    "clap",
    "libsqlite3_sys",
    "ndarray",
    "plotters",
    "rayon",
    "sqlx",
    "sqlx_core",
];

#[test]
fn a_game_server_links_no_server() {
    let packages = dependencies("nudge-client");
    for needed in ["nudge_core", "nudge_wire", "tonic", "rustls"] {
        assert!(
            packages.contains(needed),
            "{needed} is not seen: {packages:?}"
        );
    }
    assert_eq!(strangers("nudge-client", &SERVICE), Vec::<&str>::new());
    let rest = ["serde", "serde_json", "utoipa", "prost_build", "protox"];
    assert_eq!(strangers("nudge-client", &rest), Vec::<&str>::new());
}

#[test]
fn the_core_has_no_runtime_and_the_wire_no_connection() {
    let runtime = ["tokio", "hyper", "tonic"];
    assert_eq!(strangers("nudge-core", &SERVICE), Vec::<&str>::new());
    assert_eq!(strangers("nudge-core", &runtime), Vec::<&str>::new());
    assert_eq!(strangers("nudge-wire", &SERVICE), Vec::<&str>::new());
    assert_eq!(strangers("nudge-wire", &["hyper"]), Vec::<&str>::new());
}

#[test]
fn strangers_are_seen() {
    assert_eq!(strangers("nudge", &SERVICE[2..4]), ["axum", "axum_core"]);
}
