//! `ldi-client`: walks through a streamed dataset.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
