//! `ldi-bench`: what the methods cost and how good they are, as tables, plots and pages.

use anyhow::{Context as _, Result, bail};
use clap::{Parser, Subcommand};
use ldi_client::{stream::LinkSpec, warp::Stamp};
use ldi_protocol::path::Walk;
use ldi_protocol::room_index::BuiltImages;
use ldi_protocol::said::{is_lasting, said};
use ldi_server::cli::size;
use ldi_server::placement::AuditSize;
use ldi_server::serve::planner::PlannerConfig;
use ldi_tests::args::percent;
use ldi_tests::bench::{
    decode, docs, matrix, matrix_page, numerics, numerics_page, occlusion, placement, placement_page, portals,
    portals_page, searches, speed_error, speed_error_page, streaming, tree, video,
};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Measures the methods over scenes and settings; leaves tables (CSV, JSON), plots (SVG) and a
/// page (HTML).
#[derive(Debug, Parser)]
#[command(name = "ldi-bench", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Images, pixels and time of image placement against the geometry budget (Figures 13 to 16
    /// and Table 1 of Aliaga and Lastra 1999).
    #[command(after_help = "\
Examples:
  ldi-bench placement clinic.glb -o out/placement
  ldi-bench placement builtin:plant?triangles=2000000 --budgets 12.5,25 --size 512x384 --pitch 0 --grids cells,paper -o out/plant")]
    Placement(PlacementArgs),
    /// Ways to search for near boxes, against trying every box: gap to the best, boxes tried, time.
    #[command(after_help = "\
Examples:
  ldi-bench searches clinic.glb --budget 10 -o out/searches")]
    Searches(SearchesArgs),
    /// Every reconstruction, order and density of the warp: milliseconds against error, on views
    /// of the scenes' paths.
    #[command(after_help = "\
Examples:
  ldi-bench speed-error clinic.glb -o out/speed
  ldi-bench speed-error clinic.glb house.glb --budget 10 --densities 1,2 --frames 12 -o out/speed
  ldi-bench speed-error clinic.glb --datasets clinic10 -o out/speed")]
    SpeedError(SpeedErrorArgs),
    /// The LDI tree against the number of its reference images (charts 1 to 3 of Chang, Bishop and
    /// Lastra 1999).
    #[command(after_help = "\
Examples:
  ldi-bench tree 'builtin:church?triangles=300000' -o out/tree
  ldi-bench tree clinic.glb --images 1,8,64 --side 256 -o out/tree")]
    Tree(TreeArgs),
    /// Portals by culling alone, textures, one and two depth images, layered images and ours,
    /// along a path (Figures 5 and 6 of Rafferty, Aliaga, Popescu and Lastra 1998).
    #[command(after_help = "\
Examples:
  ldi-server scene house -o house.glb; ldi-bench portals house.glb -o out/portals
  ldi-bench portals 'builtin:house?triangles=100000' --path house.path.json --frames 130 -o out/portals")]
    Portals(PortalArgs),
    /// Hard numerical cases: bound, why it holds, oracle, worst seen.
    #[command(after_help = "\
Examples:
  ldi-bench numerics -o out/numerics
  ldi-bench numerics --cases 10000000 --seed 2 -o out/numerics")]
    Numerics(NumericsArgs),
    /// Ways to send ahead of need on one walk over virtual links, in virtual time: frames that
    /// lack something, bytes that no frame needed.
    #[command(after_help = "\
Examples:
  ldi-bench streaming small_house --path small_house.path.json -o out/streaming
  ldi-bench streaming small_house --path small_house.path.json --link rate=25mbit,delay=40ms --decode-mb-s 15 --twice -o out/streaming")]
    Streaming(StreamingArgs),
    /// How fast one thread verifies and decodes each kind of chunk, as a client's cache takes it
    /// in.
    #[command(after_help = "\
Examples:
  ldi-bench decode clinic.ldi -o out/decode")]
    Decode(DecodeArgs),
    /// How many samples of images are hidden, and what culling them gains and loses: by tiles, as
    /// frames do, and by the octree that was proposed for it.
    #[command(after_help = "\
