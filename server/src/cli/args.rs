//! The command line of `ldi-server`.

use crate::build::Shard;
use crate::serve::HttpAt;
use clap::{Args, Parser, Subcommand};
use glam::DVec3;
use ldi_protocol::client_profile::{self, ClientProfile};
use std::io::Read as _;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::path::PathBuf;
use std::time::Duration;

/// Precomputes layered depth images of big 3D scenes and streams them to walkers on the LAN.
#[derive(Debug, Parser)]
#[command(
    name = "ldi-server",
    version,
    about,
    after_help = "\
First minute:
  ldi-server build house.glb -o dataset        precompute (minutes for a building of a million triangles)
  ldi-server serve dataset                     prints the address and the fingerprint to connect with
  ldi-client walk 127.0.0.1:4433 --fingerprint HEX --path walk.json --size 1280x720 -o frames --report walk.json

Exit codes: 0 done, 1 failed but a retry may help, 2 wrong usage, 42 failed for good (bad input).
Logs go to stderr; RUST_LOG=debug shows more."
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Write a built-in scene as GLB.
    #[command(after_help = "Example: ldi-server scene plant --triangles 2000000 --seed 1 -o plant.glb")]
    Scene(SceneArgs),
    /// Build a dataset from a scene.
    #[command(after_help = "\
Examples:
  ldi-server build clinic.glb -o clinic.ldi --budget 10%
  ldi-server build 'builtin:house?triangles=300000&seed=1' -o house.ldi --budget 30000 --report build.json
  ldi-server build house.ifc pipes.ifc 'garden.obj?unit=cm' -o site.ldi --budget 10%
  ldi-server build plant.glb -o tour.ldi --budget 100000 --along tour.path.json --within 2
  ldi-server build town.glb -o town.ldi --represent grid --shard 1/4     on each of four machines another share, then all of it
  ldi-server build builtin:house -o rooms.ldi --represent portals --portal-images both --portal-references 13
A build that was stopped goes on where it was when the same command is given again.")]
    Build(Box<BuildArgs>),
    /// Say what is in a dataset, how big it is, what was skipped and why.
    #[command(after_help = "Example: ldi-server inspect clinic.ldi --json | jq .bytes")]
    Inspect(InspectArgs),
    /// Find rooms and the openings between them, or read them from the scene; draw the plan.
    #[command(after_help = "\
Examples:
  ldi-server rooms clinic.glb -o plan.svg
  ldi-server rooms clinic.glb --override corrections.toml -o plan.svg --json clinic.ldi/rooms.json
  ldi-server rooms builtin:house --auto --check 1000      found, compared with the scene's own rooms, and judged by rays
The file of corrections is described in docs/user/rooms.md.")]
    Rooms(RoomsArgs),
    /// Make a walk through a scene or a dataset, as a path file.
    #[command(after_help = "\
Examples:
  ldi-server tour clinic.ldi -o clinic.tour.json
  ldi-server tour clinic.glb -o clinic.tour.json --seconds 300 --seed 2
The walk keeps to the walk volume, clear of walls; another seed gives another walk.")]
    Tour(TourArgs),
    /// Check every hash and every bound of a dataset; with --guarantee, audit all promises over
    /// many poses.
    #[command(after_help = "\
Examples:
  ldi-server verify clinic.ldi
  ldi-server verify clinic.ldi --guarantee --poses 100000 --json audit.json")]
    Verify(VerifyArgs),
    /// Say what `select` answers along a path.
    #[command(after_help = "Example: ldi-server plan clinic.ldi --poses clinic.path.json -o plan.jsonl")]
    Plan(PlanArgs),
    /// Render the ground truth along a path by ray casting.
    #[command(after_help = "\
Example: ldi-server render clinic.glb --path clinic.path.json --size 1280x720 --samples 16 --depth --every 100 -o truth")]
    Render(RenderArgs),
    /// Serve a dataset over QUIC, and its plan over HTTP.
    #[command(after_help = "\
Examples:
  ldi-server serve clinic.ldi --listen 0.0.0.0:4433 --http 127.0.0.1:8080
  ldi-server serve clinic.ldi --config serve.toml --check     is all as it should be?

