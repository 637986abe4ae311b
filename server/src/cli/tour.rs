//! `ldi-server tour`: a walk through a scene or a dataset, as a path file.

use super::Failure;
use super::args::TourArgs;
use super::commands::{open, threads};
use super::outputs::{check_writable, print, write_file};
use super::progress::Stderr;
use crate::build::Progress as _;
use crate::octree::{Clusters, Octree};
use crate::render::Caster;
use crate::scene;
use crate::store::is_dataset;
use crate::tour::{self, TourError, TourOptions};
use crate::walk_volume::{self, WalkOptions};
use anyhow::anyhow;
use ldi_protocol::path::Walk;
use ldi_protocol::volume::WalkVolume;
use std::path::Path;
use std::sync::Arc;

/// Triangles of a cell of the octree, as a share of the scene's: what a build with a budget of 10%
/// has.
const CELL_SHARE: u64 = 10;
/// Fastest that a tour gets on, metres per second.
const FASTEST_M_S: f64 = 1.4;

pub(super) fn tour(a: &TourArgs) -> Result<(), Failure> {
    threads(a.threads)?;
    check_writable(&a.output)?;
    let progress = Stderr::new(&a.progress);
    let (caster, volume, eye_height_m) = match &a.scenes[..] {
        [dataset] if is_dataset(Path::new(dataset)) => of_dataset(Path::new(dataset), a, &progress)?,
        _ => of_scenes(a, &progress)?,
    };
    progress.stage("tour", 0);
    let options = TourOptions { seconds: a.seconds, seed: a.seed, eye_height_m };
    let walk = tour::tour(&caster, &volume, &options).map_err(Failure::permanent)?;
    progress.finish();
    write_file(&a.output, walk.to_json().as_bytes())?;
    print(&format!("{}: {}", a.output.display(), said(&walk)))
}

/// Rays at what stands where people walk, where that is, and the eye height.
type Site = (Caster, WalkVolume, Option<f64>);

fn of_dataset(path: &Path, a: &TourArgs, progress: &Stderr) -> Result<Site, Failure> {
    if a.fly || a.eye_height.is_some() || !a.start.is_empty() {
        return Err(Failure::usage(anyhow!(
            "--start, --eye-height and --fly are for scenes: {} is a dataset, whose walk volume its build has made",
            path.display()
        )));
    }
    progress.stage("reading near geometry", 0);
    let dataset = open(path)?;
    let (scene, volume) = tour::near_geometry(&dataset, a.seconds * FASTEST_M_S, a.seed).map_err(|e| match e {
        TourError::Store(e) => Failure::of(e.permanent(), e),
        e => Failure::permanent(anyhow::Error::new(e).context(path.display().to_string())),
    })?;
    Ok((Caster::of_scene(Arc::new(scene), false), volume, dataset.index().settings.eye_height_m))
}

fn of_scenes(a: &TourArgs, progress: &Stderr) -> Result<Site, Failure> {
    progress.stage("reading the scene", 0);
    let scene = Arc::new(scene::load_all(&a.scenes).map_err(|e| Failure::of(e.is_permanent(), e))?);
    for doubt in scene::doubts(&a.scenes, &scene) {
        tracing::warn!("{}: {doubt}", a.scenes.join(" + "));
    }
    progress.stage("walk volume", 0);
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, (scene.triangles() / CELL_SHARE).max(1));
    let caster = Caster::new(Arc::clone(&scene), &clusters, &octree);
    let eye_height_m = (!a.fly).then_some(a.eye_height.unwrap_or(1.6));
    let options = WalkOptions { eye_height_m, starts: a.start.clone(), along: None };
    let (volume, report) =
        walk_volume::walk_volume(&caster, &clusters, &octree, &options).map_err(Failure::permanent)?;
    report.warnings.iter().for_each(|warning| tracing::warn!("walk volume: {warning}"));
    Ok((caster, volume, eye_height_m))
}

/// A tour in figures.
fn said(walk: &Walk) -> String {
    let places: Vec<_> = walk.poses.iter().map(|p| p.pose.position).collect();
    let metres: f64 = places.windows(2).map(|p| p[0].distance(p[1])).sum();
    let heights =
        places.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| [low.min(p.y), high.max(p.y)]);
    let seconds = walk.poses.len() as f64 / walk.fps;
    format!("{} poses in {seconds:.0} s, {metres:.0} m, over {:.1} m of height", places.len(), heights[1] - heights[0])
}
