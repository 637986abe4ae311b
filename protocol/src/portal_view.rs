//! Recursive portal culling: what may be seen from an eye, cell by cell (Luebke and Georges 1995,
//! "Portals and mirrors"; Rafferty et al. 1998, section 2.1).
//!
//! In: [`Rooms`], an eye with its frustum. Out: for each cell that may be seen the cones in which
//! it may be seen. Unlike those sources, a portal is clipped as a polygon, not as the rectangle
//! around it on the screen, so a cone is exactly what the portals on the way leave open:
//!
//! ```text
//!   eye --<======|  portal 1   cone: apex and one plane per side of the clipped polygon
//!          \_____|___
//!                 \==|  portal 2, clipped by the cone of portal 1
//! ```
//!
//! Nothing that can be seen is missed, if the rooms keep their promise (a line of sight leaves a
//! cell only through portals):
//! - A line of sight crosses portals in some order; its direction lies in every polygon's cone,
//!   hence in their intersection.
//! - A portal is crossed only from the side on which the eye is: a straight line crosses a plane
//!   once.
//! - A cell is not entered again with a cone that lies within one it was entered with: everything
//!   beyond was then found. This ends cycles, and every path, since cones only shrink.
//! - An eye closer to a portal than the margin of the rooms sees through it unclipped, and counts
//!   as being on both sides.
//! - What exceeds [`MAX_CONES`] or [`MAX_VISITS`] is given the whole frustum instead of being
//!   dropped.
//!
//! More may be reported than is seen: furniture and walls that stand within a cell hide nothing
//! here.

use crate::{
    camera::Frustum,
    rooms::{CellId, Rooms},
};
use glam::DVec3;

/// Most cones of one cell; beyond it the cell counts as seen in the whole frustum. More: exacter,
/// and slower where dozens of openings see each other. Fewer: open halls lose their narrow cones.
pub const MAX_CONES: usize = 64;
/// Most steps through portals for one view; beyond it every cell counts as seen. A bound on time,
/// far above what buildings take.
pub const MAX_VISITS: usize = 50_000;
/// How far outside of a plane a point may be and still count as inside, as a part of its distance:
/// rounding must not lose a sliver.
const TOLERANCE: f64 = 1.0e-9;

/// A convex, semi-infinite pyramid.
#[derive(Debug, Clone, PartialEq)]
pub struct Cone {
    /// Apex: the eye.
    pub apex: DVec3,
    /// Unit directions of the edges, in order.
    pub edges: Vec<DVec3>,
    /// Inward unit normals; side `i` lies between edges `i` and `i + 1`.
    pub normals: Vec<DVec3>,
}

impl Cone {
    /// The cone of a frustum.
    pub fn of_frustum(f: &Frustum) -> Self {
        let [left, right, bottom, top] = f.normals;
        // Around: left, bottom, right, top. The sum of the normals points forward, which tells an
        // edge from its opposite.
        let around = [left, bottom, right, top];
        let forward: DVec3 = around.iter().sum();
        let edge = |i: usize| {
            let e = around[(i + 3) % 4].cross(around[i]).normalize_or_zero();
            if e.dot(forward) < 0.0 { -e } else { e }
        };
        Self { apex: f.apex, edges: (0..4).map(edge).collect(), normals: around.to_vec() }
    }

    /// The cone from `apex` over a convex polygon; None if nothing of it can be seen from there.
    pub fn over(apex: DVec3, polygon: &[DVec3]) -> Option<Self> {
        let mut edges: Vec<DVec3> = Vec::with_capacity(polygon.len());
        for p in polygon {
            let e = (*p - apex).try_normalize()?;
            // Corners that look the same give sides without a direction.
            if edges.last().is_none_or(|l| l.distance_squared(e) > 1e-20) {
                edges.push(e);
            }
        }
        while edges.len() > 1 && edges[0].distance_squared(edges[edges.len() - 1]) <= 1e-20 {
            edges.pop();
        }
        let n = edges.len();
        if n < 3 {
            return None;
        }
        let middle: DVec3 = edges.iter().sum();
        let mut normals: Vec<DVec3> = Vec::with_capacity(n);
        for i in 0..n {
            let normal = edges[i].cross(edges[(i + 1) % n]).normalize_or_zero();
            normals.push(if normal.dot(middle) < 0.0 { -normal } else { normal });
        }
        Some(Self { apex, edges, normals })
    }