SIGHUP reloads the dataset, the token and the certificate; walkers inside stay.")]
    Serve(ServeArgs),
    /// Show the server's identity, or replace it in two steps.
    #[command(after_help = "\
Examples:
  ldi-server identity --prepare      makes the next certificate; running servers announce it after SIGHUP
  ldi-server identity --switch       takes it, when all clients have met it; then SIGHUP")]
    Identity(IdentityArgs),
    /// Print completions for a shell.
    #[command(after_help = "\
Example: ldi-server completions bash > ~/.local/share/bash-completion/completions/ldi-server")]
    Completions {
        /// Shell.
        shell: clap_complete::Shell,
    },
    /// Write man pages, one for each command.
    #[command(after_help = "Example: ldi-server man -o ~/.local/share/man/man1")]
    Man {
        /// Folder for the pages.
        #[arg(short, long, value_name = "DIR")]
        output: PathBuf,
    },
}

/// Options of commands that show progress.
#[derive(Debug, Clone, Default, Args)]
pub struct ProgressArgs {
    /// Show no progress; warnings and errors are shown.
    #[arg(short, long, conflicts_with = "progress")]
    pub quiet: bool,
    /// Form of the progress on standard error [default: a bar on a terminal, else plain lines].
    #[arg(long, value_enum, hide_short_help = true, hide_possible_values = true, value_name = "bar|plain|json")]
    pub progress: Option<ProgressForm>,
}

/// Form of the progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum ProgressForm {
    /// A bar with rate and remaining time.
    Bar,
    /// A line every ten seconds, and one at the end of each stage.
    Plain,
    /// A JSON object per line, every second.
    Json,
}

/// `ldi-server scene`.
#[derive(Debug, Args)]
pub struct SceneArgs {
    /// pipes, house, plant, island, church or town.
    pub name: String,
    /// Triangles to aim at, instances counted.
    #[arg(long)]
    pub triangles: Option<u64>,
    /// Seed of everything random in it.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// File to write.
    #[arg(short, long, value_name = "FILE.glb")]
    pub output: PathBuf,
}

