//! Rooms: cells and the portals between them (Rafferty et al. 1998, section 2.1).
//!
//! A cell is a part of space: the union of upright boxes, which may touch but share no volume with
//! another cell's. What lies in no cell is the outside. A portal is a flat convex polygon in the
//! border of two cells, or of a cell and the outside. The promise that culling rests on: **a
//! straight line that no surface stops leaves a cell only through its portals** (or through the
//! outer border of a margin around them, [`Rooms::margin_m`]: borders of cells follow a raster,
//! portals do not).
//!
//! ```text
//!    +-------+------+        cells: 0, 1, 2; the outside is None
//!    |   0   +  1   |        portals: [0, 1] door, [1, 2] door, [0, None] window
//!    +       |      |        normal of a portal (right-hand rule around its corners): from its first cell into its second
//!    +-------+--  --+
//!    outside |  2   |
//! ```
//!
//! Pure data, read from strangers: [`Rooms::new`] is the only door, and checks numbers, names,
//! shapes and references.

use crate::Aabb;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A cell by its position in [`Rooms::cells`], or None for the outside.
pub type CellId = Option<u32>;

/// Longest file of rooms, bytes: some hundred thousand boxes.
pub const MAX_JSON_BYTES: usize = 64 << 20;
/// Most cells, and separately portals.
pub const MAX_ROOMS: usize = 65_536;
/// Most boxes of all cells together: 48 bytes each.
pub const MAX_BOXES: usize = 1 << 20;
/// Most corners of a portal.
pub const MAX_CORNERS: usize = 64;
/// Longest name, bytes.
pub const MAX_NAME_BYTES: usize = 256;
/// Largest coordinate, metres.
const MAX_COORDINATE_M: f64 = 1.0e7;
/// How far corners may lie out of a portal's plane, as a part of its size: exporters write f32.
const FLATNESS: f64 = 1.0e-3;

/// What kind of opening a portal is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PortalKind {
    /// Down to the floor: people walk through it.
    Door,
    /// An opening that ends above the floor.
    Window,
    /// A horizontal opening: a stairwell, a gallery, a missing ceiling.
    Hatch,
    /// No opening that was meant to be one, but sight goes through: a gap, found by rays.
    Gap,
    /// From an annotation or an override file, which do not say.
    Given,
}

/// A part of space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Name for people, unique.
    pub name: String,
    /// Upright boxes, world, metres.
    pub boxes: Vec<Aabb>,
}

impl Cell {
    /// Box around the cell.
    pub fn bounds(&self) -> Aabb {
        self.boxes.iter().fold(Aabb::EMPTY, |b, o| b.union(*o))
    }

    /// Distance from a point to the cell; 0 inside.
    pub fn distance_m(&self, p: DVec3) -> f64 {
        self.boxes.iter().map(|b| b.distance(p)).fold(f64::INFINITY, f64::min)
    }
}

/// An opening.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Portal {
    /// The cells on its two sides; its normal points from the first into the second.
    pub cells: [CellId; 2],
    /// What it is.
    pub kind: PortalKind,
    /// Corners of a flat convex polygon, world, metres.
    pub corners: Vec<DVec3>,
}

impl Portal {
    /// Unit normal, from the first cell into the second.
    pub fn normal(&self) -> DVec3 {
        newell(&self.corners).normalize_or_zero()
    }

    /// Mean of the corners.
    pub fn centre(&self) -> DVec3 {
        self.corners.iter().sum::<DVec3>() / self.corners.len().max(1) as f64
    }

    /// Area, m².
    pub fn area_m2(&self) -> f64 {
        newell(&self.corners).length() * 0.5
    }

    /// The cell on the other side, if `cell` is on one.
    pub fn beyond(&self, cell: CellId) -> Option<CellId> {
        match self.cells {
            [a, b] if a == cell => Some(b),
            [a, b] if b == cell => Some(a),
            _ => None,
        }
    }

    /// Where a line from its side `side` (0: of the first cell) passes through the polygon: factor
    /// of `ray`, above 0.
    pub fn crossed(&self, side: usize, origin: DVec3, ray: DVec3) -> Option<f64> {
        let normal = self.normal();
        let toward = if side == 0 { normal } else { -normal };
        let along = ray.dot(toward);
        if along <= 0.0 {
            return None;
        }
        let t = (self.corners[0] - origin).dot(toward) / along;
        let p = origin + ray * t;
        let n = self.corners.len();
        let turns = |i: usize| (self.corners[(i + 1) % n] - self.corners[i]).cross(p - self.corners[i]).dot(normal);
        (t > 0.0 && (0..n).all(|i| turns(i) > 1e-9)).then_some(t)
    }