    /// Whether a point lies inside or, within rounding, on the border.
    pub fn contains(&self, p: DVec3) -> bool {
        let v = p - self.apex;
        let slack = TOLERANCE * v.length();
        self.normals.iter().all(|n| n.dot(v) >= -slack)
    }

    /// Whether another cone with the same apex lies within this one.
    pub fn contains_cone(&self, o: &Self) -> bool {
        o.edges.iter().all(|e| self.normals.iter().all(|n| n.dot(*e) >= -TOLERANCE))
    }

    /// False only when a side has the whole box beyond it.
    pub fn may_intersect(&self, b: &crate::Aabb) -> bool {
        self.normals.iter().all(|n| b.support(*n) >= n.dot(self.apex) - TOLERANCE)
    }

    /// False only when a side has the whole ball beyond it.
    fn may_reach(&self, centre: DVec3, radius_m: f64) -> bool {
        let v = centre - self.apex;
        let reach = radius_m + TOLERANCE * (v.length() + radius_m);
        self.normals.iter().all(|n| n.dot(v) + reach >= 0.0)
    }

    /// The part of a convex polygon within the cone (Sutherland and Hodgman 1974); empty if there
    /// is none.
    pub fn clip(&self, polygon: &[DVec3]) -> Vec<DVec3> {
        let mut clipping = Clipping::default();
        clipping.clip(self, polygon);
        clipping.kept
    }
}

/// Memory of clipping, kept from one polygon to the next.
#[derive(Debug, Default)]
struct Clipping {
    /// What is left of the polygon.
    kept: Vec<DVec3>,
    before: Vec<DVec3>,
    /// How far each corner lies within the side at hand.
    within: Vec<f64>,
}

impl Clipping {
    /// [`Cone::clip`], into `kept`.
    fn clip(&mut self, cone: &Cone, polygon: &[DVec3]) {
        self.kept.clear();
        self.kept.extend_from_slice(polygon);
        for n in &cone.normals {
            self.within.clear();
            self.within.extend(self.kept.iter().map(|p| {
                let v = *p - cone.apex;
                n.dot(v) + TOLERANCE * v.length()
            }));
            if self.within.iter().all(|s| *s >= 0.0) {
                continue;
            }
            std::mem::swap(&mut self.kept, &mut self.before);
            self.kept.clear();
            let count = self.before.len();
            for i in 0..count {
                let next = if i + 1 < count { i + 1 } else { 0 };
                let (p, q) = (self.before[i], self.before[next]);
                let (s, t) = (self.within[i], self.within[next]);
                if s >= 0.0 {
                    self.kept.push(p);
                }
                if (s >= 0.0) != (t >= 0.0) {
                    self.kept.push(p + (q - p) * (s / (s - t)));
                }
            }
            if self.kept.len() < 3 {
                self.kept.clear();
                return;
            }
        }
    }
}

/// A cell that may be seen.
#[derive(Debug, Clone, PartialEq)]
pub struct VisibleCell {
    /// Which.
    pub cell: CellId,
    /// What is left open toward it; none of the cones lies within another that came before it.
    pub cones: Vec<Cone>,
}

/// A portal that may be seen and was not gone through.
#[derive(Debug, Clone, PartialEq)]
pub struct Threshold {
    /// Position in [`Rooms::portals`].
    pub portal: u32,
    /// Which of the portal's two cells it is seen from.
    pub side: usize,
    /// What may be seen of it.
    pub cone: Cone,
}

/// What may be seen.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PortalView {
    /// Cells in the order in which they were reached; those of the eye come first.
    pub cells: Vec<VisibleCell>,
    /// Where [`portal_view_within`] stopped; a portal comes once for each way to it.
    pub thresholds: Vec<Threshold>,
    /// Portals that were clipped; those that lie wholly beyond a side of the cone are not.
    pub clipped: usize,
    /// Whether [`MAX_VISITS`] was reached, so that everything counts as seen.
    pub everything: bool,
}

impl PortalView {
    /// Whether a cell may be seen.
    pub fn sees(&self, cell: CellId) -> bool {
        self.cells.iter().any(|c| c.cell == cell)
    }
}

/// Steps through portals for one view of a frame. Beyond it everything counts as seen, which is
/// right but costs budget. Larger: halls with hundreds of gaps are culled more exactly, and frames
/// of them take longer: half a microsecond to one per step.
pub const VISITS_PER_VIEW: usize = 1_000;

