//! Where eyes see sky: what some reference positions saw, and by which of them an eye goes.

use crate::{sky::SkyMap, volume::WalkVolume};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Where an eye stood when the tree was made, and where it saw sky.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SkyPlace {
    /// Of the eye.
    pub position: DVec3,
    /// What it saw.
    pub sky: SkyMap,
}

/// The skies of a tree.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Skies {
    /// Reference positions with the sky they saw.
    pub places: Vec<SkyPlace>,
    /// By run of the walk volume ([`WalkVolume::run_at`]): the place that eyes there go by: of the nearest the one that is right in most directions. Empty: eyes go by the nearest.
    pub of_run: Vec<u16>,
}

impl Skies {
    /// The sky that an eye goes by; outside of the volume that of the nearest place.
    pub fn at(&self, eye: DVec3, volume: Option<&WalkVolume>) -> Option<&SkyMap> {
        let run = volume.and_then(|v| v.run_at(eye));
        let told = run.and_then(|r| self.places.get(usize::from(*self.of_run.get(r)?)));
        let distance = |s: &&SkyPlace| s.position.distance_squared(eye);
        told.or_else(|| self.places.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))).map(|s| &s.sky)
    }

    /// # Errors
    /// The first broken rule, in words.
    pub(super) fn check(&self) -> Result<(), String> {
        if self.places.iter().any(|s| !s.position.is_finite()) {
            return Err("a reference position is not finite".into());
        }
        match self.of_run.iter().find(|place| usize::from(**place) >= self.places.len()) {
            Some(place) => Err(format!("eyes go by the sky of place {place}, there are {}", self.places.len())),
            None => Ok(()),
        }
    }
}
