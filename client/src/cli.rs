//! The command line: parses arguments, writes results to files, converts errors to exit codes.
//!
//! Exit codes: 0 success, 2 wrong usage, 1 a failure that a retry may cure, 42 a permanent failure.

mod connect;
mod failure;
mod input;
mod shell;
mod signals;

use anyhow::Context;
use clap::{Args, CommandFactory as _, Parser, Subcommand, ValueEnum as _};
use failure::Failure;
use indicatif::{ProgressBar, ProgressStyle};
use input::{check_file, check_folder, disk, parse_size, read_path, token};
use ldi_client::{
    app::HeadlessConnection,
    composite::Fill,
    engine::{
        Appearance, Cull, DataSource, DisplayMode, FrameRenderer, Method, Pace, Progress, Renderer, WalkJob,
        WalkOptions, pictures_of, run,
    },
    gpu::{Gpu, WarpOn},
    report::{DatasetReport, DiskReport, LinkReport, MachineReport, Report, SceneReport},
    stream::{ConnectConfig, Connection, DEFAULT_DISK_BYTES, Fingerprint, LinkSpec},
    warp::{Order, Stamp, WarpOptions},
};
use ldi_protocol::{
    index::Index,
    path::{Walk, misfit},
    said::said,
    wire::Picture,
};
use std::{
    io::IsTerminal,
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

/// Walks through large static scenes streamed from a server: near geometry is drawn, distant parts
/// are warped from layered depth images.
#[derive(Parser)]
#[command(
    name = "ldi-client",
    version,
    after_help = "Examples:\n  ldi-client connect localhost\n  ldi-client walk localhost --fingerprint HEX --path path.json --size 1280x720 -o frames --report walk.json"
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Walk along a path without a window: numbered frames and a report.
    #[command(after_help = "Examples:\n  \
        ldi-client walk localhost --fingerprint HEX --path clinic.path.json --size 1280x720 --pace wait --every 200 -o frames --report walk.json\n  \
        ldi-client walk localhost --fingerprint HEX --path clinic.path.json --size 1280x720 --truth truth -o frames --report walk.json\n  \
        ldi-client walk localhost --fingerprint HEX --path house.path.json --size 640x512 --method warp2 --pace wait --every 13 -o frames --report walk.json\n  \
        ldi-client walk localhost --fingerprint HEX --path clinic.path.json --size 1280x720 --link rate=25mbit,delay=40ms,loss=2% -o frames --report walk.json\n\n\
        Exit codes: 0 done, 2 wrong usage, 1 a retry may help, 42 a retry will not help.")]
    Walk(Box<WalkArgs>),
    /// Walk freely, in a window.
    #[command(after_help = "Examples:\n  \
        ldi-client connect museum.local\n  \
        ldi-client connect 'ldi://museum.local/house#1.5,1.6,-2,90,0'\n  \
        ldi-client connect localhost:4433 --fingerprint HEX --shots pictures\n\n\
        Keys: click looks around (Esc lets the pointer go), W A S D and arrows walk, Q and E sink and\n\
        rise in --fly datasets, Shift runs, the wheel changes the speed. H shows all keys.\n\n\
        Exit codes: 0 closed, 2 wrong usage or an unknown server, 1 a retry may help, 42 refused or a changed fingerprint.")]
    Connect(Box<connect::ConnectArgs>),
    /// Measure what drawing costs on this machine's processor, for `ldi-server build --for FILE`.
    #[command(
        after_help = "Example: ldi-client calibrate -o laptop.json; ldi-server build town.glb -o town.ldi --for laptop.json"
    )]
    Calibrate {
        /// File of the profile.
        #[arg(short = 'o', long = "out", value_name = "FILE.json")]
        out: PathBuf,
        /// Name of the profile [default: the file's].
        #[arg(long)]
        name: Option<String>,
    },
    /// Print completions for a shell.
    #[command(
        after_help = "Example: ldi-client completions bash > ~/.local/share/bash-completion/completions/ldi-client"
    )]
    Completions {
        /// Shell.
        shell: clap_complete::Shell,
    },
    /// Write man pages, one for each command.
    #[command(after_help = "Example: ldi-client man -o ~/.local/share/man/man1")]
    Man {
        /// Folder for the pages.
        #[arg(short = 'o', long = "out", value_name = "DIR")]
        out: PathBuf,
    },
}

