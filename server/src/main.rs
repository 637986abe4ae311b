//! `ldi-server`. Everything is in the library.

#[global_allocator]
static ALLOCATOR: ldi_server::cli::ExitingAllocator = ldi_server::cli::ExitingAllocator;

fn main() -> std::process::ExitCode {
    ldi_server::cli::main()
}