/// `ldi-server build`.
#[derive(Debug, Args)]
// So that what is wrong with a negative number is said by whoever takes it.
#[command(allow_negative_numbers = true)]
pub struct BuildArgs {
    /// .gltf, .glb, .obj, .ply, .stl, .ifc, or builtin:NAME; several are one scene.
    ///
    /// FILE?up=z&unit=mm&missing=plain where it is not in metres with Y up (units m, cm, mm, in, ft)
    /// or pictures are missing; builtin:NAME?triangles=N&seed=S. Several files are models of one
    /// project.
    #[arg(required = true, value_name = "SCENE")]
    pub scenes: Vec<String>,
    /// Directory to make.
    #[arg(short, long, value_name = "DATASET", required_unless_present = "dry_run")]
    pub output: Option<PathBuf>,
    /// Plan and audit only: say what the build would take and whether its promises hold.
    ///
    /// In words and, where standard output is no terminal, as JSON; nothing else is written.
    #[arg(long, help_heading = "Dry run")]
    pub dry_run: bool,
    /// With --dry-run: JSON only, on a terminal too.
    #[arg(long, requires = "dry_run", help_heading = "Dry run")]
    pub json: bool,
    /// With --dry-run: draw the plan, see `ldi-server inspect --help`.
    #[arg(long, value_name = "FILE.svg|.png", requires = "dry_run", help_heading = "Dry run")]
    pub plan: Option<PathBuf>,
    /// With --plan: draw this path over it, and say how much of it lies inside.
    #[arg(long, value_name = "PATH.json", requires = "plan", help_heading = "Dry run", hide_short_help = true)]
    pub path: Option<PathBuf>,
    /// Random poses of a dry run's audit.
    #[arg(long, default_value_t = 10_000, requires = "dry_run", help_heading = "Dry run", hide_short_help = true)]
    pub poses: u64,
    /// Its adversarial poses, on borders of every kind [default: a tenth of the random ones].
    #[arg(long, requires = "dry_run", help_heading = "Dry run", hide_short_help = true)]
    pub adversarial: Option<u64>,
    /// Geometry budget P: triangles per frame, or a share of the scene's, as 10%
    /// [default: by --for].
    #[arg(long, value_name = "N|PERCENT%", value_parser = budget)]
    pub budget: Option<Budget>,
    /// The client that the budget is for: cpu, laptop, workstation, or a file by `ldi-client
    /// calibrate`.
    ///
    /// Where geometry with its levels of detail takes no longer than images would, there are no
    /// images. `build` says which budgets it tried.
    #[arg(long = "for", value_name = "CLIENT", default_value = "cpu", value_parser = client)]
    pub client: ClientProfile,
    /// With --for: bytes of images per byte of the scene, at most; a smaller budget takes more.
    #[arg(long, value_name = "N", default_value_t = 4.0, value_parser = positive, help_heading = "Quality", hide_short_help = true)]
    pub bytes_per_scene_byte: f64,
    /// Optimization budget Popt, what images aim at
    /// [default: P; with --grid paper P - max(10% of P, 2 x the largest pseudo-leaf)].
    #[arg(long, help_heading = "Research", hide_short_help = true)]
    pub optimize_budget: Option<u64>,
    /// LDI samples per output pixel pitch: 1, 1.5 or 2.
    #[arg(long, default_value_t = 1.0, value_parser = density, help_heading = "Quality", hide_short_help = true)]
    pub density: f64,
    /// Colour coding of images.
    ///
    /// Exact, or exact as long as an image takes at most 0.95 (high) or 0.55 (compact) bytes per
    /// sample; compact codes textures nearly, too.
    #[arg(long, default_value = "high", value_parser = ["lossless", "high", "compact"], help_heading = "Quality")]
    pub colour: String,
    /// How the eyes are covered.
    #[arg(long, default_value = "cells", value_parser = ["paper", "cells"], help_heading = "Research", hide_short_help = true)]
    pub grid: String,
    /// Horizontal field of view in degrees, at least 54.
    #[arg(long, default_value_t = 60.0, help_heading = "Quality", hide_short_help = true)]
    pub fov: f64,
    /// Output size the dataset is made for.
    #[arg(long, default_value = "1280x720", value_parser = size)]
    pub size: (u32, u32),
    /// Largest sample footprint, output pixels.
    #[arg(long, default_value_t = 2.0, help_heading = "Quality", hide_short_help = true)]
    pub max_footprint: f64,
    /// Farthest that near geometry may lie from where it is, output pixels; 0: always in full.
    ///
    /// What is far enough is drawn with fewer triangles.
    #[arg(long, default_value_t = 0.5, value_parser = deviation, help_heading = "Quality")]
    pub max_deviation: f64,
    /// Free look up and down, degrees.
    #[arg(long, default_value_t = 60.0, help_heading = "Quality", hide_short_help = true)]
    pub pitch: f64,
    /// Eyes about this high above any floor, metres.
    #[arg(long, default_value_t = 1.6, conflicts_with = "fly", help_heading = "Where people walk")]
    pub eye_height: f64,
    /// The whole box of the scene.
    #[arg(long, help_heading = "Where people walk")]
    pub fly: bool,
    /// People start here and walk wherever they get to from there, metres [default: found].
    ///
    /// A place on a floor or an eye above it. May be given more than once.
    #[arg(long, value_name = "X,Y,Z", conflicts_with_all = ["fly", "along"], value_parser = place, allow_hyphen_values = true, help_heading = "Where people walk")]
    pub start: Vec<DVec3>,
    /// Only near this path, for guided tours and for trying a large scene.
    #[arg(long, value_name = "PATH.json", conflicts_with = "fly", help_heading = "Where people walk")]
    pub along: Option<PathBuf>,
    /// With --along: so far to its sides, up and down, metres.
    #[arg(long, value_name = "M", default_value_t = 1.0, requires = "along", value_parser = positive, help_heading = "Where people walk", hide_short_help = true)]
    pub within: f64,
    /// Representations to build: auto, grid, portals, tree or cache.
    ///
    /// Grid (images of placements, over the coarse levels of an LDI
    /// tree), portals (rooms, with images of what lies beyond their portals, and the grid's where
    /// that exceeds the budget, over the same), tree (the LDI tree alone) or cache (geometry and
    /// the coarse levels of an LDI tree, for clients that make images themselves: --method cache);
    /// grid,tree is whichever keeps --max-footprint with fewer bytes; auto is grid, or portals if
    /// the scene names rooms, or --find-rooms or --rooms is given, and they take fewer bytes and
    /// break no promise.
    #[arg(long, default_value = "auto", value_delimiter = ',')]
    pub represent: Vec<String>,
    /// With --represent tree: smallest distance of samples, metres.
    #[arg(long, value_name = "M", default_value_t = 0.01, value_parser = positive, help_heading = "Research", hide_short_help = true)]
    pub tree_pitch: f64,
    /// With --represent tree: pixels along a side of each of a reference's six images.
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=2048), help_heading = "Research", hide_short_help = true)]
    pub tree_reference: u32,
    /// Rooms as `ldi-server rooms --json` writes them.
    ///
    /// With --represent portals or auto [default: the scene's own; with portals else found].
    #[arg(long, value_name = "FILE", help_heading = "Rooms")]
    pub rooms: Option<PathBuf>,
    /// With --represent portals or auto: find rooms even if the scene names its own; where there
    /// are none, auto takes the grid.
    #[arg(long, conflicts_with = "rooms", help_heading = "Rooms", hide_short_help = true)]
    pub find_rooms: bool,
    /// With --represent portals: eyes nearer than this to a portal see geometry beyond it, metres.
    #[arg(long, value_name = "M", default_value_t = crate::portal::NEAR_M, value_parser = positive, help_heading = "Research", hide_short_help = true)]
    pub portal_near: f64,
    /// With --represent portals: images of what lies beyond portals: ours (for boxes of eyes, with
    /// a bound on their samples' size), paper (reference images from a semicircle before each
    /// portal, and a layered image merged from them, as of 1998), or both.
    #[arg(long, value_name = "WHICH", default_value = "ours", value_parser = ["ours", "paper", "both"], help_heading = "Research", hide_short_help = true)]
    pub portal_images: String,
    /// With --portal-images paper or both: reference images on each side of a portal, an odd
    /// number [default: 13].
    #[arg(long, value_name = "N", help_heading = "Research", hide_short_help = true)]
    pub portal_references: Option<usize>,
    /// Likewise: radius of the semicircle, metres from the portal's middle [default: 2].
    #[arg(long, value_name = "M", help_heading = "Research", hide_short_help = true)]
    pub portal_radius: Option<f64>,
    /// Likewise: the part of the semicircle that the images are spread over, degrees; eyes more
    /// than 60 degrees off the portal's normal see geometry [default: 120].
    #[arg(long, value_name = "DEG", help_heading = "Research", hide_short_help = true)]
    pub portal_arc: Option<f64>,
    /// Likewise: depths that differ by at most this share are one in merging [default: 0.02].
    #[arg(long, value_name = "SHARE", help_heading = "Research", hide_short_help = true)]
    pub portal_same_depth: Option<f64>,
    /// After this time no image is begun any more. Seconds, or as 90s, 20m, 3h.
    ///
    /// The dataset works, what is not made is softer, and the same command goes on with it.
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub time_limit: Option<Duration>,
    /// Hold at most so much memory, as 6GB or 800MB [default: no limit].
    ///
    /// What is not in use lies in a file beside the output, and the disk needs room for it.
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    pub memory_limit: Option<u64>,
    /// Threads [default: all cores].
    #[arg(long)]
    pub threads: Option<usize>,
    /// Make and keep share I of N of the images only, as another process makes another share in the
    /// same folder; the same command without it then writes the dataset.
    #[arg(long, value_name = "I/N", conflicts_with_all = ["dry_run", "report"], hide_short_help = true)]
    pub shard: Option<Shard>,
    /// Also write the report here; it is always in the dataset as report.json.
    #[arg(long)]
    pub report: Option<PathBuf>,
    /// Progress.
    #[command(flatten)]
    pub progress: ProgressArgs,
}

