//! Which rooms points lie in, for many points: boxes of rooms sorted by where they lie in plan.
//!
//! In: rooms. Out: for any point what [`Rooms::cells_near`] gives within the rooms' margin, which
//! looks at every box.

use glam::DVec3;
use ldi_protocol::Aabb;
use ldi_protocol::rooms::{CellId, Rooms};
use std::ops::Range;

/// Most columns of [`Columns`]: some megabytes.
const MOST_COLUMNS: f64 = 65_536.0;
/// Side of one, at least, metres: a doorway is about as wide.
const LEAST_COLUMN_M: f64 = 0.5;

/// What [`Rooms::cells_near`] within the rooms' margin gives, for many points: boxes sorted by
/// where they lie in plan.
pub(super) struct Columns<'a> {
    rooms: &'a Rooms,
    bounds: Aabb,
    side_m: f64,
    across: usize,
    /// Per column, cell and number of every box that reaches it with the margin around, cells in
    /// order.
    boxes: Vec<Vec<[u32; 2]>>,
}

impl<'a> Columns<'a> {
    pub(super) fn new(rooms: &'a Rooms) -> Self {
        let all =
            || (0u32..).zip(rooms.cells()).flat_map(|(c, cell)| (0u32..).zip(&cell.boxes).map(move |(n, b)| (c, n, b)));
        let around = |b: &Aabb| Aabb { min: b.min - rooms.margin_m(), max: b.max + rooms.margin_m() };
        let bounds = Aabb::from_points(all().flat_map(|(.., b)| [around(b).min, around(b).max]));
        let size = bounds.size().max(DVec3::ZERO);
        let side_m = (size.x * size.z / MOST_COLUMNS).sqrt().max(size.max_element() / MOST_COLUMNS).max(LEAST_COLUMN_M);
        let count = |m: f64| (m / side_m) as usize + 1;
        let mut columns = Self {
            rooms,
            bounds,
            side_m,
            across: count(size.x),
            boxes: vec![Vec::new(); count(size.x) * count(size.z)],
        };
        for (c, n, b) in all() {
            let b = around(b);
            let ([x0, z0], [x1, z1]) = (columns.column(b.min), columns.column(b.max));
            for z in z0..=z1 {
                for x in x0..=x1 {
                    columns.boxes[z * columns.across + x].push([c, n]);
                }
            }
        }
        columns
    }

    /// Of a point within the bounds.
    fn column(&self, p: DVec3) -> [usize; 2] {
        let from = (p - self.bounds.min) / self.side_m;
        [from.x as usize, from.z as usize]
    }

    /// Boxes that may reach a point.
    fn boxes_at(&self, p: DVec3) -> &[[u32; 2]] {
        if !self.bounds.contains(p) {
            return &[];
        }
        let [x, z] = self.column(p);
        &self.boxes[z * self.across + x]
    }

    /// Whether a point is in a box of a room, so high above its bottom, metres.
    pub(super) fn is_at_height(&self, p: DVec3, heights_m: &Range<f64>) -> bool {
        let mut boxes = self.boxes_at(p).iter().map(|&[c, n]| &self.rooms.cells()[c as usize].boxes[n as usize]);
        boxes.any(|b| b.contains(p) && heights_m.contains(&(p.y - b.min.y)))
    }

    /// Whether a room is one of [`Self::cells_near`].
    pub(super) fn is_near(&self, p: DVec3, room: CellId) -> bool {
        let Some(room) = room else { return self.cells_near(p).contains(&None) };
        let boxes = &self.rooms.cells()[room as usize].boxes;
        let mut of_room = self.boxes_at(p).iter().filter(|b| b[0] == room);
        of_room.any(|b| boxes[b[1] as usize].distance(p) <= self.rooms.margin_m())
    }

    pub(super) fn cells_near(&self, p: DVec3) -> Vec<CellId> {
        let margin = self.rooms.margin_m();
        let here = self.boxes_at(p);
        if here.is_empty() {
            return vec![None];
        }
        let of = |&[c, n]: &[u32; 2]| &self.rooms.cells()[c as usize].boxes[n as usize];
        let mut near: Vec<CellId> = here.iter().filter(|b| of(b).distance(p) <= margin).map(|b| Some(b[0])).collect();
        near.dedup();
        let held = |q: DVec3| here.iter().any(|b| of(b).contains(q) && near.contains(&Some(b[0])));
        let around = Aabb { min: p - margin, max: p + margin };
        if !(held(p) && around.corners().into_iter().all(held)) {
            near.push(None);
        }
        near
    }
}

#[cfg(test)]
mod tests {
    use super::super::leaks::Random;
    use super::*;
    use ldi_protocol::rooms::Cell;

    #[test]
    fn columns_give_what_a_look_at_every_box_gives() {
        let mut r = Random(7);
        let mut at = |m: f64| DVec3::new(m * r.unit(), 0.3 * m * r.unit(), 2.0 * m * r.unit());
        let cells = (0..40)
            .map(|n| Cell {
                name: n.to_string(),
                boxes: (0..5)
                    .map(|_| (at(9.0), at(2.0)))
                    .map(|(min, size)| Aabb { min, max: min + size + 0.1 })
                    .collect(),
            })
            .collect();
        let rooms = Rooms::new(0.15, cells, Vec::new()).unwrap();
        let columns = Columns::new(&rooms);
        let mut counts = [0; 5];
        for _ in 0..20_000 {
            let p = at(12.0) - 0.5;
            let near = columns.cells_near(p);
            assert_eq!(near, rooms.cells_near(p, rooms.margin_m()), "at {p}");
            let rooms = (0..40).map(Some).chain([None]);
            assert!(rooms.into_iter().all(|room| columns.is_near(p, room) == near.contains(&room)), "at {p}");
            counts[near.len().min(4)] += 1;
        }
        assert!(counts[1..].iter().all(|n| *n > 100), "{counts:?}");
    }
}