Examples:
  ldi-bench occlusion clinic.ldi --path clinic.path.json -o out/occlusion
  ldi-bench occlusion clinic.ldi --path clinic.path.json --leaves 16,1024 --views 40 -o out/occlusion")]
    Occlusion(OcclusionArgs),
    /// Every scene with default settings and with each single method: seconds, memory and bytes of
    /// the build; time, error, holes and bytes of a walk. Says where the default is dominated.
    #[command(after_help = "\
Examples:
  ldi-bench matrix clinic.glb small_house.glb -o out/matrix
  ldi-bench matrix clinic.glb 'builtin:plant?triangles=2000000' --build=--time-limit=5min --frames 12 -o out/matrix")]
    Matrix(MatrixArgs),
    /// The frames of a walk as video, as a server that renders every frame would stream them: bits
    /// per second against error. Needs ffmpeg.
    #[command(after_help = "\
Examples:
  ldi-server render house.glb --path house.path.json --size 640x360 --samples 4 --mips -o frames
  ldi-server render house.glb --path house.path.json --size 640x360 --samples 16 --every 60 -o truth
  ldi-bench video frames --truth truth --flip 0.03 -o out/video")]
    Video(VideoArgs),
    /// Writes the generated documentation: benchmark pages from docs/benchmarks/data, and the
    /// command reference.
    #[command(after_help = "\
Examples:
  ldi-bench docs
  ldi-bench docs --check")]
    Docs(DocsArgs),
}

#[derive(Debug, clap::Args)]
struct DocsArgs {
    /// Folder of the project.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// Write nothing; fail if a page is not up to date.
    #[arg(long)]
    check: bool,
}

#[derive(Debug, clap::Args)]
struct MatrixArgs {
    /// Scenes, as for `ldi-server build`; beside NAME.glb the path NAME.path.json is walked.
    #[arg(required = true)]
    scenes: Vec<String>,
    /// Folder for what is left, datasets and pictures included.
    #[arg(short, long)]
    output: PathBuf,
    /// Single methods beside the default.
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["grid", "portals", "tree", "cache", "levels", "geometry"])]
    methods: Vec<matrix::Setting>,
    /// Output size.
    #[arg(long, default_value = "1280x720", value_parser = size)]
    size: (u32, u32),
    /// Frames, evenly spaced over each path.
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    frames: u64,
    /// Walks per setting, in turns; times are their medians.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeats: u32,
    /// An option of all builds; give it again for another one.
    #[arg(long, value_name = "OPTION")]
    build: Vec<String>,
}

#[derive(Debug, clap::Args)]
struct VideoArgs {
    /// Folder of the frames (PNG), shown in the order of their names.
    frames: PathBuf,
    /// Folder of the truth of some frames, under the same names.
    #[arg(long)]
    truth: PathBuf,
    /// Frames per second.
    #[arg(long, default_value_t = 60.0)]
    fps: f64,
    /// Encoders.
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["x264", "x264-best", "x264-deep", "av1", "av1-deep"])]
    encoders: Vec<video::Encoder>,
    /// Quality settings: constant rate factors.
    #[arg(long, value_delimiter = ',', default_values_t = [2, 8, 14, 20, 26, 32, 38])]
    crf: Vec<u32>,
    /// Say what each encoder needs for this mean FLIP: that of `ldi-client walk` over the same
    /// frames.
    #[arg(long)]
    flip: Option<f64>,
    /// Folder for what is left.
    #[arg(short, long)]
    output: PathBuf,
}

#[derive(Debug, clap::Args)]
struct DecodeArgs {
    /// Directory of a dataset, as `ldi-server build` makes it; all of its chunks come into memory.
    dataset: PathBuf,
    /// Folder for what is left.
    #[arg(short, long)]
    output: PathBuf,
    /// Passes over all chunks; the median counts.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
}

#[derive(Debug, clap::Args)]
struct OcclusionArgs {
    /// Directory of a dataset, as `ldi-server build` makes it.
    dataset: PathBuf,
    /// Path file to walk.
    #[arg(long)]
    path: PathBuf,
    /// Folder for what is left.
    #[arg(short, long)]
    output: PathBuf,
    /// Most samples of an octree's leaf.
    #[arg(long, value_delimiter = ',', default_value = "16,64,256,1024", value_parser = clap::value_parser!(u32).range(1..))]
    leaves: Vec<u32>,
    /// Poses of the path, evenly spaced; those whose views show images count.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    views: u32,
    /// Output size.
    #[arg(long, default_value = "1280x720", value_parser = size)]
    size: (u32, u32),
}

