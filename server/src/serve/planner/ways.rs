//! Where somebody on foot can get to in a building: through doors, not through walls.
//!
//! In: the rooms of a dataset. Out: whether a straight way leads through doors ([`leads`]), and
//! the doors that can be reached, by the length of the way through the rooms ([`doors`]: Dijkstra
//! 1959 over doors, straight from one to the next). What lies behind a wall is near by straight
//! distance and far on foot; a forecast that does not know the wall sends it in vain.
//!
//! Which portals can be walked through is a matter of shape, not of what they are called:
//! annotations do not say, and gaps may be as large as doors.

use glam::DVec3;
use ldi_protocol::rooms::{CellId, Portal, Rooms};
use std::collections::BTreeMap;

/// A door reaches at least so far below the eye, metres: higher ones are windows.
const SILL_M: f64 = 1.0;
/// And no lower than so far below its top, metres: people duck a little.
const LINTEL_M: f64 = 0.1;
/// Narrowest door, metres.
const NARROWEST_M: f64 = 0.5;
/// How far beside a door's polygon a straight way may pass, metres: people go around the jamb.
/// Larger: fewer guesses are lost, more go through walls.
const BESIDE_M: f64 = 0.3;

/// A door that can be reached.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Door {
    /// Its middle, at the height of the eye.
    pub place: DVec3,
    /// Horizontal unit direction through it.
    pub into: DVec3,
    /// Horizontal unit direction of the first leg of the way there.
    pub toward: DVec3,
    /// Length of the way, metres.
    pub distance_m: f64,
}

/// Whether somebody whose eye is so high can walk through a portal; through horizontal ones stairs
/// lead.
fn is_open(portal: &Portal, eye_m: f64) -> bool {
    let heights = portal.corners.iter().map(|c| c.y);
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), y| (a.min(y), b.max(y)));
    let along = DVec3::Y.cross(portal.normal()).normalize_or_zero();
    let places = portal.corners.iter().map(|c| c.dot(along));
    let (left, right) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
    low <= eye_m - SILL_M && high >= eye_m - LINTEL_M && right - left >= NARROWEST_M
}

fn is_level(portal: &Portal) -> bool {
    portal.normal().y.abs() > 0.5
}

/// Whether the straight way between two places, metres, leads through portals that can be walked
/// through wherever it leaves a room.
pub(super) fn leads(rooms: &Rooms, from: DVec3, to: DVec3) -> bool {
    let ends = rooms.cells_near(to, rooms.margin_m());
    let mut reached = rooms.cells_near(from, rooms.margin_m());
    let mut next = 0;
    while let Some(&cell) = reached.get(next) {
        next += 1;
        if ends.contains(&cell) {
            return true;
        }
        for portal in rooms.portals_of(cell).iter().map(|p| &rooms.portals()[*p as usize]) {
            let Some(beyond) = portal.beyond(cell).filter(|b| !reached.contains(b)) else { continue };
            let n = portal.normal();
            let (before, after) = (n.dot(from - portal.corners[0]), n.dot(to - portal.corners[0]));
            // Ways that end within the margin of the plane touch it.
            let touches = before.abs().min(after.abs()) <= rooms.margin_m();
            if before.signum() == after.signum() && !touches {
                continue;
            }
            let at = from.lerp(to, (before / (before - after)).clamp(0.0, 1.0));
            if (is_level(portal) || is_open(portal, at.y)) && portal.distance_m(at) <= BESIDE_M {
                reached.push(beyond);
            }
        }
    }
    false
}

