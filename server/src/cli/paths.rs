//! Path files that commands read, and what is said where one does not fit its scene.

use super::Failure;
use crate::scene;
use anyhow::{Context as _, anyhow};
use glam::DVec3;
use ldi_protocol::Aabb;
use ldi_protocol::index::Index;
use ldi_protocol::path::{self, PathError, Walk};
use ldi_protocol::volume::WalkVolume;
use std::path::Path;

/// Reads a path through a dataset; warns of one that would fit with a factor or with other axes.
pub(super) fn path_in_dataset(file: &Path, index: &Index) -> Result<Walk, Failure> {
    read(file, |places| path::misfit(places, &index.scene.bounds, index.volume.as_ref())).inspect(|walk| {
        warn_of_misfit(file, walk, &index.scene.bounds, index.volume.as_ref());
    })
}

/// Reads a path through a scene, which is read only where the path is too long for one.
pub(super) fn path_in_scene(file: &Path, scenes: &[String]) -> Result<Walk, Failure> {
    read(file, |places| path::misfit(places, &scene::load_all(scenes).ok()?.bounds(), None))
}

/// Warns of a path that does not lie in the scene, with the factor by which it would; returns
/// whether it did.
pub(super) fn warn_of_misfit(file: &Path, walk: &Walk, bounds: &Aabb, volume: Option<&WalkVolume>) -> bool {
    let places: Vec<DVec3> = walk.poses.iter().map(|p| p.pose.position).collect();
    let misfit = path::misfit(&places, bounds, volume);
    if let Some(misfit) = &misfit {
        tracing::warn!("{}: {misfit}", file.display());
    }
    misfit.is_some()
}

/// `misfit`: what says that places do not lie in the scene.
fn read(file: &Path, misfit: impl FnOnce(&[DVec3]) -> Option<String>) -> Result<Walk, Failure> {
    let walk = std::fs::File::open(file)
        .map_err(PathError::from)
        .and_then(|open| path::read(open, |told| tracing::warn!("{}: {told}", file.display())));
    let too_far = match &walk {
        Err(PathError::TooFar { places, .. }) => misfit(places),
        _ => None,
    };
    match too_far {
        Some(misfit) => Err(Failure::permanent(anyhow!("{}: {misfit}", file.display()))),
        None => walk.with_context(|| file.display().to_string()).map_err(Failure::permanent),
    }
}
