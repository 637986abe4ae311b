//! `ldi-link`: runs a command behind a bad link, in a network namespace of its own.
//!
//! Exit codes: the command's; 2 wrong usage, 42 where namespaces cannot be made.

use clap::Parser;
use ldi_client::stream::LinkSpec;
use ldi_protocol::said::said;
use ldi_tests::namespace::run_behind;
use std::process::ExitCode;

/// Runs a command whose only network is a link with this rate, delay, loss: as `--link` of
/// ldi-client, but outside of the program, for anything over IPv4. Linux, as root.
#[derive(Debug, Parser)]
#[command(
    name = "ldi-link",
    version,
    after_help = "\
Examples:
  ldi-server serve house.ldi --listen 0.0.0.0:4433 &
  ldi-link rate=25mbit,delay=20ms,loss=2% -- ldi-client walk {host}:4433 --fingerprint HEX --path house.path.json --report walk.json
  ldi-link delay=50ms -- ping -c 5 {host}

{host} in the command becomes this machine's address at the other end. What became of the packets is said at the end."
)]
struct Cli {
    /// rate=20mbit,delay=20ms,jitter=5ms,loss=2%,dup=1%,blackout=10s:2s,queue=100ms,seed=1, each
    /// of them optional.
    link: LinkSpec,
    /// What to run there.
    #[arg(last = true, required = true)]
    command: Vec<String>,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    match run_behind(cli.link, &cli.command) {
        Ok(ended) => {
            for (way, c) in ["up", "down"].iter().zip(ended.counts) {
                eprintln!(
                    "{way}: {} packets sent, {} lost, {} dropped by the queue, {} bytes delivered",
                    c.sent, c.lost, c.dropped, c.bytes
                );
            }
            ExitCode::from(ended.status.code().and_then(|c| u8::try_from(c).ok()).unwrap_or(1))
        }
        Err(e) => {
            eprintln!("error: {}", said(e.as_ref()));
            ExitCode::from(42)
        }
    }
}