/// The doors that lie at most `within_m` away on foot, nearest first; each in the direction in
/// which it is reached first.
pub(super) fn doors(rooms: &Rooms, from: DVec3, within_m: f64) -> Vec<Door> {
    // Reached and not gone on from: portal, room beyond it, door.
    let mut open: BTreeMap<u32, (CellId, Door)> = BTreeMap::new();
    let mut done: Vec<u32> = Vec::new();
    let mut found = Vec::new();
    let step =
        |open: &mut BTreeMap<u32, (CellId, Door)>, done: &[u32], cell: CellId, at: DVec3, before: Option<Door>| {
            for &number in rooms.portals_of(cell).iter().filter(|p| !done.contains(p)) {
                let portal = &rooms.portals()[number as usize];
                let Some(beyond) = portal.beyond(cell) else { continue };
                if is_level(portal) || !is_open(portal, from.y) {
                    continue;
                }
                let place = portal.centre().with_y(from.y);
                let leg = (place - at).with_y(0.0);
                let distance_m = before.map_or(0.0, |d| d.distance_m) + leg.length();
                let into =
                    portal.normal().with_y(0.0).normalize_or_zero() * if portal.cells[0] == cell { 1.0 } else { -1.0 };
                let toward = before.map_or(leg.normalize_or(into), |d| d.toward);
                let nearer = open.get(&number).is_none_or(|o| distance_m < o.1.distance_m);
                if distance_m <= within_m && nearer {
                    open.insert(number, (beyond, Door { place, into, toward, distance_m }));
                }
            }
        };
    for cell in rooms.cells_near(from, rooms.margin_m()) {
        step(&mut open, &done, cell, from, None);
    }
    while let Some((&number, &(beyond, door))) =
        open.iter().min_by(|a, b| a.1.1.distance_m.total_cmp(&b.1.1.distance_m))
    {
        open.remove(&number);
        done.push(number);
        found.push(door);
        step(&mut open, &done, beyond, door.place, Some(door));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_protocol::{
        Aabb,
        rooms::{Cell, PortalKind},
    };

    /// ```text
    ///   z 8 +-----+-----+      a, b, c, d: rooms of 4 m by 4 m, 3 m high
    ///       |  c  D  d  |      D: doors of 1 m by 2 m; W: a window between a and b
    ///     4 +--D--+--D--+
    ///       |  a  W  b  |      from a to b on foot: through c and d
    ///     0 +-----+-----+ x 8
    /// ```
    fn four() -> Rooms {
        let cell = |name: &str, x: f64, z: f64| {
            let (min, max) = (DVec3::new(x, 0.0, z), DVec3::new(x + 4.0, 3.0, z + 4.0));
            Cell { name: name.into(), boxes: vec![Aabb { min, max }] }
        };
        let portal = |cells: [u32; 2], kind, low: f64, middle: DVec3, along: DVec3| {
            let at = |side: f64, y: f64| middle + along * side + DVec3::Y * y;
            let corners = vec![at(-0.5, low), at(0.5, low), at(0.5, 2.0), at(-0.5, 2.0)];
            Portal { cells: cells.map(Some), kind, corners }
        };
        let portals = vec![
            portal([0, 2], PortalKind::Door, 0.0, DVec3::new(2.0, 0.0, 4.0), DVec3::X),
            portal([2, 3], PortalKind::Given, 0.0, DVec3::new(4.0, 0.0, 6.0), DVec3::NEG_Z),
            portal([3, 1], PortalKind::Gap, 0.0, DVec3::new(6.0, 0.0, 4.0), DVec3::NEG_X),
            portal([0, 1], PortalKind::Window, 0.9, DVec3::new(4.0, 0.0, 2.0), DVec3::NEG_Z),
        ];
        Rooms::new(
            0.1,
            vec![cell("a", 0.0, 0.0), cell("b", 4.0, 0.0), cell("c", 0.0, 4.0), cell("d", 4.0, 4.0)],
            portals,
        )
        .unwrap()
    }

    fn eye(x: f64, z: f64) -> DVec3 {
        DVec3::new(x, 1.6, z)
    }

    #[test]
    fn doors_come_by_the_way_on_foot() {
        let rooms = four();
        let found = doors(&rooms, eye(2.0, 2.0), 100.0);
        let places: Vec<DVec3> = found.iter().map(|d| d.place).collect();
        assert_eq!(places, [eye(2.0, 4.0), eye(4.0, 6.0), eye(6.0, 4.0)], "the window is no door");
        let leg = 8f64.sqrt();
        for (door, distance) in found.iter().zip([2.0, 2.0 + leg, 2.0 + 2.0 * leg]) {
            assert!((door.distance_m - distance).abs() < 1e-9, "{door:?}");
            assert_eq!(door.toward, DVec3::Z, "all ways begin at the first door");
        }
        assert_eq!(found.iter().map(|d| d.into).collect::<Vec<_>>(), [DVec3::Z, DVec3::X, DVec3::NEG_Z]);
        assert_eq!(doors(&rooms, eye(2.0, 2.0), 3.0).len(), 1);
        assert_eq!(
            doors(&rooms, DVec3::new(2.0, 0.7, 2.0), 100.0).len(),
            0,
            "for an eye near the floor there is nothing below"
        );
        // Somebody in a doorway is in both rooms: 4 m to d's other door, and the door itself is
        // nearest.
        assert_eq!(doors(&rooms, eye(2.0, 4.0), 100.0)[0].distance_m, 0.0);
    }

    /// Against walking the way in steps of 1 mm: wherever the room changes, a door has to be near.
    #[test]
    fn straight_ways_lead_through_doors_only() {
        let rooms = four();
        let stepped = |from: DVec3, to: DVec3, beside_m: f64| {
            let steps = (from.distance(to) * 1e3).ceil() as u32;
            let cell = |i: u32| rooms.cell_at(from.lerp(to, f64::from(i) / f64::from(steps)));
            (1..=steps).all(|i| {
                let (a, b) = (cell(i - 1), cell(i));
                let at = from.lerp(to, f64::from(i) / f64::from(steps));
                let through =
                    |p: &Portal| p.beyond(a) == Some(b) && p.kind != PortalKind::Window && p.distance_m(at) <= beside_m;
                a == b || rooms.portals().iter().any(through)
            })
        };
        let mut state = 5u64;
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1u32 << 24)
        };
        let mut counts = [0; 2];
        for _ in 0..3000 {
            let mut place = || eye(0.2 + 7.6 * unit(), 0.2 + 7.6 * unit());
            let (from, to) = (place(), place());
            let near_border = |p: DVec3| rooms.cells_near(p, 0.1).len() > 1;
            if near_border(from) || near_border(to) {
                continue;
            }
            // Steps are too coarse to tell what passes as far beside a door as is allowed.
            let wide = stepped(from, to, BESIDE_M + 0.002);
            if wide == stepped(from, to, BESIDE_M - 0.002) {
                assert_eq!(leads(&rooms, from, to), wide, "{from} to {to}");
                counts[usize::from(wide)] += 1;
            }
        }
        assert!(counts.iter().all(|c| *c > 300), "{counts:?}");
        // A step aside ends within the wall's margin: still in the room.
        assert!(leads(&rooms, eye(1.0, 3.0), eye(1.0, 4.05)) && !leads(&rooms, eye(1.0, 3.0), eye(1.0, 4.2)));
    }
}