#[derive(Args)]
struct WalkArgs {
    /// `HOST[:PORT]` of the server; `HOST[:PORT]/NAME` where it serves several datasets.
    server: String,
    /// Fingerprint of the server's certificate, as the server prints it; two with a comma between
    /// them while the certificate changes.
    #[arg(long, value_name = "HEX[,HEX]")]
    fingerprint: Option<String>,
    /// Path file: waypoints or poses.
    #[arg(long, value_name = "PATH.json")]
    path: PathBuf,
    /// Output size in pixels.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: (u32, u32),
    /// Folder of the frames.
    #[arg(short = 'o', long = "out", value_name = "DIR")]
    out: PathBuf,
    /// File of the report.
    #[arg(long, value_name = "FILE")]
    report: PathBuf,
    /// Device that renders.
    #[arg(long, value_enum, default_value = "cpu")]
    renderer: Renderer,
    /// Device that warps images, if a GPU renders.
    #[arg(long, value_enum, default_value = "auto")]
    warp_on: WarpOn,
    /// Representation of distant parts.
    #[arg(long, value_enum, default_value = "auto")]
    method: Method,
    /// With --method cache: largest displacement that a cached image may show, pixels. Larger:
    /// images last longer.
    #[arg(long, value_name = "PX", default_value_t = 2.0)]
    cache_error_px: f64,
    /// With --method texture: 1 shows the image taken from straight in front of each portal; all,
    /// the nearest of those taken along a semicircle.
    #[arg(long, value_name = "1|all", default_value = "1", value_parser = ["1", "all"])]
    portal_textures: String,
    /// With --method portals: show images wherever a portal has one for the eye, even where
    /// geometry would fit the budget.
    #[arg(long)]
    portals_everywhere: bool,
    /// Reconstruction of warped samples: 1px, 2x2, 3x3, cross, footprint, parallelogram, ewa or
    /// quads [default: quads; 2x2 with --order epipole].
    #[arg(long, value_name = "NAME")]
    stamp: Option<Stamp>,
    /// Content of holes: surface, the nearest farther surface; last, the previous frame, as in the
    /// portal system of 1998; off, nothing.
    #[arg(long, value_enum, default_value = "surface")]
    fill: Fill,
    /// Smooth warped pixels with the 3 x 3 kernel of the 1999 system: less noise, less detail.
    #[arg(long)]
    smooth: bool,
    /// Samples per output pixel along each side.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=2), default_value_t = 1)]
    supersample: u32,
    /// Visibility of two samples in a pixel: z, the nearer wins; epipole, the later in
    /// occlusion-compatible order.
    #[arg(long, default_value = "z")]
    order: Order,
    /// Reject samples by groups before the warp.
    #[arg(long, value_enum, default_value = "auto")]
    cull: Cull,
    /// Time for the LDI tree per frame, milliseconds [default: as its finest samples in view need].
    #[arg(long, value_name = "MS")]
    frame_ms: Option<f64>,
    /// File with the shared secret, if the server requires one [default: the environment variable
    /// LDI_TOKEN].
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Folder of ground-truth frames to compare with, as `ldi-server render --depth` writes them.
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// Folder of another renderer's frames to evaluate as well, as `ldi-server render --samples 1
    /// --mips` writes them.
    #[arg(long, value_name = "DIR", requires = "truth")]
    baseline: Option<PathBuf>,
    /// realtime: draw each pose when it is due, from the data that has arrived; wait: complete
    /// frames of every Nth pose only.
    #[arg(long, value_enum, default_value = "realtime")]
    pace: Pace,
    /// Capacity of the cache, decoded bytes [default: 1 GiB].
    #[arg(long, value_name = "N")]
    cache_bytes: Option<u64>,
    /// Folder of the disk cache for later visits, created if absent [default: no disk cache].
    #[arg(long, value_name = "DIR")]
    disk_cache: Option<PathBuf>,
    /// Capacity of the disk cache, bytes.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_DISK_BYTES)]
    disk_cache_bytes: u64,
    /// Radius around the eye in which data is prefetched, metres [default: 10; 0 with --pace wait].
    #[arg(long, value_name = "M")]
    prefetch_m: Option<f64>,
    /// Save every Nth frame, numbered by the pose's index.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Also save the pixels from geometry, those from images, and the source of each pixel.
    #[arg(long)]
    debug_views: bool,
    /// Number of frames drawn again with all geometry after the walk, for the speedup; 0 for none.
    #[arg(long, value_name = "N", default_value_t = 20)]
    baseline_frames: u32,
    /// Simulate a network link in both directions:
    /// rate=20mbit,delay=20ms,jitter=5ms,loss=2%,dup=1%,blackout=10s:2s,queue=100ms,seed=1; each
    /// key optional, delay one way.
    #[arg(long, value_name = "LINK")]
    link: Option<LinkSpec>,
}

