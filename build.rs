//! Tells the revision.

fn main() {
    revision();
}

/// Tells the compiler which revision this is, where whoever builds says so: there is no history in
/// a container's build.
fn revision() {
    println!("cargo:rerun-if-env-changed=NUDGE_REVISION");
    let version = std::env::var("CARGO_PKG_VERSION").unwrap_or_default();
    let told = std::env::var("NUDGE_REVISION").unwrap_or_default();
    let (revision, version) = match told.trim() {
        "" | "unknown" => ("unknown", version),
        told => (told, format!("{version} ({told})")),
    };
    println!("cargo:rustc-env=NUDGE_REVISION={revision}\ncargo:rustc-env=NUDGE_VERSION={version}");
}