#[derive(Debug, clap::Args)]
struct StreamingArgs {
    /// Directory of a dataset, as `ldi-server build` makes it.
    dataset: PathBuf,
    /// The walk.
    #[arg(long)]
    path: PathBuf,
    /// Folder for what is left.
    #[arg(short, long)]
    output: PathBuf,
    /// Links between server and client, as for `ldi-client walk`; give it again for another one.
    #[arg(long, default_values = ["rate=100mbit,delay=5ms", "rate=25mbit,delay=40ms"])]
    link: Vec<LinkSpec>,
    /// Output size.
    #[arg(long, default_value = "1280x720", value_parser = size)]
    size: (u32, u32),
    /// Stored bytes that the client decodes per second, in millions
    /// [default: measured here, one thread].
    #[arg(long)]
    decode_mb_s: Option<f64>,
    /// Decoded bytes of the client's cache.
    #[arg(long, default_value_t = 1 << 30)]
    cache_bytes: u64,
    /// What the server takes sending ahead to be worth, bytes: its setting `ahead_worth`.
    #[arg(long, default_value_t = PlannerConfig::default().ahead_worth)]
    ahead_worth: u64,
    /// Walk the path a second time.
    #[arg(long)]
    twice: bool,
}

#[derive(Debug, clap::Args)]
struct PortalArgs {
    /// Scenes with rooms, as for `ldi-server build`; beside NAME.glb the path NAME.path.json is
    /// walked.
    #[arg(required = true)]
    scenes: Vec<String>,
    /// Folder for what is left; datasets found there are used again.
    #[arg(short, long)]
    output: PathBuf,
    /// Walk this path instead.
    #[arg(long)]
    path: Option<PathBuf>,
    /// Output size.
    #[arg(long, default_value = "640x512", value_parser = size)]
    size: (u32, u32),
    /// Frames along the path.
    #[arg(long, default_value_t = 520, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Every so many of them are judged against 16 rays per pixel.
    #[arg(long, default_value_t = 13, value_parser = clap::value_parser!(u32).range(1..))]
    judge_every: u32,
    /// Reference images on each side of a portal, an odd number.
    #[arg(long, default_value_t = 13)]
    references: usize,
    /// Radius of the semicircle, metres.
    #[arg(long, default_value_t = 2.0)]
    radius: f64,
    /// The part of it that images are spread over, degrees.
    #[arg(long, default_value_t = 120.0)]
    arc: f64,
    /// Depths that differ by at most this share are one in merging.
    #[arg(long, default_value_t = ldi_server::construct::SAME_DEPTH)]
    same_depth: f64,
    /// Geometry budget of the dataset, percent of the scene's triangles.
    #[arg(long, default_value = "2", value_parser = percent)]
    budget: f64,
    /// Leave out our own images, which take most of the time.
    #[arg(long)]
    paper_only: bool,
}

#[derive(Debug, clap::Args)]
struct TreeArgs {
    /// Scene, as for `ldi-server build`; beside NAME.glb the path NAME.path.json is walked.
    scene: String,
    /// Folder for what is left.
    #[arg(short, long)]
    output: PathBuf,
    /// Numbers of reference images.
    #[arg(long, value_delimiter = ',', default_value = "1,2,4,8,16,32,64,128")]
    images: Vec<usize>,
    /// Pixels along a side of a reference image.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(16..=2048))]
    side: u32,
    /// Smallest distance of samples, metres.
    #[arg(long, default_value_t = 0.005)]
    pitch: f64,
    /// Output size.
    #[arg(long, default_value = "512x512", value_parser = size)]
    size: (u32, u32),
    /// Views along the path.
    #[arg(long, default_value_t = 24)]
    frames: usize,
}