/// Runs the command line.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| "warn,winit=error,ldi_client=info".into());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let done = match cli.command {
        Command::Walk(args) => walk(&args),
        Command::Connect(args) => connect::connect(&args),
        Command::Calibrate { out, name } => shell::calibrate(&out, name.as_deref()),
        Command::Completions { shell } => shell::completions(shell, Cli::command()),
        Command::Man { out } => shell::man(&out, Cli::command()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("ldi-client: {}", said(failure.error.as_ref()));
            ExitCode::from(failure.code)
        }
    }
}

fn unsupported(what: &str, instead: &str) -> Failure {
    Failure::usage(format!("not there yet: {what}; {instead}"))
}

/// Rejects unsupported combinations of options.
fn reject_unsupported(args: &WalkArgs) -> Result<(), Failure> {
    let order_and_stamp = WarpOptions { stamp: stamp(args), order: args.order, ..WarpOptions::default() };
    if args.warp_on == WarpOn::Gpu && args.renderer != Renderer::Cpu {
        Gpu::can_warp(&order_and_stamp)?;
    }
    if args.method == Method::Cache && args.renderer != Renderer::Cpu {
        return Err(unsupported("cached images on a graphics card", "use --renderer cpu with --method cache"));
    }
    if !(args.cache_error_px.is_finite() && args.cache_error_px > 0.0) {
        return Err(Failure::usage("--cache-error-px is a positive number of pixels"));
    }
    if args.portal_textures != "1" && args.method != Method::Texture {
        return Err(Failure::usage("--portal-textures goes with --method texture"));
    }
    if args.portals_everywhere && args.method != Method::Portals {
        return Err(Failure::usage(
            "--portals-everywhere goes with --method portals; the methods of 1998 always do so",
        ));
    }
    if args.frame_ms.is_some_and(|ms| !(ms.is_finite() && ms > 0.0)) {
        return Err(Failure::usage("--frame-ms is a positive number of milliseconds"));
    }
    if !(prefetch_m(args).is_finite() && prefetch_m(args) >= 0.0) {
        return Err(Failure::usage("--prefetch-m is a number of metres, 0 or more"));
    }
    Ok(())
}

/// The order epipole applies to single samples: stamps that span several need depths.
fn stamp(args: &WalkArgs) -> Stamp {
    args.stamp.unwrap_or(if args.order == Order::Epipole { Stamp::TwoByTwo } else { Stamp::Quads })
}

/// The method with its modifiers.
fn method_of(args: &WalkArgs) -> Method {
    match args.method {
        Method::Texture if args.portal_textures == "all" => Method::Textures,
        Method::Portals if args.portals_everywhere => Method::PortalsEverywhere,
        method => method,
    }
}

