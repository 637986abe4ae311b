//! Corrections of found rooms by a person: a TOML file, applied from top to bottom by kind in the
//! order below.
//!
//! ```toml
//! [[split]]                       # a room with no narrow place in it: cut by a plane; the cut becomes a portal
//! cell = "room 5"
//! x = 12.5                        # or z = ...
//! names = ["hall west", "hall east"]      # the side of smaller x (or z) first
//!
//! [[merge]]                       # rooms that are one; portals between them go
//! cells = ["room 3", "room 4"]
//! name = "living"
//!
//! [[rename]]
//! from = "room 1"
//! to = "kitchen"
//!
//! [[remove_portal]]               # of those between the two, the one nearest to `at`
//! cells = ["kitchen", "outside"]
//! at = [3.0, 1.5, 7.2]
//!
//! [[portal]]                      # a flat convex polygon
//! cells = ["kitchen", "living"]
//! corners = [[4, 0, 1], [4, 0, 2], [4, 2, 2], [4, 2, 1]]
//!
//! [[remove_cell]]                 # becomes outside; its portals go
//! cell = "room 9"
//! ```
//!
//! What is cut or removed is believed: culling shows nothing through a portal that a person has
//! taken away.

use super::annotated::oriented;
use glam::DVec3;
use ldi_protocol::Aabb;
use ldi_protocol::rooms::{Cell, CellId, Portal, PortalKind, Rooms};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use toml::Spanned;

/// Longest file, bytes.
const MAX_BYTES: usize = 1 << 20;
/// What the file calls the outside.
const OUTSIDE: &str = "outside";
/// A portal to be removed lies at most this far from its `at`, metres.
const NEAR_M: f64 = 1.0;