/// `ldi-server inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Dataset directory.
    pub dataset: PathBuf,
    /// JSON, with every cell's bounds, triangles and source ranges.
    #[arg(long)]
    pub json: bool,
    /// Draw storey by storey where people walk and where not and why, rooms and grid points, as SVG
    /// or PNG.
    #[arg(long, value_name = "FILE.svg|.png")]
    pub plan: Option<PathBuf>,
    /// With --plan: draw instead the floor plans that the map shows, with the names of rooms.
    #[arg(long, requires = "plan")]
    pub floors: bool,
    /// With --plan: draw this path over it, and say how much of it lies inside.
    #[arg(long, value_name = "PATH.json", requires = "plan")]
    pub path: Option<PathBuf>,
}

/// `ldi-server rooms`.
#[derive(Debug, Args)]
pub struct RoomsArgs {
    /// Scene, or several, as for `build`.
    #[arg(required = true, value_name = "SCENE")]
    pub scenes: Vec<String>,
    /// Draw the plan: storeys below each other, cells coloured and named, portals as lines.
    #[arg(short, long, value_name = "FILE.svg")]
    pub output: Option<PathBuf>,
    /// Write cells and portals; as rooms.json in a dataset, `inspect --plan` draws them.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// TOML file of corrections: rename, merge, split, remove, add.
    #[arg(long = "override", value_name = "FILE")]
    pub overrides: Option<PathBuf>,
    /// Find rooms even if the scene names its own, and compare with those.
    #[arg(long)]
    pub auto: bool,
    /// Judge culling from this many random poses by a ray per pixel.
    #[arg(long, default_value_t = 0, value_name = "POSES")]
    pub check: u32,
    /// Pixels of a pose's picture there: many poses with few rays each find other faults than few
    /// with many.
    #[arg(long, default_value = "320x200", value_parser = size)]
    pub check_size: (u32, u32),
    /// Another number gives other poses; those that sort cells into rooms are none of them.
    #[arg(long, default_value_t = 1, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub check_seed: u32,
    /// Write figures as JSON.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Threads [default: all cores].
    #[arg(long)]
    pub threads: Option<usize>,
    /// Progress.
    #[command(flatten)]
    pub progress: ProgressArgs,
}

