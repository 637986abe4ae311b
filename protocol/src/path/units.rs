//! Recognises a path whose units or axes are not those of its scene.
//!
//! In: the places of a path, the scene's box, perhaps its walk volume. Out: a sentence that says
//! which factor, or which exchange of axes, brings the path into the scene.

use crate::{Aabb, volume::WalkVolume};
use glam::DVec3;

/// Places that are looked at, evenly spread over the path.
const LOOKED_AT: usize = 1000;
/// A path with this share of its places in the scene fits as it is.
const FITS_AS_IT_IS: f64 = 0.5;
/// Share of the places that a factor must bring into the scene's box.
const FITS_BOX: f64 = 0.95;
/// Share of the places that a factor must bring into the walk volume.
const FITS_VOLUME: f64 = 0.5;
/// Smallest extent of a path that fits, as a share of the scene's: near the origin everything fits.
const LEAST_EXTENT: f64 = 0.02;
/// A scene smaller than this is walked around, metres.
const EXHIBIT_M: f64 = 10.0;

/// A possible mistake: metres per unit of the path, and what to do if that is it.
const FACTORS: [(f64, &str); 8] = [
    (0.3048, "the path seems to be in feet, and path files are in metres"),
    (0.0254, "the path seems to be in inches, and path files are in metres"),
    (0.01, "the path seems to be in centimetres, and path files are in metres"),
    (0.001, "the path seems to be in millimetres, and path files are in metres"),
    (1000.0, "the scene seems to be in millimetres, which `FILE?unit=mm` says"),
    (100.0, "the scene seems to be in centimetres, which `FILE?unit=cm` says"),
    (1.0 / 0.0254, "the scene seems to be in inches, which `FILE?unit=in` says"),
    (1.0 / 0.3048, "the scene seems to be in feet, which `FILE?unit=ft` says"),
];

/// What says that a path does not lie in a scene and how it would; None where it lies there, or no
/// usual mistake explains it.
pub fn misfit(places: &[DVec3], scene: &Aabb, volume: Option<&WalkVolume>) -> Option<String> {
    let step = places.len().div_ceil(LOOKED_AT).max(1);
    let places: Vec<DVec3> = places.iter().step_by(step).copied().collect();
    let longest = scene.size().max_element();
    let around = if longest < EXHIBIT_M { longest.max(4.0) } else { 2.0 };
    let in_box = scene.inflated(around);
    let share = |holds: &dyn Fn(DVec3) -> bool| {
        places.iter().filter(|p| holds(**p)).count() as f64 / places.len().max(1) as f64
    };
    let now = share(&|p| in_box.contains(p));
    if places.is_empty() || scene.is_empty() || now >= FITS_AS_IT_IS {
        return None;
    }
    let extent = places.iter().fold(Aabb::EMPTY, |b, p| b.union(Aabb { min: *p, max: *p })).size().max_element();
    let fits = |changed: &dyn Fn(DVec3) -> DVec3, factor: f64| {
        let is_large = places.len() == 1 || extent * factor >= LEAST_EXTENT * longest;
        is_large
            && match volume {
                Some(volume) => share(&|p| volume.contains(changed(p))) >= FITS_VOLUME,
                None => share(&|p| in_box.contains(changed(p))) >= FITS_BOX,
            }
    };
    let turned = |p: DVec3| DVec3::new(p.x, p.z, -p.y);
    let mut found = Vec::new();
    if fits(&turned, 1.0) {
        found.push(
            "with (x, z, -y) for (x, y, z) they lie in it: the path seems to have Z up, and path files have Y up"
                .into(),
        );
    }
    for (factor, advice) in FACTORS {
        if fits(&|p| p * factor, factor) {
            found.push(format!("multiplied by {} they lie in it: {advice}", short(factor)));
        } else if fits(&|p| turned(p * factor), factor) {
            let axes = "(x, z, -y) for (x, y, z)";
            found.push(format!("multiplied by {}, with {axes}, they lie in it: {advice}, with Y up", short(factor)));
        }
    }
    if found.is_empty() {
        return None;
    }
    let [low, high] = [scene.min, scene.max].map(|p| format!("{:.1}, {:.1}, {:.1}", p.x, p.y, p.z));
    let outside = ((1.0 - now) * 100.0).round();
    Some(format!(
        "{outside}% of its places lie outside of the scene, which reaches from ({low}) to ({high}); {}",
        found.join("; or ")
    ))
}

/// A factor with four digits.
fn short(factor: f64) -> String {
    let text = format!("{factor:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A building of 30 x 6 x 20 m, and a walk of 21 places along its length.
    fn building() -> (Aabb, Vec<DVec3>) {
        let scene = Aabb { min: DVec3::new(-15.0, 0.0, -10.0), max: DVec3::new(15.0, 6.0, 10.0) };
        (scene, (0..=20).map(|n| DVec3::new(f64::from(n) - 10.0, 1.6, 4.0)).collect())
    }

    fn said(change: impl Fn(DVec3) -> DVec3) -> Option<String> {
        let (scene, places) = building();
        misfit(&places.into_iter().map(change).collect::<Vec<_>>(), &scene, None)
    }

    #[test]
    fn the_factor_that_fits_is_named() {
        assert_eq!(said(|p| p), None);
        for (per_metre, unit) in [(1000.0, "millimetres"), (100.0, "centimetres"), (1.0 / 0.0254, "inches")] {
            let text = said(|p| p * per_metre).expect("a factor");
            let factor =
                format!("multiplied by {} they lie in it: the path seems to be in {unit}", short(1.0 / per_metre));
            assert!(text.contains(&factor) && text.contains("(15.0, 6.0, 10.0)"), "{text}");
        }
        let text = said(|p| DVec3::new(p.x, -p.z, p.y) + DVec3::new(0.0, 0.0, 0.0)).expect("axes");
        assert!(text.contains("Z up"), "{text}");
        // Far away by itself.
        assert_eq!(said(|p| p + DVec3::X * 1e5), None);
    }

    #[test]
    fn a_scene_in_other_units_is_named() {
        let (scene, places) = building();
        let large = Aabb { min: scene.min * 1000.0 + 40_000.0, max: scene.max * 1000.0 + 40_000.0 };
        let text = misfit(&places.iter().map(|p| p + 40.0).collect::<Vec<_>>(), &large, None).expect("a factor");
        assert!(text.contains("multiplied by 1000") && text.contains("?unit=mm"), "{text}");
    }

    #[test]
    fn a_walk_around_a_statue_fits() {
        let statue = Aabb { min: DVec3::ZERO, max: DVec3::new(1.0, 2.0, 1.0) };
        let around: Vec<DVec3> =
            (0..60).map(|n| DVec3::new(4.0 * f64::from(n).cos(), 1.6, 4.0 * f64::from(n).sin())).collect();
        assert_eq!(misfit(&around, &statue, None), None);
    }
}