#[derive(Debug, clap::Args)]
struct NumericsArgs {
    /// Folder for what is left.
    #[arg(short, long)]
    output: PathBuf,
    /// Random cases of each kind, at least.
    #[arg(long, default_value_t = 1_000_000, value_parser = clap::value_parser!(u64).range(1..))]
    cases: u64,
    /// Seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Debug, clap::Args)]
struct PlacementArgs {
    /// Scenes, as for `ldi-server build`; beside NAME.glb the path NAME.path.json is walked if it
    /// is there.
    #[arg(required = true)]
    scenes: Vec<String>,
    /// Folder for what is left.
    #[arg(short, long)]
    output: PathBuf,
    /// Geometry budgets, percent of the scene's triangles.
    #[arg(long, value_delimiter = ',', default_value = "1,2,5,10,25,50", value_parser = percent)]
    budgets: Vec<f64>,
    /// Ways to cover the eyes.
    #[arg(long, value_delimiter = ',', default_value = "cells", value_parser = ["cells", "paper"])]
    grids: Vec<String>,
    /// Output size.
    #[arg(long, default_value = "1280x720", value_parser = size)]
    size: (u32, u32),
    /// Free look up and down, degrees.
    #[arg(long, default_value_t = 60.0)]
    pitch: f64,
    /// Random poses of each plan's audit; a tenth as many adversarial ones are added.
    #[arg(long, default_value_t = 10_000)]
    poses: u64,
}

#[derive(Debug, clap::Args)]
struct SpeedErrorArgs {
    /// Scene files; beside NAME.glb the path NAME.path.json is walked.
    #[arg(required = true)]
    scenes: Vec<String>,
    /// Folder for what is left, datasets and pictures included; datasets found there are used
    /// again.
    #[arg(short, long)]
    output: PathBuf,
    /// Datasets to take instead of building, one per scene.
    #[arg(long, value_delimiter = ',', conflicts_with_all = ["densities", "budget"])]
    datasets: Vec<PathBuf>,
    /// Geometry budget, percent of the scene's triangles.
    #[arg(long, default_value = "10", value_parser = percent)]
    budget: f64,
    /// Samples per output pixel pitch of the datasets that are built.
    #[arg(long, value_delimiter = ',', default_value = "1")]
    densities: Vec<f64>,
    /// Output size.
    #[arg(long, default_value = "1280x720", value_parser = size)]
    size: (u32, u32),
    /// Views.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Repetitions of each measurement; their median counts.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Numbers of threads, the last for the pictures.
    #[arg(long, value_delimiter = ',', default_value = "1,2", value_parser = clap::value_parser!(u32).range(1..))]
    threads: Vec<u32>,
    /// Reconstructions [default: all].
    #[arg(long, value_delimiter = ',')]
    stamps: Vec<Stamp>,
}

#[derive(Debug, clap::Args)]
struct SearchesArgs {
    /// Scenes, as for `ldi-server build`.
    #[arg(required = true)]
    scenes: Vec<String>,
    /// Folder for what is left.
    #[arg(short, long)]
    output: PathBuf,
    /// Geometry budget, percent of the scene's triangles.
    #[arg(long, default_value = "10", value_parser = percent)]
    budget: f64,
    /// Most groups of view cells of each scene, those of the fewest first.
    #[arg(long, default_value_t = 24)]
    cases: usize,
}

fn main() -> ExitCode {
    match run(Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("ldi-bench: {}", said(e.as_ref()));
            // What no retry mends.
            let lasting = e.chain().filter_map(|cause| cause.downcast_ref::<std::io::Error>()).any(is_lasting);
            ExitCode::from(if lasting { 42 } else { 1 })
        }
    }
}

fn run(command: Command) -> Result<()> {
    match command {
        Command::Placement(a) => placement(a),
        Command::Searches(a) => searches(a),
        Command::SpeedError(a) => speed_error(a),
        Command::Numerics(a) => numerics(a),
        Command::Tree(a) => ldi_tree(a),
        Command::Streaming(a) => streaming(&a),
        Command::Decode(a) => decode_of(&a),
        Command::Portals(a) => portals_of(a),
        Command::Occlusion(a) => occlusion_of(&a),
        Command::Matrix(a) => matrix_of(a),
        Command::Video(a) => video_of(a),
        Command::Docs(a) => docs_of(&a),
    }
}