/// `ldi-server tour`.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct TourArgs {
    /// Dataset; or a scene, or several, as for `build`.
    #[arg(required = true, value_name = "SCENE|DATASET")]
    pub scenes: Vec<String>,
    /// Path file to write.
    #[arg(short, long, value_name = "PATH.json")]
    pub output: PathBuf,
    /// Length, seconds.
    #[arg(long, default_value_t = 60.0, value_parser = tour_length)]
    pub seconds: f64,
    /// Another number gives another walk.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Of a scene: eyes about this high above any floor, metres [default: 1.6].
    #[arg(long, value_name = "M", conflicts_with = "fly", value_parser = positive)]
    pub eye_height: Option<f64>,
    /// Of a scene: anywhere in its box.
    #[arg(long)]
    pub fly: bool,
    /// Of a scene: people start here, as for `build`; may be given more than once.
    #[arg(long, value_name = "X,Y,Z", conflicts_with = "fly", value_parser = place, allow_hyphen_values = true)]
    pub start: Vec<DVec3>,
    /// Threads [default: all cores].
    #[arg(long)]
    pub threads: Option<usize>,
    /// Progress.
    #[command(flatten)]
    pub progress: ProgressArgs,
}

/// `ldi-server verify`.
#[derive(Debug, Args)]
pub struct VerifyArgs {
    /// Dataset directory.
    pub dataset: PathBuf,
    /// Audit frame cost and footprint by brute force.
    #[arg(long)]
    pub guarantee: bool,
    /// Count the triangles of every cell over this scene, as for `build`, instead of over the
    /// dataset's list of them; a triangle in no cell, in two, or outside of its cell is an error.
    /// Given once for each file of a dataset of several, in their order.
    #[arg(long = "scene", value_name = "SCENE", requires = "guarantee")]
    pub scenes: Vec<String>,
    /// Random poses of the audit.
    #[arg(long, default_value_t = 100_000, requires = "guarantee")]
    pub poses: u64,
    /// Adversarial poses, on borders of every kind [default: a tenth of the random ones].
    #[arg(long, requires = "guarantee")]
    pub adversarial: Option<u64>,
    /// Seed of the audit's poses.
    #[arg(long, default_value_t = 1, requires = "guarantee")]
    pub seed: u64,
    /// Write the audit here instead of to stdout.
    #[arg(long, requires = "guarantee")]
    pub json: Option<PathBuf>,
    /// Progress.
    #[command(flatten)]
    pub progress: ProgressArgs,
}