    /// Distance from a point to the polygon.
    pub fn distance_m(&self, p: DVec3) -> f64 {
        let n = self.normal();
        let len = self.corners.len();
        let edge = |i: usize| (self.corners[i], self.corners[(i + 1) % len]);
        if (0..len).all(|i| (edge(i).1 - edge(i).0).cross(p - edge(i).0).dot(n) >= 0.0) {
            return (p - self.corners[0]).dot(n).abs();
        }
        (0..len)
            .map(|i| {
                let (a, b) = edge(i);
                let t = ((p - a).dot(b - a) / (b - a).length_squared().max(1e-18)).clamp(0.0, 1.0);
                p.distance(a.lerp(b, t))
            })
            .fold(f64::INFINITY, f64::min)
    }
}

/// Twice the area times the unit normal of a polygon, relative to its first corner, so that
/// far-off polygons keep their precision.
pub fn newell(corners: &[DVec3]) -> DVec3 {
    let n = corners.len();
    (0..n).map(|i| (corners[i] - corners[0]).cross(corners[(i + 1) % n] - corners[0])).sum()
}

/// Why rooms were refused.
#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
#[error("{place}: {problem}; find the rooms again with `ldi-server rooms`, or mend the file")]
pub struct RoomsError {
    place: String,
    problem: String,
}

fn fault<T>(place: impl Into<String>, problem: impl Into<String>) -> Result<T, RoomsError> {
    Err(RoomsError { place: place.into(), problem: problem.into() })
}

/// Cells and portals of a scene.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(into = "Raw", try_from = "Raw")]
pub struct Rooms {
    margin_m: f64,
    cells: Vec<Cell>,
    portals: Vec<Portal>,
    /// Portals of each cell; those of the outside come last.
    portals_of: Vec<Vec<u32>>,
    /// Box around each cell.
    bounds: Vec<Aabb>,
    /// Of each portal.
    faces: Vec<Face>,
}

/// What culling asks of a portal at every look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Face {
    /// [`Portal::normal`].
    pub normal: DVec3,
    /// A ball around it: [`Portal::centre`], and the distance of the farthest corner, metres.
    pub centre: DVec3,
    pub radius_m: f64,
}

impl Face {
    pub(crate) fn of(portal: &Portal) -> Self {
        let centre = portal.centre();
        let radius_m = portal.corners.iter().map(|c| c.distance(centre)).fold(0.0, f64::max);
        Self { normal: portal.normal(), centre, radius_m }
    }
}

/// The stored form.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    margin_m: f64,
    cells: Vec<Cell>,
    portals: Vec<Portal>,
}

impl Rooms {
    /// Checks and joins cells and portals.
    ///
    /// `margin_m`: how far a cell's boxes may be off its portals' planes, metres, 0 or more.
    ///
    /// # Errors
    /// Numbers out of range, empty or equal names, cells without a box, portals that are not flat
    /// and convex or lead nowhere.
    pub fn new(margin_m: f64, cells: Vec<Cell>, portals: Vec<Portal>) -> Result<Self, RoomsError> {
        if !(0.0..=10.0).contains(&margin_m) {
            return fault("margin_m", format!("{margin_m} is not between 0 and 10 m"));
        }
        if cells.len() > MAX_ROOMS || portals.len() > MAX_ROOMS {
            return fault("rooms", format!("{} cells and {} portals, at most {MAX_ROOMS}", cells.len(), portals.len()));
        }
        if cells.iter().map(|c| c.boxes.len()).sum::<usize>() > MAX_BOXES {
            return fault("rooms", format!("more than {MAX_BOXES} boxes"));
        }
        let in_range = |p: &DVec3| p.abs().cmple(DVec3::splat(MAX_COORDINATE_M)).all();
        let mut names = std::collections::BTreeSet::new();
        for (i, c) in cells.iter().enumerate() {
            let place = || format!("cells[{i}]");
            if c.name.is_empty() || c.name.len() > MAX_NAME_BYTES || !names.insert(c.name.as_str()) {
                return fault(place(), "its name is empty, too long or taken");
            }
            if c.boxes.is_empty() {
                return fault(place(), "it has no box");
            }
            if !c.boxes.iter().all(|b| in_range(&b.min) && in_range(&b.max) && b.min.cmplt(b.max).all()) {
                return fault(place(), "min must be below max on every axis, and both within the world's limits");
            }
        }
        let mut portals_of = vec![Vec::new(); cells.len() + 1];
        for (i, p) in portals.iter().enumerate() {
            let place = || format!("portals[{i}]");
            if p.cells[0] == p.cells[1] || p.cells.iter().flatten().any(|c| *c as usize >= cells.len()) {
                return fault(place(), "it must lead from one cell of the list to another, or outside (null)");
            }
            if p.corners.len() > MAX_CORNERS || !p.corners.iter().all(in_range) || !is_flat_convex(&p.corners) {
                return fault(place(), "its corners must be a flat, convex polygon in order");
            }
            for c in p.cells {
                portals_of[c.map_or(cells.len(), |c| c as usize)].push(i as u32);
            }
        }
        let bounds = cells.iter().map(Cell::bounds).collect();
        let faces = portals.iter().map(Face::of).collect();
        Ok(Self { margin_m, cells, portals, portals_of, bounds, faces })
    }