fn matrix_of(a: MatrixArgs) -> Result<()> {
    let study = matrix::Matrix {
        scenes: a.scenes,
        settings: a.methods,
        size: format!("{}x{}", a.size.0, a.size.1),
        frames: a.frames,
        repeats: a.repeats,
        build: a.build,
        output: a.output,
    };
    let rows = matrix::run(&study, |row| eprintln!("{}", matrix_page::line(row)))?;
    let dominated = matrix::dominated(&rows);
    let mut options: String = study.build.iter().map(|o| format!(" --build={o}")).collect();
    let methods = study.settings.iter().filter_map(clap::ValueEnum::to_possible_value);
    methods.for_each(|m| options += &format!(" --methods {}", m.get_name()));
    let (scenes, size, frames) = (study.scenes.join(" "), &study.size, study.frames);
    let command =
        format!("ldi-bench matrix {scenes} --size {size} --frames {frames} --repeats {}{options}", study.repeats);
    let json = serde_json::json!({ "command": command, "dominated": dominated, "rows": rows });
    write(&study.output.join("matrix.json"), &serde_json::to_string_pretty(&json)?)?;
    write(&study.output.join("matrix.csv"), &matrix_page::csv(&rows))?;
    write(&study.output.join("index.html"), &matrix_page::html(&rows, &command))?;
    dominated.iter().for_each(|d| println!("{}", matrix_page::sentence(d)));
    if dominated.is_empty() {
        println!("no default is dominated");
    }
    println!("look at {}", study.output.join("index.html").display());
    Ok(())
}

fn docs_of(a: &DocsArgs) -> Result<()> {
    let changed = if a.check { docs::stale(&a.root)? } else { docs::write(&a.root)? };
    changed.iter().for_each(|file| println!("{}", file.display()));
    if a.check && !changed.is_empty() {
        bail!("{} pages are not up to date: run `ldi-bench docs`", changed.len());
    }
    Ok(())
}

fn placement(a: PlacementArgs) -> Result<()> {
    std::fs::create_dir_all(&a.output).with_context(|| format!("cannot make {}", a.output.display()))?;
    let sweep = placement::Sweep {
        scenes: a.scenes,
        budgets_percent: a.budgets,
        grids: a.grids,
        size: a.size,
        pitch_deg: a.pitch,
        audit: AuditSize { random: a.poses, adversarial: a.poses / 10 },
    };
    let rows = placement::run(&sweep, &(), |r| match &r.error {
        Some(e) => eprintln!("{} {} {}%: {e}", r.scene, r.grid, r.budget_percent),
        None => eprintln!(
            "{} {} {}%: {} points, {} placements, {} images, {:.0} Mpx, {:.1} s, {} violations",
            r.scene,
            r.grid,
            r.budget_percent,
            r.points,
            r.placements,
            r.images,
            r.megapixels,
            r.seconds,
            r.audit.as_ref().map_or(0, |a| a.violations)
        ),
    })?;
    let plots = placement_page::plots(&rows);
    let command = typed();
    write(&a.output.join("placement.json"), &serde_json::to_string_pretty(&rows)?)?;
    write(&a.output.join("placement.csv"), &placement_page::csv(&rows))?;
    for (name, svg) in &plots {
        write(&a.output.join(format!("{name}.svg")), &placement_page::standalone(svg))?;
    }
    write(&a.output.join("index.html"), &placement_page::page(&sweep, &rows, &plots, &command))?;
    println!("look at {}", a.output.join("index.html").display());
    Ok(())
}