/// `ldi-server plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// Dataset directory.
    pub dataset: PathBuf,
    /// Path file.
    #[arg(long, value_name = "PATH.json")]
    pub poses: PathBuf,
    /// One JSON object per pose and line.
    #[arg(short, long, value_name = "PLAN.jsonl")]
    pub output: PathBuf,
}

/// `ldi-server render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Scene, or several, as for `build`.
    #[arg(required = true, value_name = "SCENE")]
    pub scenes: Vec<String>,
    /// Path file.
    #[arg(long, value_name = "PATH.json")]
    pub path: PathBuf,
    /// Picture size.
    #[arg(long, value_parser = size)]
    pub size: (u32, u32),
    /// Samples per pixel, a square number: a regular grid, box-filtered in linear light; 1 is the
    /// pixel centre.
    #[arg(long, default_value_t = 16)]
    pub samples: u32,
    /// Filter textures trilinearly by the ray's footprint.
    #[arg(long)]
    pub mips: bool,
    /// Also write eye-space depth in metres at pixel centres, frame_NNNNN.f32.
    #[arg(long)]
    pub depth: bool,
    /// Horizontal field of view, degrees.
    #[arg(long, default_value_t = 60.0)]
    pub fov: f64,
    /// Render poses 0, N, 2N ...
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub every: u64,
    /// Hold at most so much memory, as 6GB or 800MB; what is not in use lies in a file beside the
    /// output, and the disk needs room for it [default: no limit].
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    pub memory_limit: Option<u64>,
    /// Threads [default: all cores].
    #[arg(long)]
    pub threads: Option<usize>,
    /// Directory for the frames.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Progress.
    #[command(flatten)]
    pub progress: ProgressArgs,
}

/// `ldi-server serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Dataset, or a folder of datasets, which are served by the names of their folders.
    pub dataset: PathBuf,
    /// QUIC address or name, with port [default: 127.0.0.1:4433]; port 0 picks a free one.
    #[arg(long, value_name = "HOST:PORT", value_parser = address)]
    pub listen: Option<SocketAddr>,
    /// HTTP address or name, with port, or `off` [default: 127.0.0.1:8080]; port 0 picks a free
    /// one.
    #[arg(long, value_name = "HOST:PORT", value_parser = http_address)]
    pub http: Option<HttpAt>,
    /// TOML file with the same settings and the limits; options given here win.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Print the page's address as a QR code, for a telephone on the same network.
    #[arg(long)]
    pub qr: bool,
    /// File with the token that clients must show.
    #[arg(long)]
    pub token_file: Option<PathBuf>,
    /// PEM or DER file of your own certificate, instead of the one that the server makes.
    #[arg(long, value_name = "FILE", requires = "key")]
    pub certificate: Option<PathBuf>,
    /// PEM or DER file of its private key.
    #[arg(long, value_name = "FILE", requires = "certificate")]
    pub key: Option<PathBuf>,
    /// Check dataset, settings, token and certificate, and do not serve.
    #[arg(long)]
    pub check: bool,
    /// Form of the log on standard error.
    #[arg(long, value_enum, default_value = "plain")]
    pub log: LogForm,
}

/// Form of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LogForm {
    /// Lines for people.
    Plain,
    /// One JSON object per line.
    Json,
}

/// `ldi-server identity`.
#[derive(Debug, Args)]
pub struct IdentityArgs {
    /// Folder of the identity
    /// [default: $XDG_STATE_HOME/ldi-server, else ~/.local/state/ldi-server].
    pub folder: Option<PathBuf>,
    /// Make the identity that will replace this one, unless it is there.
    #[arg(long, conflicts_with = "switch")]
    pub prepare: bool,
    /// Replace the identity by the next one.
    #[arg(long)]
    pub switch: bool,
}

