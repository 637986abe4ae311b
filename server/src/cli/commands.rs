//! What each command does.

use super::Failure;
use super::args::{
    Budget, BuildArgs, Command, IdentityArgs, InspectArgs, PlanArgs, RenderArgs, SceneArgs, ServeArgs, VerifyArgs,
};
use super::datasets::OnDisk;
use super::outputs::{cannot_write, check_writable, make_folder, print, write_file, write_json};
use super::paths::{path_in_dataset, path_in_scene, warn_of_misfit};
use super::progress::Stderr;
use crate::build::{self, BudgetRule, BuildError, BuildOptions, PortalOptions, Progress as _, Represent, RoomSource};
use crate::octree;
use crate::placement::{self, PlacementError};
use crate::plan as floor_plan;
use crate::render::{self, Caster};
use crate::scene::{self, builtin};
use crate::serve::{self, Datasets as _, Identity, IdentityError, ServeConfig, ServeError};
use crate::store::{self, Dataset};
use crate::walk_volume::{Corridor, WalkError, WalkReport};
use anyhow::{Context as _, anyhow};
use glam::DVec3;
use ldi_protocol::OutputCamera;
use ldi_protocol::codec::ColourProfile;
use ldi_protocol::floor_plan::FloorPlan;
use ldi_protocol::index::{BuildSettings, Index};
use ldi_protocol::path::Walk;
use ldi_protocol::room_index::BuiltImages;
use ldi_protocol::rooms::Rooms;
use std::io::{BufWriter, IsTerminal as _, Write as _};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;

/// Runs a command.
pub fn run(command: Command) -> Result<(), Failure> {
    match command {
        Command::Scene(a) => write_scene(&a),
        Command::Build(a) => build_dataset(*a),
        Command::Inspect(a) => inspect(&a),
        Command::Rooms(a) => super::rooms::rooms(&a),
        Command::Tour(a) => super::tour::tour(&a),
        Command::Verify(a) => verify(&a),
        Command::Plan(a) => plan(&a),
        Command::Render(a) => render(&a),
        Command::Serve(a) => serve(a),
        Command::Identity(a) => identity(&a),
        Command::Completions { shell } => super::shell::completions(shell),
        Command::Man { output } => super::shell::man(&output),
    }
}

fn write_scene(a: &SceneArgs) -> Result<(), Failure> {
    let made = builtin::build(&a.name, a.triangles, a.seed).map_err(Failure::usage)?;
    let bytes = scene::glb_write::glb_bytes(&made.scene).map_err(Failure::permanent)?;
    write_file(&a.output, &bytes)?;
    let path = a.output.with_extension("path.json");
    let waypoints: Vec<[f64; 3]> = made.waypoints.iter().map(|w| w.to_array()).collect();
    let file = serde_json::json!({ "eye_height": 1.6, "waypoints": waypoints, "closed": false });
    write_file(&path, file.to_string().as_bytes())?;
    let s = &made.scene;
    println!(
        "{}: {} triangles ({} unique), {} instances, {} rooms, {} portals; a walk through it: {}",
        a.output.display(),
        s.triangles(),
        s.unique_triangles(),
        s.instances.len(),
        s.rooms.len(),
        s.portals.len(),
        path.display()
    );
    Ok(())
}

