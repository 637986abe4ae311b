//! Generated scenes that stand for what users bring, each with places where people walk and places
//! where nobody does.
//!
//! Scenes of 5,000 to 60,000 triangles with most detail where people are. Walked and unwalked
//! places are written down by hand beside the geometry, so that they judge the walk volume
//! independently of how it is found.

mod city;
mod furniture;
mod ground;
mod houses;
mod kit;
mod mine;
mod objects;
mod office;
mod scan;
mod stadium;
mod towers;

use glam::DVec3;
use ldi_server::render::{Caster, CellSet, Ray};
use ldi_server::scene::{Scene, glb_write};
use std::{path::Path, sync::Arc};

/// A generated scene, with places where people walk and places where nobody does.
#[derive(Debug, Clone)]
pub struct Specimen {
    /// Name, usable as a file name.
    pub name: &'static str,
    /// The scene, metres, Y up.
    pub scene: Scene,
    /// Height of the eyes above the floor, metres.
    pub eye_height_m: f64,
    /// Eye positions, metres, that the walk volume must hold.
    pub walked: Vec<DVec3>,
    /// Eye positions, metres, that the walk volume must not hold.
    pub unwalked: Vec<DVec3>,
}

/// Names and generators.
const SPECIMENS: [(&str, fn() -> Specimen); 13] = [
    ("hill_house", houses::hill_house),
    ("island_city", city::island_city),
    ("two_towers", towers::two_towers),
    ("mine", mine::mine),
    ("split_level", houses::split_level),
    ("stadium", stadium::stadium),
    ("pit", ground::pit),
    ("far_origin", houses::far_origin),
    ("spaceship", objects::spaceship),
    ("terrain", ground::terrain),
    ("statue", objects::statue),
    ("scan", scan::scan),
    ("closed_doors", office::closed_doors),
];

/// The specimens' names.
pub fn names() -> impl Iterator<Item = &'static str> {
    SPECIMENS.iter().map(|s| s.0)
}

/// All specimens; the same every time.
pub fn all() -> Vec<Specimen> {
    SPECIMENS.iter().map(|s| s.1()).collect()
}

/// The specimen of this name.
pub fn specimen(name: &str) -> Option<Specimen> {
    SPECIMENS.iter().find(|s| s.0 == name).map(|s| s.1())
}

/// Writes the specimen's scene as binary glTF.
///
/// # Errors
/// If the file cannot be written.
pub fn write_glb(specimen: &Specimen, file: &Path) -> anyhow::Result<()> {
    use anyhow::Context as _;
    let bytes = glb_write::glb_bytes(&specimen.scene).with_context(|| specimen.name.to_string())?;
    std::fs::write(file, bytes).with_context(|| format!("cannot write {}", file.display()))
}

/// Path file with a pose at each walked place, looking where the nearest surface is about
/// [`VIEW_M`] away.
pub fn walked_path(specimen: &Specimen) -> serde_json::Value {
    let caster = Caster::of_scene(Arc::new(specimen.scene.clone()), false);
    let poses: Vec<serde_json::Value> = specimen
        .walked
        .iter()
        .enumerate()
        .map(|(i, &eye)| {
            serde_json::json!({
                "t": i, "position": eye.to_array(), "yaw": view_yaw_deg(&caster, eye), "pitch": -8.0
            })
        })
        .collect();
    serde_json::json!({ "fps": 1, "eye_height": specimen.eye_height_m, "poses": poses })
}

/// Distance of what a picture from a walked place should show, metres.
const VIEW_M: f64 = 6.0;

/// Heading, of 16, whose view meets the scene nearest to [`VIEW_M`], in the mean over its width.
fn view_yaw_deg(caster: &Caster, eye: DVec3) -> f64 {
    let miss = |yaw_deg: f64| {
        let (s, c) = yaw_deg.to_radians().sin_cos();
        let ray = Ray::new(eye, DVec3::new(-s, -0.1, -c));
        caster.trace(&ray, &CellSet::all()).map_or(4.0, |h| (h.t / VIEW_M).ln().abs())
    };
    let view = |yaw_deg: &f64| [-24.0, -12.0, 0.0, 12.0, 24.0].map(|side| miss(yaw_deg + side)).iter().sum::<f64>();
    let headings = (0..16).map(|k| f64::from(k) * 22.5);
    headings.min_by(|a, b| view(a).total_cmp(&view(b))).unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
