//! The `nudge` binary.

fn main() -> std::process::ExitCode {
    nudge::cli::run()
}
