//! Compiles the protos of `proto/` without `protoc`, and tells the revision.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto");
    revision();
    let files = ["environment", "ingest", "influence", "model"]
        .map(|name| format!("nudge/v1/{name}.proto"));
    let mut compiler = protox::Compiler::new(["proto"])?;
    compiler
        .include_imports(true)
        .include_source_info(true)
        .open_files(files)?;
    // The Open Inference Protocol, whose package is not ours.
    compiler.open_file("inference/grpc_service.proto")?;
    let out = std::path::PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(
        out.join("descriptors.bin"),
        compiler.encode_file_descriptor_set(),
    )?;
    tonic_prost_build::configure().compile_fds(compiler.file_descriptor_set())?;
    Ok(())
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