fn build_dataset(a: BuildArgs) -> Result<(), Failure> {
    for r in &a.represent {
        match r.as_str() {
            "auto" | "grid" | "tree" | "portals" | "cache" => {}
            _ => {
                return Err(Failure::usage(anyhow!(
                    "--represent: there is no '{r}'; choose auto, grid, portals, tree or cache"
                )));
            }
        }
    }
    limit_memory(a.memory_limit, a.output.as_deref())?;
    threads(a.threads)?;
    let colour = ColourProfile::from_name(&a.colour)
        .ok_or_else(|| Failure::usage(anyhow!("--colour: there is no '{}'", a.colour)))?;
    let (budget, rule) = match a.budget {
        Some(Budget::Triangles(n)) => (n, BudgetRule::Given),
        _ if a.optimize_budget.is_some() => {
            return Err(Failure::usage(anyhow!("--optimize-budget needs --budget as a number of triangles")));
        }
        // 0 until the scene is read.
        Some(Budget::Share(share)) => (0, BudgetRule::Share(share)),
        None => (0, BudgetRule::For { profile: a.client.clone(), bytes_per_scene_byte: a.bytes_per_scene_byte }),
    };
    if let Some(popt) = a.optimize_budget.filter(|p| *p == 0 || *p > budget) {
        return Err(Failure::usage(anyhow!("--optimize-budget {popt} must lie between 1 and the budget, {budget}")));
    }
    let asked = |what: &str| a.represent.iter().any(|r| r == what);
    let only = |name: &str| a.represent.iter().all(|r| r == name);
    let (portals, along) = (asked("portals"), a.along.is_some());
    if portals && asked("tree") {
        return Err(Failure::absent("--represent portals together with tree"));
    }
    let by_rooms = portals || only("auto");
    if !by_rooms && (a.rooms.is_some() || a.find_rooms) {
        return Err(Failure::usage(anyhow!("--rooms and --find-rooms go with --represent portals or auto")));
    }
    if along && (portals || a.rooms.is_some() || a.find_rooms) {
        return Err(Failure::absent("--along with rooms"));
    }
    let walk = a.along.as_deref().map(|file| path_in_scene(file, &a.scenes)).transpose()?;
    let portal_options = portal_options(&a, portals)?;
    let rooms = match (a.rooms, a.find_rooms) {
        // A scene within the budget never asks for it.
        (Some(file), _) if !file.is_file() => {
            return Err(Failure::permanent(anyhow!("--rooms: {} is not there", file.display())));
        }
        (Some(file), _) => RoomSource::File(file),
        (None, true) => RoomSource::Found,
        (None, false) => RoomSource::Scene,
    };
    let represent = match (asked("auto") || asked("grid"), asked("tree")) {
        // Beside anything else it adds nothing: cached images are made from what every dataset has.
        _ if only("cache") => Represent::Cache,
        _ if portals && only("portals") => Represent::Portals { rooms, portals: portal_options },
        // What is planned depends on images, and near a path rooms are not known to be whole.
        _ if (portals || only("auto")) && !a.dry_run && !along => Represent::Auto { rooms, portals: portal_options },
        (true, true) => Represent::Smaller,
        (false, true) => Represent::Tree { pitch_m: a.tree_pitch, side: a.tree_reference },
        _ => Represent::Grid,
    };
    let options = BuildOptions {
        scenes: a.scenes,
        output: a.output.unwrap_or_default(),
        colour,
        represent,
        starts: a.start,
        time_limit: a.time_limit,
        along: walk.map(|walk| Corridor::around(&walk, a.within)),
        budget: rule,
        settings: BuildSettings {
            budget,
            optimize_budget: a.optimize_budget.unwrap_or(0),
            camera: OutputCamera { width: a.size.0, height: a.size.1, fov_deg: a.fov },
            max_footprint_px: a.max_footprint,
            max_deviation_px: a.max_deviation,
            pitch_deg: a.pitch,
            density: a.density,
            colour: a.colour,
            grid: a.grid,
            eye_height_m: (!a.fly).then_some(a.eye_height),
        },
    };
    if let Some(file) = &a.report {
        check_writable(file)?;
    }
    let progress = Stderr::new(&a.progress);
    let failed = |e: BuildError| match e {
        BuildError::Walk(e @ WalkError::NowhereAlong { .. }) => {
            let file = a.along.as_ref().map_or_else(String::new, |file| file.display().to_string());
            Failure::permanent(anyhow::Error::new(e).context(format!("--along {file}")))
        }
        BuildError::Scene(e) => Failure::of(e.is_permanent(), e),
        BuildError::Store(e) => Failure::of(e.permanent(), e),
        BuildError::Placement(e @ (PlacementError::FieldOfView { .. } | PlacementError::Setting { .. })) => {
            Failure::usage(e)
        }
        BuildError::NoShares { .. } => Failure::usage(e),
        e => Failure::permanent(e),
    };
    if let Some(shard) = a.shard {
        let found = build::build_shard(&options, shard, &progress).map_err(failed)?;
        progress.finish();
        let rest = match found.missing {
            0 => "all shares are there: the same command without --shard writes the dataset".to_owned(),
            missing => format!("{missing} placements of other shares, or beyond the time limit, are missing"),
        };
        let (share, of, output) = (found.share, found.placements, options.output.display());
        return print(&format!("{output}: share {shard}, {share} of {of} placements; {rest}"));
    }
    if a.dry_run {
        if only("auto") && !along {
            tracing::warn!("a dry run plans the grid; `build` may take rooms instead, if the scene has any");
        }
        let (found, index) = build::dry_run(&options, audit_size(a.poses, a.adversarial), &progress).map_err(failed)?;
        progress.finish();
        tell_notes(&found.skipped);
        if let Some(file) = &a.plan {
            let path = a.path.as_deref().map(|path| path_in_dataset(path, &index)).transpose()?;
            draw_plan(file, &index, &[], (Some(&found.walk), None, path.as_ref()))?;
        }
        let json = serde_json::to_value(&found).map_err(Failure::permanent)?;
        match &a.report {
            Some(file) => write_json(file, &json)?,
            // Programs read it; people read words.
            None if a.json || !std::io::stdout().is_terminal() => print(&format!("{json:#}"))?,
            None => {}
        }
        if !a.json {
            eprintln!("{}", found.said());
        }
        return promises_kept(&found.audit);
    }
    let built = build::build(&options, &progress).map_err(failed)?;
    progress.finish();
    if let Some(file) = &a.report {
        write_json(file, &built.report)?;
    }
    let r = &built.report;
    for (number, note) in r["skipped"].as_array().into_iter().flatten().enumerate() {
        let [what, why] = ["what", "why"].map(|k| note[k].as_str().unwrap_or_default());
        let of_scene = number < built.of_scene;
        eprintln!("{}: {what} ({why})", if of_scene { "not as in the scene" } else { "not made" });
    }
    if let Some(choice) = &built.budget {
        eprintln!("{}", choice.said());
    }
    println!(
        "{}: {} images for {}, {:.1} MB, hash {}",
        options.output.display(),
        r["ldis"],
        match &r["rooms"] {
            serde_json::Value::Null => format!("{} grid points", r["grid"]["points"]),
            rooms => format!("{} portals of {} rooms", rooms["portals"], rooms["rooms"]),
        },
        r["bytes"]["total"].as_f64().unwrap_or(0.0) / 1e6,
        built.written.hash
    );
    Ok(())
}