/// A picture size like 1280x720, with sides from 16 to 8192.
pub fn size(s: &str) -> Result<(u32, u32), String> {
    let wrong = || format!("'{s}' is not a size like 1280x720, with sides from 16 to 8192");
    let (w, h) = s.split_once('x').ok_or_else(wrong)?;
    let side = |t: &str| t.parse::<u32>().ok().filter(|n| (16..=8192).contains(n)).ok_or_else(wrong);
    Ok((side(w)?, side(h)?))
}

/// An address, or the first of a name's.
fn address(s: &str) -> Result<SocketAddr, String> {
    let found = s
        .to_socket_addrs()
        .map_err(|e| format!("{e}; an address and a port are needed, as 0.0.0.0:4433 or localhost:4433"))?;
    found.into_iter().next().ok_or_else(|| "the name has no address".to_string())
}

/// An address or a name, or `off`.
fn http_address(s: &str) -> Result<HttpAt, String> {
    if s == "off" { Ok(HttpAt(None)) } else { address(s).map(HttpAt::from) }
}

/// A time as 90, 90s, 20m or 3h.
fn deviation(s: &str) -> Result<f64, String> {
    let px: f64 = s.parse().map_err(|_| format!("not a number of pixels: {s}"))?;
    if px >= 0.0 && px.is_finite() { Ok(px) } else { Err("0 or more pixels".into()) }
}

fn duration(s: &str) -> Result<Duration, String> {
    let (number, unit) = match s.char_indices().next_back() {
        Some((at, 's')) => (&s[..at], 1.0),
        Some((at, 'm')) => (&s[..at], 60.0),
        Some((at, 'h')) => (&s[..at], 3600.0),
        _ => (s, 1.0),
    };
    let seconds = number.parse::<f64>().ok().map(|n| n * unit).filter(|n| *n >= 0.0);
    seconds
        .and_then(|s| Duration::try_from_secs_f64(s).ok())
        .ok_or_else(|| "a time is needed, as 90s, 20m or 3h".into())
}

/// Bytes, as 6GB, 800MB or 1000000.
fn bytes(s: &str) -> Result<u64, String> {
    let units = [("GB", 1e9), ("MB", 1e6), ("KB", 1e3), ("B", 1.0)];
    let upper = s.to_ascii_uppercase();
    let (number, unit) = units.iter().find_map(|(u, of)| Some((upper.strip_suffix(u)?, *of))).unwrap_or((&upper, 1.0));
    let bytes = number.trim().parse::<f64>().ok().map(|n| n * unit).filter(|n| *n >= 1.0 && *n < 1e18);
    bytes.map(|n| n as u64).ok_or_else(|| "a size is needed, as 6GB or 800MB".into())
}

/// A place in the world as X,Y,Z.
fn place(s: &str) -> Result<DVec3, String> {
    let numbers: Vec<f64> =
        s.split(',').filter_map(|n| n.trim().parse().ok()).filter(|n: &f64| n.is_finite()).collect();
    match (numbers[..].try_into(), s.split(',').count()) {
        (Ok(xyz), 3) => Ok(DVec3::from_array(xyz)),
        _ => Err("three numbers of metres are needed, as 1.5,0,-3".into()),
    }
}

/// Seconds of a tour: at least one, and no more poses than a path file may have.
fn tour_length(s: &str) -> Result<f64, String> {
    let seconds = s.parse().ok().filter(|s: &f64| (1.0..=30_000.0).contains(s));
    seconds.ok_or_else(|| "a number of seconds from 1 to 30000 is needed".into())
}

fn positive(s: &str) -> Result<f64, String> {
    s.parse().ok().filter(|v: &f64| *v > 0.0 && v.is_finite()).ok_or_else(|| "a number above 0 is needed".to_string())
}

/// A geometry budget as it is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Budget {
    /// Triangles per frame.
    Triangles(u64),
    /// Of the scene's triangles, above 0 and at most 1.
    Share(f64),
}

/// A client's profile by name, or from a file.
fn client(s: &str) -> Result<ClientProfile, String> {
    if let Some(profile) = ClientProfile::named(s) {
        return Ok(profile);
    }
    let wrong = |e: &dyn std::fmt::Display| {
        format!("choose cpu, laptop or workstation, or give a file by `ldi-client calibrate -o FILE`; {s}: {e}")
    };
    let file = std::fs::File::open(s).map_err(|e| wrong(&e))?;
    let mut text = String::new();
    file.take(client_profile::MAX_FILE_BYTES).read_to_string(&mut text).map_err(|e| wrong(&e))?;
    ClientProfile::from_json(&text).map_err(|e| wrong(&e))
}

