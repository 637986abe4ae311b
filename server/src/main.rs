//! `ldi-server`. Everything is in the library.

fn main() -> std::process::ExitCode {
    ldi_server::cli::main()
}