/// Tells what of a scene was left out or changed on the way in.
fn tell_notes(notes: &[scene::Note]) {
    for note in notes {
        eprintln!("not as in the scene: {} ({})", note.what, note.why);
    }
}

/// What is shown beyond portals; refused where the options do not go together.
fn portal_options(a: &BuildArgs, portals: bool) -> Result<PortalOptions, Failure> {
    let mut options = PortalOptions { near_m: a.portal_near, ..PortalOptions::default() };
    options.images = match a.portal_images.as_str() {
        "paper" => BuiltImages::Paper,
        "both" => BuiltImages::Both,
        _ => BuiltImages::Ours,
    };
    let of_paper = [
        a.portal_references.is_some(),
        a.portal_radius.is_some(),
        a.portal_arc.is_some(),
        a.portal_same_depth.is_some(),
    ];
    if of_paper.contains(&true) && options.images == BuiltImages::Ours {
        return Err(Failure::usage(anyhow!(
            "--portal-references, -radius, -arc and -same-depth go with --portal-images paper or both"
        )));
    }
    if !portals && options.images != BuiltImages::Ours {
        return Err(Failure::usage(anyhow!("--portal-images goes with --represent portals")));
    }
    let s = &mut options.semicircle;
    s.references = a.portal_references.unwrap_or(s.references);
    s.radius_m = a.portal_radius.unwrap_or(s.radius_m);
    s.arc_deg = a.portal_arc.unwrap_or(s.arc_deg);
    s.check().map_err(|why| Failure::usage(anyhow!("images of portals: {why}")))?;
    options.same_depth = a.portal_same_depth.unwrap_or(options.same_depth);
    if !(0.0..1.0).contains(&options.same_depth) {
        return Err(Failure::usage(anyhow!("--portal-same-depth is a share from 0 to below 1")));
    }
    Ok(options)
}

