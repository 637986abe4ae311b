//! What was found about where people walk, for the build's report, its messages and the plan.

use serde::{Deserialize, Serialize};

/// A rectangle of floor on the plan, metres: x from, x to, z from, z to, height.
pub type Patch = [f32; 5];

/// A region that was kept or left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RegionReport {
    /// Whether people walk there.
    pub kept: bool,
    /// Why, or why not.
    pub why: String,
    /// Floor, m².
    pub area_m2: f64,
    /// Lowest and highest floor, metres.
    pub heights_m: [f64; 2],
    /// A place on it: x, y, z, metres.
    pub place: [f64; 3],
    /// Share of the scene's triangles that lie in cells seen from near.
    pub detail: f64,
    /// Its floor in rows, for the plan; empty for small regions.
    pub patches: Vec<Patch>,
}

/// Where people walk, and where they do not.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct WalkReport {
    /// The largest regions, kept ones first.
    pub regions: Vec<RegionReport>,
    /// Floor of all regions by verdict, m².
    pub area_m2: std::collections::BTreeMap<String, f64>,
    /// Share of the scene's triangles that lie in cells seen from near where people walk.
    pub detail: f64,
    /// Share of those that lie in cells seen from near from any floor at all.
    pub detail_from_anywhere: f64,
    /// Tiles without detail, or beyond what can be held, that were not searched.
    pub unsearched: Option<String>,
    /// Poses of the path that float above no floor: number and position, the first ones.
    pub floating: Vec<(usize, [f64; 3])>,
    /// How many there are.
    pub floating_total: usize,
    /// What a user should know and can change.
    pub warnings: Vec<String>,
}

impl WalkReport {
    /// What a build says of it, a line each: the largest regions, and what was left out.
    pub fn lines(&self) -> Vec<String> {
        const SAID: usize = 4;
        let mut out = Vec::new();
        let of_kept = |kept: bool| self.regions.iter().filter(move |r| r.kept == kept);
        for r in of_kept(true).take(SAID) {
            let [x, y, z] = r.place;
            out.push(format!(
                "{:.0} m² around ({x:.0}, {y:.0}, {z:.0}), {:.0}% of the triangles seen from near: {}",
                r.area_m2,
                r.detail * 100.0,
                r.why
            ));
        }
        let kept: Vec<&str> = of_kept(true).map(|r| r.why.as_str()).collect();
        let left: Vec<String> = self
            .area_m2
            .iter()
            .filter(|(why, area)| !kept.contains(&why.as_str()) && **area >= 1.0)
            .map(|(why, area)| format!("{area:.0} m² {why}"))
            .collect();
        if !left.is_empty() {
            out.push(format!("nobody walks on {}", left.join("; ")));
        }
        out
    }
}