/// Checks that a dataset has the representation of a method.
fn check_offer(method: Method, index: &Index) -> Result<(), Failure> {
    let name = method.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned());
    let refused = |why: &str| Err(Failure::permanent(anyhow::anyhow!("--method {name}: {why}")));
    let wanted = method.show().portals.images;
    match &index.rooms {
        None if matches!(method, Method::Texture | Method::Warp1 | Method::Warp2) => refused(
            "the dataset has no rooms; build it with `ldi-server build SCENE --represent portals --portal-images paper`, or use --method auto",
        ),
        None if method == Method::Portals => refused(
            "the dataset has no rooms; build it with `ldi-server build SCENE --represent portals`, or use --method auto",
        ),
        Some(_) if method == Method::Grid => refused(
            "the dataset is walked by rooms, and has a grid at most where those are too much; build it with --represent grid, or use --method portals",
        ),
        Some(rooms) if !rooms.built.offer(wanted) && wanted.is_paper() => refused(
            "the dataset has no reference images of portals; build it with `--represent portals --portal-images paper` (or both), or use --method portals",
        ),
        Some(rooms) if !rooms.built.offer(wanted) => refused(
            "the dataset has only images of portals as of 1998; build it with `--represent portals --portal-images ours` (or both), or use --method ldi",
        ),
        _ => Ok(()),
    }
}

/// Warns of a path that does not lie in the scene; says with which factor it would.
fn warn_of_misfit(file: &Path, walk: &Walk, index: &Index) {
    let places: Vec<_> = walk.poses.iter().map(|p| p.pose.position).collect();
    if let Some(misfit) = misfit(&places, &index.scene.bounds, index.volume.as_ref()) {
        tracing::warn!("{}: {misfit}", file.display());
    }
}

/// Frames that wait for their own data do not benefit from prefetched data.
fn prefetch_m(args: &WalkArgs) -> f64 {
    args.prefetch_m.unwrap_or(if matches!(args.pace, Pace::Wait) { 0.0 } else { 10.0 })
}

