//! The commands of `ldi-server`: from arguments to stages, from results to stdout, from errors to
//! exit codes.

mod allocator;
mod args;
mod commands;
mod datasets;
mod file_memory;
#[cfg(target_os = "linux")]
mod memory_watch;
mod outputs;
mod paths;
mod progress;
mod qr;
mod rooms;
mod shell;
mod tour;

pub use allocator::ExitingAllocator;
pub use args::size;

use clap::Parser as _;
use ldi_protocol::said::said;
use std::io::IsTerminal as _;
use std::process::ExitCode;

/// A command that failed.
#[derive(Debug)]
pub struct Failure {
    kind: Kind,
    error: anyhow::Error,
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    /// The arguments make no sense.
    Usage = 2,
    /// A retry may help.
    Retry = 1,
    /// It will fail again.
    Permanent = 42,
}

impl Failure {
    fn usage(error: impl Into<anyhow::Error>) -> Self {
        Self { kind: Kind::Usage, error: error.into() }
    }
    fn permanent(error: impl Into<anyhow::Error>) -> Self {
        Self { kind: Kind::Permanent, error: error.into() }
    }
    fn of(permanent: bool, error: impl Into<anyhow::Error>) -> Self {
        Self { kind: if permanent { Kind::Permanent } else { Kind::Retry }, error: error.into() }
    }
    /// Something of the option list that this version does not have.
    fn absent(what: &str) -> Self {
        Self::usage(anyhow::anyhow!("{what} is not there yet"))
    }
}

/// Packs stay open as long as their dataset: a large one has more than the usual limit allows.
fn raise_file_limit() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let limit = getrlimit(Resource::Nofile);
    // Without it an error says that there are too many open files.
    let _ = setrlimit(Resource::Nofile, Rlimit { current: limit.maximum, ..limit });
}

/// Runs the command line; returns the exit code.
pub fn main() -> ExitCode {
    let cli = args::Cli::parse();
    raise_file_limit();
    start_log(match &cli.command {
        args::Command::Serve(a) => a.log,
        _ => args::LogForm::Plain,
    });
    match commands::run(cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(f) => {
            eprintln!("ldi-server: {}", said(f.error.as_ref()));
            ExitCode::from(f.kind as u8)
        }
    }
}

/// Logs to standard error: warnings, and who comes and goes. What the reader of IFC warns of is in
/// the scene's notes.
fn start_log(form: args::LogForm) {
    const USUAL: &str = "warn,access=info,ifc_lite_geometry=error,ifc_lite_processing=error";
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| USUAL.into());
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    match form {
        args::LogForm::Plain => log.with_ansi(std::io::stderr().is_terminal()).init(),
        args::LogForm::Json => log.json().flatten_event(true).init(),
    }
}