fn inspect(a: &InspectArgs) -> Result<(), Failure> {
    if let Some(file) = &a.plan {
        let dataset = open(&a.dataset)?;
        let path = a.path.as_deref().map(|path| path_in_dataset(path, dataset.index())).transpose()?;
        let rooms = super::rooms::rooms_of_dataset(&a.dataset, dataset.index())?;
        let report = dataset.report().and_then(|r| serde_json::from_value(r["walk"].clone()).ok());
        let plans = if a.floors { &dataset.index().plans[..] } else { &[] };
        return draw_plan(file, dataset.index(), plans, (report.as_ref(), rooms.as_ref(), path.as_ref()));
    }
    let value = store::inspect(&open(&a.dataset)?, a.json).map_err(|e| Failure::of(e.permanent(), e))?;
    print(&if a.json { format!("{value:#}") } else { store::inspect_text(&value) })
}

/// Draws the plan of an index, as PNG or SVG by the file's name, and says how much of a path lies
/// inside. Without floor plans: where people walk and where not.
fn draw_plan(
    file: &Path,
    index: &Index,
    plans: &[FloorPlan],
    (report, rooms, path): (Option<&WalkReport>, Option<&Rooms>, Option<&Walk>),
) -> Result<(), Failure> {
    let volume = index.volume.as_ref().ok_or_else(|| {
        Failure::permanent(anyhow!("{}: the dataset holds no walk volume; build it again", index.scene.name))
    })?;
    let points: Vec<DVec3> = index.points.iter().map(|p| p.position).collect();
    let subject = floor_plan::Subject {
        title: &index.scene.name,
        volume,
        eye_height_m: index.settings.eye_height_m,
        report,
        rooms,
        points: &points,
        path,
        plans,
    };
    let drawn = floor_plan::draw(&subject);
    match file.extension().and_then(|e| e.to_str()) {
        Some("png") => write_file(file, &drawn.png().map_err(Failure::permanent)?)?,
        Some("svg") => write_file(file, drawn.svg().as_bytes())?,
        _ => return Err(Failure::usage(anyhow!("--plan {}: the name must end in .svg or .png", file.display()))),
    }
    if let Some(path) = path {
        let (share, of) = floor_plan::inside(volume, path);
        print(&format!("{:.2}% of {of} poses of the path lie in the walk volume", share * 100.0))?;
    }
    Ok(())
}

fn verify(a: &VerifyArgs) -> Result<(), Failure> {
    let progress = Stderr::new(&a.progress);
    if !a.guarantee {
        let begin = |chunks: usize| progress.stage("hashing, then decoding", chunks as u64);
        let found = store::verify_heard(&a.dataset, &begin, &|| progress.advance(1));
        progress.finish();
        let found = found.map_err(|e| Failure::of(e.permanent(), e))?;
        for f in &found.faults {
            print(&f.to_string())?;
        }
        print(&format!(
            "{}: {} pages and {} chunks hashed, {} decoded, {} faults",
            a.dataset.display(),
            found.pages,
            found.chunks,
            found.decoded,
            found.faults.len()
        ))?;
        if found.faults.is_empty() {
            return Ok(());
        }
        if !found.all_known {
            print("chunks were not looked at: their list lies in what is damaged")?;
        }
        return Err(Failure::permanent(anyhow!("{} faults; {}", found.faults.len(), store::REPLACE)));
    }
    let dataset = open(&a.dataset)?;
    let ranges = dataset.source_ranges().map_err(|e| Failure::of(e.permanent(), e))?;
    let ranges = ranges.ok_or_else(|| {
        Failure::permanent(anyhow!(
            "{}: the file `source` is missing, so triangles cannot be counted again",
            a.dataset.display()
        ))
    })?;
    let index = dataset.index();
    let counts: Vec<u64> = match &a.scenes[..] {
        [] => ranges.iter().map(|cell| cell.iter().map(|r| u64::from(r.count)).sum()).collect(),
        names => {
            let scene = scene::load_all(names).map_err(|e| Failure::of(e.is_permanent(), e))?;
            let bounds: Vec<_> = index.cells.iter().map(|c| c.bounds).collect();
            octree::recount(&scene, &ranges, &bounds)
                .with_context(|| {
                    let name = names.join(" + ");
                    format!("{} was not built from {name}, or the scene has changed since", a.dataset.display())
                })
                .map_err(Failure::permanent)?
        }
    };
    let camera_of = |image: u32| {
        let first = *index.images.get(image as usize)?.chunks.first()?;
        ldi_protocol::codec::ldi::decode_first(&dataset.chunk(first).ok()?).ok().map(|ldi| ldi.camera)
    };
    let size = audit_size(a.poses, a.adversarial);
    progress.stage(&format!("audit of {} poses", size.random + size.adversarial), 0);
    let report = placement::audit(index, &counts, &camera_of, size, a.seed);
    let geometry = |chunk: u32| ldi_protocol::codec::cell::decode(&dataset.chunk(chunk).ok()?).ok();
    progress.stage("audit of levels of detail", 0);
    let levels = placement::audit_levels(index, &geometry, size.random, a.seed);
    progress.finish();
    let mut json = serde_json::to_value(&report).map_err(Failure::permanent)?;
    json["violations"] = (report.violations + levels.violations).into();
    json["levels"] = serde_json::to_value(&levels).map_err(Failure::permanent)?;
    match &a.json {
        Some(file) => write_json(file, &json)?,
        None => print(&serde_json::to_string_pretty(&json).map_err(Failure::permanent)?)?,
    }
    promises_kept(&report)?;
    eprintln!(
        "{} of {} levels of detail lie farther from the cells in full than the dataset says, of {} points",
        levels.violations, levels.levels, levels.points
    );
    if levels.violations > 0 {
        return Err(Failure::permanent(anyhow!("{} levels of detail deviate too far", levels.violations)));
    }
    Ok(())
}

