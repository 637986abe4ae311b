//! The command `connect`: opens a window, after checking the server's certificate.

use super::{
    failure::Failure,
    input::{check_folder, disk, parse_size, read_path, token},
    signals::stop_at_signal,
};
use clap::Args;
use ldi_client::{
    app::{self, AppConfig, AppError, GamepadAt, ViewLink, parse_pose},
    engine::Renderer,
    gpu::WarpOn,
    stream::{
        Acquaintance, ConnectConfig, ConnectError, Connection, DEFAULT_DISK_BYTES, DiskCache, Fingerprint, KnownHosts,
        KnownHostsError,
    },
};
use ldi_protocol::{
    Pose,
    said::said,
    wire::{MAX_NAME_CHARS, Picture},
};
use std::{
    io::{BufRead as _, IsTerminal as _, Write as _},
    path::PathBuf,
    sync::Arc,
};

#[derive(Args)]
pub struct ConnectArgs {
    /// `HOST[:PORT]` of the server; `HOST[:PORT]/NAME` where it serves several datasets; or a link
    /// that Ctrl+C copies in a window: ldi://HOST/NAME#X,Y,Z,YAW,PITCH.
    #[arg(value_name = "SERVER")]
    server: ViewLink,
    /// Fingerprint of the server's certificate, as the server prints it: only this certificate is
    /// trusted, and the list of known servers is not used. Two with a comma between them while the
    /// certificate changes.
    #[arg(long, value_name = "HEX[,HEX]")]
    fingerprint: Option<String>,
    /// File of known servers [default: known_hosts in the user's configuration folder,
    /// ~/.config/ldi on Linux].
    #[arg(long, value_name = "FILE")]
    known_hosts: Option<PathBuf>,
    /// Trust an unknown server without asking. A known server whose certificate has changed is
    /// still refused.
    #[arg(long)]
    accept_new: bool,
    /// File with the shared secret, if the server requires one [default: the environment variable
    /// LDI_TOKEN].
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Name shown on other walkers' maps and on the server's page [default: the program and its
    /// version].
    #[arg(long, value_name = "NAME", value_parser = parse_name)]
    name: Option<String>,
    /// Size of the window in pixels.
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "1280x720")]
    size: (u32, u32),
    /// Device that renders.
    #[arg(long, value_enum, default_value = "auto")]
    renderer: Renderer,
    /// Device that warps images, if a GPU renders.
    #[arg(long, value_enum, default_value = "auto")]
    warp_on: WarpOn,
    /// Intended frame time while moving, milliseconds: the picture's resolution adapts to it
    /// [default: that in the settings, 16.7 at first].
    #[arg(long, value_name = "MS")]
    frame_ms: Option<f64>,
    /// File of the window's settings [default: settings.json in the user's configuration folder].
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// Start pose: position in metres, yaw and pitch in degrees [default: chosen on the largest
    /// storey].
    #[arg(long, value_name = "X,Y,Z[,YAW[,PITCH]]", value_parser = parse_pose, allow_hyphen_values = true)]
    start: Option<Pose>,
    /// Folder of the screenshots, created if absent.
    #[arg(long, value_name = "DIR", default_value = ".")]
    shots: PathBuf,
    /// Capacity of the cache, decoded bytes [default: 1 GiB].
    #[arg(long, value_name = "N")]
    cache_bytes: Option<u64>,
    /// Folder of the disk cache for later visits [default: the user's cache folder, ~/.cache/ldi on
    /// Linux].
    #[arg(long, value_name = "DIR")]
    disk_cache: Option<PathBuf>,
    /// Capacity of the disk cache, bytes; 0: no disk cache.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_DISK_BYTES)]
    disk_cache_bytes: u64,
    /// Radius around the eye in which data is prefetched, metres.
    #[arg(long, value_name = "M", default_value_t = 10.0)]
    prefetch_m: f64,
    /// Path file to replay once the first view is complete, and again with P.
    #[arg(long, value_name = "PATH.json")]
    replay: Option<PathBuf>,
    /// Device file of the gamepad, or `off` [default: the first of /dev/input/js0 to js3, on Linux;
    /// plugged in later, too].
    #[arg(long, value_name = "FILE")]
    gamepad: Option<PathBuf>,
    /// File of the bookmarks [default: one named after the scene in the user's configuration
    /// folder].
    #[arg(long, value_name = "FILE")]
    bookmarks: Option<PathBuf>,
    /// Write an event log, one JSON object per line: for tests.
    #[arg(long, value_name = "FILE", hide = true)]
    events: Option<PathBuf>,
}

impl From<AppError> for Failure {
    fn from(e: AppError) -> Self {
        Self { code: e.exit_code(), error: e.into() }
    }
}

impl From<KnownHostsError> for Failure {
    fn from(e: KnownHostsError) -> Self {
        let code = if matches!(e, KnownHostsError::File { .. }) { 1 } else { 42 };
        Self { code, error: e.into() }
    }
}