fn walk(args: &WalkArgs) -> Result<(), Failure> {
    reject_unsupported(args)?;
    check_folder(&args.out, "-o")?;
    check_file(&args.report, "--report")?;
    let path = read_path(&args.path)?;
    let token = token(args.token_file.as_deref())?;
    for (folder, option) in [(&args.truth, "--truth"), (&args.baseline, "--baseline")] {
        let Some(folder) = folder else { continue };
        let poses = || (0..path.poses.len()).step_by(args.every as usize);
        match pictures_of(folder, poses()) {
            0 => {
                return Err(Failure::permanent(anyhow::anyhow!(
                    "{option} {}: no picture of any pose of this walk; make them with `ldi-server render` of the same path with --every {}",
                    folder.display(),
                    args.every
                )));
            }
            n if n < poses().count() => {
                tracing::warn!("{option} {}: {n} pictures for {} frames", folder.display(), poses().count());
            }
            _ => {}
        }
    }
    // The rendered size, which determines the texture levels in use.
    let [width, height] = [args.size.0, args.size.1].map(|n| n.saturating_mul(args.supersample));
    let mut config = ConnectConfig::new(&args.server, Picture { width, height, fov_deg: None });
    if let Some(hex) = &args.fingerprint {
        let (now, next) = Fingerprint::pair(hex)?;
        (config.fingerprint, config.next_fingerprint) = (Some(now), next);
    }
    config.token = token;
    config.prefetch_m = prefetch_m(args);
    config.show = method_of(args).show();
    // The early index is enough only if no option requires other data.
    config.early = args.pace == Pace::Realtime && matches!(method_of(args), Method::Auto | Method::Tree);
    config.link = args.link;
    config.disk = args.disk_cache.as_deref().map(|d| disk(d, args.disk_cache_bytes)).transpose()?;
    if let Some(bytes) = args.cache_bytes {
        config.cache_bytes = bytes;
    }
    // A missing GPU is reported before the walk.
    let renderer = args.renderer.renderer(args.warp_on)?;
    let drawn_by = drawn_by(&renderer);
    let report_file = PendingReport::create(&args.report).map_err(Failure::permanent)?;
    let connection = Connection::connect(config.clone())?;
    check_offer(args.method, connection.index())?;
    warn_of_misfit(&args.path, &path, connection.index());
    let stop = signals::stop_at_signal("ending the walk; once more ends it without a report")
        .map_err(|e| Failure { code: 1, error: e.into() })?;
    let link = HeadlessConnection::new(connection, config, Arc::clone(&stop))
        .map_err(|e| Failure { code: 1, error: e.into() })?;
    let options = WalkOptions {
        width: args.size.0,
        height: args.size.1,
        method: method_of(args),
        cache_error_px: args.cache_error_px,
        stamp: stamp(args),
        order: args.order,
        cull: args.cull,
        fill: args.fill,
        smooth: args.smooth,
        frame_ms: args.frame_ms,
        supersample: args.supersample,
        pace: args.pace,
        every: args.every as usize,
        cache_bytes: args.cache_bytes,
        debug_views: args.debug_views,
        shows: DisplayMode::Scene,
        appearance: Appearance::default(),
        background_layout: false,
        baseline_frames: args.baseline_frames as usize,
    };
    let job = WalkJob {
        path: &path,
        options: &options,
        folder: &args.out,
        truth: args.truth.as_deref(),
        baseline: args.baseline.as_deref(),
        stop: Some(&stop),
    };
    let mut show = ProgressDisplay::new();
    let (summary, frames) = run(&link, &job, renderer, &mut |p| show.frame(p))?;
    show.done();
    let index = link.index();
    let scene = &index.scene;
    let report = Report {
        scene: SceneReport {
            name: scene.name.clone(),
            triangles: scene.triangles,
            unique_triangles: scene.unique_triangles,
            instances: scene.instances,
            bounds: [scene.bounds.min.to_array(), scene.bounds.max.to_array()],
        },
        dataset: DatasetReport {
            hash: link.dataset_hash(),
            budget: index.settings.budget,
            representations: match (&index.rooms, index.placements.is_empty()) {
                (Some(_), _) if !index.points.is_empty() => vec!["geometry", "portals", "grid"],
                (Some(_), _) => vec!["geometry", "portals"],
                (None, false) => vec!["geometry", "grid"],
                (None, true) => vec!["geometry"],
            },
        },
        machine: MachineReport::here(),
        options: options_as_json(args, &options, drawn_by),
        link: link.stats().link.map(|[up, down]| LinkReport { up, down }),
        disk: args.disk_cache.is_some().then(|| {
            let stats = link.stats();
            DiskReport { chunks: stats.disk_chunks, bytes: stats.disk_bytes }
        }),
        summary,
        frames,
    };
    report_file.publish(&report).map_err(|error| Failure { code: 1, error })?;
    if stop.load(Ordering::Relaxed) && report.frames.is_empty() {
        println!("no frame yet; report in {}", args.report.display());
        return Ok(());
    }
    let s = &report.summary;
    println!(
        "{} frames drawn, {} of them incomplete, {} kept; {} triangles at most (budget {}), {:.1} ms median{}, {} bytes; report in {}",
        s.frames_drawn,
        s.frames_incomplete,
        s.frames,
        s.max_triangles,
        s.budget_triangles,
        s.frame_ms.p50,
        s.mean_flip.map_or(String::new(), |f| format!(", mean FLIP {f:.4}"))
            + &s.flip_over_baseline.map_or(String::new(), |r| format!(
                " ({:.2} x the baseline's over {} frames with images, worst frame {:.2} x, far pixels {:.2} x)",
                r.mean, r.frames, r.worst, r.far_by_pixel
            )),
        s.bytes_total,
        args.report.display()
    );
    if s.frames_unplanned > 0 {
        tracing::warn!(
            "{} of {} frames are seen from places that no image was made for: what is far is softer there; `ldi-server inspect DATASET --plan plan.svg --path PATH.json` shows which, `ldi-server build --start X,Y,Z` or `--along PATH.json` makes images for them",
            s.frames_unplanned,
            s.frames
        );
    }
    if s.damaged_chunks > 0 {
        let n = s.damaged_chunks;
        return Err(Failure::permanent(anyhow::anyhow!(
            "{n} chunks of the dataset are damaged: frames lack what is in them; look with `ldi-server verify`"
        )));
    }
    match &s.lost {
        Some(lost) => Err(Failure { code: 1, error: anyhow::anyhow!("{lost}; the walk is not whole") }),
        None => Ok(()),
    }
}