/// A tenth as many adversarial poses as random ones, unless their number is given.
fn audit_size(random: u64, adversarial: Option<u64>) -> placement::AuditSize {
    placement::AuditSize { random, adversarial: adversarial.unwrap_or(random / 10) }
}

/// Whether all promises were kept; says so.
fn promises_kept(audit: &placement::AuditReport) -> Result<(), Failure> {
    eprintln!(
        "all promises, triangles, footprints and deviations, hold in {} of {} poses",
        audit.all_poses() - audit.violations.min(audit.all_poses()),
        audit.all_poses()
    );
    if audit.violations > 0 {
        return Err(Failure::permanent(anyhow!("{} of {} poses break a promise", audit.violations, audit.all_poses())));
    }
    Ok(())
}

fn plan(a: &PlanArgs) -> Result<(), Failure> {
    let dataset = open(&a.dataset)?;
    let walk = path_in_dataset(&a.poses, dataset.index())?;
    let file = std::fs::File::create(&a.output).map_err(|e| cannot_write(&a.output, e))?;
    let mut out = BufWriter::new(file);
    let mut write = || -> anyhow::Result<()> {
        for (index, p) in walk.poses.iter().enumerate() {
            let row = placement::plan_row(dataset.index(), index as u64, &p.pose);
            serde_json::to_writer(&mut out, &row)?;
            out.write_all(b"\n")?;
        }
        Ok(out.flush()?)
    };
    write().with_context(|| a.output.display().to_string()).map_err(|e| Failure::of(false, e))
}

/// Keeps the process to a limit by a file in the first folder above `output` that is there; the
/// system's folder for such files without an output.
fn limit_memory(bytes: Option<u64>, output: Option<&Path>) -> Result<(), Failure> {
    // Without it the kernel ends the program, without a word.
    #[cfg(target_os = "linux")]
    super::allocator::watch_memory().context("no thread can be started").map_err(|e| Failure::of(false, e))?;
    let Some(bytes) = bytes else { return Ok(()) };
    let beside = |output: &Path| {
        let full = std::path::absolute(output).ok()?;
        full.ancestors().find(|folder| folder.is_dir()).map(Path::to_path_buf)
    };
    let folder = output.and_then(beside).unwrap_or_else(std::env::temp_dir);
    super::allocator::limit_memory(bytes, &folder)
        .with_context(|| format!("--memory-limit: no file without a name can be made in {}", folder.display()))
        .map_err(|e| Failure::of(false, e))
}

