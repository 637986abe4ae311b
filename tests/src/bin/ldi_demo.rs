//! `ldi-demo`: the main job in small. Builds a dataset, serves it on loopback, walks it over QUIC,
//! leaves a page.

use anyhow::{Context as _, Result};
use clap::Parser;
use ldi_tests::page::Page;
use ldi_tests::poses;
use ldi_tests::run::{self, Server};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Builds a dataset from a scene, serves it on loopback, walks through it over QUIC and leaves
/// OUT/index.html.
#[derive(Debug, Parser)]
#[command(
    name = "ldi-demo",
    version,
    after_help = "\
Examples:
  deploy/demo.sh
  deploy/demo.sh --open
  deploy/demo.sh clinic.glb clinic.path.json --budget 2% --frames 40 -o out/clinic"
)]
struct Options {
    /// Scene, as for `ldi-server build` [default: the built-in town].
    #[arg(requires = "path")]
    scene: Option<PathBuf>,
    /// Path file to walk along.
    path: Option<PathBuf>,
    /// Folder for everything the demo leaves.
    #[arg(short, long, default_value = "out/demo")]
    output: PathBuf,
    /// Geometry budget: triangles, or a share of the scene's such as `2%` [default: 100000 for the
    /// built-in town; else what `ldi-server build` chooses].
    #[arg(long)]
    budget: Option<String>,
    /// Frames, evenly spaced over the path.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    frames: u64,
    /// Picture size.
    #[arg(long, default_value = "1280x720")]
    size: String,
    /// Triangles of the built-in town.
    #[arg(long, default_value_t = 24_000_000)]
    triangles: u64,
    /// A small and fast run through the built-in house, for tests.
    #[arg(long)]
    quick: bool,
    /// Open the window on the dataset at the end.
    #[arg(long)]
    open: bool,
}

/// Runs commands one after the other, shows them as one would type them, and remembers them with
/// their seconds.
#[derive(Default)]
struct Steps(Vec<(String, f64)>);

impl Steps {
    fn run(&mut self, command: Command) -> Result<()> {
        let shown = run::show(&command);
        println!("$ {shown}");
        let start = Instant::now();
        run::run(command)?;
        self.0.push((shown, start.elapsed().as_secs_f64()));
        Ok(())
    }
}

fn main() -> Result<()> {
    let mut o = Options::parse();
    let builtin = if o.quick { "house" } else { "town" };
    if o.quick {
        (o.frames, o.size, o.triangles) = (o.frames.min(4), "320x180".into(), o.triangles.min(25_000));
        o.budget = Some("40%".into());
    } else if o.scene.is_none() {
        o.budget.get_or_insert_with(|| "100000".into());
    }
    std::fs::create_dir_all(&o.output).with_context(|| format!("cannot make {}", o.output.display()))?;
    let out = |name: &str| o.output.join(name);
    let mut steps = Steps::default();

    let (scene, path) = match (&o.scene, &o.path) {
        (Some(scene), Some(path)) => (scene.clone(), path.clone()),
        _ => {
            let mut c = run::command("ldi-server")?;
            let scene = out(&format!("{builtin}.glb"));
            c.args(["scene", builtin, "--seed", "1", "--triangles", &o.triangles.to_string(), "-o"]).arg(&scene);
            steps.run(c)?;
            (scene, out(&format!("{builtin}.path.json")))
        }
    };
    let poses_file = out("poses.json");
    let n = poses::spread(&path, o.frames, &poses_file)?;
    println!("walking {n} poses, evenly spaced over {}", path.display());

    let mut c = run::command("ldi-server")?;
    c.arg("build").arg(&scene).arg("-o").arg(out("dataset"));
    c.args(["--size", &o.size, "--report"]).arg(out("build.json"));
    if let Some(budget) = &o.budget {
        c.args(["--budget", budget]);
    }
    // Images of what is far, and only those that the walk can meet.
    c.args(["--represent", "grid", "--along"]).arg(&path);
    steps.run(c)?;
    for (samples, folder) in [("16", "truth"), ("1", "baseline")] {
        let mut c = run::command("ldi-server")?;
        c.arg("render").arg(&scene).arg("--path").arg(&poses_file).args(["--size", &o.size, "--samples", samples]);
        c.arg(if samples == "1" { "--mips" } else { "--depth" }).arg("-o").arg(out(folder));
        steps.run(c)?;
    }

    let server = Server::start(&out("dataset"))?;
    println!("serving on {}, plan on http://{}/", server.quic, server.http);
    let mut c = run::command("ldi-client")?;
    c.args(["walk", &server.quic, "--fingerprint", &server.fingerprint, "--path"]).arg(&poses_file);
    c.args(["--size", &o.size, "--pace", "wait", "--debug-views", "--truth"]).arg(out("truth"));
    c.arg("--baseline").arg(out("baseline")).arg("-o").arg(out("frames")).arg("--report").arg(out("walk.json"));
    steps.run(c)?;
    // The opponent: levels of detail of all that is in view, without images.
    let mut c = run::command("ldi-client")?;
    c.args(["walk", &server.quic, "--fingerprint", &server.fingerprint, "--path"]).arg(&poses_file);
    c.args(["--size", &o.size, "--pace", "wait", "--method", "levels", "-o"]).arg(out("levels"));
    c.arg("--report").arg(out("levels.json"));
    steps.run(c)?;

    let levels = read_json(&out("levels.json"))?;
    let (build, walk) = (read_json(&out("build.json"))?, read_json(&out("walk.json"))?);
    let page = Page {
        scene: &scene.file_stem().unwrap_or_default().to_string_lossy(),
        build: &build,
        walk: &walk,
        levels: &levels,
        scene_bytes: scene.metadata().with_context(|| format!("cannot read {}", scene.display()))?.len(),
        commands: &steps.0,
    };
    std::fs::write(out("index.html"), page.html())
        .with_context(|| format!("cannot write {}", out("index.html").display()))?;
    println!("look at {}", out("index.html").display());
    if o.open {
        let mut c = run::command("ldi-client")?;
        c.args(["connect", &server.quic, "--fingerprint", &server.fingerprint]);
        println!("$ {}", run::show(&c));
        let closed = c.status().context("cannot open the window")?;
        anyhow::ensure!(closed.success(), "the window ended with {closed}");
    }
    Ok(())
}

fn read_json(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{}", path.display()))
}