/// A file of corrections that cannot be applied.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("{}:{line}: {problem}", path.display())]
pub struct OverrideError {
    /// The file.
    pub path: PathBuf,
    /// Line, from 1.
    pub line: usize,
    /// What is wrong, and what would do.
    pub problem: String,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct File {
    split: Vec<Spanned<Split>>,
    merge: Vec<Spanned<Merge>>,
    rename: Vec<Spanned<Rename>>,
    remove_portal: Vec<Spanned<RemovePortal>>,
    portal: Vec<Spanned<AddPortal>>,
    remove_cell: Vec<Spanned<RemoveCell>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Split {
    cell: String,
    x: Option<f64>,
    z: Option<f64>,
    names: [String; 2],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Merge {
    cells: Vec<String>,
    name: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Rename {
    from: String,
    to: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RemovePortal {
    cells: [String; 2],
    at: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct AddPortal {
    cells: [String; 2],
    corners: Vec<[f64; 3]>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RemoveCell {
    cell: String,
}

/// Applies the corrections in `text`, the content of `path`.
///
/// # Errors
/// The first line that cannot be read or applied.
pub fn apply_overrides(rooms: &Rooms, path: &Path, text: &str) -> Result<Rooms, OverrideError> {
    let fail = |line: usize, problem: String| OverrideError { path: path.into(), line, problem };
    if text.len() > MAX_BYTES {
        return Err(fail(1, format!("{} bytes, at most {MAX_BYTES} are read", text.len())));
    }
    let line_of = |at: usize| text.as_bytes()[..at.min(text.len())].iter().filter(|b| **b == b'\n').count() + 1;
    let file: File =
        toml::from_str(text).map_err(|e| fail(e.span().map_or(1, |s| line_of(s.start)), e.message().to_string()))?;
    let mut draft =
        Draft { cells: rooms.cells().iter().cloned().map(Some).collect(), portals: rooms.portals().to_vec() };
    // One list of (line, correction), in the order of kinds.
    let mut last = 1;
    let mut run = |at: usize, result: Result<(), String>| {
        last = line_of(at);
        result.map_err(|problem| fail(last, problem))
    };
    for s in &file.split {
        run(s.span().start, draft.split(s.get_ref()))?;
    }
    for m in &file.merge {
        run(m.span().start, draft.merge(m.get_ref()))?;
    }
    for r in &file.rename {
        run(r.span().start, draft.rename(r.get_ref()))?;
    }
    for r in &file.remove_portal {
        run(r.span().start, draft.remove_portal(r.get_ref()))?;
    }
    for p in &file.portal {
        run(p.span().start, draft.add_portal(p.get_ref()))?;
    }
    for r in &file.remove_cell {
        run(r.span().start, draft.remove_cell(r.get_ref()))?;
    }
    draft.rooms(rooms.margin_m()).map_err(|problem| fail(last, problem))
}

/// Rooms while they change: removed cells leave a gap, so that numbers stay.
struct Draft {
    cells: Vec<Option<Cell>>,
    portals: Vec<Portal>,
}

impl Draft {
    fn find(&self, name: &str) -> Result<CellId, String> {
        if name == OUTSIDE {
            return Ok(None);
        }
        let at = self.cells.iter().position(|c| c.as_ref().is_some_and(|c| c.name == name));
        at.map(|i| Some(i as u32)).ok_or_else(|| {
            let names: Vec<&str> = self.cells.iter().flatten().map(|c| c.name.as_str()).take(12).collect();
            format!("no cell is named \"{name}\"; there are {} ...", names.join(", "))
        })
    }

    fn cell(&self, name: &str) -> Result<usize, String> {
        self.find(name)?.map(|c| c as usize).ok_or_else(|| "the outside is no cell that can be changed".into())
    }

    fn check_name(&self, name: &str) -> Result<(), String> {
        if name.is_empty() || name == OUTSIDE || self.find(name).is_ok() {
            return Err(format!("the name \"{name}\" is empty or taken"));
        }
        Ok(())
    }

    fn rename(&mut self, r: &Rename) -> Result<(), String> {
        let c = self.cell(&r.from)?;
        self.check_name(&r.to)?;
        if let Some(cell) = &mut self.cells[c] {
            cell.name.clone_from(&r.to);
        }
        Ok(())
    }

    fn merge(&mut self, m: &Merge) -> Result<(), String> {
        let numbers = m.cells.iter().map(|n| self.cell(n)).collect::<Result<Vec<_>, _>>()?;
        let [first, rest @ ..] = numbers.as_slice() else { return Err("`cells` names no cell".into()) };
        for c in rest {
            if c == first {
                return Err("a cell is named twice".into());
            }
            let boxes = self.cells[*c].take().map(|c| c.boxes).unwrap_or_default();
            if let Some(cell) = &mut self.cells[*first] {
                cell.boxes.extend(boxes);
            }
            self.redirect(*c, Some(*first as u32));
        }
        if let Some(cell) = &mut self.cells[*first] {
            cell.name.clear();
        }
        self.check_name(&m.name)?;
        if let Some(cell) = &mut self.cells[*first] {
            cell.name.clone_from(&m.name);
        }
        Ok(())
    }

    fn redirect(&mut self, from: usize, to: CellId) {
        for p in &mut self.portals {
            p.cells = p.cells.map(|c| if c == Some(from as u32) { to } else { c });
        }
        self.portals.retain(|p| p.cells[0] != p.cells[1]);
    }

    fn remove_cell(&mut self, r: &RemoveCell) -> Result<(), String> {
        let c = self.cell(&r.cell)?;
        self.cells[c] = None;
        self.redirect(c, None);
        Ok(())
    }

    fn remove_portal(&mut self, r: &RemovePortal) -> Result<(), String> {
        let [a, b] = [self.find(&r.cells[0])?, self.find(&r.cells[1])?];
        let at = DVec3::from(r.at);
        let nearest = (0..self.portals.len())
            .filter(|p| self.portals[*p].beyond(a) == Some(b))
            .map(|p| (self.portals[p].distance_m(at), p))
            .min_by(|x, y| x.0.total_cmp(&y.0));
        match nearest {
            Some((d, p)) if d <= NEAR_M => {
                self.portals.remove(p);
                Ok(())
            }
            Some((d, _)) => {
                Err(format!("the nearest portal between them lies {d:.2} m from `at`, more than {NEAR_M} m"))
            }
            None => Err(format!("there is no portal between \"{}\" and \"{}\"", r.cells[0], r.cells[1])),
        }
    }

    fn add_portal(&mut self, p: &AddPortal) -> Result<(), String> {
        let cells = [self.find(&p.cells[0])?, self.find(&p.cells[1])?];
        let corners: Vec<DVec3> = p.corners.iter().map(|c| DVec3::from(*c)).collect();
        if cells[0] == cells[1] {
            return Err("both cells are the same".into());
        }
        if corners.len() > ldi_protocol::rooms::MAX_CORNERS || !ldi_protocol::rooms::is_flat_convex(&corners) {
            return Err("`corners` must be a flat, convex polygon in order".into());
        }
        self.add(Portal { cells, kind: PortalKind::Given, corners });
        Ok(())
    }

    fn add(&mut self, portal: Portal) {
        let empty = Cell { name: String::new(), boxes: Vec::new() };
        let cells: Vec<Cell> = self.cells.iter().map(|c| c.clone().unwrap_or_else(|| empty.clone())).collect();
        self.portals.push(oriented(&cells, portal));
    }

    fn split(&mut self, s: &Split) -> Result<(), String> {
        let c = self.cell(&s.cell)?;
        let (axis, at) = match (s.x, s.z) {
            (Some(x), None) => (0, x),
            (None, Some(z)) => (2, z),
            _ => return Err("give either x or z".into()),
        };
        let Some(cell) = self.cells[c].take() else { return Err("the cell is gone".into()) };
        let bounds = cell.bounds();
        if !(bounds.min[axis] < at && at < bounds.max[axis]) {
            let (low, high) = (bounds.min[axis], bounds.max[axis]);
            return Err(format!("the plane misses the cell, which reaches from {low:.2} to {high:.2}"));
        }
        let second = self.cells.len() as u32;
        let mut parts = [Vec::new(), Vec::new()];
        let mut cut = Aabb::EMPTY;
        for b in &cell.boxes {
            let (mut low, mut high) = (*b, *b);
            low.max[axis] = low.max[axis].min(at);
            high.min[axis] = high.min[axis].max(at);
            if low.min[axis] < at {
                parts[0].push(low);
            }
            if high.max[axis] > at {
                parts[1].push(high);
            }
            if b.min[axis] < at && at < b.max[axis] {
                cut = cut.union(*b);
            }
        }
        // Portals on the line belong to both halves.
        let mut more = Vec::new();
        for p in &mut self.portals {
            let Some(side) = p.cells.iter().position(|x| *x == Some(c as u32)) else { continue };
            let low = p.corners.iter().any(|q| q[axis] < at);
            let high = p.corners.iter().any(|q| q[axis] > at);
            if high && low {
                let mut copy = p.clone();
                copy.cells[side] = Some(second);
                more.push(copy);
            } else if high {
                p.cells[side] = Some(second);
            }
        }
        self.portals.extend(more);
        let [low, high] = parts;
        for name in &s.names {
            self.check_name(name)?;
        }
        self.cells[c] = Some(Cell { name: s.names[0].clone(), boxes: low });
        self.cells.push(Some(Cell { name: s.names[1].clone(), boxes: high }));
        if !cut.is_empty() {
            let other = 2 - axis;
            let corner = |o: f64, y: f64| {
                let mut p = DVec3::new(0.0, y, 0.0);
                (p[axis], p[other]) = (at, o);
                p
            };
            let (a, b) = (cut.min, cut.max);
            let corners =
                vec![corner(a[other], a.y), corner(b[other], a.y), corner(b[other], b.y), corner(a[other], b.y)];
            self.add(Portal { cells: [Some(c as u32), Some(second)], kind: PortalKind::Given, corners });
        }
        Ok(())
    }

    fn rooms(self, margin_m: f64) -> Result<Rooms, String> {
        let mut number = Vec::new();
        let mut cells = Vec::new();
        for c in self.cells {
            number.push(c.as_ref().map(|_| cells.len() as u32));
            cells.extend(c);
        }
        let new = |c: CellId| c.and_then(|c| number[c as usize]);
        let portals =
            self.portals.into_iter().map(|p| Portal { cells: [new(p.cells[0]), new(p.cells[1])], ..p }).collect();
        Rooms::new(margin_m, cells, portals).map_err(|e| e.to_string())
    }
}

#[cfg(test)]
#[path = "overrides_test.rs"]
mod tests;
