//! `ldi-load`: many simulated walkers on a server; latency of chunks, incomplete frames, bytes,
//! waste, what it costs the server.
//!
//! Exit codes: 0 done, 2 wrong usage, 1 a failure that a retry may cure, 42 a permanent one.

use anyhow::Context as _;
use clap::{Parser, ValueEnum};
use ldi_client::stream::{ConnectConfig, Fingerprint, LinkSpec};
use ldi_protocol::{path, said::said};
use ldi_tests::load::{
    self, Load, LoadError, decoding_fits,
    hostile::Manner,
    page,
    process::Process,
    raw,
    report::report,
    track::{Route, Scenario},
};
use std::{
    io::IsTerminal as _,
    path::{Path, PathBuf},
    process::ExitCode,
};

/// Most walkers: beyond, sockets run out.
const MAX_WALKERS: i64 = 20_000;
/// Longest file with a token.
const MAX_TOKEN_BYTES: u64 = 1024;

/// Many simulated walkers on one server, each with a real connection and a real cache: a report
/// (JSON) and a page (HTML) beside it.
#[derive(Debug, Parser)]
#[command(
    name = "ldi-load",
    version,
    after_help = "\
Examples:
  ldi-load localhost --fingerprint HEX --walkers 64 --seconds 60 --path house.path.json --report load.json --server-pid $(pgrep -x ldi-server)
  ldi-load localhost --fingerprint HEX --walkers 8 --seconds 30 --random 1 --ramp 5 --link rate=25mbit,delay=40ms,loss=2% --report load.json
  nice -n 19 ldi-load localhost --fingerprint HEX --walkers 0 --hostile 1000 --seconds 60 --random 1 --report hostile.json

A walker looks 60 times per second what of its view is missing. Exit codes: 0 done, 2 wrong usage, 1 a retry may help, 42 a retry will not help."
)]
struct Cli {
    /// `HOST[:PORT]` of the server; `HOST[:PORT]/NAME` where it serves several datasets.
    server: String,
    /// How many walkers; 0 with --hostile: only those.
    #[arg(long, value_parser = clap::value_parser!(u32).range(0..=MAX_WALKERS))]
    walkers: u32,
    /// How long they walk once all are in, seconds.
    #[arg(long, value_parser = seconds)]
    seconds: f64,
    /// Path file: waypoints or poses; each walker begins at another place on it.
    #[arg(long, value_name = "PATH.json", conflicts_with = "random", required_unless_present = "random")]
    path: Option<PathBuf>,
    /// Random walks through the walk volume, from this seed.
    #[arg(long, value_name = "SEED")]
    random: Option<u64>,
    /// File of the report; the page lies beside it as .html.
    #[arg(long, value_name = "FILE")]
    report: PathBuf,
    /// Process of the server, when it runs on this machine: its memory and processor time are
    /// reported.
    #[arg(long, value_name = "PID")]
    server_pid: Option<u32>,
    /// Behave as if this link, in both directions, lay before each walker:
    /// rate=20mbit,delay=20ms,jitter=5ms,loss=2%,dup=1%,blackout=10s:2s,queue=100ms,seed=1; each
    /// key optional, delay one way; the seed counts up from walker to walker.
    #[arg(long, value_name = "LINK")]
    link: Option<LinkSpec>,
    /// Fingerprint of the server's certificate, as the server prints it.
    #[arg(long, value_name = "HEX")]
    fingerprint: Option<String>,
    /// File with the shared secret that the server asks for.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// How walkers move.
    #[arg(long, value_enum, default_value = "path")]
    scenario: Scenario,
    /// Connections that want the server no good, beside the walkers: what they cost shows in the
    /// walkers' figures. To tell what they cost the server from what they cost this program, run
    /// them in another one, of low priority: `nice -n 19 ldi-load ... --walkers 0 --hostile N`.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=MAX_WALKERS))]
    hostile: u32,
    /// How those behave, in turn.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "HOW", default_values = ["silent", "slow", "flooding", "malformed"])]
    hostile_as: Vec<Manner>,
    /// Time over which the walkers come in, seconds.
    #[arg(long, value_parser = ramp, default_value = "0")]
    ramp: f64,
    /// Whether chunks are decoded; auto: unless all caches together might take more than half of
    /// the free memory.
    #[arg(long, value_enum, default_value = "auto")]
    decode: Decode,
    /// Most decoded bytes that each walker holds [default: 1 GiB].
    #[arg(long, value_name = "N")]
    cache_bytes: Option<u64>,
    /// How far around the eye data is sent ahead of need, metres.
    #[arg(long, value_name = "M", default_value_t = 10.0)]
    prefetch_m: f64,
    /// Leave out the bare QUIC transfer to compare with.
    #[arg(long)]
    no_raw: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Decode {
    Auto,
    On,
    Off,
}

fn seconds(s: &str) -> Result<f64, String> {
    let range = 0.1..=86_400.0;
    s.parse().ok().filter(|v| range.contains(v)).ok_or_else(|| format!("'{s}' is no number of seconds of 0.1 to 86400"))
}

fn ramp(s: &str) -> Result<f64, String> {
    if s.parse() == Ok(0.0) { Ok(0.0) } else { seconds(s) }
}

/// An error with its exit code.
struct Failure(u8, anyhow::Error);

impl From<LoadError> for Failure {
    fn from(e: LoadError) -> Self {
        Self(e.exit_code(), e.into())
    }
}

fn main() -> ExitCode {
    if std::env::args().nth(1).as_deref() == Some(raw::SERVE) {
        return if raw::serve().is_ok() { ExitCode::SUCCESS } else { ExitCode::from(1) };
    }
    let cli = Cli::parse();
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure(code, e)) => {
            eprintln!("ldi-load: {}", said(e.as_ref()));
            ExitCode::from(code)
        }
    }
}