/// What an eye at the frustum's apex may see within the frustum.
pub fn portal_view(rooms: &Rooms, frustum: &Frustum) -> PortalView {
    let start = rooms.cells_near(frustum.apex, rooms.margin_m());
    portal_view_within(rooms, frustum, &start, &|_| true, MAX_VISITS)
}

/// The same, but only through cells that `enters` admits: portals into others are
/// [`PortalView::thresholds`]. `start`: the cells of the eye, [`Rooms::cells_near`] within the
/// margin; `most_visits` in place of [`MAX_VISITS`].
pub fn portal_view_within(
    rooms: &Rooms,
    frustum: &Frustum,
    start: &[CellId],
    enters: &dyn Fn(CellId) -> bool,
    most_visits: usize,
) -> PortalView {
    let whole = Cone::of_frustum(frustum);
    let mut walk = Walk {
        rooms,
        enters,
        whole: whole.clone(),
        found: PortalView::default(),
        slot: vec![usize::MAX; rooms.cells().len() + 1],
        visits: 0,
        clipping: Clipping::default(),
    };
    // A stack of its own: paths may be as long as there are portals.
    let mut open: Vec<(CellId, Cone)> = Vec::new();
    for cell in start.iter().filter(|c| enters(**c)) {
        open.push((*cell, whole.clone()));
    }
    open.reverse();
    while let Some((cell, cone)) = open.pop() {
        walk.enter(cell, cone, &mut open);
        if walk.visits > most_visits {
            return walk.everything();
        }
    }
    walk.found
}

struct Walk<'a> {
    rooms: &'a Rooms,
    enters: &'a dyn Fn(CellId) -> bool,
    whole: Cone,
    found: PortalView,
    /// Position of each cell in `found`; the outside's comes last.
    slot: Vec<usize>,
    visits: usize,
    clipping: Clipping,
}

impl Walk<'_> {
    fn enter(&mut self, cell: CellId, mut cone: Cone, open: &mut Vec<(CellId, Cone)>) {
        self.visits += 1;
        let last = self.slot.len() - 1;
        let slot = &mut self.slot[cell.map_or(last, |c| c as usize)];
        if *slot == usize::MAX {
            *slot = self.found.cells.len();
            self.found.cells.push(VisibleCell { cell, cones: Vec::new() });
        }
        let seen = &mut self.found.cells[*slot].cones;
        if seen.iter().any(|c| c.contains_cone(&cone)) {
            return;
        }
        if seen.len() >= MAX_CONES {
            seen.clear();
            cone = self.whole.clone();
        }
        seen.push(cone.clone());
        let margin = self.rooms.margin_m();
        let eye = self.whole.apex;
        for &number in self.rooms.portals_of(cell) {
            let portal = &self.rooms.portals()[number as usize];
            let Some(beyond) = portal.beyond(cell) else { continue };
            let side = usize::from(portal.cells[0] != cell);
            // Beyond the plane for an eye on this side of it.
            let face = &self.rooms.faces()[number as usize];
            let ahead = (portal.corners[0] - eye).dot(face.normal) * if side == 0 { 1.0 } else { -1.0 };
            if ahead < -margin {
                continue;
            }
            let mut go_on = |cone: Cone| match (self.enters)(beyond) {
                true => open.push((beyond, cone)),
                false => self.found.thresholds.push(Threshold { portal: number, side, cone }),
            };
            if ahead.abs() <= margin && portal.distance_m(eye) <= margin {
                go_on(cone.clone());
                continue;
            }
            if !cone.may_reach(face.centre, face.radius_m) {
                continue;
            }
            self.clipping.clip(&cone, &portal.corners);
            if let Some(narrow) = Cone::over(eye, &self.clipping.kept) {
                go_on(narrow);
            }
            self.found.clipped += 1;
        }
    }

    fn everything(mut self) -> PortalView {
        let all = (0..self.rooms.cells().len() as u32).map(Some).chain([None]).filter(|c| (self.enters)(*c));
        self.found.cells = all.map(|cell| VisibleCell { cell, cones: vec![self.whole.clone()] }).collect();
        self.found.thresholds.clear();
        for (portal, p) in (0u32..).zip(self.rooms.portals()) {
            let between = p.cells.map(self.enters);
            for side in (0..2).filter(|side| between[*side] && !between[1 - side]) {
                self.found.thresholds.push(Threshold { portal, side, cone: self.whole.clone() });
            }
        }
        self.found.everything = true;
        self.found
    }
}

#[cfg(test)]
#[path = "portal_view_test.rs"]
mod tests;
