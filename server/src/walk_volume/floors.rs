//! The floors of a tile: surfaces that somebody can stand on, line by line.
//!
//! In: the cluster instances over a tile. Out: per line its floors, ascending, each with the
//! surface above.
//!
//! - A floor has head room: an eye at the nominal height keeps its distance from the surface above.
//! - What is steeper than [`LEAST_UP`] and higher than a step is no floor: cliffs. Lower pieces
//!   are noses of stairs and kerbs.
//! - The space inside of a solid is none: its floor looks down and what is above it up, unless the
//!   whole file's faces are turned.
//! - Masked surfaces (leaves, grass, fences, water) are no floors. Those less than a step above
//!   something solid do not take head room either: people walk through grass.

use super::{
    lines::{self, Raster, Window},
    tiles::{LINES, Tile},
};
use crate::{octree::Clusters, scene::Scene};
use glam::DVec3;
use ldi_protocol::mesh::Alpha;

/// Highest step that is climbed at once, metres: two treads of a stair, as lines can miss one.
/// Larger: chairs lead onto tables.
pub(super) const STEP_M: f64 = 0.4;
/// Thickness below which a floor may be the upper side of a ceiling, metres. Larger: slabs;
/// smaller: ceilings of thick tiles.
const SHEET_M: f64 = 0.07;
/// Cosine of the steepest floor against the vertical: 48 degrees, so that slopes of 45 with some
/// noise are walked on.
const LEAST_UP: f64 = 0.669;

/// A floor on one line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Floor {
    /// Line, row-major over the tile.
    pub line: u16,
    /// Its height above the scene's foot, metres.
    pub y_m: f32,
    /// Height of the next surface above; infinite under the sky.
    pub above_m: f32,
    /// Whether its front looks up, by the winding of its triangle.
    pub up: bool,
    /// Whether that of the surface above does.
    pub above_up: bool,
    /// Whether the next surface below lies a room's height below.
    pub is_over_a_room: bool,
    /// Whether it is a thin sheet over a room, or the back of a ceiling.
    pub is_sheet: bool,
    /// Whether it shows its own back: the inside of a hull.
    pub is_back: bool,
}

/// The floors of a tile.
#[derive(Debug, Clone, Default)]
pub(super) struct TileFloors {
    /// Place along x and z, in tiles.
    pub place: [u32; 2],
    /// Floors, by line and ascending.
    pub floors: Vec<Floor>,
    /// Per line the position of its first floor, and one more.
    pub first: Vec<u32>,
    /// Lines whose highest surface looks up, and lines whose highest surface looks down.
    pub tops: [u32; 2],
    /// Spaces with head room between a surface that looks up and one that looks down, and the
    /// other way round.
    pub spaces: [u32; 2],
}

impl TileFloors {
    /// Leaves out what lies inside of solids: a surface that looks down, below one that looks up.
    /// `turned`: fronts are backs.
    pub fn without_insides(mut self, turned: bool) -> Self {
        for f in &mut self.floors {
            f.is_sheet |= f.is_over_a_room && f.up == turned;
            f.is_back = f.up == turned;
        }
        self.only(|f| !(f.above_m.is_finite() && f.up == turned && f.above_up != turned))
    }

    /// The same with some of its floors.
    fn only(mut self, keep: impl Fn(&Floor) -> bool) -> Self {
        let mut first = vec![0u32; self.first.len()];
        for f in self.floors.iter().filter(|f| keep(f)) {
            first[f.line as usize + 1] += 1;
        }
        for line in 1..first.len() {
            first[line] += first[line - 1];
        }
        self.floors.retain(keep);
        Self { first, ..self }
    }

    /// Positions of the floors of a line.
    pub fn of_line(&self, line: u32) -> std::ops::Range<usize> {
        self.first[line as usize] as usize..self.first[line as usize + 1] as usize
    }
}

/// How floors are told from other surfaces.
#[derive(Debug, Clone, Copy)]
pub(super) struct FloorRules {
    /// World height that heights are measured from, metres.
    pub foot_m: f64,
    /// Least distance to the surface above, metres.
    pub head_room_m: f64,
    /// Masked surfaces count like solid ones.
    pub masks_are_solid: bool,
    /// A plane at the scene's foot counts as a surface.
    pub ground: bool,
}

/// A surface met by a line: height, and whether it can be stood on and is solid.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Surface {
    line: u16,
    y_m: f32,
    up: bool,
    walkable: bool,
    solid: bool,
}