fn speed_error(a: SpeedErrorArgs) -> Result<()> {
    if !a.datasets.is_empty() && a.datasets.len() != a.scenes.len() {
        bail!("--datasets: {} for {} scenes; name one for each", a.datasets.len(), a.scenes.len());
    }
    std::fs::create_dir_all(&a.output).with_context(|| format!("cannot make {}", a.output.display()))?;
    let job = speed_error::Job {
        scenes: a.scenes,
        output: a.output.clone(),
        budget_percent: a.budget,
        // A given dataset has its own density.
        densities: if a.datasets.is_empty() { a.densities } else { vec![1.0] },
        datasets: a.datasets,
        size: a.size,
        frames: a.frames as usize,
        repeat: a.repeat as usize,
        threads: a.threads.iter().map(|t| *t as usize).collect(),
        stamps: if a.stamps.is_empty() { Stamp::ALL.to_vec() } else { a.stamps },
    };
    let found = speed_error::run(&job, &(), |r| eprintln!("{}", speed_error_page::line(r)))?;
    write(&a.output.join("speed-error.json"), &serde_json::to_string_pretty(&found)?)?;
    write(&a.output.join("speed-error.csv"), &speed_error_page::csv(&found.rows))?;
    if !found.colours.is_empty() {
        write(&a.output.join("colours.csv"), &speed_error_page::colours_csv(&found.colours))?;
    }
    let plots = speed_error_page::plots(&found.rows);
    for (name, svg) in &plots {
        write(&a.output.join(format!("{name}.svg")), &placement_page::standalone(svg))?;
    }
    write(&a.output.join("index.html"), &speed_error_page::page(&job, &found, &plots, &typed()))?;
    println!("look at {}", a.output.join("index.html").display());
    Ok(())
}

fn ldi_tree(a: TreeArgs) -> Result<()> {
    std::fs::create_dir_all(&a.output).with_context(|| format!("cannot make {}", a.output.display()))?;
    let study = tree::Study {
        scene: a.scene,
        images: a.images,
        side: a.side,
        pitch_m: a.pitch,
        size: a.size,
        frames: a.frames,
    };
    let rows = tree::run(&study, |r| eprintln!("{}", tree::line(r)))?;
    write(&a.output.join("tree.json"), &serde_json::to_string_pretty(&rows)?)?;
    write(&a.output.join("tree.csv"), &tree::csv(&rows))?;
    for (name, svg) in tree::plots(&rows) {
        write(&a.output.join(format!("{name}.svg")), &placement_page::standalone(&svg))?;
    }
    println!("look at {}", a.output.join("chart1.svg").display());
    Ok(())
}

fn portals_of(a: PortalArgs) -> Result<()> {
    std::fs::create_dir_all(&a.output).with_context(|| format!("cannot make {}", a.output.display()))?;
    let path = a.path.as_ref().map(|file| {
        let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        ldi_protocol::path::parse(&text).with_context(|| file.display().to_string())
    });
    let semicircle = ldi_server::portal::Semicircle { references: a.references, radius_m: a.radius, arc_deg: a.arc };
    if let Err(why) = semicircle.check() {
        bail!("--references, --radius, --arc: {why}");
    }
    let study = portals::Study {
        scenes: a.scenes,
        output: a.output.clone(),
        path: path.transpose()?,
        size: a.size,
        frames: a.frames as usize,
        judge_every: a.judge_every as usize,
        semicircle,
        same_depth: a.same_depth,
        built: if a.paper_only { BuiltImages::Paper } else { BuiltImages::Both },
        budget_percent: a.budget,
    };
    let all = portals::run(&study, &(), |what| eprintln!("{what}"))?;
    write(&a.output.join("portals.json"), &serde_json::to_string_pretty(&all)?)?;
    write(&a.output.join("portals.csv"), &portals_page::csv(&all))?;
    let table = portals_page::table(&all);
    write(&a.output.join("portals.md"), &format!("`{}`\n{table}", typed()))?;
    for (k, found) in all.iter().enumerate() {
        for (name, svg) in portals_page::plots(found) {
            write(&a.output.join(format!("{name}-{k}.svg")), &placement_page::standalone(&svg))?;
        }
    }
    print!("{table}");
    println!("look at {}", a.output.join("figure6-0.svg").display());
    Ok(())
}

