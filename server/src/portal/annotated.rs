//! Cells and portals that the scene file names.

use crate::scene::{OUTSIDE, Scene};
use glam::DVec3;
use ldi_protocol::rooms::{Cell, CellId, Portal, PortalKind, Rooms, RoomsError};

/// How far annotated boxes may be off the portals' planes, metres: half of a wall.
const MARGIN_M: f64 = 0.15;
/// How far beside a portal its cells are looked for, metres.
const BESIDE_M: f64 = 0.2;

/// The annotated rooms of a scene; None if it names none.
///
/// # Errors
/// If they break a rule of [`Rooms::new`].
pub fn annotated_rooms(scene: &Scene) -> Result<Option<Rooms>, RoomsError> {
    if scene.rooms.is_empty() {
        return Ok(None);
    }
    let cells: Vec<Cell> = scene.rooms.iter().map(|r| Cell { name: r.name.clone(), boxes: vec![r.bounds] }).collect();
    // The importer has checked that every name is known.
    let id = |name: &str| -> CellId {
        if name == OUTSIDE { None } else { cells.iter().position(|c| c.name == name).map(|c| c as u32) }
    };
    let portals = scene.portals.iter().map(|p| {
        let [a, b] = p.rooms.each_ref().map(|r| id(r));
        oriented(&cells, Portal { cells: [a, b], kind: PortalKind::Given, corners: p.corners.clone() })
    });
    let portals = portals.collect();
    Rooms::new(MARGIN_M, cells, portals).map(Some)
}

/// A portal whose corners turn so that its normal points from its first cell into its second:
/// annotations may have either order.
pub(super) fn oriented(cells: &[Cell], mut portal: Portal) -> Portal {
    let (c, n) = (portal.centre(), portal.normal());
    let off = |cell: CellId, p: DVec3| cell.map_or(0.0, |i| cells[i as usize].distance_m(p));
    // How far off the cells would be if the portal pointed forward, and backward.
    let cost = |s: f64| off(portal.cells[0], c - n * (s * BESIDE_M)) + off(portal.cells[1], c + n * (s * BESIDE_M));
    // Beside the outside, being in the cell is what counts.
    if cost(-1.0) < cost(1.0) {
        portal.corners.reverse();
    }
    portal
}