fn render(a: &RenderArgs) -> Result<(), Failure> {
    limit_memory(a.memory_limit, Some(&a.output))?;
    threads(a.threads)?;
    let options = render::RenderOptions {
        camera: OutputCamera { width: a.size.0, height: a.size.1, fov_deg: a.fov },
        samples: a.samples,
        mips: a.mips,
        depth: a.depth,
        every: a.every as usize,
    };
    options.check().map_err(Failure::usage)?;
    let walk = path_in_scene(&a.path, &a.scenes)?;
    let scene = scene::load_all(&a.scenes).map_err(|e| Failure::of(e.is_permanent(), e))?;
    tell_notes(&scene.notes);
    let bounds = scene.bounds();
    let outside = walk.poses.iter().filter(|p| !bounds.contains(p.pose.position)).count();
    if !warn_of_misfit(&a.path, &walk, &bounds, None) && outside > 0 {
        let of = walk.poses.len();
        let [from, to] = [bounds.min, bounds.max].map(|p| format!("{:.1}, {:.1}, {:.1}", p.x, p.y, p.z));
        tracing::warn!("{outside} of {of} poses lie outside of the scene, which reaches from ({from}) to ({to})");
    }
    make_folder(&a.output)?;
    let progress = Stderr::new(&a.progress);
    let caster = Caster::of_scene(Arc::new(scene), a.mips);
    progress.stage("rendering", walk.poses.len().div_ceil(options.every) as u64);
    render::render_path(&caster, &walk, &options, &a.output, &mut |_, _| progress.advance(1))
        .map_err(|e| Failure::of(false, e))?;
    progress.finish();
    Ok(())
}

fn serve(a: ServeArgs) -> Result<(), Failure> {
    let mut config = match &a.config {
        Some(file) => ServeConfig::from_file(file).map_err(Failure::permanent)?,
        None => ServeConfig::default(),
    };
    config.listen = a.listen.unwrap_or(config.listen);
    config.http = a.http.unwrap_or(config.http);
    config.token_file = a.token_file.or(config.token_file);
    if a.certificate.is_some() {
        (config.certificate, config.key) = (a.certificate, a.key);
    }
    let failed = |e: ServeError| Failure::of(!matches!(e, ServeError::Bind { .. } | ServeError::Stdout(_)), e);
    if a.qr && config.http.0.is_none() {
        return Err(Failure::usage(anyhow!("--qr shows the address of the page: leave out --http off")));
    }
    let datasets = OnDisk::new(a.dataset);
    let stamp = datasets.stamp();
    let opened = datasets.open_checked(a.check)?;
    if a.check {
        let names: Vec<String> = opened.keys().cloned().collect();
        let fingerprint = serve::check(opened, &config).map_err(failed)?;
        names.iter().for_each(|name| println!("{name}: can be served; fingerprint={fingerprint}"));
        return Ok(());
    }
    let runtime =
        tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(|e| Failure::of(false, e))?;
    let page = |http: SocketAddr, reached: &[SocketAddr]| match a.qr.then(|| super::qr::shown(http, reached)) {
        Some(Ok(text)) => eprintln!("{text}"),
        Some(Err(e)) => tracing::warn!("--qr: {e:?}"),
        None => {}
    };
    runtime.block_on(serve::serve(Arc::new(datasets), (stamp, opened), config, &page)).map_err(failed)
}

fn identity(a: &IdentityArgs) -> Result<(), Failure> {
    let folder = a.folder.clone().or_else(serve::state_folder).ok_or(IdentityError::NoFolder);
    let shown = folder.and_then(|folder| match (a.prepare, a.switch) {
        (true, _) => Identity::prepare_next(&folder),
        (_, true) => Identity::switch(&folder),
        _ => Identity::in_folder(&folder),
    });
    let shown = shown.map_err(Failure::permanent)?;
    println!("fingerprint={}", shown.fingerprint());
    if let Some(days) = shown.days_left(SystemTime::now()) {
        println!("days={days}");
    }
    if let Some(next) = shown.next {
        println!("next={}", next.to_hex());
    }
    Ok(())
}

pub(super) fn open(path: &Path) -> Result<Dataset, Failure> {
    Dataset::open(path).map_err(|e| Failure::of(e.permanent(), e))
}

pub(super) fn threads(n: Option<usize>) -> Result<(), Failure> {
    match n {
        None => Ok(()),
        Some(0) => Err(Failure::usage(anyhow!("--threads 0: at least one is needed"))),
        Some(n) => rayon::ThreadPoolBuilder::new().num_threads(n).build_global().map_err(|e| Failure::of(false, e)),
    }
}