fn streaming(a: &StreamingArgs) -> Result<()> {
    std::fs::create_dir_all(&a.output).with_context(|| format!("cannot make {}", a.output.display()))?;
    let walk = walk_of(&a.path)?;
    let study = streaming::Study {
        dataset: &a.dataset,
        walk: &walk,
        size: a.size,
        links: &a.link,
        decoded_per_s: a.decode_mb_s.map(|m| m * 1e6),
        cache_bytes: a.cache_bytes,
        ahead_worth: a.ahead_worth,
        twice: a.twice,
    };
    let found = streaming::run(&study, |r| eprintln!("{}", streaming::line(r)))?;
    write(&a.output.join("streaming.json"), &serde_json::to_string_pretty(&found)?)?;
    print!("{}", streaming::table(&found));
    Ok(())
}

fn walk_of(path: &Path) -> Result<Walk> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    ldi_protocol::path::parse(&text).with_context(|| path.display().to_string())
}

fn occlusion_of(a: &OcclusionArgs) -> Result<()> {
    std::fs::create_dir_all(&a.output).with_context(|| format!("cannot make {}", a.output.display()))?;
    let leaves: Vec<usize> = a.leaves.iter().map(|n| *n as usize).collect();
    let rows = occlusion::run(&a.dataset, &walk_of(&a.path)?, a.views as usize, a.size, &leaves)?;
    write(&a.output.join("occlusion.json"), &serde_json::to_string_pretty(&rows)?)?;
    print!("{}", occlusion::table(&rows));
    Ok(())
}

fn decode_of(a: &DecodeArgs) -> Result<()> {
    std::fs::create_dir_all(&a.output).with_context(|| format!("cannot make {}", a.output.display()))?;
    let kinds = decode::run(&a.dataset, a.repeat)?;
    write(&a.output.join("decode.json"), &serde_json::to_string_pretty(&kinds)?)?;
    print!("{}", decode::table(&kinds));
    Ok(())
}

fn video_of(a: VideoArgs) -> Result<()> {
    if !(a.fps.is_finite() && a.fps > 0.0) {
        bail!("--fps {}: a number above 0", a.fps);
    }
    let study = video::Study {
        frames: a.frames,
        truth: a.truth,
        fps: a.fps,
        encoders: a.encoders,
        crf: a.crf,
        flip: a.flip,
        output: a.output.clone(),
    };
    let found = video::run(&study, |r| eprintln!("{}", video::line(r)))?;
    write(&a.output.join("video.json"), &serde_json::to_string_pretty(&found)?)?;
    let table = video::table(&found, a.flip);
    write(&a.output.join("video.md"), &format!("`{}`\n\n{table}", typed()))?;
    print!("{table}");
    Ok(())
}

fn numerics(a: NumericsArgs) -> Result<()> {
    std::fs::create_dir_all(&a.output).with_context(|| format!("cannot make {}", a.output.display()))?;
    let cases = numerics::run(a.cases, a.seed);
    write(&a.output.join("numerics.json"), &serde_json::to_string_pretty(&cases)?)?;
    write(&a.output.join("numerics.csv"), &numerics_page::csv(&cases))?;
    write(&a.output.join("index.html"), &numerics_page::page(&cases, &typed()))?;
    print!("{}", numerics_page::table(&cases));
    println!("look at {}", a.output.join("index.html").display());
    let broken = cases.iter().filter(|c| !c.holds()).count();
    if broken > 0 {
        bail!("{broken} of {} bounds are broken", cases.len());
    }
    Ok(())
}

/// The command as it was typed.
fn typed() -> String {
    let command: Vec<String> = std::env::args().skip(1).collect();
    format!("ldi-bench {}", command.join(" "))
}

fn searches(a: SearchesArgs) -> Result<()> {
    std::fs::create_dir_all(&a.output).with_context(|| format!("cannot make {}", a.output.display()))?;
    let (mut rows, mut cases, mut groupings) = (Vec::new(), Vec::new(), Vec::new());
    for scene in &a.scenes {
        eprintln!("{scene}");
        let (of_scene, each, sets) = searches::run(scene, a.budget, a.cases)?;
        rows.extend(of_scene);
        cases.push((scene, each));
        groupings.push((scene, sets));
    }
    write(&a.output.join("searches.json"), &serde_json::to_string_pretty(&(&rows, &cases, &groupings))?)?;
    print!("{}", searches::table(&rows));
    groupings.iter().for_each(|(scene, sets)| print!("{}", searches::grouping_table(scene, sets)));
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}
