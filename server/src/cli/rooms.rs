//! `ldi-server rooms`: cells and portals of a scene, as a plan, as JSON, judged.

use super::Failure;
use super::args::RoomsArgs;
use super::commands::threads;
use super::outputs::{print, write_file, write_json};
use super::progress::Stderr;
use crate::build::Progress as _;
use crate::octree::{Clusters, Octree};
use crate::portal::{self, Statistics};
use crate::render::Caster;
use crate::scene::{self, Scene};
use crate::walk_volume::{self, WalkOptions};
use anyhow::{Context as _, anyhow};
use ldi_protocol::index::Index;
use ldi_protocol::rooms::{self, Rooms};
use ldi_protocol::{Aabb, OutputCamera};
use serde_json::json;
use std::path::Path;
use std::sync::Arc;

/// Eyes by which it is found where people walk, metres above the floor.
const EYE_HEIGHT_M: f64 = 1.6;
/// Name of the file of rooms beside a dataset's report.
pub(super) const FILE: &str = "rooms.json";

pub(super) fn rooms(a: &RoomsArgs) -> Result<(), Failure> {
    threads(a.threads)?;
    let progress = Stderr::new(&a.progress);
    progress.stage("loading", 0);
    let name = a.scenes.join(" + ");
    let scene = Arc::new(scene::load_all(&a.scenes).map_err(|e| Failure::of(e.is_permanent(), e))?);
    let annotated = portal::annotated_rooms(&scene).map_err(Failure::permanent)?;
    let compare = annotated.clone().filter(|_| a.auto);
    let needs_rays = a.auto || annotated.is_none() || a.check > 0;
    if needs_rays {
        progress.stage("sorting triangles for rays", 0);
    }
    let (caster, found) = needs_rays.then(|| in_cells(&scene)).unzip();
    let (cells, walked) = found.unwrap_or((Vec::new(), Aabb::EMPTY));
    let (mut rooms, statistics) = match (annotated, &caster) {
        (Some(rooms), _) if !a.auto => (rooms, None),
        (_, Some(caster)) => {
            progress.stage("looking for rooms", 0);
            let found = portal::find_rooms(caster, &walked).map_err(Failure::permanent)?;
            (found.rooms, Some(found.statistics))
        }
        (_, None) => (Rooms::default(), None),
    };
    if let Some(file) = &a.overrides {
        let text = std::fs::read_to_string(file)
            .with_context(|| format!("cannot read {}", file.display()))
            .map_err(Failure::permanent)?;
        rooms = portal::apply_overrides(&rooms, file, &text).map_err(Failure::permanent)?;
    }
    if let Some(file) = &a.output {
        write_file(file, portal::plan_svg(&rooms, &name).as_bytes())?;
    }
    if let Some(file) = &a.json {
        write_file(file, &serde_json::to_vec(&rooms).map_err(Failure::permanent)?)?;
    }
    let comparison = compare.map(|annotated| portal::compare(&annotated, &rooms));
    let check = caster.as_ref().filter(|_| a.check > 0).map(|caster| {
        progress.stage("sorting cells into rooms", 0);
        let members = portal::cells_of_rooms(caster, &rooms, cells.len());
        let poses = portal::random_poses(caster, &rooms, a.check as usize, u64::from(a.check_seed));
        progress.stage("checking against rays", poses.len() as u64);
        let (width, height) = a.check_size;
        let camera = OutputCamera { width, height, fov_deg: 60.0 };
        portal::check_sight(caster, &cells, &rooms, &members, &poses, &camera, &|| progress.advance(1))
    });
    progress.finish();
    print(&summary(&name, &rooms, statistics.as_ref()))?;
    if let Some(c) = &comparison {
        print(&format!(
            "against the annotation: cells {} found, {} missed, {} invented; portals {} found, {} missed, {} invented; corners within {:.3} m",
            c.cells_found.len(),
            c.cells_missed.len(),
            c.cells_invented.len(),
            c.portals_found.len(),
            c.portals_missed.len(),
            c.portals_invented.len(),
            c.corner_error_max_m
        ))?;
    }
    if let Some(c) = &check {
        print(&format!(
            "against rays: from {} of {} poses a surface is seen that would not be drawn ({} of {} rays, {} of them through joints of the model narrower than {} mm), from {} one in a room that culling does not report, though other rooms draw it mostly ({} rays); {:.2} cells reported, {:.2} reached per pose; {:.0} us each; in {} all of space counts as seen",
            c.poses_left_out,
            c.poses,
            c.left_out_rays,
            c.rays,
            c.left_out_rays_in_joints,
            portal::JOINT_M * 1e3,
            c.poses_with_a_miss,
            c.missed_rays,
            c.cells_reported_mean,
            c.cells_reached_mean,
            c.cull_us_mean,
            c.everything_seen
        ))?;
    }
    if let Some(file) = &a.report {
        let report = json!({ "scene": name, "search": statistics, "comparison": comparison, "check": check });
        write_json(file, &report)?;
    }
    Ok(())
}