fn budget(s: &str) -> Result<Budget, String> {
    let found = match s.strip_suffix('%') {
        Some(percent) => {
            percent.parse().ok().filter(|p: &f64| *p > 0.0 && *p <= 100.0).map(|p| Budget::Share(p / 100.0))
        }
        None => s.parse().ok().filter(|n| *n > 0).map(Budget::Triangles),
    };
    found.ok_or_else(|| "a number of triangles above 0 is needed, or a share up to 100% as 10%".into())
}

fn density(s: &str) -> Result<f64, String> {
    match s {
        "1" | "1.0" => Ok(1.0),
        "1.5" => Ok(1.5),
        "2" | "2.0" => Ok(2.0),
        _ => Err("is 1, 1.5 or 2".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_listens_on_addresses_and_names() {
        assert_eq!(address("0.0.0.0:4433"), Ok(SocketAddr::from(([0, 0, 0, 0], 4433))));
        assert!(address("localhost:80").is_ok_and(|a| a.ip().is_loopback() && a.port() == 80));
        for wrong in ["4433", "0.0.0.0", "localhost", ""] {
            assert!(address(wrong).is_err_and(|e| e.contains("localhost:4433")), "{wrong}");
        }
    }

    #[test]
    fn http_is_answered_at_an_address_or_not() {
        assert_eq!(http_address("off"), Ok(HttpAt(None)));
        assert_eq!(http_address("[::1]:80").map(|a| a.0.is_some()), Ok(true));
        assert!(http_address("on").is_err());
    }

    #[test]
    fn times_have_units() {
        let seconds = |s: &str| duration(s).map(|d| d.as_secs_f64());
        assert_eq!(["90", "90s", "1.5m", "2h"].map(seconds), [Ok(90.0), Ok(90.0), Ok(90.0), Ok(7200.0)]);
        for wrong in ["", "m", "-1", "3d", "nan", "infs"] {
            assert!(duration(wrong).is_err_and(|e| e.contains("20m")), "{wrong}");
        }
    }

    #[test]
    fn places_are_three_numbers() {
        assert_eq!(place("1.5, 0,-3"), Ok(DVec3::new(1.5, 0.0, -3.0)));
        for wrong in ["", "1,2", "1,2,3,4", "1,x,3", "1,nan,3", "1,,2,3"] {
            assert!(place(wrong).is_err_and(|e| e.contains("1.5,0,-3")), "{wrong}");
        }
    }

    #[test]
    fn clients_are_names_or_files() {
        assert_eq!(client("laptop").map(|p| p.name), Ok("laptop".into()));
        let e = client("no/such.json").unwrap_err();
        assert!(e.contains("choose cpu, laptop or workstation") && e.contains("no/such.json"), "{e}");
        let file = std::env::temp_dir().join(format!("ldi-client-{}.json", std::process::id()));
        for (text, fits) in [
            (r#"{"name": "tablet", "ns_per_triangle": 9, "ns_per_pixel": 2, "ns_per_sample": 30}"#, true),
            (r#"{"name": "tablet", "ns_per_triangle": 9}"#, false),
        ] {
            std::fs::write(&file, text).unwrap();
            assert_eq!(client(&file.to_string_lossy()).is_ok(), fits, "{text}");
        }
        std::fs::remove_file(&file).unwrap();
    }

    #[test]
    fn budgets_are_triangles_or_shares() {
        assert_eq!(budget("135000"), Ok(Budget::Triangles(135_000)));
        assert_eq!((budget("10%"), budget("2.5%")), (Ok(Budget::Share(0.1)), Ok(Budget::Share(0.025))));
        for wrong in ["0", "-1", "1.5", "0%", "-3%", "101%", "nan%", "inf%", "%", "", "ten"] {
            assert!(budget(wrong).is_err_and(|e| e.contains("10%")), "{wrong}");
        }
    }
}