/// The GPU and its calibration; null without one.
fn drawn_by(renderer: &FrameRenderer) -> serde_json::Value {
    let Some(gpu) = renderer.gpu() else { return serde_json::Value::Null };
    serde_json::json!({
        "adapter": gpu.adapter(),
        "software": gpu.is_software(),
        "atomics": format!("{:?}", gpu.atomics()).to_lowercase(),
        "calibration": gpu.calibration(),
    })
}

/// Options of the walk and of the command, for the report.
fn options_as_json(args: &WalkArgs, options: &WalkOptions, drawn_by: serde_json::Value) -> serde_json::Value {
    // Plain data: serialization does not fail.
    let mut json = serde_json::to_value(options).unwrap_or_default();
    if let serde_json::Value::Object(map) = &mut json {
        map.insert("path".into(), args.path.display().to_string().into());
        map.insert("size".into(), format!("{}x{}", args.size.0, args.size.1).into());
        map.insert("renderer".into(), if drawn_by.is_null() { "cpu" } else { "gpu" }.into());
        map.insert("gpu".into(), drawn_by);
        map.insert("truth".into(), args.truth.as_ref().map(|t| t.display().to_string()).into());
        map.insert("baseline".into(), args.baseline.as_ref().map(|t| t.display().to_string()).into());
        map.insert("prefetch_m".into(), prefetch_m(args).into());
        map.insert("frame_ms".into(), args.frame_ms.into());
        map.insert("link".into(), args.link.map(|l| l.to_string()).into());
        map.insert("disk_cache".into(), args.disk_cache.as_ref().map(|d| d.display().to_string()).into());
        map.insert("server".into(), args.server.clone().into());
    }
    json
}

/// The report's file: written to a temporary name, then renamed, so that it is never incomplete.
struct PendingReport<'a> {
    path: &'a Path,
    temporary: PathBuf,
}

impl<'a> PendingReport<'a> {
    fn create(path: &'a Path) -> anyhow::Result<Self> {
        let temporary = path.with_extension("tmp");
        std::fs::write(&temporary, "").with_context(|| {
            format!("{}: cannot be written; give --report a file in a folder that can be", path.display())
        })?;
        Ok(Self { path, temporary })
    }

    fn publish(self, report: &Report) -> anyhow::Result<()> {
        let text = serde_json::to_string_pretty(report)?;
        std::fs::write(&self.temporary, text + "\n")
            .with_context(|| format!("{}: cannot be written", self.temporary.display()))?;
        std::fs::rename(&self.temporary, self.path)
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }
}

impl Drop for PendingReport<'_> {
    fn drop(&mut self) {
        // Absent once the report was published.
        let _ = std::fs::remove_file(&self.temporary);
    }
}

/// Displays progress: a bar on a terminal, otherwise a line every few seconds.
struct ProgressDisplay {
    bar: Option<ProgressBar>,
    start: Instant,
    last_line: Instant,
}

impl ProgressDisplay {
    fn new() -> Self {
        let now = Instant::now();
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(0);
            if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} frames, {per_sec}, ETA {eta}, {msg}")
            {
                bar.set_style(style);
            }
            bar
        });
        Self { bar, start: now, last_line: now }
    }

    fn frame(&mut self, p: Progress) {
        let received = format!("{:.1} MB received, {:.1} ms", p.bytes as f64 * 1e-6, p.frame_ms);
        match &self.bar {
            Some(bar) => {
                bar.set_length(p.total as u64);
                bar.set_position(p.done as u64);
                bar.set_message(received);
            }
            None if p.done == p.total || self.last_line.elapsed() > Duration::from_secs(5) => {
                self.last_line = Instant::now();
                let rate = p.done as f64 / self.start.elapsed().as_secs_f64().max(1e-9);
                let left_s = (p.total - p.done) as f64 / rate.max(1e-9);
                eprintln!("{} of {} frames, {rate:.1} per second, {left_s:.0} s left, {received}", p.done, p.total);
            }
            None => {}
        }
    }

    fn done(&self) {
        if let Some(bar) = &self.bar {
            bar.finish();
        }
    }
}