/// The floors of a tile.
pub(super) fn floors_of(
    scene: &Scene,
    clusters: &Clusters,
    raster: &Raster,
    tile: &Tile,
    rules: &FloorRules,
) -> TileFloors {
    let from = tile.place.map(|p| p * LINES);
    let window = Window { from, to: [0, 1].map(|axis| from[axis] + LINES) };
    let mut met: Vec<Surface> = Vec::new();
    for &(instance, cluster) in &tile.content {
        let world_from_mesh = &scene.instances[instance as usize].world_from_mesh;
        let cluster = &clusters.clusters[cluster as usize];
        let primitive = &scene.meshes[cluster.mesh as usize].primitives[cluster.primitive as usize];
        let masked = matches!(scene.materials[primitive.material as usize].alpha, Alpha::Mask(_));
        let solid = rules.masks_are_solid || !masked;
        let mirrored = world_from_mesh.matrix3.determinant() < 0.0;
        for t in &cluster.triangles {
            let corners = primitive.triangles[*t as usize]
                .map(|v| world_from_mesh.transform_point3(primitive.positions[v as usize].as_dvec3()));
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let (up, walkable) = ((normal.y > 0.0) != mirrored, solid && !is_cliff(&corners));
            lines::triangle(corners, raster, &window, |line, y| {
                let y_m = (y - rules.foot_m) as f32;
                met.push(Surface { line: line as u16, y_m, up, walkable, solid });
            });
        }
    }
    if rules.ground {
        let ground = |line| Surface { line: line as u16, y_m: 0.0, up: true, walkable: true, solid: true };
        met.extend((0..LINES * LINES).map(ground));
    }
    let by_height = |a: &Surface, b: &Surface| {
        let kinds = |s: &Surface| (!s.walkable, !s.solid, !s.up);
        a.line.cmp(&b.line).then(a.y_m.total_cmp(&b.y_m)).then(kinds(a).cmp(&kinds(b)))
    };
    met.sort_unstable_by(by_height);
    let mut out = TileFloors { place: tile.place, first: vec![0; (LINES * LINES) as usize + 1], ..Default::default() };
    for of_line in met.chunk_by(|a, b| a.line == b.line) {
        let low = out.floors.len();
        add_line(of_line, rules.head_room_m, &mut out);
        out.first[of_line[0].line as usize + 1] = (out.floors.len() - low) as u32;
    }
    for line in 1..out.first.len() {
        out.first[line] += out.first[line - 1];
    }
    if !tile.heights_m.is_empty() {
        let within = |f: &Floor| tile.heights_m.iter().any(|[low, high]| f.y_m >= *low && f.y_m <= *high);
        return out.only(within);
    }
    out
}

/// Whether a triangle is steep and higher than a step.
fn is_cliff(v: &[DVec3; 3]) -> bool {
    let normal = (v[1] - v[0]).cross(v[2] - v[0]);
    let height =
        v.iter().map(|p| p.y).fold(f64::NEG_INFINITY, f64::max) - v.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    normal.y.abs() < LEAST_UP * normal.length() && height > STEP_M
}

/// Adds the floors of one line from its surfaces, ascending.
fn add_line(surfaces: &[Surface], head_room_m: f64, out: &mut TileFloors) {
    let mut ground = f32::NEG_INFINITY;
    let taken: Vec<&Surface> = surfaces
        .iter()
        .filter(|s| {
            if s.solid {
                ground = s.y_m;
            }
            s.solid || f64::from(s.y_m - ground) > STEP_M
        })
        .collect();
    let mut is_top = false;
    for (n, s) in taken.iter().enumerate() {
        // Two faces at one height are one surface.
        let above = taken[n + 1..].iter().find(|o| o.y_m > s.y_m + 1e-3);
        let (above_m, above_up) = above.map_or((f32::INFINITY, false), |o| (o.y_m, o.up));
        if above.is_none() && !is_top {
            out.tops[usize::from(!s.up)] += 1;
            is_top = true;
        }
        let is_again = out.floors.last().is_some_and(|f| f.line == s.line && s.y_m - f.y_m <= 1e-3);
        if !s.walkable || is_again {
            continue;
        }
        if f64::from(above_m) - f64::from(s.y_m) >= head_room_m {
            if above.is_some() && s.up != above_up {
                out.spaces[usize::from(!s.up)] += 1;
            }
            // The surfaces of one sheet, and the first one below it.
            let foot = taken[..n].iter().rposition(|o| s.y_m - o.y_m > SHEET_M as f32);
            let thin = foot.is_none_or(|f| f + 1 < n);
            let below_m = foot.map_or(f32::NEG_INFINITY, |f| taken[f].y_m);
            let is_over_a_room = below_m.is_finite() && f64::from(s.y_m - below_m) >= head_room_m;
            let is_sheet = is_over_a_room && thin;
            let (line, y_m, up, is_back) = (s.line, s.y_m, s.up, false);
            out.floors.push(Floor { line, y_m, above_m, up, above_up, is_over_a_room, is_sheet, is_back });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on_one_line(surfaces: &[(f32, bool, bool)]) -> Vec<(f32, f32)> {
        let of = |&(y_m, walkable, solid): &(f32, bool, bool)| Surface { line: 7, y_m, up: true, walkable, solid };
        let mut out = TileFloors::default();
        add_line(&surfaces.iter().map(of).collect::<Vec<_>>(), 1.65, &mut out);
        out.floors.iter().map(|f| (f.y_m, f.above_m)).collect()
    }

    const INF: f32 = f32::INFINITY;

    #[test]
    fn floors_have_head_room() {
        assert_eq!(on_one_line(&[(0.0, true, true), (0.8, true, true), (3.0, true, true)]), [(0.8, 3.0), (3.0, INF)]);
        assert_eq!(on_one_line(&[(0.0, true, true), (0.0, true, true), (2.0, true, true)]), [(0.0, 2.0), (2.0, INF)]);
    }

    #[test]
    fn grass_is_walked_through_and_leaves_are_no_floor() {
        assert_eq!(on_one_line(&[(0.0, true, true), (0.3, false, false)]), [(0.0, INF)]);
        assert_eq!(on_one_line(&[(0.0, true, true), (0.3, false, false), (1.2, false, false)]), []);
        assert_eq!(on_one_line(&[(0.0, true, true), (4.0, false, false)]), [(0.0, 4.0)]);
    }

    #[test]
    fn cliffs_are_no_floors_but_noses_of_stairs_are() {
        let slope = |degrees: f64, length: f64| {
            let up = DVec3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), 0.0) * length;
            is_cliff(&[DVec3::ZERO, DVec3::Z, up])
        };
        assert!(!slope(45.0, 10.0) && slope(52.0, 10.0) && !slope(70.0, 0.4));
    }
}
