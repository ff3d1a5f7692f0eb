//! Compiles the protos of `proto/` without `protoc`; services only where they are asked for.

use std::path::PathBuf;

/// Where the protos are: beside the crates, for clients in other languages read them too.
const PROTOS: &str = "../../proto";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed={PROTOS}");
    let files = ["environment", "ingest", "influence", "model"]
        .map(|name| format!("nudge/v1/{name}.proto"));
    let mut compiler = protox::Compiler::new([PROTOS])?;
    compiler
        .include_imports(true)
        .include_source_info(true)
        .open_files(files)?;
    // The Open Inference Protocol, whose package is not ours.
    compiler.open_file("inference/grpc_service.proto")?;

    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(
        out.join("descriptors.bin"),
        compiler.encode_file_descriptor_set(),
    )?;

    let has_services = std::env::var_os("CARGO_FEATURE_GRPC").is_some();
    tonic_prost_build::configure()
        .build_client(has_services)
        .build_server(has_services)
        // Who connects, and over what, is not of the wire.
        .build_transport(false)
        // Columns keep their bytes in the buffer that they arrived in.
        .bytes(".nudge.v1.Columns")
        .bytes(".nudge.v1.Transition")
        .compile_fds(compiler.file_descriptor_set())?;
    Ok(())
}