    /// Reads the JSON form.
    ///
    /// # Errors
    /// If it is too long, no JSON of this form, or breaks a rule of [`Rooms::new`].
    pub fn from_json(text: &[u8]) -> Result<Self, RoomsError> {
        if text.len() > MAX_JSON_BYTES {
            return fault("rooms", format!("{} bytes, at most {MAX_JSON_BYTES} are read", text.len()));
        }
        serde_json::from_slice(text).or_else(|e| fault("rooms", e.to_string()))
    }

    /// How far borders of cells may be off, metres.
    pub fn margin_m(&self) -> f64 {
        self.margin_m
    }

    /// The cells.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// The portals.
    pub fn portals(&self) -> &[Portal] {
        &self.portals
    }

    /// Portals of a cell or of the outside, by their positions in [`Rooms::portals`].
    pub fn portals_of(&self, cell: CellId) -> &[u32] {
        self.portals_of.get(cell.map_or(self.cells.len(), |c| c as usize)).map_or(&[], Vec::as_slice)
    }

    /// Of each portal, in the order of [`Self::portals`].
    pub(crate) fn faces(&self) -> &[Face] {
        &self.faces
    }

    /// Name of a cell or of the outside.
    pub fn name(&self, cell: CellId) -> &str {
        cell.and_then(|c| self.cells.get(c as usize)).map_or("outside", |c| &c.name)
    }

    /// The cell that holds a point.
    pub fn cell_at(&self, p: DVec3) -> CellId {
        let holds = |c: usize| self.bounds[c].contains(p) && self.cells[c].boxes.iter().any(|b| b.contains(p));
        (0..self.cells.len()).find(|c| holds(*c)).map(|c| c as u32)
    }

    /// Every cell within `margin_m` of a point, and the outside when that may be: where a walk
    /// through the portals starts.
    pub fn cells_near(&self, p: DVec3, margin_m: f64) -> Vec<CellId> {
        let mut near: Vec<CellId> = (0..self.cells.len() as u32)
            .filter(|c| self.bounds[*c as usize].distance(p) <= margin_m)
            .filter(|c| self.cells[*c as usize].distance_m(p) <= margin_m)
            .map(Some)
            .collect();
        let held =
            |q: DVec3| near.iter().flatten().any(|c| self.cells[*c as usize].boxes.iter().any(|b| b.contains(q)));
        let around = Aabb { min: p - margin_m, max: p + margin_m };
        if !(held(p) && around.corners().into_iter().all(held)) {
            near.push(None);
        }
        near
    }
}

impl From<Rooms> for Raw {
    fn from(r: Rooms) -> Self {
        Self { margin_m: r.margin_m, cells: r.cells, portals: r.portals }
    }
}

impl TryFrom<Raw> for Rooms {
    type Error = RoomsError;
    fn try_from(r: Raw) -> Result<Self, RoomsError> {
        Self::new(r.margin_m, r.cells, r.portals)
    }
}

/// Whether the polygon has an area, lies in a plane, and turns the same way at every corner, once
/// around.
pub fn is_flat_convex(corners: &[DVec3]) -> bool {
    let n = corners.len();
    if n < 3 || !corners.iter().all(|c| c.is_finite()) {
        return false;
    }
    let edge = |i: usize| corners[(i + 1) % n] - corners[i % n];
    let size = Aabb::from_points(corners.iter().copied()).size().max_element();
    let Some(normal) = newell(corners).try_normalize() else { return false };
    let flat = corners.iter().all(|c| (*c - corners[0]).dot(normal).abs() <= FLATNESS * size);
    let convex = (0..n).all(|i| edge(i).cross(edge(i + 1)).dot(normal) >= -FLATNESS * size * size);
    let turn: f64 = (0..n).map(|i| edge(i).angle_between(edge(i + 1))).sum();
    flat && convex && (turn - std::f64::consts::TAU).abs() < 0.1
}

#[cfg(test)]
#[path = "rooms_test.rs"]
mod tests;