/// Opens the window and returns when it is closed.
pub fn connect(args: &ConnectArgs) -> Result<(), Failure> {
    if args.frame_ms.is_some_and(|ms| !(ms.is_finite() && ms > 0.0)) {
        return Err(Failure::usage("--frame-ms is a positive number of milliseconds"));
    }
    if !(args.prefetch_m.is_finite() && args.prefetch_m >= 0.0) {
        return Err(Failure::usage("--prefetch-m is a number of metres, 0 or more"));
    }
    check_folder(&args.shots, "--shots")?;
    let replay = args.replay.as_deref().map(read_path).transpose()?;
    let (width, height) = args.size;
    let mut config = ConnectConfig::new(&args.server.server, Picture { width, height, fov_deg: None });
    config.token = token(args.token_file.as_deref())?;
    config.prefetch_m = args.prefetch_m;
    if let Some(name) = &args.name {
        config.name.clone_from(name);
    }
    config.early = true;
    if let Some(bytes) = args.cache_bytes {
        config.cache_bytes = bytes;
    }
    trust(args, &mut config)?;
    if args.disk_cache_bytes > 0 {
        // A folder given by the user must work; a default one is optional.
        config.disk = match (&args.disk_cache, DiskCache::default_folder()) {
            (Some(folder), _) => Some(disk(folder, args.disk_cache_bytes)?),
            (None, Some(folder)) => match disk(&folder, args.disk_cache_bytes) {
                Ok(found) => Some(found),
                Err(e) => {
                    tracing::warn!("nothing is kept for the next visit: {}", said(e.error.as_ref()));
                    None
                }
            },
            (None, None) => None,
        };
    }
    let renderer = args.renderer.renderer(args.warp_on)?;
    let app = AppConfig {
        connect: config,
        size: args.size,
        frame_ms: args.frame_ms,
        settings: args.settings.clone(),
        // A replayed walk starts at its own pose.
        begin: args
            .start
            .or(args.server.pose)
            .or_else(|| replay.as_ref().and_then(|walk| walk.poses.first()).map(|p| p.pose)),
        screenshots: args.shots.clone(),
        replay,
        gamepad: match &args.gamepad {
            None => GamepadAt::Any,
            Some(file) if file.as_os_str() == "off" => GamepadAt::Nowhere,
            Some(file) => GamepadAt::File(file.clone()),
        },
        bookmarks: args.bookmarks.clone(),
        events: args.events.clone(),
        stop: stop_at_signal("closing the window").map_err(|e| Failure { code: 1, error: e.into() })?,
    };
    app::run(app, renderer)?;
    Ok(())
}

/// Sets the accepted certificate: the given one, or the one that the server shows if it is known or
/// is accepted now.
fn trust(args: &ConnectArgs, config: &mut ConnectConfig) -> Result<(), Failure> {
    if let Some(hex) = &args.fingerprint {
        let (now, next) = Fingerprint::pair(hex)?;
        (config.fingerprint, config.next_fingerprint) = (Some(now), next);
        return Ok(());
    }
    let path = args.known_hosts.clone().or_else(KnownHosts::default_path).ok_or_else(|| {
        Failure::usage("this user has no home folder: give --known-hosts FILE or the server's --fingerprint")
    })?;
    let known = KnownHosts::load(&path)?;
    // A connection without an expected certificate fails and reports the one found.
    let found = match Connection::connect(ConnectConfig { fingerprint: None, ..config.clone() }) {
        Err(ConnectError::UnknownServer { fingerprint }) => fingerprint.parse::<Fingerprint>()?,
        Err(e) => return Err(e.into()),
        Ok(_) => return Err(ConnectError::Protocol("a connection without a certificate".into()).into()),
    };
    if known.check(&config.server, found)? == Acquaintance::Stranger {
        if !args.accept_new {
            ask(&config.server, found)?;
        }
        known.remember(&config.server, found)?;
        eprintln!("ldi-client: {} is known from now on ({})", config.server, known.path().display());
    }
    (config.fingerprint, config.next_fingerprint) = (Some(found), known.other(&config.server, found));
    config.known_hosts = Some(Arc::new(known));
    Ok(())
}

/// Asks on the terminal whether to trust a server.
fn ask(server: &str, found: Fingerprint) -> Result<(), Failure> {
    let stranger = || ConnectError::UnknownServer { fingerprint: found.to_string() };
    if !std::io::stdin().is_terminal() {
        // No user to ask.
        return Err(Failure::usage(format!(
            "{server} is not known here, and there is no terminal to ask on. If the server prints fingerprint={found}, \
             type\n  ldi-client connect {server} --fingerprint {found}\nor trust whoever answers now, and remember it:\n  \
             ldi-client connect {server} --accept-new"
        )));
    }
    eprint!(
        "The server {server} is not known here. Its certificate has the fingerprint\n  {found}\n\
         Compare it with what the server prints as fingerprint=. Trust it from now on? [yes/no] "
    );
    let _ = std::io::stderr().flush();
    let mut answer = String::new();
    let read = std::io::stdin().lock().read_line(&mut answer);
    match (read, answer.trim().to_ascii_lowercase().as_str()) {
        (Ok(_), "yes" | "y") => Ok(()),
        _ => Err(stranger().into()),
    }
}

fn parse_name(text: &str) -> Result<String, String> {
    match text.chars().count() {
        1..=MAX_NAME_CHARS if !text.chars().any(char::is_control) => Ok(text.to_owned()),
        _ => Err(format!("give 1 to {MAX_NAME_CHARS} characters in one line")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_fit_what_servers_show() {
        assert_eq!(parse_name("Zoë, guide").unwrap(), "Zoë, guide");
        assert!(parse_name(&"ë".repeat(64)).is_ok());
        for wrong in [String::new(), "a\nb".into(), "x".repeat(65)] {
            assert!(parse_name(&wrong).is_err(), "{wrong}");
        }
    }
}