/// Rays against a scene in the octree's cells of a build with a tenth of its triangles, and the
/// bounds of these.
fn in_cells(scene: &Arc<Scene>) -> (Caster, (Vec<Aabb>, Aabb)) {
    let clusters = Clusters::build(scene);
    let octree = Octree::build(scene, &clusters, scene.triangles() / 10);
    let bounds = octree.cells.iter().map(|c| c.bounds).collect();
    let caster = Caster::new(scene.clone(), &clusters, &octree);
    let options = WalkOptions { eye_height_m: Some(EYE_HEIGHT_M), ..WalkOptions::default() };
    let walked = match walk_volume::walk_volume(&caster, &clusters, &octree, &options) {
        Ok((volume, _)) => walk_volume::surroundings(&volume, &scene.bounds()),
        Err(_) => scene.bounds(),
    };
    (caster, (bounds, walked))
}

fn summary(scene: &str, rooms: &Rooms, statistics: Option<&Statistics>) -> String {
    let boxes: usize = rooms.cells().iter().map(|c| c.boxes.len()).sum();
    let mut text = format!("{scene}: {} cells ({boxes} boxes), {} portals", rooms.cells().len(), rooms.portals().len());
    match statistics {
        None => text += ", from the scene's annotations",
        Some(s) => {
            let kinds: Vec<String> = s
                .portals
                .iter()
                .map(|(k, n)| format!("{n} {k}{}", if k.ends_with("ch") { "es" } else { "s" }))
                .collect();
            let seconds: f64 = s.seconds.iter().map(|s| s.1).sum();
            text += &format!(" ({}), found in {seconds:.1} s", kinds.join(", "));
            if s.rays > 0 {
                text += &format!("; {} of {} rays leak", s.leaking_rays, s.rays);
            }
            if s.joined > 0 {
                text += &format!("; {} pairs of rooms joined", s.joined);
            }
            if let Some(why) = &s.no_cells {
                text += &format!("; no rooms: {why}");
            }
        }
    }
    text
}

/// The rooms of a dataset: those of its rooms.json, else those that it is walked by.
pub(super) fn rooms_of_dataset(dataset: &Path, index: &Index) -> Result<Option<Rooms>, Failure> {
    let file = dataset.join(FILE);
    if !file.exists() {
        return Ok(index.rooms.as_ref().map(|r| r.rooms.clone()));
    }
    let read = || -> anyhow::Result<Rooms> {
        let length = std::fs::metadata(&file).with_context(|| format!("cannot read {}", file.display()))?.len();
        if length > rooms::MAX_JSON_BYTES as u64 {
            return Err(anyhow!("{}: {length} bytes are too many", file.display()));
        }
        let text = std::fs::read(&file).with_context(|| format!("cannot read {}", file.display()))?;
        Rooms::from_json(&text).with_context(|| file.display().to_string())
    };
    read().map(Some).map_err(Failure::permanent)
}