fn run(cli: &Cli) -> Result<(), Failure> {
    let permanent = |e: anyhow::Error| Failure(42, e);
    let route = match (&cli.path, cli.random) {
        (Some(file), _) => {
            let walk = std::fs::File::open(file)
                .map_err(path::PathError::from)
                .and_then(|open| path::read(open, |told| eprintln!("ldi-load: {}: {told}", file.display())))
                .with_context(|| file.display().to_string());
            Route::Path(walk.map_err(permanent)?)
        }
        (None, seed) => Route::Random(seed.unwrap_or(1)),
    };
    if !(cli.prefetch_m.is_finite() && cli.prefetch_m >= 0.0) {
        return Err(Failure(2, anyhow::anyhow!("--prefetch-m is a number of metres, 0 or more")));
    }
    if cli.walkers == 0 && cli.hostile == 0 {
        return Err(Failure(2, anyhow::anyhow!("--walkers 0 leaves nothing to do: give 1 or more, or --hostile N")));
    }
    let mut config = ConnectConfig::new(&cli.server, load::PICTURE);
    let fingerprint = cli.fingerprint.as_deref().map(str::parse::<Fingerprint>).transpose();
    config.fingerprint = fingerprint.map_err(|e| Failure(e.exit_code(), e.into()))?;
    config.token = cli.token_file.as_deref().map(token).transpose().map_err(permanent)?;
    config.link = cli.link;
    config.prefetch_m = cli.prefetch_m;
    config.cache_bytes = cli.cache_bytes.unwrap_or(config.cache_bytes);
    config.decoding = match cli.decode {
        Decode::Auto => decoding_fits(cli.walkers as usize, config.cache_bytes),
        Decode::On => true,
        Decode::Off => false,
    };
    if !config.decoding && cli.decode == Decode::Auto {
        eprintln!(
            "chunks are verified but not decoded: {} caches of {:.1} GB might not fit into memory; --decode on or a smaller --cache-bytes decodes them",
            cli.walkers,
            config.cache_bytes as f64 * 1e-9
        );
    }
    if cli.report.extension().is_some_and(|e| e == "html") {
        let name = cli.report.display();
        return Err(Failure(
            2,
            anyhow::anyhow!("--report {name}: the report is JSON, and its page lies beside it as .html; name it .json"),
        ));
    }
    // Found out before the run, not after it.
    let beside = cli.report.with_extension("tmp");
    std::fs::write(&beside, "")
        .with_context(|| {
            format!("{}: cannot be written; give --report a file in a folder that can be", cli.report.display())
        })
        .map_err(permanent)?;
    let load = Load {
        config,
        walkers: cli.walkers as usize,
        seconds: cli.seconds,
        ramp_s: cli.ramp,
        hostile: cli.hostile as usize,
        manners: cli.hostile_as.clone(),
        route,
        scenario: cli.scenario,
        server: cli.server_pid.map(Process),
        raw: !cli.no_raw,
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(|e| Failure::from(LoadError::from(e)))?;
    let total = cli.ramp + cli.seconds;
    let seen = runtime.block_on(load::run(&load, |at, walkers| {
        if (at.round() as u64).is_multiple_of(5) {
            eprintln!("{at:.0} of {total} s, {walkers} walkers");
        }
    }));
    // Goodbyes are on their way.
    runtime.shutdown_timeout(std::time::Duration::from_millis(300));
    let seen = seen.inspect_err(|_| drop(std::fs::remove_file(&beside)))?;
    let report = report(&load, &seen);
    let command = std::env::args().skip(1).fold("ldi-load".to_owned(), |line, word| line + " " + &word);
    let page_file = cli.report.with_extension("html");
    let write = || -> anyhow::Result<()> {
        std::fs::write(&beside, serde_json::to_string_pretty(&report)? + "\n")?;
        std::fs::rename(&beside, &cli.report)?;
        std::fs::write(&page_file, page::html(&report, &seen, &command))?;
        Ok(())
    };
    write().with_context(|| format!("{}: cannot be written", cli.report.display())).map_err(|e| Failure(1, e))?;
    let percent = |v: &serde_json::Value| v.as_f64().map_or("-".into(), |v| format!("{:.2}%", 100.0 * v));
    let ms = |kind: &str| report["chunk_ms"][kind]["p99"].as_f64().map_or("-".into(), |v| format!("{v:.1}"));
    println!(
        "{} of {} connected, {} dropped; {} of frames incomplete ({} after the first second); chunks p99 {} ms near, {} ms far; {:.1} MB, {} wasted; report in {}, page in {}",
        report["connected"],
        report["walkers"],
        report["dropped"],
        percent(&report["incomplete_fraction"]),
        percent(&report["after_first_second"]["incomplete_fraction"]),
        ms("near"),
        ms("far"),
        report["bytes_total"].as_f64().unwrap_or_default() * 1e-6,
        percent(&report["wasted_fraction"]),
        cli.report.display(),
        page_file.display()
    );
    for (manner, toll) in seen.hostile.iter().filter(|_| cli.hostile > 0) {
        println!(
            "hostile, {}: {} came in, of these {} thrown out; {} turned away; {:.1} MB to them",
            format!("{manner:?}").to_lowercase(),
            toll.came_in,
            toll.thrown_out,
            toll.turned_away,
            toll.bytes as f64 * 1e-6
        );
    }
    Ok(())
}

fn token(path: &Path) -> anyhow::Result<String> {
    let bytes = std::fs::metadata(path).with_context(|| format!("{}: cannot be read", path.display()))?.len();
    anyhow::ensure!(
        bytes <= MAX_TOKEN_BYTES,
        "{}: {bytes} bytes; a token has at most {MAX_TOKEN_BYTES}",
        path.display()
    );
    Ok(std::fs::read_to_string(path)?.trim().to_owned())
}
